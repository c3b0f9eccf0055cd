"""Attachment: scans and poses become posed scans; each scan without a pose is counted.

A batch goes one way: the chain of frames to its sensor is found, the moments of its scans are
chosen (`deskew`), the chain is looked up at these (`chain`), and scans without a pose are dropped.
So are scans whose poses leap away and back (`sifting`). `course` then watches where the sensor was.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from functools import reduce
from itertools import starmap
from typing import Self

import numpy as np

from occmap.errors import PoseError
from occmap.posing.chain import Chain
from occmap.posing.concerns import Concern
from occmap.posing.course import STANDS, Course, list_tilts
from occmap.posing.deskew import choose_deskewed, keep, spread_moments
from occmap.posing.jumps import list_jumps
from occmap.posing.options import Deskew, DropReason, PosingOptions
from occmap.posing.resolve import resolve
from occmap.posing.sifting import Attached, Ends, Laser, LeapFilter
from occmap.posing.sources import Sources, gather
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.posing.transforms import Status, Transforms
from occmap.types import Pose, PoseBatch, PoseSample, ScanBatch

POSES_OF_BODY = (
    "the poses beside the scans are taken as the robot's, with the laser at `sensor_pose` on it; "
    "leave that out if they are the laser's own"
)


@dataclass(eq=False)
class Poser:
    """The poses of one log, and how its scans get theirs.

    Nothing is extrapolated: a scan outside the poses of its chain of frames is left out.
    """

    sources: Sources
    options: PosingOptions
    fixed: str | None = None
    """The frame of the map; known when the first frame is resolved."""
    notes: list[str] = field(default_factory=list)
    """What was decided or left out and its user should know; grows, each sentence once."""
    chains: dict[str, Chain | None] = field(default_factory=dict)
    """By scan frame; None where no chain leads to it."""
    courses: defaultdict[str, Course] = field(default_factory=lambda: defaultdict(Course))
    """By topic: how its sensor sat, and where it went."""

    def __post_init__(self) -> None:
        self._offset_ns = round(self.options.time_offset_s * 1e9)  # to the clock of the poses
        self._above = _find_above(self.options)
        self._leaps = LeapFilter(self.options.max_speed)

    @classmethod
    def build(
        cls, samples: Iterable[PoseSample | PoseBatch], options: PosingOptions | None = None
    ) -> Self:
        """Read all samples of a log once, in any order.

        Raises
        ------
        PoseError
            The chosen trajectory is neither a file nor a topic with poses.
        LogError
            The trajectory file cannot be read.
        """
        options = options or PosingOptions()
        sources = gather(samples, options)
        return cls(sources, options, notes=list(sources.notes))

    def resolve(self, frames: Collection[str]) -> None:
        """Find the chains to these scan frames, all from the same fixed frame.

        Raises
        ------
        PoseError
            No frame, of these and earlier ones, has a chain.
        """
        failures = self.find_chains(frames)
        if failures and self.fixed is None:
            raise next(iter(failures.values()))

    def find_chains(self, frames: Collection[str]) -> dict[str, PoseError]:
        """Find the chains to these scan frames; say of those that have none why.

        Where none at all has one so far, nothing is decided, and they may be asked for again.
        """
        new = sorted(frame for frame in set(frames) if frame not in self.chains)
        # What mends one laser among others is not what mends a single one.
        failures = self._resolve(new, alone=len(new) == 1 and not self.chains)
        if self.fixed is not None:
            failures = self._resolve(failures, alone=False)  # again, by what was found meanwhile
            self.chains.update(dict.fromkeys(failures))
            self._note(*map(str, failures.values()))
        return failures

    def _resolve(self, frames: Iterable[str], alone: bool) -> dict[str, PoseError]:
        """Find the chains to frames, one after the other; say why there is none."""
        failures: dict[str, PoseError] = {}
        for frame in frames:
            try:
                way = resolve(self.sources, self.options, frame, self.fixed, alone)
            except PoseError as error:
                failures[frame] = error
            else:
                self.fixed, self.chains[frame] = way.fixed, way.chain
                self._note(*way.notes)
                if not way.chain.interval_s and self.sources.tree.moves:
                    self._note(f"{frame!r} never moves in {way.fixed!r}, though other frames do")
        return failures

    def is_stated(self, batch: ScanBatch) -> bool:
        """Whether the poses that the log states beside these scans are theirs."""
        return batch.pose is not None and self.sources.trajectory is None

    def prepare(self, batch: ScanBatch) -> None:
        """Find the way to the sensor of some scans, unless its poses stand beside them.

        Raises
        ------
        PoseError
            No scan frame so far has a chain to the map frame.
        """
        if not self.is_stated(batch) and batch.frame not in self.chains:
            self.resolve([batch.frame])

    def attach(self, batches: Iterable[ScanBatch]) -> Iterator[Attached]:
        """Give each scan the pose of its sensor, or each beam where the scan is de-skewed.

        A pose that the log states beside the scan is used as it is, unless the user named a
        trajectory; where the user gave the sensor's pose, it is taken to be the body's. Where only
        some scans of a batch are de-skewed, it comes in two parts.

        Raises
        ------
        PoseError
            As `prepare`.
        """
        some = (batch for batch in batches if len(batch.stamp_ns))
        found = (part for batch in some for part in self._look_up(batch))
        for attached in self._leaps.sift(starmap(self._keep, found)):
            if (posed := attached.posed) is not None:
                stamp_ns = posed.batch.stamp_ns + self._offset_ns
                stated = self.is_stated(posed.batch)
                chain = None if stated else self.chains[posed.batch.frame]
                self.courses[posed.batch.topic].see(posed, stamp_ns, chain)
            yield attached
        self._note(*self._leaps.list_notes())

    def _look_up(self, batch: ScanBatch) -> Iterator[tuple[ScanBatch, Transforms]]:
        """Look up the sensor at the stamp of each scan (S), or at K moments of each (S * K)."""
        self.prepare(batch)
        if batch.pose is not None and self.is_stated(batch):
            self._note(*_list_idle(self.options))
            sensor = self.options.sensor_pose
            found = Transforms.read(batch.pose)
            yield batch, found.then(Transforms.fixed(sensor)) if sensor else found
            return
        chain = self.chains[batch.frame]
        if chain is None:
            nowhere = np.full(len(batch.stamp_ns), Status.NO_TRANSFORM, np.uint8)
            yield batch, Transforms(np.empty(0), np.empty(0), nowhere)
            return
        deskewed, notes = choose_deskewed(batch, self.options.deskew, chain)
        self._note(*notes)
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        if deskewed.any():
            part = batch.take(deskewed)
            yield part, chain.at((stamp_ns[deskewed, None] + spread_moments(part)).ravel())
        if not deskewed.all():
            yield batch.take(~deskewed), chain.at(stamp_ns[~deskewed])

    def _keep(self, batch: ScanBatch, found: Transforms) -> Attached:
        """Keep the scans that have a pose at all of their moments, and count the others."""
        status = found.status.reshape(len(batch.stamp_ns), -1).max(axis=1)
        lost = Counter(status[status != Status.POSED].tolist())
        dropped = {DropReason[Status(code).name]: lost[code] for code in sorted(lost)}
        posed = status == Status.POSED
        if not posed.any():
            return Attached(batch, None, dropped)
        placed = self._above.then(found) if self._above else found
        return Attached(batch, keep(batch, posed, placed), dropped)

    def list_concerns(self, first_ns: int, max_range: float) -> Iterator[tuple[str, Concern]]:
        """Say what of the poses that were given so far spoils a map, and of which topic.

        That a sensor never moved is a note: it may have stood.

        Parameters
        ----------
        first_ns
            Stamp of the first scan of the log.
        max_range
            Beams are used up to here (m).
        """
        jumped = False
        for topic, course in sorted(self.courses.items()):
            if course.stands:
                self._note(f"{topic}: {STANDS}")
            if course.stance:
                yield from ((topic, tilt) for tilt in list_tilts(course.stance, max_range))
            if not jumped:  # of several sensors on one robot, one tells it
                first = first_ns + self._offset_ns
                for concern in list_jumps(course.find_jumps(), course.stamp_ns, first):
                    jumped = True
                    yield topic, concern

    def find_ends(self) -> dict[Laser, Ends]:
        """Where the posed scans so far begin and end, by their laser."""
        return self._leaps.find_ends()

    def _note(self, *sentences: str) -> None:
        self.notes += [each for each in dict.fromkeys(sentences) if each not in self.notes]


def _find_above(options: PosingOptions) -> Transforms | None:
    """Find where the log's map frame lies in the map that is made; None where they are one."""
    turned = [Pose.planar(0.0, 0.0, math.radians(options.align))] if options.align else []
    moved = [options.transform] if options.transform else []
    ways = [*turned, *moved]
    return Transforms.fixed(reduce(Pose.then, ways)) if ways else None


def _list_idle(options: PosingOptions) -> Iterator[str]:
    """Say whose the poses beside the scans are, and which options do nothing to them."""
    if options.sensor_pose is not None:
        yield POSES_OF_BODY
    given = {
        "`map_frame`": options.map_frame is not None,
        "`base_frame`": options.base_frame is not None,
        "`time_offset_s`": options.time_offset_s != 0,
        "`deskew=on`": options.deskew is Deskew.ON,
    }
    for option, is_given in given.items():
        if is_given:
            yield f"{option} does nothing: the poses stand beside the scans"
