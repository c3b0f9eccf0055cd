"""What a search is worth: a gain that is more than noise, and that both halves of a log show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from occmap.plain import Finite
from occmap.scoring.score import Trial, estimate_error
from occmap.scoring.trials import NOISE, SMALL
from occmap.tuning.search import Correction, Knob, Scorer, search

EVERY_SCAN = slice(None)


class Verdict(StrEnum):
    """What a search is worth; `Finding.verdict` says what each means."""

    FOUND = "found"
    NOTHING = "nothing"
    DISAGREE = "disagree"
    UNSEEN = "unseen"


class Gain(NamedTuple):
    """How much larger the share of one map is than that of another, by the same scans."""

    share: float = 0.0
    error: float = 0.0
    """Standard error, from the differences scan by scan"""

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


def find(scorer: Scorer, start: Correction, knobs: Sequence[Knob]) -> Finding:
    """Search for a correction better than `start`, and judge it; no knobs: no search."""
    if not knobs:
        return Finding(Verdict.UNSEEN, start)
    before, earlier = scorer.score(start), set(scorer.tried)
    middle = len(before.predicted) // 2
    best = search(scorer, start, knobs)
    tried = {
        each: trial
        for each, trial in scorer.tried.items()
        if each not in earlier or each in (start, best)
    }
    gain = Gain.measure(before, tried[best])
    halves = [
        {each: Gain.measure(before, trial, half) for each, trial in tried.items()}
        for half in (slice(middle), slice(middle, None))
    ]
    alike = tuple(Half(best, *gains[best]) for gains in halves)
    if gain.certain and all(half.gain > SMALL for half in alike):
        return Finding(Verdict.FOUND, best, *gain, alike)
    # What is best for one half alone may certainly lose in the other.
    own = [max(gains, key=lambda each: gains[each].share) for gains in halves]
    opposed = any(
        gains[each].certain and Gain(-rest[each].share, rest[each].error).certain
        for each, gains, rest in zip(own, halves, reversed(halves), strict=True)
    )
    if opposed or (gain.certain and min(half.gain for half in alike) <= 0):
        apart = tuple(Half(each, *gains[each]) for each, gains in zip(own, halves, strict=True))
        return Finding(Verdict.DISAGREE, start, *gain, apart)
    return Finding(Verdict.NOTHING, start, *gain, alike)
