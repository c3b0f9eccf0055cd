"""Limits that a user sets on what was measured: `NAME > NUMBER`, read and held against it.

What can be limited is listed below, command by command. A name means the same wherever it stands;
docs/pipelines.md says what.
"""

import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import permutations
from operator import attrgetter
from typing import Any, NamedTuple

from occmap.errors import UsageError, require
from occmap.plugins import guess
from occmap.report import HIDDEN

SIGNS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
SHARE = "%"
"""The unit of what is part of a whole; a limit on it is 5% or 0.05."""
COUNT = ""
"""The unit of what is counted."""

EXPRESSION = re.compile(r"\s*([^\s<>=!]+)\s*(<=?|>=?|==|!=)\s*([^\s<>=!%]+\s*%?)\s*")


class Measure(NamedTuple):
    """Something about the result of a command that a limit can be set on."""

    name: str
    unit: str
    """Such as s, or m2; SHARE or COUNT"""
    take: Callable[[Any], float]
    """Takes it from the result"""


Measures = tuple[Measure, ...]


@dataclass(frozen=True)
class Failed:
    """A limit that the result does not keep to."""

    name: str
    """What was measured, as `limits` names it"""
    value: float
    """What was measured; a share from 0 to 1, else in the unit of the measure"""
    limit: str
    """The limit, such as dropped_scans > 5%"""
    sentence: str = field(metadata=HIDDEN)
    """What was measured, and what the user says of it"""


class Limit(NamedTuple):
    """A condition on a measure under which a command fails."""

    measure: Measure
    sign: str
    bound: float
    """In the unit of the measure, a share from 0 to 1"""
    option: str = "`limits`"
    """Where the user set it"""

    @property
    def condition(self) -> str:
        """The sign and the number as they can be typed."""
        return f"{self.sign} {self._write(self.bound, 15)}"

    def find_failure(self, result: object) -> Failed | None:
        """Hold a result against the limit; None where the result keeps to it."""
        name, value = self.measure.name, self.measure.take(result)
        if not self._is_broken_by(value):
            return None
        # In few digits, but enough that it stays on its side of the limit.
        digits = next(n for n in (3, 6, 9, 17) if self._is_broken_by(float(f"{value:.{n}g}")))
        told = f"{value}" if isinstance(value, int) else self._write(value, digits)
        sentence = f"{name} is {told}, and {self.option} says {self.condition}"
        return Failed(name, value, f"{name} {self.condition}", sentence)

    def _is_broken_by(self, value: float) -> bool:
        return SIGNS[self.sign](value, self.bound)

    def _write(self, value: float, digits: int) -> str:
        is_share = self.measure.unit == SHARE
        return f"{100 * value:.{digits}g}%" if is_share else f"{value:.{digits}g}"


def parse_limit(text: str, measures: Sequence[Measure]) -> Limit:
    """Read a limit such as `dropped_scans > 5%`.

    Raises
    ------
    UsageError
        It is of another form, names none of the measures, or has a number that makes no sense.
    """
    where, by_name = f"`limits` {text!r}", {measure.name: measure for measure in measures}
    if not (found := EXPRESSION.fullmatch(text)):
        example = f"{measures[0].name} > {'5%' if measures[0].unit == SHARE else '5'}"
        fix = f'write NAME, one of {" ".join(SIGNS)} and a number, such as "{example}"'
        raise UsageError("is not a limit", where=where, fix=fix)
    name, sign, number = found.groups()
    if name not in by_name:
        fix = f"{guess(name, by_name)} there are {', '.join(by_name)}".strip()
        raise UsageError(f"no measure is called {name!r}", where=where, fix=fix)
    return Limit(by_name[name], sign, parse_bound(number, by_name[name], where))


def parse_bound(text: str, measure: Measure, where: str) -> float:
    """Read the number of a limit, with % where it is one on a share.

    Raises
    ------
    UsageError
        It is not a number, or not one that the measure can reach.
    """
    number, is_share, in_percent = text.removesuffix("%"), measure.unit == SHARE, text[-1:] == "%"
    try:
        bound = float(number) / (100 if in_percent else 1)
    except ValueError:
        bound = math.nan
    if not math.isfinite(bound):
        fix = "write a share such as 5% or 0.05" if is_share else ""
        raise UsageError(f"{text!r} is not a number", where=where, fix=fix)
    if in_percent and not is_share:
        raise UsageError(f"{measure.name} is not a share", where=where, fix="leave out the %")
    if is_share and not (0 <= bound < 1 or (bound == 1 and in_percent)):
        is_meant = 1 <= bound <= 100 and not in_percent  # most who write 1 mean 1%
        fix = f"write {bound:g}% or {bound / 100:g}" if is_meant else "write 0% to 100%"
        raise UsageError(f"{text} is not a share", where=where, fix=fix)
    return bound


