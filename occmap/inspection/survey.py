"""One pass over the scans of a log: everything about them is counted as they stream by."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from occmap.batching import (
    NOT_ASKED_FOR,
    Batcher,
    Geometry,
    LeftOut,
    Selection,
    Selector,
)
from occmap.errors import PoseError
from occmap.inspection.extent import Extent
from occmap.inspection.findings import Shape
from occmap.inspection.ranges import RangeCensus
from occmap.inspection.times import StampLog
from occmap.posing.attach import Poser
from occmap.posing.options import DropReason
from occmap.sampling import Sample, expect_scans
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Scan, ScanBatch, ScanRun

MAX_SHAPES = 1000
"""Shapes that are counted: a log in which every scan has another must not fill the memory."""
SAMPLED_TOPICS = 100
"""Topics whose scans are sampled: no robot has more lasers, and a map of each takes its time."""


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
    left_out: Counter[LeftOut] = field(default_factory=Counter)
    posed: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    stated: bool = True
    """Every scan so far had its pose beside it"""

    def see(self, some: Scan | ScanRun) -> None:
        """Take note of one scan, or of all scans of a run."""
        self.stamps.add(some)
        self.stated &= some.first.pose is not None
        geometry = Geometry.of(some.first)
        self.frames.setdefault(geometry.frame)
        angles = geometry.angle_min, geometry.angle_increment
        shape = Shape(geometry.beams, *angles, geometry.range_min, geometry.range_max, scans=0)
        if shape in self.shapes or len(self.shapes) < MAX_SHAPES:
            self.shapes[shape] += some.scans


@dataclass(eq=False)
class Survey:
    """Reads the scans of a log once; `extent` and `topics` grow meanwhile."""

    poser: Poser
    returns: ReturnOptions
    selection: Selection
    expected: int
    """Scans in the log, as its reader counts them"""
    limits: RangeLimits
    extent: Extent = field(default_factory=Extent)
    topics: dict[str, TopicSurvey] = field(default_factory=dict)
    first_ns: int = 0
    """The stamp of the log's first scan"""

    def read(self, scans: Iterable[Scan | ScanRun]) -> None:
        """Read all scans, holding no more than a batch of each topic."""
        for batch, posed, dropped in self.poser.attach(self._stack(scans)):
            survey = self.topics[batch.topic]
            survey.dropped.update({reason.value: count for reason, count in dropped.items()})
            if posed is not None:
                survey.posed += len(posed.batch.stamp_ns)
                if survey.is_sampled:
                    survey.sample.take(posed)
                rays, _ = interpret(posed, self.returns)
                self.extent.add(rays)

    def _stack(self, scans: Iterable[Scan | ScanRun]) -> Iterator[ScanBatch]:
        """Stack the scans that a build would use; those without a way to the map are counted."""
        batcher = Batcher(Selection(), self.poser.options.stamps)
        for stacked in batcher.stack(self._select(scans)):
            survey, batch = self.topics[stacked.topic], self.limits.apply(stacked)
            survey.census.add(batch)
            try:
                self.poser.prepare(batch)
            except PoseError:  # no scan so far has a way to the map
                survey.dropped[DropReason.NO_TRANSFORM] += len(batch.stamp_ns)
            else:
                yield batch

    def _select(self, scans: Iterable[Scan | ScanRun]) -> Iterator[Scan | ScanRun]:
        """Give the scans that a build would use; scans that nobody asked for are only counted."""
        selector = Selector(self.selection, self.poser.options.stamps)
        for some, reason in selector.judge(scans):
            survey = self._find(some.first.topic)
            survey.read += some.scans
            self.limits.see(some)
            if reason not in NOT_ASKED_FOR:
                survey.see(some)
            if reason is None:
                yield some
            else:
                survey.left_out[reason] += 1
        self.first_ns = selector.seam.first_ns or 0

    def _find(self, topic: str) -> TopicSurvey:
        if topic not in self.topics:
            sample = Sample(expect_scans(self.expected, self.selection))
            self.topics[topic] = TopicSurvey(topic, sample, len(self.topics) < SAMPLED_TOPICS)
        return self.topics[topic]

    def list_notes(self) -> Iterator[str]:
        """Say that scans are sampled of only some of very many topics."""
        if len(self.topics) > SAMPLED_TOPICS:
            yield (
                f"the mount and the agreement are estimated for {SAMPLED_TOPICS} of "
                f"{len(self.topics):,} topics with scans"
            )
