"""What limits can be set on, command by command: names, units, meanings, and where they come from.

A name means the same wherever it stands.
"""

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import TYPE_CHECKING, Any

from occmap.gates import COUNT, SHARE, Measure

if TYPE_CHECKING:  # each command makes one kind of result, and need not load what makes the others
    from occmap.difference import MapDifference
    from occmap.inspection.findings import Inspection, ScanFindings
    from occmap.report import Report, ScanCounts
    from occmap.scoring.compare import VariantComparison
    from occmap.tuning import Tuning

Measures = tuple[Measure[Any], ...]


def divide(part: float, whole: float) -> float:
    """A share; 0 of nothing."""
    return part / whole if whole else 0.0


def share_dropped(scans: "ScanCounts") -> float:
    """Measure the share of the scans asked for that are not used."""
    return divide(scans.wanted - scans.used, scans.wanted)


SAVED: "tuple[Measure[Report], ...]" = (
    Measure("scans_read", COUNT, "scans in the logs", lambda made: made.scans.read),
    Measure("scans_used", COUNT, "scans in the map", lambda made: made.scans.used),
    Measure(
        "dropped_scans",
        SHARE,
        "scans asked for that are not used",
        lambda made: share_dropped(made.scans),
    ),
    Measure(
        *("hits", SHARE, "beams that hit something"),
        lambda made: divide(made.beams.hit, sum(made.beams)),
    ),
    Measure(
        *("no_return", SHARE, "beams that nothing came back to"),
        lambda made: divide(made.beams.no_return, sum(made.beams)),
    ),
    Measure("occupied", SHARE, "cells of the map", lambda made: made.map.occupied),
    Measure("free", SHARE, "cells of the map", lambda made: made.map.free),
    Measure("unknown", SHARE, "cells that nothing observed", lambda made: made.map.unknown),
    Measure(
        *("undecided", SHARE, "cells observed, but neither occupied nor free"),
        lambda made: made.map.undecided,
    ),
    Measure(
        *("agreement", SHARE, "hits that lie in cells called occupied; 0 where hits are not kept"),
        lambda made: made.map.agreement or 0.0,
    ),
    Measure("cells", COUNT, "columns times rows", lambda made: made.map.cells),
    Measure(
        *("area", "m2", "area of the cells that are not unknown, in m2"),
        lambda made: (
            made.map.columns * made.map.rows * (1 - made.map.unknown) * made.map.resolution**2
        ),
    ),
    Measure("notes", COUNT, "notes on stderr", lambda made: len(made.notes)),
)
"""What can be limited of what `occmap render` and `occmap merge` make"""

BUILD: "tuple[Measure[Report], ...]" = (
    *SAVED,
    Measure("damage", COUNT, "notes on damage to a log", lambda made: len(made.damage)),
)


def over_topics(
    combine: Callable[[list[Any]], float], take: "Callable[[ScanFindings], Any]"
) -> "Callable[[Inspection], float]":
    """Measure something of each topic of scans of all logs, and combine that."""
    return lambda found: combine([take(topic) for log in found.logs for topic in log.scans])


def take_largest(values: Sequence[float]) -> float:
    """The largest of some numbers; 0 where there are none."""
    return max(values, default=0.0)


def divide_sums(pairs: Sequence[tuple[int, int]]) -> float:
    """The sum of the first numbers of pairs, as a share of the sum of the second ones."""
    return divide(sum(part for part, _ in pairs), sum(whole for _, whole in pairs))


CHECK: "tuple[Measure[Inspection], ...]" = (
    Measure("scans_read", COUNT, "scans in the logs", over_topics(sum, lambda each: each.scans)),
    Measure("topics", COUNT, "topics with scans", over_topics(len, lambda each: each.topic)),
    Measure(
        *("dropped_scans", SHARE, "scans asked for that a build drops"),
        over_topics(divide_sums, lambda each: (each.wanted - each.poses.posed, each.wanted)),
    ),
    Measure(
        *("hits", SHARE, "ranges that measure something"),
        over_topics(divide_sums, lambda each: (each.ranges.measured, each.ranges.total)),
    ),
    Measure(
        *("largest_gap", "s", "longest time between two scans of a topic, in s"),
        over_topics(take_largest, lambda each: each.times.largest_gap_s),
    ),
    Measure(
        *("drift", "s", "growth of the stamps against the record times, in s"),
        over_topics(take_largest, lambda each: abs(each.times.drift_s)),
    ),
    Measure(
        *("jumps_back", COUNT, "stamps earlier than the one before"),
        over_topics(sum, lambda each: each.times.jumps_back),
    ),
    Measure(
        *("cells", COUNT, "columns times rows of the map"),
        lambda found: found.map.columns * found.map.rows if found.map else 0,
    ),
    Measure("warnings", COUNT, "warnings", lambda found: len(found.warnings)),
    Measure(
        *("damage", COUNT, "notes on damage to a log"),
        lambda found: sum(len(log.damage) for log in found.logs),
    ),
)

SCORED: "tuple[Measure[VariantComparison | Tuning], ...]" = (
    Measure("scans_read", COUNT, "scans in the logs", lambda run: run.tally.scans_read),
    Measure("scans_used", COUNT, "scans with a pose", lambda run: run.tally.scans_used),
    Measure(
        *("dropped_scans", SHARE, "scans asked for that are not used"),
        lambda run: share_dropped(run.tally.scans),
    ),
    Measure("damage", COUNT, "notes on damage to a log", lambda run: len(run.remarks.damage)),
)
"""What can be limited of anything that is scored on held-out scans"""

COMPARE: "tuple[Measure[VariantComparison], ...]" = (
    Measure(
        *("share", SHARE, "held-out beams that the recommended variant predicts"),
        lambda run: run.recommended.score.share,
    ),
    Measure(
        *("log_likelihood", "nat", "mean of the held-out ranges under the recommended variant"),
        lambda run: run.recommended.score.log_likelihood,
    ),
    Measure(
        *("cross_entropy", "nat", "mean of the cells found free and found occupied"),
        lambda run: run.recommended.score.cross_entropy,
    ),
    Measure(
        *("seconds", "s", "processor time of the recommended variant, in s"),
        lambda run: run.recommended.seconds,
    ),
    *SCORED,
)

TUNE: "tuple[Measure[Tuning], ...]" = (
    Measure(
        *("gain", SHARE, "by how much more of the held-out beams are predicted"),
        lambda run: run.gain.share,
    ),
    Measure(
        *("share", SHARE, "held-out beams that the recommended correction predicts"),
        lambda run: run.after.score.share,
    ),
    *SCORED,
)


def share_pair(pair: str) -> "Callable[[MapDifference], float]":
    """Measure the share of known cells that changed from one class to another."""
    return lambda found: divide(found.changed[pair], found.known)


PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]

DIFF: "tuple[Measure[MapDifference], ...]" = (
    Measure("changed", SHARE, "cells known in either map", lambda found: found.share),
    *(Measure(pair.replace(" ", "_"), SHARE, "the same cells", share_pair(pair)) for pair in PAIRS),
    Measure(
        *("changed_cells", COUNT, "cells that changed"),
        lambda found: sum(found.changed.values()),
    ),
    Measure(
        *("largest_blob", COUNT, "cells of the largest connected change"),
        lambda found: found.largest.cells if found.largest else 0,
    ),
    Measure("known", COUNT, "cells known in either map", lambda found: found.known),
)
