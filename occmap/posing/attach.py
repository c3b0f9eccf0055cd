"""Attachment: scans and poses become posed scans; each scan without a pose is counted."""

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from functools import reduce
from itertools import chain, starmap
from typing import Self

import numpy as np

from occmap.errors import PoseError
from occmap.posing.chain import REASONS, Chain, Found, Status, make_chain
from occmap.posing.concerns import Concern
from occmap.posing.course import STANDS, Course, list_tilts
from occmap.posing.frames import Edge, Source, Step
from occmap.posing.jumps import JumpWatch
from occmap.posing.options import Deskew, PosingOptions, Stamps
from occmap.posing.resolve import resolve
from occmap.posing.sifting import Attached, Ends, Laser, LeapFilter
from occmap.posing.sources import Sources, gather
from occmap.posing.tracks import MAX_STAMP_NS, Track, TrackBuilder, find_usable
from occmap.types import (
    Bool,
    Float64,
    Int64,
    Pose,
    PoseBatch,
    PosedScans,
    PoseSample,
    ScanBatch,
)

MAX_TURN_S = 60.0
"""A scan that is said to take longer has a wrong time_increment."""

MAX_AUTO_TURN_S = 1.0
"""The slowest laser that is de-skewed unasked; some drivers write milliseconds for seconds."""

MOMENTS = 33
"""Poses looked up for one de-skewed scan; see `_keep` for how close that is."""

POSES_OF_BODY = (
    "the poses beside the scans are taken as the robot's, with the laser at `sensor_pose` on it; "
    "leave that out if they are the laser's own"
)

IDENTITY = (0, 0, 0, 0, 0, 0, 1)
"""No shift and no turn; also stands in for a pose that is not finite."""


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
    """By scan frame; None where there is no way to it."""
    courses: defaultdict[str, Course] = field(
        default_factory=lambda: defaultdict(Course), init=False
    )
    """By topic: how its sensor sat, and where it went."""

    def __post_init__(self) -> None:
        self._leaps = LeapFilter(self.options.max_speed)
        self._noted = set(self.notes)
        self._watches: dict[str, JumpWatch] = {}
        self._stated: defaultdict[str, TrackBuilder] = defaultdict(TrackBuilder)
        self._above = _find_above(self.options)

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
        new = sorted(frame for frame in set(frames) if frame not in self.chains)
        # What mends one laser among others is not what mends a single one.
        failures = self._resolve(new, alone=len(new) == 1 and not self.chains)
        if failures and self.fixed is None:
            raise next(iter(failures.values()))
        failures = self._resolve(failures, alone=False)  # again, by what was found meanwhile
        self.chains.update(dict.fromkeys(failures))
        self._note(*(str(error) for error in failures.values()))

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

    def prepare(self, batch: ScanBatch) -> None:
        """Find the way to the sensor of some scans, unless its poses stand beside them.

        Raises
        ------
        PoseError
            No scan frame so far has a chain to the map frame.
        """
        is_stated = batch.pose is not None and self.sources.trajectory is None
        if not is_stated and batch.frame not in self.chains:
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
        parts = chain.from_iterable(self._look_up(each) for each in batches if len(each.stamp_ns))
        for attached in self._leaps.sift(starmap(self._pose, parts)):
            if attached.posed is not None:
                self._watch(attached.posed)
            yield attached
        self._note(*self._leaps.list_notes())

    def _pose(self, batch: ScanBatch, found: Found) -> Attached:
        """Keep the scans that were found, at all of their moments."""
        status = found.status.reshape(len(batch.stamp_ns), -1).max(axis=1)
        counts = Counter(status.tolist())
        dropped = {why: counts[code] for code, why in REASONS.items() if counts[code]}
        posed = status == Status.POSED
        if not posed.any():
            return Attached(batch, None, dropped)
        placed = self._above.then(found) if self._above else found
        return Attached(batch, _keep(batch, posed, placed), dropped)

    def _watch(self, scans: PosedScans) -> None:
        """Record where the sensor was."""
        frame, topic, pose = scans.batch.frame, scans.batch.topic, scans.batch.pose
        self.courses[topic].see(scans)
        stamp_ns = scans.batch.stamp_ns + self._offset_ns
        chain = self.chains.get(frame)
        if pose is not None and self.sources.trajectory is None:
            stated = PoseBatch(stamp_ns, stamp_ns, pose, "", "", static=False, topic=topic)
            self._stated[topic].add_batch(stated, Stamps.HEADER)
        elif chain is not None:
            if frame not in self._watches:
                self._watches[frame] = JumpWatch(chain)
            self._watches[frame].see(stamp_ns)

    def _list_watches(self) -> dict[str, JumpWatch]:
        """List what watches the poses, by topic; of poses beside scans all were needed first."""
        watches = {
            topic: self._watches[course.frame]
            for topic, course in self.courses.items()
            if course.frame in self._watches
        }
        for topic, builder in self._stated.items():
            track = builder.build()
            if track is not None:
                watch = JumpWatch(make_chain([Step(Edge("", "", track, Source.ODOMETRY))], None))
                watch.see(track.stamp_ns)
                watches[topic] = watch
        return watches

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
        jumped, watches = False, self._list_watches()
        for topic, course in sorted(self.courses.items()):
            if course.stands:
                self._note(f"{topic}: {STANDS}")
            if course.stance:
                yield from ((topic, tilt) for tilt in list_tilts(course.stance, max_range))
            watch = watches.get(topic)
            if watch and not jumped:  # of several sensors on one robot, one tells it
                for concern in watch.list_concerns(first_ns + self._offset_ns):
                    jumped = True
                    yield topic, concern

    @property
    def jumps(self) -> bool:
        """Whether any pose takes the robot elsewhere at once."""
        return any(watch.edges_ns.size for watch in self._list_watches().values())

    def find_ends(self) -> dict[Laser, Ends]:
        """Where the posed scans so far begin and end, by their laser."""
        return self._leaps.find_ends()

    def _look_up(self, batch: ScanBatch) -> Iterator[tuple[ScanBatch, Found]]:
        """Look up the sensor at the stamp of each scan (S), or at K moments of each (S * K).

        A batch comes in two parts where only some of its scans are de-skewed.
        """
        self.prepare(batch)
        if batch.pose is not None and self.sources.trajectory is None:
            self._note(*_list_idle(self.options))
            yield batch, _read_stated(batch.pose, self.options.sensor_pose)
            return
        way = self.chains[batch.frame]
        if way is None:
            nowhere = np.full(len(batch.stamp_ns), Status.NO_TRANSFORM, np.uint8)
            yield batch, Found(np.empty(0), np.empty(0), nowhere)
            return
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        deskewed = self._choose_deskewed(batch, way)
        if deskewed.any():
            part = _take(batch, deskewed)
            yield part, way.at((stamp_ns[deskewed, None] + _spread_moments(part)).ravel())
        if not deskewed.all():
            yield _take(batch, ~deskewed), way.at(stamp_ns[~deskewed])

    @property
    def _offset_ns(self) -> int:
        """From the clock of the scans to that of the poses."""
        return round(self.options.time_offset_s * 1e9)

    def _choose_deskewed(self, batch: ScanBatch, chain: Chain) -> Bool:
        """Choose the scans (S) whose beams get poses of their own.

        AUTO asks for a believable scan time and for poses dense enough to show the motion in it.
        """
        if self.options.deskew is Deskew.OFF:
            return np.zeros(len(batch.stamp_ns), np.bool_)
        with np.errstate(invalid="ignore", over="ignore"):  # a log may state any number
            duration_s = np.abs(batch.time_increment) * (batch.ranges.shape[1] - 1)
        if self.options.deskew is Deskew.AUTO:
            dense = chain.is_dense(duration_s)
            chosen: Bool = dense & (duration_s > 0) & (duration_s <= MAX_AUTO_TURN_S)
        else:
            chosen = (duration_s > 0) & (duration_s <= MAX_TURN_S)
            if not chosen.all():
                self._note(
                    f"scans of {batch.frame!r} that state no believable time between beams are "
                    "not de-skewed"
                )
        if chosen.any():
            self._note(f"de-skewed: each beam of {batch.frame!r} has a pose of its own")
        return chosen

    def _note(self, *sentences: str) -> None:
        new = [each for each in dict.fromkeys(sentences) if each not in self._noted]
        self._noted.update(new)
        self.notes.extend(new)


