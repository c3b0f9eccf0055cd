"""Hits and misses of cells, cloud by cloud, over the ground."""

from typing import NamedTuple

import numpy as np

from occmap.clouds.kernels.growth import NO_GROUND, Blocks, find_column
from occmap.clouds.kernels.heights import SOME, Cloud, place_points
from occmap.grid.kernels.units import CELL_SHIFT, NEAR_WEIGHT, TILE_BITS
from occmap.jit import array_kernel, step
from occmap.types import COLUMN_MM, Float64, Int16, Int32, Int64, UInt8

STEP_MM = 80
"""The ground is bilinear between columns that differ by no more."""
MISS, HIT, UNKNOWN = 1, 2, 4
"""Bits of a cell in one cloud; the last one stays where there is no ground."""
SECTORS_OF_QUARTER = 180
SECTORS = 4 * SECTORS_OF_QUARTER
"""Bearings of the map: equal widths in x / (|x| + |y|), half a degree on average."""
GROUND, OBSTACLE, ABOVE, BELOW, TOO_FAR, NO_RETURN = range(6)
"""Places in the counts of points."""
COUNTS = 6
NEAR_M = 8.0
"""Poses that are off move what is seen from farther away by more than the clearance, and beams are
farther apart there than things are thick: such a look weighs less"""
FAR = -(1 << 31) + 1
"""The height of what is too far away"""
NOTHING = 1 << 62
"""Farther than anything is"""


class Canvas(NamedTuple):
    """What the second pass writes to, tile by tile."""

    table: Int32
    """(R, C) number of each tile; -1: without ground, -2: not looked at"""
    corner: Int64
    """(2,) row and column of the first tile"""
    places: Int64
    """(T, 2) row and column of each tile"""
    counts: Int32
    """(T, 2, 4096) hits and misses"""
    state: UInt8
    """(T, 4096) what the cloud at hand says"""
    ground: Int16
    """(T, 4096) height of the ground over that of the tile (mm)"""
    base: Int32
    """(T,) height of the tile (mm)"""


@step
def ground_at(blocks: Blocks, height: Int32, x: float, y: float) -> int:
    """The height of the ground at a point (mm): bilinear where it is flat, else of its column."""
    across, along = x * 1000 / COLUMN_MM, y * 1000 / COLUMN_MM
    own = find_column(blocks, int(np.floor(along)), int(np.floor(across)))
    if own < 0 or height[own] == NO_GROUND:
        return NO_GROUND
    col, row = int(np.floor(across - 0.5)), int(np.floor(along - 0.5))
    right, up = across - 0.5 - col, along - 0.5 - row
    level: int = height[own]
    low, high, total = level, level, 0.0
    for i in range(2):
        for j in range(2):
            at = find_column(blocks, row + i, col + j)
            if at < 0 or height[at] == NO_GROUND:
                return level
            low, high = min(low, height[at]), max(high, height[at])
            total += height[at] * (up if i else 1 - up) * (right if j else 1 - right)
    if high - low > STEP_MM:
        return level
    return int(np.rint(total))


@array_kernel
def lay_ground(
    blocks: Blocks, height: Int32, canvas: Canvas, box: Int64, resolution: float, used: int
) -> int:
    """Give the tiles of a box that have ground a place; return how many places are used.

    Stops, and returns the places used so far, where no place is left.

    Parameters
    ----------
    box
        (4,) first row and column, last row and column of tiles, from the canvas' corner.
    """
    cells = 1 << TILE_BITS
    heights = np.empty(cells * cells, np.int32)
    for up in range(box[0], box[2] + 1):
        for right in range(box[1], box[3] + 1):
            if canvas.table[up, right] != -2:
                continue
            lowest = 1 << 30
            for i in range(cells * cells):
                row = ((canvas.corner[0] + up) << TILE_BITS) + (i >> TILE_BITS)
                col = ((canvas.corner[1] + right) << TILE_BITS) + (i & (cells - 1))
                x, y = (col + 0.5) * resolution, (row + 0.5) * resolution
                heights[i] = ground_at(blocks, height, x, y)
                if heights[i] != NO_GROUND:
                    lowest = min(lowest, heights[i])
            if lowest == 1 << 30:
                canvas.table[up, right] = -1
                continue
            if used == len(canvas.base):
                return -1 - used
            canvas.table[up, right] = used
            canvas.base[used] = lowest
            canvas.places[used, 0] = canvas.corner[0] + up
            canvas.places[used, 1] = canvas.corner[1] + right
            for i in range(cells * cells):
                if heights[i] == NO_GROUND:
                    canvas.state[used, i] = UNKNOWN
                else:
                    canvas.ground[used, i] = min(heights[i] - lowest, 32767)
            used += 1
    return used


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


