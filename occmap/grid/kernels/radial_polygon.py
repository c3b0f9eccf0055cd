"""The polygon update of a radial sensor model: what a scan says about each cell it covers, once.

A cell at distance d gets what the model says of d and the range of the beam that covers the cell's
bearing.

Clipped at p_min, such a model says the same about all cells up to some share of the range. These
are added as spans, as in `polygon`; only the cells beyond are visited. Thousands of them are
listed, and go through one short loop after the other: where a loop has no branch, a processor works
on several cells at once.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.fill import Spans, fill_outline, find_rows, make_outline, make_spans
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.sectors import (
    BEARINGS,
    ROUNDED,
    bearing_of,
    cover_bearings,
    find_sectors,
    make_sectors,
    outline_sectors,
    reach_out,
    stay_inside,
)
from occmap.grid.kernels.units import (
    AT_A_TIME,
    CELL_SHIFT,
    FIRST_HIT,
    HALF_CELL,
    HIT,
    MANY,
    NOTHING,
    PAD,
    TABLE_STEPS,
    Tables,
)
from occmap.jit import kernel
from occmap.types import Float64, Int32, Int64


class View(NamedTuple):
    """One scan: which of its beams covers which bearing, and what that says about a cell."""

    at: tuple[int, int]
    """x and y of the sensor, from the window's corner (lattice units)"""
    covering: Int32
    """(BEARINGS + 1,) the beam that covers each step of a turn"""
    limits: Float64
    """(2 B + 2,) a pair for each beam, and one for what no beam covers. A squared distance times
    the first is a place in the table of free cells; the second is where a hit lies, if any, or
    -inf"""
    depth: float
    """How far about the range a hit reaches (lattice units)"""
    entries: Int64
    """Those of `Tables`"""


class Listed(NamedTuple):
    """Cells to visit, each (N,): room for `MANY`, and for one more row."""

    rows: Int32
    cols: Int32
    places: Int32
    """Which of the steps of a turn a cell lies in, and then which of the entries it gets"""
    limits: Float64
    """(2 N,) those of the beam that covers the cell"""


@kernel
def trace_radial_polygons(
    beams: Beams, corner: Int64, tables: Tables, cells: Int64, runs: Int32
) -> None:
    """Add what every scan says about each cell that it covers, once.

    A cell belongs to the beam that covers its bearing: a beam covers the bearings that are nearer
    to it than to its neighbours, at most 60 degrees to either side, and as much beyond the first
    and the last.

    Parameters
    ----------
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    cells
        (H, W + PAD) sums of the entries of the cells that were visited.
    runs
        H x (W + PAD), flat: changes along rows of how often a cell got the first entry of `free`.
    """
    scans, count = beams.rays.kind.shape
    rows, cols = cells.shape[0], cells.shape[1] - PAD
    depth = tables.depth * beams.units_per_metre
    sectors, covering = make_sectors(count), np.empty(BEARINGS + 1, np.int32)
    limits, within = np.empty(2 * count + 2), np.empty(count)
    limits[2 * count], limits[2 * count + 1] = np.inf, -np.inf
    room = MANY + cells.shape[1] + AT_A_TIME
    places = np.empty((3, room), np.int32)
    listed = Listed(places[0], places[1], places[2], np.empty(2 * room))
    outline, outer, inner = make_outline(4 * count + 4), make_spans(rows), make_spans(rows)
    for s in range(scans):
        ranges, kinds = beams.ranges[s], beams.rays.kind[s]
        at_x, at_y = beams.origins[s, 0, 0] - corner[0], beams.origins[s, 0, 1] - corner[1]
        sign = find_sectors(beams, s, sectors)
        side_by_side = cover_bearings(sectors, kinds, sign, covering)
        reach_out(beams, s, depth, sectors)
        corners = outline_sectors(at_x, at_y, sectors, outline)
        touched = find_rows(outline.y, corners, rows)
        outer = fill_outline(outline, corners, touched, cols, outer)
        for b in range(count):
            limits[2 * b] = TABLE_STEPS / max(ranges[b] - depth, 0.0) ** 2
            limits[2 * b + 1] = ranges[b] if kinds[b] == HIT else -np.inf
            within[b] = max(tables.plain * (ranges[b] - depth) * (1 - 1e-6) - ROUNDED, 0.0)
        inner.counts[:] = 0
        if side_by_side:
            stay_inside(within, sign, sectors)
            corners = outline_sectors(at_x, at_y, sectors, outline)
            inner = fill_outline(outline, corners, touched, cols, inner)
        view = View((at_x, at_y), covering, limits, depth, tables.entries)
        _observe_spans(view, touched, outer, inner, listed, cells, runs)