def _find_above(options: PosingOptions) -> Found | None:
    """Find where the log's map frame lies in the map that is made; None where they are one."""
    aligned = Pose.planar(0.0, 0.0, math.radians(options.align or 0.0))
    ways = [pose for pose in (aligned, options.transform) if pose and pose != IDENTITY]
    founds = [Found.of(track.position, track.quaternion) for track in map(Track.fixed, ways)]
    return reduce(Found.then, founds) if founds else None


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


def _read_stated(pose: Float64, mount: Pose | None) -> Found:
    """Read the poses (S, 7) that a log states beside its scans, of the sensor or of its body."""
    usable, norm = find_usable(pose)
    pose = np.where(usable[:, None], pose, IDENTITY)
    found = Found.of(pose[:, :3], pose[:, 3:] / norm[:, None])
    found.status[~usable] = Status.NOT_FINITE
    if mount is None:
        return found
    fixed = Track.fixed(mount)
    return found.then(Found.of(fixed.position, fixed.quaternion))


def _spread_moments(batch: ScanBatch) -> Int64:
    """Spread K moments (S, K) evenly from the first beam of each scan to its last (ns)."""
    beams = batch.ranges.shape[1]
    moments = np.linspace(0, (beams - 1) * batch.time_increment, min(beams, MOMENTS), axis=1)
    moments_ns: Int64 = np.round(moments * 1e9).astype(np.int64)
    return moments_ns


def _keep(batch: ScanBatch, posed: Bool, found: Found) -> PosedScans:
    """Keep the scans (S) that are posed; where there are K moments of each, each beam has a pose.

    Between two moments positions and matrices are interpolated linearly. At 720 degrees a second
    and ten scans a second a matrix is then off by 2e-4: 2 mm at ten metres.
    """
    scans = len(posed)
    position = found.position.reshape(scans, -1, 3)[posed]
    rotation = found.rotation.reshape(scans, -1, 9)[posed]
    batch, moments = _take(batch, posed), position.shape[1]
    if moments == 1:
        return PosedScans(batch, position[:, 0], rotation.reshape(-1, 3, 3))
    at = np.linspace(0, moments - 1, batch.ranges.shape[1])
    share = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(moments)))
    rotation = share @ rotation
    return PosedScans(batch, share @ position, rotation.reshape(*rotation.shape[:2], 3, 3))


def _take(batch: ScanBatch, scans: Bool) -> ScanBatch:
    """Some of the scans; their ranges are copied only where these are not all."""
    return batch if scans.all() else batch.take(scans)
