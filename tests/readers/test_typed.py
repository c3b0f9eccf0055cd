"""A nasty value or type in each field of each kind of message: a note or the same scans, no more.

`make fuzz` runs 5,000 cases, others each time; a plain test run does fewer, the same each time.
"""

import os
import time
from pathlib import Path

import pytest

from tests.fuzz.typed import MAKERS, PAIRS, make_case, run_case

MUCH = float(os.environ.get("OCCMAP_FUZZ", "0"))
ROUNDS = max(2, round(5000 * MUCH / len(PAIRS)))
FIRST = time.time_ns() % 10**9 * len(PAIRS) if MUCH else 0


@pytest.mark.parametrize("maker", MAKERS)
def test_what_is_nasty_in_one_message_spoils_no_other(maker: str, tmp_path: Path) -> None:
    mine = [at for at, (each, _) in enumerate(PAIRS) if each == maker]
    numbers = [FIRST + turn * len(PAIRS) + at for turn in range(ROUNDS) for at in mine]
    ends = {run_case(make_case(number), tmp_path) for number in numbers}

    assert len(numbers) >= 5 * ROUNDS
    assert "built" in {end.partition(",")[0] for end in ends}