@kernel
def _observe_spans(
    view: View,
    touched: tuple[int, int],
    outer: Spans,
    inner: Spans,
    listed: Listed,
    cells: Int64,
    runs: Int32,
) -> None:
    """Add one scan's inner spans, and what beams say about the other cells of its spans."""
    stride, size = cells.shape[1], 0
    rows, cols = listed.rows, listed.cols
    for r in range(touched[0], touched[1]):
        row = np.uint64(r)
        n, inner_end = inner.starts[row], inner.starts[row] + inner.counts[row]
        beyond = np.int64(0)  # an inner span may bridge a gap between two others
        for i in range(outer.starts[row], outer.starts[row] + outer.counts[row], 2):
            col = max(np.int64(outer.limits[np.uint64(i)]), beyond)
            end = np.int64(outer.limits[np.uint64(i + 1)])
            while col < end:
                until, beyond = end, end
                if n < inner_end and inner.limits[np.uint64(n)] < end:
                    until = np.int64(inner.limits[np.uint64(n)])
                    beyond = np.int64(inner.limits[np.uint64(n + 1)])
                    runs[np.uint64(r * stride + until)] += 1
                    runs[np.uint64(r * stride + beyond)] -= 1
                    n += 2
                for j in range((until - col + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
                    k = np.uint64(size + j)
                    rows[k], cols[k] = r, col + j
                size += max(int(until - col), 0)
                col = max(col, beyond)
        if size >= MANY or r == touched[1] - 1:
            _observe_cells(view, listed, size, cells)
            size = 0


@kernel
def _observe_cells(view: View, listed: Listed, size: int, cells: Int64) -> None:
    """Add to each of the listed cells what the beam that covers its bearing says about it."""
    (at_x, at_y), covering, entries = view.at, view.covering, view.entries
    rows, cols, places, limits = listed.rows, listed.cols, listed.places, listed.limits
    stride, flat = cells.shape[1], cells.reshape(-1)
    steps, first_hit, nothing = float(TABLE_STEPS), float(FIRST_HIT), float(NOTHING)
    to_steps = steps / view.depth
    two, one = np.uint64(2), np.uint64(1)
    for i in range(size):
        k = np.uint64(i)
        x = float((np.int64(cols[k]) << CELL_SHIFT) + HALF_CELL - at_x)
        y = float((np.int64(rows[k]) << CELL_SHIFT) + HALF_CELL - at_y)
        places[k] = bearing_of(x, y)
    for i in range(size):
        k = np.uint64(i)
        b = np.uint64(covering[np.uint64(places[k])])
        limits[two * k], limits[two * k + one] = view.limits[two * b], view.limits[two * b + one]
    for i in range(size):
        k = np.uint64(i)
        x = float((np.int64(cols[k]) << CELL_SHIFT) + HALF_CELL - at_x)
        y = float((np.int64(rows[k]) << CELL_SHIFT) + HALF_CELL - at_y)
        squared = x * x + y * y
        as_free = squared * limits[two * k]
        off = abs(np.sqrt(squared) - limits[two * k + one]) * to_steps
        as_hit = first_hit + off if off <= steps else nothing
        places[k] = np.int32(as_free if as_free < steps else as_hit)
        rows[k] = rows[k] * stride + cols[k]  # from here on its place in the window
    for i in range(size):
        k = np.uint64(i)
        flat[np.uint64(rows[k])] += entries[np.uint64(places[k])]
