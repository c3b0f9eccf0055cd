"""The search for a correction, from coarse to fine and one number after the other.

The scans of the logs are read once, and posed again and again.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from occmap.choices import to_rpy
from occmap.errors import PoseError
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.posing import Deskew, PosingOptions
from occmap.posing.attach import Poser
from occmap.posing.chain import MAX_TURN_S
from occmap.posing.tracks import to_quaternions
from occmap.readers import Log
from occmap.report import Finite
from occmap.scans import make_engine
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally, refuse_unused
from occmap.scans.tracing import Remarks
from occmap.scoring import SMALL, Gain, HoldOut, Sample, score_map
from occmap.scoring.compare import refuse_unscored
from occmap.sensor import interpret
from occmap.types import IDENTITY, Float64, Pose, PosedScans, Rays, ScanBatch
from occmap.workers import Workers

MOST_SCANS, MOST_OF_ALL = 1000, 4000
"""Scans of a log, and of all: more tell little more, and each is traced over thirty times."""
MOST_OFFSET_S = 0.5
"""No larger time offset is tried, either way."""
ALIKE = 1e-3
"""Mounts that differ by less (m, rad) count as one: no map shows the difference."""


@dataclass(frozen=True, eq=False)
class KeptLog:
    """Scans of one log, and what is needed to say where they were taken."""

    path: str
    poser: Poser
    batches: tuple[ScanBatch, ...]

    @property
    def stated(self) -> bool:
        """Whether all poses stand beside the scans, so that their times do not matter."""
        chosen = self.poser.sources.trajectory is not None
        return not chosen and all(batch.pose is not None for batch in self.batches)

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


def keep_logs(
    logs: Sequence[Log], options: BuildOptions, tally: Tally, remarks: Remarks
) -> list[KeptLog]:
    """Read logs as a build does, and keep scans that have a pose at every time offset.

    Raises
    ------
    OccmapError
        As a build, or no scan is left.
    """
    kept = [keep_log(log, options, limit_scans(len(logs)), tally, remarks) for log in logs]
    refuse_unused(remarks.logs, tally)
    read, used = sum(log.scans for log in kept), tally.scans_used
    if read < used:
        remarks.notes.append(f"{read:,} of {used:,} scans are tried, spread over the logs")
    kept = [drop_outer(log, options.posing) for log in kept]
    if not any(log.scans for log in kept):
        raise PoseError(
            f"no scan has a pose both {MOST_OFFSET_S:g} s before its time and {MOST_OFFSET_S:g} s "
            "after it",
            where=", ".join(remarks.logs),
            fix="give a longer log",
        )
    return kept


def limit_scans(logs: int) -> int:
    """How many scans of each of so many logs are kept."""
    return max(min(MOST_SCANS, MOST_OF_ALL // logs), 1)


def keep_log(log: Log, options: BuildOptions, most: int, tally: Tally, remarks: Remarks) -> KeptLog:
    """Read a log, and keep at most so many of the scans that have a pose."""
    drive = open_drive(log, options)
    drive.foresee()
    sample = Sample[ScanBatch](most)
    for posed in drive.read(tally):
        sample.add(posed.batch)
    tally.scans_used += sample.seen
    remarks.note(log.path, log.notes, drive.list_notes())
    return KeptLog(str(log.path), drive.poser, tuple(sample.parts))


def drop_outer(log: KeptLog, options: PosingOptions) -> KeptLog:
    """Drop the scans without a pose at some offset, so that all maps are of the same scans."""
    if log.may_deskew(options):
        options = replace(options, deskew=Deskew.ON)
    for offset in (-MOST_OFFSET_S, MOST_OFFSET_S):
        shifted = replace(options, time_offset_s=options.time_offset_s + offset)
        log = replace(log, batches=tuple(posed.batch for posed in log.pose(shifted)))
    return log


def find_mount(logs: Sequence[KeptLog], options: PosingOptions) -> Pose | None:
    """Find the `sensor_pose` that leaves every pose of a scan as it is.

    Returns
    -------
    Pose or None
        None where no single one does: lasers sit at different places, one turns on its body, or
        the log does not tell which frame the body is.
    """
    if options.sensor_pose is not None:
        return options.sensor_pose
    on_body = replace(options, sensor_pose=IDENTITY)
    mounts = []
    for log in logs:
        sensor, body = log.pose(options), log.pose(on_body)
        if [len(each.position) for each in sensor] != [len(each.position) for each in body]:
            return None
        mounts += [measure_mount(*pair) for pair in zip(sensor, body, strict=True)]
    every = np.concatenate(mounts)
    if np.abs(every - every[0]).max() >= ALIKE:
        return None
    return Pose(*every[0, :, 3].tolist(), *to_quaternions(every[:1, :, :3])[0].tolist())


def measure_mount(sensor: PosedScans, body: PosedScans) -> Float64:
    """Measure where a sensor sits on its body at each scan: (S, 3, 4), turn and position.

    The height is left out, as it is of `sensor_pose`: no map shows it.
    """
    (position, turn), (origin, orientation) = sensor.at_first_beam, body.at_first_beam
    back = orientation.swapaxes(1, 2)
    place = back @ (position - origin)[:, :, None]
    place[:, 2] = 0
    return np.concatenate([back @ turn, place], axis=2)


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


TIME = Knob("time_s", (0.16, 0.08, 0.04, 0.02, 0.01), MOST_OFFSET_S)
QUARTER_DEG = round(math.radians(0.25), 9)  # as corrections are: steps back end at 0
YAW = Knob("yaw", tuple(n * QUARTER_DEG for n in (8, 4, 2, 1)), math.radians(20))
X = Knob("x", (0.04, 0.02, 0.01, 0.005), 0.5)
Y = replace(X, name="y")
TOGETHER = [replace(knob, steps=knob.steps[-3:]) for knob in (TIME, YAW, X, Y)]


class Fare(NamedTuple):
    """How well the map of a log predicts the scans that are held out from it."""

    predicted: Float64
    """(N, 2) of each held-out scan, as `scoring.Trial.predicted` has it"""
    agreement: float | None
    """Share of the hits of the other scans in cells that it calls occupied; None without a map"""
    parts: tuple["Fare", ...] = ()
    """Those of single logs, where this is all of them together"""

    @property
    def beams(self) -> int:
        """Held-out beams that measured a range."""
        return int(self.predicted[:, 0].sum())

    @property
    def share(self) -> float:
        """Share of these that the map predicts."""
        return float(self.predicted[:, 1].sum()) / max(self.beams, 1)


def join_fares(parts: Sequence[Fare]) -> Fare:
    """Take the maps of all logs together; their agreement counts by their held-out beams."""
    known = [(each.agreement, each.beams) for each in parts if each.agreement is not None]
    agreed = sum(agreement * beams for agreement, beams in known)
    agreement = agreed / sum(beams for _, beams in known) if known else None
    return Fare(np.concatenate([each.predicted for each in parts]), agreement, tuple(parts))


@dataclass(eq=False)
class Scorer:
    """Scores corrections by the same scans, each only once."""

    logs: Sequence[KeptLog]
    options: BuildOptions
    mount: Pose | None
    """The sensor's pose as it is now"""
    advance: Callable[[], None]
    """Called for each correction"""
    tried: dict[Correction, Fare] = field(default_factory=dict)

    def score(self, correction: Correction) -> Fare:
        """Score maps of the scans posed with a correction, all logs together."""
        if correction not in self.tried:
            fare = join_fares([self.score_log(log, correction) for log in self.logs])
            refuse_unscored([log.path for log in self.logs], len(fare.predicted), fare.beams)
            self.tried[correction] = fare
            self.advance()
        return self.tried[correction]

    def score_log(self, log: KeptLog, correction: Correction) -> Fare:
        """Score a map of one log alone, since the frames of several may lie anywhere."""
        hold_out, engine = HoldOut(), make_engine(self.options)
        with Workers(engine.add, self.options.jobs) as workers:
            for rays in self.trace(log, correction):
                seen = hold_out.split(rays)
                if len(seen.kind):
                    workers.give(seen)
        if not hold_out.hits:
            return Fare(np.zeros((hold_out.scans, 2)), None)
        made = render(engine.finish(), self.options.model, self.options.max_cells)
        return Fare(score_map(made, hold_out.held, self.options.jobs).predicted, made.agreement)

    def trace(self, log: KeptLog, correction: Correction) -> Iterator[Rays]:
        """Turn the scans of a log, posed with a correction, into rays."""
        # All these scans have poses at every offset; none may get lost in a gap on the way.
        posing = replace(self.options.posing, max_pose_gap_s=None)
        for posed in log.pose(correction.apply(posing, self.mount)):
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
            and scorer.score(tried).share > scorer.score(best).share
        ):
            best, tried = tried, tried.move(knob.name, change)
        if best != start:
            break
    return best


