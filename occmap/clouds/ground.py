"""The ground below a drive: derived from what all clouds show, before any of them is traced."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.clouds import FLAT, CloudOptions
from occmap.clouds.counting import Counted, thin_path
from occmap.clouds.kernels import growth, heights
from occmap.clouds.kernels.growth import BLOCK, STRAY, Blocks, Found, Layer, Peaks, index_blocks
from occmap.clouds.kernels.heights import BIN_MM, Histogram, Pieces
from occmap.errors import MapError
from occmap.report import join_names
from occmap.sensor import Sensor
from occmap.types import BLOCK_BITS, COLUMN_MM, NO_GROUND, Bool, Float64, Int32, Int64

DEPTHS, DEPTHS_IN_MAP = (100, 3000), (-300, 3000)
"""The ground lies so far below a sensor (mm), or below what is known of its place where clouds are
in the map already: often where the robot stands."""
BESIDE, UNDER = 7, 2
"""Columns beside the path that the ground grows from, and that the robot stands on"""
FEWEST_SEEDS, AROUND = 100, 80
"""Where fewer columns under the path show anything, the robot hardly moved, or never sees its way.
What lies near it may be tables: the ground is what lies low in so many columns around."""
LOWEST_SHARE, APART_MM = 0.25, 300
"""Such a share of these shows the ground, or another level, so far above or below"""
HIDDEN_SHARE = 0.1
"""Such a share shows the ground where a roof of the robot, of many points, hides it elsewhere"""
AS_HIGH_MM = 50
"""Sensors whose heights above the ground differ by no more count as one."""
KNOWN_POINTS = 1000
"""Points that are taken to show ground that is known"""
NO_PEAKS = Peaks(*np.zeros((4, 0), np.int32))
REACHES = (1, 2, 4, 8, 16)
"""How far the ground reaches over columns without points (columns), one after the other"""
ROUNDS = 4
SQUARE_MM, STOREY_MM = 1000, 1800
"""Where a path comes by a square again, so much higher, it is on another storey"""
FILLED = 10
"""Columns so far from measured ground have ground"""
DEEP_MM, FEWEST_POINTS = 300, 2
"""So many points of a column that lie so deep below the ground around it show a hole"""
ALL_FAR = f"no point of any cloud lies within {heights.FAR_M:g} m of its sensor"
NO_FLOOR = "no ground is seen below the sensor along its way"
GIVE_HEIGHT = (
    "see in `occmap check` if the mount is wrong, else give `sensor_height=M`, or a plane: "
    "`ground=flat` `sensor_height=M`"
)
LEAST_WAY, OWN_SHARE = 20, 0.3
"""Of so many columns of the sensor's way, on drives that do not see their robot, points stand in at
most 5%; where it, or who walks behind it, is seen, in 60% and more"""
ITSELF = "the robot itself, which `footprint` or `min_range` leaves out"
LITTLE = 0.25
"""In a smaller share of the columns hardly any floor was seen: corridors have 0.7, streets 0.36"""
LITTLE_FLOOR = (
    "hardly any floor is seen: if clouds were cut above it, give a plane by `ground=flat` "
    "`sensor_height=M`, else see if mount and height of the sensor are right"
)
LEVEL_MM, LEVEL_SHARE, LEAST_LEVEL = 50, 0.95, 500
"""So many columns, of which such a share lies within this distance of one plane, are a floor of one
level, which goes on where nobody saw it. A street has 0.4 there, a hall with a platform 0.8"""
LEVEL_FILLED = 128
"""It goes on over so many columns"""


def derive_ground(
    counted: Counted,
    options: CloudOptions,
    known: Ground | None = None,
    before: Ground | None = None,
) -> tuple[Ground, list[str]]:
    """Find the ground below the drive, and say what there is to say of it.

    Parameters
    ----------
    known
        Ground that stays as it is, from where more grows.
    before
        What was found first, on which the clouds were laid that were counted.

    Raises
    ------
    MapError
        No ground is found.
    """
    columns = read_columns(counted.table, counted.path, known)
    blocks = columns.blocks
    if not columns.filled:
        seen = [points[:, 2] for _, points in counted.views.values()]
        apart = np.abs(np.concatenate([np.zeros(0), *seen]) - counted.path[:1, 2] / 1000)
        if (apart > heights.FAR_M).sum() > len(apart) / 2:
            raise MapError(ALL_FAR, fix="points and places are metres: are these millimetres?")
    seats = list_seats(columns, counted.paths, options.sensor_height)
    stood = np.concatenate([each.path - [0, 0, each.height] for each in seats])
    if options.ground == FLAT:
        return make_flat(stood), [f"{tell_heights(seats)} above the plane taken for the ground"]
    laid = known and known.lay_out(blocks.places)
    was = None if before is None else list_levels(before.lay_out(blocks.places))
    height = grow(columns, seats, laid, was)
    measured = height != NO_GROUND
    if not measured.any():
        raise MapError(NO_FLOOR, fix=GIVE_HEIGHT)
    fill_around(blocks, height)
    holes, stands = find_holes(columns, height, measured, options)
    if laid is not None:
        holes |= list_known_holes(blocks, laid, measured)
    height[holes] = NO_GROUND
    shown = np.count_nonzero(measured & (columns.peaks.many > 0))  # others may be known
    note = (
        f"{tell_heights(seats)} above the ground, which was found for {shown:,} of "
        f"{columns.filled:,} columns of 0.15 m"
    )
    notes = [note] if shown >= LITTLE * columns.filled else [note, LITTLE_FLOOR]
    notes += [*list_storeys(stood), *list_others(seats)]
    notes += list_own(columns, counted.path, height, stands)
    return pack_ground(blocks, height, measured), notes


def list_levels(ground: Ground) -> Int32:
    """The heights of the columns of ground (C,; mm), where points showed it."""
    return np.where(ground.measured, ground.height_mm, np.int32(NO_GROUND)).ravel()


class Shown(NamedTuple):
    """What points show of columns."""

    blocks: Blocks
    peaks: Peaks
    filled: int
    """How many columns hold points"""
    pieces: Pieces
    """What was counted"""


class Seat(NamedTuple):
    """Where sensors sit that are as high above the ground."""

    sensors: tuple[Sensor, ...]
    path: Int64
    """(P, 3) where they went (mm)"""
    height: int
    """How high above the ground (mm)"""
    layer: Layer
    """Where the ground begins"""
    beside: int
    """So far beside the path the ground is looked for (columns)"""
    upper: int
    """How high they are above a higher level, which may be the ground (mm); 0: there is none"""
    lower: int
    """Likewise above a lower one, where the robot itself may have been taken for the ground"""


def grow(
    columns: Shown, seats: Sequence[Seat], known: Ground | None, before: Int32 | None
) -> Int32:
    """Let the ground grow from under the path, without what is low and stands on it (C,).

    It grows twice: what it reached only over a low thing or up a kerb, it then loses.

    Parameters
    ----------
    columns
        Peaks of what is low are written over.
    known
        Ground that stays as it is.
    before
        (C,) what was found first (mm). Levels that are not reached go on from there: a kerb that
        poses blur is a way up, and a sharp one is none.
    """
    blocks, height = columns.blocks, np.empty_like(columns.peaks.first)
    first = grow_all(columns, seats, known, before)
    drop_low(columns, first, height)
    drop_low(columns, grow_all(columns, seats, known, before), height)
    growth.restore_levels(blocks, first, height)
    smooth = np.empty_like(height)
    growth.smooth_ground(blocks, columns.peaks, first, height, smooth)
    keep_known(known, first._replace(height=smooth))
    return smooth


def grow_all(
    columns: Shown, seats: Sequence[Seat], known: Ground | None, before: Int32 | None
) -> Found:
    """Let the ground grow with all that stands on it; parameters are those of `grow`."""
    found = find_nothing(columns)
    for seat in seats:
        look_beside(columns, seat.path, (seat.beside, UNDER), seat.layer, found)
    keep_known(known, found)
    go_on(columns, found)
    if before is not None:
        growth.keep_levels(columns.peaks, before, found)
        go_on(columns, found)
    return found


def go_on(columns: Shown, found: Found) -> None:
    """Let the ground grow to the columns beside it, and over gaps."""
    blocks, peaks, every = columns.blocks, columns.peaks, len(found.height)
    queue = np.empty((2, every), np.int64)
    for apart in REACHES:
        if growth.grow_ground(blocks, peaks, found, apart, every, queue) and apart > 1:
            growth.grow_ground(blocks, peaks, found, 1, every, queue)


def drop_low(columns: Shown, found: Found, height: Int32) -> None:
    """Fill the heights of the ground (C,; mm) without low things, which show nothing else then.

    That is written over the first of their peaks, since a copy of all would take much memory.
    """
    growth.drop_raised(columns.blocks, found, height)
    low, peaks = np.flatnonzero(height != found.height), columns.peaks
    first = peaks.first[low]
    peaks.many[low], peaks.height[first], peaks.weight[first] = 1, height[low], found.weight[low]


def fill(blocks: Blocks, height: Int32, rounds: int, peaks: Peaks = NO_PEAKS) -> None:
    """Fill columns without ground (C,) from those beside them, one ring a round.

    They take the mean of these, or a peak near it where there are peaks.
    """
    found = Found(height, np.zeros(len(height), np.int32), np.zeros(0, np.bool_))
    growth.grow_ground(blocks, peaks, found, 1, rounds, np.empty((2, len(height)), np.int64))


def fill_around(blocks: Blocks, height: Int32) -> None:
    """Fill columns around measured ground (C,); a floor of one level goes on as its plane."""
    plane = find_level_floor(blocks, height)
    fill(blocks, height, FILLED)
    if plane is not None:
        beyond = height == NO_GROUND
        fill(blocks, height, LEVEL_FILLED - FILLED)
        at = np.flatnonzero(beyond & (height != NO_GROUND))
        height[at] = np.rint(plane.find_heights(list_places(blocks, at)))


def find_holes(
    columns: Shown, height: Int32, measured: Bool, options: CloudOptions
) -> tuple[Bool, Bool]:
    """Find columns (C,) that have no ground, since points lie deep below where it would be.

    Holes go on to the columns around, as far as ground is filled in, if no ground was measured in
    them and nothing that stands on it.

    Returns
    -------
    Which have none, and on which something stands.
    """
    deep, standing = np.zeros((2, len(height)), np.int32)
    heights.count_apart(columns.pieces, height, (-DEEP_MM, *options.band_mm), deep, standing)
    stands = standing >= FEWEST_POINTS
    is_open = ~measured & (height != NO_GROUND) & ~stands
    reached = np.where(~measured & (deep >= FEWEST_POINTS), np.int32(0), np.int32(NO_GROUND))
    del deep, standing  # which take much memory
    # A hole goes on as ground does: at a height of 0, to open columns, which share a peak there.
    zero, one = np.zeros(1, np.int32), np.ones(1, np.int32)
    ways = Peaks(np.zeros(len(height), np.int32), is_open.astype(np.int32), zero, one)
    fill(columns.blocks, reached, FILLED, ways)
    return is_open & (reached == 0), stands


def list_known_holes(blocks: Blocks, known: Ground, measured: Bool) -> Bool:
    """List columns (C,) beside known ground that have none in it, and none was measured now."""
    around = list_levels(known)
    fill(blocks, around, FILLED)
    return np.asarray(~measured & (around != NO_GROUND) & (known.height_mm == NO_GROUND).ravel())


def find_nothing(columns: Shown) -> Found:
    """Begin to look for the ground of columns."""
    height = np.full_like(columns.peaks.first, NO_GROUND)
    return Found(height, np.zeros(len(height), np.int32), np.zeros(len(height), np.bool_))


def look_beside(
    columns: Shown, path: Int64, reach: tuple[int, int], layer: Layer, found: Found
) -> Int64:
    """Add to the ground what lies so deep below a sensor, beside its path.

    Returns
    -------
    Int64
        (N,) how deep each of these lies, to `BIN_MM`.
    """
    depths = np.zeros((layer.most - layer.least) // BIN_MM + 1, np.int64)
    growth.look_beside(columns.blocks, columns.peaks, path, reach, layer, found, depths)
    return np.repeat(layer.least + np.arange(len(depths)) * BIN_MM + BIN_MM // 2, depths)


class Plane(NamedTuple):
    """A floor of one level."""

    start: Int64
    """(2, 1) row and column of a place on it"""
    level: float
    """How high it is there (mm)"""
    right: float
    up: float
    """By how much it rises (mm) to the next column and to the next row"""

    def find_heights(self, places: Int64 | Float64) -> Float64:
        """Find how high it is (mm) in some places (2, N), counted in columns."""
        up, right = places - self.start
        return np.asarray(self.level + self.right * right + self.up * up)


def list_places(blocks: Blocks, at: Int64) -> Int64:
    """(2, N) the rows and columns of some columns, by where they lie in flat arrays."""
    places = blocks.places[at >> 2 * BLOCK_BITS].T * BLOCK
    places[0] += (at >> BLOCK_BITS) % BLOCK
    places[1] += at % BLOCK
    return np.asarray(places)


def find_level_floor(blocks: Blocks, height: Int32) -> Plane | None:
    """Find the plane of measured ground (C,); give None where it has none."""
    at = np.flatnonzero(height != NO_GROUND)
    if len(at) < LEAST_LEVEL:
        return None
    plane, off = fit_plane(list_places(blocks, at), height[at], np.ones_like(at, np.bool_))
    return plane if np.count_nonzero(np.abs(off) < LEVEL_MM) >= LEVEL_SHARE * len(at) else None


def fit_plane(places: Int64, level_mm: Int32, used: Bool) -> tuple[Plane, Float64]:
    """Fit a plane to places (2, N) and their levels (N,), at first to those that are used.

    It does not lean aside where these lie in a row. Sums are of integers, so that their order does
    not count.

    Returns
    -------
    The plane, and how high above it each place lies (N,; mm).
    """
    start = places[:, :1]
    up, right = places - start
    known = np.stack([np.ones_like(up), right, up], dtype=np.int32, casting="same_kind")
    del up, right  # which take much memory
    for _ in range(ROUNDS):
        # No place is copied, as there may be many.
        squares = np.einsum("in,jn,n->ij", known, known, used, dtype=np.int64)
        heights = np.einsum("in,n,n->i", known, level_mm, used, dtype=np.int64)
        plane = Plane(start, *np.linalg.lstsq(squares, heights, rcond=None)[0].tolist())
        off = level_mm - plane.find_heights(places)
        used = np.abs(off) < 3 * max(float(np.median(np.abs(off[used]))), LEVEL_MM / 3)
    return plane, off


def tell_heights(seats: Sequence[Seat]) -> str:
    """Say how high the sensors are, and which is which where that differs."""
    heights_m = [f"{each.height / 1000:.2f} m" for each in seats]
    if len(seats) == 1:
        return f"the sensor is {heights_m[0]}"
    names = [join_names(f"{log} {topic}" for log, topic, _ in each.sensors) for each in seats]
    told = zip(heights_m, names, strict=True)
    return "the sensors are " + ", ".join(f"{height} ({name})" for height, name in told)


def list_storeys(stood: Int64) -> Iterator[str]:
    """Say if a path (P, 3; mm) goes over itself, since there is one ground in each place."""
    _, place = np.unique(stood[:, :2] // SQUARE_MM, axis=0, return_inverse=True)
    low, high = np.full(len(stood), 1 << 40), np.full(len(stood), -1 << 40)
    np.minimum.at(low, place, stood[:, 2])
    np.maximum.at(high, place, stood[:, 2])
    over = np.count_nonzero(high - low > STOREY_MM)
    if over:
        yield (
            f"the sensor went over its own way, more than {STOREY_MM / 1000:g} m above it, in "
            f"{over} places: if z is up in the poses, map each storey by itself, with `start_s` "
            "and `end_s`"
        )


def list_others(seats: Sequence[Seat]) -> Iterator[str]:
    """Say if the ground may be another level than the one that was taken."""
    for each in seats:
        taken = f"the ground is taken to lie {each.height / 1000:.2f} m below the sensor, and what "
        if each.upper:
            yield (
                f"{taken}is seen {each.upper / 1000:.2f} m below it to stand there, as tables do: "
                "if the robot drives on that, or the floor mirrors, give "
                f"`sensor_height={each.upper / 1000:.2f}`, unless `occmap check` says that the "
                f"mount is wrong; it may also be {ITSELF}"
            )
        if each.lower:
            yield (
                f"{taken}is seen {each.lower / 1000:.2f} m below it to be mirrored, or a hole: but "
                f"the first may be {ITSELF}"
            )


def list_own(columns: Shown, path: Int64, height: Int32, stands: Bool) -> Iterator[str]:
    """Say if points stand on the ground (C,; mm) where sensors went themselves, along their path.

    What is in the way of a robot cannot be where it drove.
    """
    way = find_nothing(columns)
    look_beside(columns, path, (0, 0), Layer(0, 0, 0), way)
    own = stands[way.stood & (height != NO_GROUND)]
    if len(own) >= LEAST_WAY and own.mean() > OWN_SHARE:
        yield (
            f"something stands in {own.mean():.0%} of the columns that the sensor itself went "
            f"over: people who walk behind it, or {ITSELF}"
        )


def read_columns(table: Histogram, path: Int64, known: Ground | None) -> Shown:
    """Read what was counted of columns around a path (P, 3; mm), and lay them out in blocks."""
    keys = table.keys[: int(table.used[0])]
    order = np.argsort(keys)  # column by column, and in each from the lowest piece
    # Counts stay where they are, as they may be most of what is in memory.
    keys, is_counted = keys[order], order.astype(np.int32)
    is_next = np.diff(keys >> heights.PIECE_BITS, prepend=-1) != 0
    places = unpack_columns(keys[is_next], path)
    many = np.zeros(len(places), np.int32)
    level, weight = np.empty((2, 8 * len(keys) + 8), np.int32)
    column = np.cumsum(is_next, dtype=np.int32) - 1
    pieces = Pieces(column, keys, is_counted, table.counts)
    found = heights.list_peaks(pieces, np.empty(heights.ROOM, np.int64), many, level, weight)
    blocks = make_blocks(places, known)
    at = find_columns(blocks, places)
    first, of_column = np.zeros((2, len(blocks.places) << 2 * BLOCK_BITS), np.int32)
    first[at], of_column[at] = np.cumsum(many) - many, many
    peaks = Peaks(first, of_column, level[:found].copy(), weight[:found].copy())
    return Shown(blocks, peaks, len(places), pieces._replace(column=at.astype(np.int32)[column]))


def unpack_columns(keys: Int64, path: Int64) -> Int64:
    """(N, 2) rows and columns of the columns of some keys, the ones that are nearest to a path.

    A key has them modulo `WIDE`; a path has at least one place wherever there are keys.
    """
    columns = keys >> heights.PIECE_BITS
    packed = np.stack([columns // heights.WIDE, columns % heights.WIDE], axis=1)
    start = path[:1, 1::-1] // COLUMN_MM - heights.WIDE // 2
    return np.asarray(start + (packed - start) % heights.WIDE)


def find_columns(blocks: Blocks, places: Int64) -> Int64:
    """Where columns (N, 2) that blocks hold lie in flat arrays."""
    block = blocks.table[tuple(((places >> BLOCK_BITS) - blocks.corner).T)].astype(np.int64)
    row, col = places.T % BLOCK
    return np.asarray((block << 2 * BLOCK_BITS) | (row << BLOCK_BITS) | col)


def make_blocks(columns: Int64, known: Ground | None) -> Blocks:
    """Lay out blocks around columns (N, 2), with room for what is filled beside them."""
    held = columns >> BLOCK_BITS
    # As one number each, of which NumPy finds the different ones thirty times as fast.
    held = held[np.unique((held[:, 0] << 32) + held[:, 1], return_index=True)[1]]
    around = [held + np.array(way) for way in product((-1, 0, 1), repeat=2)]
    if known is not None:
        around.append(known.blocks)
    return index_blocks(np.unique(np.concatenate(around), axis=0))


def list_seats(columns: Shown, paths: Mapping[Sensor, Int64], given_m: float | None) -> list[Seat]:
    """Measure how high each sensor is above the ground; those that are as high count as one.

    Raises
    ------
    MapError
        Nothing lies below any of them, or there is no path.
    """
    if not paths:
        fix = "`occmap check` shows why: damage, times without poses, turns between key frames"
        raise MapError("no cloud that is asked for has points and a pose", fix=fix)
    alone = [measure_seat(columns, {each: path}, given_m) for each, path in paths.items()]
    alike, highest = list[dict[Sensor, Int64]](), 0
    for seat in sorted(filter(None, alone), key=lambda each: each.height):
        if not alike or seat.height - highest > AS_HIGH_MM:
            alike.append({})
        alike[-1][seat.sensors[0]], highest = seat.path, seat.height
    seats = [measure_seat(columns, some, given_m) for some in alike]
    if not seats:
        raise MapError(NO_FLOOR, fix=GIVE_HEIGHT)
    return list(filter(None, seats))


def measure_seat(
    columns: Shown, paths: Mapping[Sensor, Int64], given_m: float | None
) -> Seat | None:
    """Measure how high sensors are: the median depth of peaks under their path.

    Where there are few, it is the depth of the lowest plane around.

    Returns
    -------
    Seat or None
        None where nothing lies below them, and no height is given.
    """
    sensors, under = tuple(paths), find_nothing(columns)
    path = thin_path(np.concatenate([*paths.values()]))
    band = DEPTHS if all(frame for *_, frame in sensors) else DEPTHS_IN_MAP
    seen = look_beside(columns, path, (UNDER, 0), Layer(*band, STRAY), under)
    beside, share, lean = BESIDE, 0.5, (0.0, 0.0)
    if np.count_nonzero(under.height != NO_GROUND) < FEWEST_SEEDS:
        beside, share = AROUND, 1 - LOWEST_SHARE
        seen, lean = look_around(columns, path[len(path) // 2], band)
    given = None if given_m is None else (round(given_m * 1000), 150, 0, 0)
    if given is None and not len(seen):
        return None
    depth, spread, *others = given or measure_level(seen, share)
    layer = Layer(depth - spread, depth + spread, STRAY, *lean)
    return Seat(sensors, path, depth, layer, beside, *others)


def measure_level(seen: Int64, share: float) -> tuple[int, int, int, int]:
    """Measure the level that lies as deep as such a share of depths (N,; mm).

    Returns
    -------
    How deep it is, by how much that differs, and how deep others above and below it are, or 0.
    """
    middle = find_quantile(seen, share)
    here, above = seen[np.abs(seen - middle) <= APART_MM], seen[seen < middle - APART_MM]
    below = seen[seen > middle + APART_MM]
    depth = find_quantile(here, 0.5)
    spread = int(np.clip(4 * find_quantile(np.abs(here - depth), 0.5) + 60, 140, 450))
    upper = find_quantile(above, 0.5) if len(above) >= LOWEST_SHARE * len(seen) else 0
    lower = find_quantile(below, 0.5) if len(below) >= HIDDEN_SHARE * len(seen) else 0
    return depth, spread, upper, lower


def look_around(
    columns: Shown, place: Int64, band: tuple[int, int]
) -> tuple[Int64, tuple[float, float]]:
    """Find how deep below a place (3,) of a sensor, within a band, lies what is around it.

    A floor may lean: a plane is fitted to what lies low, and all that is near it. Each depth is the
    one that a plane like this has below the sensor. It is level where that is no floor.

    Returns
    -------
    Depths (N,; mm), and by how much the plane rises (mm) to the next column and row.
    """
    around = find_nothing(columns)
    look_beside(columns, place[None], (AROUND, 0), Layer(*band, 1), around)
    at = np.flatnonzero(around.height != NO_GROUND)
    if not len(at):
        return at, (0.0, 0.0)
    places, level = list_places(columns.blocks, at), around.height[at]
    low = np.abs(level - find_quantile(level, LOWEST_SHARE)) <= APART_MM
    plane, off = fit_plane(places, level, low)
    under = plane.find_heights(place[1::-1, None] / COLUMN_MM - 0.5)
    # A laser that measures in one plane sees that, and no floor.
    is_steep = math.hypot(plane.right, plane.up) > heights.RISE * COLUMN_MM
    if is_steep or not band[0] <= place[2] - under[0] <= band[1]:
        return place[2] - level.astype(np.int64), (0.0, 0.0)
    return np.rint(place[2] - under - off).astype(np.int64), (plane.right, plane.up)


def find_quantile(seen: Int32 | Int64, share: float) -> int:
    """Find the one of some numbers than which such a share is no larger."""
    return int(np.quantile(seen, share, method="inverted_cdf"))


def keep_known(known: Ground | None, found: Found) -> None:
    """Let ground that is known, in its place, stay as if the robot had stood there."""
    if known is not None:
        there = known.measured.ravel()
        found.height[there] = known.height_mm.ravel()[there]
        found.weight[there], found.stood[there] = KNOWN_POINTS, True


def pack_ground(blocks: Blocks, height: Int32, measured: Bool) -> Ground:
    """Keep the blocks that have ground."""
    levels, seen = (each.reshape(len(blocks.places), -1) for each in (height, measured))
    kept = (levels != NO_GROUND).any(axis=1)
    return Ground(blocks.places[kept], levels[kept], seen[kept])


def make_flat(stood: Int64) -> Ground:
    """Make a plane where robots stood (P, 3), as far as points count; all in mm."""
    side, reach = COLUMN_MM * BLOCK, round(heights.FAR_M * 1000)
    low, high = (stood.min(axis=0) - reach) // side, (stood.max(axis=0) + reach) // side
    rows, cols = (np.arange(low[axis], high[axis] + 1) for axis in (1, 0))
    places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    level = math.floor(np.median(stood[:, 2]))
    height = np.full((len(places), BLOCK**2), level, np.int32)
    return Ground(places, height, np.ones(height.shape, np.bool_))
