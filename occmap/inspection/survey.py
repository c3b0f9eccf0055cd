"""One pass over the scans of a log: everything about them is counted as they stream by."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occmap.batching import (
    BATCH_BEAMS,
    NOT_ASKED_FOR,
    Batcher,
    Geometry,
    LeftOut,
    Selection,
    Selector,
    describe,
)
from occmap.errors import PoseError
from occmap.inspection.extent import Extent
from occmap.inspection.findings import Shape
from occmap.inspection.ranges import RangeCensus
from occmap.inspection.sample import Sample
from occmap.inspection.times import StampLog
from occmap.posing.attach import Poser
from occmap.posing.options import DropReason, Stamps
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Kind, Scan, ScanBatch

MAX_SHAPES = 1000
"""Shapes that are told apart; a log whose every scan has another must not fill the memory."""


@dataclass
class TopicSurvey:
    """What is known about the scans of one topic so far."""

    topic: str
    sample: Sample
    batcher: Batcher
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

    def see(self, scan: Scan) -> None:
        """Take note of a single scan."""
        self.stamps.add(scan)
        self.stated &= scan.pose is not None
        geometry = describe(scan)
        self.frames.setdefault(geometry.frame)
        shape = _strip(geometry)
        if shape in self.shapes or len(self.shapes) < MAX_SHAPES:
            self.shapes[shape] += 1


@dataclass(frozen=True)
class Survey:
    """Reads the scans of a log once; extent and topics grow."""

    poser: Poser
    returns: ReturnOptions
    selection: Selection
    expected: int
    """Scans in the log, as its reader counts them"""
    extent: Extent = field(default_factory=Extent)
    topics: dict[str, TopicSurvey] = field(default_factory=dict)

    @property
    def by_record_time(self) -> bool:
        """Whether a scan was taken when it was recorded."""
        return self.poser.options.stamps is Stamps.RECORD

    def read(self, scans: Iterable[Scan]) -> None:
        """Read all scans, holding no more than a batch of each topic."""
        for topic, some in gather_topics(self._select(scans)):
            survey = self.topics[topic]
            for batch in survey.batcher.stack(some):
                survey.census.add(batch)
                self._attach(survey, batch)

    def _select(self, scans: Iterable[Scan]) -> Iterator[Scan]:
        """Give the scans that a build would use; of those not asked for nothing else is told."""
        selector = Selector(self.selection, by_record_time=self.by_record_time)
        for scan in scans:
            survey = self.topics.get(scan.topic) or self._begin(scan.topic)
            survey.read += 1
            reason = selector.find_fault(scan)
            if reason not in NOT_ASKED_FOR:
                survey.see(scan)
            if reason is None:
                yield scan
            else:
                survey.left_out[reason] += 1

    def _begin(self, topic: str) -> TopicSurvey:
        batcher = Batcher(Selection(), by_record_time=self.by_record_time)
        self.topics[topic] = TopicSurvey(topic, Sample(self._expect()), batcher)
        return self.topics[topic]

    def _expect(self) -> int:
        """Estimate how many scans are wanted; of a part of a log, so few that all are taken."""
        chosen = self.selection
        part = math.isfinite(chosen.start_s) or math.isfinite(chosen.end_s)
        return 0 if part else self.expected // chosen.stride

    def _attach(self, survey: TopicSurvey, batch: ScanBatch) -> None:
        """See which scans of a batch get a pose, and how far they reach."""
        try:
            posed, dropped = self.poser.attach(batch)
        except PoseError:  # no scan so far has a way to the map
            posed, dropped = None, {DropReason.NO_TRANSFORM: len(batch.stamp_ns)}
        survey.dropped.update({reason.value: count for reason, count in dropped.items()})
        if posed is None:
            return
        survey.posed += len(posed.batch.stamp_ns)
        survey.sample.take(posed)
        rays, _ = interpret(posed, self.returns)
        used = rays.kind != Kind.SKIP
        seen = np.broadcast_to(rays.origin, (*used.shape, 2))
        self.extent.add(rays.end[used])
        self.extent.add(seen[used])


def gather_topics(scans: Iterable[Scan]) -> Iterator[tuple[str, list[Scan]]]:
    """Give scans by topic, as many at once as fill a batch."""
    held: dict[str, list[Scan]] = {}
    beams = 0
    for scan in scans:
        held.setdefault(scan.topic, []).append(scan)
        beams += max(len(scan.ranges), 1)
        if beams >= BATCH_BEAMS:
            yield from held.items()
            held, beams = {}, 0
    yield from held.items()


def _strip(geometry: Geometry) -> Shape:
    """Keep what tells shapes apart."""
    return Shape(
        beams=geometry.beams,
        angle_min=geometry.angle_min,
        angle_increment=geometry.angle_increment,
        range_min=geometry.range_min,
        range_max=geometry.range_max,
        scans=0,
    )
