"""The polygon update of a radial sensor model: what a scan says about each cell it covers, once.

A cell at distance d is told what the model says of d and the range of the beam that covers the
cell's bearing.

Clipped at p_min, such a model says the same about all cells up to some share of the range. These
are noted as spans, as in `polygon`; only the cells beyond are visited.
"""

import numpy as np

from occmap.grid.kernels.beams import Profile
from occmap.grid.kernels.fill import fill_outline, find_rows
from occmap.grid.kernels.project import round_to_units
from occmap.grid.kernels.sectors import (
    BEARINGS,
    COS_60,
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
NEAR, FAR, SCALE, RANGE = range(4)
"""Columns of what `limit_ranges` writes."""


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
    limits, within = np.empty((beams + 1, 4), np.float64), np.empty(beams, np.float64)
    entries = np.concatenate((free, hit, np.zeros(1, np.int64)))
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
        limit_ranges(ranges, kinds[s], depth, free.size - 1, limits)
        _observe_spans(
            at_x, at_y, touched, starts, counts, spans, inner_starts, inner_counts, inner,
            covering, limits, depth, entries, cells, runs,
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
def limit_ranges(ranges: Float64, kinds: UInt8, depth: float, steps: int, limits: Float64) -> None:
    """Write, for each beam, up to which squared distance it speaks of free cells and of its hit.

    The last row of `limits` (B + 1, 4) is nobody's: what no beam covers, index -1, gets nothing.
    """
    for b in range(kinds.size):
        before = max(ranges[b] - depth, 0.0)
        limits[b, NEAR] = before * before
        limits[b, FAR] = (ranges[b] + depth) ** 2 if kinds[b] == HIT else -1.0
        limits[b, SCALE] = steps / max(before * before, 1.0)
        limits[b, RANGE] = ranges[b]
    limits[kinds.size] = -1.0


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
    limits: Float64,
    depth: float,
    entries: Int64,
    cells: Int64,
    runs: Int32,
) -> None:
    """Note one scan's inner spans, and add what beams say about the other cells of its spans.

    `entries` holds the tables of free cells and of hits, one behind the other, and a last 0.
    """
    stride = cells.shape[1]
    steps = float(entries.size // 2 - 1)
    hits_from, nothing, to_steps = steps + 1, 2 * steps + 2, steps / depth
    for r in range(touched[0], touched[1]):
        row = np.uint64(r)
        from_y = float((r << CELL_SHIFT) + HALF_CELL - at_y)
        start, turned = (1.0, -1.0) if from_y >= 0 else (3.0, 1.0)
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
                    from_x = float((c << CELL_SHIFT) + HALF_CELL - at_x)
                    # As `bearing_of`, whose choice by the sign of y is the same for a whole row.
                    part = from_x / max(abs(from_x) + abs(from_y), NO_LENGTH)
                    b = covering[np.uint64((start + turned * part) * (BEARINGS / 4))]
                    squared = from_x * from_x + from_y * from_y
                    # Both places, then a choice without a branch: whether a cell lies before, in or
                    # behind a hit cannot be guessed.
                    off = abs(np.sqrt(squared) - limits[b, RANGE]) * to_steps
                    as_hit, as_free = hits_from + min(off, steps), squared * limits[b, SCALE]
                    is_free, is_hit = squared < limits[b, NEAR], squared <= limits[b, FAR]
                    place = as_free if is_free else (as_hit if is_hit else nothing)
                    cells[row, np.uint64(c)] += entries[np.uint64(place)]
                col = beyond
