"""From single scans to batches: the scans that are used, stacked by geometry."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from occmap.options import BuildOptions, Selection
from occmap.posing import Stamps
from occmap.posing.attach import Poser
from occmap.readers import Echo, Log, ReaderOptions, read_recorded
from occmap.scans.tally import LeftOut, Tally
from occmap.sensor import RangeLimits, read_limits
from occmap.types import Attached, Cloud, Recorded, Scan, ScanBatch, ScanRun


def find_flaw(scan: Scan | Cloud) -> LeftOut | None:
    """Say why nobody can use a scan; None where it can be used."""
    if isinstance(scan, Cloud):
        return None if len(scan.points) else LeftOut.NO_BEAMS
    if not len(scan.ranges):
        return LeftOut.NO_BEAMS
    if not math.isfinite(scan.angle_min + scan.angle_increment * len(scan.ranges)):
        return LeftOut.BAD_ANGLES
    return None


class Selector:
    """Says which scans of one log are used; it is shown all of them, in order."""

    def __init__(self, selection: Selection, stamps: Stamps) -> None:
        self.selection = selection
        self.stamps = stamps
        """Which of a scan's two times counts"""
        self._wants_all = replace(selection, topics=()) == Selection()
        self.first_ns: int | None = None
        """The stamp of the log's first scan; None before it is seen"""
        self._wanted = 0
        """How many scans lie in the time window so far"""
        self.read = 0
        self.left_out: Counter[LeftOut] = Counter()
        """How many of those read `select` left out, by reason"""

    def select(self, scans: Iterable[Recorded]) -> Iterator[Recorded]:
        """Pass on the scans that are used, and count the others."""
        for some, reason in self.judge(scans):
            self.read += some.scans
            if reason is None:
                yield some
            else:
                self.left_out[reason] += 1

    def judge(self, scans: Iterable[Recorded]) -> Iterator[tuple[Recorded, LeftOut | None]]:
        """Give each scan and why it is not used, or None; a run stays whole if all is used."""
        for some in scans:
            # A run is taken whole where the user wants every scan, and these can be used.
            if isinstance(some, ScanRun) and not (self._wants_all and not find_flaw(some.first)):
                yield from ((scan, self._judge_next(scan)) for scan in some.split())
            else:
                yield some, self._judge_next(some.first)

    def _judge_next(self, scan: Scan | Cloud) -> LeftOut | None:
        stamp_ns = self.stamps.choose(scan.stamp_ns, scan.record_ns)
        self.first_ns = stamp_ns if self.first_ns is None else self.first_ns
        if (flaw := find_flaw(scan)) is not None:
            return flaw
        if not self.selection.start_s <= (stamp_ns - self.first_ns) / 1e9 < self.selection.end_s:
            return LeftOut.TIME
        self._wanted += 1
        return LeftOut.STRIDE if (self._wanted - 1) % self.selection.stride else None


BATCH_BEAMS = 1 << 18
"""Beams that are gathered before they are handed on: a few megabytes, and enough work that threads
seldom wait for Python's lock."""

BATCH_POINTS = 1 << 19
"""Points of clouds that are gathered, unless one has more"""
CLOUD_MOMENTS = 33
"""Poses looked up for one cloud whose points have times of their own"""

ECHOES = "MultiEchoLaserScan"
"""The type of scans whose beams have several echoes"""

MOST_TURNS = 1.5
"""Some lasers overlap a little where a turn closes; none goes round twice."""

Geometry: TypeAlias = tuple[tuple[str, str], tuple[float, ...]]
"""What all scans of a batch share: topic and frame, then angles, beams, limits and posed or not."""


def find_geometry(scan: Scan) -> Geometry:
    """Take from a scan what all scans of a batch share."""
    limits, has_pose = read_limits(scan), scan.pose is not None
    angles = scan.angle_min, scan.angle_increment
    return (scan.topic, scan.frame), (*angles, len(scan.ranges), *limits, has_pose)


def stack(scans: Iterable[Recorded], stamps: Stamps) -> Iterator[ScanBatch]:
    """Stack scans, holding no more than a batch at a time; a run is a batch as it is."""
    held: defaultdict[Geometry, list[Scan]] = defaultdict(list)
    clouds: list[Cloud] = []
    beams = 0
    for some in scans:
        if isinstance(some, Cloud):
            if clouds and not can_join(clouds, some):
                yield make_cloud_batch(clouds, stamps)
                clouds = []
            clouds.append(some)
            continue
        if isinstance(some, Scan):
            held[find_geometry(some)].append(some)
            beams += len(some.ranges)
        if isinstance(some, ScanRun) or beams >= BATCH_BEAMS:
            yield from release(held, stamps)
            beams = 0
        if isinstance(some, ScanRun):
            yield make_batch(some, stamps)
    if clouds:
        yield make_cloud_batch(clouds, stamps)
    yield from release(held, stamps)


def can_join(clouds: Sequence[Cloud], other: Cloud) -> bool:
    """Whether a cloud goes into one batch with those before it."""
    kinds = {
        (cloud.topic, cloud.frame, cloud.pose is None, cloud.offset_ns is None)
        for cloud in (clouds[-1], other)
    }
    points = sum(len(cloud.points) for cloud in (*clouds, other))
    return len(kinds) == 1 and points <= BATCH_POINTS


