"""The search for a correction, from coarse to fine and one number after the other.

The scans of the logs are read once, and posed again and again.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Self

import numpy as np

from occmap.choices import to_rpy
from occmap.errors import PoseError
from occmap.evidence import render
from occmap.options import BuildOptions, compose_build
from occmap.posing import Deskew, PosingOptions
from occmap.posing.attach import Poser
from occmap.posing.chain import MAX_TURN_S, Transforms
from occmap.scans import Sample, make_engine, mounts
from occmap.scans.logs import choose_topics
from occmap.scans.stream import Drive
from occmap.scans.tally import Tally, refuse_unused
from occmap.scans.tracing import Reading
from occmap.scoring import SMALL, Gain, Trial, has_hits, hold_out, score_map
from occmap.scoring.compare import refuse_unscored
from occmap.sensor import ReturnOptions, interpret
from occmap.types import Float64, Int64, Kind, Pose, PosedScans, Rays, ScanBatch

MOST_SCANS, MOST_OF_ALL = 1000, 4000
"""Scans of a log, and of all: more tell little more, and each is traced over thirty times."""
USUAL_SCORINGS = 35
"""About how many maps a search scores, for the progress bar"""
REACH_S = 0.5
"""No larger time offset is tried, either way."""
ALIKE = 1e-3
"""Mounts that differ by less (m, rad) count as one: no map shows the difference."""


@dataclass(frozen=True, eq=False)
class KeptLog:
    """Scans of one log, and what is needed to say where they were taken."""

    path: str
    poser: Poser
    batches: tuple[ScanBatch, ...]
    has_others: bool = False
    """Whether the log has scans on topics that are not asked for, too"""

    @property
    def topics(self) -> list[str]:
        """The topics of the scans."""
        return sorted({batch.topic for batch in self.batches})

    def take(self, topic: str) -> Self:
        """Take the scans of one topic."""
        mine = tuple(batch for batch in self.batches if batch.topic == topic)
        return replace(self, batches=mine)

    @property
    def stated(self) -> bool:
        """Whether all poses stand beside the scans, so that their times do not matter."""
        return self.poser.options.takes_stated(*self.batches)

    def pose(self, options: PosingOptions) -> list[PosedScans]:
        """Pose the scans with other options; those that then have no pose are left out."""
        poser = Poser(self.poser.sources, options, self.poser.fixed)
        return [posed for batch in self.batches for posed in poser.attach(batch)]

    def may_deskew(self, options: PosingOptions) -> bool:
        """Whether all scans say believably when each beam was measured, and no option uses it."""
        times = [np.abs(it.time_increment) * (it.ranges.shape[1] - 1) for it in self.batches]
        is_timed = all(((it > 0) & (it <= MAX_TURN_S)).all() for it in times)
        return options.deskew is Deskew.OFF and is_timed and not self.stated

    @property
    def scans(self) -> int:
        """How many scans are kept."""
        return sum(len(batch.stamp_ns) for batch in self.batches)


def keep_logs(reading: Reading) -> list[KeptLog]:
    """Read logs as a build does, and keep scans that have a pose at every time offset.

    The tally goes on to show the progress of a search over them.

    Raises
    ------
    OccmapError
        As a build, or no scan is left.
    """
    tally = reading.tally
    logs = len(tally.logs)
    most = max(min(MOST_SCANS, MOST_OF_ALL // logs), 1)
    reading.total += USUAL_SCORINGS * min(reading.total, most * logs)
    kept = [keep_log(drive, most, tally) for drive in reading.list_drives()]
    refuse_unused(tally)
    read, used = sum(log.scans for log in kept), tally.scans_used
    if read < used:
        tally.notes.append(f"{read:,} of {used:,} scans are tried, spread over the logs")
    kept = [drop_outer(log, reading.options.posing) for log in kept]
    if not any(log.scans for log in kept):
        reach = f"{REACH_S:g} s"
        found = f"no scan has a pose both {reach} before its time and {reach} after it"
        raise PoseError(found, where=", ".join(tally.logs), fix="give a longer log")
    return kept


def keep_log(drive: Drive, most: int, tally: Tally) -> KeptLog:
    """Read a log, and keep at most so many of the scans that have a pose."""
    sample = Sample[ScanBatch](most)
    for posed in drive.read(tally):
        sample.add((thin_clouds(posed) if posed.batch.clouds else posed).batch)
    tally.scans_used += sample.seen
    has_others = len(choose_topics(drive.log, ())) > len(drive.topics)
    return KeptLog(str(drive.log.path), drive.poser, tuple(sample.parts), has_others)


def drop_outer(log: KeptLog, options: PosingOptions) -> KeptLog:
    """Drop the scans without a pose at some offset, so that all maps are of the same scans."""
    if log.may_deskew(options):
        options = replace(options, deskew=Deskew.ON)
    for offset in (-REACH_S, REACH_S):
        shifted = replace(options, time_offset_s=options.time_offset_s + offset)
        log = replace(log, batches=tuple(posed.batch for posed in log.pose(shifted)))
    return log


def find_common_mount(logs: Sequence[KeptLog]) -> Pose | None:
    """Find the `sensor_pose` that leaves every pose of a scan as it is.

    Its height is left out, as it is where `sensor_pose` is typed: no map shows it.

    Returns
    -------
    Pose or None
        None where no single one does: lasers sit at different places, one turns on its body, or
        a log does not tell which frame the body is.
    """
    found = [
        mounts.find_mount(log.poser, frame)
        for log in logs
        for frame in sorted({batch.frame for batch in log.batches})
    ]
    places = [it.pose._replace(z=0.0) for it in found if it and not it.frames]
    is_one = len(places) == len(found) and np.ptp(places, axis=0).max() < ALIKE
    return places[0] if is_one else None


SLICED_BEAMS = 720
"""Of a planar scan out of each cloud, at the height of its sensor, as a laser there would take it:
walls are sharp in such scans where time and mount are right. For the map itself clouds are not cut.
"""
BAND_M = 0.2
"""Points that lie less far above or below their sensor are of its planar scan"""
KEPT_BAND_M, KEPT_POINTS = 0.6, 10_000
"""Of about so many points of a cloud those are kept that may lie in the band by other poses"""
NEAREST_M, FARTHEST_M = 0.3, 30.0


def thin_clouds(posed: PosedScans) -> PosedScans:
    """Keep, of clouds, copies of some points that lie near the height of their sensor."""
    every = [len(cloud.points) // KEPT_POINTS + 1 for cloud in posed.batch.clouds or ()]
    some = take_points(posed, [slice(None, None, stride) for stride in every])
    near = [np.flatnonzero(np.abs(away[:, 2]) < KEPT_BAND_M) for away, _ in list_away(some)]
    return take_points(some, near)


def take_points(posed: PosedScans, chosen: Sequence[slice | Int64]) -> PosedScans:
    """Take of each cloud the points that are chosen of it."""
    kept = []
    for cloud, which in zip(posed.batch.clouds or (), chosen, strict=True):
        times = None if cloud.offset_ns is None else cloud.offset_ns[which]
        kept.append(cloud._replace(points=cloud.points[which], offset_ns=times))
    return replace(posed, batch=replace(posed.batch, clouds=tuple(kept)))


def slice_clouds(posed: PosedScans, options: ReturnOptions) -> Rays:
    """Make a planar scan of each cloud: of each half degree the nearest point in the band."""
    shape = len(posed.batch.stamp_ns), SLICED_BEAMS
    origin, direction = np.zeros((shape[0], 1, 2)), np.zeros((*shape, 2))
    distance, kind = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    nearest, farthest = max(NEAREST_M, options.min_range), min(FARTHEST_M, options.max_range)
    for scan, (away, sensor) in enumerate(list_away(posed)):
        reach = np.hypot(away[:, 0], away[:, 1])
        seen = (np.abs(away[:, 2]) < BAND_M) & (reach > nearest) & (reach < farthest)
        order = np.flatnonzero(seen)[np.argsort(-reach[seen], kind="stable")]
        x_y, length = away[order, :2], reach[order]
        bearing = np.arctan2(x_y[:, 1], x_y[:, 0]) * (SLICED_BEAMS / math.tau)
        beam = np.floor(bearing).astype(np.int64) % SLICED_BEAMS
        # Of several points of a beam the last one is kept, which is the nearest.
        direction[scan, beam], distance[scan, beam] = x_y / length[:, np.newaxis], length
        kind[scan, beam], origin[scan, 0] = Kind.HIT, sensor[:2]
    return Rays.along(origin, direction, distance, kind, posed.batch.stamp_ns, full_circle=True)


def list_away(posed: PosedScans) -> Iterator[tuple[Float64, Float64]]:
    """List for each cloud where its points lie from its sensor (N, 3), and where that is (3,) (m).

    Both are turned as the map is.
    """
    from occmap.clouds.kernels import heights  # noqa: PLC0415  late: it brings LLVM

    for cloud in heights.list_clouds(posed):
        points, pose = heights.pose_points(cloud, len(cloud.points))
        turned = np.einsum("nij,nj->ni", pose[:, :, :3], points)
        yield turned + pose[:, :, 3] - cloud.origin, cloud.origin


@dataclass(frozen=True)
class Correction:
    """What is added to the stamps of scans, and to the laser's place on its body."""

    time_s: float = 0.0
    """Added to the stamps of scans (s)"""
    yaw: float = 0.0
    """Added to the laser's yaw on its body (rad)"""
    x: float = 0.0
    """Added to its x on the body (m)"""
    y: float = 0.0
    """Added to its y on the body (m)"""
    deskew: bool = False
    """Each beam has a pose of its own"""

    @property
    def is_any(self) -> bool:
        """Whether it changes something."""
        return self != Correction()

    def move(self, name: str, step: float) -> "Correction":
        """Change one number."""
        return replace(self, **{name: round(getattr(self, name) + step, 9)})

    def apply(self, options: PosingOptions, mount: Pose | None) -> PosingOptions:
        """Correct options, of which `mount` is the sensor's pose as it is now."""
        options = replace(options, time_offset_s=round(options.time_offset_s + self.time_s, 9))
        if self.deskew:
            options = replace(options, deskew=Deskew.ON)
        if mount is None or not any((self.yaw, self.x, self.y)):
            return options
        roll, pitch, yaw = to_rpy(mount)
        # Rounded as `sensor_pose` is written.
        place = round(mount.x + self.x, 5), round(mount.y + self.y, 5), mount.z
        turned = math.remainder(yaw + self.yaw, math.tau)
        pose = Pose.from_xyzrpy(place, (roll, pitch, round(turned, 5)))
        return replace(options, sensor_pose=pose)


