"""How good a written map is, whatever made it: asked of recordings, or of the truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occmap.cells import CellClass, Decision, OccupancyMap, to_log_odds
from occmap.difference import ClassMap, Place
from occmap.errors import MapError
from occmap.grid.tiles import MAX_CELLS
from occmap.options import BuildOptions
from occmap.report import HIDDEN, Count, Finite, Printed, Share
from occmap.scans.logs import count_scans, open_scans
from occmap.scans.tally import ScanCounts, Tally, refuse_unused
from occmap.scans.tracing import AddRays, Progress, Remarks, ignore_progress, trace_logs
from occmap.scoring import Trial, score_map
from occmap.scoring.fit import STAY, Transform, Walls, fit
from occmap.types import IDENTITY, Bool, Float32, Float64, Kind, Rays, UInt8

LEAST_CHANCE = 0.001
"""No class is so sure that beams never find otherwise."""
FIRST_GUESS = 0.9
"""The chance that a beam stops in an occupied cell, until beams tell"""
FARTHEST_M = 2.0
"""Distances from walls count up to here"""
FREE, OCCUPIED, NEITHER = CellClass.FREE, CellClass.OCCUPIED, CellClass.NEITHER
WHITE, BLACK, GREY = (254, 254, 254), (0, 0, 0), (205, 205, 205)
INVENTED, DANGER, MISSED = (213, 94, 0), (0, 114, 178), (230, 159, 0)
"""Colours that colour-blind people tell apart, too (Okabe and Ito, 2008)"""


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


def find_place(written: ClassMap) -> Place:
    """Where a map lies; raises MapError where it does not say, or has no walls."""
    if written.place is None:
        fix = "give the YAML of map_server, or an .npz"
        raise MapError("does not say where it lies", where=written.path, fix=fix)
    if not (written.classes == OCCUPIED).any():
        raise MapError("has no occupied cell", where=written.path, fix="give a map with walls")
    return written.place


def list_walls(written: ClassMap) -> Float64:
    """(N, 2) the middles of the occupied cells (m)."""
    place = find_place(written)
    rows, cols = np.nonzero(written.classes == OCCUPIED)
    return np.column_stack([cols + 0.5, rows + 0.5]) * place.resolution + place[1:]


def measure_walls(written: ClassMap) -> Walls:
    """Measure how far it is from each cell to the nearest occupied one."""
    place = find_place(written)
    corner = np.array([place.x, place.y])
    return Walls.of(written.classes == OCCUPIED, corner, place.resolution, FARTHEST_M)


def score_by_logs(
    written: ClassMap,
    paths: Sequence[Path],
    options: BuildOptions,
    is_fitted: bool,
    progress: Progress = ignore_progress,
) -> tuple[LogScore, list[str]]:
    """Ask recordings how good a map is; return what they say, and notes on them.

    Parameters
    ----------
    is_fitted
        Move the recordings by the transform by which their hits fit the map best.

    Raises
    ------
    OccmapError
        As a build, no beam measured a range, or the map says not where it lies.
    """
    options = replace(options, resolution=find_place(written).resolution)
    tally = Tally()
    logs = open_scans(paths, options)
    total = sum(count_scans(log, options.selection.topics) for log in logs)
    tally.tell = lambda scans: progress(scans, total)
    seen: list[Rays] = []

    def begin() -> AddRays:
        seen.clear()
        return seen.append

    remarks = Remarks([str(log.path) for log in logs])
    # One thread, so that scans come in their order.
    for log, notes in trace_logs(logs, replace(options, jobs=1), begin, tally):
        remarks.note(log.path, log.notes, notes)
    refuse_unused(paths, tally)
    hits = list_hits(seen)
    if not len(hits):
        where = ", ".join(remarks.logs)
        raise MapError("no beam measured a range", where=where, fix="see `occmap check`")
    walls = measure_walls(written)
    moved = fit(hits, walls).transform if is_fitted else STAY
    if is_fitted and moved.is_far(walls.pivot):
        remarks.notes.append(
            "the logs fit best at the end of what is searched, and perhaps better beyond: try "
            "again with a first `transform`"
        )
    seen = [move_rays(rays, moved) for rays in seen]
    trial, occupied, free = weigh(written, seen, options.jobs)
    beside = 1.5 * walls.resolution  # of all eight
    score = LogScore(
        logs=remarks.logs,
        scans=tally.scans,
        beams=trial.score.beams,
        share=trial.score.share,
        share_error=trial.score.share_error,
        log_likelihood=trial.score.log_likelihood,
        agreement=float(np.mean(walls.measure(moved.move(hits)) < beside)),
        stops_in_occupied=occupied,
        stops_in_free=free,
        transform=moved.after(options.posing.transform or IDENTITY) if is_fitted else STAY,
    )
    return score, remarks.notes


def list_hits(seen: Sequence[Rays]) -> Float64:
    """(N, 2) where beams ended (m)."""
    return np.concatenate([rays.end[rays.kind == Kind.HIT] for rays in seen] or [np.zeros((0, 2))])


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
    chances = occupied, free
    if occupied <= free:  # a map of somewhere else; its walls are still those that it names
        chances = guess
    return score_map(to_probabilities(written, *chances), seen, jobs), occupied, free


def to_probabilities(written: ClassMap, occupied: float, free: float) -> OccupancyMap:
    """Make a map in which all cells of a class have one probability."""
    place = find_place(written)
    sure = [min(max(chance, LEAST_CHANCE), 1 - LEAST_CHANCE) for chance in (occupied, free)]
    odds = np.zeros(3, np.float32)
    odds[[OCCUPIED, FREE]] = [to_log_odds(chance) for chance in sure]
    middle = sum(sure) / 2
    observed: Bool = written.classes != NEITHER
    decision, origin = Decision(middle, middle), (place.x, place.y)
    return OccupancyMap(odds[written.classes], observed, place.resolution, origin, decision)


def score_by_truth(
    written: ClassMap, truth: ClassMap, within_m: float, is_fitted: bool
) -> TruthScore:
    """Hold a map against the truth; both may be of any resolution, the finer one counts.

    Parameters
    ----------
    within_m
        How far a wall may be off (m).
    is_fitted
        Move the map by the transform by which its walls fit those of the truth best.

    Raises
    ------
    MapError
        One of them says not where it lies, or both together are too large.
    """
    moved = fit(list_walls(written), measure_walls(truth)).transform if is_fitted else STAY
    canvas = make_canvas(written, truth, moved)
    is_true, is_said = canvas.lay(truth, STAY), canvas.lay(written, moved)
    shape, side = is_true.shape, canvas.side
    from_true, from_said = (
        cut(Walls.of(each == OCCUPIED, canvas.corner, side, FARTHEST_M), shape)
        for each in (is_true, is_said)
    )
    edges = (is_true == OCCUPIED) & touch(is_true == FREE)
    far = within_m + side / 1000  # distances are between middles of cells
    open_floor = (is_true == FREE) & (from_true > far)
    walls, is_missed = is_said == OCCUPIED, edges & (from_said > far)
    # Of what lies where the truth is unknown, as behind a window, it says nothing.
    judged = walls & ((is_true != NEITHER) | (from_true <= far))
    invented, dangerous = judged & (from_true > far), is_missed & (is_said == FREE)
    distances = from_true[judged]
    picture = np.full((*shape, 3), GREY, np.uint8)
    layers = (
        (is_said == FREE, WHITE),
        (walls, BLACK),
        (is_missed, MISSED),
        (dangerous, DANGER),
        (invented, INVENTED),
    )
    for cells, colour in layers:
        picture[cells] = colour
    return TruthScore(
        truth=str(truth.path),
        within_m=within_m,
        edges_found=1 - share(is_missed, edges),
        edges_invented=share(invented, judged),
        occupied_called_free=share(dangerous, edges),
        free_called_occupied=share(open_floor & walls, open_floor),
        free_found=share(open_floor & (is_said == FREE), open_floor),
        wall_distance_m=float(distances.mean()) if distances.size else math.inf,
        wall_distance_95_m=float(np.quantile(distances, 0.95)) if distances.size else math.inf,
        transform=moved,
        picture=picture[::-1],
    )


def share(part: Bool, whole: Bool) -> float:
    """Which share of some cells is in a part of them; 0 of none."""
    return int(np.count_nonzero(part)) / max(int(np.count_nonzero(whole)), 1)


def cut(walls: Walls, shape: tuple[int, ...]) -> Float32:
    """Take the distances within a map of a shape, without the margin around it."""
    side = (walls.away.shape[0] - shape[0]) // 2
    return walls.away[side : side + shape[0], side : side + shape[1]]


def touch(mask: Bool) -> Bool:
    """Cells that are beside those of a mask, over edges or corners, or in it."""
    padded = np.pad(mask, 1)
    height, width = mask.shape
    views = (padded[r : r + height, c : c + width] for r in range(3) for c in range(3))
    touched: Bool = np.logical_or.reduce(list(views))
    return touched


class Canvas(NamedTuple):
    """The cells on which two maps are compared."""

    corner: Float64
    """(2,) x and y of the lower-left corner (m)"""
    side: float
    """Of a cell (m)"""
    rows: int
    cols: int

    def lay(self, written: ClassMap, moved: Transform) -> UInt8:
        """(H, W) the classes of a map that is moved; NEITHER outside of it."""
        place = find_place(written)
        height, width = written.classes.shape
        xs, ys = (
            self.corner[axis] + (np.arange(size) + 0.5) * self.side
            for axis, size in enumerate((self.cols, self.rows))
        )
        classes = np.full((self.rows, self.cols), NEITHER, np.uint8)
        for row, y in enumerate(ys.tolist()):
            points = moved.move_back(np.column_stack([xs, np.full(self.cols, y)]))
            # A little farther on, as a border that two maps share may be rounded either way.
            at = np.floor((points - np.array(place[1:])) / place.resolution + 1e-6)
            cols, rows = at.astype(np.int64).T
            inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
            classes[row, inside] = written.classes[rows[inside], cols[inside]]
        return classes


def make_canvas(written: ClassMap, truth: ClassMap, moved: Transform) -> Canvas:
    """Make cells that cover both maps, as small as the smaller ones, on the lattice of the truth.

    Raises
    ------
    MapError
        They are too many.
    """
    true = find_place(truth)
    side = min(find_place(written).resolution, true.resolution)
    reach = np.concatenate([moved.move(list_corners(written)), list_corners(truth)])
    corner = np.array([true.x, true.y])
    low = np.floor((reach.min(axis=0) - corner) / side + 1e-6)
    high = np.ceil((reach.max(axis=0) - corner) / side - 1e-6)
    cols, rows = (int(each) for each in high - low)
    if rows * cols > MAX_CELLS:
        found = f"both maps together take {cols} x {rows} cells, too many to compare"
        raise MapError(found, where=written.path, fix="check that both are in one map frame")
    return Canvas(corner + low * side, side, rows, cols)


def list_corners(written: ClassMap) -> Float64:
    """(4, 2) where the corners of a map are (m)."""
    place, (rows, cols) = find_place(written), written.classes.shape
    whole = np.array([[0, 0], [cols, 0], [0, rows], [cols, rows]])
    return np.array(place[1:]) + whole * place.resolution
