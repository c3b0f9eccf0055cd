"""The search for a correction, from coarse to fine and one number after the other.

A verdict says what came of it: a gain must be more than noise, and both halves of a log show it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from occmap.choices.values import to_rpy
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.posing.options import PosingOptions
from occmap.report.printed import Finite
from occmap.scans.engines import make_engine
from occmap.scoring.compare import refuse_unscored
from occmap.scoring.score import SMALL, Gain, Trial
from occmap.scoring.trials import Trials, Variant
from occmap.sensor.returns import interpret
from occmap.tuning.kept import MOST_OFFSET_S, KeptLog
from occmap.types import Pose, Rays


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

    def move(self, name: str, step: float) -> "Correction":
        """Change one number."""
        return replace(self, **{name: round(getattr(self, name) + step, 9)})

    def apply(self, options: PosingOptions, mount: Pose | None) -> PosingOptions:
        """Correct options, of which `mount` is the sensor's pose as it is now."""
        options = replace(options, time_offset_s=round(options.time_offset_s + self.time_s, 9))
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


class Scorer:
    """Scores corrections by the same scans, each only once."""

    def __init__(
        self,
        logs: Sequence[KeptLog],
        options: BuildOptions,
        mount: Pose | None,
        advance: Callable[[], None],
    ) -> None:
        self._logs = logs
        self._options = options
        # All these scans have poses at every offset; none may get lost in a gap on the way.
        self._posing = replace(options.posing, max_pose_gap_s=None)
        self._mount = mount
        self._advance = advance
        self.tried: dict[Correction, Trial] = {}

    def score(self, correction: Correction) -> Trial:
        """Score a map of the scans posed with a correction."""
        if correction in self.tried:
            return self.tried[correction]
        options = self._options
        trials = Trials([Variant(options.update, options.model)], options)
        with trials.tracing() as workers:
            observe = trials.begin(workers)
            for rays in self.trace(correction):
                observe(rays)
        refuse_unscored([log.path for log in self._logs], trials.hold_out)
        (result,) = trials.score()
        self.tried[correction] = Trial(result.score, result.predicted)
        self._advance()
        return self.tried[correction]

    def trace(self, correction: Correction) -> list[Rays]:
        """Turn all scans, posed with a correction, into rays."""
        posing = correction.apply(self._posing, self._mount)
        every = (posed for log in self._logs for posed in log.pose(posing))
        return [interpret(posed, self._options.returns)[0] for posed in every]

    def measure_agreement(self, correction: Correction) -> float | None:
        """Measure the share of hits in occupied cells, in a map with a correction; None: no hit."""
        options = self._options
        engine = make_engine(options)
        for rays in self.trace(correction):
            engine.add(rays)
        return render(engine.finish(), options.model, options.max_cells).agreement


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
    """Search for a correction better than `start`, and judge it; no knobs: no search.

    It must gain certainly by all held-out scans, and each half of them must show it. The halves
    disagree where what is best for one of them certainly loses in the other.
    """
    if not knobs:
        return Finding(Verdict.UNSEEN, start)
    before, earlier = scorer.score(start).predicted, scorer.tried.keys() - {start}
    best = find_best(scorer, start, knobs)
    gain = Gain.measure(before, scorer.tried[best].predicted)

    of_this = [each for each in scorer.tried if each not in earlier or each == best]
    middle = len(before) // 2
    first, second = (
        {each: Gain.measure(before[half], scorer.tried[each].predicted[half]) for each in of_this}
        for half in (slice(middle), slice(middle, None))
    )
    alike = Half(best, *first[best]), Half(best, *second[best])
    if gain.certain and all(half.gain > SMALL for half in alike):
        return Finding(Verdict.FOUND, best, *gain, alike)
    mine, its = (max(gains, key=lambda each: gains[each].share) for gains in (first, second))
    opposed = (first[mine].certain and (-second[mine]).certain) or (
        second[its].certain and (-first[its]).certain
    )
    if opposed or (gain.certain and min(half.gain for half in alike) <= 0):
        apart = Half(mine, *first[mine]), Half(its, *second[its])
        return Finding(Verdict.DISAGREE, start, *gain, apart)
    return Finding(Verdict.NOTHING, start, *gain, alike)


class Way(NamedTuple):
    """What two searches found, one after the other."""

    time: Finding
    mount: Finding
    correction: Correction
    """What both found together"""

    @property
    def verdicts(self) -> list[Verdict]:
        """What each of the two searches is worth."""
        return [self.time.verdict, self.mount.verdict]


def find_way(scorer: Scorer, timed: Sequence[Knob], place: Sequence[Knob]) -> Way:
    """Search for a time offset and then for a mount; where that matters, the other way round too.

    A laser that is late looks as if it sat further back, and the reverse, so whichever is searched
    first may make up for the other.
    """
    time = find_correction(scorer, Correction(), timed)
    # Where halves want different times, a mount would only make up for that.
    disagree = time.verdict is Verdict.DISAGREE
    mount = find_correction(scorer, time.correction, [] if disagree else place)
    usual = Way(time, mount, mount.correction)
    if not disagree and time.verdict is not Verdict.FOUND:  # no time has made up for a mount
        return usual
    mount = find_correction(scorer, Correction(), place)
    time = find_correction(scorer, mount.correction, timed)
    return choose_way(scorer, usual, Way(time, mount, time.correction))


def choose_way(scorer: Scorer, usual: Way, other: Way) -> Way:
    """Choose between the way that begins with the time and the one that begins with the mount.

    The one that finds less to be wrong is right, unless the other gains certainly more.
    """
    if other.mount.verdict is not Verdict.FOUND or other.time.verdict is Verdict.DISAGREE:
        return usual
    # Two corrections fit much, even times that change within the log: the mount alone must do.
    if Verdict.DISAGREE in usual.verdicts and other.time.verdict is Verdict.FOUND:
        return usual
    less, more = sorted((usual, other), key=lambda way: way.verdicts.count(Verdict.FOUND))
    before, after = (scorer.score(way.correction).predicted for way in (less, more))
    gain = Gain.measure(before, after)
    return more if gain.certain else less