@step
def find_cell(canvas: Canvas, row: int, col: int) -> int:
    """Where a cell lies in the flat arrays of a canvas; -1 where it has no place."""
    up, right = (row >> TILE_BITS) - canvas.corner[0], (col >> TILE_BITS) - canvas.corner[1]
    if up < 0 or right < 0 or up >= canvas.table.shape[0] or right >= canvas.table.shape[1]:
        return -1
    tile: int = canvas.table[up, right]
    if tile < 0:
        return -1
    inside = (1 << TILE_BITS) - 1
    return (tile << 2 * TILE_BITS) | ((row & inside) << TILE_BITS) | (col & inside)


class Aside(NamedTuple):
    """Some points of a cloud, seen from its sensor; so few that they stay in a core's cache."""

    x: Float64
    y: Float64
    z: Float64
    """m in the map, NaN where nothing came back"""
    right: Int32
    up: Int32
    """Lattice units from the sensor; both 0 beyond the distances that count"""
    sector: Int32
    """The bearing"""
    level: Int32
    """Height in the map (mm), or `FAR`"""
    clear: Float64
    """From which height above the ground on it is an obstacle (mm)"""


@array_kernel
def measure_points(some: Aside, origin: Float64, band: Band, scale: float) -> None:
    """Find out what points are seen from their sensor; one loop that processors run in lanes."""
    least, most = band.nearest * band.nearest, band.farthest * band.farthest
    at_x, at_y = np.rint(origin[0] * scale), np.rint(origin[1] * scale)
    for i in range(len(some.x)):
        away_x, away_y = some.x[i] - origin[0], some.y[i] - origin[1]
        square = away_x * away_x + away_y * away_y
        is_used = least <= square < most
        right = np.rint(some.x[i] * scale) - at_x if is_used else 0.0
        up = np.rint(some.y[i] * scale) - at_y if is_used else 0.0
        # No quotient of whole numbers as small as these is rounded to a whole one.
        part = np.floor(right * SECTORS_OF_QUARTER / max(abs(right) + abs(up), 1.0))
        sector = SECTORS_OF_QUARTER - part if up >= 0 else 3 * SECTORS_OF_QUARTER + part
        some.right[i], some.up[i] = np.int32(right), np.int32(up)
        some.sector[i] = np.int32(sector if sector < SECTORS else 0.0)
        some.level[i] = np.int32(np.rint(some.z[i] * 1000) if is_used else FAR)
        some.clear[i] = band.low + band.margin * max(np.sqrt(square) - band.level, 0.0)


