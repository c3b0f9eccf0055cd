"""Limits that a user sets on what was measured: `NAME > NUMBER`, read and held against it.

What can be limited is listed below, command by command. A name means the same wherever it stands;
docs/pipelines.md says what.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from itertools import permutations
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from occmap.errors import UsageError, require
from occmap.report import HIDDEN

if TYPE_CHECKING:  # each command makes one kind of result, and need not load what makes the others
    from occmap.difference import MapDifference
    from occmap.inspection.findings import Inspection, ScanFindings
    from occmap.report.results import Report
    from occmap.scoring.compare import Scored, VariantComparison
    from occmap.scoring.maps import LogScore, MapScore, TruthScore
    from occmap.tuning import Tuning

Result_contra = TypeVar("Result_contra", contravariant=True)

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

FORM = 'write NAME, one of < <= > >= == != and a number, such as "{} > {}"'
EXPRESSION = re.compile(r"\s*([^\s<>=!]+)\s*([<>=!]+)\s*([^\s%]+)\s*(%?)\s*")


@dataclass(frozen=True)
class Measure(Generic[Result_contra]):
    """Something about the result of a command that a limit can be set on."""

    name: str
    unit: str
    """Such as s, or m2; SHARE or COUNT"""
    take: Callable[[Result_contra], float]


@dataclass(frozen=True)
class Limit:
    """A condition on a measure under which a command fails."""

    measure: Measure[Any]
    sign: str
    bound: float
    """In the unit of the measure, a share from 0 to 1"""
    in_percent: bool = False
    """The bound was written as 5% rather than 0.05"""
    option: str = "`limits`"
    """Where the user set it"""

    def is_broken_by(self, value: float) -> bool:
        """Whether the condition holds for a value."""
        return SIGNS[self.sign](value, self.bound)

    @property
    def condition(self) -> str:
        """The sign and the number as they can be typed."""
        return f"{self.sign} {self._write(self.bound, 15)}"

    def format_value(self, value: float) -> str:
        """Write a value in few digits, but enough that it stays on its side of the limit."""
        if isinstance(value, int):
            return f"{value}"
        for digits in (3, 6, 9):
            if self.is_broken_by(float(f"{value:.{digits}g}")) == self.is_broken_by(value):
                return self._write(value, digits)
        return self._write(value, 17)

    def _write(self, value: float, digits: int) -> str:
        return f"{100 * value:.{digits}g}%" if self.in_percent else f"{value:.{digits}g}"


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


def parse_limit(text: str, measures: Sequence[Measure[Any]]) -> Limit:
    """Read a limit such as `dropped_scans > 5%`.

    Raises
    ------
    UsageError
        It is of another form, names none of the measures, or has a number that makes no sense.
    """
    where = f"`limits` {text!r}"
    found = EXPRESSION.fullmatch(text)
    if found is None or found[2] not in SIGNS:
        first = measures[0]
        example = FORM.format(first.name, "5%" if first.unit == SHARE else "5")
        raise UsageError("is not a limit", where=where, fix=example)
    name, by_name = found[1], {measure.name: measure for measure in measures}
    if name not in by_name:
        close = get_close_matches(name, by_name, n=1)
        fix = f"did you mean {close[0]!r}? " if close else ""
        fix += f"there are {', '.join(by_name)}"
        raise UsageError(f"no measure is called {name!r}", where=where, fix=fix)
    bound = parse_bound(found[3] + found[4], by_name[name], where)
    return Limit(by_name[name], found[2], bound, in_percent=bool(found[4]))


def parse_bound(text: str, measure: Measure[Any], where: str) -> float:
    """Read the number of a limit, with % where it is one on a share.

    Raises
    ------
    UsageError
        It is not a number, or not one that the measure can reach.
    """
    in_percent = text.endswith("%")
    try:
        bound = float(text.removesuffix("%"))
    except ValueError:
        bound = math.nan
    if not math.isfinite(bound):
        fix = "write a share such as 5% or 0.05" if measure.unit == SHARE else ""
        raise UsageError(f"{text!r} is not a number", where=where, fix=fix)
    if measure.unit != SHARE and in_percent:
        raise UsageError(f"{measure.name} is not a share", where=where, fix="leave out the %")
    if measure.unit == SHARE and not in_percent and bound == 1:  # most who write 1 mean 1%
        found = "1 is the whole, not 1%"
        raise UsageError(found, where=where, fix="write 1% or 0.01, or else 100%")
    if in_percent:
        bound /= 100
    if measure.unit == SHARE and not 0 <= bound <= 1:
        fix = "write 0% to 100%"
        if not in_percent and 1 < bound <= 100:
            fix = f"write {bound:g}% or {bound / 100:g}"
        raise UsageError(f"{text} is not a share between 0 and 1", where=where, fix=fix)
    return bound


def judge(limits: Iterable[Limit], result: object) -> list[Failed]:
    """Hold a result against every limit; list those that it does not keep to."""
    failed = []
    for limit in limits:
        name, value = limit.measure.name, limit.measure.take(result)
        if limit.is_broken_by(value):
            told = f"{name} is {limit.format_value(value)}, and {limit.option} says"
            condition = limit.condition
            failed.append(Failed(name, value, f"{name} {condition}", f"{told} {condition}"))
    return failed


Measures = tuple[Measure[Any], ...]

SCANS: "tuple[Measure[Report | Scored], ...]" = (
    Measure("scans_read", COUNT, lambda it: it.scans.read),
    Measure("scans_used", COUNT, lambda it: it.scans.used),
    Measure("dropped_scans", SHARE, lambda it: it.scans.dropped_share),
)
"""What became of the scans, in any report"""

SAVED: "tuple[Measure[Report], ...]" = (
    *SCANS,
    Measure("hits", SHARE, lambda it: it.hit_share),
    Measure("no_return", SHARE, lambda it: it.no_return_share),
    Measure("occupied", SHARE, lambda it: it.map.occupied),
    Measure("free", SHARE, lambda it: it.map.free),
    Measure("unknown", SHARE, lambda it: it.map.unknown),
    Measure("undecided", SHARE, lambda it: it.map.undecided),
    Measure("agreement", SHARE, lambda it: it.map.agreement or 0.0),  # 0 where no hits are kept
    Measure("cells", COUNT, lambda it: it.map.cells),
    Measure("area", "m2", lambda it: it.map.area),
    Measure("notes", COUNT, lambda it: len(it.notes)),
)
"""What can be limited of what `occmap render` and `occmap merge` make"""

BUILD: "tuple[Measure[Report], ...]" = (
    *SAVED,
    Measure("damage", COUNT, lambda it: len(it.damage)),
)


largest = partial(max, default=0.0)
"""The largest of some numbers; 0 where there are none."""


def over_topics(
    combine: Callable[[list[Any]], float], take: "Callable[[ScanFindings], Any]"
) -> "Callable[[Inspection], float]":
    """Measure something of each topic of scans of all logs, and combine that."""
    return lambda it: combine([take(topic) for log in it.logs for topic in log.scans])


def divide_sums(pairs: Sequence[tuple[int, int]]) -> float:
    """Divide the sum of the first numbers of pairs by that of the second ones; 0 of nothing."""
    whole = sum(whole for _, whole in pairs)
    return sum(part for part, _ in pairs) / whole if whole else 0.0


CHECK: "tuple[Measure[Inspection], ...]" = (
    Measure("scans_read", COUNT, over_topics(sum, lambda it: it.scans)),
    Measure("topics", COUNT, over_topics(len, lambda it: it.topic)),
    Measure(
        "dropped_scans",
        SHARE,
        over_topics(divide_sums, lambda it: (it.wanted - it.poses.posed, it.wanted)),
    ),
    Measure(
        "hits", SHARE, over_topics(divide_sums, lambda it: (it.ranges.measured, it.ranges.total))
    ),
    Measure("largest_gap", "s", over_topics(largest, lambda it: it.times.largest_gap_s)),
    Measure("drift", "s", over_topics(largest, lambda it: abs(it.times.drift_s))),
    Measure("jumps_back", COUNT, over_topics(sum, lambda it: it.times.jumps_back)),
    Measure("cells", COUNT, lambda it: it.map.columns * it.map.rows if it.map else 0),
    Measure("warnings", COUNT, lambda it: len(it.warnings)),
    Measure("damage", COUNT, lambda it: sum(len(log.damage) for log in it.logs)),
)

SCORED: "tuple[Measure[Scored], ...]" = (
    *SCANS,
    Measure("damage", COUNT, lambda it: len(it.damage)),
)
"""What can be limited of anything that is scored on held-out scans"""

COMPARE: "tuple[Measure[VariantComparison], ...]" = (
    Measure("share", SHARE, lambda it: it.recommended.score.share),
    Measure("log_likelihood", "nat", lambda it: it.recommended.score.log_likelihood),
    Measure("cross_entropy", "nat", lambda it: it.recommended.score.cross_entropy),
    Measure("seconds", "s", lambda it: it.recommended.seconds),
    *SCORED,
)

TUNE: "tuple[Measure[Tuning], ...]" = (
    Measure("gain", SHARE, lambda it: it.gain),
    Measure("share", SHARE, lambda it: it.share),
    *SCORED,
)

PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]


def share_pair(pair: str) -> "Callable[[MapDifference], float]":
    """Measure the share of known cells that changed from one class to another."""
    return lambda it: it.changed[pair] / max(it.known, 1)


DIFF: "tuple[Measure[MapDifference], ...]" = (
    Measure("changed", SHARE, lambda it: it.share),
    *(Measure(pair.replace(" ", "_"), SHARE, share_pair(pair)) for pair in PAIRS),
    Measure("changed_cells", COUNT, lambda it: it.changed_cells),
    Measure("largest_blob", COUNT, lambda it: it.largest.cells if it.largest else 0),
    Measure("known", COUNT, lambda it: it.known),
)


def by_logs(take: "Callable[[LogScore], float]") -> "Callable[[MapScore], float]":
    """Measure what recordings say of a map; raises UsageError where none is given."""

    def measure(score: "MapScore") -> float:
        require(score.by_logs is not None, "this limit is on what logs say", "add `logs=LOG`")
        return take(cast("LogScore", score.by_logs))

    return measure


def by_truth(take: "Callable[[TruthScore], float]") -> "Callable[[MapScore], float]":
    """Measure what the truth says of a map; raises UsageError where it is not given."""

    def measure(score: "MapScore") -> float:
        require(score.by_truth is not None, "this limit is on the truth", "give the truth as well")
        return take(cast("TruthScore", score.by_truth))

    return measure


SCORE: "tuple[Measure[MapScore], ...]" = (
    Measure("share", SHARE, by_logs(lambda it: it.share)),
    Measure("log_likelihood", "nat", by_logs(lambda it: it.log_likelihood)),
    Measure("agreement", SHARE, by_logs(lambda it: it.agreement)),
    Measure("edges_found", SHARE, by_truth(lambda it: it.edges_found)),
    Measure("edges_invented", SHARE, by_truth(lambda it: it.edges_invented)),
    Measure("occupied_called_free", SHARE, by_truth(lambda it: it.occupied_called_free)),
    Measure("free_called_occupied", SHARE, by_truth(lambda it: it.free_called_occupied)),
    Measure("free_found", SHARE, by_truth(lambda it: it.free_found)),
    Measure("wall_distance", "m", by_truth(lambda it: it.wall_distance_m)),
    Measure("wall_distance_95", "m", by_truth(lambda it: it.wall_distance_95_m)),
)
