"""How good a written map is, whatever made it: asked of recordings, or of the truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from occmap.cells import CellClass, Decision, OccupancyMap
from occmap.choices import check_bounds, option
from occmap.difference.maps import ClassMap, Place, load_map
from occmap.errors import LogError, MapError, require
from occmap.grid.tiles import MAX_CELLS
from occmap.options import BuildOptions
from occmap.report import HIDDEN, Count, Finite, Printed, Share, fold_notes
from occmap.report.results import doubt_agreement, name_frames
from occmap.scans import Sample, list_hits
from occmap.scans.tally import ScanCounts
from occmap.scans.tracing import Progress, Reading, ignore_progress
from occmap.scoring import MOST_SCANS, Trial, score_map
from occmap.scoring.matching import REACH_M, Match, Walls, find_match
from occmap.store.merging import STAY, Transform
from occmap.types import IDENTITY, Bool, Float32, Rays, UInt8
from occmap.writers import check_picture, refuse_input

WITHIN_M = 0.1
"""A wall that is drawn on the wrong side of a cell's edge is still right."""
LEAST_CHANCE = 0.001
"""No class is so sure that beams never find otherwise."""
FIRST_GUESS = 0.9
"""The chance that a beam stops in an occupied cell, until beams tell"""
BESIDE = 1.5
"""In cells: all eight cells around one are nearer"""
AS_THEY_LIE = Match(STAY, 1.0, 0.0)
FREE, OCCUPIED, NEITHER = CellClass.FREE, CellClass.OCCUPIED, CellClass.NEITHER
COLOURS = np.array(
    [(213, 94, 0), (0, 114, 178), (230, 159, 0), (0, 0, 0), (254, 254, 254), (205, 205, 205)],
    np.uint8,
)
"""Of what is invented, dangerous, missed, a wall, free, and neither; colour-blind people tell these
apart, too (Okabe and Ito, 2008)"""


@dataclass(frozen=True)
class Against:
    """What a map is held against, and how.

    Raises
    ------
    UsageError
        It is held against nothing, or a value makes no sense.
    """

    logs: tuple[Path, ...] = option((), "A recording of the place.", flag="log", metavar="LOG")
    truth: Path | None = option(
        None, "The map that is true: a plan, a simulator's, or another tool's.", metavar="MAP"
    )
    within_m: float = option(
        WITHIN_M,
        "A wall is found, and not invented, if it is off by at most so much.",
        unit="m",
        flag="within",
        bounds=(0, 1),
    )
    fit: bool = option(
        False,
        "First move the recordings onto the map, or the map onto the truth, by the shift of up to "
        "2 m and the turn of up to 20 degrees by which they fit best.",
    )
    picture: Path | None = None
    """Where to draw how the map and the truth differ"""

    def __post_init__(self) -> None:
        check_bounds(self)
        nothing = "there is nothing to score by"
        require(bool(self.truth or self.logs), nothing, "add `logs=LOG` or `truth=MAP`")
        is_drawn = self.picture is not None
        require(bool(self.truth) or not is_drawn, "the picture shows the truth", "add `truth=MAP`")


@dataclass(frozen=True)
class LogScore:
    """How well a map says what the beams of recordings meet."""

    logs: list[str]
    """Logs, as they were given"""
    scans: ScanCounts
    """What became of the scans"""
    beams: Count
    """Beams that measured a range"""
    share: Share
    """Share of these whose first occupied cell is within two cells of the range"""
    share_error: Finite
    """Standard error of the share, the scans taken as independent draws; null of a single scan"""
    log_likelihood: float
    """Mean log-likelihood of the measured ranges (nat), by the two chances that follow"""
    agreement: Share
    """Share of the hits that lie in occupied cells, or beside one"""
    stops_in_occupied: Share
    """Share of the looks of beams at occupied cells that ended there"""
    stops_in_free: Share
    """Share of the looks of beams at free cells that ended there"""
    transform: Transform
    """The pose of the recordings' map frame in the map by which they fit, as `transform` takes it:
    x, y (m) and yaw (rad); zeros where it is not looked for"""


