"""Bresenham's line (1965): where it runs, what of it lies in a window, and how it is added.

A line is a staircase along its major axis u, a cell at a time; v is the other axis. After i of its
n cells it has made floor((2 i m + n) / (2 n)) of its m steps along v.

Cells that all get the same are not visited. Only changes along u are written: +1 where a run of
cells starts, and -1 after its end, so that a running sum gives the counts back. A step from v - 1
to v at u ends one run and starts the next, so that a single entry says both:

    change[v, u] = runs[v, u] + steps[v, u] - steps[v + 1, u]

A line thus costs one addition for each step and not for each cell: a third of them, on average.
Lines that rise more than they run go in the same way to a transposed pair of arrays.

A beam is such a line, and the model is sure of it up to some cell. In the surface update, beams are
also drawn between two neighbours that meet one surface, as the module `projection` says; a drawn
beam has no measured range, so its range follows from its end.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels import AT_A_TIME, PAD
from occmap.jit import step
from occmap.types import Int32, Int64

FRACTION_BITS = 36
"""Bits of the fraction of a step's place; the bits above are an index into a window."""


@step
def fill_up(size: int) -> int:
    """Fill up how often a short loop runs, to whole groups of `AT_A_TIME`."""
    return (size + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME


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
    if i == 0:
        return 0
    if i == line.n:
        return line.m
    if i == line.n - 1:
        return line.m - (line.n < 2 * line.m)
    return (2 * i * line.m + line.n) // (2 * line.n)


@step
def find_step(line: Line, j: int) -> int:
    """After how many cells a line has made j steps: the inverse of `steps_after`."""
    if j <= 0:
        return 0
    if j > line.m:
        return line.n + 1
    return int((line.n * (2 * j - 1) + 2 * line.m - 0.5) * (0.5 / line.m))


class Changes(NamedTuple):
    """How often cells were plain: changes along a window's rows, and of steep lines along columns.

    All lie in one array, one after the other: H x (W + PAD) runs along rows, (H + 1) x (W + PAD)
    steps, W x (H + PAD) runs along columns and (W + 1) x (H + PAD) steps; where a kernel writes to
    rows alone, only the first of these.
    """

    numbers: Int32
    rows: int
    """H"""
    cols: int
    """W"""


class Field(NamedTuple):
    """The cells of a window that scans are added to."""

    corner: Int64
    """(2,) x and y of the window's corner (lattice units from the anchor)"""
    cells: Int64
    """H x (W + PAD), flat: what single cells got; none where cells lie in tiles"""
    changes: Changes
    """How often cells were plain; has no numbers where cells lie in tiles"""
    clipped: bool | None
    """None: no beam reaches beyond the window, which costs fewer comparisons"""


class Path(NamedTuple):
    """The cells of a window that a beam crosses."""

    line: Line
    first: int
    """The first cell of the line that lies in the window"""
    plain: int
    """The first that is not plain: before it, all cells get the same"""
    end: int
    """The one after the last that lies in the window"""
    weight: int
    """How many times each of its cells gets what the model says"""


@step
def clip_path(path: Path, changes: Changes, clipped: bool | None) -> Path:
    """Leave out the cells that lie beside a window, unless none does, as `Field` says."""
    if clipped is None:  # as an argument it is known while compiling, which leaves out the rest
        return path
    line, (u, v), rows, cols = path.line, (path.line.u, path.line.v), changes.rows, changes.cols
    width, height = (rows, cols) if line.steep else (cols, rows)
    before_u, beyond_u = (-u, width - u) if line.u_sign > 0 else (u - width + 1, u + 1)
    before_v, beyond_v = (-v, height - v) if line.v_sign > 0 else (v - height + 1, v + 1)
    first = max(before_u, find_step(line, before_v))
    end = max(min(beyond_u, find_step(line, max(beyond_v, 0))), first)
    return Path(line, first, min(max(path.plain, first), end), end, path.weight)


@step
def find_changes(line: Line, changes: Changes) -> tuple[int, int, int]:
    """Find where the changes of lines such as one lie: its runs, its steps, and how long a row is.

    A row of a steep line is a column of the window.
    """
    across, up = changes.cols + PAD, changes.rows + PAD
    if line.steep:
        runs = (2 * changes.rows + 1) * across
        return runs, runs + changes.cols * up, up
    return 0, changes.rows * across, across


@step
def note_plain(path: Path, changes: Changes) -> None:
    """Add the plain cells of a path as changes: a run begins and ends, and a step ends others."""
    line, numbers = path.line, changes.numbers
    runs, steps, stride = find_changes(line, changes)
    made, last = count_steps(line, path.first), count_steps(line, path.plain - 1)
    v, v_last = line.v + line.v_sign * made, line.v + line.v_sign * last
    # A line to the left ends its runs and makes its steps one cell farther to the right.
    origin, change = (line.u, path.weight) if line.u_sign > 0 else (line.u + 1, -path.weight)
    numbers[np.uint64(runs + v * stride + origin + line.u_sign * path.first)] += change
    numbers[np.uint64(runs + v_last * stride + origin + line.u_sign * path.plain)] -= change
    if made < last:
        note_steps(line, (made, last), (steps + origin, stride), change, numbers)


@step
def note_steps(
    line: Line, made: tuple[int, int], place: tuple[int, int], change: int, numbers: Int32
) -> None:
    """Add the steps of a line, of which so many are made before and behind them, as changes.

    The place of a step advances by n / m along u and by one along v: both in one fixed-point
    number. Its fraction is too low by less than 2^-36 for each step, and 1 / (2 m) is the least
    that separates it from the next whole number. So steps are exact for lines of 2^22 cells in a
    window of 2^24 cells, which has at most 2^12 steps of a line.
    """
    n, m, (done, last), (steps, stride) = line.n, line.m, made, place
    to_next = (n << FRACTION_BITS) // m
    at = (to_next >> 1) - 1 + (1 << FRACTION_BITS)  # rounded up
    if done:
        whole, rest = divmod(2 * n * done, 2 * m)
        at += (whole << FRACTION_BITS) + (rest << FRACTION_BITS) // (2 * m)
    if line.u_sign < 0:
        at, to_next = (1 << FRACTION_BITS) - 1 - at, -to_next
    row = line.v + done + 1 if line.v_sign > 0 else line.v - done  # the upper one of both
    at += (steps + row * stride) << FRACTION_BITS
    to_next += (line.v_sign * stride) << FRACTION_BITS
    for _ in range(last - done):
        numbers[np.uint64(at) >> np.uint64(FRACTION_BITS)] += line.v_sign * change
        at += to_next


FARTHEST_CENTRE = 1.25
"""Cells by which a cell's centre may be farther from the sensor than its place on the line: half a
diagonal at the first cell, and half a cell beside the line."""
BEGIN_EIGHTHS = 5
"""A beam between two others is drawn from so many eighths of its way on."""


@step
def begin_between(at: int, to: int) -> int:
    """Find where a beam between two others begins on its way, along x or y."""
    return ((8 - BEGIN_EIGHTHS) * at + BEGIN_EIGHTHS * to) >> 3


@step
def count_nearer(n: int, m: int, reach: float) -> int:
    """How many of a line's first cells are nearer than `reach` (cells); the last never is."""
    return min(max(int(reach * n / np.sqrt(float(n * n + m * m))), 0), n) if n else 0
