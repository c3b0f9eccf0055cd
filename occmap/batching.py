"""From single scans to batches: the scans that are wanted, stacked by geometry."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Annotated, NamedTuple, TypeAlias, overload

import numpy as np

from occmap.arrays import Int64
from occmap.errors import require
from occmap.posing.options import Stamps
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import read_limits
from occmap.types import Scan, ScanBatch, ScanRun, Seconds

BATCH_BEAMS = 1 << 18
"""Beams that are gathered before they are handed on: a few megabytes, and enough work that threads
seldom wait for Python's lock."""

MOST_TURNS = 1.5
"""Some lasers overlap a little where a turn closes; none goes round twice."""

Geometry: TypeAlias = tuple[tuple[str, str], tuple[float, ...]]
"""What all scans of a batch share: topic and frame, then angles, beams, limits and posed or not."""


class LeftOut(StrEnum):
    """Why a scan is not used, before its pose is looked up."""

    NO_BEAMS = "no beams"
    BAD_ANGLES = "angles not finite"
    TIME = "outside `start_s` and `end_s`"
    STRIDE = "left out by `stride`"


NOT_ASKED_FOR = (LeftOut.TIME, LeftOut.STRIDE)
"""The user's own choice: nothing is wrong with these scans, and none of them is lost."""


def count_wanted(read: int, unused: Mapping[str, int]) -> int:
    """Count the scans that were asked for, of those read; `unused` counts scans by reason."""
    return read - sum(unused.get(reason, 0) for reason in NOT_ASKED_FOR)


@dataclass(frozen=True)
class Selection:
    """Which scans of a log to use; two parts that end and start at one time share no scan.

    Raises
    ------
    UsageError
        The values leave no scan to use.
    """

    topics: Annotated[tuple[str, ...], "TOPIC"] = ()
    """Use the scans of this topic."""
    start_s: Seconds = -math.inf
    """Use scans from this time after the first on."""
    end_s: Seconds = math.inf
    """Use scans before this time after the first."""
    stride: Annotated[int, "N"] = 1
    """Use every N-th of these scans."""

    def __post_init__(self) -> None:
        require(self.stride >= 1, f"a stride of {self.stride} is not possible", "give 1 or more")
        found = f"`start_s={self.start_s}` is not before `end_s={self.end_s}`"
        fix = "both are in seconds after the log's first scan"
        require(self.start_s < self.end_s, found, fix)


def find_geometry(scan: Scan) -> Geometry:
    """Take from a scan what all scans of a batch share."""
    limits, has_pose = read_limits(scan), scan.pose is not None
    angles = scan.angle_min, scan.angle_increment
    return (scan.topic, scan.frame), (*angles, len(scan.ranges), *limits, has_pose)


def find_flaw(scan: Scan) -> LeftOut | None:
    """Say why nobody can use a scan; None where it can be used."""
    if not len(scan.ranges):
        return LeftOut.NO_BEAMS
    if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
        return LeftOut.BAD_ANGLES
    return None


class Seam(NamedTuple):
    """What a part of a log needs to know of the parts before it to select its scans."""

    first_ns: int | None = None
    """The stamp of the log's first scan; None: it is in this part"""
    wanted: int = 0
    """How many scans of the parts before lie in the time window"""


FROM_THE_START = Seam()


class Selector:
    """Says which scans of one log are not used, and why; it is shown all of them, in order."""

    def __init__(self, selection: Selection, stamps: Stamps, seam: Seam = FROM_THE_START) -> None:
        self.selection = selection
        self._stamps = stamps
        self._wants_all = replace(selection, topics=()) == Selection()
        self.seam = seam
        """The seam between the scans so far and those to come"""

    def judge(
        self, scans: Iterable[Scan | ScanRun]
    ) -> Iterator[tuple[Scan | ScanRun, LeftOut | None]]:
        """Give each scan and why it is not used, or None; a run stays whole if all is used."""
        for some in scans:
            # A run is taken whole where the user wants every scan, and these can be used.
            if isinstance(some, Scan) or (self._wants_all and find_flaw(some.first) is None):
                yield some, self._judge_next(some.first)
            else:
                yield from ((scan, self._judge_next(scan)) for scan in some.split())

    def _judge_next(self, scan: Scan) -> LeftOut | None:
        first_ns, wanted = self.seam
        stamp_ns = self.stamp(scan)
        first_ns = stamp_ns if first_ns is None else first_ns
        self.seam = Seam(first_ns, wanted)
        if (flaw := find_flaw(scan)) is not None:
            return flaw
        if not self.selection.start_s <= (stamp_ns - first_ns) / 1e9 < self.selection.end_s:
            return LeftOut.TIME
        self.seam = Seam(first_ns, wanted + 1)
        return LeftOut.STRIDE if wanted % self.selection.stride else None

    @overload
    def stamp(self, some: Scan) -> int: ...
    @overload
    def stamp(self, some: ScanRun) -> Int64: ...
    def stamp(self, some: Scan | ScanRun) -> int | Int64:
        """The time that counts (ns): of a scan, or (S,) of those of a run."""
        return some.record_ns if self._stamps is Stamps.RECORD else some.stamp_ns