@dataclass(frozen=True)
class TruthScore:
    """How a map differs from the truth. A wall is found where one is as near as `within_m`."""

    truth: str
    """The map that is true"""
    within_m: float
    """How far a wall may be off (m)"""
    edges_found: Share
    """Share of the edge cells of the truth, occupied beside free ones, near which the map has an
    occupied cell"""
    edges_invented: Share
    """Share of the map's occupied cells near which the truth has none, where it is known"""
    occupied_called_free: Share
    """Share of the edge cells that the map calls free, with nothing occupied near"""
    free_called_occupied: Share
    """Share of the truth's free cells away from walls that the map calls occupied"""
    free_found: Share
    """Share of the truth's free cells away from walls that the map calls free"""
    wall_distance_m: float
    """Mean distance from the map's occupied cells to the truth's (m); 2 m where it is more"""
    wall_distance_95_m: float
    """95 in 100 of these distances are no larger (m)"""
    transform: Transform
    """By what the map was moved so that it fits the truth: x, y (m) and yaw (rad)"""
    picture: UInt8 = field(metadata=HIDDEN)
    """(H, W, 3) red, green, blue, highest y on top"""


@dataclass(frozen=True, kw_only=True)
class MapScore(Printed):
    """How good a written map is: what occmap score prints."""

    map: str
    """The map, as it was given"""
    resolution: float
    """Side of a cell (m)"""
    occupied: Count
    """Cells that are occupied"""
    free: Count
    """Cells that are free"""
    by_logs: LogScore | None = None
    """As recordings have it; null where none is given"""
    by_truth: TruthScore | None = None
    """As the truth has it; null where it is not given"""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each, as on stderr"""
    files: tuple[str, ...] = ()
    """Files that were written"""


def score(
    path: Path, against: Against, options: BuildOptions, progress: Progress = ignore_progress
) -> MapScore:
    """Say how good a written map is, by recordings or by the truth, and draw it if wanted.

    Raises
    ------
    OccmapError
        A map or a log cannot be read, a map does not say where it lies, or the picture cannot be
        written.
    """
    truth, picture = against.truth, against.picture
    check_picture(picture, [path, *([truth] if truth else []), *against.logs], [".png"])
    written = load_map(path, options.writing)
    true = load_map(truth, options.writing) if truth else None
    if picture:
        refuse_input(picture, [each.image for each in (written, true) if each and each.image])
    by_logs, by_truth, notes = None, None, [*written.notes, *(true.notes if true else ())]
    if against.logs:
        by_logs, told = score_by_logs(written, against, options, progress)
        notes += told
    if true:
        found = AS_THEY_LIE
        if against.fit:
            walls = find_place(written).list_middles(written.classes == OCCUPIED)
            found = find_match(walls, Walls.of(true.classes == OCCUPIED, find_place(true)))
        notes += filter(None, [found.doubt("the map", str(truth))])
        by_truth = score_by_truth(written, true, against.within_m, found.transform)
        if picture:
            from occmap.writers.images import write_colours  # noqa: PLC0415  late: brings pillow

            write_colours(picture, by_truth.picture)
    return MapScore(
        map=str(path),
        resolution=find_place(written).resolution,
        occupied=int(np.count_nonzero(written.classes == OCCUPIED)),
        free=int(np.count_nonzero(written.classes == FREE)),
        by_logs=by_logs,
        by_truth=by_truth,
        notes=fold_notes(notes),
        files=(str(picture),) if picture else (),
    )


def find_place(written: ClassMap) -> Place:
    """Where a map lies; raises MapError where it does not say, or has no walls."""
    if written.place is None:
        fix = "give the YAML of map_server, or an .npz"
        raise MapError("does not say where it lies", where=written.path, fix=fix)
    if not (written.classes == OCCUPIED).any():
        raise MapError("has no occupied cell", where=written.path, fix="give a map with walls")
    return written.place


def score_by_logs(
    written: ClassMap, against: Against, options: BuildOptions, progress: Progress
) -> tuple[LogScore, list[str]]:
    """Ask recordings how good a map is; return what they say, and notes on them.

    At most 4,000 scans are asked, spread over all of them.

    Raises
    ------
    OccmapError
        As a build, no beam measured a range, or the map does not say where it lies.
    """
    place = find_place(written)
    options = replace(options, resolution=place.resolution)
    sample = Sample[Rays](MOST_SCANS)
    reading = Reading(against.logs, options, progress)
    for rays in reading.list_rays():
        sample.add(rays)
    tally = reading.tally
    tally.notes += [*sample.list_notes(), *filter(None, [name_frames(tally.frames)])]
    hits = list_hits(sample.parts)
    if not len(hits):
        where = ", ".join(tally.logs)
        raise LogError("no beam measured a range", where=where, fix="see `occmap check`")
    walls = Walls.of(written.classes == OCCUPIED, place)
    found = find_match(hits, walls) if against.fit else AS_THEY_LIE
    moved = found.transform
    if doubt := found.doubt("the drive", "the map"):
        tally.notes.append(f"{doubt}: try again with a first `transform`")
    seen = [move_rays(rays, moved) for rays in sample.parts]
    trial, occupied, free = weigh(written, seen, options.jobs)
    agreement = float(np.mean(walls.measure(moved.move(hits)) < BESIDE * place.resolution))
    if not against.fit and (doubt := doubt_agreement(agreement)):
        hint = "if the logs have another frame, `fit` may find it"
        if written.align and not options.posing.transform:
            turn = math.radians(float(written.align))
            turned = f"the map is turned by {written.align} degrees"
            hint = f"{turned}: if it was not moved besides, try `transform=(0,0,{turn:.6f})`"
        tally.notes.append(f"{doubt} or beside one: {hint}")
    score = LogScore(
        logs=tally.logs,
        scans=tally.scans,
        beams=trial.score.beams,
        share=trial.score.share,
        share_error=trial.score.share_error,
        log_likelihood=trial.score.log_likelihood,
        agreement=agreement,
        stops_in_occupied=occupied,
        stops_in_free=free,
        transform=moved.after(options.posing.transform or IDENTITY) if against.fit else STAY,
    )
    return score, tally.notes


def move_rays(rays: Rays, by: Transform) -> Rays:
    """Move scans as a whole."""
    origin = by.move(rays.origin.reshape(-1, 2)).reshape(rays.origin.shape)
    return rays._replace(origin=origin, turn=by.matrix @ rays.turn)


def weigh(written: ClassMap, seen: Sequence[Rays], jobs: int) -> tuple[Trial, float, float]:
    """Score a map of classes: each gets the chance with which beams stop in its cells.

    Classes say nothing of probabilities, so the likelihood is that of the best two numbers.
    """
    guess = FIRST_GUESS, 1 - FIRST_GUESS
    found = score_map(to_probabilities(written, *guess), seen, jobs).score.reliability
    occupied, free = (
        next((each.observed for each in found if abs(each.predicted - chance) < 0.01), chance)
        for chance in guess
    )
    # In a map of somewhere else beams may stop in free cells: its walls are still those it names.
    chances = (occupied, free) if occupied > free else guess
    return score_map(to_probabilities(written, *chances), seen, jobs), occupied, free


def to_probabilities(written: ClassMap, occupied: float, free: float) -> OccupancyMap:
    """Make a map in which all cells of a class have one probability."""
    place = find_place(written)
    chances = np.clip([0.5, free, occupied], LEAST_CHANCE, 1 - LEAST_CHANCE)  # as CellClass has it
    log_odds = np.log(chances / (1 - chances)).astype(np.float32)[written.classes]
    middle = float(chances[1:].mean())
    decision, origin = Decision(middle, middle), (place.x, place.y)
    return OccupancyMap(log_odds, written.classes != NEITHER, place.resolution, origin, decision)


def score_by_truth(
    written: ClassMap, truth: ClassMap, within_m: float, moved: Transform = STAY
) -> TruthScore:
    """Hold a map against the truth; both may be of any resolution, the finer one counts.

    Parameters
    ----------
    within_m
        How far a wall may be off (m).
    moved
        By what the map is moved first.

    Raises
    ------
    MapError
        One of them does not say where it lies, they share nothing, or the truth has too many cells.
    """
    place, shape = cover(written, truth, within_m)
    is_true, is_said = lay(truth, STAY, place, shape), lay(written, moved, place, shape)
    side = place.resolution
    far = within_m + side / 1000  # distances are between middles of cells
    walls, from_true = is_said == OCCUPIED, measure_distances(is_true == OCCUPIED, place)
    is_floor_beside = measure_distances(is_true == FREE, place, 2 * side) < BESIDE * side
    edges = (is_true == OCCUPIED) & is_floor_beside
    open_floor = (is_true == FREE) & (from_true > far)
    is_missed = edges & (measure_distances(walls, place, far + side) > far)
    # Of what lies where the truth is unknown, as behind a window, it says nothing.
    judged = walls & ((is_true != NEITHER) | (from_true <= far))
    invented, dangerous = judged & (from_true > far), is_missed & (is_said == FREE)
    distances = from_true[judged]
    if not (distances.size and edges.any()):
        found = f"{truth.path} has no edge of a wall, or is not known where this map has walls"
        fix = "check that both are in one map frame: `fit` looks up to 2 m away"
        raise MapError(found, where=written.path, fix=fix)
    layers = [invented, dangerous, is_missed, walls, is_said == FREE]
    drawn = np.select(layers, list(np.arange(len(layers), dtype=np.uint8)), np.uint8(len(layers)))
    return TruthScore(
        truth=str(truth.path),
        within_m=within_m,
        edges_found=1 - share(is_missed, edges),
        edges_invented=share(invented, judged),
        occupied_called_free=share(dangerous, edges),
        free_called_occupied=share(open_floor & walls, open_floor),
        free_found=share(open_floor & (is_said == FREE), open_floor),
        wall_distance_m=float(distances.mean()),
        wall_distance_95_m=float(np.quantile(distances, 0.95)),
        transform=moved,
        picture=COLOURS[drawn[::-1]],
    )


def share(part: Bool, whole: Bool) -> float:
    """Which share of some cells is in a part of them; 0 of none."""
    return int(np.count_nonzero(part)) / max(int(np.count_nonzero(whole)), 1)


def measure_distances(cells: Bool, place: Place, reach: float = REACH_M) -> Float32:
    """(H, W) how far it is from each cell of a map to the nearest of some cells (m)."""
    away = Walls.of(cells, place, reach).away
    margin = (away.shape[0] - cells.shape[0]) // 2
    return away[margin:-margin, margin:-margin]


def cover(written: ClassMap, truth: ClassMap, within_m: float) -> tuple[Place, tuple[int, int]]:
    """Choose cells that cover the truth and `within_m` around it: nothing else is judged.

    Returns
    -------
    place, shape
        Where they lie, as small as the smaller ones, on the lattice of the truth, and how many rows
        and columns there are.

    Raises
    ------
    MapError
        They are too many.
    """
    true = find_place(truth)
    side = min(find_place(written).resolution, true.resolution)
    around = math.ceil(within_m / side - 1e-6)
    rows, cols = (
        math.ceil(cells * true.resolution / side - 1e-6) + 2 * around
        for cells in truth.classes.shape
    )
    if rows * cols > MAX_CELLS:
        found = f"{cols} x {rows} cells of {side:g} m cover it, too many to compare"
        raise MapError(found, where=truth.path, fix="take a coarser map, or a part of the truth")
    return Place(side, true.x - around * side, true.y - around * side), (rows, cols)


def lay(written: ClassMap, moved: Transform, place: Place, shape: tuple[int, int]) -> UInt8:
    """(H, W) the classes of a map that is moved, cell by cell; NEITHER outside of it."""
    own, framed = find_place(written), np.pad(written.classes, 1)
    # A little farther on, as a border that two maps share may be rounded either way.
    x, y = (edge - (1 + 1e-6) * own.resolution for edge in own[1:])
    around = Place(own.resolution, x, y)
    classes = np.empty(shape, np.uint8)
    for row in range(shape[0]):
        line = place._replace(y=place.y + row * place.resolution)
        points = moved.move_back(line.list_middles(np.ones((1, shape[1]), np.bool_)))
        classes[row] = framed[around.find_cells(points, framed.shape)]
    return classes