@dataclass(frozen=True)
class Knob:
    """A number of the correction, and how it is searched."""

    name: str
    steps: tuple[float, ...]
    """From coarse to fine, each half the one before: the share has a single, smooth peak"""
    reach: float
    """No larger correction is tried, either way"""


TIME = Knob("time_s", (0.16, 0.08, 0.04, 0.02, 0.01), REACH_S)
QUARTER_DEG = round(math.radians(0.25), 9)  # as corrections are: steps back end at 0
YAW = Knob("yaw", tuple(n * QUARTER_DEG for n in (8, 4, 2, 1)), math.radians(20))
X = Knob("x", (0.04, 0.02, 0.01, 0.005), 0.5)
Y = replace(X, name="y")


@dataclass(eq=False)
class Scorer:
    """Scores corrections by the same scans, each only once."""

    logs: Sequence[KeptLog]
    options: BuildOptions
    mount: Pose | None
    """The sensor's pose as it is now"""
    advance: Callable[[], None]
    """Called for each correction"""
    tried: dict[Correction, Trial] = field(default_factory=dict)

    def is_at_edge(self, correction: Correction) -> bool:
        """Whether a larger time offset, which is not tried, may well be better."""
        return abs(correction.time_s) > REACH_S - TIME.steps[1]

    def score(self, correction: Correction) -> Trial:
        """Score maps of the scans posed with a correction, all logs together."""
        if correction not in self.tried:
            trial = Trial.join(self.score_log(log, correction) for log in self.logs)
            paths = [log.path for log in self.logs]
            refuse_unscored(paths, len(trial.totals), trial.score.beams > 0)
            self.tried[correction] = trial
            self.advance()
        return self.tried[correction]

    def score_log(self, log: KeptLog, correction: Correction) -> Trial:
        """Score a map of one log alone, since the frames of several may lie anywhere."""
        engine = make_engine(self.options)
        held_out = hold_out(self.trace(log, correction), [engine], self.options.jobs)
        if not has_hits(held_out):
            return Trial(np.zeros((held_out.scans, 6)), np.zeros((1, 3)), None)
        made = render(engine.finish(), self.options.model, self.options.max_cells)
        return score_map(made, held_out.parts, self.options.jobs)

    def trace(self, log: KeptLog, correction: Correction) -> Iterator[Rays]:
        """Turn the scans of a log, posed with a correction, into rays."""
        # All these scans have poses at every offset; none may get lost in a gap on the way.
        posing = replace(self.options.posing, max_pose_gap_s=None)
        for posed in log.pose(correction.apply(posing, self.mount)):
            if posed.batch.clouds:
                yield slice_clouds(posed, self.options.returns)
            else:
                yield interpret(posed, self.options.returns)[0]


