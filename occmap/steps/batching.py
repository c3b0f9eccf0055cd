"""From single scans to batches: the scans that are wanted, stacked by geometry."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

import numpy as np

from occmap.arrays import Int64
from occmap.posing.options import Stamps
from occmap.selection import FROM_THE_START, LeftOut, Seam, Selection, Selector
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import read_limits
from occmap.types import Scan, ScanBatch, ScanRun

BATCH_BEAMS = 1 << 18
"""Beams that are gathered before they are handed on: a few megabytes, and enough work that threads
seldom wait for Python's lock."""

MOST_TURNS = 1.5
"""Some lasers overlap a little where a turn closes; none goes round twice."""

Geometry: TypeAlias = tuple[tuple[str, str], tuple[float, ...]]
"""What all scans of a batch share: topic and frame, then angles, beams, limits and posed or not."""


def find_geometry(scan: Scan) -> Geometry:
    """Take from a scan what all scans of a batch share."""
    limits, has_pose = read_limits(scan), scan.pose is not None
    angles = scan.angle_min, scan.angle_increment
    return (scan.topic, scan.frame), (*angles, len(scan.ranges), *limits, has_pose)


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
