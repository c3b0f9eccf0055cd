"""From single scans to batches: the scans that are used, stacked by geometry, or a sample."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from occmap.cells import Ground
from occmap.options import BuildOptions, Selection
from occmap.posing import Concern, Doubt, Stamps
from occmap.posing.attach import Poser
from occmap.readers import Echo, Log, ReaderOptions, Role, read_recorded
from occmap.readers.depth import clean_cloud
from occmap.scans import TopicSample
from occmap.scans.logs import choose_topics, count_scans
from occmap.scans.tally import LeftOut, Tally
from occmap.sensor import drop_own_points, read_limits
from occmap.sensor.bands import RangeLimits
from occmap.types import Cloud, PosedScans, Recorded, Scan, ScanBatch


def find_flaw(some: Recorded) -> LeftOut | None:
    """Say why nobody can use a scan, or those of a batch; None where they can be used."""
    beams = len(some.points) if isinstance(some, Cloud) else some.ranges.shape[-1]
    if not beams:
        return LeftOut.NO_BEAMS
    last = 0.0 if isinstance(some, Cloud) else some.angle_min + some.angle_increment * beams
    return None if math.isfinite(last) else LeftOut.BAD_ANGLES


Wants: TypeAlias = Callable[[int, int], bool]


class Selector:
    """Says which scans of one log are used; it is shown all of them, in order.

    Parameters
    ----------
    wants
        Says of each cloud that is used, by its stamp and its number of points, whether it is posed.
    """

    def __init__(
        self, options: BuildOptions, wants: Wants = lambda _stamp_ns, _points: True
    ) -> None:
        self._selection, self._stamps = options.selection, options.posing.stamps
        self._wants, self._wants_all = wants, replace(options.selection, topics=()) == Selection()
        self.first_ns: int | None = None
        """The stamp of the log's first scan; None before it is seen"""
        self._wanted: Counter[str] = Counter()
        """How many scans of each topic lie in the time window so far"""
        self.read = 0
        self.left_out: Counter[str] = Counter()
        """How many of those read `select` left out, by reason"""

    def select(self, scans: Iterable[Recorded]) -> Iterator[Recorded]:
        """Pass on the scans that are used, and count the others."""
        for some in scans:
            if self.first_ns is None:
                stamps = self._stamps.choose(some.stamp_ns, some.record_ns)
                self.first_ns = int(np.ravel(stamps)[0])
            if isinstance(some, ScanBatch) and self._wants_all and not find_flaw(some):
                self.see(some, None)
                yield some
                continue
            for scan in some.split() if isinstance(some, ScanBatch) else (some,):
                reason = self._find_reason(scan)
                self.see(scan, reason)
                if reason is None and (isinstance(scan, Scan) or self._is_wanted(scan)):
                    yield scan

    def see(self, some: Recorded, reason: LeftOut | None) -> None:
        """Count scans that are used, or a scan that is left out for a reason."""
        self.read += some.scans
        if reason is not None:
            self.left_out[reason] += 1

    def see_batch(self, batch: ScanBatch) -> None:
        """Take a look at scans that are used, of which some may have no pose."""

    def _is_wanted(self, cloud: Cloud) -> bool:
        stamp_ns = self._stamps.choose(cloud.stamp_ns, cloud.record_ns)
        return self._wants(stamp_ns, len(cloud.points))

    def _find_reason(self, scan: Scan | Cloud) -> LeftOut | None:
        if (flaw := find_flaw(scan)) is not None:
            return flaw
        passed_ns = self._stamps.choose(scan.stamp_ns, scan.record_ns) - (self.first_ns or 0)
        if not self._selection.start_s <= passed_ns / 1e9 < self._selection.end_s:
            return LeftOut.TIME
        self._wanted[scan.topic] += 1
        is_between = (self._wanted[scan.topic] - 1) % self._selection.stride
        return LeftOut.STRIDE if is_between else None


