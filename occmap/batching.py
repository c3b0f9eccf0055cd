"""From single scans to batches: the scans that are wanted, stacked by geometry."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from occmap.errors import UsageError
from occmap.types import Scan, ScanBatch

BATCH_BEAMS = 1 << 18
"""Beams that are held before they are handed on: a few megabytes, and enough work that threads
seldom wait for each other's Python."""


class LeftOut(StrEnum):
    """Why a scan is not used, before anybody asks where it was taken."""

    NO_BEAMS = "no beams"
    BAD_ANGLES = "angles not finite"
    TIME = "outside --start and --end"
    STRIDE = "left out by --stride"


NOT_ASKED_FOR = (LeftOut.TIME, LeftOut.STRIDE)
"""The user's own choice: nothing is wrong with these scans, and none of them is lost."""


def count_wanted(read: int, unused: Mapping[str, int]) -> int:
    """Of the scans that were read, how many were asked for; the others are `unused`, by reason."""
    return read - sum(unused.get(reason, 0) for reason in NOT_ASKED_FOR)


@dataclass(frozen=True)
class Selection:
    """Which scans of a log to use.

    Parameters
    ----------
    topics
        The scan topics; empty: all.
    start_s, end_s
        Seconds after the log's first scan; the end is outside, so that a log that is cut at any
        moment falls into parts that share no scan.
    stride
        Every so manieth scan of those in the time window.
    """

    topics: tuple[str, ...] = ()
    start_s: float = -math.inf
    end_s: float = math.inf
    stride: int = 1

    def __post_init__(self) -> None:
        if self.stride < 1:
            raise UsageError(f"a stride of {self.stride} is not possible", fix="give 1 or more")
        if not self.start_s < self.end_s:
            raise UsageError(
                f"--start {self.start_s} is not before --end {self.end_s}",
                fix="both are in seconds after the log's first scan",
            )


class Geometry(NamedTuple):
    """What scans must share to be stacked."""

    topic: str
    frame: str
    angle_min: float
    angle_increment: float
    beams: int
    range_min: float
    range_max: float
    time_increment: float
    posed: bool


class Selector:
    """Says of the scans of one log, one after the other, which are not used, and why."""

    def __init__(self, selection: Selection, *, by_record_time: bool = False) -> None:
        self.selection = selection
        self._by_record_time = by_record_time
        self._first_ns: int | None = None
        self._wanted = 0

    def find_fault(self, scan: Scan) -> LeftOut | None:
        """Say why the next scan is not used; None where it is."""
        stamp_ns = self.stamp(scan)
        if self._first_ns is None:
            self._first_ns = stamp_ns
        if not len(scan.ranges):
            return LeftOut.NO_BEAMS
        if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
            return LeftOut.BAD_ANGLES
        seconds = (stamp_ns - self._first_ns) / 1e9
        if not self.selection.start_s <= seconds < self.selection.end_s:
            return LeftOut.TIME
        self._wanted += 1
        return LeftOut.STRIDE if (self._wanted - 1) % self.selection.stride else None

    def stamp(self, scan: Scan) -> int:
        """The time of a scan that counts (ns)."""
        return scan.record_ns if self._by_record_time else scan.stamp_ns


class Batcher:
    """Selects and stacks the scans of one log; `left_out` counts the others by reason."""

    def __init__(self, selection: Selection, *, by_record_time: bool = False) -> None:
        self.read = 0
        self.left_out: dict[LeftOut, int] = {}
        self._selector = Selector(selection, by_record_time=by_record_time)

    def stack(self, scans: Iterable[Scan]) -> Iterator[ScanBatch]:
        """Stack scans, holding no more than a batch at a time."""
        held: dict[Geometry, list[Scan]] = {}
        beams = 0
        for scan in scans:
            self.read += 1
            reason = self._selector.find_fault(scan)
            if reason is not None:
                self.left_out[reason] = self.left_out.get(reason, 0) + 1
                continue
            held.setdefault(describe(scan), []).append(scan)
            beams += len(scan.ranges)
            if beams >= BATCH_BEAMS:
                yield from self._release(held)
                held, beams = {}, 0
        yield from self._release(held)

    def _release(self, held: dict[Geometry, list[Scan]]) -> Iterator[ScanBatch]:
        for geometry, scans in held.items():
            yield ScanBatch(
                frame=geometry.frame,
                angle_min=geometry.angle_min,
                angle_increment=geometry.angle_increment,
                range_min=geometry.range_min,
                range_max=geometry.range_max,
                time_increment=geometry.time_increment,
                stamp_ns=np.array([self._selector.stamp(scan) for scan in scans], np.int64),
                ranges=np.stack([scan.ranges for scan in scans]),
                pose=np.array([scan.pose for scan in scans]) if geometry.posed else None,
                topic=geometry.topic,
            )


def describe(scan: Scan) -> Geometry:
    """What a scan must share with others to be stacked; limits that mean none are made so."""
    return Geometry(
        scan.topic,
        scan.frame,
        scan.angle_min,
        scan.angle_increment,
        len(scan.ranges),
        scan.range_min if scan.range_min >= 0 else 0.0,
        scan.range_max if scan.range_max > 0 else math.inf,
        scan.time_increment,
        scan.pose is not None,
    )
