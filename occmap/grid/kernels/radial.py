"""Updates for inverse sensor models that look at the distance from the sensor, such as Elfes'.

A model comes as two tables of log-odds: `free` over (d / (r - depth))^2, for cells well before the
range r, and `hit` over |d - r| / depth, for cells about it. So no cell costs a logarithm, and a
free one not even a square root. A table entry holds the log-odds in fixed point above the lowest
20 bits, and an observation, 1, in those: one addition to a cell counts both.
"""

import numpy as np

from occmap.grid.kernels.arrays import Int32
from occmap.grid.kernels.fill import cross_rows, make_spans
from occmap.grid.kernels.jit import kernel
from occmap.grid.kernels.project import round_to_units
from occmap.grid.kernels.sectors import (
    BEARINGS,
    bearing_of,
    cover_bearings,
    find_sectors,
    outline_sectors,
)
from occmap.types import Float32, Float64, Int64, UInt8

COUNT_BITS = 20
"""A window cell counts fewer than 2^20 observations before it must be emptied."""


@kernel
def trace_radial_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    full_circle: bool,
    units_per_metre: float,
    depth: float,
    corner: Int64,
    free: Int64,
    hit: Int64,
    cells: Int64,
) -> None:
    """Add what every scan says about each cell that it covers, once.

    A cell belongs to the beam that covers its bearing: a beam covers the bearings that are nearer
    to it than to its neighbours, and as much beyond the first and the last.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, 1, 2), (S, K, 2, 2), (B, 2), (S, B), (S, B) as in `Rays`.
    depth
        m
    corner
        (2,) x and y of the window's corner in lattice units.
    free, hit
        (T + 1,) tables of a model.
    cells
        (H, W) sums.
    """
    scans, beams = kinds.shape
    rows, cols = cells.shape
    direction, ranges = np.empty((beams, 2), np.float64), np.empty(beams, np.float64)
    x, y = np.empty(4 * beams + 4, np.int64), np.empty(4 * beams + 4, np.int64)
    begins = np.empty(4 * beams + 4, np.bool_)
    sectors, covers = np.empty((beams, 2, 2), np.float64), np.empty(beams, np.bool_)
    covering = np.empty(BEARINGS + 1, np.int32)
    buckets, counts = np.empty((rows, 32), np.int32), np.empty(rows, np.int64)
    for s in range(scans):
        _aim(turn[s], bearing, distance[s], direction, ranges)
        sign = find_sectors(direction, kinds[s], full_circle, sectors, covers)
        cover_bearings(sectors, covers, sign, covering)
        corners = outline_sectors(
            origin[s, 0], direction, ranges, kinds[s], units_per_metre, depth, corner, sectors,
            covers, x, y, begins,
        )  # fmt: skip
        while not cross_rows(x, y, begins, corners, buckets, counts):
            buckets = np.empty((rows, 2 * buckets.shape[1]), np.int32)
        make_spans(buckets, counts, cols)
        at_x = round_to_units(origin[s, 0, 0], units_per_metre) - corner[0]
        at_y = round_to_units(origin[s, 0, 1], units_per_metre) - corner[1]
        ranges *= units_per_metre
        for row in range(rows):
            for i in range(0, counts[row], 2):
                span = (np.int64(buckets[row, i]), np.int64(buckets[row, i + 1]))
                _observe_span(
                    (at_x, at_y, row), span, covering, ranges, kinds[s], depth * units_per_metre,
                    free, hit, cells,
                )  # fmt: skip


@kernel
def _aim(
    turn: Float64, bearing: Float64, distance: Float32, direction: Float64, ranges: Float64
) -> None:
    """Write one scan's unit vectors (B, 2) and ranges (B,) in the map plane (m)."""
    for b in range(distance.size):
        t = min(b, turn.shape[0] - 1)
        x = turn[t, 0, 0] * bearing[b, 0] + turn[t, 0, 1] * bearing[b, 1]
        y = turn[t, 1, 0] * bearing[b, 0] + turn[t, 1, 1] * bearing[b, 1]
        length = max(np.sqrt(x * x + y * y), 1e-300)
        direction[b, 0], direction[b, 1], ranges[b] = x / length, y / length, distance[b] * length


@kernel
def _observe_span(
    at: tuple[int, int, int],
    span: tuple[np.int64, np.int64],
    covering: Int32,
    ranges: Float64,
    kinds: UInt8,
    depth: float,
    free: Int64,
    hit: Int64,
    cells: Int64,
) -> None:
    """Add what the covering beams say about the cells of one span of a row.

    `at` is the sensor's x and y in lattice units and the row; `ranges`, `depth` are in these units.
    """
    x, y, row = at
    steps = free.size - 1
    from_y = float((row << 8) + 128 - y)
    for col in range(span[0], span[1]):
        from_x = float((col << 8) + 128 - x)
        b = covering[np.uint64(bearing_of(from_x, from_y))]
        if b < 0:
            continue
        squared = from_x * from_x + from_y * from_y
        until = max(ranges[b] - depth, 0.0) ** 2
        if squared < until:
            cells[np.uint64(row), np.uint64(col)] += free[np.uint64(squared / until * steps)]
        elif kinds[b] == 2:
            off = abs(np.sqrt(squared) - ranges[b])
            if off <= depth:
                cells[np.uint64(row), np.uint64(col)] += hit[np.uint64(off / depth * steps)]
