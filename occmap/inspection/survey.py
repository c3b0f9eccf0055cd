"""One pass over the scans of a log: everything about them is counted as they stream by.

That is their shapes, their times, their range values (in `ranges`), and the extent of their map.
"""

import math
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occmap.grid.lattice import CellBox, Lattice
from occmap.inspection.findings import Shape, TimeFindings
from occmap.inspection.ranges import RangeCensus
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.options import Stamps
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.scans.mounts import Sample, expect_scans
from occmap.scans.stream import Selector, stack
from occmap.scans.tally import NOT_ASKED_FOR
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import interpret, read_limits
from occmap.types import Cloud, Float64, Kind, Rays, Recorded, ScanBatch

MAX_SHAPES = 1000
"""How many shapes are counted: each scan of a log may have its own, and memory is bounded."""
SAMPLED_TOPICS = 100
"""How many topics are sampled: no robot has more lasers, and the map of each takes time."""
LONGEST_RUN_NS = 10**16
"""A simulation lasts no longer than this: 115 days."""
BELIEVABLE_S = 1e9
"""No beam is sent so long after the one before; a log may state any number."""
EARLIEST_DATE_NS = 631_152_000 * 10**9
"""A log with the date of its recording is of 1990 or later."""


class StampLog:
    """The times of every scan of a topic, 24 bytes each."""

    def __init__(self) -> None:
        self.header_ns = array("q")
        """What the driver wrote"""
        self.record_ns = array("q")
        """When the recorder stored it"""
        self._increment = array("d")

    def add(self, some: Recorded) -> None:
        """Take the times of one scan, or of all scans of a run."""
        for times, own in ((self.header_ns, some.stamp_ns), (self.record_ns, some.record_ns)):
            times.frombytes(np.clip(own, -MAX_STAMP_NS, MAX_STAMP_NS, dtype=np.int64).tobytes())
        self._increment.frombytes(np.asarray(some.time_increment, np.float64).tobytes())

    def sum_up(self, suggested_stamps: Stamps, poses_ns: int | None = None) -> TimeFindings:
        """Sum up the times of at least one scan.

        Parameters
        ----------
        poses_ns
            The stamp of some pose that is not stated beside a scan, if there is one.
        """
        header, record = np.array(self.header_ns), np.array(self.record_ns)
        steps = np.diff(header) / 1e9
        offset = (header.astype(np.float64) - record) / 1e9
        all_equal = len(header) > 1 and bool((header == header[0]).all())
        duration_s = float(header.max() - header.min()) / 1e9
        # A simulation's clock begins at 0. That of a laser may, too, but then the poses have dates.
        latest = max(int(header.max()), LONGEST_RUN_NS if poses_ns is None else poses_ns)
        began_at_zero = header.min() >= 0 and latest < LONGEST_RUN_NS and not all_equal
        simulated = bool(began_at_zero and record.min() >= EARLIEST_DATE_NS)
        tenth = max(len(offset) // 10, 1)
        drift_s = float(np.median(offset[-tenth:]) - np.median(offset[:tenth]))
        increments = np.array(self._increment)
        increments = increments[np.abs(increments) < BELIEVABLE_S]
        return TimeFindings(
            start_ns=int(header.min()),
            end_ns=int(header.max()),
            duration_s=duration_s,
            rate_hz=(len(header) - 1) / duration_s if duration_s else 0.0,
            largest_gap_s=float(steps.max(initial=0)),
            offset_s=float(np.median(offset)),
            drift_s=0.0 if simulated else drift_s,
            jumps_back=int(np.count_nonzero(steps < 0)),
            largest_jump_back_s=float((-steps).max(initial=0)),
            duplicates=int(np.count_nonzero(steps == 0)),
            time_increment_s=float(np.median(increments)) if len(increments) else 0.0,
            all_equal=all_equal,
            all_zero=bool((header == 0).all()),
            simulated=simulated,
            suggested_stamps=suggested_stamps,
        )


@dataclass
class Extent:
    """The cells that a map must hold; grows with the rays that it is shown."""

    lattice: Lattice
    behind: float
    """How far behind the measured range a hit is placed (m)"""
    around: float
    """How far around a hit cells are taken as observed, too (m)"""
    box: CellBox | None = None
    """Around all cells that rays observe; None: they observe none"""
    longest: float = 0.0
    """The longest beam (m)"""

    def add(self, rays: Rays) -> None:
        """Take in the beams that are used, from where they were sent to where they end."""
        hit, used = rays.kind == Kind.HIT, rays.kind != Kind.SKIP
        end = rays._replace(distance=rays.distance + hit * np.float32(self.behind)).end
        one_viewpoint = rays.origin.shape[1] == 1
        begun = used.any(axis=1, keepdims=True) if one_viewpoint else used
        self._take(rays.origin[begun])
        self._take(end[used])
        self._take(end[hit], self.around)
        self.longest = max(self.longest, float(rays.distance.max(initial=0.0)) + self.behind)

    def _take(self, places: Float64, around: float = 0.0) -> None:
        """Take in places (N, 2)."""
        if len(places):
            box = self.lattice.enclose(places, around)
            self.box = box.join(self.box) if self.box else box


@dataclass
class TopicSurvey:
    """What is known about the scans of one topic so far."""

    topic: str
    sample: Sample
    is_sampled: bool = True
    stamps: StampLog = field(default_factory=StampLog)
    census: RangeCensus = field(default_factory=RangeCensus)
    shapes: Counter[Shape] = field(default_factory=Counter)
    frames: dict[str, None] = field(default_factory=dict)
    read: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    posed: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    stated: bool = True
    """Every scan so far had its pose beside it"""

    def see(self, some: Recorded) -> None:
        """Take note of one scan or cloud, or of all scans of a run."""
        self.stamps.add(some)
        first = some.first
        self.stated &= first.pose is not None
        self.frames.setdefault(first.frame)
        if isinstance(first, Cloud):
            self.shapes[Shape(0, 0.0, math.tau, 0.0, math.inf, scans=0)] += 1
            return
        angles = first.angle_min, first.angle_increment
        shape = Shape(len(first.ranges), *angles, *read_limits(first), scans=0)
        if shape in self.shapes or len(self.shapes) < MAX_SHAPES:
            self.shapes[shape] += some.scans


@dataclass(eq=False)
class Survey:
    """Reads the scans of a log once; `extent` and `topics` grow meanwhile."""

    poser: Poser
    options: BuildOptions
    expected: int
    """Scans in the log, as its reader counts them"""
    limits: RangeLimits
    extent: Extent
    topics: dict[str, TopicSurvey] = field(default_factory=dict)
    first_ns: int = 0
    """The stamp of the log's first scan"""

    def read(self, scans: Iterable[Recorded]) -> None:
        """Read all scans, holding no more than a batch of each topic."""
        for batch, posed, dropped in self.poser.attach(self._stack(scans)):
            survey = self.topics[batch.topic]
            survey.dropped.update(dropped)
            if posed is not None:
                survey.posed += len(posed.batch.stamp_ns)
                if survey.is_sampled:
                    survey.sample.take(posed)
                rays, _ = interpret(posed, self.options.returns)
                self.extent.add(rays)

    def _stack(self, scans: Iterable[Recorded]) -> Iterator[ScanBatch]:
        """Stack the scans that a build would use, and count their ranges."""
        batches = stack(self._select(scans), self.poser.options.stamps)
        for batch in map(self.limits.apply, batches):
            self.topics[batch.topic].census.add(batch)
            yield batch

    def _select(self, scans: Iterable[Recorded]) -> Iterator[Recorded]:
        """Give the scans that a build would use; scans that nobody asked for are only counted."""
        selector = Selector(self.options.selection, self.poser.options.stamps)
        for some, reason in selector.judge(self.limits.watch(scans)):
            survey = self._find(some.first.topic)
            survey.read += some.scans
            if reason not in NOT_ASKED_FOR:
                survey.see(some)
            if reason is None:
                yield some
            else:
                survey.left_out[reason] += 1
        self.first_ns = selector.first_ns or 0

    def _find(self, topic: str) -> TopicSurvey:
        if topic not in self.topics:
            sample = Sample(expect_scans(self.expected, self.options.selection))
            self.topics[topic] = TopicSurvey(topic, sample, len(self.topics) < SAMPLED_TOPICS)
        return self.topics[topic]

    def list_notes(self) -> Iterator[str]:
        """Say where there are so many topics that only some are sampled."""
        if len(self.topics) > SAMPLED_TOPICS:
            yield (
                f"the mount and the agreement are estimated for {SAMPLED_TOPICS} of "
                f"{len(self.topics):,} topics with scans"
            )