class Verdict(StrEnum):
    """What a search is worth; `Finding.verdict` says what each means."""

    FOUND = "found"
    NOTHING = "nothing"
    DISAGREE = "disagree"
    UNSEEN = "unseen"


@dataclass(frozen=True)
class Half:
    """What half of the held-out scans gain."""

    correction: Correction
    """By what: by the best for all, or, where halves disagree, by the best for this one"""
    gain: float
    """How much larger the share is"""
    gain_error: Finite
    """Standard error of the gain, from the differences scan by scan; null where one scan is all
    there is"""


@dataclass(frozen=True)
class Finding:
    """What came of a search."""

    verdict: Verdict
    """found: a gain that is more than noise, and that both halves show; nothing: there is none;
    disagree: what gains in one half does not in the other; unseen: not searched, see the
    notes"""
    correction: Correction
    """What was found, with what was found before; else what the search began with"""
    gain: float = 0.0
    """How much larger the share is by the best that was tried"""
    gain_error: Finite = 0.0
    """Standard error of the gain, from the differences scan by scan; null where one scan is all
    there is"""
    halves: tuple[Half, ...] = ()
    """The first half of the held-out scans and the second; none where nothing was searched"""


def find_correction(scorer: Scorer, start: Correction, knobs: Sequence[Knob]) -> Finding:
    """Search for a correction better than `start`, and judge it; no knobs: no search."""
    if not knobs:
        return Finding(Verdict.UNSEEN, start)
    scorer.score(start)
    earlier = scorer.tried.keys() - {start}
    best = find_best(scorer, start, knobs)
    return judge(
        scorer, start, best, [it for it in scorer.tried if it not in earlier or it == best]
    )


