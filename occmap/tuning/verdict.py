"""What a search is worth: a gain that is more than noise, and that both halves of a log show."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from occmap.scoring.score import Trial, estimate_error
from occmap.scoring.trials import NOISE, SMALL
from occmap.tuning.search import Correction, Course, Knob, search


class Verdict(StrEnum):
    """What came of a search."""

    FOUND = "found"
    """A gain that is more than noise, in a map of all scans and in one of either half."""
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
    def measure(cls, before: Trial, after: Trial) -> "Gain":
        """Measure it scan by scan."""
        beams, near = after.predicted.T
        error = estimate_error(near - before.predicted[:, 1], beams)
        return cls(after.score.share - before.score.share, error)


@dataclass(frozen=True)
class Finding:
    """What came of the search for a time offset, or for a mount."""

    verdict: Verdict
    correction: Correction
    """The best there is: what was found, or else what the search began with"""
    gain: Gain = Gain()
    """Of the best that was tried, in a map of all scans"""
    halves: tuple[tuple[Correction, Gain], ...] = ()
    """What the first half of the scans and the second gain, and by what: by the best for both, or,
    where they disagree, each by what is best for itself"""


def find(course: Course, start: Correction, knobs: Sequence[Knob]) -> Finding:
    """Search for a better correction than one, and judge it; without knobs there is no search."""
    if not knobs:
        return Finding(Verdict.UNSEEN, start)
    earlier = course.tried.keys() - {start}
    best = search(course, start, knobs)
    tried = {each: halves for each, halves in course.tried.items() if each not in earlier}
    gain = Gain.measure(course.score_whole(start), course.score_whole(best))
    alike = [(best, Gain.measure(*pair)) for pair in zip(tried[start], tried[best], strict=True)]
    if gain.certain and all(part.certain for _, part in alike):
        return Finding(Verdict.FOUND, best, gain, tuple(alike))
    own = [max(tried, key=lambda each: tried[each][half].score.share) for half in (0, 1)]  # noqa: B023
    apart = [
        (each, Gain.measure(tried[start][half], tried[each][half])) for half, each in enumerate(own)
    ]
    swapped = [Gain.measure(tried[start][half], tried[own[1 - half]][half]) for half in (0, 1)]
    opposed = all(part.certain for _, part in apart) and min(swapped).share < 0
    if gain.certain or opposed:
        return Finding(Verdict.DISAGREE, start, gain, tuple(apart))
    return Finding(Verdict.NOTHING, start, gain, tuple(alike))
