"""What limits can be set on, command by command: names, units, meanings, and where they come from.

A name means the same wherever it stands.
"""

from collections.abc import Callable
from itertools import permutations
from typing import TYPE_CHECKING, Any

from occmap.gates import COUNT, SHARE, Measure

if TYPE_CHECKING:  # each command makes one kind of result, and need not load what makes the others
    from occmap.difference import MapDifference
    from occmap.inspection.findings import Inspection, ScanFindings
    from occmap.report import Report, Tally
    from occmap.scoring.compare import VariantComparison
    from occmap.tuning import Tuning

Measures = tuple[Measure[Any], ...]


def divide(part: float, whole: float) -> float:
    """A share; 0 of nothing."""
    return part / whole if whole else 0.0


def share_dropped(scans: "Report | Tally") -> float:
    """Measure the share of the scans asked for that are not used."""
    return divide(scans.scans_wanted - scans.scans_used, scans.scans_wanted)


def share_beams(kind: str) -> "Callable[[Report], float]":
    """Measure the share of beams that were read as one kind."""
    return lambda report: divide(getattr(report.beams, kind), sum(report.beams))


def measure_area(report: "Report") -> float:
    """Area of the cells that something observed (m2)."""
    return report.columns * report.rows * (1 - report.shares.unknown) * report.resolution**2


SAVED: "tuple[Measure[Report], ...]" = (
    Measure("scans_read", COUNT, "scans in the logs", lambda report: report.scans_read),
    Measure("scans_used", COUNT, "scans in the map", lambda report: report.scans_used),
    Measure(
        "dropped_scans", SHARE, "of the scans asked for, those that are not used", share_dropped
    ),
    Measure("hits", SHARE, "of the beams, those that hit something", share_beams("hit")),
    Measure(
        "no_return",
        SHARE,
        "of the beams, those that nothing came back to",
        share_beams("no_return"),
    ),
    Measure("occupied", SHARE, "of the map's cells", lambda report: report.shares.occupied),
    Measure("free", SHARE, "of the map's cells", lambda report: report.shares.free),
    Measure(
        "unknown",
        SHARE,
        "of the map's cells, those that nothing observed",
        lambda report: report.shares.unknown,
    ),
    Measure(
        "undecided",
        SHARE,
        "of the map's cells, those observed, but neither occupied nor free",
        lambda report: report.undecided,
    ),
    Measure(
        "agreement",
        SHARE,
        "of the hits, those that lie in cells called occupied; 0 where hits are not kept",
        lambda report: report.agreement or 0.0,
    ),
    Measure(
        "cells",
        COUNT,
        "columns times rows of the map",
        lambda report: report.columns * report.rows,
    ),
    Measure("area", "m2", "area of the cells that are not unknown, in m2", measure_area),
    Measure("notes", COUNT, "notes on stderr", lambda report: len(report.notes)),
)
"""Of what `occmap render` and `occmap merge` make."""

BUILD: "tuple[Measure[Report], ...]" = (
    *SAVED,
    Measure("damage", COUNT, "notes on damage to a log", lambda report: len(report.damage)),
)


def list_topics(inspection: "Inspection") -> "list[ScanFindings]":
    """All topics of scans, of all logs."""
    return [topic for log in inspection.logs for topic in log.scans]


def sum_topics(count: "Callable[[ScanFindings], int]") -> "Callable[[Inspection], int]":
    """Measure something that adds up over topics."""
    return lambda inspection: sum(count(topic) for topic in list_topics(inspection))


def measure_largest(time: "Callable[[ScanFindings], float]") -> "Callable[[Inspection], float]":
    """Measure the largest of all topics."""
    return lambda inspection: max(map(time, list_topics(inspection)), default=0.0)


def share_ranges(inspection: "Inspection") -> float:
    """Of all range values, those that are a measurement."""
    topics = list_topics(inspection)
    measured = sum(topic.ranges.measured for topic in topics)
    return divide(measured, sum(topic.ranges.total for topic in topics))


def share_lost(inspection: "Inspection") -> float:
    """Of the scans asked for, those that a build with the same options would drop."""
    topics = list_topics(inspection)
    wanted, posed = sum(topic.wanted for topic in topics), sum(each.poses.posed for each in topics)
    return divide(wanted - posed, wanted)


