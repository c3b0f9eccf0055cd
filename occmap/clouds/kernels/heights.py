"""Clouds as kernels take them, heights of their points in columns, and the peaks among these."""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.jit import kernel, step
from occmap.types import COLUMN_MM, Float32, Float64, Int32, Int64, PosedScans, UInt16
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
PIECE, HALF = (1 << PIECE_BITS) - 1, 1 << PIECE_BITS - 1
MOST_PIECES = 4096
"""Between more pieces of a column (1.3 km) there is no ground."""
ROOM = MOST_PIECES * BINS + 2 * AROUND + 2
"""Bins of a column, and of what is around it"""
EMPTY = -1
MOST_POINTS = 65535
"""More points of a bin are not counted: sums that end there are the same in any order"""
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
    """(3 N,) x, y and z of each (m)"""
    which: Int32
    """(N,) the pose of each point; empty: all have the first"""
    poses: Float64
    """(M, 3, 4) from the points' frame to the map"""
    origin: Float64
    """(3,) m, where the sensor was in the map"""


class Histogram(NamedTuple):
    """Counts of map heights: a hash table of pieces of columns with open addressing."""

    slots: Int32
    """(K,) `EMPTY`, or where a piece is counted; K is a power of two"""
    keys: Int64
    """(K / 2,) packed row, column and piece, as they were met"""
    counts: UInt16
    """(K / 2, 16) points in each of their bins, at most `MOST_POINTS`"""
    used: Int64
    """(1,) how many pieces there are"""


Tables: TypeAlias = tuple[Histogram, Histogram]
Room: TypeAlias = tuple[Float64, Int64]
"""(3, `SOME`) and (2, `SOME`) to work with"""


class Pieces(NamedTuple):
    """Pieces of columns, as they were counted."""

    column: Int32
    """(P,) where the column of each lies in flat arrays"""
    keys: Int64
    """(P,) as those of a histogram, in ascending order"""
    at: Int32
    """(P,) where each is counted"""
    counts: UInt16
    """(Q, 16) points in each bin, as those of a histogram"""


@step
def pack(row: int, col: int, piece: int) -> int:
    """One number for a piece of a column."""
    mask = WIDE - 1
    return ((((row & mask) << 21) | (col & mask)) << PIECE_BITS) | (piece + HALF)


@step
def find_piece(table: Histogram, key: int) -> int:
    """Where the piece with a key is counted, maybe from now on."""
    slots, keys, used = table.slots, table.keys, table.used
    # Folded, since a product's lower bits know nothing of a factor's upper ones: of the row.
    place = (((key ^ (key >> 31)) * -7046029254386353131) >> 32) & (slots.size - 1)
    while slots[place] != EMPTY and keys[slots[place]] != key:
        place = (place + 1) & (slots.size - 1)
    if slots[place] == EMPTY:
        slots[place], keys[used[0]] = used[0], key
        used[0] += 1
    at: int = slots[place]
    return at


@step
def place_point(cloud: Cloud, i: int) -> tuple[float, float, float]:
    """Say where a point lies in the map, by the pose that it has."""
    pose = cloud.poses[cloud.which[i] if cloud.which.size else 0]
    u, v, w = cloud.points[3 * i], cloud.points[3 * i + 1], cloud.points[3 * i + 2]
    x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
    y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
    z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
    return x, y, z


