"""What limits can be set on, command by command: names, units, meanings, and where they come from.

A name means the same wherever it stands.
"""

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Any, TypeVar

from occmap.gates import COUNT, SHARE, Measure

if TYPE_CHECKING:  # each command makes one kind of result, and need not load what makes the others
    from occmap.difference import MapDifference
    from occmap.inspection.findings import Inspection, ScanFindings
    from occmap.report import Report
    from occmap.scoring.compare import Scored, VariantComparison
    from occmap.tuning import Tuning

Measures = tuple[Measure[Any], ...]
Result = TypeVar("Result")


def share(name: str, meaning: str, take: Callable[[Result], float]) -> Measure[Result]:
    """Measure a share."""
    return Measure(name, SHARE, meaning, take)


def count(name: str, meaning: str, take: Callable[[Result], float]) -> Measure[Result]:
    """Measure a number."""
    return Measure(name, COUNT, meaning, take)


def divide(part: float, whole: float) -> float:
    """A share; 0 of nothing."""
    return part / whole if whole else 0.0


SAVED: "tuple[Measure[Report], ...]" = (
    count("scans_read", "scans in the logs", lambda it: it.scans.read),
    count("scans_used", "scans in the map", lambda it: it.scans.used),
    share("dropped_scans", "scans asked for that are not used", lambda it: it.scans.dropped_share),
    share("hits", "beams that hit something", lambda it: it.hit_share),
    share("no_return", "beams that nothing came back to", lambda it: it.no_return_share),
    share("occupied", "cells of the map", lambda it: it.map.occupied),
    share("free", "cells of the map", lambda it: it.map.free),
    share("unknown", "cells that nothing observed", lambda it: it.map.unknown),
    share(
        "undecided", "cells observed, but neither occupied nor free", lambda it: it.map.undecided
    ),
    share(
        "agreement",
        "hits that lie in cells called occupied; 0 where hits are not kept",
        lambda it: it.map.agreement or 0.0,
    ),
    count("cells", "columns times rows", lambda it: it.map.cells),
    Measure("area", "m2", "area of the cells that are not unknown, in m2", lambda it: it.map.area),
    count("notes", "notes on stderr", lambda it: len(it.notes)),
)
"""What can be limited of what `occmap render` and `occmap merge` make"""

BUILD: "tuple[Measure[Report], ...]" = (
    *SAVED,
    count("damage", "notes on damage to a log", lambda it: len(it.damage)),
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
    """The sum of the first numbers of pairs, as a share of the sum of the second ones."""
    return divide(sum(part for part, _ in pairs), sum(whole for _, whole in pairs))


CHECK: "tuple[Measure[Inspection], ...]" = (
    count("scans_read", "scans in the logs", over_topics(sum, lambda it: it.scans)),
    count("topics", "topics with scans", over_topics(len, lambda it: it.topic)),
    share(
        "dropped_scans",
        "scans asked for that a build drops",
        over_topics(divide_sums, lambda it: (it.wanted - it.poses.posed, it.wanted)),
    ),
    share(
        "hits",
        "ranges that measure something",
        over_topics(divide_sums, lambda it: (it.ranges.measured, it.ranges.total)),
    ),
    Measure(
        "largest_gap",
        "s",
        "longest time between two scans of a topic, in s",
        over_topics(take_largest, lambda it: it.times.largest_gap_s),
    ),
    Measure(
        "drift",
        "s",
        "growth of the stamps against the record times, in s",
        over_topics(take_largest, lambda it: abs(it.times.drift_s)),
    ),
    count(
        "jumps_back",
        "stamps earlier than the one before",
        over_topics(sum, lambda it: it.times.jumps_back),
    ),
    count(
        "cells",
        "columns times rows of the map",
        lambda it: it.map.columns * it.map.rows if it.map else 0,
    ),
    count("warnings", "warnings", lambda it: len(it.warnings)),
    count("damage", "notes on damage to a log", lambda it: sum(len(log.damage) for log in it.logs)),
)

SCORED: "tuple[Measure[Scored], ...]" = (
    count("scans_read", "scans in the logs", lambda it: it.scans.read),
    count("scans_used", "scans with a pose", lambda it: it.scans.used),
    share(
        "dropped_scans",
        "scans asked for that are not used",
        lambda it: it.scans.dropped_share,
    ),
    count("damage", "notes on damage to a log", lambda it: len(it.damage)),
)
"""What can be limited of anything that is scored on held-out scans"""

COMPARE: "tuple[Measure[VariantComparison], ...]" = (
    share(
        "share",
        "held-out beams that the recommended variant predicts",
        lambda it: it.recommended.score.share,
    ),
    Measure(
        "log_likelihood",
        "nat",
        "mean of the held-out ranges under the recommended variant",
        lambda it: it.recommended.score.log_likelihood,
    ),
    Measure(
        "cross_entropy",
        "nat",
        "mean of the cells found free and found occupied",
        lambda it: it.recommended.score.cross_entropy,
    ),
    Measure(
        "seconds",
        "s",
        "processor time of the recommended variant, in s",
        lambda it: it.recommended.seconds,
    ),
    *SCORED,
)

TUNE: "tuple[Measure[Tuning], ...]" = (
    share("gain", "by how much more of the held-out beams are predicted", lambda it: it.gain),
    share(
        "share",
        "held-out beams that the recommended correction predicts",
        lambda it: it.share,
    ),
    *SCORED,
)


def share_pair(pair: str) -> "Callable[[MapDifference], float]":
    """Measure the share of known cells that changed from one class to another."""
    return lambda it: divide(it.changed[pair], it.known)


PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]

DIFF: "tuple[Measure[MapDifference], ...]" = (
    share("changed", "cells known in either map", lambda it: it.share),
    *(share(pair.replace(" ", "_"), "the same cells", share_pair(pair)) for pair in PAIRS),
    count("changed_cells", "cells that changed", lambda it: sum(it.changed.values())),
    count(
        "largest_blob",
        "cells of the largest connected change",
        lambda it: it.largest.cells if it.largest else 0,
    ),
    count("known", "cells known in either map", lambda it: it.known),
)
