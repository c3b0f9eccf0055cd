"""The polygon update of a radial sensor model: what a scan says about each cell it covers, once.

A cell at distance d is told what the model says of d and the range of the beam that covers the
cell's bearing.

Clipped at p_min, such a model says the same about all cells up to some share of the range. These
are noted as spans, as in `polygon`; only the cells beyond are visited. They are listed, and then
many go through one short step after the other: where a step has no branch, a processor works on
several cells at once.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.beams import Profile
from occmap.grid.kernels.fill import fill_outline, find_rows
from occmap.grid.kernels.project import round_to_units
from occmap.grid.kernels.sectors import (
    BEARINGS,
    COS_60,
    bearing_of,
    cover_bearings,
    find_sectors,
    outline_sectors,
    stay_inside,
)
from occmap.grid.kernels.units import CELL_SHIFT, HALF_CELL, HIT, NO_LENGTH, PAD
from occmap.jit import kernel
from occmap.types import Float32, Float64, Int32, Int64, UInt8

ROUNDED = 4
"""Lattice units by which corners may lie farther out than the sectors that they are made for."""
MANY = 2048
"""Cells are visited when so many are listed: loops are long, and the lists fit the cache."""


class Listed(NamedTuple):
    """Cells to visit, each (N,): room for `MANY` and for those of one more row."""

    rows: Int32
    cols: Int32
    places: Int32
    """Which of the steps of a turn a cell lies in, and then which of the entries it gets"""
    scale: Float64
    """Of the beam that covers the cell, as `limit_ranges` writes it"""
    hit_range: Float64
    """Likewise"""


@kernel
def trace_radial_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    full_circle: bool,
    corner: Int64,
    units_per_metre: float,
    profile: Profile,
    cells: Int64,
    runs: Int32,
) -> None:
    """Add what every scan says about each cell that it covers, once.

    A cell belongs to the beam that covers its bearing: a beam covers the bearings that are nearer
    to it than to its neighbours, at most 60 degrees to either side, and as much beyond the first
    and the last.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, 1, 2), (S, K, 2, 2), (2, B), (S, B), (S, B) as in `Rays`.
    corner
        (2,) x and y of the window's corner in lattice units.
    cells
        (H, W + PAD) sums of the entries of the cells that were visited.
    runs
        H x (W + PAD), flat: changes along rows of how often a cell got the first entry of `free`.
    """
    scans, beams = kinds.shape
    rows, cols = cells.shape[0], cells.shape[1] - PAD
    free, hit, depth, plain = profile.free, profile.hit, profile.depth, profile.plain
    direction, ranges = np.empty((beams, 2), np.float64), np.empty(beams, np.float64)
    sides = np.empty((beams, 4), np.float64)
    covers, shares_side = np.empty(beams, np.bool_), np.empty(beams, np.bool_)
    lengths, covering = np.empty((beams, 4), np.float64), np.empty(BEARINGS + 1, np.int32)
    scale, hit_range = np.empty(beams + 1, np.float64), np.empty(beams + 1, np.float64)
    within, room = np.empty(beams, np.float64), MANY + cells.shape[1]
    listed = Listed(
        np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int32),
        np.empty(room, np.float64), np.empty(room, np.float64),
    )  # fmt: skip
    entries = np.concatenate((free[:-1], np.zeros(1, np.int64), hit))
    x, y = np.empty(4 * beams + 4, np.int64), np.empty(4 * beams + 4, np.int64)
    begins = np.empty(4 * beams + 4, np.bool_)
    starts, counts = np.empty(rows, np.int32), np.empty(rows, np.int32)
    inner_starts, inner_counts = np.empty(rows, np.int32), np.empty(rows, np.int32)
    found = np.empty((2, 4 * rows), np.int32)
    spans, inner = np.empty(4 * rows, np.int32), np.empty(4 * rows, np.int32)
    for s in range(scans):
        at_x = round_to_units(origin[s, 0, 0], units_per_metre) - corner[0]
        at_y = round_to_units(origin[s, 0, 1], units_per_metre) - corner[1]
        aim(turn[s], bearing, distance[s], units_per_metre, direction, ranges)
        sign = find_sectors(direction, kinds[s], full_circle, sides, covers, shares_side)
        side_by_side = cover_bearings(sides, kinds[s], covers, sign, covering)
        reach_out(direction, ranges, kinds[s], full_circle, depth, sides, lengths)
        corners = outline_sectors(at_x, at_y, sides, lengths, covers, shares_side, x, y, begins)
        touched = find_rows(y, corners, rows)
        found, spans = fill_outline(
            x, y, begins, corners, touched, cols, starts, counts, found, spans
        )
        inner_counts[:] = 0
        if side_by_side:
            for b in range(beams):
                within[b] = max(plain * (ranges[b] - depth) * (1 - 1e-6) - ROUNDED, 0.0)
            stay_inside(within, sides, sign, shares_side, lengths)
            corners = outline_sectors(at_x, at_y, sides, lengths, covers, shares_side, x, y, begins)
            found, inner = fill_outline(
                x, y, begins, corners, touched, cols, inner_starts, inner_counts, found, inner
            )
        limit_ranges(ranges, kinds[s], depth, free.size - 1, scale, hit_range)
        _observe_spans(
            at_x, at_y, touched, starts, counts, spans, inner_starts, inner_counts, inner,
            covering, scale, hit_range, depth, entries, listed, cells, runs,
        )  # fmt: skip


@kernel
def aim(
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    units_per_metre: float,
    direction: Float64,
    ranges: Float64,
) -> None:
    """Write one scan's unit vectors (B, 2) and ranges (B,) in the map plane (lattice units)."""
    for b in range(distance.size):
        t = min(b, turn.shape[0] - 1)
        x = turn[t, 0, 0] * bearing[0, b] + turn[t, 0, 1] * bearing[1, b]
        y = turn[t, 1, 0] * bearing[0, b] + turn[t, 1, 1] * bearing[1, b]
        length = max(np.sqrt(x * x + y * y), NO_LENGTH)
        direction[b, 0], direction[b, 1] = x / length, y / length
        ranges[b] = distance[b] * length * units_per_metre


