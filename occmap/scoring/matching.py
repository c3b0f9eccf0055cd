"""The small transform by which walls lie on the walls of a map best, and how sure that is.

So the map frame of one session is found in that of another. `occmap.store.merging` moves its
evidence there. Users say `fit` for it.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from occmap.cells import CellBox, Evidence
from occmap.choices import format_place
from occmap.difference.maps import Place
from occmap.errors import PoseError
from occmap.evidence import read_model, render, to_grid
from occmap.grid.tiles import MAX_CELLS, EvidenceKind
from occmap.options import BuildOptions
from occmap.scans.tracing import Observed
from occmap.sensor.models import SensorModel
from occmap.store import merging
from occmap.store.merging import STAY, Transform
from occmap.types import Bool, Float32, Float64, Paths, Pose, Update

REACH_M, REACH_RAD = 2.0, math.radians(20)
"""No larger transform is looked for, and what is farther from a wall counts as this far"""
STEP_M, STEP_RAD = 0.2, math.radians(2)
"""Of the first look; then both are halved again and again"""
HALVINGS, ROUGH = 6, 3
"""How often for the best place, and for those that it is compared with"""
MOST_PEAKS = 12
APART_M, APART_RAD = 0.3, math.radians(3)
"""Places nearer to one another are the same"""
LEAST_SHARE, MOST_RIVAL = 0.35, 0.75
"""Halves of real logs fit with a share of 0.45 to 0.78, and their rivals have 0.3 to 0.7 of that.
Logs of other buildings fit with one below 0.35, or their rivals have 0.79 of it and more."""
BESIDE = (0, -1, 1, -2, 2)
"""In steps: where something is as good farther away, the nearer one counts"""
WAYS = sorted(product(BESIDE, BESIDE), key=lambda way: abs(way[0]) + abs(way[1]))
"""In steps of x and y"""
MOST_POINTS = 10_000
MOST_STEPS = 200
"""Of distances (cells): in a map of millimetres they end nearer by than elsewhere"""
BAND = 1024
"""Rows of a map whose distances are measured at once"""


class Walls(NamedTuple):
    """How far it is from each cell to the nearest wall."""

    away: Float32
    """(H, W) m, up to REACH_M; along the border it is as much"""
    place: Place

    @classmethod
    def of(cls, occupied: Bool, place: Place, reach: float = REACH_M) -> "Walls":
        """Measure it between the middles of cells, in a map (H, W) and within `reach` (m) around.

        Bands of rows are measured by themselves, as a large map would need much memory at once.
        """
        resolution, x, y = place
        side = min(math.ceil(reach / resolution), MOST_STEPS)
        mask = np.pad(occupied, ((2 * side, 2 * side), (side, side)))
        away = np.empty((len(mask) - 2 * side, mask.shape[1]), np.float32)
        for row in range(0, len(away), BAND):
            squares = _measure_squares(mask[row : row + BAND + 2 * side], side)[side:-side]
            away[row : row + BAND] = np.sqrt(squares) * np.float32(resolution)
        np.minimum(away, np.float32(min(reach, side * resolution)), out=away)
        margin = side * resolution
        return cls(away, Place(resolution, x - margin, y - margin))

    @property
    def pivot(self) -> Float64:
        """(2,) what points are turned about (m): the world's zero, or the next place in the map.

        A session that begins at the same dock as another is turned about that.
        """
        low_x, low_y, high_x, high_y = self.place.measure(CellBox(0, 0, *self.away.shape))
        return np.clip(np.zeros(2), (low_x, low_y), (high_x, high_y))

    def measure(self, points: Float64) -> Float32:
        """How far it is from the cells of points (..., 2) to the nearest wall (m)."""
        return self.away[self.place.find_cells(points, self.away.shape)]

    def measure_between(self, points: Float64) -> Float64:
        """How far it is from points (..., 2) to the middle of the nearest wall's cells (m).

        It is interpolated between the middles of cells, so that parts of a cell count.
        """
        at = (points - self.place[1:]) / self.place.resolution - 0.5
        at = np.clip(at, 0, np.array(self.away.shape[::-1]) - 1.001)
        col, row = np.moveaxis(at.astype(np.int64), -1, 0)
        along, up = np.moveaxis(at % 1, -1, 0)
        left, right = (
            self.away[row, col + side] * (1 - up) + self.away[row + 1, col + side] * up
            for side in (0, 1)
        )
        return np.asarray(left * (1 - along) + right * along)


def _measure_squares(walls: Bool, side: int) -> Float32:
    """(H, W) squares of the distances to the nearest wall, in cells, as far as `side` cells.

    They are smallest over columns first and over rows then, which is exact (Felzenszwalb and
    Huttenlocher 2012), here for whole rows of cells at once.
    """
    squares = np.where(walls, np.float32(0), np.float32((side + 1) ** 2))
    for _ in range(2):
        lowest = squares.copy()
        for step in range(1, side + 1):
            farther = squares + np.float32(step * step)
            np.minimum(lowest[step:], farther[:-step], out=lowest[step:])
            np.minimum(lowest[:-step], farther[step:], out=lowest[:-step])
        squares = np.ascontiguousarray(lowest.T)
    return squares


class Match(NamedTuple):
    """Where points lie nearest to walls. Of points that all lie on walls the share is 1."""

    transform: Transform
    share: float
    rival: float
    """The share at the best other place, which is APART_M or APART_RAD away at least"""
    is_far: bool = False
    """Whether it lies at the end of what is searched"""
    lift: float = 0.0
    """How far ground is to be lifted onto ground (m)"""

    @property
    def told(self) -> str:
        """How well it fits."""
        return f"{self.share:.0%} of the walls match, and {self.rival:.0%} at the best other place"

    def doubt(self, whose: str, where: str) -> str:
        """Say why it is not sure where something lies on a map; "" where it is.

        Another place may be nearly as good, as along a corridor or in another building.
        """
        if self.share < LEAST_SHARE or self.rival > MOST_RIVAL * self.share:
            return f"it is not sure how {whose} lies on {where}: {self.told}"
        if self.is_far:
            return f"{whose} may lie on {where} better beyond what is searched: {self.told}"
        return ""


def find_match(points: Float64, walls: Walls) -> Match:
    """Find by which transform points (N, 2) lie nearest to walls, and how sure that is.

    All transforms on a coarse grid are tried, by turns about the pivot of the walls. Those that are
    better than the ones beside them are refined, in steps half as long again and again. A point
    tells less and less the farther it is from a wall, so that what has no wall in the other map, as
    people have none, does not pull.
    """
    if not len(points):
        return Match(STAY, 0.0, 0.0)
    points = points[:: max(len(points) // MOST_POINTS, 1)]
    middle = points.mean(axis=0)
    search = _Search(points - middle, middle, walls)
    refined = [search.refine(place, range(1, ROUGH + 1), 1500) for place in search.list_peaks()]
    shares = [float(search.measure_shares(it.yaw, np.array([it[:2]]))[0]) for it in refined]
    (share, best), *others = sorted(zip(shares, refined, strict=True), reverse=True)
    rival = next((share for share, other in others if _are_apart(other, best)), 0.0)
    found = search.turn_about_zero(search.refine(best, range(ROUGH + 1, HALVINGS + 1)))
    shift = float(np.abs(found.move(walls.pivot) - walls.pivot).max())  # of the first look
    is_far = shift > REACH_M - STEP_M / 2 or abs(found.yaw) > REACH_RAD - STEP_RAD / 2
    return Match(found, share, rival, is_far)


class _Search(NamedTuple):
    """A search for the place of points, which is a turn about their middle and then a shift.

    About their own middle a small turn leaves most points nearly where they are, so that the best
    shift hardly depends on it, and a place can be refined in small steps. The first look is by
    turns about the pivot of the walls instead, where the drives of both maps may have begun.
    """

    points: Float64
    """(N, 2) from their middle (m)"""
    middle: Float64
    """(2,) in the map of the walls (m)"""
    walls: Walls

    def measure_shares(
        self, yaw: float, shifts: Float64, width: float = 0.0, most: int = MOST_POINTS
    ) -> Float64:
        """Measure how near points, some of them, lie to walls; at `width` (m) they count 0.6.

        Where that is less than half a cell, distances between the middles of cells count, too.

        Returns
        -------
        (K,) for a turn and, after it, each of some shifts (K, 2)
        """
        points = self.points[:: max(len(self.points) // most, 1)]
        turned = Transform(0.0, 0.0, yaw).move(points)
        # All x, then all y, and in place: half of a search goes by here.
        moved = np.add(turned.T[:, np.newaxis], shifts.T[:, :, np.newaxis], order="C")
        moved += self.middle.reshape(2, 1, 1)
        is_fine = 0 < width < self.walls.place.resolution / 2
        measure = self.walls.measure_between if is_fine else self.walls.measure
        near = measure(np.moveaxis(moved, 0, -1)) / max(width, self.walls.place.resolution)
        near *= near
        near *= -0.5
        return np.asarray(np.exp(near, out=near).mean(axis=1), np.float64)

    def swing(self, yaw: float) -> Float64:
        """(2,) how far a turn about the pivot takes the middle of the points along (m)."""
        arm = self.middle - self.walls.pivot
        return Transform(0.0, 0.0, yaw).move(arm) - arm

    def list_peaks(self) -> list[Transform]:
        """List the places on a coarse grid that none beside them beats, the best ones first.

        The grid is of turns about the pivot and, after each, of shifts.
        """
        steps = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M).tolist()
        shifts = np.array(list(product(steps, steps)))
        turns = np.arange(-REACH_RAD, REACH_RAD + STEP_RAD / 2, STEP_RAD).tolist()
        swung = [shifts + self.swing(yaw) for yaw in turns]
        by_turn = zip(turns, swung, strict=True)
        shares = np.stack([self.measure_shares(*each, STEP_M, 500) for each in by_turn], axis=1)
        grid = shares.reshape(len(steps), len(steps), len(turns))
        beside = np.lib.stride_tricks.sliding_window_view(np.pad(grid, 1), (3, 3, 3))
        peaks = np.flatnonzero(grid >= beside.max(axis=(3, 4, 5)))
        best = peaks[np.argsort(-grid.ravel()[peaks], kind="stable")][:MOST_PEAKS].tolist()
        places = (divmod(each, len(turns)) for each in best)
        return [Transform._make([*swung[at][shift].tolist(), turns[at]]) for shift, at in places]

    def refine(self, place: Transform, halvings: range, most: int = MOST_POINTS) -> Transform:
        """Go on to the best of the places beside, in shorter and shorter steps."""
        for halving in halvings:
            step_m, step_rad = STEP_M / 2**halving, STEP_RAD / 2**halving
            turns = [place.yaw + turn * step_rad for turn in BESIDE]
            shifts = place[:2] + np.array(WAYS) * step_m
            shares = np.stack([self.measure_shares(yaw, shifts, step_m, most) for yaw in turns])
            turn, shift = divmod(int(shares.argmax()), len(shifts))
            place = Transform._make([*shifts[shift].tolist(), turns[turn]])
        return place

    def turn_about_zero(self, place: Transform) -> Transform:
        """Write a place as a turn about the map's zero and a shift, as `transform` is typed."""
        right, up = (self.middle - Transform(0.0, 0.0, place.yaw).move(self.middle)).tolist()
        return Transform(round(place.x + right, 5), round(place.y + up, 5), round(place.yaw, 6))


