"""Leaps: a damaged pose takes a scan to where the robot cannot have been, and the map with it."""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from occmap.posing.options import DropReason
from occmap.types import Bool, Float64, Int64, PosedScans

SLACK_M = 1.0
"""A shorter step is no leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
RARE = 10
"""Among so many steps one at most may be a leap; where more are, stamps or poses mean another
thing than they say, and no step is called one."""


@dataclass
class _Path:
    """Where the scans of one topic led so far."""

    stamp_ns: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    """(2,) of the last two scans, fewer in the beginning ..."""
    place: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """(2, 3) ... and where they were (m)"""
    steps: int = 0
    leaps: int = 0
    is_noted: bool = False


class LeapFilter:
    """Leaves out scans that lie too far from both neighbours, for the time between."""

    def __init__(self, max_speed: float, notes: list[str]) -> None:
        self._max_speed = max_speed
        self._notes = notes
        """Grows by what the first scan of each topic that is left out did"""
        self._paths: defaultdict[str, _Path] = defaultdict(_Path)

    def drop(
        self, posed: list[PosedScans], dropped: dict[DropReason, int]
    ) -> tuple[list[PosedScans], dict[DropReason, int]]:
        """Leave out the scans that leap, and count them among those without a usable pose."""
        if self._max_speed == np.inf:
            return posed, dropped
        kept = []
        for scans in posed:
            astray = self._find_astray(scans)
            if not astray.any():
                kept.append(scans)
                continue
            leaps = int(np.count_nonzero(astray))
            dropped = {**dropped, DropReason.LEAP: dropped.get(DropReason.LEAP, 0) + leaps}
            if leaps < len(astray):
                rest = scans.batch.take(~astray)
                kept.append(PosedScans(rest, scans.position[~astray], scans.rotation[~astray]))
        return kept, dropped

    def _find_astray(self, scans: PosedScans) -> Bool:
        """(S,) which scans fit neither neighbour: leaps lead to and from them.

        At an end of the path, or beside a long pause, it is one leap from a scan that fits another.
        """
        path = self._paths[scans.batch.topic]
        old = len(path.stamp_ns)
        place = scans.position if scans.position.ndim == 2 else scans.position[:, 0]
        stamp_ns = np.concatenate([path.stamp_ns, scans.batch.stamp_ns])
        place = np.concatenate([path.place, place])
        path.stamp_ns, path.place = stamp_ns[-2:], place[-2:]

        seconds = np.diff(stamp_ns) / 1e9
        metres = np.linalg.norm(np.diff(place, axis=0), axis=1)
        near = (seconds > 0) & (seconds <= SPARSE_S)
        leaps = near & (metres > np.maximum(SLACK_M, self._max_speed * seconds))
        path.steps += int(np.count_nonzero(near[max(old - 1, 0) :]))
        path.leaps += int(np.count_nonzero(leaps[max(old - 1, 0) :]))
        if path.leaps * RARE > path.steps:
            return np.zeros(len(stamp_ns) - old, np.bool_)
        to, away = np.append(False, leaps), np.append(leaps, False)
        fits = np.append(False, near & ~leaps) | np.append(near & ~leaps, False)
        beside = (to & np.append(False, fits[:-1])) | (away & np.append(fits[1:], False))
        astray: Bool = (~fits & (beside | (to & away)))[old:]
        if astray.any() and not path.is_noted:
            path.is_noted = True
            at = int(np.flatnonzero(astray)[0]) + old
            step = at - 1 if to[at] else at
            self._notes.append(
                f"{scans.batch.topic}: the scan at {stamp_ns[at] / 1e9:.3f} s lies "
                f"{metres[step]:,.6g} m from its neighbour, {seconds[step]:.3g} s away: it and "
                "others that leap so are left out; `max_speed=inf` keeps them"
            )
        return astray