CHECK: "tuple[Measure[Inspection], ...]" = (
    Measure("scans_read", COUNT, "scans in the logs", sum_topics(lambda topic: topic.scans)),
    Measure("topics", COUNT, "topics with scans", lambda inspection: len(list_topics(inspection))),
    Measure("dropped_scans", SHARE, "of the scans asked for, those that a build drops", share_lost),
    Measure("hits", SHARE, "of the ranges, those that measure something", share_ranges),
    Measure(
        "largest_gap",
        "s",
        "longest time between two scans of a topic, in s",
        measure_largest(lambda topic: topic.times.largest_gap_s),
    ),
    Measure(
        "drift",
        "s",
        "growth of the stamps against the record times, in s",
        measure_largest(lambda topic: abs(topic.times.drift_s)),
    ),
    Measure(
        "jumps_back",
        COUNT,
        "stamps earlier than the one before",
        sum_topics(lambda topic: topic.times.jumps_back),
    ),
    Measure(
        "cells",
        COUNT,
        "columns times rows of the map",
        lambda inspection: inspection.map.columns * inspection.map.rows if inspection.map else 0,
    ),
    Measure("warnings", COUNT, "warnings", lambda inspection: len(inspection.warnings)),
    Measure(
        "damage",
        COUNT,
        "notes on damage to a log",
        lambda inspection: sum(len(log.damage) for log in inspection.logs),
    ),
)

COMPARE: "tuple[Measure[VariantComparison], ...]" = (
    Measure(
        "share",
        SHARE,
        "of the held-out beams, those that the recommended variant predicts",
        lambda comparison: comparison.recommended.score.share,
    ),
    Measure(
        "log_likelihood",
        "nat",
        "mean of the held-out ranges under the recommended variant",
        lambda comparison: comparison.recommended.score.log_likelihood,
    ),
    Measure(
        "cross_entropy",
        "nat",
        "mean of the cells found free and found occupied",
        lambda comparison: comparison.recommended.score.cross_entropy,
    ),
    Measure(
        "seconds",
        "s",
        "processor time of the recommended variant, in s",
        lambda comparison: comparison.recommended.seconds,
    ),
    Measure(
        "scans_read", COUNT, "scans in the logs", lambda comparison: comparison.tally.scans_read
    ),
    Measure(
        "scans_used", COUNT, "scans with a pose", lambda comparison: comparison.tally.scans_used
    ),
    Measure(
        "dropped_scans",
        SHARE,
        "of the scans asked for, those that are not used",
        lambda comparison: share_dropped(comparison.tally),
    ),
    Measure(
        "damage",
        COUNT,
        "notes on damage to a log",
        lambda comparison: len(comparison.remarks.damage),
    ),
)

TUNE: "tuple[Measure[Tuning], ...]" = (
    Measure(
        "gain",
        SHARE,
        "by how much more of the held-out beams are predicted with what is recommended",
        lambda tuning: tuning.gain.share,
    ),
    Measure(
        "share",
        SHARE,
        "of the held-out beams, those that are predicted with what is recommended",
        lambda tuning: tuning.after.score.share,
    ),
    Measure("scans_read", COUNT, "scans in the logs", lambda tuning: tuning.tally.scans_read),
    Measure("scans_used", COUNT, "scans with a pose", lambda tuning: tuning.tally.scans_used),
    Measure(
        "dropped_scans",
        SHARE,
        "of the scans asked for, those that are not used",
        lambda tuning: share_dropped(tuning.tally),
    ),
    Measure("damage", COUNT, "notes on damage to a log", lambda tuning: len(tuning.remarks.damage)),
)


def share_pair(pair: str) -> "Callable[[MapDifference], float]":
    """Measure the share of known cells that changed from one class to another."""
    return lambda difference: divide(difference.changed[pair], difference.known)


PAIRS = [f"{was} to {now}" for was, now in permutations(("neither", "free", "occupied"), 2)]

DIFF: "tuple[Measure[MapDifference], ...]" = (
    Measure(
        "changed", SHARE, "of the cells known in either map", lambda difference: difference.share
    ),
    *(
        Measure(pair.replace(" ", "_"), SHARE, "of the same cells", share_pair(pair))
        for pair in PAIRS
    ),
    Measure(
        "changed_cells",
        COUNT,
        "cells that changed",
        lambda difference: sum(difference.changed.values()),
    ),
    Measure(
        "largest_blob",
        COUNT,
        "cells of the largest connected change",
        lambda difference: difference.largest.cells if difference.largest else 0,
    ),
    Measure("known", COUNT, "cells known in either map", lambda difference: difference.known),
)
