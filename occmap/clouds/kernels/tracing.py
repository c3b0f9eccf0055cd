"""Hits and misses of cells, cloud by cloud, over the ground."""

from typing import NamedTuple

import numpy as np

from occmap.clouds.kernels import growth
from occmap.clouds.kernels.growth import BLOCK, STEPPED, Blocks, find_column, find_under, locate
from occmap.clouds.kernels.heights import SOME, Cloud, place_points
from occmap.clouds.kernels.laying import Columns, ground_at
from occmap.grid.kernels.units import CELL_SHIFT, NEAR_WEIGHT, UNITS_PER_CELL
from occmap.jit import kernel, step
from occmap.types import (
    BLOCK_BITS,
    COLUMN_MM,
    NO_GROUND,
    Float32,
    Float64,
    Int16,
    Int32,
    Int64,
    UInt8,
)

LOW, HIT, UNKNOWN, HIGH = 1, 2, 4, 8
"""Bits of a cell in one cloud: what looks at it is a beam `LOW` over its ground, or a `HIGH` one;
`UNKNOWN`, which stays, is that it has no ground."""
FAR_WEIGHT = NEAR_WEIGHT // 4
"""What a cloud weighs in cells far away, and in those that only high beams look at"""
LOW_SHARE = 5 / 8
"""Beams that pass over a cell higher than this share of the robot's height say little of it"""
SECTORS_OF_QUARTER = 180
SECTORS = 4 * SECTORS_OF_QUARTER
"""Bearings of the map: equal widths in x / (|x| + |y|), half a degree on average."""
GROUND, OBSTACLE, ABOVE, BELOW, TOO_FAR, NO_RETURN = range(6)
"""Places in the counts of points."""
COUNTS = 6
DEEP = 1.5
"""What lies so many times the clearance below the floor shows a drop"""
NEAR_M = 8.0
"""Poses that are off move what is seen from farther away by more than the clearance, and beams are
farther apart there than things are thick: such a look weighs less"""
FAR = -(1 << 31) + 1
"""The height of what is too far away"""
NOTHING = 1 << 62
"""Farther than anything is"""
END_BITS, HALF_END = 32, 1 << 31
"""Bits of the column in which a bearing ends, which may be negative"""
PACE, WALL, AHEAD, BACK = 0.5, 3, 12, 20
"""A ray into a drop is followed in such steps (columns), from three before its end, where it may
have met the wall on the other side, but at most 12 beyond the floor, to 20 before that"""
RIM = 4 / 3
"""So many steps before the end of the floor is its rim: poses that are off blur it"""
RING_M, RINGS = 1.0, 64
"""How wide the rings around the sensor are, by which beams are told that end nearer than a cell;
the last one is all that is farther away"""
NOBODY_LOOKED = -2
CELLS, INSIDE, HIGHEST = BLOCK * BLOCK, BLOCK - 1, 1 << 30
"""Cells of a tile; the mask of a row or column inside one; higher than all ground"""


class Canvas(NamedTuple):
    """What the second pass writes to, tile by tile."""

    columns: Columns
    tiles: Blocks
    """Where cells lie in flat arrays, tile by tile, as columns do in blocks; the number of a tile
    is -1 where it is without ground, and `NOBODY_LOOKED` where that is not known"""
    base: Int32
    """(T,) height of the tile (mm)"""
    ground: Int16
    """(4096 T,) height of the ground over that of the tile (mm)"""
    state: UInt8
    """(4096 T,) what the cloud at hand says"""
    counts: Int32
    """(2 * 4096 T,) hits of all cells of a tile, and then their misses"""
    used: Int64
    """(1,) how many tiles have a place"""
    points: Int64
    """(6,) how many points were of each kind"""
    resolution: float
    """Side of a cell (m)"""