def find_best(scorer: Scorer, start: Correction, knobs: Sequence[Knob]) -> Correction:
    """Search for the correction with the best share: all numbers by coarse steps, then by finer."""
    best = start
    for steps in zip(*(knob.steps for knob in knobs), strict=True):
        for knob, step in zip(knobs, steps, strict=True):
            best = climb(scorer, best, knob, step)
    return best


def climb(scorer: Scorer, best: Correction, knob: Knob, step: float) -> Correction:
    """Change one number by steps, up or else down, as long as the share grows."""
    for change in (step, -step):
        start, tried = best, best.move(knob.name, change)
        while (
            abs(getattr(tried, knob.name)) <= knob.reach
            and scorer.score(tried).score.share > scorer.score(best).score.share
        ):
            best, tried = tried, tried.move(knob.name, change)
        if best != start:
            break
    return best


def compose(scorer: Scorer, best: Correction) -> tuple[str, ...]:
    """Compose the line of a build with a correction.

    Where a log has other lasers, too, the mount is written as a transform to the one that is tuned,
    since `sensor_pose` is for a laser that is alone.
    """
    options, mount, changes = scorer.options, scorer.mount, dict[str, str]()
    posing = best.apply(options.posing, mount)
    one, moved = next(log for log in scorer.logs if log.batches), posing.sensor_pose
    seat = mounts.find_mount(one.poser, one.batches[0].frame, in_3d=True)
    if one.has_others and mount and moved and seat and seat.frames:
        step = Transforms.fixed(mount).invert().then(Transforms.fixed(moved)).first
        changes = seat.write(mounts.turn_mount(seat.pose, step))
        posing = replace(posing, sensor_pose=None)
    paths = [log.path for log in scorer.logs]
    return compose_build(paths, replace(options, posing=posing), changes.items())