def _are_apart(place: Transform, other: Transform) -> bool:
    x, y, yaw = np.abs(np.subtract(place, other)).tolist()
    return math.hypot(x, y) > APART_M or yaw > APART_RAD


def fit_logs(
    paths: Paths, options: BuildOptions, past: Evidence, observe: Callable[[BuildOptions], Observed]
) -> tuple[BuildOptions, str]:
    """Give the options by which the walls of logs lie on those of evidence, and say so.

    Parameters
    ----------
    observe
        Traces the logs as options say: the map that they make alone is fitted.

    Raises
    ------
    OccmapError
        A log cannot be read, or it is not sure where they lie.
    """
    logs, level = ", ".join(map(str, paths)), options.posing.level
    seen = observe(replace(options, fit=False))
    if options.update is Update.CLOUD:
        level = seen.options.posing.level or (0.0, 0.0)  # not that of the evidence
    found = match(replace(seen.evidence, where=logs), past, options.model, options.max_cells)
    placed, align = options.posing.transform, options.posing.align
    pose = merging.add_move(placed, found.transform, align, found.lift)
    typed = f"`transform=({format_place(pose)})`"
    if level and any(level):
        typed += " `level=({:g},{:g})`".format(*level)
    posing = replace(options.posing, transform=pose, level=level)
    note = f"{past.where}: {logs} fit it with {typed}: {found.told}"
    return replace(options, posing=posing), note


