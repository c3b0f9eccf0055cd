"""What a search is worth: a gain that is more than noise, and that both halves of a log show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from occmap.scoring.score import Trial, estimate_error
from occmap.scoring.trials import NOISE, SMALL
from occmap.tuning.search import Correction, Course, Knob, search

EVERY_SCAN = slice(None)


class Verdict(StrEnum):
    """What came of a search."""

    FOUND = "found"
    """A gain that is more than noise, and so large in either half of the held-out scans that it
    shows."""
    NOTHING = "nothing"
    DISAGREE = "disagree"
    """What gains in one half of the scans does not in the other: something else is wrong."""
    UNSEEN = "unseen"
    """Not searched, as these logs cannot show it."""


class Gain(NamedTuple):
    """How much higher the share of one map is than that of another."""

    share: float = 0.0
    error: float = 0.0
    """Standard error; both are asked about the same scans"""

    @property
    def certain(self) -> bool:
        """Whether it is more than noise, and so much that it shows in a map."""
        return self.share > max(NOISE * self.error, SMALL)

    @classmethod
    def measure(cls, before: Trial, after: Trial, scans: slice = EVERY_SCAN) -> "Gain":
        """Measure it by the same held-out scans, all or some."""
        beams, now = after.predicted[scans].T
        more = now - before.predicted[scans, 1]
        return cls(math.fsum(more) / max(math.fsum(beams), 1), estimate_error(more, beams))


NO_GAIN = Gain()


@dataclass(frozen=True)
class Finding:
    """What came of the search for a time offset, or for a mount."""

    verdict: Verdict
    correction: Correction
    """The best there is: what was found, or else what the search began with"""
    gain: Gain = NO_GAIN
    """What the best that was tried gains, by all held-out scans"""
    halves: tuple[tuple[Correction, Gain], ...] = ()
    """What the first half of the held-out scans and the second gain, and by what: by the best for
    both, or, where they disagree, each by what is best for itself"""


def find(course: Course, start: Correction, knobs: Sequence[Knob]) -> Finding:
    """Search for a better correction than one, and judge it; without knobs there is no search."""
    if not knobs:
        return Finding(Verdict.UNSEEN, start)
    before, earlier = course.score(start), set(course.tried)
    best = search(course, start, knobs)
    tried = {start, best} | (course.tried.keys() - earlier)
    gain = Gain.measure(before, course.tried[best])
    halves = [
        {
            each: Gain.measure(before, trial, half)
            for each, trial in course.tried.items()
            if each in tried
        }
        for half in cut(before)
    ]
    alike = tuple((best, gains[best]) for gains in halves)
    if gain.certain and all(part.share > SMALL for _, part in alike):
        return Finding(Verdict.FOUND, best, gain, alike)
    own = [max(gains, key=lambda each: gains[each].share) for gains in halves]
    apart = tuple((each, gains[each]) for each, gains in zip(own, halves, strict=True))
    opposed = any(
        gains[each].certain and Gain(-rest[each].share, rest[each].error).certain
        for each, gains, rest in zip(own, halves, reversed(halves), strict=True)
    )
    if opposed or (gain.certain and min(part.share for _, part in alike) <= 0):
        return Finding(Verdict.DISAGREE, start, gain, apart)
    return Finding(Verdict.NOTHING, start, gain, alike)


def cut(trial: Trial) -> tuple[slice, slice]:
    """Cut the held-out scans of a trial into halves."""
    middle = len(trial.predicted) // 2
    return slice(0, middle), slice(middle, None)
