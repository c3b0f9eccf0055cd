"""Small logs for the tests of posing, written down as a person would."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from occmap.posing import PosingOptions
from occmap.posing.attach import Poser
from occmap.posing.sources import gather
from occmap.types import Float64, Pose, PosedScans, PoseSample, ScanBatch
from tests.samples import make_batch

SECOND = 10**9


def at(seconds: float, parent: str, child: str, pose: Pose, topic: str = "/tf") -> PoseSample:
    stamp_ns = round(seconds * SECOND)
    return PoseSample(stamp_ns, parent, child, pose, False, topic, stamp_ns)


def bolted(parent: str, child: str, pose: Pose) -> PoseSample:
    return PoseSample(0, parent, child, pose, static=True, topic="/tf_static")


def drive(
    parent: str, child: str, topic: str = "/tf", seconds: Sequence[float] = range(11)
) -> list[PoseSample]:
    """One metre a second along x."""
    return [at(t, parent, child, Pose.planar(t, 0, 0), topic) for t in seconds]


def batch_at(
    seconds: Sequence[float], frame: str = "laser", beams: int = 3, time_increment: float = 0.0
) -> ScanBatch:
    stamps = np.array([round(t * SECOND) for t in seconds], np.int64)
    increments = np.full(len(stamps), time_increment)
    ranges = np.ones((len(stamps), beams))
    return make_batch(ranges, frame=frame, stamp_ns=stamps, time_increment=increments)


def attach(poser: Poser, *batches: ScanBatch) -> tuple[list[PosedScans], dict[str, int]]:
    """The scans that get poses, and how many get none, by reason."""
    before = poser.count_lost()
    posed = [part for batch in batches for part in poser.attach(batch)]
    return posed, dict(poser.count_lost() - before)


def attach_twice(poser: Poser, *batches: ScanBatch) -> tuple[list[PosedScans], dict[str, int]]:
    """As `attach`, once all scans have shown which of them leap away."""
    attach(poser, *batches)
    poser.settle()
    poser.start_over()
    return attach(poser, *batches)


def positions(poser: Poser, seconds: Sequence[float], frame: str = "laser") -> Float64:
    """Where the sensor is at these moments, all of which must have a pose."""
    (posed,), dropped = attach(poser, batch_at(seconds, frame))
    assert not dropped
    return posed.position


def build(*samples: PoseSample, **options: object) -> Poser:
    chosen = PosingOptions(**options)  # type: ignore[arg-type]
    return Poser(gather(samples, chosen), chosen)


def yaw_of(rotation: ArrayLike) -> Float64:
    matrix = np.asarray(rotation)
    yaw: Float64 = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
    return yaw


def turned(yaw: float, x: float = 0.0, y: float = 0.0) -> Pose:
    return Pose.planar(x, y, math.radians(yaw))


def matrix_of(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Float64:
    """Rz(yaw) Ry(pitch) Rx(roll), written out: about fixed axes, x first (REP 103)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, np.float64)