def find_walls(past: Evidence, model: SensorModel, max_cells: int) -> Walls:
    """Measure how far it is to the walls of evidence."""
    grid = render(to_grid(past), model, max_cells)
    return Walls.of(grid.occupied, Place(grid.resolution, *grid.origin))


def match(evidence: Evidence, past: Evidence, model: SensorModel, max_cells: int) -> Match:
    """Find how the walls of evidence lie on those of other evidence, and how much its ground rises.

    The hits in its occupied cells say where it lies. Of all hits, some are noise; and of cells,
    each once, many are at the back of a wall that the other session saw from the front.

    Raises
    ------
    OccmapError
        It is not sure where it lies, or its ground is that of another storey.
    """
    grid = to_grid(evidence)
    made = render(grid, model, max_cells)
    weights = made.occupied.astype(np.float64)
    if grid.kind is EvidenceKind.COUNTS:
        weights *= grid.read(made.box)[0]
    points = spread_points(weights, Place(made.resolution, *made.origin))
    found = find_match(points, find_walls(past, model, max_cells))
    refuse_doubt(found, evidence.where, past.where or "the evidence before it")
    if evidence.ground and past.ground:
        moved = merging.move_ground(evidence.ground, found.transform, 0.0)
        rise_mm = past.ground.measure_rise(moved)
        found = found._replace(lift=-float(np.median(rise_mm)) / 1000 if rise_mm.size else 0.0)
        if abs(found.lift) > REACH_M:
            higher = f"{abs(found.lift):.2f} m {'lower' if found.lift > 0 else 'higher'}"
            told = f"its walls lie on those of {past.where}, but its ground lies {higher}"
            fix = "another storey is a map of its own; of the same floor, give a first `transform`"
            raise PoseError(told, where=evidence.where, fix=fix)
    return found