BATCH_BEAMS = 1 << 18
"""Beams that are gathered before they are handed on: a few megabytes, and enough work that threads
seldom wait for Python's lock. Two points of a cloud take as much as a beam."""
CLOUD_MOMENTS = 33
"""Poses looked up for one cloud whose points have times of their own"""

ECHOES = "MultiEchoLaserScan"
"""The type of scans whose beams have several echoes"""

MOST_TURNS = 1.5
"""Some lasers overlap a little where a turn closes; none goes round twice."""


def stack(scans: Iterable[Recorded], stamps: Stamps) -> Iterator[ScanBatch]:
    """Stack scans, holding no more than a batch at a time; one of a reader stays as it is."""
    held: defaultdict[object, list[Any]] = defaultdict(list)
    beams = 0
    for some in scans:
        if not isinstance(some, ScanBatch):
            held[find_shape(some)].append(some)
            beams += len(some.points) // 2 if isinstance(some, Cloud) else len(some.ranges)
            if beams < BATCH_BEAMS:
                continue
        yield from (pack(alike, stamps) for alike in held.values())
        held.clear()
        beams = 0
        if isinstance(some, ScanBatch):
            yield settle(some, stamps)
    yield from (pack(alike, stamps) for alike in held.values())


def find_shape(some: Scan | Cloud) -> tuple[object, ...]:
    """Take from a scan, or a cloud, what all of a batch share."""
    of_all = some.topic, some.frame, some.pose is not None
    if isinstance(some, Cloud):
        return *of_all, some.offset_ns is not None
    return *of_all, some.angle_min, some.angle_increment, len(some.ranges), *read_limits(some)


def pack(alike: list[Any], stamps: Stamps) -> ScanBatch:
    """Make a batch of scans, or of clouds, of one shape."""
    if isinstance(alike[0], Cloud):
        return make_cloud_batch(alike, stamps)
    batch = ScanBatch.like(
        alike[0],
        stamp_ns=np.array([scan.stamp_ns for scan in alike], np.int64),
        record_ns=np.array([scan.record_ns for scan in alike], np.int64),
        ranges=np.stack([scan.ranges for scan in alike]),
        time_increment=np.array([scan.time_increment for scan in alike], np.float64),
        pose=np.array([scan.pose for scan in alike]) if alike[0].pose is not None else None,
    )
    return settle(batch, stamps)


def settle(batch: ScanBatch, stamps: Stamps) -> ScanBatch:
    """Settle which stamps of a reader's scans count, and up to where they measure."""
    low, high = read_limits(batch)
    stamp_ns = stamps.choose(batch.stamp_ns, batch.record_ns)
    return replace(batch, stamp_ns=stamp_ns, range_min=low, range_max=high)


def make_cloud_batch(clouds: Sequence[Cloud], stamps: Stamps) -> ScanBatch:
    """Make a batch of clouds, which have a beam for each moment that poses are looked up at.

    A cloud begins where its earliest point does.
    """
    first = clouds[0]
    moments = 1 if first.offset_ns is None else CLOUD_MOMENTS
    at_once = np.zeros(1, np.int64)
    offsets = [at_once if cloud.offset_ns is None else cloud.offset_ns for cloud in clouds]
    span = np.array([(each.min(), each.max()) for each in offsets])
    stamp_ns, record_ns = np.array([(cloud.stamp_ns, cloud.record_ns) for cloud in clouds]).T
    times = stamps.choose(stamp_ns, record_ns) + span[:, 0], record_ns
    step = (span[:, 1] - span[:, 0]) / 1e9 / max(moments - 1, 1)
    ranges = np.zeros((len(clouds), moments), np.float32)
    pose = None if first.pose is None else np.array([cloud.pose for cloud in clouds])
    shape = first.frame, 0.0, math.tau / moments, 0.0, math.inf
    return ScanBatch(*shape, *times, ranges, step, pose, first.topic, tuple(clouds))