def list_measures(unit: str, *names: str, of: str = "") -> Measures:
    """List measures that are called as the attributes are that hold them, of a part of a result."""
    return tuple(Measure(name, unit, attrgetter(of + name)) for name in names)


SCANS: Measures = (
    Measure("scans_read", COUNT, attrgetter("scans.read")),
    Measure("scans_used", COUNT, attrgetter("scans.used")),
    Measure("dropped_scans", SHARE, attrgetter("scans.dropped_share")),
)
"""What became of the scans, in any report"""
DAMAGE = Measure("damage", COUNT, lambda it: len(it.damage))
"""Of any report on logs"""


def take_beams(name: str, result: Any) -> float:
    """Take a share of the beams of a report; raises UsageError where it is on clouds."""
    found = f"`limits` has {name}, a share of beams, and clouds of points have none"
    require(name in result.beam_shares, found, "leave out that limit")
    return float(result.beam_shares[name])


HITS = Measure("hits", SHARE, partial(take_beams, "hits"))
SAVED: Measures = (
    *SCANS,
    HITS,
    Measure("no_return", SHARE, partial(take_beams, "no_return")),
    *list_measures(SHARE, "occupied", "free", "unknown", "undecided", of="map."),
    Measure("agreement", SHARE, lambda it: it.map.agreement or 0.0),  # 0 where no hits are kept
    Measure("cells", COUNT, attrgetter("map.cells")),
    Measure("area", "m2", attrgetter("map.area")),
    Measure("notes", COUNT, lambda it: len(it.notes)),
)
"""What can be limited of what `occmap render` and `occmap merge` make"""

BUILD: Measures = (*SAVED, DAMAGE)

CHECK: Measures = (
    Measure("scans_read", COUNT, lambda it: sum(each.scans for each in it.topics)),
    Measure("topics", COUNT, lambda it: len(it.topics)),
    Measure("dropped_scans", SHARE, lambda it: it.dropped_share),
    HITS,
    Measure("largest_gap", "s", lambda it: max([0.0, *(t.times.largest_gap_s for t in it.topics)])),
    Measure("drift", "s", lambda it: max([0.0, *(abs(t.times.drift_s) for t in it.topics)])),
    Measure("jumps_back", COUNT, lambda it: sum(each.times.jumps_back for each in it.topics)),
    Measure("cells", COUNT, lambda it: it.map.columns * it.map.rows if it.map else 0),
    Measure("warnings", COUNT, lambda it: len(it.warnings)),
    DAMAGE,
)

COMPARE: Measures = (
    Measure("share", SHARE, attrgetter("recommended.score.share")),
    *list_measures("nat", "log_likelihood", "cross_entropy", of="recommended.score."),
    Measure("seconds", "s", attrgetter("recommended.seconds")),
    *(*SCANS, DAMAGE),
)

TUNE: Measures = (*list_measures(SHARE, "gain", "share"), *SCANS, DAMAGE)

PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]
"""From which class to which a cell may change"""


def share_pair(pair: str, difference: Any) -> float:
    """Take the share of known cells that changed from one class to another."""
    return float(difference.changed[pair] / max(difference.known, 1))


DIFF: Measures = (
    Measure("changed", SHARE, attrgetter("share")),
    *(Measure(pair.replace(" ", "_"), SHARE, partial(share_pair, pair)) for pair in PAIRS),
    Measure("changed_cells", COUNT, attrgetter("changed_cells")),
    Measure("largest_blob", COUNT, lambda it: it.largest.cells if it.largest else 0),
    Measure("known", COUNT, attrgetter("known")),
)


LACKS = {
    "by_logs": ("this limit is on what logs say", "add `logs=LOG`"),
    "by_truth": ("this limit is on the truth", "give the truth as well"),
}
"""What is said where a map is scored without it"""


def take_score(judge: str, name: str, score: Any) -> float:
    """Take what recordings or the truth say of a map; raises UsageError where none is given."""
    judgement = getattr(score, judge)
    require(judgement is not None, *LACKS[judge])
    return float(getattr(judgement, name))


LOGS_SAY = {"share": SHARE, "log_likelihood": "nat", "agreement": SHARE}
TRUTH_SAYS = (
    *("edges_found", "edges_invented"),
    *("occupied_called_free", "free_called_occupied", "free_found"),
)
SCORE: Measures = (
    *(Measure(name, unit, partial(take_score, "by_logs", name)) for name, unit in LOGS_SAY.items()),
    *(Measure(name, SHARE, partial(take_score, "by_truth", name)) for name in TRUTH_SAYS),
    Measure("wall_distance", "m", partial(take_score, "by_truth", "wall_distance_m")),
    Measure("wall_distance_95", "m", partial(take_score, "by_truth", "wall_distance_95_m")),
)
