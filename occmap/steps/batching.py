"""From single scans to batches: the scans that are used, stacked by geometry."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

import numpy as np

from occmap.posing.options import Stamps
from occmap.selection import Selector
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import read_limits
from occmap.types import Cloud, Int64, Recorded, Scan, ScanBatch, ScanRun

BATCH_BEAMS = 1 << 18
"""Beams that are gathered before they are handed on: a few megabytes, and enough work that threads
seldom wait for Python's lock."""

CLOUD_MOMENTS = 33
"""Poses looked up for one cloud whose points have times of their own"""

MOST_TURNS = 1.5
"""Some lasers overlap a little where a turn closes; none goes round twice."""

Geometry: TypeAlias = tuple[tuple[str, str], tuple[float, ...]]
"""What all scans of a batch share: topic and frame, then angles, beams, limits and posed or not."""


def find_geometry(scan: Scan) -> Geometry:
    """Take from a scan what all scans of a batch share."""
    limits, has_pose = read_limits(scan), scan.pose is not None
    angles = scan.angle_min, scan.angle_increment
    return (scan.topic, scan.frame), (*angles, len(scan.ranges), *limits, has_pose)


def batch_scans(
    scans: Iterable[Recorded], selector: Selector, limits: RangeLimits
) -> Iterator[ScanBatch]:
    """Batch the scans of a log that are used; from its limit on, a range means "no return".

    All scans are shown to the limits, since those that are not used tell of the laser, too.
    """
    used = selector.select(limits.watch(scans))
    return map(limits.apply, stack(used, selector.stamps))


def stack(scans: Iterable[Recorded], stamps: Stamps) -> Iterator[ScanBatch]:
    """Stack scans, holding no more than a batch at a time; a run is a batch as it is."""
    held: dict[Geometry, dict[int, Scan]] = {}
    beams = 0
    for number, some in enumerate(scans):
        if isinstance(some, Cloud):
            yield make_cloud_batch(some, stamps)
            continue
        if isinstance(some, Scan):
            held.setdefault(find_geometry(some), {})[number] = some
            beams += len(some.ranges)
        if isinstance(some, ScanRun) or beams >= BATCH_BEAMS:
            yield from release(held, stamps)
            held, beams = {}, 0
        if isinstance(some, ScanRun):
            yield make_batch(some, stamps)
    yield from release(held, stamps)


def release(held: Mapping[Geometry, Mapping[int, Scan]], stamps: Stamps) -> Iterator[ScanBatch]:
    """Make a batch of the scans of each geometry; these are held by their places in the stream."""
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
        yield make_batch(run, stamps, number)


def make_batch(run: ScanRun, stamps: Stamps, number: Int64 | None = None) -> ScanBatch:
    """Make a batch of scans that are alike."""
    first = run.first
    shape = first.frame, first.angle_min, first.angle_increment, *read_limits(first)
    stamp_ns = stamps.choose(run.stamp_ns, run.record_ns)
    differing = stamp_ns, run.ranges, run.time_increment, run.pose
    return ScanBatch(*shape, *differing, first.topic, number)


def make_cloud_batch(cloud: Cloud, stamps: Stamps) -> ScanBatch:
    """Make a batch of one cloud, which has a beam for each moment that its poses are looked up at.

    It begins where its earliest point does.
    """
    start, stop, moments = 0, 0, 1
    if cloud.offset_ns is not None:
        start, stop, moments = int(cloud.offset_ns.min()), int(cloud.offset_ns.max()), CLOUD_MOMENTS
    stamp_ns = stamps.choose(np.array([cloud.stamp_ns]), np.array([cloud.record_ns])) + start
    pose = None if cloud.pose is None else np.array([cloud.pose])
    ranges, step = np.zeros((1, moments), np.float32), (stop - start) / 1e9 / max(moments - 1, 1)
    shape = cloud.frame, 0.0, math.tau / moments, 0.0, math.inf
    times = stamp_ns, ranges, np.array([step])
    return ScanBatch(*shape, *times, pose, cloud.topic, clouds=(cloud,))


def list_oddities(batch: ScanBatch) -> Iterator[str]:
    """Say what is odd about the beams of scans, and on which topic."""
    if oddity := find_oddity(batch.angle_increment, batch.ranges.shape[1]):
        yield f"{batch.topic}: {oddity}"


def find_oddity(angle_increment: float, beams: int) -> str:
    """Say what is odd about angles; "" where nothing is."""
    turns = abs(angle_increment) * (beams - 1) / math.tau
    if MOST_TURNS < turns < math.inf:
        return f"{beams} beams go round {turns:.3g} times: angles are radians; are these degrees?"
    if beams > 1 and angle_increment == 0:
        return f"{beams} beams all point the same way: angle_increment is 0"
    return ""