def find_oddity(batch: ScanBatch) -> str:
    """Say what is odd about the angles of scans; "" where nothing is."""
    # A scan with fewer beams than others of its file ends in NaN.
    beams = int(np.flatnonzero(~np.isnan(batch.ranges).all(axis=0)).max(initial=-1)) + 1
    turns = abs(batch.angle_increment) * (beams - 1) / math.tau
    if MOST_TURNS < turns < math.inf:
        return f"{beams} beams go round {turns:.3g} times: angles are radians; are these degrees?"
    if beams > 1 and batch.angle_increment == 0:
        return f"{beams} beams all point the same way: angle_increment is 0"
    return ""


FAR_M = 200.0
"""No laser that measures metres has half of its ranges beyond it."""


def find_middle(batch: ScanBatch) -> float:
    """Find the median of a sample of the ranges that are measurements; infinite if none is.

    Where nearly all lie beyond what the scans state as their limit, these count, unless most are
    of one value, which stands for "no return".
    """
    sample = batch.ranges.ravel()[::16]  # one beam of so many tells how far away things are
    finite = np.sort(sample[(sample > 0) & (sample < np.inf)])
    near, middle = finite < batch.range_max, finite[finite.size // 2 :][:1]
    is_code = np.count_nonzero(finite == middle) > 0.5 * finite.size
    measured = finite[near] if is_code or near.sum() > 0.1 * near.size else finite
    return float(np.median(measured)) if len(measured) else math.inf


def list_idle(log: Log, topics: Sequence[str], options: ReaderOptions) -> Iterator[str]:
    """Say which options of its reader a log has no use for."""
    types = [stream.type for stream in log.streams if stream.topic in topics]
    if options.echo is not Echo.FIRST and not any(each.endswith(ECHOES) for each in types):
        yield f"`echo={options.echo}` does nothing: no topic of scans holds {ECHOES}"


def write_doubts(doubts: Iterable[Doubt]) -> list[str]:
    """Write doubts as sentences that name their topics."""
    return [f"{topic}: {concern.text}" for topic, concern in doubts]


class Drive:
    """The scans of one log that are used, as a stream of batches: selected, limited and posed."""

    def __init__(self, log: Log, poser: Poser, options: BuildOptions) -> None:
        self.log, self.poser, self.options = log, poser, options
        poser.drift = (options.posing.height_drift or {}).get(str(log.path))
        self.bodies = options.clouds.own_points or {}
        """Where the robot itself is around a sensor"""
        self.topics = choose_topics(log, options.selection.topics)
        self.scans = count_scans(log, self.topics)
        """How many the log has on these topics"""
        self.limits = RangeLimits(options.returns)
        self.is_settled = False
        """Whether all scans were read, so that limits and leaps hold from the first scan on"""
        self._first_ns = 0
        self._odd: dict[tuple[str, str], None] = {}
        self._middle_m: defaultdict[str, float] = defaultdict(lambda: math.inf)
        """The median range of each topic, of the batch where it is lowest"""

    def renew(self, options: BuildOptions) -> "Drive":
        """Make a drive that has read no scan, by the poses that are known and other options."""
        poser = Poser(self.poser.sources, options.posing)
        poser.find_chains(self.poser.chains)
        return Drive(self.log, poser, options)

    def settle(self) -> bool:
        """Say, once all scans were read, whether limits and leaps were known from the first on.

        Else they are from now on, and the scans are to be read once more.
        """
        if self.is_settled:
            return True
        self.is_settled = True
        return all([self.limits.settle(self.poser.list_standing()), self.poser.settle()])

    def rounds(self) -> Iterator[None]:
        """Yield once, and once more if by then all scans showed other limits, or leaps."""
        yield
        if not self.settle():
            yield

    def foresee(self) -> bool:
        """Read all scans for limits and leaps alone, and settle them."""
        self.limits = RangeLimits(self.options.returns)
        for _ in self.read(Tally()):
            pass
        return self.settle()

    def sample(self) -> list[PosedScans]:
        """Pose some of the scans that a build uses, spread evenly over the log."""
        for _ in self.rounds():  # the second time without scans that leap away
            samples = {topic: TopicSample() for topic in self.topics}
            for posed in self.read(Tally()):
                samples[posed.batch.topic].add(posed)
        return [part for sample in samples.values() for part in sample.parts]

    def read(self, tally: Tally, selector: Selector | None = None) -> Iterator[PosedScans]:
        """Read the scans that are used and have poses, batch by batch; count what becomes of all.

        Parameters
        ----------
        selector
            Says which scans are used; None: a new one, by the options.
        """
        self.poser.start_over()
        stamps = self.options.posing.stamps
        selector = selector or Selector(self.options)
        chosen = selector.select(self.limits.watch(read_recorded(self.log, self.topics)))
        chosen = (clean_cloud(some) if isinstance(some, Cloud) else some for some in chosen)
        limited = map(self.limits.apply, stack(map(self.poser.settle_moments, chosen), stamps))
        for batch in tally.time_each("read", limited):
            selector.see_batch(batch)
            if self._middle_m[batch.topic] > FAR_M:
                self._middle_m[batch.topic] = min(self._middle_m[batch.topic], find_middle(batch))
            if oddity := find_oddity(batch):
                self._odd[batch.topic, oddity] = None
            for posed in tally.time_each("pose", self.poser.attach(batch)):
                yield self.drop_own(posed) if batch.clouds else posed
            tally.advance(len(batch.stamp_ns))
        tally.dropped.update(self.poser.count_lost())
        tally.frames[str(self.log.path)] = self.poser.fixed
        tally.lasers = max(tally.lasers, len(self.topics))
        tally.scans_read += selector.read
        tally.dropped.update(selector.left_out)
        self._first_ns = selector.first_ns or 0

    def drop_own(self, posed: PosedScans) -> PosedScans:
        """Make no returns of the points of clouds that are the robot's own."""
        body = self.bodies.get((str(self.log.path), posed.batch.topic, posed.batch.frame), ())
        return drop_own_points(posed, self.options.returns, body)

    def list_doubts(self) -> Iterator[Doubt]:
        """Say of which topics angles are odd, and where ranges or places can hardly be metres."""
        yield from ((topic, Concern(oddity, command="")) for topic, oddity in self._odd)
        for topic in (topic for topic, it in self._middle_m.items() if FAR_M < it < math.inf):
            found = f"most ranges are above {FAR_M:g} m: ranges are metres"
            yield topic, Concern(f"{found}; are these millimetres or centimetres?", command="")
        yield from self.poser.suspect_places(self._middle_m)

    def list_remarks(self) -> Iterator[str]:
        """Say what is chosen, and what is passed over, without being asked for."""
        yield from list_idle(self.log, self.topics, self.options.reading)
        clouds = [it.topic for it in self.log.streams if it.role is Role.CLOUD and it.count]
        left = [topic for topic in clouds if topic not in self.topics]
        if left and not self.options.selection.topics:
            yield f"clouds are left out, as there are scans: `topics={left[0]}` maps clouds alone"
        yield from self.poser.notes
        yield from self.limits.list_notes()

    def list_notes(self, ground: Ground | None = None) -> list[str]:
        """Say what there is to say of poses, scans and ranges, once all scans were read.

        Parameters
        ----------
        ground
            That clouds were traced over.
        """
        # Lists, as the poser takes notes meanwhile.
        told = [*self.poser.list_concerns(self._first_ns, self.options.returns.max_range)]
        axes = [*self.poser.suspect_axes(ground)] if ground else []
        return [*self.list_remarks(), *write_doubts([*self.list_doubts(), *axes, *told])]
