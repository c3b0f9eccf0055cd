"""A few hundred posed scans spread over a log, and what they tell that no single scan does."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occmap.command import format_mount
from occmap.errors import MapError
from occmap.evidence import render
from occmap.inspection.findings import MountFindings
from occmap.pipeline import BuildOptions, make_engine
from occmap.posing.rotations import rotate_by
from occmap.sensor.models import CountingModel
from occmap.sensor.returns import NoReturn, ReturnOptions, interpret
from occmap.types import Bool, Float64, Int64, Kind, Pose, PosedScans, Rays, as_float32

SAMPLE_SCANS = 300
MAX_SAMPLE_BEAMS = 1 << 19

HIT_CELL_M = 0.2
MAX_REACH_M = 30.0
MAX_CROSSING_BEAMS = 2000
MIN_CROSSING_BEAMS = 50

MOST_CELLS = 10**8

MOUNT_CELL_M = 0.1
MOUNT_YAWS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
UNTURNED = Pose.planar(0.0, 0.0, 0.0)
CLEAR_WIN = 0.9
"""The right mount lays the walls of many scans over each other: it marks fewer cells than this
share of what any other one marks."""


class Sample:
    """Takes every n-th scan of those that it is shown."""

    def __init__(self, expected: int) -> None:
        self.parts: list[PosedScans] = []
        self._every = max(expected // SAMPLE_SCANS, 1)
        self._seen = 0
        self._beams = 0

    def take(self, posed: PosedScans) -> None:
        """Take scans of a batch."""
        scans, beams = posed.batch.ranges.shape
        rows = np.arange(-self._seen % self._every, scans, self._every)
        self._seen += scans
        if len(rows) and self._beams < MAX_SAMPLE_BEAMS:
            self._beams += len(rows) * beams
            self.parts.append(pick_rows(posed, rows))

    def describe_mount(self, options: ReturnOptions) -> MountFindings | None:
        """Say how the sensor sits; None where no scan has a pose."""
        if not self.parts:
            return None
        upward = np.concatenate([part.rotation[..., 2, 2].ravel() for part in self.parts])
        height = np.concatenate([part.position[..., 2].ravel() for part in self.parts])
        tilt = float(np.median(np.arccos(np.clip(np.abs(upward), 0, 1))))
        turn = guess_mount(self.parts, options) or UNTURNED
        return MountFindings(
            upside_down=bool(np.median(upward) < 0),
            tilt=tilt,
            height=float(np.median(height)),
            better_turn="" if turn == UNTURNED else format_mount(turn),
        )


def pick_rows(posed: PosedScans, rows: Int64) -> PosedScans:
    """Keep some scans of a batch."""
    return PosedScans(posed.batch.take(rows), posed.position[rows], posed.rotation[rows])


def measure_crossing(parts: Sequence[PosedScans], options: ReturnOptions) -> float | None:
    """Measure how many beams without return would call free what other beams hit.

    Returns
    -------
    float or None
        Their share; None where there are too few such beams, or no distance up to which they would
        call space free.
    """
    options = replace(options, no_return=NoReturn.CLEAR)
    hits, origins, directions, reaches = [], [], [], []
    for part in parts:
        rays, _ = interpret(part, options)
        lost = (rays.kind == Kind.FREE) & is_lost(part, options)
        hits.append(rays.end[rays.kind == Kind.HIT])
        origins.append(np.broadcast_to(rays.origin, rays.direction.shape)[lost])
        directions.append(rays.direction[lost])
        reaches.append(rays.distance[lost])
    reach = np.concatenate(reaches or [np.zeros(0)])
    if len(reach) < MIN_CROSSING_BEAMS:
        return None
    some = np.linspace(0, len(reach) - 1, min(len(reach), MAX_CROSSING_BEAMS)).astype(np.int64)
    walls = encode_cells(np.concatenate(hits), HIT_CELL_M)
    ways = walk(np.concatenate(origins)[some], np.concatenate(directions)[some], reach[some])
    return float(np.isin(ways, walls).any(axis=1).mean())


def is_lost(part: PosedScans, options: ReturnOptions) -> Bool:
    """(S, B) whether nothing came back to a beam."""
    limit = part.batch.range_max if options.range_max is None else options.range_max
    lost: Bool = part.batch.ranges >= as_float32(limit)
    return lost


def walk(origin: Float64, direction: Float64, reach: Float64) -> Int64:
    """Number the cells (N, K) that beams (N) pass before their reach, the last one repeated."""
    far = np.minimum(reach, MAX_REACH_M)
    steps = np.minimum(np.arange(HIT_CELL_M, MAX_REACH_M, HIT_CELL_M), far[:, None] - HIT_CELL_M)
    return encode_cells(origin[:, None] + steps[..., None] * direction[:, None], HIT_CELL_M)


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    codes: Int64 = (cells[..., 0] << 32) + cells[..., 1]
    return codes


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None


def guess_mount(parts: Sequence[PosedScans], options: ReturnOptions) -> Pose | None:
    """Guess how a sensor is turned on its body, of the ways in which people mount them.

    Parameters
    ----------
    parts
        Scans posed as if the sensor were the body.

    Returns
    -------
    Pose or None
        None where no way of mounting is clearly better than the others.
    """
    mounts = [
        Pose.from_xyzrpy((0.0, 0.0, 0.0), (roll, 0.0, yaw))
        for roll in (0.0, math.pi)
        for yaw in MOUNT_YAWS
    ]
    marked = [count_marked(parts, mount, options) for mount in mounts]
    (best, at), (second, _) = sorted(zip(marked, range(len(mounts)), strict=True))[:2]
    return mounts[at] if 0 < best < CLEAR_WIN * second else None


def count_marked(parts: Sequence[PosedScans], mount: Pose, options: ReturnOptions) -> int:
    """Count the cells that have a hit when the sensor is mounted so."""
    turn = rotate_by(np.array([mount[3:]]))[0]
    hits: list[Float64] = []
    for part in parts:
        rays: Rays
        rays, _ = interpret(replace(part, rotation=part.rotation @ turn), options)
        hits.append(rays.end[rays.kind == Kind.HIT])
    return len(np.unique(encode_cells(np.concatenate(hits or [np.zeros((0, 2))]), MOUNT_CELL_M)))