class Verdict(StrEnum):
    """What a search is worth; `Finding.verdict` says what each means."""

    FOUND = "found"
    NOTHING = "nothing"
    DISAGREE = "disagree"
    UNSEEN = "unseen"


@dataclass(frozen=True, kw_only=True)
class Half(Gain):
    """What half of the held-out scans gain."""

    correction: Correction
    """By what: by the best for all, or, where halves disagree, by the best for this one"""


@dataclass(frozen=True, kw_only=True)
class Finding(Gain):
    """What came of a search."""

    verdict: Verdict
    """found: a gain that is more than noise, and that both halves show; nothing: there is none;
    disagree: what gains in one half does not in the other; unseen: not searched, see the
    notes"""
    correction: Correction
    """What was found, with what was found before; else what the search began with"""
    gain: float = 0.0
    """How much larger the share is by the best that was tried"""
    halves: tuple[Half, ...] = ()
    """The first half of the held-out scans and the second; none where nothing was searched"""


def find_correction(scorer: Scorer, start: Correction, knobs: Sequence[Knob]) -> Finding:
    """Search for a correction better than `start`, and judge it; no knobs: no search."""
    if not knobs:
        return Finding(verdict=Verdict.UNSEEN, correction=start)
    scorer.score(start)
    earlier = scorer.tried.keys() - {start}
    best = find_best(scorer, start, knobs)
    tried = [each for each in scorer.tried if each not in earlier or each == best]
    return assess(scorer, start, best, tried)