@kernel
def lay_ground(canvas: Canvas, box: Int64, heights: Int32) -> None:
    """Give the tiles of a box that have ground a place, of which there must be enough.

    Parameters
    ----------
    box
        (4,) the rows and columns of tiles from which and to which it goes, from the canvas' corner.
    heights
        (4096,) to work with.
    """
    (table, corner, places), resolution = canvas.tiles, canvas.resolution
    blocks = canvas.columns.blocks
    for up in range(box[0], box[2]):
        for right in range(box[1], box[3]):
            if table[up, right] != NOBODY_LOOKED:
                continue
            lowest, tile = HIGHEST, canvas.used[0]
            for i in range(CELLS):
                row = ((corner[0] + up) << BLOCK_BITS) + (i >> BLOCK_BITS)
                col = ((corner[1] + right) << BLOCK_BITS) + (i & INSIDE)
                x, y = (col + 0.5) * resolution, (row + 0.5) * resolution
                heights[i] = ground_at(canvas.columns, find_under(blocks, x, y), x, y)
                if heights[i] != NO_GROUND:
                    lowest = min(lowest, heights[i])
            if lowest == HIGHEST:
                table[up, right] = -1
                continue
            canvas.used[0] += 1
            table[up, right], canvas.base[tile] = tile, lowest
            places[tile, 0], places[tile, 1] = corner[0] + up, corner[1] + right
            for i in range(CELLS):
                if heights[i] == NO_GROUND:
                    canvas.state[tile * CELLS + i] = UNKNOWN
                else:
                    canvas.ground[tile * CELLS + i] = min(heights[i] - lowest, 32767)


class Band(NamedTuple):
    """Which heights above the ground are obstacles."""

    low: int
    """From here on (mm)"""
    high: int
    """Below here (mm)"""
    margin: float
    """By how much the lower end rises with each metre beyond `level` (mm)"""
    level: float
    """Up to this distance it does not (m)"""
    nearest: float
    """Points nearer to the sensor than this are the robot's own (m)"""
    farthest: float
    """Points farther away are not used (m)"""


