"""Bresenham's line by formulas: exact for the longest lines that a window can hold."""

from hypothesis import example, given
from hypothesis import strategies as st

from occmap.grid.kernels.lines import Line, count_steps, draw_line, find_step, steps_after
from tests.grid.scans import MANY

LONGEST = 1 << 22


@st.composite
def draw_places(draw: st.DrawFn) -> tuple[int, int, int]:
    """Steps m and cells n of a line, and one of its cells."""
    n = draw(st.integers(1, LONGEST))
    return n, draw(st.integers(0, n)), draw(st.integers(0, n))


@MANY
@given(draw_places())
@example((LONGEST, LONGEST - 1, LONGEST // 2))
@example((LONGEST - 1, LONGEST - 2, LONGEST // 2 - 1))
@example((12, 7, 6))  # a half, of which a float product is a little less
@example((1, 1, 1))
def test_steps_are_rounded_halves_up(place: tuple[int, int, int]) -> None:
    n, m, i = place
    line = Line(*draw_line(0, 0, n, m))
    made = (2 * i * m + n) // (2 * n)
    assert steps_after(line, float(i)) == count_steps(line, i) == made
    first = find_step(line, made)
    assert (2 * first * m + n) // (2 * n) == made
    assert first == 0 or (2 * (first - 1) * m + n) // (2 * n) == made - 1
