"""Chains: where a sensor was in the map at any moment, by the frames in between.

A step from one frame to the next that never moves holds at all times. Any other is interpolated
between the two samples around a moment: positions linearly, rotations by slerp. Before the first
sample, after the last and in a gap that is too long there is no pose. A correction of odometry
(`map -> odom`) has no gaps that are too long, and where it jumps it holds until then: halfway
through a jump the robot never was. The pose of the sensor is the product of all steps.

A laser turns while it measures, so each beam of a de-skewed scan gets a pose of its own; a scan
that is not de-skewed has one pose, at its stamp.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from occmap.posing import Deskew, DropReason, PosingOptions
from occmap.posing.frames import Edge, find_moving, last_part
from occmap.posing.tracks import Track, find_usable, rotate_by, slerp, to_quaternions
from occmap.types import IDENTITY, Bool, Float64, Int64, Pose, PosedScans, ScanBatch, UInt8

DRIFT_M, DRIFT_RAD = 0.1, 0.05
"""A correction of odometry that moves or turns by no more never counts as a jump."""
DRIFT_M_PER_S, DRIFT_RAD_PER_S = 0.05, 0.01
"""What a correction drifts by at most, beyond that: 5 cm a second is a bad odometer."""

KEY_FRAMES_S, TURNED_RAD, AT_POSE_S = 0.3, math.radians(2), 0.02
"""Where poses are farther apart, and the robot turned by more between them, they do not tell how
it turned: at five metres a degree moves a wall by two cells. So near to a pose it hardly did.
Poses that are no farther apart show how a sensor moved in a scan."""


class Transforms(NamedTuple):
    """Where one frame was in another at N stamps, or at all times (N = 1)."""

    position: Float64
    """(N, 3) m; like the rotation, meaningless where the status is not POSED"""
    rotation: Float64
    """(N, 3, 3)"""
    status: UInt8
    """(N,) POSED, or the code of a `DropReason`; that of the leg with the highest one counts"""

    @classmethod
    def of(cls, position: Float64, quaternion: Float64) -> Self:
        """Make it of positions (N, 3) in m and unit quaternions (N, 4)."""
        return cls(position, rotate_by(quaternion), np.zeros(len(position), np.uint8))

    @classmethod
    def fixed(cls, pose: Pose) -> Self:
        """Make it of one pose that holds at all times."""
        track = Track.fixed(pose)
        return cls.of(track.position, track.quaternion)

    @classmethod
    def read(cls, poses: Float64) -> Self:
        """Make it of poses (N, 7) as they were recorded, of which some may be unusable."""
        usable, norm = find_usable(poses)
        poses = np.where(usable[:, None], poses, IDENTITY)
        found = cls.of(poses[:, :3], poses[:, 3:] / norm[:, None])
        found.status[~usable] = DropReason.UNUSABLE.code
        return found

    @property
    def first(self) -> Pose:
        """Where it was at the first stamp, or is at all times."""
        return Pose(*self.position[0].tolist(), *to_quaternions(self.rotation[:1])[0].tolist())

    def take(self, row: int) -> Self:
        """Select one of the stamps."""
        one = slice(row, row + 1)
        return type(self)(self.position[one], self.rotation[one], self.status[one])

    def then(self, below: Self) -> Self:
        """Compose with a transform that is given in the lower frame of this one."""
        position = self.position + turn(self.rotation, below.position)
        status = np.maximum(self.status, below.status)
        return type(self)(position, self.rotation @ below.rotation, status)

    def invert(self) -> Self:
        """Make the inverse: where the upper frame was in the lower one."""
        back = self.rotation.swapaxes(1, 2)
        return type(self)(-turn(back, self.position), back, self.status)


def turn(rotation: Float64, position: Float64) -> Float64:
    """Rotate vectors (N, 3) by matrices (N, 3, 3); either N may be 1."""
    return np.asarray((rotation @ position[..., None])[..., 0])


def place_logs(options: PosingOptions) -> Transforms:
    """Say where the logs' map, once it is level, lies in the map that is made."""
    turned = Pose.planar(0.0, 0.0, math.radians(options.align or 0.0))
    return Transforms.fixed(turned).then(Transforms.fixed(options.transform or IDENTITY))