@kernel
def widen(edges: Float64, cloud: Cloud, band: Band, columns: Columns, place: Float64) -> None:
    """Widen a box by the points of a cloud that observe their cells, as obstacles or as floor.

    Parameters
    ----------
    edges
        (4,) lowest x and y, highest x and y (m), changed in place.
    place
        (3, `SOME`) to work with.
    """
    least, most = band.nearest * band.nearest, band.farthest * band.farthest
    for start in range(0, cloud.points.size // 3, SOME):
        for i in range(place_points(cloud, start, place)):
            x, y = place[0, i], place[1, i]
            square = (x - cloud.origin[0]) ** 2 + (y - cloud.origin[1]) ** 2
            if not least <= square < most:
                continue
            ground = ground_at(columns, find_under(columns.blocks, x, y), x, y)
            above = place[2, i] * 1000 - ground
            clear = band.low + band.margin * max(np.sqrt(square) - band.level, 0.0)
            if ground != NO_GROUND and (abs(above) < band.low or clear <= above < band.high):
                edges[0], edges[1] = min(edges[0], x), min(edges[1], y)
                edges[2], edges[3] = max(edges[2], x), max(edges[3], y)


class Aside(NamedTuple):
    """Some points of a cloud, seen from its sensor; so few that they stay in a core's cache."""

    place: Float64
    """(3, `SOME`) m in the map, NaN where nothing came back; all others are (`SOME`,)"""
    right: Int32
    up: Int32
    """Lattice units from the sensor; both 0 beyond the distances that count"""
    apart: Float64
    """How far away it is (lattice units)"""
    sector: Int32
    """The bearing"""
    ring: Int32
    level: Int32
    """Height in the map (mm), or `FAR`"""
    clear: Float64
    """From which height above the ground on it is an obstacle (mm)"""


class Room(NamedTuple):
    """What a cloud is worked out in."""

    some: Aside
    apart: Int64
    """(2, `SECTORS`) of each bearing, how far the farthest floor is (less than 0), and how far the
    nearest hit"""
    ends: Int64
    """(2, `SECTORS`) in which cells: rows from the sensor's times 2^32, and columns"""
    steep: Float64
    """(`SECTORS`,) how steeply the hit is seen"""
    lowest: Float32
    """(`RINGS`, `SECTORS`) slope of the lowest beam that ends there (mm for each lattice unit)"""
    floor: Int32
    """(N,) the cell of each floor point, which waits for all hits, and from the end on that of each
    hit by a high beam, under which a low one may pass"""
    floor_apart: Int64
    floor_steep: Float64
    floor_bearing: Int16
    """(N,) each: how far it is, and how and where it is seen"""
    touched: Int32
    """(M,) room for the places of cells, and one more"""


def make_room(points: int, cells: int) -> Room:
    """Make room for clouds of so many points, and for so many cells."""
    right, up, sector, ring, level = np.empty((5, SOME), np.int32)
    far, clear = np.empty((2, SOME))
    some = Aside(np.empty((3, SOME)), right, up, far, sector, ring, level, clear)
    apart, ends = np.empty((2, 2, SECTORS), np.int64)
    seen = np.empty(points, np.int32), np.empty(points, np.int64), np.empty(points)
    bearing, touched = np.empty(points, np.int16), np.empty(cells + 1, np.int32)
    steep, lowest = np.empty(SECTORS), np.empty((RINGS, SECTORS), np.float32)
    return Room(some, apart, ends, steep, lowest, *seen, bearing, touched)


@kernel
def measure_points(some: Aside, size: int, origin: Float64, band: Band, scale: float) -> None:
    """Find out what points are seen from their sensor; one loop that processors run in lanes."""
    least, most = band.nearest * band.nearest, band.farthest * band.farthest
    at_x, at_y = np.rint(origin[0] * scale), np.rint(origin[1] * scale)
    rings = 1 / (RING_M * scale)
    for i in range(size):
        x, y, z = some.place[0, i], some.place[1, i], some.place[2, i]
        away_x, away_y = x - origin[0], y - origin[1]
        square = away_x * away_x + away_y * away_y
        is_used = least <= square < most
        right = np.rint(x * scale) - at_x if is_used else 0.0
        up = np.rint(y * scale) - at_y if is_used else 0.0
        # No quotient of whole numbers as small as these is rounded to a whole one.
        part = np.floor(right * SECTORS_OF_QUARTER / max(abs(right) + abs(up), 1.0))
        sector = SECTORS_OF_QUARTER - part if up >= 0 else 3 * SECTORS_OF_QUARTER + part
        apart = np.sqrt(right * right + up * up)
        some.right[i], some.up[i], some.apart[i] = np.int32(right), np.int32(up), apart
        some.ring[i] = np.int32(min(apart * rings, RINGS - 1.0))
        some.sector[i] = np.int32(sector if sector < SECTORS else 0.0)
        some.level[i] = np.int32(np.rint(z * 1000) if is_used else FAR)
        some.clear[i] = band.low + band.margin * max(np.sqrt(square) - band.level, 0.0)


@kernel
def trace_cloud(cloud: Cloud, band: Band, canvas: Canvas, room: Room) -> None:
    """Observe the cells of one cloud, each once: a hit before a miss."""
    scale = UNITS_PER_CELL / canvas.resolution
    row = int(np.rint(cloud.origin[1] * scale)) >> CELL_SHIFT
    col = int(np.rint(cloud.origin[0] * scale)) >> CELL_SHIFT
    under = find_floor(canvas, row, col, -HIGHEST)
    many, floors, highs = find_ends(cloud, band, canvas, room, under)
    many = free_floor(canvas, room, floors, many)
    look_under(cloud.origin[2] * 1000, band.high, canvas, room, highs)
    many = clear_bearings((row, col), cloud.origin[2] * 1000, band.high, canvas, room, many)
    count_looks((row, col), canvas, room.touched, many)


@step
def free_floor(canvas: Canvas, room: Room, floors: int, many: int) -> int:
    """Mark the cells of floor points that are free; return how many cells are touched."""
    state, apart = canvas.state, room.apart
    for i in range(floors):
        at, bearing, far = room.floor[i], room.floor_bearing[i], room.floor_apart[i]
        # Floor behind the nearest hit is free if it is seen over that, and not beneath it.
        is_behind = far > apart[OBSTACLE, bearing]
        is_beneath = is_behind and room.floor_steep[i] < room.steep[bearing]
        if state[at] == 0 and not is_beneath:
            room.touched[many] = at
            many += 1
            state[at] = LOW
    return many


@step
def look_under(level: float, high: int, canvas: Canvas, room: Room, highs: int) -> None:
    """Find the lowest beam that reaches each ring, and whether low ones pass under high hits."""
    lowest, rings = room.lowest, canvas.resolution / (UNITS_PER_CELL * RING_M)
    for ring in range(RINGS - 2, -1, -1):
        for bearing in range(SECTORS):
            lowest[ring, bearing] = min(lowest[ring, bearing], lowest[ring + 1, bearing])
    for i in range(1, highs + 1):
        at, apart = room.floor[-i], np.sqrt(float(room.floor_apart[-i]))
        slope = lowest[min(int(apart * rings), RINGS - 1), room.floor_bearing[-i]]
        above = level + slope * apart - canvas.base[at >> 2 * BLOCK_BITS] - canvas.ground[at]
        canvas.state[at] |= LOW if above < LOW_SHARE * high else 0


@step
def clear_bearings(
    start: tuple[int, int], level: float, high: int, canvas: Canvas, room: Room, many: int
) -> int:
    """Mark the cells up to the end of each bearing, seen from a height (mm).

    Returns how many are touched.
    """
    for bearing in range(SECTORS):
        kind = OBSTACLE if room.apart[OBSTACLE, bearing] < NOTHING else GROUND
        far, end = room.apart[kind, bearing], room.ends[kind, bearing]
        if far < NOTHING:
            up = (end + HALF_END) >> END_BITS
            right = end - (up << END_BITS)
            beams = level, high, room.lowest[:, bearing]
            many = clear_line(start, (up, right), beams, canvas, room.touched, many)
    return many


@step
def count_looks(start: tuple[int, int], canvas: Canvas, touched: Int32, many: int) -> None:
    """Count what the cloud says of the cells that it touched, and forget it."""
    state, near = canvas.state, NEAR_M / canvas.resolution
    for i in range(many):
        at = touched[i]
        tile, inside = at >> 2 * BLOCK_BITS, at & (CELLS - 1)
        row, col = locate(canvas.tiles, at)
        up, right = row - start[0], col - start[1]
        is_near = up * up + right * right < near * near
        weight = NEAR_WEIGHT if is_near and state[at] & LOW else FAR_WEIGHT
        layer = 2 * tile + (0 if state[at] & HIT else 1)
        canvas.counts[layer * CELLS + inside] += weight
        state[at] = 0


@step
def find_floor(canvas: Canvas, row: int, col: int, other: int) -> int:
    """The height of the ground of a cell (mm), or another one where it has none."""
    at = find_column(canvas.tiles, row, col)
    if at < 0 or canvas.state[at] & UNKNOWN:
        return other
    level: int = canvas.base[at >> 2 * BLOCK_BITS] + canvas.ground[at]
    return level


@step
def find_rim(
    columns: Columns, start: tuple[int, int, float], away: tuple[int, int], below: tuple[int, float]
) -> tuple[int, int]:
    """Follow a ray that ends below the floor back to where the floor ends that it went through.

    Where floor was measured there, or behind it, that floor mirrors.

    Parameters
    ----------
    start
        Lattice units of the sensor, and in how many a column is wide.
    away
        Lattice units right and up to the end of the ray.
    below
        The height of the floor (mm), and at which share of its way the ray went through it.

    Returns
    -------
    Lattice units right and up to the last floor; both 0 where there is no drop.
    """
    (x, y, width), (right, up), (floor, share) = start, away, below
    pace = PACE * width / np.sqrt(float(right * right + up * up))
    ahead = min(max(int((1 - share) / pace) - WALL, 0), AHEAD)
    for k in range(-ahead, BACK + 1):
        here = share - k * pace
        along, across = np.floor(y + up * here), np.floor(x + right * here)
        row, col = int(np.floor(along / width)), int(np.floor(across / width))
        at = find_column(columns.blocks, row, col)
        if here < 2 * pace:
            break
        if at >= 0 and columns.measured[at]:
            if k <= 0 or abs(columns.height[at] - floor) > growth.STEP_MM:
                break
            here -= RIM * pace
            return int(np.floor(right * here)), int(np.floor(up * here))
    return 0, 0


@kernel
def mark_drops(
    size: int, under: int, origin: Float64, canvas: Canvas, room: Room, many: int
) -> int:
    """Mark the last floor before points that lie deep below it; return how many are touched."""
    some, state, scale = room.some, canvas.state, UNITS_PER_CELL / canvas.resolution
    at_x, at_y = int(np.rint(origin[0] * scale)), int(np.rint(origin[1] * scale))
    start = at_x, at_y, COLUMN_MM * scale / 1000
    for i in range(size):
        level = some.level[i]
        if level == FAR or level >= origin[2] * 1000:
            continue
        row, col = (at_y + some.up[i]) >> CELL_SHIFT, (at_x + some.right[i]) >> CELL_SHIFT
        floor = find_floor(canvas, row, col, under)
        rise = floor - origin[2] * 1000
        if level - floor > -DEEP * some.clear[i] or rise >= 0:
            continue
        share = rise / (level - origin[2] * 1000)
        away = int(some.right[i]), int(some.up[i])
        right, up = find_rim(canvas.columns, start, away, (floor, share))
        row, col = (at_y + up) >> CELL_SHIFT, (at_x + right) >> CELL_SHIFT
        at = find_column(canvas.tiles, row, col)
        if (right == 0 and up == 0) or at < 0 or state[at] & UNKNOWN:
            continue
        room.touched[many] = at
        many += state[at] == 0
        state[at] |= HIT | LOW
        far = right * right + up * up
        end = ((row - (at_y >> CELL_SHIFT)) << END_BITS) + col - (at_x >> CELL_SHIFT)
        apart = np.sqrt(float(far))
        note_end(room, OBSTACLE, some.sector[i], far, rise / apart, end)
        ring = min(int(apart / (RING_M * scale)), RINGS - 1)
        note_beam(room, ring, some.sector[i], rise / apart)
    return many


@step
def is_face(columns: Columns, some: Aside, i: int, high: int) -> bool:
    """Whether a point below the ground stands on ground beside it, as the face of a step does.

    The column that it lies in may have the ground above the step, which is seen more often.
    """
    across, along = some.place[0, i] * 1000 / COLUMN_MM, some.place[1, i] * 1000 / COLUMN_MM
    row, col = int(np.floor(along)), int(np.floor(across))
    for up in range(-STEPPED, STEPPED + 1):
        for right in range(-STEPPED, STEPPED + 1):
            at = find_column(columns.blocks, row + up, col + right)
            is_ground = at >= 0 and columns.measured[at]
            if is_ground and some.clear[i] <= some.level[i] - columns.height[at] < high:
                return True
    return False


@step
def note_end(room: Room, kind: int, bearing: int, far: int, slope: float, end: int) -> None:
    """Keep what a bearing ends at: the nearest hit, or the farthest floor."""
    key, known = far if kind else -far, room.apart[kind, bearing]
    if kind and key <= known:
        room.steep[bearing] = slope if key < known else max(slope, room.steep[bearing])
    if key < known or (key == known and end < room.ends[kind, bearing]):
        room.apart[kind, bearing], room.ends[kind, bearing] = key, end


@step
def note_beam(room: Room, ring: int, bearing: int, slope: float) -> None:
    """Keep the lowest beam that ends in a ring."""
    room.lowest[ring, bearing] = min(room.lowest[ring, bearing], slope)


@kernel
def find_ends(
    cloud: Cloud, band: Band, canvas: Canvas, room: Room, under: int
) -> tuple[int, int, int]:
    """Mark the cells of hits, and find what the beams of each bearing end at.

    Returns how many cells are touched, and how many points are floor, and hits of high beams.
    """
    some, right, up, level = room.some, room.some.right, room.some.up, room.some.level
    origin, state, ground, counts = cloud.origin, canvas.state, canvas.ground, canvas.points
    scale = UNITS_PER_CELL / canvas.resolution
    at_x, at_y = int(np.rint(origin[0] * scale)), int(np.rint(origin[1] * scale))
    room.apart[:], room.lowest[:] = NOTHING, np.inf
    many, floors, highs = 0, 0, 0
    for start in range(0, cloud.points.size // 3, SOME):
        size = place_points(cloud, start, some.place)
        measure_points(some, size, origin, band, scale)
        deep = 0
        for i in range(size):
            row, col = (at_y + up[i]) >> CELL_SHIFT, (at_x + right[i]) >> CELL_SHIFT
            at = find_column(canvas.tiles, row, col)
            if level[i] == FAR or at < 0 or state[at] & UNKNOWN:
                counts[NO_RETURN if np.isnan(some.place[0, i]) else TOO_FAR] += 1
                deep += level[i] != FAR
                continue
            above = level[i] - canvas.base[at >> 2 * BLOCK_BITS] - ground[at]
            kind = GROUND if above < band.low else OBSTACLE
            kind = ABOVE if above >= band.high else BELOW if above <= -band.low else kind
            if kind == BELOW:
                deep += 1
                kind = OBSTACLE if is_face(canvas.columns, some, i, band.high) else BELOW
            is_doubtful = kind == OBSTACLE and abs(above) < some.clear[i]
            counts[GROUND if is_doubtful else kind] += 1
            if kind > OBSTACLE or is_doubtful:
                continue
            far = np.int64(right[i]) * right[i] + np.int64(up[i]) * up[i]
            rise = level[i] - (0 if kind else above) - origin[2] * 1000
            slope = rise / some.apart[i]
            if kind:
                room.touched[many] = at
                many += state[at] == 0
                is_high = above >= LOW_SHARE * band.high
                state[at] |= HIT if is_high else HIT | LOW
                if is_high:
                    highs += 1
                    room.floor[-highs], room.floor_apart[-highs] = at, far
                    room.floor_bearing[-highs] = some.sector[i]
            else:
                room.floor[floors], room.floor_apart[floors] = at, far
                room.floor_bearing[floors], room.floor_steep[floors] = some.sector[i], slope
                floors += 1
            end = ((row - (at_y >> CELL_SHIFT)) << END_BITS) + col - (at_x >> CELL_SHIFT)
            note_end(room, kind, some.sector[i], far, slope, end)
            note_beam(room, some.ring[i], some.sector[i], slope)
        if deep:
            many = mark_drops(size, under, origin, canvas, room, many)
    return many, floors, highs


@kernel
def clear_line(
    start: tuple[int, int],
    away: tuple[int, int],
    beams: tuple[float, int, Float32],
    canvas: Canvas,
    touched: Int32,
    many: int,
) -> int:
    """Mark the cells of Bresenham's line before its last one.

    Parameters
    ----------
    beams
        How high the sensor is (mm), how high above the ground they say nothing (mm), and the slope
        of the lowest one that reaches each ring (mm for each lattice unit).

    Returns
    -------
    How many cells are touched.
    """
    state, (row, col), (up, right), (level, high, slopes) = canvas.state, start, away, beams
    steps, fewer = max(abs(up), abs(right)), min(abs(up), abs(right))
    row_way, col_way = 1 if up > 0 else -1, 1 if right > 0 else -1
    is_steep, rest, done = abs(up) == steps, steps, 0
    pace = np.sqrt(float(up * up + right * right)) / max(steps, 1)
    rings = pace * canvas.resolution / RING_M
    while done < steps:
        # Up to the tile's border it takes steps along the longer side, and fewer along the other.
        rows = INSIDE - (row & INSIDE) if row_way > 0 else row & INSIDE
        cols = INSIDE - (col & INSIDE) if col_way > 0 else col & INSIDE
        ahead, aside = (rows, cols) if is_steep else (cols, rows)
        left = min(steps - done, ahead + 1)
        if fewer:
            left = min(left, (2 * steps * (aside + 1) - rest + 2 * fewer - 1) // (2 * fewer))
        at, moved = find_column(canvas.tiles, row, col), (rest + 2 * fewer * left) // (2 * steps)
        row_step, col_step = row_way << BLOCK_BITS, col_way
        ahead_step, aside_step = (row_step, col_step) if is_steep else (col_step, row_step)
        going, sensor = rest, level - (canvas.base[at >> 2 * BLOCK_BITS] if at >= 0 else 0)
        for k in range(done, done + left if at >= 0 else done):
            ring = min(int(k * rings), RINGS - 1)
            above = sensor + slopes[ring] * (k * pace * UNITS_PER_CELL) - canvas.ground[at]
            says = 0 if above >= high else LOW if above < LOW_SHARE * high else HIGH
            # The room behind the last place is free; a cell without ground is never 0.
            touched[many] = at
            many += says != 0 and state[at] == 0
            state[at] |= says
            # Halves are rounded away from the first cell.
            going += 2 * fewer
            turns = going >= 2 * steps
            going -= 2 * steps if turns else 0
            at += ahead_step + (aside_step if turns else 0)
        done += left
        rest += 2 * fewer * left - 2 * steps * moved
        row += row_way * (left if is_steep else moved)
        col += col_way * (moved if is_steep else left)
    return many