@kernel
def place_points(cloud: Cloud, start: int, place: Float64) -> int:
    """Fill `place` (3, `SOME`) with where points from `start` on lie in the map; return how many.

    x, y and z are NaN for no return.
    """
    # Cut out, and with one pose for all where they have one: so processors place several at once.
    poses, size = cloud.poses, min(SOME, cloud.points.size // 3 - start)
    flat = cloud.points[3 * start : 3 * (start + size)]
    xx, xy, xz, at_x = poses[0, 0, 0], poses[0, 0, 1], poses[0, 0, 2], poses[0, 0, 3]
    yx, yy, yz, at_y = poses[0, 1, 0], poses[0, 1, 1], poses[0, 1, 2], poses[0, 1, 3]
    zx, zy, zz, at_z = poses[0, 2, 0], poses[0, 2, 1], poses[0, 2, 2], poses[0, 2, 3]
    for i in range(size):
        u, v, w = float(flat[3 * i]), float(flat[3 * i + 1]), float(flat[3 * i + 2])
        apart = abs(u) + abs(v) + abs(w)
        u = u if apart > 0.0 and apart < FARTHEST_M else np.nan
        place[0, i] = xx * u + xy * v + xz * w + at_x
        place[1, i] = yx * u + yy * v + yz * w + at_y
        place[2, i] = zx * u + zy * v + zz * w + at_z
    for i in range(size if cloud.which.size else 0):
        if not np.isnan(place[0, i]):
            place[0, i], place[1, i], place[2, i] = place_point(cloud, start + i)
    return size


@kernel
def count_heights(
    cloud: Cloud, tables: Tables, start: int, nearest: tuple[float, float], room: Room
) -> int:
    """Count the heights of the points from `start` on; return where a table was full.

    Parameters
    ----------
    tables
        For what is far from the sensor, and for what is around it.
    nearest
        What lies nearer to the sensor, on the map, is not counted, or is around it (m).
    """
    (place, listed), (far, around) = room, tables
    while 3 * start < cloud.points.size:
        if max(far.used[0] - len(far.keys), around.used[0] - len(around.keys)) + SOME > 0:
            return start
        size = place_points(cloud, start, place)
        many, few = list_heights(place, size, cloud.origin, nearest, listed)
        count_listed(far, listed[:, :many])
        count_listed(around, listed[:, SOME - few :])
        start += size
    return start


@step
def count_listed(table: Histogram, listed: Int64) -> None:
    """Count points by their pieces of columns, and the bins of these."""
    # Loops of their own, so that a processor waits for many places in memory at once.
    for i in range(listed.shape[1]):
        listed[0, i] = find_piece(table, listed[0, i])
    for i in range(listed.shape[1]):
        points = int(table.counts[listed[0, i], listed[1, i]])
        table.counts[listed[0, i], listed[1, i]] = min(points + 1, MOST_POINTS)


@step
def round_mm(metres: float) -> int:
    """Round a length to whole millimetres."""
    return int(np.rint(metres * 1000))


@step
def list_heights(
    place: Float64, size: int, origin: Float64, nearest: tuple[float, float], listed: Int64
) -> tuple[int, int]:
    """List the pieces of columns, and the bins of these, in which points lie; return how many.

    Points around the sensor are listed from the end on.
    """
    many, few = 0, 0
    for i in range(size):
        x, y, z = place[0, i], place[1, i], place[2, i]
        away_x, away_y, rise = x - origin[0], y - origin[1], z - origin[2]
        distance = np.sqrt(away_x * away_x + away_y * away_y)
        reach = RISE * distance
        if nearest[0] <= distance < FAR_M and -DEEPEST_M - reach <= rise <= reach:
            row, col = round_mm(y) // COLUMN_MM, round_mm(x) // COLUMN_MM
            height = round_mm(z) // BIN_MM
            is_far = distance >= nearest[1]
            many, few = many + is_far, few + (not is_far)
            at = many - 1 if is_far else SOME - few
            listed[0, at] = pack(row, col, height >> 4)
            listed[1, at] = height & 15
    return many, few


@kernel
def add_histogram(other: Histogram, table: Histogram, start: int) -> int:
    """Add the pieces of columns from the one `start` on; return where the table was full."""
    many: int = other.used[0]
    for i in range(start, many):
        if table.used[0] == len(table.keys):
            return i
        here = find_piece(table, other.keys[i])
        for j in range(BINS):
            both = int(table.counts[here, j]) + int(other.counts[i, j])
            table.counts[here, j] = min(both, MOST_POINTS)
    return many


@kernel
def list_peaks(pieces: Pieces, bins: Int64, many: Int32, height: Int32, weight: Int32) -> int:
    """List the local peaks of columns, lowest first; return how many.

    A peak is three bins that hold more than those beside them, and at least 35% of the points
    within 20 cm: so a wall has none.

    Parameters
    ----------
    bins
        (`ROOM`,) to work with.
    many
        (C,) filled with how many peaks each column has.
    height, weight
        Filled with the height of each peak (mm), and its points.
    """
    keys, found, start, column = pieces.keys, 0, 0, 0
    while start < keys.size:
        before, stop = found, start
        first = last = keys[start] & PIECE
        while stop < keys.size and keys[stop] >> PIECE_BITS == keys[start] >> PIECE_BITS:
            last = keys[stop] & PIECE
            stop += 1
        size = (last - first + 1) * BINS
        if last - first < MOST_PIECES:
            for i in range(size + 2 * AROUND + 2):
                bins[i] = 0
            for i in range(start, stop):
                at = ((keys[i] & PIECE) - first) * BINS + AROUND
                for j in range(BINS):
                    bins[at + j] = pieces.counts[pieces.at[i], j]
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
                    shift = (bins[i + 1] - bins[i - 1]) * BIN_MM // here
                    height[found] = (bottom + i - AROUND) * BIN_MM + BIN_MM // 2 + shift
                    weight[found] = here
                    found += 1
                total += bins[i + AROUND + 1] - bins[i - AROUND]
        many[column] = found - before
        column += 1
        start = stop
    return found


@kernel
def count_apart(
    pieces: Pieces, height: Int32, limits: tuple[int, int, int], deep: Int32, standing: Int32
) -> None:
    """Count the points of columns that lie deep below their ground, and those that stand on it.

    Parameters
    ----------
    height
        (C,) of the ground (mm).
    limits
        Above the ground (mm): what lies below the first is deep, and what lies between the others
        stands on it.
    deep, standing
        (C,) the points are added.
    """
    for i in range(pieces.keys.size):
        at, counts = pieces.column[i], pieces.counts[pieces.at[i]]
        bottom = ((pieces.keys[i] & PIECE) - HALF) * BINS * BIN_MM - height[at]
        for j in range(BINS):
            above = bottom + j * BIN_MM
            deep[at] += counts[j] if above < limits[0] else 0
            standing[at] += counts[j] if limits[1] < above < limits[2] else 0


@kernel
def find_reach(points: Float32, centre: Float32) -> int:
    """How far points (3 N,) lie from a place in their frame (3,) at most, rounded up (m)."""
    farthest, (x, y, z) = np.int32(0), centre
    for i in range(points.size // 3):
        u, v, w = points[3 * i], points[3 * i + 1], points[3 * i + 2]
        apart, right, up, above = abs(u) + abs(v) + abs(w), u - x, v - y, w - z
        is_real = np.float32(0) < apart <= np.float32(FARTHEST_M)
        square = right * right + up * up + above * above if is_real else np.float32(0)
        # Whole metres, of which processors compare several at once.
        farthest = max(farthest, np.int32(np.sqrt(square)))
    return int(farthest) + 1


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
    """Bring points (N, 3) that may lie among other fields of a message side by side, (3 N,)."""
    if points.flags.carray:
        return points.reshape(-1)
    packed = np.empty((len(points), 1), "V12")  # three floats at once: 2 to 4 times as fast
    packed[:] = points.view("V12")
    return packed.view(np.float32).reshape(-1)


def find_moments(cloud: RecordedCloud, moments: int) -> Int32:
    """Find which of a cloud's poses each of its points has (N,); empty where there is one."""
    offset_ns = cloud.offset_ns
    if moments == 1 or offset_ns is None:
        return ALL_AT_ONCE
    start, stop = int(offset_ns.min()), int(offset_ns.max())
    scale = (moments - 1) / max(stop - start, 1)
    nearest: Int32 = np.rint((offset_ns - start) * scale).astype(np.int32)
    return nearest


def pose_points(cloud: Cloud, about: int) -> tuple[Float64, Float64]:
    """Take about so many points (N, 3) of a cloud, and the pose (N, 3, 4) of each."""
    points = cloud.points.reshape(-1, 3)
    every = max(len(points) // about, 1)
    with np.errstate(invalid="ignore"):  # where a log is damaged they are of any bits
        some = points[::every].astype(np.float64)
    if cloud.which.size:
        return some, cloud.poses[cloud.which[::every]]
    return some, np.broadcast_to(cloud.poses[0], (len(some), 3, 4))