def assess(scorer: Scorer, start: Correction, best: Correction, tried: list[Correction]) -> Finding:
    """Judge the best of the corrections that were tried to find one better than `start`.

    It must gain certainly by all held-out scans, and each half of them must show it. The halves
    disagree where what is best for one of them certainly loses in the other.
    """
    found = {each: scorer.score(each).predicted for each in tried}
    before = found[start]
    gain = Gain.measure(before, found[best])
    halves = [
        {
            each: Half(correction=each, **vars(Gain.measure(before[half], found[each][half])))
            for each in tried
        }
        for half in (slice(len(before) // 2), slice(len(before) // 2, None))
    ]
    of_best = tuple(half[best] for half in halves)
    favourites = tuple(max(half.values(), key=lambda each: each.gain) for half in halves)
    are_opposed = any(
        each.certain and other[each.correction].loses
        for each, other in zip(favourites, reversed(halves), strict=True)
    )
    if gain.certain and all(half.gain > SMALL for half in of_best):
        return Finding(verdict=Verdict.FOUND, correction=best, **vars(gain), halves=of_best)
    if are_opposed or (gain.certain and min(half.gain for half in of_best) <= 0):
        return Finding(verdict=Verdict.DISAGREE, correction=start, **vars(gain), halves=favourites)
    return Finding(verdict=Verdict.NOTHING, correction=start, **vars(gain), halves=of_best)


def is_better(scorer: Scorer, start: Correction, other: Correction) -> bool:
    """Whether a correction is one that was started from, or surely better."""
    return start == other or assess(scorer, start, other, [start, other]).verdict is Verdict.FOUND


def find_deskew(scorer: Scorer, best: Correction, timed: Sequence[Knob]) -> Finding:
    """Judge whether poses for single beams alone gain on the best that was found without."""
    if not timed or not all(log.may_deskew(scorer.options.posing) for log in scorer.logs):
        return Finding(verdict=Verdict.UNSEEN, correction=best)
    tried = [best, Correction(deskew=True)]
    return assess(scorer, best, max(tried, key=lambda each: scorer.score(each).score.share), tried)


def find_both(
    scorer: Scorer, start: Correction, timed: Sequence[Knob], place: Sequence[Knob]
) -> tuple[Finding, Finding, Correction]:
    """Search for a time offset and for a mount; give what came of each, and both together.

    A laser that is late looks as if it sat further back, and the reverse, so each makes up for a
    part of the other. What gains more alone is right, and the other is searched on top of it.
    """
    time = find_correction(scorer, start, timed)
    # Where halves want different times, a mount would only make up for that.
    mount = find_correction(scorer, start, [] if time.verdict is Verdict.DISAGREE else place)
    if time.verdict is not Verdict.FOUND:
        return time, mount, mount.correction
    if mount.verdict is Verdict.FOUND and mount.gain > time.gain:
        time = find_correction(scorer, mount.correction, timed)
        return time, mount, time.correction
    # At the edge of what is tried, it would make up for the rest of the time.
    place = [] if scorer.is_at_edge(time.correction) else place
    mount = find_correction(scorer, time.correction, place)
    return time, mount, mount.correction
