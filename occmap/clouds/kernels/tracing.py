"""Hits and misses of cells, cloud by cloud, over the ground."""

from typing import NamedTuple

import numpy as np

from occmap.clouds.kernels.growth import NO_GROUND, Blocks, find_column
from occmap.clouds.kernels.heights import COLUMN_MM, Cloud
from occmap.grid.kernels.units import CELL_SHIFT, TILE_BITS
from occmap.jit import kernel, step
from occmap.types import Int16, Int32, Int64, UInt8

NONE = -(1 << 15)
"""A cell without ground."""
STEP_MM = 80
"""The ground is bilinear between columns that differ by no more."""
HIT, MISS = 1, 2
"""Bits of a cell in one cloud."""
SECTORS_OF_QUARTER = 180
SECTORS = 4 * SECTORS_OF_QUARTER
"""Bearings of the map: equal widths in x / (|x| + |y|), half a degree on average."""
GROUND, OBSTACLE, ABOVE, BELOW, TOO_FAR, NO_RETURN = range(6)
"""Places in the counts of points."""
COUNTS = 6


class Canvas(NamedTuple):
    """What the second pass writes to, tile by tile."""

    table: Int32
    """(R, C) number of each tile; -1: without ground, -2: not looked at"""
    corner: Int64
    """(2,) row and column of the first tile"""
    counts: Int32
    """(T, 2, 4096) hits and misses"""
    state: UInt8
    """(T, 4096) what the cloud at hand says"""
    ground: Int16
    """(T, 4096) height of the ground over that of the tile (mm), or `NONE`"""
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


@kernel
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
            for i in range(cells * cells):
                above = heights[i] - lowest
                canvas.ground[used, i] = NONE if heights[i] == NO_GROUND else min(above, 32767)
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


@step
def find_sector(x: int, y: int) -> int:
    """Which of the bearings of the map a direction has."""
    size = abs(x) + abs(y)
    if size == 0:
        return 0
    part = x * SECTORS_OF_QUARTER // size
    sector = SECTORS_OF_QUARTER - part if y >= 0 else 3 * SECTORS_OF_QUARTER + part
    return sector % SECTORS


@kernel
def trace_cloud(
    cloud: Cloud, band: Band, canvas: Canvas, scale: float, touched: Int32, counts: Int64
) -> None:
    """Observe the cells of one cloud, each once: a hit before a miss.

    Parameters
    ----------
    scale
        Lattice units in a metre.
    touched
        Room for the places of cells.
    counts
        (7,) points of each kind; they are added.
    """
    points, which, poses, origin = cloud
    state, ground = canvas.state.reshape(-1), canvas.ground.reshape(-1)
    at_x, at_y = int(np.rint(origin[0] * scale)), int(np.rint(origin[1] * scale))
    nearest = np.full(SECTORS, 1 << 62, np.int64)
    farthest = np.full(SECTORS, -1, np.int64)
    ends = np.zeros((2, SECTORS, 2), np.int64)
    many = 0
    for i in range(len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not (abs(u) + abs(v) + abs(w) > 0.0 and abs(u) + abs(v) + abs(w) < 1e6):
            counts[NO_RETURN] += 1
            continue
        pose = poses[which[i] if which.size else 0]
        x = pose[0, 0] * u + pose[0, 1] * v + pose[0, 2] * w + pose[0, 3]
        y = pose[1, 0] * u + pose[1, 1] * v + pose[1, 2] * w + pose[1, 3]
        z = pose[2, 0] * u + pose[2, 1] * v + pose[2, 2] * w + pose[2, 3]
        away_x, away_y = x - origin[0], y - origin[1]
        distance = np.sqrt(away_x * away_x + away_y * away_y)
        if not (band.nearest <= distance < band.farthest):
            counts[TOO_FAR] += 1
            continue
        unit_x, unit_y = int(np.rint(x * scale)), int(np.rint(y * scale))
        row, col = unit_y >> CELL_SHIFT, unit_x >> CELL_SHIFT
        at = find_cell(canvas, row, col)
        if at < 0 or ground[at] == NONE:
            counts[TOO_FAR] += 1
            continue
        above = int(np.rint(z * 1000)) - canvas.base[at >> 2 * TILE_BITS] - ground[at]
        if above >= band.high:
            counts[ABOVE] += 1
            continue
        if above <= -band.low:
            counts[BELOW] += 1
            continue
        x_off, y_off = unit_x - at_x, unit_y - at_y
        apart = x_off * x_off + y_off * y_off
        sector = find_sector(x_off, y_off)
        if above < band.low:
            counts[GROUND] += 1
            if state[at] == 0:
                touched[many] = at
                many += 1
            state[at] |= MISS
            if apart > farthest[sector] or (
                apart == farthest[sector] and (row, col) < (ends[1, sector, 0], ends[1, sector, 1])
            ):
                farthest[sector] = apart
                ends[1, sector, 0], ends[1, sector, 1] = row, col
        elif above >= band.low + band.margin * max(distance - band.level, 0.0):
            counts[OBSTACLE] += 1
            if state[at] == 0:
                touched[many] = at
                many += 1
            state[at] |= HIT
            if apart < nearest[sector] or (
                apart == nearest[sector] and (row, col) < (ends[0, sector, 0], ends[0, sector, 1])
            ):
                nearest[sector] = apart
                ends[0, sector, 0], ends[0, sector, 1] = row, col
    for sector in range(SECTORS):
        if nearest[sector] < 1 << 62:
            row, col = ends[0, sector, 0], ends[0, sector, 1]
        elif farthest[sector] >= 0:
            row, col = ends[1, sector, 0], ends[1, sector, 1]
        else:
            continue
        many = clear_line(at_y >> CELL_SHIFT, at_x >> CELL_SHIFT, row, col, canvas, touched, many)
    for i in range(many):
        at = touched[i]
        hit = state[at] & HIT
        canvas.counts[at >> 2 * TILE_BITS, 0 if hit else 1, at & ((1 << 2 * TILE_BITS) - 1)] += 1
        state[at] = 0


@step
def clear_line(
    row: int, col: int, to_row: int, to_col: int, canvas: Canvas, touched: Int32, many: int
) -> int:
    """Mark the cells of Bresenham's line before its last one; return how many are touched."""
    state, ground = canvas.state.reshape(-1), canvas.ground.reshape(-1)
    up, right = to_row - row, to_col - col
    steps = max(abs(up), abs(right))
    for k in range(steps):
        # Halves are rounded away from the first cell.
        rise = (2 * k * abs(up) + steps) // (2 * steps)
        run = (2 * k * abs(right) + steps) // (2 * steps)
        at = find_cell(
            canvas, row + (rise if up > 0 else -rise), col + (run if right > 0 else -run)
        )
        if at >= 0 and ground[at] != NONE:
            if state[at] == 0:
                touched[many] = at
                many += 1
            state[at] |= MISS
    return many