def release(held: dict[Geometry, list[Scan]], stamps: Stamps) -> Iterator[ScanBatch]:
    """Make a batch of the scans of each geometry, and hold them no more."""
    for scans in held.values():
        run = ScanRun(
            scans[0],
            np.array([scan.stamp_ns for scan in scans], np.int64),
            np.array([scan.record_ns for scan in scans], np.int64),
            np.stack([scan.ranges for scan in scans]),
            np.array([scan.time_increment for scan in scans], np.float64),
            np.array([scan.pose for scan in scans]) if scans[0].pose is not None else None,
        )
        yield make_batch(run, stamps)
    held.clear()


def make_batch(run: ScanRun, stamps: Stamps) -> ScanBatch:
    """Make a batch of scans that are alike."""
    first = run.first
    shape = first.frame, first.angle_min, first.angle_increment, *read_limits(first)
    stamp_ns = stamps.choose(run.stamp_ns, run.record_ns)
    return ScanBatch(*shape, stamp_ns, run.ranges, run.time_increment, run.pose, first.topic)


def make_cloud_batch(clouds: Sequence[Cloud], stamps: Stamps) -> ScanBatch:
    """Make a batch of clouds, which have a beam for each moment that poses are looked up at.

    A cloud begins where its earliest point does.
    """
    first = clouds[0]
    moments = 1 if first.offset_ns is None else CLOUD_MOMENTS
    span = np.array([find_span(cloud) for cloud in clouds])
    stamp_ns, record_ns = np.array([(cloud.stamp_ns, cloud.record_ns) for cloud in clouds]).T
    times = stamps.choose(stamp_ns, record_ns) + span[:, 0]
    step = (span[:, 1] - span[:, 0]) / 1e9 / max(moments - 1, 1)
    ranges = np.zeros((len(clouds), moments), np.float32)
    pose = None if first.pose is None else np.array([cloud.pose for cloud in clouds])
    shape = first.frame, 0.0, math.tau / moments, 0.0, math.inf
    return ScanBatch(*shape, times, ranges, step, pose, first.topic, clouds=tuple(clouds))


def find_span(cloud: Cloud) -> tuple[int, int]:
    """When its first and its last point were measured, after its stamp (ns)."""
    if cloud.offset_ns is None:
        return 0, 0
    return int(cloud.offset_ns.min()), int(cloud.offset_ns.max())


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


def list_idle(log: Log, topics: Sequence[str], options: ReaderOptions) -> Iterator[str]:
    """Say which options of its reader a log has no use for."""
    types = [stream.type for stream in log.streams if stream.topic in topics]
    if options.echo is not Echo.FIRST and not any(each.endswith(ECHOES) for each in types):
        yield f"`echo={options.echo}` does nothing: no topic of scans holds {ECHOES}"


class Drive:
    """The scans of one log that are used, as a stream of batches: selected, limited and posed.

    Parameters
    ----------
    topics
        The topics whose scans are used.
    """

    def __init__(
        self, log: Log, topics: Sequence[str], poser: Poser, options: BuildOptions
    ) -> None:
        self.log, self.topics, self.poser = log, topics, poser
        self.limits = RangeLimits(options.returns)
        self.is_settled = False
        """Whether all scans were read, so that limits and leaps hold from the first scan on"""
        self._options = options
        self._first_ns = 0
        self._odd: dict[str, None] = {}

    def settle(self) -> bool:
        """Say, once all scans were read, whether limits and leaps were known from the first on.

        Else they are from now on, and the scans are to be read once more.
        """
        self.is_settled = True
        return all([self.limits.settle(), self.poser.settle()])

    def foresee(self) -> bool:
        """Read all scans for limits and leaps alone, and settle them."""
        self.limits = RangeLimits(self._options.returns)
        for _ in self.read(Tally()):
            pass
        return self.settle()

    def read(
        self, tally: Tally, wants: Callable[[int, int], bool] | None = None
    ) -> Iterator[Attached]:
        """Read the scans that are used, holding no more than a batch; count what becomes of all.

        Parameters
        ----------
        wants
            Says of each cloud, by its stamp and its number of points, whether it is posed; None:
            all are.
        """
        self.poser.start_over()
        stamps = self._options.posing.stamps
        selector = Selector(self._options.selection, stamps)
        chosen = selector.select(self.limits.watch(read_recorded(self.log, self.topics)))
        if wants is not None:
            chosen = (
                some
                for some in chosen
                if not isinstance(some, Cloud)
                or wants(stamps.choose(some.stamp_ns, some.record_ns), len(some.points))
            )
        batches = stack(chosen, stamps)
        limited = tally.time_each("read", map(self.limits.apply, batches))
        for attached in tally.time_each("pose", self.poser.attach(limited)):
            self._odd |= dict.fromkeys(list_oddities(attached.batch))
            tally.drop(attached.dropped)
            yield attached
            tally.advance(len(attached.batch.stamp_ns))
        tally.frames[str(self.log.path)] = self.poser.fixed
        tally.lasers = max(tally.lasers, len(self.topics))
        tally.scans_read += selector.read
        tally.drop(dict(selector.left_out))
        self._first_ns = selector.first_ns or 0

    def list_notes(self) -> list[str]:
        """Say what there is to say of poses, scans and ranges, once all scans were read."""
        concerns = self.poser.list_concerns(self._first_ns, self._options.returns.max_range)
        # A list, as the poser takes notes meanwhile.
        told = [f"{topic}: {concern.text}" for topic, concern in concerns]
        idle = list_idle(self.log, self.topics, self._options.reading)
        return [*idle, *self.poser.notes, *self._odd, *told, *self.limits.list_notes()]
