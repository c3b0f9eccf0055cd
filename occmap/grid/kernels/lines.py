"""Bresenham's line (1965): where it runs, what of it lies in a window, and how it is added.

A line is a staircase along its major axis u, a cell at a time; v is the other axis. After i of its
n cells it has made floor((2 i m + n) / (2 n)) of its m steps along v.

Cells that all get the same are not visited. Only changes along u are written: +1 where a run of
cells starts, and -1 after its end, so that a running sum gives the counts back. A step from v - 1
to v at u ends one run and starts the next, so that a single entry says both:

    change[v, u] = runs[v, u] + steps[v, u] - steps[v + 1, u]

A line thus costs one addition for each step and not for each cell: a third of them, on average.
Lines that rise more than they run go in the same way to a transposed pair of arrays.
"""

from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.types import Int32

FRACTION_BITS = 36
"""Bits of the fraction of a step's place; the bits above are an index into a window."""


class Line(NamedTuple):
    """A line of n + 1 cells."""

    steep: bool
    """u counts rows, and v columns"""
    u: int
    v: int
    """The first cell"""
    u_sign: int
    v_sign: int
    n: int
    m: int


@step
def draw_line(col: int, row: int, end_col: int, end_row: int) -> Line:
    """The line from one cell to another."""
    n, m = abs(end_col - col), abs(end_row - row)
    right, up = (1 if end_col > col else -1), (1 if end_row > row else -1)
    if m > n:
        return Line(True, row, col, up, right, m, n)
    return Line(False, col, row, right, up, n, m)


@step
def steps_after(line: Line, i: float) -> float:
    """How many steps along v a line has made after i cells: floor(i m / n + 1 / 2).

    A quarter of 1 / n, half of what lies between two values, keeps them from what rounding does.
    """
    per_cell = 1.0 / max(line.n, 1)
    return float(np.floor(i * (line.m * per_cell) + (0.5 + 0.25 * per_cell)))


@step
def count_steps(line: Line, i: int) -> int:
    """`steps_after` as an integer; at the ends of a line, its usual places, without a division."""
    if i in (0, line.n):
        return line.m if i else 0
    return (2 * i * line.m + line.n) // (2 * line.n)


@step
def find_step(line: Line, j: int) -> int:
    """After how many cells a line has made j steps: the inverse of `steps_after`."""
    if j <= 0:
        return 0
    if j > line.m:
        return line.n + 1
    return int((line.n * (2 * j - 1) + 2 * line.m - 0.5) * (0.5 / line.m))


@step
def lies_inside(col: int, row: int, end_col: int, end_row: int, rows: int, cols: int) -> bool:
    """Whether both ends of a line lie in a window, and so all of it: nearly always."""
    return (
        min(row, end_row, col, end_col) >= 0
        and max(row, end_row) < rows
        and max(col, end_col) < cols
    )


@kernel
def clip_line(line: Line, rows: int, cols: int) -> tuple[int, int]:
    """Find which cells of a line lie in a window: the first, and the one after the last."""
    width, height = (rows, cols) if line.steep else (cols, rows)
    u, v, n = line.u, line.v, line.n
    before_u, beyond_u = (-u, width - u) if line.u_sign > 0 else (u - width + 1, u + 1)
    before_v, beyond_v = (-v, height - v) if line.v_sign > 0 else (v - height + 1, v + 1)
    first = max(before_u, find_step(line, before_v), 0)
    end = min(beyond_u, find_step(line, beyond_v) if beyond_v > 0 else 0, n + 1)
    return first, max(first, end)


@step
def note_line(
    line: Line, first: int, end: int, runs: Int32, steps: Int32, stride: int, weight: int
) -> None:
    """Add the cells of a line from `first` to before `end`, all in the window, as changes.

    The place of a step advances by n / m along u and by one along v: both in one fixed-point
    number. Its fraction is too low by less than 2^-36 for each step, and 1 / (2 m) is the least
    that separates it from the next whole number. So steps are exact for lines of 2^22 cells in a
    window of 2^24 cells, which has at most 2^12 steps of a line.
    """
    n, m = line.n, line.m
    made = count_steps(line, first)
    last = m - (n < 2 * m) if end == n else count_steps(line, end - 1)
    v, v_last = line.v + line.v_sign * made, line.v + line.v_sign * last
    # A line to the left ends its runs and makes its steps one cell farther to the right.
    origin, change = (line.u, weight) if line.u_sign > 0 else (line.u + 1, -weight)
    runs[np.uint64(v * stride + origin + line.u_sign * first)] += change
    runs[np.uint64(v_last * stride + origin + line.u_sign * end)] -= change
    if made == last:
        return
    slope = (n << FRACTION_BITS) // m
    place = (slope >> 1) - 1 + (1 << FRACTION_BITS)  # rounded up
    if made:
        whole, rest = divmod(2 * n * made, 2 * m)
        place += (whole << FRACTION_BITS) + (rest << FRACTION_BITS) // (2 * m)
    if line.u_sign < 0:
        place, slope = (1 << FRACTION_BITS) - 1 - place, -slope
    if line.v_sign > 0:
        place += ((v + 1) * stride + origin) << FRACTION_BITS
        slope += stride << FRACTION_BITS
    else:
        place += (v * stride + origin) << FRACTION_BITS
        slope -= stride << FRACTION_BITS
        change = -change
    for _ in range(last - made):
        steps[np.uint64(place) >> np.uint64(FRACTION_BITS)] += change
        place += slope
