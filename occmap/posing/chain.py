"""Chains: the poses of a sensor in the map frame, through any number of frames in between."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from occmap.posing.frames import Step, last_part
from occmap.posing.options import DropReason
from occmap.posing.rotations import rotate_by, slerp
from occmap.posing.tracks import Track
from occmap.types import Bool, Float64, Int64, UInt8

DRIFT_M = 0.1
DRIFT_M_PER_S = 0.05
DRIFT_RAD = 0.05
DRIFT_RAD_PER_S = 0.01
"""The most that a correction of odometry grows by itself: 5 cm a second is a bad odometer."""

DENSE_S = 0.1
"""A robot's velocity hardly changes in this time, so a turn of the laser is seen, not guessed."""


class Status(IntEnum):
    """Whether there is a pose at a stamp; the worst leg of a chain counts."""

    POSED = 0
    BEFORE = 1
    AFTER = 2
    GAP = 3
    NOT_FINITE = 4


REASONS = {
    Status.BEFORE: DropReason.BEFORE,
    Status.AFTER: DropReason.AFTER,
    Status.GAP: DropReason.GAP,
    Status.NOT_FINITE: DropReason.NOT_FINITE,
}


class Found(NamedTuple):
    """What a chain knows at N stamps; position and rotation mean something where POSED."""

    position: Float64
    """(N, 3) m"""
    rotation: Float64
    """(N, 3, 3)"""
    status: UInt8
    """(N,) of Status"""


@dataclass(frozen=True, eq=False)
class _Rigid:
    """A leg that is the same at all times."""

    position: Float64
    rotation: Float64

    def at(self, stamp_ns: Int64) -> Found:
        return Found(self.position, self.rotation, np.zeros(len(stamp_ns), np.uint8))


@dataclass(frozen=True, eq=False)
class _Moving:
    """A leg that is interpolated between the two samples around a stamp."""

    track: Track
    holds: Bool
    """(N - 1,): the pose jumped between two samples, and the earlier one holds until then."""
    max_gap_ns: float

    def at(self, stamp_ns: Int64) -> Found:
        stamps = self.track.stamp_ns
        last = len(stamps) - 1
        earlier = np.clip(np.searchsorted(stamps, stamp_ns, side="right") - 1, 0, last)
        later = np.minimum(earlier + 1, last)
        width = stamps[later] - stamps[earlier]
        since = np.clip(stamp_ns - stamps[earlier], 0, width)

        fraction = since / np.maximum(width, 1)
        fraction[self.holds[earlier]] = 0
        start, end = self.track.position[earlier], self.track.position[later]
        position = start + fraction[:, None] * (end - start)
        rotation = slerp(self.track.quaternion[earlier], self.track.quaternion[later], fraction)

        status = np.zeros(len(stamp_ns), np.uint8)
        status[(width > self.max_gap_ns) & (since > 0)] = Status.GAP
        status[stamp_ns < stamps[0]] = Status.BEFORE
        status[stamp_ns > stamps[-1]] = Status.AFTER
        return Found(position, rotate_by(rotation), status)


@dataclass(frozen=True, eq=False)
class _Inverse:
    """A leg that was recorded the other way round."""

    leg: "_Rigid | _Moving"

    def at(self, stamp_ns: Int64) -> Found:
        position, rotation, status = self.leg.at(stamp_ns)
        back = rotation.swapaxes(1, 2)
        return Found(-apply(back, position), back, status)


@dataclass(frozen=True, eq=False)
class Chain:
    """The way from the map frame to a sensor."""

    steps: tuple[Step, ...]
    """From the map frame downwards."""
    legs: tuple[_Rigid | _Moving | _Inverse, ...]
    interval_s: float
    """Median time between the samples of the leg that is sampled least; 0 where none moves. What
    corrects odometry now and then does not count: it says nothing about the drive."""

    @property
    def frames(self) -> tuple[str, ...]:
        """The frames from the map to the sensor."""
        return (self.steps[0].upper, *(step.lower for step in self.steps)) if self.steps else ()

    def is_dense(self, duration_s: Float64) -> Bool:
        """Whether the poses show how the sensor moved within durations (N,)."""
        dense: Bool = self.interval_s <= np.maximum(duration_s, DENSE_S)
        return dense & (self.interval_s > 0)

    def at(self, stamp_ns: Int64) -> Found:
        """Interpolate at stamps (N,), in any order."""
        n = len(stamp_ns)
        position, rotation = np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3))
        status = np.zeros(n, np.uint8)
        for leg in self.legs:
            found = leg.at(stamp_ns)
            position = position + apply(rotation, found.position)
            rotation = rotation @ found.rotation
            status = np.maximum(status, found.status)
        return Found(position, rotation, status)


