"""Hits and misses of cells, cloud by cloud, over the ground."""

from typing import NamedTuple

import numpy as np

from occmap.clouds.kernels import growth
from occmap.clouds.kernels.growth import BLOCK, STEPPED, Blocks, find_column, find_under
from occmap.clouds.kernels.heights import SOME, Cloud, place_points
from occmap.clouds.kernels.laying import Columns, ground_at
from occmap.grid.kernels import CELL_SHIFT, NEAR_WEIGHT, UNITS_PER_CELL
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
COUNTS = DOUBTFUL = 6
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
FLOORS, HIGHS = range(2)
"""Places in the numbers of what a cloud left in its room"""
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
    is_touched: UInt8
    """(T,) whether it says anything of a tile"""
    counts: Int16
    """(2 * 4096 T,) hits of all cells of a tile, and then their misses"""
    used: Int64
    """(1,) how many tiles have a place"""
    points: Int64
    """(6,) how many points were of each kind"""
    resolution: float
    """Side of a cell (m)"""


@kernel
def lay_ground(canvas: Canvas, box: Int64, heights: Int32) -> bool:
    """Give the tiles of a box that have ground a place; return whether there were enough of these.

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
            for row in range(BLOCK):
                y = (((corner[0] + up) << BLOCK_BITS) + row + 0.5) * resolution
                for col in range(BLOCK):
                    x = (((corner[1] + right) << BLOCK_BITS) + col + 0.5) * resolution
                    level = ground_at(canvas.columns, find_under(blocks, x, y), x, y)
                    heights[(row << BLOCK_BITS) + col] = level
                    if level != NO_GROUND:
                        lowest = min(lowest, level)
            if lowest == HIGHEST:
                table[up, right] = -1
                continue
            if tile == len(canvas.base):
                return False
            canvas.used[0] += 1
            table[up, right], canvas.base[tile] = tile, lowest
            places[tile, 0], places[tile, 1] = corner[0] + up, corner[1] + right
            for i in range(CELLS):
                if heights[i] == NO_GROUND:
                    canvas.state[tile * CELLS + i] = UNKNOWN
                else:
                    canvas.ground[tile * CELLS + i] = min(heights[i] - lowest, 32767)
    return True


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
    used: Int64
    """(2,) how many points are `FLOORS` and `HIGHS`: hits by high beams"""
    weight: Int16
    """(64,) of looks at a row of cells"""


def make_room(points: int) -> Room:
    """Make room for clouds of so many points."""
    right, up, sector, ring, level = np.empty((5, SOME), np.int32)
    far, clear = np.empty((2, SOME))
    some = Aside(np.empty((3, SOME)), right, up, far, sector, ring, level, clear)
    apart, ends = np.empty((2, 2, SECTORS), np.int64)
    seen = np.empty(points, np.int32), np.empty(points, np.int64), np.empty(points)
    steep, lowest = np.empty(SECTORS), np.empty((RINGS, SECTORS), np.float32)
    bearing, weight = np.empty(points, np.int16), np.empty(BLOCK, np.int16)
    return Room(some, apart, ends, steep, lowest, *seen, bearing, np.empty(2, np.int64), weight)


class View(NamedTuple):
    """Where a cloud is seen from, and what counts."""

    band: Band
    x: int
    y: int
    """Lattice units of the sensor in the map"""
    row: int
    col: int
    level: float
    """Its height in the map (mm)"""
    scale: float
    """Lattice units in a metre"""
    rings: float
    """Rings around it in a lattice unit"""
    low: float
    """Beams that pass over a cell lower than this are low (mm above its ground)"""


@kernel
def trace_cloud(cloud: Cloud, band: Band, canvas: Canvas, room: Room) -> None:
    """Observe the cells of one cloud, each once: a hit before a miss."""
    scale, (x, y, z) = UNITS_PER_CELL / canvas.resolution, cloud.origin
    at_x, at_y = int(np.rint(x * scale)), int(np.rint(y * scale))
    row, col = at_y >> CELL_SHIFT, at_x >> CELL_SHIFT
    rings, low = 1 / (RING_M * scale), LOW_SHARE * band.high
    view = View(band, at_x, at_y, row, col, z * 1000, scale, rings, low)
    under = find_floor(canvas, row, col, -HIGHEST)
    room.apart[:], room.lowest[:], room.used[:] = NOTHING, np.inf, 0
    for start in range(0, cloud.points.size // 3, SOME):
        size = place_points(cloud, start, room.some.place)
        measure_points(room.some, size, cloud.origin, view)
        is_deep = False
        for i in range(size):
            at, kind, is_below = sort_point(i, view, canvas, room.some)
            is_deep |= is_below
            if kind <= OBSTACLE:
                note_point(i, at, kind, view, canvas, room)
        if is_deep:
            mark_drops(size, under, view, canvas, room)
    free_floor(canvas, room)
    look_under(view, canvas, room)
    clear_bearings(view, canvas, room)
    count_looks(view, canvas, room)


@kernel
def measure_points(some: Aside, size: int, origin: Float64, view: View) -> None:
    """Find out what points are seen from their sensor; one loop that processors run in lanes."""
    band, scale, at_x, at_y = view.band, view.scale, float(view.x), float(view.y)
    least, most = band.nearest * band.nearest, band.farthest * band.farthest
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
        some.ring[i] = np.int32(min(apart * view.rings, RINGS - 1.0))
        some.sector[i] = np.int32(sector if sector < SECTORS else 0.0)
        some.level[i] = np.int32(np.rint(z * 1000) if is_used else FAR)
        some.clear[i] = band.low + band.margin * max(np.sqrt(square) - band.level, 0.0)


@step
def sort_point(i: int, view: View, canvas: Canvas, some: Aside) -> tuple[int, int, bool]:
    """Say in which cell a point lies, of what kind it is, and whether it may show a drop."""
    band, level, counts = view.band, some.level[i], canvas.points
    row, col = (view.y + some.up[i]) >> CELL_SHIFT, (view.x + some.right[i]) >> CELL_SHIFT
    at = find_column(canvas.tiles, row, col)
    if level == FAR or at < 0 or canvas.state[at] & UNKNOWN:
        kind = NO_RETURN if np.isnan(some.place[0, i]) else TOO_FAR
        counts[kind] += 1
        return at, kind, level != FAR
    above = level - floor_of(canvas, at)
    kind = GROUND if above < band.low else OBSTACLE
    kind = ABOVE if above >= band.high else BELOW if above <= -band.low else kind
    is_below = kind == BELOW
    if is_below and is_face(canvas.columns, some, i, band.high):
        kind = OBSTACLE
    is_doubtful = kind == OBSTACLE and abs(above) < some.clear[i]
    counts[GROUND if is_doubtful else kind] += 1
    return at, DOUBTFUL if is_doubtful else kind, is_below


@step
def note_point(i: int, at: int, kind: int, view: View, canvas: Canvas, room: Room) -> None:
    """Mark the cell of a hit, or keep floor; its bearing may end here."""
    some, used = room.some, room.used
    floor = floor_of(canvas, at)
    right, up, bearing = some.right[i], some.up[i], some.sector[i]
    far = np.int64(right) * right + np.int64(up) * up
    slope = ((some.level[i] if kind else floor) - view.level) / some.apart[i]
    is_high = some.level[i] - floor >= view.low
    if kind:
        touch(at, HIT if is_high else HIT | LOW, canvas)
    # A low hit is written, too, so that there is no branch, and the next hit goes over it. Points
    # take one place each at most, so the ends never meet.
    keep = -1 - used[HIGHS] if kind else used[FLOORS]
    used[HIGHS if kind else FLOORS] += is_high or not kind
    room.floor[keep], room.floor_apart[keep] = at, far
    room.floor_bearing[keep], room.floor_steep[keep] = bearing, slope
    row, col = (view.y + up) >> CELL_SHIFT, (view.x + right) >> CELL_SHIFT
    note_end(room, kind, bearing, far, slope, (row - view.row, col - view.col))
    note_beam(room, some.ring[i], bearing, slope)


@step
def find_floor(canvas: Canvas, row: int, col: int, other: int) -> int:
    """The height of the ground of a cell (mm), or another one where it has none."""
    at = find_column(canvas.tiles, row, col)
    return other if at < 0 or canvas.state[at] & UNKNOWN else floor_of(canvas, at)


@step
def floor_of(canvas: Canvas, at: int) -> int:
    """The height of the ground of a cell that has one (mm)."""
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
def mark_drops(size: int, under: int, view: View, canvas: Canvas, room: Room) -> None:
    """Mark the last floor before points that lie deep below it."""
    some, x, y = room.some, view.x, view.y
    start = x, y, COLUMN_MM * view.scale / 1000
    for i in range(size):
        level = some.level[i]
        if level == FAR or level >= view.level:
            continue
        row, col = (y + some.up[i]) >> CELL_SHIFT, (x + some.right[i]) >> CELL_SHIFT
        floor = find_floor(canvas, row, col, under)
        rise = floor - view.level
        if level - floor > -DEEP * some.clear[i] or rise >= 0:
            continue
        share = rise / (level - view.level)
        away = int(some.right[i]), int(some.up[i])
        right, up = find_rim(canvas.columns, start, away, (floor, share))
        row, col = (y + up) >> CELL_SHIFT, (x + right) >> CELL_SHIFT
        at = find_column(canvas.tiles, row, col)
        if (right == 0 and up == 0) or at < 0 or canvas.state[at] & UNKNOWN:
            continue
        touch(at, HIT | LOW, canvas)
        far = right * right + up * up
        apart = np.sqrt(float(far))
        end, slope = (row - view.row, col - view.col), rise / apart
        # A constant is of a type of its own, for which steps are compiled anew.
        note_end(room, int(OBSTACLE), some.sector[i], far, slope, end)
        note_beam(room, find_ring(view, apart), some.sector[i], slope)


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
def touch(at: int, says: int, canvas: Canvas) -> None:
    """Mark what the cloud says of a cell."""
    canvas.state[at] |= says
    canvas.is_touched[at >> 2 * BLOCK_BITS] = 1


@step
def note_end(
    room: Room, kind: int, bearing: int, far: int, slope: float, cell: tuple[int, int]
) -> None:
    """Keep what a bearing ends at: the nearest hit, or the farthest floor."""
    end = (cell[0] << END_BITS) + cell[1]
    key, known = far if kind else -far, room.apart[kind, bearing]
    if kind and key <= known:
        room.steep[bearing] = slope if key < known else max(slope, room.steep[bearing])
    if key < known or (key == known and end < room.ends[kind, bearing]):
        room.apart[kind, bearing], room.ends[kind, bearing] = key, end


@step
def find_ring(view: View, apart: float) -> int:
    """In which ring lies what is so many lattice units away."""
    return min(int(apart * view.rings), RINGS - 1)


@step
def note_beam(room: Room, ring: int, bearing: int, slope: float) -> None:
    """Keep the lowest beam that ends in a ring."""
    room.lowest[ring, bearing] = min(room.lowest[ring, bearing], slope)


@step
def free_floor(canvas: Canvas, room: Room) -> None:
    """Mark the cells of floor points that are free."""
    for i in range(room.used[FLOORS]):
        at, bearing, far = room.floor[i], room.floor_bearing[i], room.floor_apart[i]
        # Floor behind the nearest hit is free if it is seen over that, and not beneath it.
        is_behind = far > room.apart[OBSTACLE, bearing]
        is_beneath = is_behind and room.floor_steep[i] < room.steep[bearing]
        if canvas.state[at] == 0 and not is_beneath:
            touch(at, LOW, canvas)


@step
def look_under(view: View, canvas: Canvas, room: Room) -> None:
    """Find the lowest beam that reaches each ring, and whether low ones pass under high hits."""
    lowest = room.lowest
    for ring in range(RINGS - 2, -1, -1):
        for bearing in range(SECTORS):
            lowest[ring, bearing] = min(lowest[ring, bearing], lowest[ring + 1, bearing])
    for i in range(1, room.used[HIGHS] + 1):
        at, apart = room.floor[-i], np.sqrt(float(room.floor_apart[-i]))
        slope = lowest[find_ring(view, apart), room.floor_bearing[-i]]
        above = view.level + slope * apart - floor_of(canvas, at)
        canvas.state[at] |= LOW if above < view.low else 0


@step
def clear_bearings(view: View, canvas: Canvas, room: Room) -> None:
    """Mark the cells up to the end of each bearing."""
    for bearing in range(SECTORS):
        kind = OBSTACLE if room.apart[OBSTACLE, bearing] < NOTHING else GROUND
        far, end = room.apart[kind, bearing], room.ends[kind, bearing]
        if far < NOTHING:
            up = (end + HALF_END) >> END_BITS
            clear_line(view, (up, end - (up << END_BITS)), bearing, canvas, room)


@step
def count_looks(view: View, canvas: Canvas, room: Room) -> None:
    """Count what the cloud says of cells, and forget it."""
    for tile in range(canvas.used[0]):
        if canvas.is_touched[tile]:
            canvas.is_touched[tile] = 0
            count_tile(tile, view, canvas, room.weight)


@kernel
def count_tile(tile: int, view: View, canvas: Canvas, weight: Int16) -> None:
    """Count what the cloud says of a tile, a row at a time: processors count many cells at once."""
    start, near = tile * CELLS, (NEAR_M / canvas.resolution) ** 2
    row = (canvas.tiles.places[tile, 0] << BLOCK_BITS) - view.row
    col = (canvas.tiles.places[tile, 1] << BLOCK_BITS) - view.col
    for at in range(start, start + CELLS, BLOCK):
        state, says = canvas.state[at : at + BLOCK], 0
        for i in range(BLOCK):
            says |= state[i] & (LOW | HIT | HIGH)
        if says:
            # Cells of the row are near up to so many columns away, and less.
            square = near - (row + ((at - start) >> BLOCK_BITS)) ** 2
            away = int(np.sqrt(max(square, 0.0)))
            away += away * away < square
            weight[:] = FAR_WEIGHT
            for i in range(max(1 - away - col, 0), min(away - col, BLOCK)):
                weight[i] = NEAR_WEIGHT if state[i] & LOW else FAR_WEIGHT
            hits = canvas.counts[at + start : at + start + BLOCK]
            misses = canvas.counts[at + start + CELLS : at + start + CELLS + BLOCK]
            for i in range(BLOCK):
                look = np.int16(0) if state[i] == 0 or state[i] & UNKNOWN else weight[i]
                hits[i] += look if state[i] & HIT else np.int16(0)
                misses[i] += np.int16(0) if state[i] & HIT else look
                state[i] &= UNKNOWN


@kernel
def clear_line(view: View, away: tuple[int, int], bearing: int, canvas: Canvas, room: Room) -> None:
    """Mark the cells of Bresenham's line before its last one.

    Parameters
    ----------
    away
        Rows up and columns right to the last cell.
    """
    (up, right), row, col, slopes = away, view.row, view.col, room.lowest[:, bearing]
    high, low = view.band.high, view.low
    steps, fewer = max(abs(up), abs(right)), min(abs(up), abs(right))
    row_way, col_way = 1 if up > 0 else -1, 1 if right > 0 else -1
    is_steep, rest, done = abs(up) == steps, steps, 0
    pace = np.sqrt(float(up * up + right * right)) / max(steps, 1) * UNITS_PER_CELL
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
        if at >= 0:
            canvas.is_touched[at >> 2 * BLOCK_BITS] = 1
        going, level = rest, view.level - (canvas.base[at >> 2 * BLOCK_BITS] if at >= 0 else 0)
        for k in range(done, done + left if at >= 0 else done):
            above = level + slopes[find_ring(view, k * pace)] * (k * pace) - canvas.ground[at]
            says = 0 if above >= high else LOW if above < low else HIGH
            canvas.state[at] |= says
            # Halves are rounded away from the first cell.
            going += 2 * fewer
            turns = going >= 2 * steps
            going -= 2 * steps if turns else 0
            at += ahead_step + (aside_step if turns else 0)
        done += left
        rest += 2 * fewer * left - 2 * steps * moved
        row += row_way * (left if is_steep else moved)
        col += col_way * (moved if is_steep else left)