@kernel
def reach_out(
    direction: Float64,
    ranges: Float64,
    kinds: UInt8,
    full_circle: bool,
    depth: float,
    sides: Float64,
    lengths: Float64,
) -> None:
    """Write how far sectors must go so that nothing that a beam speaks of is left out.

    To the tangent at the outermost circle, and a little more for rounding. A side lies at most 60
    degrees from its beam, but for a beam straight up, which has none.
    """
    for b in range(kinds.size):
        reach = ranges[b] + (depth if kinds[b] == HIT else 0.0) + ROUNDED
        for side in range(2):
            cosine = sides[b, 2 * side] * direction[b, 0] + sides[b, 2 * side + 1] * direction[b, 1]
            lengths[b, 2 * side] = reach / max(cosine, COS_60 / 2)
            lengths[b, 2 * side + 1] = 0.0
    for b in range(0 if full_circle else 1, kinds.size):
        lengths[b - 1, 2] = lengths[b, 0] = max(lengths[b - 1, 2], lengths[b, 0])


@kernel
def limit_ranges(
    ranges: Float64, kinds: UInt8, depth: float, steps: int, scale: Float64, hit_range: Float64
) -> None:
    """Write, for each beam, where the entries for free cells end and where its hit lies.

    A squared distance times `scale` (B + 1,) is a place in the table of free cells, which has
    `steps` places. `hit_range` (B + 1,) is -inf for a beam that hit nothing. The last of both is
    nobody's: what no beam covers gets nothing.
    """
    for b in range(kinds.size):
        scale[b] = steps / max(ranges[b] - depth, 0.0) ** 2
        hit_range[b] = ranges[b] if kinds[b] == HIT else -np.inf
    scale[kinds.size], hit_range[kinds.size] = np.inf, -np.inf


