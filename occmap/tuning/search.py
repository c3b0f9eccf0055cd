"""The search for a correction: from coarse to fine, one number after the other."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from occmap.command import to_rpy
from occmap.engines import make_engine
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.posing.options import PosingOptions
from occmap.scoring.compare import refuse_unscored
from occmap.scoring.score import Trial
from occmap.scoring.trials import Trials
from occmap.scoring.variants import Variant
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
    """From coarse to fine; curves have one peak and are smooth, so each halves the one before"""
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
        if correction not in self.tried:
            self.tried[correction] = self._try(correction)
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

    def _try(self, correction: Correction) -> Trial:
        options = self._options
        trials = Trials([Variant(options.update, options.model)], options)
        with trials.tracing() as workers:
            observe = trials.begin(workers)
            for rays in self.trace(correction):
                observe(rays)
        refuse_unscored([log.path for log in self._logs], trials.hold_out)
        (result,) = trials.score()
        return Trial(result.score, result.predicted)


def search(scorer: Scorer, start: Correction, knobs: Sequence[Knob]) -> Correction:
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
