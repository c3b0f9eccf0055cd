"""The ground: columns in blocks, what grows from under the path, and what is filled beside it.

`look_beside` begins under the path, and `grow_ground` goes on from column to column. `drop_raised`
takes out what stands on it, `restore_levels` gives back pavements, and `smooth_ground` takes the
mean of all visits. `occmap.clouds.ground` calls them in this order.
"""

from typing import NamedTuple

import numpy as np

from occmap.clouds.kernels.heights import BIN_MM
from occmap.jit import kernel, step
from occmap.types import BLOCK_BITS, COLUMN_MM, NO_GROUND, Bool, Int32, Int64

BLOCK = 1 << BLOCK_BITS
"""Columns along the side of a block."""
STEP_MM = 80
"""The ground of a column is at most this far from the mean of what is beside it, and is bilinear
between columns that differ by no more"""
SMOOTH, ALIKE_MM = 4, 90
"""So far around it (columns) the ground of a column is the mean of what lies so near to its own: of
a step as high as the clearance it is one side, and floor that two visits show 8 cm apart is one"""
QUEUED = -1
"""Stands for the points of a column that may have ground next"""
STRAY = 16
"""A peak below one that holds more than so many times its points is noise, or a mirrored thing"""
STEPPED = 3
"""Low things are looked for so far around a column (columns)"""
SLOPE_MM, HIGH_MM = 0.12 * COLUMN_MM, 300
"""By so much one surface rises from column to column; what is so high is no low thing"""
STEEPEST_MM = 0.3 * COLUMN_MM
"""Over a gap it goes on rising by less from column to column"""
BROAD = 10
"""A surface that goes on so far behind its brink is a level to drive on, and no pallet (columns)"""
BRINK_MM, DROP_MM = 60, 80
"""A level ends where the next column is so much lower; what falls by the second does not go on"""


class Blocks(NamedTuple):
    """Where columns lie in flat arrays, block by block."""

    table: Int32
    """(R, C) number of each block, or -1"""
    corner: Int64
    """(2,) row and column of the first block"""
    places: Int64
    """(B, 2) row and column of each block"""


def index_blocks(places: Int64) -> Blocks:
    """Make the table of blocks (B, 2), at least one."""
    places = places if len(places) else np.zeros((1, 2), np.int64)
    corner = places.min(axis=0)
    table = np.full(places.max(axis=0) - corner + 1, -1, np.int32)
    table[tuple((places - corner).T)] = np.arange(len(places))
    return Blocks(table, corner, places)


@step
def find_column(blocks: Blocks, row: int, col: int) -> int:
    """Where a column lies in flat arrays; -1 where no block has it."""
    up, right = (row >> BLOCK_BITS) - blocks.corner[0], (col >> BLOCK_BITS) - blocks.corner[1]
    if up < 0 or right < 0 or up >= blocks.table.shape[0] or right >= blocks.table.shape[1]:
        return -1
    block: int = blocks.table[up, right]
    if block < 0:
        return -1
    return (block << 2 * BLOCK_BITS) | ((row & (BLOCK - 1)) << BLOCK_BITS) | (col & (BLOCK - 1))


@step
def find_under(blocks: Blocks, x: float, y: float) -> int:
    """Where the column below a point (m) lies in flat arrays; -1 where no block has it."""
    across, along = x * 1000 / COLUMN_MM, y * 1000 / COLUMN_MM
    return find_column(blocks, int(np.floor(along)), int(np.floor(across)))


@step
def locate(blocks: Blocks, at: int) -> tuple[int, int]:
    """The row and the column of a column by where it lies."""
    block = blocks.places[at >> 2 * BLOCK_BITS]
    row: int = (block[0] << BLOCK_BITS) | ((at >> BLOCK_BITS) & (BLOCK - 1))
    col: int = (block[1] << BLOCK_BITS) | (at & (BLOCK - 1))
    return row, col


@step
def find_near(blocks: Blocks, at: int, up: int, right: int) -> int:
    """Where the column so far up and right of another one lies; -1 where no block has it."""
    inside = ((at >> BLOCK_BITS) & (BLOCK - 1)) + up, (at & (BLOCK - 1)) + right
    if (inside[0] | inside[1]) & -BLOCK == 0:  # it lies in the same block, as most do
        return at + (up << BLOCK_BITS) + right
    row, col = locate(blocks, at)
    return find_column(blocks, row + up, col + right)


