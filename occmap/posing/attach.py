"""Attachment: scans and poses become posed scans; each scan without a pose is counted.

`Poser.attach` is the way of a batch of scans.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from occmap.cells import Ground
from occmap.errors import PoseError
from occmap.posing import POSED, Concern, Deskew, Doubt, Drift, DropReason, PosingOptions, chain
from occmap.posing import course as courses
from occmap.posing.chain import Chain, Transforms, place_logs, tilt
from occmap.posing.course import Course, Stance
from occmap.posing.sources import Search, Sources
from occmap.posing.tracks import MAX_STAMP_NS, Track
from occmap.report import count
from occmap.types import Cloud, Float64, Int64, PosedScans, Recorded, ScanBatch, Trajectory

TWIN_SHARE = 0.5
"""Two lasers do not measure at the same moments; a filter keeps the stamps of what it filters."""
STATED_FRAME, STATED_LASER = "map", "laser"
"""Names for the frames of logs that state poses beside their scans and name no frame."""
NEAR_FLOOR_M = 1.5
"""A ceiling that is taken for a floor is farther from most robots"""
STOOD_S = 2, 8, 32
"""A sensor stood still for so long if it was in one place then, and at the shorter times"""
STOOD_M, STOOD_RAD = 0.05, math.radians(2)
"""Poses of one that stands still are no farther apart, and not turned by more"""
Laser: TypeAlias = tuple[str, str]
"""Topic and frame"""


@dataclass(eq=False)
class Poser:
    """The poses of one log, and how its scans get theirs.

    Nothing is extrapolated: a scan outside the poses of its chain of frames is left out.
    """

    sources: Sources
    options: PosingOptions
    fixed: str | None = None
    """The frame of the map; known when the first frame is resolved."""
    notes: list[str] = field(init=False)
    """What a user should know of decisions and of what was left out; grows, each sentence once."""
    chains: dict[str, Chain | None] = field(default_factory=dict)
    """By scan frame; None where no chain leads to it."""
    courses: dict[Laser, Course] = field(default_factory=dict)
    """Where each sensor was at its scans."""
    leaps: dict[Laser, Int64] = field(default_factory=dict)
    """Stamps, by the clock of the poses, of the scans that leap away."""
    drift: Drift | None = None
    """By what heights are corrected at stamps of scans; None: they stay as they are"""

    def __post_init__(self) -> None:
        self.notes = list(self.sources.notes)
        self._offset_ns = round(self.options.time_offset_s * 1e9)  # to the clock of the poses
        self._above = place_logs(self.options).then(tilt(self.options.level or (0.0, 0.0)))

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
        alone = len(left) == 1 and not self.chains
        failures: dict[str, PoseError] = {}
        # Twice, as the chain of a later frame may show which frame the map is in.
        for frame in (frame for frame in left * 2 if frame not in self.chains):
            search = Search(self.sources, self.options, frame.strip("/"), alone)
            try:
                self.fixed, way = search.resolve(self.fixed)
            except PoseError as error:
                failures[frame] = error
                continue
            failures.pop(frame, None)
            self.chains[frame] = way
            self._note(*search.notes)
        if self.fixed is not None:
            self.chains.update(dict.fromkeys(failures))
            self._note(*map(str, failures.values()))
        return failures

    def start_over(self) -> None:
        """Forget the scans that were seen, since they are about to come once more."""
        self.courses.clear()

    def may_leap(self) -> bool:
        """Whether any scan so far may prove to leap away, once all scans were seen."""
        tracks, max_speed = self._list_tracks(), self.options.max_speed
        return any(courses.find_leaps(track, max_speed).any() for _, track in tracks)

    def settle(self) -> bool:
        """Look for leaps, once all scans were seen; say whether all scans that were kept may stay.

        From then on those that leap away are left out.
        """
        max_speed = self.options.max_speed
        for laser, track in self._list_tracks():
            if not (outliers := courses.find_outliers(track, max_speed)).any():
                continue
            outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
            if max_speed < math.inf:
                self.leaps[laser] = track.stamp_ns[outliers]
                scans = count(len(self.leaps[laser]), "scan")
                outcome = f"{scans} left out for such leaps; `max_speed=inf` keeps all"
            where = courses.describe_first(track, outliers, self._offset_ns)
            self._note(f"{laser[0]}: {where}: {outcome}")
        return not self.leaps

    def _convert(self, stamp_ns: Int64) -> Int64:
        """Convert stamps of scans (S,) to the clock of the poses."""
        moved = np.clip(stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS) + self._offset_ns
        return np.clip(moved, -MAX_STAMP_NS, MAX_STAMP_NS)

    def settle_moments(self, some: Recorded) -> Recorded:
        """Take a cloud to be measured at its stamp where poses are too sparse to move its points.

        Some drivers stamp the end of a sweep, and then its earliest point is no better moment.
        """
        if not isinstance(some, Cloud) or some.offset_ns is None:
            return some
        way, duration_ns = self._find_way(some), np.ptp(some.offset_ns, keepdims=True)
        if way is None or way.is_dense(duration_ns / 1e9):
            return some
        if way.interval_s:
            found = "poses are too far apart to place points at times of their own"
            self._note(f"{some.topic}: {found}")
        return some._replace(offset_ns=None)

    def measure_standstills(self, posed: PosedScans) -> Float64:
        """Measure for how long (S,; s) the sensor of clouds stands still, before and after them.

        Of one that no transform moves nobody knows, so it is 0.
        """
        batch, stamp_ns = posed.batch, self._convert(posed.stamp_ns)
        stood_s = np.zeros(len(stamp_ns))
        way = self._find_way(batch)
        if way and not way.interval_s:
            way = self._find_carrier(batch.frame)
        if way is None:
            return stood_s
        apart_s = np.array([0, *STOOD_S])[:, None]
        shape = len(apart_s), len(stamp_ns)
        for sign in (-1, 1):
            there = way.at((stamp_ns + sign * apart_s * 10**9).ravel())
            position, rotation = (each.reshape(*shape, *each.shape[1:]) for each in there[:2])
            moved = np.linalg.norm(position - position[0], axis=2)
            cosine = (np.einsum("tsij,sij->ts", rotation, rotation[0]) - 1) / 2
            stands = (moved <= STOOD_M) & (cosine >= math.cos(STOOD_RAD))
            stands &= there.status.reshape(shape) == POSED
            stood_s += (np.logical_and.accumulate(stands) * apart_s).max(axis=0)
        return stood_s

    def attach(self, batch: ScanBatch) -> Iterator[PosedScans]:
        """Give each scan of a batch the pose of its sensor, or each beam where it is de-skewed.

        A pose that the log states beside the scan is used as it is, unless the user named a
        trajectory; where the user gave the sensor's pose, it is taken to be the body's. Where only
        some scans of the batch are de-skewed, it comes in two parts. Scans in a frame that no chain
        leads to are left out, and so are those that are known to leap away.
        """
        if not len(batch.stamp_ns):
            return
        if batch.pose is not None and self.options.takes_stated():
            yield from self._keep(batch, self._read_stated(batch.pose))
            return
        if (way := self._find_way(batch)) is None:
            course = self.courses.setdefault((batch.topic, batch.frame), Course())
            status = np.full(len(batch.stamp_ns), DropReason.NO_TRANSFORM.code, np.uint8)
            course.lose(batch.stamp_ns, status)
            return
        stamp_ns = self._convert(batch.stamp_ns)
        if batch.clouds and not way.interval_s and (carrier := self._find_carrier(batch.frame)):
            yield from self._keep(batch, way.at(stamp_ns), carrier.at(stamp_ns))
            return
        # A cloud takes long, and its points say when they were measured.
        in_clouds = bool(batch.clouds)
        deskew = Deskew.AUTO if in_clouds else self.options.deskew
        deskewed, notes = chain.choose_deskewed(batch, deskew, way)
        self._note(*notes)
        if deskewed.any():
            part = batch.take(deskewed)
            moment_ns = stamp_ns[deskewed, None] + chain.list_moments(part)
            yield from self._keep(part, way.at(moment_ns.ravel(), in_clouds))
        if not deskewed.all():
            yield from self._keep(batch.take(~deskewed), way.at(stamp_ns[~deskewed], in_clouds))

    def _find_way(self, some: Cloud | ScanBatch) -> Chain | None:
        """Find the chain to the frame of scans; None: there is none, or poses stand beside them."""
        if self.options.takes_stated(some):
            return None
        if some.frame not in self.chains:
            self.find_chains([some.frame])
        return self.chains.get(some.frame)

    def _read_stated(self, poses: Float64) -> Transforms:
        """Read the poses (S, 7) that stand beside scans, as the sensor's or as its body's."""
        found, sensor, usual = Transforms.read(poses), self.options.sensor_pose, PosingOptions()
        if sensor is not None:
            taken = "the poses beside the scans are taken as the robot's"
            fix = "leave that out if they are the laser's own"
            self._note(f"{taken}, with the laser at `sensor_pose` on it; {fix}")
            found = found.then(Transforms.fixed(sensor))
        for name in ("map_frame", "base_frame", "time_offset_s", "deskew"):
            if getattr(self.options, name) != getattr(usual, name):
                self._note(f"`{name}` does nothing: the poses stand beside the scans")
        return found

    def _find_carrier(self, frame: str) -> Chain | None:
        """Find what moves, where a frame of clouds does not: they are in the map already."""
        for body in self.sources.tree.bodies[:1]:
            self.find_chains([body])
            carrier = self.chains.get(body)
            if carrier and carrier.interval_s:
                self._note(
                    f"the clouds in {frame!r} do not move with a sensor: taken as in the map "
                    f"already, and as seen from {body!r}"
                )
                return carrier
        return None

    def _keep(
        self, batch: ScanBatch, found: Transforms, seen_from: Transforms | None = None
    ) -> Iterator[PosedScans]:
        """Keep the scans (S) that have a pose at all of their K moments; record all of them.

        Parameters
        ----------
        found
            Where the frame of the scans was.
        seen_from
            Where the sensor was, if clouds are in another frame than its own.
        """
        laser, stamp_ns = (batch.topic, batch.frame), self._convert(batch.stamp_ns)
        places = found if seen_from is None else seen_from
        status = places.status.reshape(len(stamp_ns), -1).max(axis=1)
        if laser in self.leaps:
            status[np.isin(stamp_ns, self.leaps[laser])] = DropReason.LEAP.code
        kept = status == POSED
        course = self.courses.setdefault(laser, Course())
        if not kept.all():
            course.lose(batch.stamp_ns[~kept], status[~kept])
        if kept.any():
            posed = chain.place_beams(batch, kept, self._above.then(found))
            if seen_from is not None:
                posed = replace(posed, origin=self._above.then(seen_from).position[kept])
            if self.drift:  # these arrays are nobody else's yet
                added = np.interp(posed.batch.stamp_ns, *self.drift) / 1000
                posed.position.T[2] += added
                if posed.origin is not None:
                    posed.origin[:, 2] += added
            course.see(posed, stamp_ns[kept])
            yield posed

    def _list_tracks(self, topic: str | None = None) -> list[tuple[Laser, Track]]:
        """List where each sensor, of a topic or of all, was at its scans, if some has a pose."""
        lasers = sorted(each for each in self.courses if topic in (None, each[0]))
        tracks = ((laser, self.courses[laser].build()) for laser in lasers)
        return [(laser, track) for laser, track in tracks if track]

    def count_lost(self, topic: str | None = None) -> Counter[str]:
        """Count the scans without a usable pose by reason, of one topic or of all."""
        courses = (each for (name, _), each in self.courses.items() if topic in (None, name))
        return Counter(reason for each in courses for _, reason in each.list_lost())

    def list_trajectories(self, log: str) -> Iterator[Trajectory]:
        """List where each laser of a log was at its scans, by the log's own clock."""
        parent = (self.fixed or STATED_FRAME).lstrip("/")
        for (topic, frame), course in self.courses.items():
            # A laser that is in the frame of the map gets one of its own.
            name = STATED_LASER if frame.lstrip("/") == parent else frame.lstrip("/")
            stamp_ns, pose = course.list_poses()
            lost = tuple(course.list_lost())
            yield Trajectory(log, topic, parent, name, stamp_ns - self._offset_ns, pose, lost)

    def find_stance(self, topic: str) -> Stance | None:
        """Find how the sensor of a topic sat; None where no scan had a pose."""
        return next((Stance.measure(track) for _, track in self._list_tracks(topic)), None)

    def list_concerns(self, first_ns: int, max_range: float) -> Iterator[Doubt]:
        """List what spoils a map in the poses that were given so far.

        A sensor that never moved is only noted: the robot may have stood still.

        Parameters
        ----------
        first_ns
            Stamp of the first scan of the log.
        max_range
            Beams are used up to here (m).
        """
        jumped, begin_ns = None, first_ns + self._offset_ns
        yield from self._list_twins()
        for (topic, frame), track in self._list_tracks():
            if courses.stands(track):
                found = "the laser never moves, so the map is what it sees from one place"
                fix = "if the robot drove, its poses are missing: give them with `poses`"
                self._note(f"{topic}: {found}; {fix}")
            if not self.courses[topic, frame].is_of_clouds:
                for tilt in courses.list_tilts(Stance.measure(track), max_range):
                    yield topic, tilt
            elif axes := courses.warn_of_axes(track):
                yield topic, axes
            # Of several sensors on one robot, one tells it.
            way = self.chains.get(frame)
            if not jumped and (jumped := courses.warn_of_jumps(way, track, begin_ns)):
                yield topic, jumped

    def list_standing(self) -> list[str]:
        """List the topics of sensors that never moved, where there are scans enough to see it."""
        return [name for (name, _), track in self._list_tracks() if courses.stands(track)]

    def suspect_axes(self, ground: Ground | None) -> Iterator[Doubt]:
        """Say of which clouds the mount is known beside the poses, or z may point down in these.

        That is told by the ground below their sensor.
        """
        for laser, track in self._list_tracks():
            if self.courses[laser].is_of_clouds and self.sources.lidar:
                yield laser[0], self.sources.lidar
            place, stance = track.position, Stance.measure(track)
            above = np.inf if ground is None else place[:, 2] - ground.find_heights(place)
            is_odd = stance.upside_down and stance.height < 0
            if self.courses[laser].is_of_clouds and is_odd and np.mean(above < NEAR_FLOOR_M) < 0.5:
                found = "the sensor hangs upside down, below the zero of the map"
                why = "does z point down in the poses (NED)? `level=(180,0)` turns the map over"
                yield laser[0], Concern(f"{found}, and no floor is near below it: {why}")

    def suspect_places(self, middle_m: Mapping[str, float]) -> Iterator[Doubt]:
        """Say where places of sensors can hardly be metres, by topic, as are the median ranges.

        Those of which poses are mixed are as far apart for that reason.
        """
        for (topic, frame), track in self._list_tracks():
            way, doubt = self.chains.get(frame), courses.suspect_places(track, middle_m[topic])
            if doubt and not (way and courses.warn_of_mixed(way, track.stamp_ns, 0)):
                yield topic, doubt

    def _list_twins(self) -> Iterator[Doubt]:
        """Say which topics hold the scans of another one, such as those that were filtered."""
        known: dict[str, tuple[str, Int64]] = {}
        of_clouds = {laser for laser, course in self.courses.items() if course.is_of_clouds}
        ways = (self.chains.get(frame) for _, frame in of_clouds)
        # Clouds that are in the map already are made of those of a sensor, in another frame.
        are_mixed = len({way.interval_s > 0 for way in ways if way}) > 1
        for (topic, frame), track in self._list_tracks():
            kind = "" if are_mixed and (topic, frame) in of_clouds else frame
            other, stamp_ns = known.setdefault(kind, (topic, track.stamp_ns))
            if topic != other and np.isin(track.stamp_ns, stamp_ns).mean() > TWIN_SHARE:
                found = f"has the stamps of {other}, and both count"
                why = "if one is made from the other, choose with `topics`"
                yield topic, Concern(f"{found}: {why}")

    def _note(self, *sentences: str) -> None:
        self.notes += [each for each in dict.fromkeys(sentences) if each not in self.notes]