@kernel
def _observe_spans(
    at_x: int,
    at_y: int,
    touched: tuple[int, int],
    starts: Int32,
    counts: Int32,
    spans: Int32,
    inner_starts: Int32,
    inner_counts: Int32,
    inner: Int32,
    covering: Int32,
    scale: Float64,
    hit_range: Float64,
    depth: float,
    entries: Int64,
    listed: Listed,
    cells: Int64,
    runs: Int32,
) -> None:
    """Note one scan's inner spans, and add what beams say about the other cells of its spans."""
    stride, size = cells.shape[1], 0
    rows, cols = listed.rows, listed.cols
    for r in range(touched[0], touched[1]):
        row = np.uint64(r)
        n, inner_end = inner_starts[row], inner_starts[row] + inner_counts[row]
        beyond = np.int64(0)  # an inner span may bridge a gap between two others
        for i in range(starts[row], starts[row] + counts[row], 2):
            col, end = max(np.int64(spans[np.uint64(i)]), beyond), np.int64(spans[np.uint64(i + 1)])
            while col < end:
                until, beyond = end, end
                if n < inner_end and inner[np.uint64(n)] < end:
                    until = np.int64(inner[np.uint64(n)])
                    beyond = np.int64(inner[np.uint64(n + 1)])
                    runs[np.uint64(r * stride + until)] += 1
                    runs[np.uint64(r * stride + beyond)] -= 1
                    n += 2
                for c in range(col, until):
                    k = np.uint64(size + c - col)
                    rows[k], cols[k] = r, c
                size += max(int(until - col), 0)
                col = beyond
        if size >= MANY or r == touched[1] - 1:
            _observe_cells(
                at_x, at_y, listed, size, covering, scale, hit_range, depth, entries, cells
            )
            size = 0


@kernel
def _observe_cells(
    at_x: int,
    at_y: int,
    listed: Listed,
    size: int,
    covering: Int32,
    scale: Float64,
    hit_range: Float64,
    depth: float,
    entries: Int64,
    cells: Int64,
) -> None:
    """Add to each of the listed cells what the beam that covers its bearing says about it.

    `entries` holds the table of free cells, a 0 for nothing, and the table of hits.
    """
    rows, cols, places = listed.rows, listed.cols, listed.places
    stride, flat = cells.shape[1], cells.reshape(-1)
    steps = float(entries.size // 2 - 1)
    to_steps, hits_from = steps / depth, steps + 1
    for i in range(size):
        k = np.uint64(i)
        x = float((np.int64(cols[k]) << CELL_SHIFT) + HALF_CELL - at_x)
        y = float((np.int64(rows[k]) << CELL_SHIFT) + HALF_CELL - at_y)
        places[k] = bearing_of(x, y)
    for i in range(size):
        k = np.uint64(i)
        b = np.uint64(covering[np.uint64(places[k])])
        listed.scale[k], listed.hit_range[k] = scale[b], hit_range[b]
    for i in range(size):
        k = np.uint64(i)
        x = float((np.int64(cols[k]) << CELL_SHIFT) + HALF_CELL - at_x)
        y = float((np.int64(rows[k]) << CELL_SHIFT) + HALF_CELL - at_y)
        squared = x * x + y * y
        as_free = squared * listed.scale[k]
        off = abs(np.sqrt(squared) - listed.hit_range[k]) * to_steps
        as_hit = hits_from + off if off <= steps else steps
        places[k] = np.int32(as_free if as_free < steps else as_hit)
        rows[k] = rows[k] * stride + cols[k]  # from here on its place in the window
    for i in range(size):
        k = np.uint64(i)
        flat[np.uint64(rows[k])] += entries[np.uint64(places[k])]
