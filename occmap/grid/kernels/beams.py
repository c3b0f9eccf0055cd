"""The beam and the surface update: every beam adds evidence to each cell along its line.

A beam is a line from the sensor's cell to its end. A cell at distance d on a beam of range r gets
what the inverse sensor model says of d and r, and log-odds are summed (Thrun, Burgard, Fox 2005,
ch. 9). A model says the same about all cells up to some share of the range, and a model that counts
does so up to the end: these cells are plain. Where a window is crossed often, plain cells are added
in runs instead of being visited (`lines`).

For a model that counts, `note_beams` adds each beam at once. For all else a scan is traced in
steps: `list_lines` draws its beams, and the functions of `visits` go through these lines.
"""

from typing import NamedTuple

import numpy as np

from occmap.arrays import Bool, Float64, Int64
from occmap.grid.kernels.lines import clip_line, draw_line, lies_inside, note_line
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.sums import Changes
from occmap.grid.kernels.units import (
    BETWEEN,
    CELL_SHIFT,
    HIT,
    MOST_BETWEEN,
    PAD,
    SKIP,
    UNITS_PER_CELL,
    Tables,
)
from occmap.jit import kernel, step

FARTHEST_CENTRE = 1.25
"""Cells by which a cell's centre may be farther from the sensor than its place on the line: half a
diagonal at the first cell, and half a cell beside the line."""
BEGIN_EIGHTHS = 5
"""A beam between two others is drawn from so many eighths of its way on."""


class Lines(NamedTuple):
    """The lines of one scan: those of its beams, and of the beams drawn between them."""

    cells: Int64
    """(N, 4) column and row of the first cell, and of the last"""
    parts: Int64
    """(N, 3) the first cell in the window, the first that is not plain, the one after the last"""
    weights: Int64
    """(N,) what each line counts"""
    is_hit: Bool
    """(N,)"""
    sensors: Int64
    """(N, 2) x and y of the sensor from the window's corner (units)"""
    ranges: Float64
    """(N,) of the beams on the map (units); 0 where the model does not ask"""


@step
def begin_between(at: int, to: int) -> int:
    """Find where a beam between two others begins on its way, along x or y (lattice units)."""
    return ((8 - BEGIN_EIGHTHS) * at + BEGIN_EIGHTHS * to) >> 3


@kernel
def note_beams(beams: Beams, hit: int, corner: Int64, cells: Int64, changes: Changes) -> None:
    """Add the hits and misses of every beam, and of those drawn between it and the next.

    All cells but the end are plain, so none of them is visited. This is a tenth quicker than to
    list the lines first.

    Parameters
    ----------
    hit
        What the end cell of a HIT beam gets.
    cells
        (H, W + PAD) sums of what visited cells got: here the ends.
    """
    origins, ends_x, ends_y, kinds = beams.origins, beams.ends_x, beams.ends_y, beams.rays.kind
    weights, between = beams.weights, beams.between
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    rows, cols = cells.shape[0], cells.shape[1] - PAD
    scans, count = kinds.shape
    viewpoints = origins.shape[1]
    for s in range(scans):
        for b in range(count):
            if kinds[s, b] == SKIP:
                continue
            k = b if viewpoints > 1 else 0
            at_x, at_y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
            x, y = at_x, at_y
            to_x, to_y = ends_x[s, b] - corner[0], ends_y[s, b] - corner[1]
            weight = np.int64(weights[s, b])
            parts, step_x, step_y = np.int64(between[s, b]) + 1, np.int64(0), np.int64(0)
            for part in range(1, parts + 1):  # the beam itself, then those between it and the next
                col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
                end_col, end_row = to_x >> CELL_SHIFT, to_y >> CELL_SHIFT
                line = draw_line(col, row, end_col, end_row)
                first, end = 0, line.n + 1
                if not lies_inside(col, row, end_col, end_row, rows, cols):
                    first, end = clip_line(line, rows, cols)
                if kinds[s, b] == HIT and end == line.n + 1:
                    end = line.n
                    if first <= end:
                        cells[np.uint64(end_row), np.uint64(end_col)] += weight * hit
                if first < end:
                    if line.steep:
                        note_line(line, first, end, col_runs, col_steps, rows + PAD, int(weight))
                    else:
                        note_line(line, first, end, row_runs, row_steps, cols + PAD, int(weight))
                if part < parts:
                    if part == 1:
                        c = b + 1 if b + 1 < count else 0
                        step_x = np.int64(ends_x[s, c] - ends_x[s, b]) // parts
                        step_y = np.int64(ends_y[s, c] - ends_y[s, b]) // parts
                    to_x, to_y = to_x + step_x, to_y + step_y
                    x, y = begin_between(at_x, to_x), begin_between(at_y, to_y)
                    weight = np.int64(BETWEEN)


