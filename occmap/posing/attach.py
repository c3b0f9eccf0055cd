"""Attachment: scans and poses become posed scans; each scan without a pose is counted.

`Poser.attach` is the way of a batch that `occmap.posing` lists.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from occmap.errors import PoseError
from occmap.posing import Concern, Deskew, DropReason, PosingOptions
from occmap.posing.chain import (
    Chain,
    Status,
    Transforms,
    choose_deskewed,
    list_moments,
    place_beams,
)
from occmap.posing.course import STANDS, Course, list_tilts, warn_of_jumps
from occmap.posing.leaps import LeapFilter
from occmap.posing.sources import Sources, gather, resolve
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.types import (
    IDENTITY,
    Attached,
    Float64,
    Moments,
    Pose,
    PoseBatch,
    PosedScans,
    PoseSample,
    ScanBatch,
)

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
    """What a user should know of decisions and of what was left out; grows, each sentence once."""
    chains: dict[str, Chain | None] = field(default_factory=dict)
    """By scan frame; None where no chain leads to it."""
    courses: defaultdict[str, Course] = field(default_factory=lambda: defaultdict(Course))
    """By topic: how its sensor sat, and where it went."""

    def __post_init__(self) -> None:
        self._offset_ns = round(self.options.time_offset_s * 1e9)  # to the clock of the poses
        self._leaps = LeapFilter(self.options.max_speed)
        # Where the log's map frame lies in the map that is made: mostly, they are one.
        turned = Pose.planar(0.0, 0.0, math.radians(self.options.align or 0.0))
        moved = Transforms.fixed(self.options.transform or IDENTITY)
        self._above = Transforms.fixed(turned).then(moved)

    @classmethod
    def build(
        cls,
        samples: Iterable[PoseSample | PoseBatch],
        options: PosingOptions,
        moments: Moments | None = None,
    ) -> Self:
        """Read all samples of a log once, in any order.

        Parameters
        ----------
        moments
            The times of the scans of a log that holds nothing else, for a trajectory without times.

        Raises
        ------
        PoseError
            The chosen trajectory is neither a file nor a topic with poses.
        LogError
            The trajectory file cannot be read.
        """
        sources = gather(samples, options, moments)
        return cls(sources, options, notes=list(sources.notes))

    def find_chains(self, frames: Iterable[str]) -> dict[str, PoseError]:
        """Find the chains to these scan frames, all from the same fixed frame.

        While no frame has a chain, nothing is decided, and the same frames may be asked for again.

        Returns
        -------
        dict
            By frame, the error that says why it has none.
        """
        left = sorted(set(frames) - self.chains.keys())
        # A single laser is mended by other options than one among several.
        failures = self._try_frames(left, alone=len(left) == 1 and not self.chains)
        if self.fixed is None:
            return failures
        # By now the chain of another frame may have shown which frame the map is in.
        failures = self._try_frames(failures, alone=False)
        self.chains.update(dict.fromkeys(failures))
        self._note(*map(str, failures.values()))
        return failures

    def _try_frames(self, frames: Iterable[str], alone: bool) -> dict[str, PoseError]:
        failures = {}
        for frame in frames:
            try:
                found = resolve(self.sources, self.options, frame, self.fixed, alone)
            except PoseError as error:
                failures[frame] = error
                continue
            self.fixed, chain, notes = found
            self.chains[frame] = chain
            self._note(*notes)
            if not chain.interval_s and self.sources.tree.moves and frame != self.fixed:
                self._note(f"{frame!r} never moves in {self.fixed!r}, though other frames do")
        return failures

    def start_over(self) -> Self:
        """Make a poser that knows the same of frames, and has seen no scan yet."""
        return replace(self, courses=defaultdict(Course))

    def attach(self, batches: Iterable[ScanBatch]) -> Iterator[Attached]:
        """Give each scan the pose of its sensor, or each beam where the scan is de-skewed.

        A pose that the log states beside the scan is used as it is, unless the user named a
        trajectory; where the user gave the sensor's pose, it is taken to be the body's. Where only
        some scans of a batch are de-skewed, it comes in two parts. Scans in a frame that no chain
        leads to are dropped and counted.
        """
        looked_up = (part for batch in batches for part in self._look_up(batch))
        for attached in self._leaps.sift(looked_up):
            if attached.posed is not None:
                self._watch(attached.posed)
            yield attached
        self._note(*self._leaps.list_notes())

    def _look_up(self, batch: ScanBatch) -> Iterator[Attached]:
        """Look up where the sensor was at the moments of some scans, by stated poses or a chain."""
        scans = len(batch.stamp_ns)
        if not scans:
            return
        if (stated := self._choose_stated(batch)) is not None:
            yield self._keep(batch, self._read_stated(stated))
            return
        if batch.frame not in self.chains:
            self.find_chains([batch.frame])
        chain = self.chains.get(batch.frame)
        if chain is None:
            yield Attached(batch, None, {DropReason.NO_TRANSFORM: scans})
            return
        if batch.clouds and not chain.interval_s and (bodies := self.sources.tree.bodies):
            yield from self._place_registered(batch, chain, bodies[0])
            return
        # A cloud takes long, and its points say when they were measured.
        deskew = Deskew.AUTO if batch.clouds else self.options.deskew
        deskewed, notes = choose_deskewed(batch, deskew, chain)
        self._note(*notes)
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        if deskewed.any():
            part = batch.take(deskewed)
            moment_ns = stamp_ns[deskewed, None] + list_moments(part)
            yield self._keep(part, chain.at(moment_ns.ravel()))
        if not deskewed.all():
            yield self._keep(batch.take(~deskewed), chain.at(stamp_ns[~deskewed]))

    def _place_registered(self, batch: ScanBatch, chain: Chain, body: str) -> Iterator[Attached]:
        """Place clouds that are in the map already; they were seen from where a body was."""
        self.find_chains([body])
        carrier = self.chains.get(body)
        if carrier is None or not carrier.interval_s:
            yield self._keep(batch, chain.at(batch.stamp_ns))
            return
        self._note(
            f"the clouds in {batch.frame!r} do not move with a sensor: taken as in the map "
            f"already, and as seen from {body!r}"
        )
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        seen_from = carrier.at(stamp_ns)
        found = chain.at(stamp_ns)._replace(status=seen_from.status)
        attached = self._keep(batch, found)
        if attached.posed is not None:
            origin = self._above.then(seen_from).position[seen_from.status == Status.POSED]
            attached = attached._replace(posed=replace(attached.posed, origin=origin))
        yield attached

    def _choose_stated(self, batch: ScanBatch) -> Float64 | None:
        """The poses (S, 7) that stand beside scans, unless the user named others."""
        return batch.pose if self.sources.trajectory is None else None

    def _read_stated(self, poses: Float64) -> Transforms:
        """Read the poses (S, 7) that stand beside scans, as the sensor's or as its body's."""
        found, sensor = Transforms.read(poses), self.options.sensor_pose
        self._note(*_list_idle(self.options))
        return found.then(Transforms.fixed(sensor)) if sensor else found

    def _keep(self, batch: ScanBatch, found: Transforms) -> Attached:
        """Keep the scans (S) that have a pose at all of their K moments, and count the others."""
        status = found.status.reshape(len(batch.stamp_ns), -1).max(axis=1)
        lost = Counter(status[status != Status.POSED].tolist())
        dropped: dict[str, int] = {
            DropReason[Status(code).name]: lost[code] for code in sorted(lost)
        }
        posed = status == Status.POSED
        if not posed.any():
            return Attached(batch, None, dropped)
        return Attached(batch, place_beams(batch, posed, self._above.then(found)), dropped)

    def _watch(self, posed: PosedScans) -> None:
        """Note where the sensor of some scans was, for what there is to say of its course."""
        batch = posed.batch
        chain = self.chains[batch.frame] if self._choose_stated(batch) is None else None
        self.courses[batch.topic].see(posed, batch.stamp_ns + self._offset_ns, chain)

    def list_concerns(self, first_ns: int, max_range: float) -> Iterator[tuple[str, Concern]]:
        """List what spoils a map in the poses that were given so far, each with its topic.

        A sensor that never moved is only noted: the robot may have stood still.

        Parameters
        ----------
        first_ns
            Stamp of the first scan of the log.
        max_range
            Beams are used up to here (m).
        """
        jumped = None
        for topic, course in sorted(self.courses.items()):
            if course.stands:
                self._note(f"{topic}: {STANDS}")
            if course.stance and not course.is_of_clouds:
                yield from ((topic, tilt) for tilt in list_tilts(course.stance, max_range))
            if not jumped:  # of several sensors on one robot, one tells it
                first = first_ns + self._offset_ns
                if jumped := warn_of_jumps(course.find_jumps(), course.stamp_ns, first):
                    yield topic, jumped

    def _note(self, *sentences: str) -> None:
        self.notes += [each for each in dict.fromkeys(sentences) if each not in self.notes]


def _list_idle(options: PosingOptions) -> Iterator[str]:
    """Say whose poses stand beside the scans, and which options change nothing about them."""
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
