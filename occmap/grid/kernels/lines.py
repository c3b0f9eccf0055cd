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

from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.units import BETWEEN, CELL_SHIFT, HIT, UNITS_PER_CELL, Tables
from occmap.jit import kernel, step
from occmap.types import Int32, Int64

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


FARTHEST_CENTRE = 1.25
"""Cells by which a cell's centre may be farther from the sensor than its place on the line: half a
diagonal at the first cell, and half a cell beside the line."""
BEGIN_EIGHTHS = 5
"""A beam between two others is drawn from so many eighths of its way on."""


class Beam(NamedTuple):
    """A beam of a scan in a window; all is in lattice units from the window's corner."""

    at_x: int
    """The sensor"""
    at_y: int
    to_x: int
    """The end"""
    to_y: int
    is_hit: bool
    weight: int
    """How many times each of its cells gets what the model says"""
    range: float
    """On the map; 0 where the model does not ask"""
    depth: float
    """How far about the range a hit reaches"""
    drawn: int
    """How many are drawn between it and the next"""
    step_x: int
    """From the end of one of these to that of the next"""
    step_y: int


class Path(NamedTuple):
    """The cells of a window that a beam crosses."""

    line: Line
    first: int
    """The first cell of the line that lies in the window"""
    plain: int
    """The first that is not plain: before it, all cells get the same"""
    end: int
    """The one after the last that lies in the window"""
    end_row: int
    """The cell in which the beam ends"""
    end_col: int
    weight: int
    """How many times each of its cells gets what the model says"""
    range: float
    """On the map (lattice units); 0 where the model does not ask"""


@step
def place_beam(beams: Beams, s: int, b: int, radial: Tables | None, corner: Int64) -> Beam:
    """Place a beam of a scan in a window.

    Parameters
    ----------
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    """
    viewpoint = min(b, beams.origins.shape[1] - 1)
    r = depth = 0.0
    if radial is not None:
        r, depth = beams.ranges[s, b], radial.depth * beams.units_per_metre
    drawn, step_x, step_y = int(beams.between[s, b]), 0, 0
    if beams.steps.size:
        step_x, step_y = int(beams.steps[s, b, 0]), int(beams.steps[s, b, 1])
    return Beam(
        beams.origins[s, viewpoint, 0] - corner[0],
        beams.origins[s, viewpoint, 1] - corner[1],
        beams.ends_x[s, b] - corner[0],
        beams.ends_y[s, b] - corner[1],
        beams.rays.kind[s, b] == HIT,
        int(beams.weights[s, b]),
        r,
        depth,
        drawn,
        step_x,
        step_y,
    )


@step
def draw_path(beam: Beam, i: int, radial: Tables | None, shape: tuple[int, int]) -> Path:
    """Draw a beam where `i` is 0, or else the i-th of those between it and the next.

    Parameters
    ----------
    shape
        Rows and columns of the window.
    """
    x, y, to_x, to_y = beam.at_x, beam.at_y, beam.to_x, beam.to_y
    weight, r, begun = beam.weight, beam.range, 0.0
    if i:
        to_x, to_y = to_x + i * beam.step_x, to_y + i * beam.step_y
        x, y = begin_between(x, to_x), begin_between(y, to_y)
        weight = BETWEEN
        if radial is not None:
            length = np.hypot(float(to_x - beam.at_x), float(to_y - beam.at_y))
            r = max(length - beam.depth, 0.0)
            begun = BEGIN_EIGHTHS / 8 * length
    col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
    end_col, end_row = to_x >> CELL_SHIFT, to_y >> CELL_SHIFT
    line = draw_line(col, row, end_col, end_row)
    first, plain, end = 0, line.n + (not beam.is_hit), line.n + 1
    if radial is not None:
        reach = radial.plain * max(r - beam.depth, 0.0) - begun
        plain = count_nearer(line.n, line.m, reach / UNITS_PER_CELL - FARTHEST_CENTRE)
    if not lies_inside(col, row, end_col, end_row, shape[0], shape[1]):
        first, end = clip_line(line, shape[0], shape[1])
        plain = min(max(plain, first), end)
    return Path(line, first, plain, end, end_row, end_col, weight, r)


@step
def begin_between(at: int, to: int) -> int:
    """Find where a beam between two others begins on its way, along x or y."""
    return ((8 - BEGIN_EIGHTHS) * at + BEGIN_EIGHTHS * to) >> 3


@step
def count_nearer(n: int, m: int, reach: float) -> int:
    """How many of a line's first cells are nearer than `reach` (cells); the last never is."""
    return min(max(int(reach * n / np.sqrt(float(n * n + m * m))), 0), n) if n else 0
