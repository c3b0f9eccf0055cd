"""The ground below the drives of a build: found in a pass of its own, with the map laid flat.

Heights of poses that drift are corrected on the way, and known ground goes on below new clouds.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from occmap.cells import Ground
from occmap.clouds import FLAT
from occmap.errors import MapError, name_log
from occmap.evidence import refuse_other
from occmap.options import BuildOptions
from occmap.posing import measure_drift
from occmap.posing.attach import place_logs, tilt
from occmap.report import Note, join_names
from occmap.scans import encode_cells
from occmap.scans.logs import count_scans
from occmap.scans.stream import Drive
from occmap.scans.tally import Tally
from occmap.threads import Threads
from occmap.types import BLOCK_BITS, COLUMN_MM, NO_GROUND, Float64

if TYPE_CHECKING:  # it brings numba, which takes longer to load than all else together
    from occmap.clouds.ground import GroundFinder

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


def find_ground(
    drives: Collection[Drive], options: BuildOptions, known: Ground | None
) -> BuildGround:
    """Find the ground below all drives, in a pass of its own.

    Parameters
    ----------
    drives
        Whose poses are taken.
    known
        Ground of evidence that the build is added to; it stays as it is.
    """
    from occmap.clouds.ground import GroundFinder  # noqa: PLC0415  late: it brings numba

    def count(options: BuildOptions, ground: Ground | None) -> GroundFinder:
        scans = (count_scans(drive.log, options.selection.topics) for drive in drives)
        finder = GroundFinder(sum(scans), ground=ground)
        for drive in drives:
            count_ground(drive.renew(options), finder)
        return finder

    return settle_ground(count, options, known)


Count: TypeAlias = Callable[[BuildOptions, Ground | None], "GroundFinder"]
"""Reads all clouds, and counts what they show of the ground; they may be laid on some first"""


def settle_ground(count: Count, options: BuildOptions, known: Ground | None) -> BuildGround:
    """Find the ground, and once more by clouds that are laid on it, which poses blur less."""
    finder = count(options, None)
    if known is None:
        first = level_ground(count, finder, options)
    else:
        first = extend_ground(finder, options, known)
    if options.clouds.ground == FLAT or first.ground is known:
        return first
    posing = first.options.posing
    settled = replace(posing, height_drift=posing.height_drift or {})  # none is looked for again
    finder = count(replace(first.options, posing=settled), first.ground)
    ground, notes = finder.find(options.clouds, known)
    return BuildGround(ground, [*notes, *first.notes], first.options)


def level_ground(count: Count, finder: "GroundFinder", options: BuildOptions) -> BuildGround:
    """Find the ground, and lay a map flat of which the floor leans, and the walls with it.

    SLAM that knows no gravity has its map in the frame of the first cloud, however the sensor was
    held. Of a street that climbs the walls stand upright, and it stays as it is.
    """
    level, found = (0.0, 0.0), keep_drifts(finder, options, finder.find(options.clouds)[0])
    if options.posing.level is not None:
        return found
    place = place_logs(options.posing)
    start, turned = place.position[0], place.rotation[0]
    seen = finder.count()
    if np.linalg.norm(seen.path / 1000 - start, axis=1).min(initial=np.inf) >= BEGIN_M:
        return found
    sample = (seen.sample - start) @ turned  # in the logs' own map
    for _ in range(LEVEL_ROUNDS):
        wanted = find_level(found.ground, turned @ tilt(level).rotation[0])
        if math.dist(wanted, level) < LEAST_LEAN_DEG:
            break
        before, after = (measure_spread(sample @ tilt(it).rotation[0].T) for it in (level, wanted))
        if after > before - SHARPER:
            break
        level = wanted
        laid = replace(options, posing=replace(options.posing, level=level))
        finder = count(laid, None)
        found = keep_drifts(finder, laid, finder.find(options.clouds)[0])
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
    slopes = []
    for axis in (1, 0):
        height = ground.height_mm.reshape(-1, 1 << BLOCK_BITS, 1 << BLOCK_BITS)
        known = ground.measured.reshape(height.shape) & (height != NO_GROUND)
        height, known = (np.moveaxis(each, axis + 1, 1) for each in (height, known))
        both = known[:, APART:] & known[:, :-APART]
        rise = (height[:, APART:] - height[:, :-APART])[both]
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


def extend_ground(finder: "GroundFinder", options: BuildOptions, known: Ground) -> BuildGround:
    """Let known ground go on below clouds, unless it is given as it is.

    Raises
    ------
    MapError
        Most of the ground that the clouds show lies elsewhere, or they show none to go on with.
    """
    is_whole = options.clouds.file is not None
    try:
        own, _ = finder.find(options.clouds)
    except MapError:
        if not is_whole:
            raise
    else:
        rise = known.measure_rise(own)
        logs = dict.fromkeys(log for log, _, _ in finder.count().paths)
        fix = "see in `occmap check` if poses, mount or `level` are wrong"
        if len(rise) >= LEAST_OVERLAP * min(own.measured.sum(), known.measured.sum()):
            with name_log(join_names(logs)):
                refuse_other(rise, OTHER_SHARE, options.posing.transform, fix)
    ground = known if is_whole else finder.find(options.clouds, known)[0]
    return keep_drifts(finder, options, ground)


def keep_drifts(finder: "GroundFinder", options: BuildOptions, ground: Ground) -> BuildGround:
    """Keep by what heights were corrected while clouds were counted, and say so."""
    notes: list[str] = [
        Note(
            f"heights of poses drift by {measure_drift(drift):.2f} m, as the floor shows where the "
            "drive comes by again: they are corrected; `height_drift=off` leaves them"
        ).placed(log)
        for log, drift in finder.drifts.items()
    ]
    if finder.drifts:
        options = replace(options, posing=replace(options.posing, height_drift=finder.drifts))
    return BuildGround(ground, notes, options)


def measure_spread(points: Float64) -> float:
    """Measure over how many cells points (N, 3) spread (the entropy): upright walls fill few."""
    _, many = np.unique(encode_cells(points[:, :2], UPRIGHT_CELL_M), return_counts=True)
    share = many / many.sum()
    return float(-(share * np.log(share)).sum())


def count_ground(drive: Drive, finder: "GroundFinder") -> None:
    """Let a finder of the ground see the clouds of a drive, and correct heights that drift."""
    log, posing = str(drive.log.path), drive.options.posing

    def count() -> "GroundFinder":
        for _ in drive.rounds():  # the second time without clouds that leap away
            seen = finder.start_over(log)
            with name_log(log), Threads(seen.add, drive.options.jobs) as threads:
                for posed in drive.read(Tally(), seen.wants):
                    threads.give(posed)
        return seen

    best = seen = count()
    for drift in seen.list_drifts() if posing.height_drift is None else ():
        drive.poser.drift = drift
        corrected = count()
        if corrected.measure_sharpness() > CLEARER * best.measure_sharpness():
            best, corrected.drifts = corrected, {log: drift}
    finder.join(best.count())