def refuse_doubt(found: Match, whose: str, where: str) -> None:
    """Refuse to lay something on the evidence `where`; raises PoseError unless it is sure how."""
    if doubt := found.doubt(whose, "it"):
        fix = "build with a first `transform`, or leave `fit` out"
        raise PoseError(doubt, where=where, fix=fix)


def lay_on(evidence: Evidence, past: Evidence) -> Evidence:
    """Move evidence so that its walls lie on those of other evidence; a note of it says how.

    Raises
    ------
    OccmapError
        The two cannot be combined, or it is not sure where it lies.
    """
    merging.refuse_unlike(past.manifest, evidence)
    found = match(evidence, past, read_model(past), MAX_CELLS)
    moved = merging.move_evidence(evidence, found.transform, found.lift)
    given = {tuple(each["options"]["posing"]["transform"]): None for each in moved.manifest.builds}
    typed = " and ".join(f"`transform=({format_place(Pose(*each))})`" for each in given)
    where = past.where or "the evidence before it"
    note = f"{evidence.where}: fits {where} with {typed}: {found.told}"
    return replace(moved, notes=(*evidence.notes, note))


def spread_points(weights: Float64, place: Place) -> Float64:
    """(N, 2) middles of cells (H, W), each as often as its weight says."""
    sums = np.cumsum(weights[weights > 0], dtype=np.float64)
    shares = (np.arange(MOST_POINTS if len(sums) else 0) + 0.5) / MOST_POINTS
    which = np.searchsorted(sums, shares * sums[-1:])
    return np.asarray(place.list_middles(weights > 0)[which])
