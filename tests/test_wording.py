"""One of a thing is written in the singular."""

import pytest

from occmap.wording import count


@pytest.mark.parametrize(
    ("number", "text"),
    [(0, "0 beams"), (1, "1 beam"), (2, "2 beams"), (1234567, "1,234,567 beams")],
)
def test_things_are_counted(number: int, text: str) -> None:
    assert count(number, "beam") == text


def test_a_noun_in_s_gets_es() -> None:
    assert [count(number, "miss") for number in (0, 1, 2)] == ["0 misses", "1 miss", "2 misses"]
