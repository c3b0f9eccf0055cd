"""Clouds as kernels take them, heights of their points in columns, and the peaks among these."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occmap.jit import array_kernel, step
from occmap.types import COLUMN_MM, Float32, Float64, Int32, Int64, PosedScans
from occmap.types import Cloud as RecordedCloud

BIN_MM = 20
"""Height of a bin of a column."""
BINS = 16
"""Bins of one entry: it holds a piece of a column."""
AROUND = 10
"""A peak is compared with so many bins on either side"""
PEAK_PERCENT = 35
WIDE = 1 << 21
"""Rows and columns of the ground are packed modulo this: a drive is less than 314 km wide, wherever
in the world it is."""
PIECE_BITS = 20
HALF = 1 << PIECE_BITS - 1
EMPTY = -1
SOME = 512
"""Points that are placed at once"""
FAR_M = 60.0
"""Farther away poses that are off by tenths of a degree tell nothing of the ground"""
RISE, DEEPEST_M = 0.3, 3.0
"""No ground lies higher above the sensor than this share of the distance, or farther below it
beside the same share"""
FARTHEST_M = 1e5
"""Points farther away are none"""


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


@step
def pack(row: int, col: int, piece: int) -> int:
    """One number for a piece of a column."""
    mask = WIDE - 1
    return ((((row & mask) << 21) | (col & mask)) << PIECE_BITS) | (piece + HALF)


@step
def find_place(keys: Int64, key: int) -> int:
    """Where a key is in the table, or where it belongs."""
    mask = keys.size - 1
    # Folded, since a product's lower bits know nothing of a factor's upper ones: of the row.
    place = (((key ^ (key >> 31)) * -7046029254386353131) >> 32) & mask
    while keys[place] != EMPTY and keys[place] != key:
        place = (place + 1) & mask
    return place


@array_kernel
def place_points(cloud: Cloud, start: int, x: Float64, y: Float64, z: Float64) -> None:
    """Fill x, y and z (N,) with where points from `start` on lie in the map, NaN for no return."""
    # Flat, and with one pose for all where they have one: so processors place several at once.
    flat = cloud.points.reshape(-1)[3 * start : 3 * (start + len(x))]
    which, poses = cloud.which[start : start + len(x)], cloud.poses
    one = poses[0].copy()
    for i in range(len(x)):
        u, v, w = float(flat[3 * i]), float(flat[3 * i + 1]), float(flat[3 * i + 2])
        size = abs(u) + abs(v) + abs(w)
        u = u if size > 0.0 and size < FARTHEST_M else np.nan
        x[i] = one[0, 0] * u + one[0, 1] * v + one[0, 2] * w + one[0, 3]
        y[i] = one[1, 0] * u + one[1, 1] * v + one[1, 2] * w + one[1, 3]
        z[i] = one[2, 0] * u + one[2, 1] * v + one[2, 2] * w + one[2, 3]
    for i in range(len(which)):
        k, u, v, w = which[i], float(flat[3 * i]), float(flat[3 * i + 1]), float(flat[3 * i + 2])
        if not np.isnan(x[i]):
            x[i] = poses[k, 0, 0] * u + poses[k, 0, 1] * v + poses[k, 0, 2] * w + poses[k, 0, 3]
            y[i] = poses[k, 1, 0] * u + poses[k, 1, 1] * v + poses[k, 1, 2] * w + poses[k, 1, 3]
            z[i] = poses[k, 2, 0] * u + poses[k, 2, 1] * v + poses[k, 2, 2] * w + poses[k, 2, 3]


@array_kernel
def count_heights(cloud: Cloud, table: Histogram, start: int) -> int:
    """Count the heights of the points from `start` on; return where the table was full."""
    keys, counts, used = table
    x, y, z = np.empty(SOME), np.empty(SOME), np.empty(SOME)
    key, bins = np.empty(SOME, np.int64), np.empty(SOME, np.int64)
    while start < len(cloud.points):
        size = min(SOME, len(cloud.points) - start)
        if 2 * (used[0] + size) > keys.size:
            return start
        place_points(cloud, start, x[:size], y[:size], z[:size])
        many = list_heights(x[:size], y[:size], z[:size], cloud.origin, key, bins)
        # Loops of their own, so that a processor waits for many places in memory at once.
        for i in range(many):
            place = find_place(keys, key[i])
            used[0] += keys[place] == EMPTY
            keys[place] = key[i]
            key[i] = place
        for i in range(many):
            counts[key[i], bins[i]] += 1
        start += size
    return start


@step
def round_mm(metres: float) -> int:
    """Round a length to whole millimetres."""
    return int(np.rint(metres * 1000))


@step
def list_heights(
    x: Float64, y: Float64, z: Float64, origin: Float64, key: Int64, bins: Int64
) -> int:
    """List the pieces of columns, and the bins of these, in which points lie; return how many."""
    many = 0
    for i in range(len(x)):
        away_x, away_y, rise = x[i] - origin[0], y[i] - origin[1], z[i] - origin[2]
        distance = np.sqrt(away_x * away_x + away_y * away_y)
        reach = RISE * distance
        if distance < FAR_M and -DEEPEST_M - reach <= rise <= reach:
            row, col = round_mm(y[i]) // COLUMN_MM, round_mm(x[i]) // COLUMN_MM
            height = round_mm(z[i]) // BIN_MM
            key[many] = pack(row, col, height >> 4)
            bins[many] = height & 15
            many += 1
    return many


@array_kernel
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


@array_kernel
def list_peaks(keys: Int64, counts: Int32, column: Int64, height: Int32, weight: Int32) -> int:
    """List the local peaks of columns, lowest first; return how many.

    A peak is three bins that hold more than those beside them, and at least 35% of the points
    within 20 cm: so a wall has none.

    Parameters
    ----------
    keys, counts
        Pieces in ascending order of their keys.
    column, height
        Filled with the packed column of each peak, and its height (mm).
    """
    found, start = 0, 0
    while start < keys.size:
        stop = start + 1
        while stop < keys.size and keys[stop] >> 20 == keys[start] >> 20:
            stop += 1
        first = keys[start] & ((1 << PIECE_BITS) - 1)
        last = keys[stop - 1] & ((1 << PIECE_BITS) - 1)
        if last - first < 4096:
            size = (last - first + 1) * BINS
            bins = np.zeros(size + 2 * AROUND + 2, np.int64)
            for i in range(start, stop):
                at = ((keys[i] & ((1 << PIECE_BITS) - 1)) - first) * BINS + AROUND
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


@array_kernel
def find_reach(cloud: Cloud) -> float:
    """How far no point is, from the sensor or from the points' own zero (m)."""
    points, _, poses, origin = cloud
    flat, farthest = points.reshape(-1), np.int32(0)
    for i in range(len(points)):
        u, v, w = flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]
        square = u * u + v * v + w * w
        # Whole metres, of which processors compare several at once.
        square = square if square < np.float32(FARTHEST_M**2) else np.float32(0)
        farthest = max(farthest, np.int32(np.sqrt(square)))
    away = 0.0
    for axis in range(3):
        away += (poses[0, axis, 3] - origin[axis]) ** 2
    return farthest + 1 + float(np.sqrt(away))


