"""The ground below the drives of a build: found in a pass of its own, with the map laid flat.

Heights of poses that drift are corrected on the way, and known ground goes on below new clouds.
This module is loaded for clouds alone: it brings numba, which takes longer than all else together.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.cells import Ground
from occmap.clouds import FLAT, counting
from occmap.clouds.counting import Counted, Counter, join_counted, list_apart
from occmap.clouds.ground import derive_ground
from occmap.clouds.robot import BODY_PLACES
from occmap.errors import MapError, name_log
from occmap.evidence import UNEVEN_SHARE, refuse_other
from occmap.options import BuildOptions
from occmap.posing import NO_DRIFT, Drift, measure_drift
from occmap.posing.chain import place_logs, tilt
from occmap.report import Note, join_names
from occmap.scans import encode_cells
from occmap.scans.stream import Drive, Selector
from occmap.scans.tally import Tally
from occmap.sensor import place_voxels
from occmap.threads import Threads
from occmap.types import BLOCK_BITS, COLUMN_MM, IDENTITY, NO_GROUND, Float64, Int64

LEAST_LEAN_DEG = 1.0
"""Walls of a map that leans by less are sharp enough."""
BEGIN_M = 100.0
"""SLAM that knows no gravity begins at the zero of its map"""
UPRIGHT_CELL_M = 0.05
"""Side of the cells that tell if walls stand upright"""
SHARPER = 0.005
"""Walls that lean by a degree spread by 0.01 more; where walls are few, chance makes 0.002"""
LEAST_OVERLAP = 0.25
"""Grounds that share less of the smaller one saw that from afar, where poses put it elsewhere."""
MOST_BEYOND = 0.1
"""At the edge of what they saw, sessions in one place differ by a few hundredths."""
OTHER_SHARE = 0.75
"""Poses that are off by tenths of a degree put half of the ground elsewhere, up and down."""
CLEARER = 1.02
"""Heights of poses are corrected where that makes the floor so much sharper."""
LEVEL_ROUNDS = 3
"""A floor that leans much shows its angle roughly at first."""


class BuildGround(NamedTuple):
    """The ground below all drives of a build."""

    ground: Ground
    notes: list[str]
    """What there is to say of it"""
    options: BuildOptions
    """With the angles by which its floor is laid flat"""


def find_ground(drives: list[Drive], options: BuildOptions, known: Ground | None) -> BuildGround:
    """Find the ground below all drives, in a pass of its own.

    Parameters
    ----------
    drives
        Whose poses are taken.
    known
        Ground of evidence that the build is added to; it stays as it is.

    Raises
    ------
    MapError
        There is none, or it lies elsewhere than what is known.
    """
    clouds = sum(drive.scans for drive in drives)

    def count(options: BuildOptions, ground: Ground | None) -> Counted:
        renewed = (drive.renew(options) for drive in drives)
        return join_counted(count_ground(each, clouds, ground) for each in renewed)

    with name_log(join_names(str(drive.log.path) for drive in drives)):
        return settle_ground(count, options, known)


Count: TypeAlias = Callable[[BuildOptions, Ground | None], Counted]
"""Reads all clouds, and counts what they show of the ground; they may be laid on some first"""


def settle_ground(count: Count, options: BuildOptions, known: Ground | None) -> BuildGround:
    """Find the ground, and once more by clouds that are laid on it, which poses blur less."""
    counted, is_flat = count(options, None), options.clouds.ground == FLAT
    if known is None or is_flat:  # a plane does not go on from it
        first = level_ground(count, counted, options)
    else:
        first = extend_ground(counted, options, known)
    if first.ground is known:
        return first
    if is_flat:
        if known:
            rise, fix = known.measure_rise(first.ground), "leave out `ground=flat`"
            refuse_other(rise, UNEVEN_SHARE, options.posing.transform or IDENTITY, fix)
        _, notes = derive_ground(counted, options.clouds)
        return first._replace(notes=[*notes, *first.notes])
    posing = first.options.posing
    settled = replace(posing, height_drift=posing.height_drift or NO_DRIFT)
    del counted  # what is counted may be most of what is in memory
    counted = count(replace(first.options, posing=settled), first.ground)
    ground, notes = derive_ground(counted, options.clouds, known, before=first.ground)
    return BuildGround(ground, [*notes, *first.notes], first.options)


def level_ground(count: Count, counted: Counted, options: BuildOptions) -> BuildGround:
    """Find the ground, and lay a map flat of which the floor leans, and the walls with it.

    SLAM that knows no gravity has its map in the frame of the first cloud, however the sensor was
    held. Of a street that climbs the walls stand upright, and it stays as it is.
    """
    level = 0.0, 0.0
    found = keep_found(counted, options, derive_ground(counted, options.clouds)[0])
    if options.posing.level is not None:
        return found
    place = place_logs(options.posing)
    start, turned = place.position[0], place.rotation[0]
    if np.linalg.norm(counted.path / 1000 - start, axis=1).min(initial=np.inf) >= BEGIN_M:
        return found
    views = [points - start for points in list_apart(counted.views)]
    for _ in range(LEVEL_ROUNDS):
        wanted = find_level(found.ground, turned @ tilt(level).rotation[0])
        if math.dist(wanted, level) < LEAST_LEAN_DEG:
            break
        before, after = (
            measure_walls(views, turned @ tilt(angles).rotation[0].T) for angles in (level, wanted)
        )
        if after.spread > before.spread - SHARPER or after.shared < before.shared:
            break
        level = wanted
        laid = replace(options, posing=replace(options.posing, level=level))
        counted = count(laid, None)
        found = keep_found(counted, laid, derive_ground(counted, options.clouds)[0])
    if any(level):
        found.notes.append(
            f"the floor leans by {math.hypot(*level):.1f} degrees in the map of the poses, and the "
            "walls with it: it is laid flat, as `level=({:g},{:g})` does; `level=(0,0)` leaves it "
            "as it is".format(*level)
        )
    return found


APART = 8
"""Slopes of the ground are measured over so many columns."""


def measure_slope(ground: Ground) -> tuple[float, float]:
    """Measure how steep most of the ground is, along x and along y; a ramp among floors is not."""
    height, slopes = ground.height_mm.reshape(-1, 1 << BLOCK_BITS, 1 << BLOCK_BITS), []
    known = ground.measured.reshape(height.shape) & (height != NO_GROUND)
    to_x, to_y = (np.s_[:, :, APART:], np.s_[:, :, :-APART]), (np.s_[:, APART:], np.s_[:, :-APART])
    for there, here in (to_x, to_y):
        rise = (height[there] - height[here])[known[there] & known[here]]
        slopes.append(float(np.median(rise)) / (APART * COLUMN_MM) if rise.size else 0.0)
    return slopes[0], slopes[1]


def find_level(ground: Ground, turned: Float64) -> tuple[float, float]:
    """Find the roll and pitch (degrees) that lay most of the ground flat.

    Parameters
    ----------
    turned
        (3, 3) how the frame that they are for is turned in that of the ground.
    """
    along, aside = measure_slope(ground)
    x, y, z = turned.T @ [-along, -aside, 1.0]
    roll, pitch = math.degrees(math.atan2(y, z)), -math.degrees(math.atan2(x, math.hypot(y, z)))
    return round(roll, 2) + 0.0, round(pitch, 2) + 0.0  # no negative zero


def extend_ground(counted: Counted, options: BuildOptions, known: Ground) -> BuildGround:
    """Let known ground go on below clouds, unless it is given as it is.

    Raises
    ------
    MapError
        Most of the ground that the clouds show lies elsewhere, or they show none to go on with.
    """
    is_whole, notes = options.clouds.file is not None, list[str]()
    try:
        own, _ = derive_ground(counted, options.clouds)
    except MapError:
        if not is_whole:
            raise
    else:
        rise = known.measure_rise(own)
        logs = dict.fromkeys(log for log, _, _ in counted.paths)
        fix = "see in `occmap check` if poses, mount or `level` are wrong"
        beyond = 1 - len(rise) / own.measured.sum()
        if is_whole and beyond > MOST_BEYOND:
            notes.append(
                f"{beyond:.0%} of the ground that these clouds show was not measured in "
                f"{options.clouds.file}: what lies there may be unknown or wrong, and `resume` "
                "without `ground` lets the ground grow"
            )
        if len(rise) >= LEAST_OVERLAP * min(own.measured.sum(), known.measured.sum()):
            with name_log(join_names(logs)):
                refuse_other(rise, OTHER_SHARE, options.posing.transform or IDENTITY, fix)
    ground = known if is_whole else derive_ground(counted, options.clouds, known)[0]
    found = keep_found(counted, options, ground)
    return found._replace(notes=[*notes, *found.notes])


def keep_found(counted: Counted, options: BuildOptions, ground: Ground) -> BuildGround:
    """Keep by what heights were corrected, and what was left out, and say so."""
    notes: list[str] = [
        Note(
            f"heights of poses drift by {measure_drift(drift):.2f} m, as the floor shows where the "
            "drive comes by again: they are corrected; `height_drift=off` leaves them"
        ).placed(log)
        for log, drift in counted.drifts.items()
    ]
    if counted.drifts:
        options = replace(options, posing=replace(options.posing, height_drift=counted.drifts))
    for (log, topic, _), body in counted.bodies.items():
        metres = np.linalg.norm(place_voxels(np.array(body)), axis=1)
        notes.append(
            Note(
                f"what stays at one place around the sensor of {topic} wherever it goes, "
                f"{metres.min():.1f} to {metres.max():.1f} m from it, is left out: it is the robot "
                "itself, or who goes with it; `own_points=off` keeps it"
            ).placed(log)
        )
    if counted.bodies:
        options = replace(options, clouds=replace(options.clouds, own_points=counted.bodies))
    return BuildGround(ground, notes, options)


class Walls(NamedTuple):
    """How sharp walls are, seen from above, in cells of two lattices."""

    spread: float
    """Over how many cells their points spread (the entropy): upright walls fill few"""
    shared: float
    """How many pairs of points of different clouds lie in one cell.

    Where a robot climbs, the columns of its lidar's beams lean with it, and by itself each cloud is
    sharper once they are upright, as its walls are not. What different clouds share is the walls.
    """


def measure_walls(views: Sequence[Float64], turned: Float64) -> Walls:
    """Measure walls by points (N, 3) of each view, in a map (3, 3) that is turned in theirs."""
    # Without their heights a product is so small that BLAS waits for no other thread.
    places = [points @ turned[:, :2] for points in views]
    spread, shared = 0.0, 0.0
    # Walls along an axis may fill one cell or two: the second lattice is half a cell aside.
    for aside in (0.0, UPRIGHT_CELL_M / 2):
        numbers = [encode_cells(each + aside, UPRIGHT_CELL_M) for each in places]
        many = np.concatenate([np.unique(each, return_counts=True)[1] for each in numbers])
        together = np.unique(np.concatenate(numbers), return_counts=True)[1]
        share = together / together.sum()
        spread -= float((share * np.log(share)).sum()) / 2
        shared += float((together**2).sum() - (many**2).sum())
    return Walls(spread, shared)


def count_ground(drive: Drive, clouds: int, ground: Ground | None) -> Counted:
    """Count what the clouds of a drive show of the ground, and correct heights that drift.

    Parameters
    ----------
    clouds
        How many the build has.
    ground
        On which they are laid first; None: they stay as they are.
    """
    log, posing = str(drive.log.path), drive.options.posing
    nearest = drive.options.returns.min_range
    places = BODY_PLACES if drive.options.clouds.own_points is None else 0
    share = drive.scans / max(clouds, 1)
    views = max(math.ceil(counting.UPRIGHT_CLOUDS * share), counting.LOG_CLOUDS)

    def read() -> Counter:
        for _ in drive.rounds():  # the second time without clouds that leap away
            counter = Counter(clouds, log, ground, (views, places), nearest)
            selector = Selector(drive.options, counter.wants)
            with name_log(log), Threads(counter.add, drive.options.jobs) as threads:
                for posed in drive.read(Tally(), selector):
                    threads.give(posed)
        return counter

    counter = read()
    best = counter.count()
    for drift in list_drifts(counter.way) if posing.height_drift is None else ():
        drive.poser.drift = drift
        corrected = read().count()
        if corrected.sharpness > CLEARER * best.sharpness:
            best = corrected._replace(drifts={log: drift})
    return best


SQUARES_M = 0.25, 3.5
"""Sides of the squares in which a drive comes by again: where it was, and in a lane beside it"""
AGAIN_S = 10.0
"""It left, and came by again, if that took longer."""
STOREY_M = 1.5
"""What lies higher is another floor."""
FEWEST_PASSES, LEAST_DRIFT_M = 10, 0.03
"""Where a drive comes by less often, or heights differ by less, nothing drifts."""
MOST_PARTS, MOST_STEPS = 500, 100_000
"""Drift is linear in so many parts of a drive, which is followed in so many steps, at most."""
JUMP_M, STEEP, FREE = 0.1, 0.25, 1e-4
"""A part that is higher at its end, and as steep, is where poses jump, and may change as freely"""


def list_drifts(way: Int64) -> Iterator[Drift]:
    """List by what the heights of a sensor may drift, as it is as high where it comes by again.

    SLAM of 3D lidars is off in z by 0.1 to 1 m over a drive, and would lay the floor twice.

    Parameters
    ----------
    way
        (N, 4) x, y and z (mm), and their stamps (ns), in any order.
    """
    if not len(way):
        return
    way = way[np.lexsort(way.T)]
    way = way[np.unique(way[:, 3], return_index=True)[1]]
    timed = (way - way[0]) / [1e3, 1e3, 1e3, 1e9]
    knots, passes = slice(None, None, -(-len(way) // MOST_PARTS)), np.zeros((0, 3))
    for side in SQUARES_M:
        passes = np.concatenate([passes, list_passes(timed, side)])
        if len(passes) < FEWEST_PASSES:
            continue
        if np.median(np.abs(passes[:, 2])) < LEAST_DRIFT_M:
            return
        added = np.rint(1000 * fit_drift(timed[knots], passes)).astype(np.int64)
        yield tuple(way[knots, 3].tolist()), tuple(added.tolist())


def list_passes(way: Float64, side: float) -> Float64:
    """List where a way (N, 4; m and s) comes by again: both times, and how much higher it is then.

    It goes straight from place to place, and comes by in the squares of its steps and those around.
    """
    length = np.cumsum(np.hypot(*np.diff(way[:, :2], axis=0, prepend=way[:1, :2]).T))
    steps = np.linspace(0, length[-1], min(int(length[-1] / side * 2) + 2, MOST_STEPS))
    x, y, z, time = (np.interp(steps, length, each) for each in way.T)
    row, col = (np.floor(each / side).astype(np.int64) for each in (y, x))
    squares = [((row + up) << 32) + col + right for up, right in product((-1, 0, 1), repeat=2)]
    square, time, z = np.concatenate(squares), np.tile(time, 9), np.tile(z, 9)
    order = np.lexsort((time, square))
    square, time, z = square[order], time[order], z[order]
    begins = (np.diff(square, prepend=square[0] - 1) != 0) | (np.diff(time, prepend=0) > AGAIN_S)
    which = np.cumsum(begins) - 1
    time, z = (np.bincount(which, each) / np.bincount(which) for each in (time, z))
    is_again = (np.diff(square[begins]) == 0) & (np.abs(np.diff(z)) < STOREY_M)
    return np.asarray(np.stack([time[:-1], time[1:], np.diff(z)], axis=1)[is_again])


def fit_drift(way: Float64, passes: Float64) -> Float64:
    """Fit what is added to the heights of a way (N, 4; m and s), so that they are equal at passes.

    It is linear from place to place, changes as little as may be, and is 0 where the way begins.
    That is a problem of least squares, of which this makes the normal equations: each pass adds the
    products of its four weights, of the places beside its two times, and each step adds the square
    of its change.
    """
    seconds, steps, n = way[:, 3], np.abs(np.diff(way, axis=0)), len(way)
    before = np.clip(np.searchsorted(seconds, passes[:, :2], side="right") - 1, 0, n - 2)
    share = np.clip((passes[:, :2] - seconds[before]) / steps[before, 3], 0, 1)
    place = np.concatenate([before, before + 1], axis=1).T
    # Of the drift at the second time less that at the first.
    weight = np.concatenate([1 - share, share], axis=1).T * [[-1], [1], [-1], [1]]
    pairs, products = place[:, None] * n + place, weight[:, None] * weight
    of_passes = np.bincount(pairs.ravel(), products.ravel(), n * n).reshape(n, n)
    is_jump = steps[:, 2] > np.maximum(JUMP_M, STEEP * np.hypot(steps[:, 0], steps[:, 1]))
    change = np.diff(np.eye(n), axis=0)
    of_changes = change.T * (np.where(is_jump, FREE, 1) / steps[:, 3]) @ change
    wanted = np.bincount(place.ravel(), (weight * -passes[:, 2]).ravel(), n)
    return np.append(0.0, np.linalg.solve((of_passes + of_changes)[1:, 1:], wanted[1:]))
