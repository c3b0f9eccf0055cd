"""Attachment: scans and poses become posed scans; each scan without a pose is counted.

`Poser.attach` is the way of a batch that `occmap.posing` lists. A scan has one moment, its stamp,
unless it is de-skewed: then each of its beams gets the pose of the moment at which it was measured.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from occmap.arrays import Bool, Float64, Int64
from occmap.errors import PoseError
from occmap.posing.chain import Chain, Status, Transforms
from occmap.posing.course import STANDS, Course, list_tilts
from occmap.posing.jumps import warn_of_jumps
from occmap.posing.leaps import Ends, Laser, LeapFilter
from occmap.posing.options import Concern, Deskew, DropReason, PosingOptions
from occmap.posing.resolve import resolve
from occmap.posing.sources import Sources, gather
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.types import IDENTITY, Attached, Pose, PoseBatch, PosedScans, PoseSample, ScanBatch

POSES_OF_BODY = (
    "the poses beside the scans are taken as the robot's, with the laser at `sensor_pose` on it; "
    "leave that out if they are the laser's own"
)

MAX_TURN_S = 60.0
"""A scan that is said to take longer has a wrong time_increment."""
MAX_AUTO_TURN_S = 1.0
"""The slowest laser that is de-skewed unasked; some drivers write milliseconds for seconds."""
MOMENTS = 33
"""Poses looked up for one de-skewed scan; see `place_beams` for how close that is."""


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
        self._trusts_stated = self.sources.trajectory is None
        self._leaps = LeapFilter(self.options.max_speed)
        # Where the log's map frame lies in the map that is made: mostly, they are one.
        turned = Pose.planar(0.0, 0.0, math.radians(self.options.align or 0.0))
        moved = Transforms.fixed(self.options.transform or IDENTITY)
        self._above = Transforms.fixed(turned).then(moved)

    @classmethod
    def build(cls, samples: Iterable[PoseSample | PoseBatch], options: PosingOptions) -> Self:
        """Read all samples of a log once, in any order.

        Raises
        ------
        PoseError
            The chosen trajectory is neither a file nor a topic with poses.
        LogError
            The trajectory file cannot be read.
        """
        sources = gather(samples, options)
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
            if not chain.interval_s and self.sources.tree.moves:
                self._note(f"{frame!r} never moves in {self.fixed!r}, though other frames do")
        return failures

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
        if batch.pose is not None and self._trusts_stated:
            yield self._keep(batch, self._read_stated(batch.pose))
            return
        if batch.frame not in self.chains:
            self.find_chains([batch.frame])
        chain = self.chains.get(batch.frame)
        if chain is None:
            yield Attached(batch, None, {DropReason.NO_TRANSFORM: scans})
            return
        deskewed, notes = choose_deskewed(batch, self.options.deskew, chain)
        self._note(*notes)
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        if deskewed.any():
            part = batch.take(deskewed)
            moment_ns = stamp_ns[deskewed, None] + list_moments(part)
            yield self._keep(part, chain.at(moment_ns.ravel()))
        if not deskewed.all():
            yield self._keep(batch.take(~deskewed), chain.at(stamp_ns[~deskewed]))

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
        is_stated = batch.pose is not None and self._trusts_stated
        chain = None if is_stated else self.chains[batch.frame]
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
            if course.stance:
                yield from ((topic, tilt) for tilt in list_tilts(course.stance, max_range))
            if not jumped:  # of several sensors on one robot, one tells it
                first = first_ns + self._offset_ns
                if jumped := warn_of_jumps(course.find_jumps(), course.stamp_ns, first):
                    yield topic, jumped

    def find_ends(self) -> dict[Laser, Ends]:
        """Find where the posed scans of each laser begin and end so far."""
        return self._leaps.find_ends()

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


def choose_deskewed(batch: ScanBatch, deskew: Deskew, chain: Chain) -> tuple[Bool, list[str]]:
    """Choose the scans (S) whose beams get poses of their own, and say what was decided.

    AUTO asks for a believable scan time and for poses dense enough to show the motion in it.
    """
    if deskew is Deskew.OFF:
        return np.zeros(len(batch.stamp_ns), np.bool_), []
    with np.errstate(invalid="ignore", over="ignore"):  # a log may state any number
        duration_s = np.abs(batch.time_increment) * (batch.ranges.shape[1] - 1)
    is_auto = deskew is Deskew.AUTO
    longest_s = MAX_AUTO_TURN_S if is_auto else MAX_TURN_S
    chosen: Bool = (duration_s > 0) & (duration_s <= longest_s)
    notes = []
    if is_auto:
        chosen &= chain.is_dense(duration_s)
    elif not chosen.all():
        notes.append(
            f"scans of {batch.frame!r} that state no believable time between beams are not "
            "de-skewed"
        )
    if chosen.any():
        notes.append(f"de-skewed: each beam of {batch.frame!r} has a pose of its own")
    return chosen, notes


def list_moments(batch: ScanBatch) -> Int64:
    """List the moments (S, K) of scans at which poses are looked up, from their stamps on (ns)."""
    beams = batch.ranges.shape[1]
    seconds = np.linspace(0, (beams - 1) * batch.time_increment, min(beams, MOMENTS), axis=1)
    return np.round(seconds * 1e9).astype(np.int64)


def place_beams(batch: ScanBatch, posed: Bool, found: Transforms) -> PosedScans:
    """Keep the scans (S) that are posed; where there are K moments of each, each beam has a pose.

    Between two moments positions and matrices are interpolated linearly. At 720 degrees a second
    and ten scans a second a matrix is then off by 2e-4: 2 mm at ten metres.
    """
    scans = len(posed)
    position = found.position.reshape(scans, -1, 3)[posed]
    rotation = found.rotation.reshape(scans, -1, 9)[posed]
    batch, moments = batch.take(posed), position.shape[1]
    if moments == 1:
        return PosedScans(batch, position[:, 0], rotation.reshape(-1, 3, 3))
    at = np.linspace(0, moments - 1, batch.ranges.shape[1])
    share = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(moments)))
    rotation = share @ rotation
    return PosedScans(batch, share @ position, rotation.reshape(*rotation.shape[:2], 3, 3))
