"""Heights of points, counted in columns, and the peaks among them."""

from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.types import Float32, Float64, Int32, Int64

COLUMN_MM = 150
"""Side of a column of the ground."""
BIN_MM = 20
"""Height of a bin of a column."""
BINS = 16
"""Bins of one entry: it holds a piece of a column."""
AROUND = 10
"""A peak is compared with so many bins on either side"""
PEAK_PERCENT = 35
WIDE = 1 << 20
"""Rows and columns of the ground are packed into 21 bits each."""
PIECE_BITS = 19
HALF = 1 << PIECE_BITS - 1
EMPTY = -1


class Cloud(NamedTuple):
    """Points and where they were measured from, as kernels take them."""

    points: Float32
    """(N, 3) m"""
    which: Int32
    """(N,) the pose of each point; empty: all have the first"""
    poses: Float64
    """(M, 3, 4) from the points' frame to the map"""
    origin: Float64
    """(3,) m, where the sensor was in the map"""


class Histogram(NamedTuple):
    """Counts of map heights: a hash table of pieces of columns with open addressing."""

    keys: Int64
    """(K,) `EMPTY` or a packed row, column and piece; K is a power of two"""
    counts: Int32
    """(K, 16) points in each bin"""
    used: Int64
    """(1,) how many keys are not empty"""


class Near(NamedTuple):
    """Which points tell of the ground."""

    least: float
    """From this distance on, along the ground (m)"""
    near: float
    """Up to here they count in the first layer, beyond it in the second (m)"""
    far: float
    """Up to here (m)"""
    rise: float
    """No ground lies higher above the sensor, as a share of the distance"""
    deepest: float
    """None lies farther below it, beside the same share (m)"""


@step
def pack(layer: int, row: int, col: int, piece: int) -> int:
    """One number for a piece of a column."""
    return (((((row + WIDE) << 21) | (col + WIDE)) << PIECE_BITS) | (piece + HALF)) << 1 | layer


@step
def find_place(keys: Int64, key: int) -> int:
    """Where a key is in the table, or where it belongs."""
    mask = keys.size - 1
    place = ((key * -7046029254386353131) >> 20) & mask
    while keys[place] != EMPTY and keys[place] != key:
        place = (place + 1) & mask
    return place


@kernel
def count_heights(cloud: Cloud, limits: Near, table: Histogram, start: int) -> int:
    """Count the heights of the points from `start` on; return where the table was full."""
    points, which, poses, origin = cloud
    keys, counts, used = table
    most = keys.size // 2
    last_row, last_col, last_piece, last_layer, place = 0, 0, 0, -1, 0
    for i in range(start, len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not (abs(u) + abs(v) + abs(w) > 0.0 and abs(u) + abs(v) + abs(w) < 1e6):
            continue
        pose = poses[which[i] if which.size else 0]
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
        distance = np.hypot(x - origin[0], y - origin[1])
        reach = limits.rise * distance
        rise = z - origin[2]
        if not (limits.least <= distance < limits.far):
            continue
        if rise > reach or rise < -limits.deepest - reach:
            continue
        layer = 0 if distance < limits.near else 1
        row, col = int(np.rint(y * 1000)) // COLUMN_MM, int(np.rint(x * 1000)) // COLUMN_MM
        height = int(np.rint(z * 1000)) // BIN_MM
        piece = height >> 4
        if row != last_row or col != last_col or piece != last_piece or layer != last_layer:
            key = pack(layer, row, col, piece)
            place = find_place(keys, key)
            if keys[place] == EMPTY:
                if used[0] >= most:
                    return i
                keys[place] = key
                used[0] += 1
            last_row, last_col, last_piece, last_layer = row, col, piece, layer
        counts[place, height & 15] += 1
    return len(points)


@kernel
def add_histogram(keys: Int64, counts: Int32, table: Histogram) -> None:
    """Add pieces of columns to a table that has room for all of them."""
    for i in range(keys.size):
        if keys[i] != EMPTY:
            place = find_place(table.keys, keys[i])
            if table.keys[place] == EMPTY:
                table.keys[place] = keys[i]
                table.used[0] += 1
            for j in range(BINS):
                table.counts[place, j] += counts[i, j]


@kernel
def list_peaks(keys: Int64, counts: Int32, column: Int64, height: Int32, weight: Int32) -> int:
    """List the local peaks of columns, lowest first; return how many.

    A peak is three bins that hold more than those beside them, and at least 35% of the points
    within 20 cm: so a wall has none.

    Parameters
    ----------
    keys, counts
        Pieces in ascending order of their keys, all of one layer.
    column, height
        Filled with the packed column of each peak, and its height (mm).
    """
    found, start = 0, 0
    while start < keys.size:
        stop = start + 1
        while stop < keys.size and keys[stop] >> 20 == keys[start] >> 20:
            stop += 1
        first = (keys[start] >> 1) & ((1 << PIECE_BITS) - 1)
        last = (keys[stop - 1] >> 1) & ((1 << PIECE_BITS) - 1)
        if last - first < 4096:
            size = (last - first + 1) * BINS
            bins = np.zeros(size + 2 * AROUND + 2, np.int64)
            for i in range(start, stop):
                at = (((keys[i] >> 1) & ((1 << PIECE_BITS) - 1)) - first) * BINS + AROUND
                for j in range(BINS):
                    bins[at + j] = counts[i, j]
            bottom = (first - HALF) * BINS
            total = 0
            for i in range(2 * AROUND + 1):
                total += bins[i]
            for i in range(AROUND, AROUND + size):
                here = bins[i - 1] + bins[i] + bins[i + 1]
                # The middle counts twice, so that a bin alone stands above those beside it.
                if (
                    bins[i] > 0
                    and here + bins[i] > bins[i - 2] + 2 * bins[i - 1] + bins[i]
                    and here + bins[i] >= bins[i] + 2 * bins[i + 1] + bins[i + 2]
                    and here * 100 >= total * PEAK_PERCENT
                ):
                    column[found] = keys[start] >> 20
                    shift = (bins[i + 1] - bins[i - 1]) * BIN_MM // here
                    height[found] = (bottom + i - AROUND) * BIN_MM + BIN_MM // 2 + shift
                    weight[found] = here
                    found += 1
                total += bins[i + AROUND + 1] - bins[i - AROUND]
        start = stop
    return found


@kernel
def find_reach(cloud: Cloud) -> float:
    """How far the farthest point is, from the sensor or from the points' own zero (m)."""
    points, _, poses, origin = cloud
    farthest = 0.0
    for i in range(len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        square = u * u + v * v + w * w
        if square < 1e12:
            farthest = max(farthest, square)
    away = 0.0
    for axis in range(3):
        away += (poses[0, axis, 3] - origin[axis]) ** 2
    reach: float = np.sqrt(farthest) + np.sqrt(away)
    return reach
