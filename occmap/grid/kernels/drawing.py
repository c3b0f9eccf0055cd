"""A beam on the cells of a window: the line that it crosses, and how far the model is sure of it.

In the surface update, beams are also drawn between two neighbours that meet one surface, as the
module `projection` says; a drawn beam has no measured range, so its range follows from its end.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.lines import Line, clip_line, draw_line, lies_inside
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.units import BETWEEN, CELL_SHIFT, HIT, UNITS_PER_CELL, Tables
from occmap.jit import step
from occmap.types import Int64

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