@array_kernel
def trace_cloud(
    cloud: Cloud, band: Band, canvas: Canvas, scale: float, touched: Int32, counts: Int64
) -> None:
    """Observe the cells of one cloud, each once: a hit before a miss.

    Parameters
    ----------
    scale
        Lattice units in a metre.
    touched
        Room for the places of cells, and one more.
    counts
        (6,) points of each kind; they are added.
    """
    origin = cloud.origin
    state, ground = canvas.state.reshape(-1), canvas.ground.reshape(-1)
    at_x, at_y = int(np.rint(origin[0] * scale)), int(np.rint(origin[1] * scale))
    # Of each bearing, the farthest floor and the nearest hit: how far (floor: less than 0), and in
    # which cell; of the hit also how steeply it is seen.
    apart = np.full((2, SECTORS), NOTHING)
    ends = np.zeros((2, SECTORS, 2), np.int64)
    steep = np.zeros(SECTORS)
    # Of each floor point, which waits for all hits: the same, and its bearing.
    floor, floors = np.empty(len(cloud.points), np.int32), 0
    floor_apart, floor_steep = np.empty(len(cloud.points), np.int64), np.empty(len(cloud.points))
    floor_bearing = np.empty(len(cloud.points), np.int16)
    x, y, z, clear = np.empty(SOME), np.empty(SOME), np.empty(SOME), np.empty(SOME)
    right, up = np.empty(SOME, np.int32), np.empty(SOME, np.int32)
    sector, level = np.empty(SOME, np.int32), np.empty(SOME, np.int32)
    many = 0
    for start in range(0, len(cloud.points), SOME):
        size = min(SOME, len(cloud.points) - start)
        place_points(cloud, start, x[:size], y[:size], z[:size])
        some = Aside(x[:size], y[:size], z[:size], right, up, sector, level, clear)
        measure_points(some, origin, band, scale)
        for i in range(size):
            unit_x, unit_y = at_x + right[i], at_y + up[i]
            row, col = unit_y >> CELL_SHIFT, unit_x >> CELL_SHIFT
            at = find_cell(canvas, row, col)
            if level[i] == FAR or at < 0 or state[at] & UNKNOWN:
                counts[NO_RETURN if np.isnan(x[i]) else TOO_FAR] += 1
                continue
            above = level[i] - canvas.base[at >> 2 * TILE_BITS] - ground[at]
            kind = GROUND if above < band.low else OBSTACLE
            kind = ABOVE if above >= band.high else BELOW if above <= -band.low else kind
            is_doubtful = kind == OBSTACLE and above < clear[i]
            counts[GROUND if is_doubtful else kind] += 1
            if kind > OBSTACLE or is_doubtful:
                continue
            bearing = sector[i]
            far = np.int64(right[i]) * right[i] + np.int64(up[i]) * up[i]
            rise = level[i] - (0 if kind else above) - origin[2] * 1000
            slope = rise / np.sqrt(far)
            key = far if kind else -far
            known = apart[kind, bearing]
            if kind:
                touched[many] = at
                many += state[at] == 0
                state[at] = HIT
                if key <= known:
                    steep[bearing] = slope if key < known else max(slope, steep[bearing])
            else:
                floor[floors], floor_apart[floors] = at, far
                floor_bearing[floors], floor_steep[floors] = bearing, slope
                floors += 1
            if key < known or (
                key == known and (row, col) < (ends[kind, bearing, 0], ends[kind, bearing, 1])
            ):
                apart[kind, bearing] = key
                ends[kind, bearing, 0], ends[kind, bearing, 1] = row, col
    for i in range(floors):
        at, bearing = floor[i], floor_bearing[i]
        # Floor behind the nearest hit is free if it is seen over that, and not beneath it.
        is_behind = floor_apart[i] > apart[OBSTACLE, bearing]
        if state[at] == 0 and not (is_behind and floor_steep[i] < steep[bearing]):
            touched[many] = at
            many += 1
            state[at] = MISS
    for bearing in range(SECTORS):
        kind = OBSTACLE if apart[OBSTACLE, bearing] < NOTHING else GROUND
        if apart[kind, bearing] < NOTHING:
            row, col = ends[kind, bearing, 0], ends[kind, bearing, 1]
            many = clear_line(
                at_y >> CELL_SHIFT, at_x >> CELL_SHIFT, row, col, canvas, touched, many
            )
    last, near = (1 << TILE_BITS) - 1, NEAR_M * scale / (1 << CELL_SHIFT)
    for i in range(many):
        at = touched[i]
        tile, inside = at >> 2 * TILE_BITS, at & ((1 << 2 * TILE_BITS) - 1)
        up = (canvas.places[tile, 0] << TILE_BITS) + (inside >> TILE_BITS) - (at_y >> CELL_SHIFT)
        right = (canvas.places[tile, 1] << TILE_BITS) + (inside & last) - (at_x >> CELL_SHIFT)
        weight = NEAR_WEIGHT if up * up + right * right < near * near else 1
        canvas.counts[tile, 0 if state[at] & HIT else 1, inside] += weight
        state[at] = 0


@step
def clear_line(
    row: int, col: int, to_row: int, to_col: int, canvas: Canvas, touched: Int32, many: int
) -> int:
    """Mark the cells of Bresenham's line before its last one; return how many are touched."""
    state = canvas.state.reshape(-1)
    up, right = to_row - row, to_col - col
    steps, fewer = max(abs(up), abs(right)), min(abs(up), abs(right))
    row_way, col_way = 1 if up > 0 else -1, 1 if right > 0 else -1
    is_steep, last = abs(up) == steps, (1 << TILE_BITS) - 1
    rest, done = steps, 0
    while done < steps:
        # Up to the tile's border it takes steps along the longer side, and fewer along the other.
        rows = last - (row & last) if row_way > 0 else row & last
        cols = last - (col & last) if col_way > 0 else col & last
        ahead, aside = (rows, cols) if is_steep else (cols, rows)
        left = min(steps - done, ahead + 1)
        if fewer:
            left = min(left, (2 * steps * (aside + 1) - rest + 2 * fewer - 1) // (2 * fewer))
        at, moved = find_cell(canvas, row, col), (rest + 2 * fewer * left) // (2 * steps)
        row_pace, col_pace = row_way << TILE_BITS, col_way
        pace, sideways = (row_pace, col_pace) if is_steep else (col_pace, row_pace)
        going = rest
        for _ in range(left if at >= 0 else 0):
            # The room behind the last place is free; a cell without ground is never 0.
            touched[many] = at
            many += state[at] == 0
            state[at] |= MISS
            # Halves are rounded away from the first cell.
            going += 2 * fewer
            turns = going >= 2 * steps
            going -= 2 * steps if turns else 0
            at += pace + (sideways if turns else 0)
        done += left
        rest += 2 * fewer * left - 2 * steps * moved
        row += row_way * (left if is_steep else moved)
        col += col_way * (moved if is_steep else left)
    return many