def judge(
    scorer: Scorer, start: Correction, best: Correction, tried: Sequence[Correction]
) -> Finding:
    """Judge the best of the corrections that were tried to find one better than `start`.

    It must gain certainly by all held-out scans, and each half of them must show it. The halves
    disagree where what is best for one of them certainly loses in the other.
    """
    found = {each: scorer.score(each).predicted for each in tried}
    before = found[start]
    gain = Gain.measure(before, found[best])
    halves = [
        {each: Gain.measure(before[half], found[each][half]) for each in tried}
        for half in (slice(len(before) // 2), slice(len(before) // 2, None))
    ]
    alike = tuple(Half(best, *gains[best]) for gains in halves)
    if gain.certain and all(half.gain > SMALL for half in alike):
        return Finding(Verdict.FOUND, best, *gain, alike)
    first, second = halves
    opposed = contradicts(first, second) or contradicts(second, first)
    if opposed or (gain.certain and min(half.gain for half in alike) <= 0):
        favourites = ((find_favourite(gains), gains) for gains in halves)
        apart = tuple(Half(favourite, *gains[favourite]) for favourite, gains in favourites)
        return Finding(Verdict.DISAGREE, start, *gain, apart)
    return Finding(Verdict.NOTHING, start, *gain, alike)


def find_favourite(gains: Mapping[Correction, Gain]) -> Correction:
    """Find the correction that gains most for some scans."""
    return max(gains, key=lambda each: gains[each].share)


def contradicts(gains: Mapping[Correction, Gain], others: Mapping[Correction, Gain]) -> bool:
    """Whether what is best for some scans certainly gains there, and loses by other scans."""
    favourite = find_favourite(gains)
    return gains[favourite].certain and (-others[favourite]).certain


def find_deskew(scorer: Scorer, best: Correction) -> Finding:
    """Judge whether poses for single beams alone gain on the best that was found without."""
    if not all(log.may_deskew(scorer.options.posing) for log in scorer.logs):
        return Finding(Verdict.UNSEEN, best)
    tried = [best, Correction(deskew=True)]
    return judge(scorer, best, max(tried, key=lambda each: scorer.score(each).share), tried)


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
    mount = find_correction(scorer, time.correction, place)
    return time, mount, mount.correction