ALL_AT_ONCE = np.zeros(0, np.int32)
"""All points of a cloud have one pose."""


def list_clouds(posed: PosedScans) -> Iterator[Cloud]:
    """List clouds with their poses, one for each cloud or several over its time."""
    place = np.concatenate(
        [posed.rotation, posed.position[..., None]], axis=-1
    )  # (S, 3, 4) or (S, M, 3, 4)
    if place.ndim == 3:
        place = place[:, None]
    middle = place[:, place.shape[1] // 2, :, 3]
    origins = np.ascontiguousarray(middle if posed.origin is None else posed.origin)
    for cloud, poses, origin in zip(posed.batch.clouds or (), place, origins, strict=True):
        yield Cloud(pack_points(cloud.points), find_moments(cloud, len(poses)), poses, origin)


def pack_points(points: Float32) -> Float32:
    """Bring points (N, 3) that may lie among other fields of a message side by side."""
    if points.flags.carray:
        return points
    packed = np.empty((len(points), 1), "V12")  # three floats at once: 2 to 4 times as fast
    packed[:] = points.view("V12")
    return packed.view(np.float32)


def find_moments(cloud: RecordedCloud, moments: int) -> Int32:
    """Find which of a cloud's poses each of its points has (N,); empty where there is one."""
    offset_ns = cloud.offset_ns
    if moments == 1 or offset_ns is None:
        return ALL_AT_ONCE
    start, stop = int(offset_ns.min()), int(offset_ns.max())
    scale = (moments - 1) / max(stop - start, 1)
    nearest: Int32 = np.rint((offset_ns - start) * scale).astype(np.int32)
    return nearest
