"""What limits can be set on, command by command: names, units, and where they come from.

A name means the same wherever it stands; docs/pipelines.md says what.
"""

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Any

from occmap.gates import COUNT, SHARE, Measure

if TYPE_CHECKING:  # each command makes one kind of result, and need not load what makes the others
    from occmap.difference import MapDifference
    from occmap.inspection.findings import Inspection, ScanFindings
    from occmap.report import Report
    from occmap.scoring.compare import Scored, VariantComparison
    from occmap.tuning import Tuning

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


def over_topics(
    combine: Callable[[list[Any]], float], take: "Callable[[ScanFindings], Any]"
) -> "Callable[[Inspection], float]":
    """Measure something of each topic of scans of all logs, and combine that."""
    return lambda it: combine([take(topic) for log in it.logs for topic in log.scans])


def take_largest(values: Sequence[float]) -> float:
    """The largest of some numbers; 0 where there are none."""
    return max(values, default=0.0)


def divide_sums(pairs: Sequence[tuple[int, int]]) -> float:
    """The sum of the first numbers of pairs, as a share of that of the second ones; 0 of none."""
    whole = sum(whole for _, whole in pairs)
    return sum(part for part, _ in pairs) / whole if whole else 0.0


def count_unposed(topic: "ScanFindings") -> tuple[int, int]:
    """How many of the scans that were asked for have no pose, and how many were asked for."""
    return topic.wanted - topic.poses.posed, topic.wanted


def count_measured(topic: "ScanFindings") -> tuple[int, int]:
    """How many of the ranges measure something, and how many there are."""
    return topic.ranges.measured, topic.ranges.total


CHECK: "tuple[Measure[Inspection], ...]" = (
    Measure("scans_read", COUNT, over_topics(sum, lambda it: it.scans)),
    Measure("topics", COUNT, over_topics(len, lambda it: it.topic)),
    Measure("dropped_scans", SHARE, over_topics(divide_sums, count_unposed)),
    Measure("hits", SHARE, over_topics(divide_sums, count_measured)),
    Measure("largest_gap", "s", over_topics(take_largest, lambda it: it.times.largest_gap_s)),
    Measure("drift", "s", over_topics(take_largest, lambda it: abs(it.times.drift_s))),
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


def share_pair(pair: str) -> "Callable[[MapDifference], float]":
    """Measure the share of known cells that changed from one class to another."""
    return lambda it: it.changed[pair] / max(it.known, 1)


PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]

DIFF: "tuple[Measure[MapDifference], ...]" = (
    Measure("changed", SHARE, lambda it: it.share),
    *(Measure(pair.replace(" ", "_"), SHARE, share_pair(pair)) for pair in PAIRS),
    Measure("changed_cells", COUNT, lambda it: it.changed_cells),
    Measure("largest_blob", COUNT, lambda it: it.largest.cells if it.largest else 0),
    Measure("known", COUNT, lambda it: it.known),
)
