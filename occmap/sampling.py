"""A few hundred posed scans spread over a log: enough for what no single scan tells."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occmap.batching import Selection
from occmap.posing.rotations import rotate_by
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Float64, Int64, Kind, Pose, PosedScans

SAMPLE_SCANS = 300
MAX_SAMPLE_BEAMS = 1 << 19

MOUNT_CELL_M = 0.1
MOUNT_YAWS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
UNTURNED = Pose.planar(0.0, 0.0, 0.0)
CLEAR_WIN = 0.9
"""The right mount lays the walls of many scans over each other: it marks fewer cells than this
share of what any other one marks."""


class Sample:
    """Takes every n-th scan of those that it is shown.

    Parameters
    ----------
    expected
        How many scans it will be shown, about; n follows from that.
    """

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


def pick_rows(posed: PosedScans, rows: Int64) -> PosedScans:
    """Keep some scans of a batch."""
    return PosedScans(posed.batch.take(rows), posed.position[rows], posed.rotation[rows])


def expect_scans(scans: int, selection: Selection) -> int:
    """Say how many of a log's scans a sample is made for; 0 for a part of a log, all of it counts.

    How many scans lie between two times is not known before they are read.
    """
    is_part = math.isfinite(selection.start_s) or math.isfinite(selection.end_s)
    return 0 if is_part else scans // selection.stride


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) of a size (m) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    codes: Int64 = (cells[..., 0] << 32) + cells[..., 1]
    return codes


def guess_mount(parts: Sequence[PosedScans], options: ReturnOptions) -> Pose | None:
    """Guess how a sensor is turned on its body, of the eight ways in which people mount them.

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
        rays, _ = interpret(replace(part, rotation=part.rotation @ turn), options)
        hits.append(rays.end[rays.kind == Kind.HIT])
    return len(np.unique(encode_cells(np.concatenate(hits or [np.zeros((0, 2))]), MOUNT_CELL_M)))