@kernel
def make_lines(count: int) -> Lines:
    """Room for the lines of a scan of so many beams."""
    most = count * (MOST_BETWEEN + 1)
    return Lines(
        np.empty((most, 4), np.int64),
        np.empty((most, 3), np.int64),
        np.empty(most, np.int64),
        np.empty(most, np.bool_),
        np.empty((most, 2), np.int64),
        np.empty(most),
    )


@kernel
def list_lines(
    beams: Beams, s: int, tables: Tables, corner: Int64, rows: int, cols: int, lines: Lines
) -> int:
    """Draw the beams of a scan and those between them; return how many lines cross the window.

    Parameters
    ----------
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    lines
        Written here.
    """
    origins, ends_x, ends_y, kinds = beams.origins, beams.ends_x, beams.ends_y, beams.rays.kind
    ranges, weights, between = beams.ranges, beams.weights, beams.between
    radial, depth = tables.hit.size > 1, tables.depth * beams.units_per_metre
    count, viewpoints = kinds.shape[1], origins.shape[1]
    size = 0
    for b in range(count):
        if kinds[s, b] == SKIP:
            continue
        k = b if viewpoints > 1 else 0
        at_x, at_y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
        x, y = at_x, at_y
        to_x, to_y = ends_x[s, b] - corner[0], ends_y[s, b] - corner[1]
        r = ranges[s, b] if radial else 0.0
        begun = 0.0
        weight = np.int64(weights[s, b])
        drawn, step_x, step_y = np.int64(between[s, b]), np.int64(0), np.int64(0)
        if drawn:
            c = b + 1 if b + 1 < count else 0
            step_x = np.int64(ends_x[s, c] - ends_x[s, b]) // (drawn + 1)
            step_y = np.int64(ends_y[s, c] - ends_y[s, b]) // (drawn + 1)
        for part in range(drawn + 1):  # the beam itself, then those between it and the next
            col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
            end_col, end_row = to_x >> CELL_SHIFT, to_y >> CELL_SHIFT
            line = draw_line(col, row, end_col, end_row)
            first, end = 0, line.n + 1
            if not lies_inside(col, row, end_col, end_row, rows, cols):
                first, end = clip_line(line, rows, cols)
            plain = line.n + (kinds[s, b] != HIT)
            if radial:
                reach = tables.plain * max(r - depth, 0.0) - begun
                plain = count_nearer(line.n, line.m, reach / UNITS_PER_CELL - FARTHEST_CENTRE)
            if first < end:
                at = np.uint64(size)
                lines.cells[at, 0], lines.cells[at, 1] = col, row
                lines.cells[at, 2], lines.cells[at, 3] = end_col, end_row
                lines.parts[at, 0], lines.parts[at, 2] = first, end
                lines.parts[at, 1] = min(max(plain, first), end)
                lines.weights[at], lines.is_hit[at] = weight, kinds[s, b] == HIT
                lines.sensors[at, 0], lines.sensors[at, 1], lines.ranges[at] = at_x, at_y, r
                size += 1
            if part < drawn:
                to_x, to_y = to_x + step_x, to_y + step_y
                x, y = begin_between(at_x, to_x), begin_between(at_y, to_y)
                weight = np.int64(BETWEEN)
                if radial:
                    span = np.hypot(float(to_x - at_x), float(to_y - at_y))
                    r, begun = max(span - depth, 0.0), BEGIN_EIGHTHS / 8 * span
    return size


@step
def count_nearer(n: int, m: int, reach: float) -> int:
    """How many of a line's first cells are nearer than `reach` (cells); the last never is."""
    return min(max(int(reach * n / np.sqrt(float(n * n + m * m))), 0), n) if n else 0


@kernel
def note_lines(lines: Lines, size: int, rows: int, cols: int, changes: Changes) -> None:
    """Add the plain cells of lines, as changes."""
    cells, parts, weights = lines.cells, lines.parts, lines.weights
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    for k in range(size):
        first, end, weight = parts[k, 0], parts[k, 1], int(weights[k])
        if first < end:
            line = draw_line(cells[k, 0], cells[k, 1], cells[k, 2], cells[k, 3])
            if line.steep:
                note_line(line, first, end, col_runs, col_steps, rows + PAD, weight)
            else:
                note_line(line, first, end, row_runs, row_steps, cols + PAD, weight)