def make_chain(steps: Sequence[Step], max_gap_s: float | None) -> Chain:
    """Make the steps from the map frame to a sensor ready for look-up.

    What never moves in the whole log is taken as rigid and holds at all times, so that a fixed
    transform sent on /tf limits nothing. Where nothing moves, the step with the most samples
    says when the robot was seen.
    """
    steps = tuple(steps)
    moving = _find_moving(steps)
    max_gap_ns = np.inf if max_gap_s is None else max_gap_s * 1e9
    legs: list[_Rigid | _Moving | _Inverse] = []
    for step in steps:
        # A correction holds until the next: the limit is for what moves.
        limit_ns = np.inf if _is_correction(step, steps) else max_gap_ns
        leg = (
            _Moving(step.edge.track, _find_jumps(step, steps), limit_ns)
            if step in moving
            else _Rigid(step.edge.track.position[:1], rotate_by(step.edge.track.quaternion[:1]))
        )
        legs.append(_Inverse(leg) if step.inverted else leg)
    driven = [step for step in moving if not _is_correction(step, steps)]
    intervals = [float(np.median(s.edge.track.interval_s)) for s in driven if len(s.edge.track) > 1]
    return Chain(steps, _merge(legs), max(intervals, default=0.0))


def find_driven(steps: Sequence[Step]) -> Step | None:
    """Find the lowest step that moves; None where all are fixed for good."""
    moving = _find_moving(steps)
    return moving[-1] if moving else None


def _find_moving(steps: Sequence[Step]) -> list[Step]:
    moving = [step for step in steps if step.edge.track.moves]
    sampled = [step for step in steps if not step.edge.track.static]
    if moving or not sampled:
        return moving
    return [max(sampled, key=lambda step: len(step.edge.track))]


def _is_correction(step: Step, steps: Sequence[Step]) -> bool:
    """Tell whether a step corrects odometry: it moves `odom`, and something moves below it.

    REP 105 lets map -> odom jump at any time, and odom -> base_link never.
    """
    moving = _find_moving(steps)
    below = moving[moving.index(step) + 1 :] if step in moving else []
    return bool(below) and "odom" in last_part(step.edge.child).lower()


def _find_jumps(step: Step, steps: Sequence[Step]) -> Bool:
    """Find the samples (N,) after which a correction jumps, as at the closing of a loop.

    Halfway through such a jump the robot was never there, so nothing is interpolated.
    """
    track = step.edge.track
    jumps = np.zeros(len(track), np.bool_)
    if _is_correction(step, steps):
        far = track.step_m > DRIFT_M + DRIFT_M_PER_S * track.interval_s
        turned = track.step_rad > DRIFT_RAD + DRIFT_RAD_PER_S * track.interval_s
        jumps[:-1] = far | turned
    return jumps


def _merge(
    legs: Sequence[_Rigid | _Moving | _Inverse],
) -> tuple[_Rigid | _Moving | _Inverse, ...]:
    """Multiply out neighbouring rigid legs once, not for every batch."""
    merged: list[_Rigid | _Moving | _Inverse] = []
    for leg in legs:
        before = merged[-1] if merged else None
        if isinstance(leg, _Rigid) and isinstance(before, _Rigid):
            position = before.position + apply(before.rotation, leg.position)
            merged[-1] = _Rigid(position, before.rotation @ leg.rotation)
        else:
            merged.append(leg)
    return tuple(merged)


def apply(rotation: Float64, position: Float64) -> Float64:
    """Rotate vectors (N, 3) by matrices (N, 3, 3); either N may be 1."""
    turned: Float64 = (rotation @ position[..., None])[..., 0]
    return turned