def tilt(level: tuple[float, float]) -> Transforms:
    """Make the rotation by a roll and a pitch (degrees)."""
    roll, pitch = map(math.radians, level)
    return Transforms.fixed(Pose.from_xyzrpy((0.0, 0.0, 0.0), (roll, pitch, 0.0)))


@dataclass(frozen=True, eq=False)
class Moving:
    """A step that is interpolated between the two samples around a stamp."""

    step: Edge
    holds: Bool
    """(N,) whether the pose jumps after a sample, which holds until then"""
    max_gap_ns: float

    def at(self, stamp_ns: Int64, in_clouds: bool) -> Transforms:
        """Interpolate at stamps (N,), in any order.

        Parameters
        ----------
        in_clouds
            Where poses are sparse, and turn, there is none: walls far away would be smeared.
        """
        track = self.step.track
        stamps = track.stamp_ns
        last = len(stamps) - 1
        earlier = np.clip(np.searchsorted(stamps, stamp_ns, side="right") - 1, 0, last)
        later = np.minimum(earlier + 1, last)
        width = stamps[later] - stamps[earlier]
        since = np.clip(stamp_ns - stamps[earlier], 0, width)

        fraction = since / np.maximum(width, 1)
        fraction[self.holds[earlier]] = 0
        start, end = track.position[earlier], track.position[later]
        found = Transforms.of(
            start + fraction[:, None] * (end - start),
            slerp(track.quaternion[earlier], track.quaternion[later], fraction),
        )
        found.status[(width > self.max_gap_ns) & (since > 0)] = DropReason.GAP.code
        if in_clouds and self.max_gap_ns < np.inf:
            between = np.minimum(since, width - since) > AT_POSE_S * 1e9
            turned = np.append(track.step_rad, 0)[earlier] > TURNED_RAD
            found.status[between & turned & (width > KEY_FRAMES_S * 1e9)] = DropReason.TURN.code
        found.status[stamp_ns < stamps[0]] = DropReason.BEFORE.code
        found.status[stamp_ns > stamps[-1]] = DropReason.AFTER.code
        return found.invert() if self.step.inverted else found


@dataclass(frozen=True, eq=False)
class Chain:
    """The way from the map frame to a sensor."""

    steps: tuple[Edge, ...]
    """From the map frame downwards."""
    legs: tuple[Transforms | Moving, ...]
    """The steps ready for look-up; neighbouring ones that never move are multiplied into one"""
    interval_s: float
    """Median time between the samples of the leg that is sampled least often; 0 where none moves. A
    correction of odometry does not count, since it does not say how the robot drove."""

    @property
    def frames(self) -> tuple[str, ...]:
        """The frames from the map to the sensor."""
        return (self.steps[0].parent, *(step.child for step in self.steps)) if self.steps else ()

    def is_dense(self, duration_s: Float64) -> Bool:
        """Whether the poses show how the sensor moved within durations (N,)."""
        dense: Bool = self.interval_s <= np.maximum(duration_s, KEY_FRAMES_S)
        return dense & (self.interval_s > 0)

    def at(self, stamp_ns: Int64, in_clouds: bool = False) -> Transforms:
        """Look up the sensor at stamps (N,), in any order; the worst status of the legs counts."""
        n = len(stamp_ns)
        unturned = np.broadcast_to(np.eye(3), (n, 3, 3))
        found = Transforms(np.zeros((n, 3)), unturned, np.zeros(n, np.uint8))
        for leg in self.legs:
            found = found.then(leg.at(stamp_ns, in_clouds) if isinstance(leg, Moving) else leg)
        return found