class Batcher:
    """Selects and stacks the scans of one log; `left_out` counts the others by reason.

    `notes` say what is odd about the scans; each sentence once.
    """

    def __init__(
        self,
        selection: Selection,
        stamps: Stamps = Stamps.HEADER,
        limits: RangeLimits | None = None,
        seam: Seam = FROM_THE_START,
    ) -> None:
        self.read = 0
        self.left_out: Counter[LeftOut] = Counter()
        self.notes: list[str] = []
        self._selector = Selector(selection, stamps, seam)
        self._limits = limits

    @property
    def first_ns(self) -> int:
        """The stamp of the log's first scan; 0 where none was read."""
        return self._selector.seam.first_ns or 0

    def stack(self, scans: Iterable[Scan | ScanRun]) -> Iterator[ScanBatch]:
        """Stack scans, holding no more than a batch at a time; a run is a batch as it is."""
        held: dict[Geometry, dict[int, Scan]] = {}
        beams = 0
        for some, reason in self._selector.judge(scans):
            self.read += some.scans
            if self._limits is not None:
                self._limits.see(some)
            if reason is not None:
                self.left_out[reason] += 1
                continue
            if isinstance(some, Scan):
                held.setdefault(find_geometry(some), {})[self.read] = some
                beams += len(some.ranges)
            if isinstance(some, ScanRun) or beams >= BATCH_BEAMS:
                yield from self._release(held)
                held, beams = {}, 0
            if isinstance(some, ScanRun):
                yield self._make_batch(some)
        yield from self._release(held)

    def _release(self, held: Mapping[Geometry, Mapping[int, Scan]]) -> Iterator[ScanBatch]:
        lasers = Counter(laser for laser, _ in held)
        for (laser, _), numbered in held.items():
            scans = list(numbered.values())
            run = ScanRun(
                scans[0],
                np.array([scan.stamp_ns for scan in scans], np.int64),
                np.array([scan.record_ns for scan in scans], np.int64),
                np.stack([scan.ranges for scan in scans]),
                np.array([scan.time_increment for scan in scans], np.float64),
                np.array([scan.pose for scan in scans]) if scans[0].pose is not None else None,
            )
            number = np.array([*numbered], np.int64) if lasers[laser] > 1 else None
            yield self._make_batch(run, number)

    def _make_batch(self, run: ScanRun, number: Int64 | None = None) -> ScanBatch:
        """Make a batch of scans that are alike, and note what is odd about them."""
        first = run.first
        oddity = find_oddity(first.angle_increment, len(first.ranges))
        if oddity and (note := f"{first.topic}: {oddity}") not in self.notes:
            self.notes.append(note)
        shape = first.frame, first.angle_min, first.angle_increment, *read_limits(first)
        differing = self._selector.stamp(run), run.ranges, run.time_increment, run.pose
        batch = ScanBatch(*shape, *differing, first.topic, number)
        return batch if self._limits is None else self._limits.apply(batch)


def find_oddity(angle_increment: float, beams: int) -> str:
    """Say what is odd about angles; "" where nothing is."""
    turns = abs(angle_increment) * (beams - 1) / math.tau
    if MOST_TURNS < turns < math.inf:
        return f"{beams} beams go round {turns:.3g} times: angles are radians; are these degrees?"
    if beams > 1 and angle_increment == 0:
        return f"{beams} beams all point the same way: angle_increment is 0"
    return ""
