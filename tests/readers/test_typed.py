"""A nasty value or type in each field of each kind of message: a note or the same scans, no more.

`python -m tests.fuzz.typed 5000` runs more cases.
"""

from pathlib import Path

import pytest

from tests.fuzz.typed import MAKERS, PAIRS, make_case, run_case

ROUNDS = 2


@pytest.mark.parametrize("maker", MAKERS)
def test_what_is_nasty_in_one_message_spoils_no_other(maker: str, tmp_path: Path) -> None:
    numbers = [at for at in range(ROUNDS * len(PAIRS)) if PAIRS[at % len(PAIRS)][0] == maker]
    ends = {run_case(make_case(number), tmp_path) for number in numbers}

    assert len(numbers) >= 5 * ROUNDS
    assert "built" in {end.partition(",")[0] for end in ends}