def make_chain(steps: Sequence[Edge], max_gap_s: float | None) -> Chain:
    """Make the steps from the map frame to a sensor ready for look-up.

    A step that never moves in the whole log is rigid and holds at all times, so that a fixed
    transform sent on /tf limits nothing. Where nothing moves, the step with the most samples
    says when the robot was seen.
    """
    moving = find_moving(steps)
    # A correction moves `odom`, and something moves below it. REP 105 lets map -> odom
    # jump at any time, and odom -> base_link never.
    corrections = [step for step in moving[:-1] if "odom" in last_part(step.child).lower()]
    max_gap_ns = np.inf if max_gap_s is None else max_gap_s * 1e9
    legs: list[Transforms | Moving] = []
    for step in steps:
        track = step.track
        if step in corrections:  # the limit on gaps is for what moves
            legs.append(Moving(step, find_holds(track), np.inf))
        elif step in moving:
            legs.append(Moving(step, np.zeros(len(track), np.bool_), max_gap_ns))
        elif legs and isinstance(legs[-1], Transforms):
            legs[-1] = legs[-1].then(hold(step))  # once, and not for every batch
        else:
            legs.append(hold(step))
    tracks = [step.track for step in moving if step not in corrections]
    intervals = [float(np.median(track.interval_s)) for track in tracks if len(track) > 1]
    return Chain(tuple(steps), tuple(legs), max(intervals, default=0.0))


def hold(step: Edge) -> Transforms:
    """Make a step that never moves one transform, which holds at all times."""
    held = Transforms.of(step.track.position[:1], step.track.quaternion[:1])
    return held.invert() if step.inverted else held


def find_holds(track: Track) -> Bool:
    """(N,) after which samples a correction of odometry jumps, so that they hold until the next."""
    far = track.step_m > DRIFT_M + DRIFT_M_PER_S * track.interval_s
    turned = track.step_rad > DRIFT_RAD + DRIFT_RAD_PER_S * track.interval_s
    return np.append(far | turned, False)


MAX_TURN_S = 60.0
"""A scan that is said to take longer has a wrong time_increment."""
MAX_AUTO_TURN_S = 1.0
"""The slowest laser that is de-skewed unasked; some drivers write milliseconds for seconds."""
MOMENTS = 33
"""Poses looked up for one de-skewed scan; see `place_beams` for how close that is."""


def choose_deskewed(batch: ScanBatch, deskew: Deskew, chain: Chain) -> tuple[Bool, list[str]]:
    """Choose the scans (S) whose beams get poses of their own, and say what was decided.

    AUTO asks for a believable scan time and for poses dense enough to show the motion in it.
    """
    if deskew is Deskew.OFF:
        return np.zeros(len(batch.stamp_ns), np.bool_), []
    with np.errstate(invalid="ignore", over="ignore"):  # a log may state any number
        duration_s = np.abs(batch.time_increment) * (batch.ranges.shape[1] - 1)
    is_auto = deskew is Deskew.AUTO
    longest_s = MAX_AUTO_TURN_S if is_auto else MAX_TURN_S
    chosen: Bool = (duration_s > 0) & (duration_s <= longest_s)
    notes = []
    if is_auto:
        chosen &= chain.is_dense(duration_s)
    elif not chosen.all():
        notes.append(
            f"scans of {batch.frame!r} that state no believable time between beams are not "
            "de-skewed"
        )
    if chosen.any():
        notes.append(f"de-skewed: each beam of {batch.frame!r} has a pose of its own")
    return chosen, notes


def list_moments(batch: ScanBatch) -> Int64:
    """List the moments (S, K) of scans at which poses are looked up, from their stamps on (ns)."""
    beams = batch.ranges.shape[1]
    seconds = np.linspace(0, (beams - 1) * batch.time_increment, min(beams, MOMENTS), axis=1)
    return np.round(seconds * 1e9).astype(np.int64)


def place_beams(batch: ScanBatch, posed: Bool, found: Transforms) -> PosedScans:
    """Keep the scans (S) that are posed; where there are K moments of each, each beam has a pose.

    Between two moments positions and matrices are interpolated linearly. At 720 degrees a second
    and ten scans a second a matrix is then off by 2e-4: 2 mm at ten metres.
    """
    scans = len(posed)
    position = found.position.reshape(scans, -1, 3)[posed]
    rotation = found.rotation.reshape(scans, -1, 9)[posed]
    batch, moments = batch.take(posed), position.shape[1]
    if moments == 1:
        return PosedScans(batch, position[:, 0], rotation.reshape(-1, 3, 3))
    at = np.linspace(0, moments - 1, batch.ranges.shape[1])
    share = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(moments)))
    rotation = share @ rotation
    return PosedScans(batch, share @ position, rotation.reshape(*rotation.shape[:2], 3, 3))
