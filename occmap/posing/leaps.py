"""Leaps: a damaged pose takes a scan to where the robot cannot have been, and the map with it."""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from occmap.posing.options import DropReason
from occmap.types import Bool, Float64, Int64, PosedScans

SLACK_M = 1.0
"""A shorter step is no leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
FASTEST = 50.0
"""What is told of where all scans are kept (m/s): cars reach it."""
RARE = 10
"""At most one step in so many may be a leap. Where there are more, stamps or poses do not mean what
they seem to, and no scan is left out."""


class Ends(NamedTuple):
    """Where the scans of one topic begin and end."""

    stamp_ns: Int64
    """(2,)"""
    place: Float64
    """(2, 3) m"""
    leaps: int
    """Leaps between scans, whether or not any scan is left out for it"""

    def leads_to(self, other: Self, max_speed: float) -> bool:
        """Whether no leap lies between these scans and others that follow them."""
        stamp_ns = np.array([self.stamp_ns[1], other.stamp_ns[0]])
        _, leaps = find_leaps(stamp_ns, np.stack([self.place[1], other.place[0]]), max_speed)
        return not leaps.any()


def find_leaps(stamp_ns: Int64, place: Float64, max_speed: float) -> tuple[Bool, Bool]:
    """Which steps between scans (S,) at places (S, 3) are short in time, and which of them leap."""
    seconds = np.diff(stamp_ns) / 1e9
    metres = np.linalg.norm(np.diff(place, axis=0), axis=1)
    near: Bool = (seconds > 0) & (seconds <= SPARSE_S)
    return near, near & (metres > np.maximum(SLACK_M, max_speed * seconds))


@dataclass
class _Path:
    """Where the scans of one topic led so far."""

    stamp_ns: Int64 = field(default_factory=lambda: np.zeros(0, np.int64))
    """(2,) of the last two scans, fewer in the beginning ..."""
    place: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """(2, 3) ... and where they were (m)"""
    begin: tuple[Int64, Float64] | None = None
    """(1,) and (1, 3) of the first scan"""
    steps: int = 0
    leaps: int = 0
    is_noted: bool = False


class LeapFilter:
    """Leaves out scans that lie too far from both neighbours, for the time between."""

    def __init__(self, max_speed: float, notes: list[str]) -> None:
        self._keeps_all = max_speed == np.inf
        self._max_speed = FASTEST if self._keeps_all else max_speed
        self._notes = notes
        """Grows by what the first scan of each topic that is left out did"""
        self._paths: defaultdict[str, _Path] = defaultdict(_Path)

    @property
    def _outcome(self) -> str:
        if self._keeps_all:
            return "the map reaches there, as `max_speed=inf` keeps such scans"
        return "it and others that leap so are left out; `max_speed=inf` keeps them"

    def find_ends(self) -> dict[str, Ends]:
        """Where the scans that were seen begin and end, by topic."""
        return {
            topic: Ends(
                np.append(path.begin[0], path.stamp_ns[-1:]),
                np.concatenate([path.begin[1], path.place[-1:]]),
                path.leaps,
            )
            for topic, path in self._paths.items()
            if path.begin is not None
        }

    def drop(
        self, posed: list[PosedScans], dropped: dict[DropReason, int]
    ) -> tuple[list[PosedScans], dict[DropReason, int]]:
        """Leave out the scans that leap, and count them among those without a usable pose."""
        kept = []
        for scans in posed:
            astray = self._find_astray(scans)
            if self._keeps_all or not astray.any():
                kept.append(scans)
                continue
            leaps = int(np.count_nonzero(astray))
            dropped = {**dropped, DropReason.LEAP: dropped.get(DropReason.LEAP, 0) + leaps}
            if leaps < len(astray):
                rest = scans.batch.take(~astray)
                kept.append(PosedScans(rest, scans.position[~astray], scans.rotation[~astray]))
        return kept, dropped

    def _find_astray(self, scans: PosedScans) -> Bool:
        """Tell which scans (S,) are a leap away from both of their neighbours.

        At an end of the path, or beside a long pause, the only neighbour must fit another scan.
        """
        path = self._paths[scans.batch.topic]
        old = len(path.stamp_ns)
        place = scans.position if scans.position.ndim == 2 else scans.position[:, 0]
        stamp_ns = np.concatenate([path.stamp_ns, scans.batch.stamp_ns])
        place = np.concatenate([path.place, place])
        path.stamp_ns, path.place = stamp_ns[-2:], place[-2:]
        path.begin = path.begin or (stamp_ns[:1], place[:1])

        near, leaps = find_leaps(stamp_ns, place, self._max_speed)
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
            metres = np.linalg.norm(place[step + 1] - place[step])
            seconds = (stamp_ns[step + 1] - stamp_ns[step]) / 1e9
            self._notes.append(
                f"{scans.batch.topic}: the scan at {stamp_ns[at] / 1e9:.3f} s lies "
                f"{metres:,.6g} m from its neighbour, {seconds:.3g} s away: {self._outcome}"
            )
        return astray