class Peaks(NamedTuple):
    """The peaks of columns, lowest first."""

    first: Int32
    """(C,) the first peak of each column of the blocks"""
    many: Int32
    """(C,) how many it has"""
    height: Int32
    """(P,) mm"""
    weight: Int32
    """(P,) points"""


class Found(NamedTuple):
    """What is found of columns."""

    height: Int32
    """(C,) of the ground (mm), or `NO_GROUND`"""
    weight: Int32
    """(C,) points that show it"""
    stood: Bool
    """(C,) whether the robot stood there"""


class Layer(NamedTuple):
    """Between which depths below a sensor the ground may lie, on planes that lean alike."""

    least: int
    """mm"""
    most: int
    stray: int
    """How many times the points of a lower peak another one may hold"""
    right: float = 0.0
    """By how much it rises (mm) to the next column, and to the next row"""
    up: float = 0.0


@kernel
def look_beside(
    blocks: Blocks,
    peaks: Peaks,
    path: Int64,
    reach: tuple[int, int],
    layer: Layer,
    found: Found,
    depths: Int64,
) -> None:
    """Take as ground the lowest peak that lies as deep below the sensor as the ground may.

    Parameters
    ----------
    path
        (P, 3) x, y, z of the sensor (mm).
    reach
        How far beside it columns count, and how far the robot stands.
    found
        Changed in place.
    depths
        (D,) counts of depths by `BIN_MM`, from the least one on; they are added.
    """
    (beside, under), (least, most, stray, lean_right, lean_up) = reach, layer
    height, weight, stood = found
    for i in range(len(path)):
        row, col = path[i, 1] // COLUMN_MM, path[i, 0] // COLUMN_MM
        for up in range(-beside, beside + 1):
            for right in range(-beside, beside + 1):
                apart = up * up + right * right
                if apart > beside * beside:
                    continue
                at = find_column(blocks, row + up, col + right)
                if at < 0:
                    continue
                stood[at] |= apart <= under * under
                lowest, heaviest, first = -1, 0, peaks.first[at]
                sensor = path[i, 2] + int(np.rint(lean_right * right + lean_up * up))
                for k in range(first + peaks.many[at] - 1, first - 1, -1):
                    if least <= sensor - peaks.height[k] <= most:
                        if stray * peaks.weight[k] >= heaviest:
                            lowest = k
                        heaviest = max(heaviest, peaks.weight[k])
                if lowest < 0:
                    continue
                level = peaks.height[lowest]
                depths[(sensor - level - least) // BIN_MM] += 1
                if height[at] == NO_GROUND or level < height[at]:
                    height[at], weight[at] = level, peaks.weight[lowest]


@kernel
def expect_level(blocks: Blocks, height: Int32, at: int, reach: int) -> int:
    """The height (mm) to expect of a column by the nearest measured ones, of a ring up to `reach`.

    It is their mean. Over a gap each rises on as it does from the one twice as far.
    """
    for ring in range(1, reach + 1):
        total, many = 0, 0
        for up in range(-ring, ring + 1):
            pace = 1 if abs(up) == ring else 2 * ring
            for right in range(-ring, ring + 1, pace):
                near = find_near(blocks, at, up, right)
                if near >= 0 and height[near] != NO_GROUND:
                    total += height[near]
                    many += 1
                    far = find_near(blocks, at, 2 * up, 2 * right) if ring > 1 else -1
                    rise = height[near] - height[far] if far >= 0 else 0
                    total += rise if abs(rise) < STEEPEST_MM * ring else 0
        if many:
            return (2 * total + many) // (2 * many)
    return NO_GROUND


@step
def find_peak(peaks: Peaks, at: int, level: int) -> tuple[int, int]:
    """The peak of a column with the most points within `STEP_MM` of a height, and how many."""
    height, weight = NO_GROUND, 0
    for k in range(peaks.first[at], peaks.first[at] + peaks.many[at]):
        if abs(peaks.height[k] - level) <= STEP_MM and peaks.weight[k] > weight:
            height, weight = peaks.height[k], peaks.weight[k]
    return height, weight


@kernel
def keep_levels(peaks: Peaks, before: Int32, found: Found) -> None:
    """Take the peaks that lie where ground was (C,), in columns that have none."""
    for at in range(before.size):
        if found.height[at] == NO_GROUND and before[at] != NO_GROUND:
            found.height[at], found.weight[at] = find_peak(peaks, at, before[at])


@kernel
def grow_ground(
    blocks: Blocks, peaks: Peaks, found: Found, reach: int, rounds: int, queue: Int64
) -> int:
    """Let the ground grow, in rounds, to columns up to `reach` away; return to how many.

    A column takes the peak with the most points within `STEP_MM` of what those beside it let
    expect; where no column has peaks, it takes that.

    Parameters
    ----------
    queue
        (2, C) to work with: columns that grow, or may grow next, and their height.
    """
    height, weight, _ = found
    # At first any column may have ground beside it, and then those near what has grown.
    front, grown = 0, 0
    for at in range(height.size):
        if height[at] == NO_GROUND and may_grow(peaks, at):
            front = offer(blocks, peaks, found, at, reach, queue, front)
    while front > 0 and rounds > 0:
        many = front
        for i in range(front):
            height[queue[0, i]] = queue[1, i]
        for i in range(front):
            for up in range(-reach, reach + 1):
                for right in range(-reach, reach + 1):
                    at = find_near(blocks, queue[0, i], up, right)
                    if at < 0 or height[at] != NO_GROUND or weight[at] == QUEUED:
                        continue
                    if may_grow(peaks, at):
                        weight[at] = QUEUED
                        queue[0, many] = at
                        many += 1
        begin, front = front, 0
        grown += begin
        rounds -= 1
        for i in range(begin, many):
            front = offer(blocks, peaks, found, queue[0, i], reach, queue, front)
    return grown


@step
def may_grow(peaks: Peaks, at: int) -> bool:
    """Whether a column without ground may have it: it has peaks, or no column has any."""
    return peaks.many.size == 0 or peaks.many[at] > 0


@step
def offer(
    blocks: Blocks, peaks: Peaks, found: Found, at: int, reach: int, queue: Int64, front: int
) -> int:
    """Queue a column as the one `front`, if it has ground next; return how many then are queued."""
    level, found.weight[at] = expect_level(blocks, found.height, at, reach), 0
    if peaks.many.size > 0:
        level, found.weight[at] = find_peak(peaks, at, level)
    if level == NO_GROUND:
        return front
    queue[0, front], queue[1, front] = at, level
    return front + 1


@kernel
def sum_stepped(blocks: Blocks, found: Found, at: int) -> tuple[int, int, int, int]:
    """Sum up the columns that are a step lower than one.

    They lie within half a metre, and the step is less than 30 cm, and more than 6 cm + 0.12 of
    the distance.

    Returns
    -------
    The points that they hold together; their heights (mm) times their points; and the sums of the
    ways there, up and right (columns).
    """
    height, weight, _ = found
    points, weighted, ups, rights = 0, 0, 0, 0
    for up in range(-STEPPED, STEPPED + 1):
        for right in range(-STEPPED, STEPPED + 1):
            near = find_near(blocks, at, up, right)
            if near < 0 or height[near] == NO_GROUND:
                continue
            apart, step = np.sqrt(float(up * up + right * right)), height[at] - height[near]
            if BRINK_MM + SLOPE_MM * apart < step < HIGH_MM:
                points += weight[near]
                weighted += weight[near] * height[near]
                ups += up
                rights += right
    return points, weighted, ups, rights


@kernel
def drop_raised(blocks: Blocks, found: Found, base: Int32) -> None:
    """Take low things that stand on the ground out of it: pallets, low boxes, kerbs.

    Where the columns that are a step lower hold more points together than a column does, it is no
    ground, unless the robot stood there; it takes their mean.

    Parameters
    ----------
    base
        (C,) filled: heights of the ground without them (mm).
    """
    for at in range(base.size):
        base[at] = found.height[at]
        if found.height[at] == NO_GROUND or found.stood[at]:
            continue
        points, weighted, _, _ = sum_stepped(blocks, found, at)
        if points > found.weight[at]:
            base[at] = weighted // points


@step
def find_along(blocks: Blocks, at: int, way: tuple[int, int], k: int) -> int:
    """Where the column that lies k steps from one, on a way up and right, lies; or -1."""
    up, right = way
    steps = max(abs(up), abs(right))
    return find_near(blocks, at, int(np.rint(k * up / steps)), int(np.rint(k * right / steps)))


@kernel
def goes_on(blocks: Blocks, height: Int32, at: int, up: int, right: int) -> bool:
    """Whether the surface of a column goes on for 1.5 m, on one way (columns)."""
    seen, high = 0, float(height[at])
    for k in range(1, BROAD + 1 if up or right else 0):
        near = find_along(blocks, at, (up, right), k)
        high -= SLOPE_MM
        if near >= 0 and height[near] != NO_GROUND:
            seen += 1
            high = max(high, float(height[near]))
            if high - height[near] > DROP_MM:
                return False
    return 2 * seen > BROAD


@step
def find_below(blocks: Blocks, first: Found, height: Int32, at: int) -> int:
    """The height of the ground of a column (mm); at a brink, of the lowest ground beside it.

    Points of a column at a brink are of both sides, and of the face between them. It falls by more
    on one side than it rises on the other. What was lowered since it was found first is the brink
    itself.
    """
    level: int = height[at]
    lowest = level
    for up in range(-1, 2):
        for right in range(-1, 2):
            near, back = find_near(blocks, at, up, right), find_near(blocks, at, -up, -right)
            above = max(level, height[back]) if back >= 0 else level
            is_below = near >= 0 and NO_GROUND < height[near] < 2 * level - above - BRINK_MM
            if is_below and height[near] == first.height[near]:
                lowest = min(lowest, height[near])
    return level if first.stood[at] else lowest


@kernel
def is_level(blocks: Blocks, found: Found, at: int) -> bool:
    """Whether a column is of a surface that goes on, and not at its brink."""
    height, (points, _, down, aside) = found.height, sum_stepped(blocks, found, at)
    if points == 0:  # nothing lies lower: it may go on anywhere
        for up, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            if goes_on(blocks, height, at, up, right):
                return True
        return False
    # It goes on away from what lies lower (and not where that is on all sides), and the next column
    # towards that is seen, and no brink.
    if not goes_on(blocks, height, at, -down, -aside):
        return False
    near = find_along(blocks, at, (down, aside), 1)
    is_seen = near >= 0 and height[near] != NO_GROUND
    return is_seen and find_below(blocks, found, height, at) == height[at]


@kernel
def restore_levels(blocks: Blocks, found: Found, base: Int32) -> None:
    """Give back to levels that go on, such as pavements, what was taken behind their brinks.

    Parameters
    ----------
    found
        What was found first, with all that stands on the ground.
    base
        (C,) heights of the ground without raised things (mm), changed in place.
    """
    for at in range(base.size):
        is_lowered = base[at] != NO_GROUND and found.height[at] - base[at] >= BRINK_MM
        if is_lowered and is_level(blocks, found, at):
            base[at] = found.height[at]


@kernel
def smooth_ground(blocks: Blocks, peaks: Peaks, first: Found, height: Int32, base: Int32) -> None:
    """Take the mean of all peaks around a column that lie within `ALIKE_MM` of its ground.

    Poses are off by some centimetres, and otherwise at each visit: what one visit shows of the
    ground is more often wrong than what all show.

    Parameters
    ----------
    first
        What was found first, with all that stands on the ground.
    height
        (C,) mm, as found.
    base
        (C,) filled.
    """
    for at in range(base.size):
        level = base[at] = find_below(blocks, first, height, at)
        if level == NO_GROUND:
            continue
        total, points = 0, 0
        for up in range(-SMOOTH, SMOOTH + 1):
            for right in range(-SMOOTH, SMOOTH + 1):
                near = find_near(blocks, at, up, right)
                if near < 0 or height[near] == NO_GROUND:
                    continue
                for k in range(peaks.first[near], peaks.first[near] + peaks.many[near]):
                    if abs(peaks.height[k] - level) <= ALIKE_MM:
                        total += peaks.weight[k] * peaks.height[k]
                        points += peaks.weight[k]
        if points:
            base[at] = total // points
