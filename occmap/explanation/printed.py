"""The form in which an explanation is printed."""

from dataclasses import dataclass
from typing import Literal, TypedDict

from occmap.explanation.history import Visits
from occmap.explanation.sightings import Numbers, Sighting
from occmap.grid.tiles import LOG_ODDS_UNIT, EvidenceKind
from occmap.plain import Count, Share
from occmap.types import Box


class PrintedCell(TypedDict):
    """A cell of the map."""

    row: int
    """Row of the cell in the lattice: floor(y / resolution)"""
    column: int
    """Column of the cell in the lattice: floor(x / resolution)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""


class PrintedSeen(TypedDict):
    """What observed a cell."""

    hits: Count | None
    """Hits; null for evidence in log-odds"""
    misses: Count | None
    """Misses; null for evidence in log-odds"""
    log_odds: float | None
    """Sum of log-odds (natural logarithm); null for evidence in counts"""
    observations: Count
    """Observations: hits and misses, or those that the sum is of"""


class PrintedSighting(TypedDict):
    """What one scan did to the cell."""

    stamp_ns: int
    """When the scan was taken, as its log says it (ns)"""
    log: str
    """The log, as it was given"""
    build: Count
    """Which build of the evidence used it, counted from 0 as in the manifest"""
    topic: str
    """The topic, or the kind of line"""
    seen: PrintedSeen
    """What the scan added to the cell"""
    x: float
    """Where the sensor was (m)"""
    y: float
    """Where the sensor was (m)"""
    distance: float
    """From there to the middle of the cell (m)"""


@dataclass(frozen=True, kw_only=True)
class BuildVisits(Visits):
    """When one build observed the cell."""

    build: Count
    """Which build of the evidence, counted from 0 as in the manifest"""
    logs: list[str]
    """The names of its logs"""


class PrintedExplanation(TypedDict):
    """What was seen at a point, and by which scans: what occmap explain prints."""

    point: tuple[float, float]
    """x and y that were asked for (m)"""
    cell: PrintedCell
    """The cell that holds the point"""
    digest: str | None
    """SHA-256 of all that a store holds, however it is compressed; null for a file"""
    map_extent: Box | None
    """Lowest x and y, highest x and y of all observed cells (m); null where there are none"""
    class_: Literal["occupied", "free", "undecided", "unknown"]
    """What the cell is; unknown is what nothing observed, undecided what is neither occupied nor
    free"""
    probability: Share
    """How much the cell is thought to be occupied, from 0 to 1; the prior where it is
    unknown"""
    model: str
    """The sensor model that says so, with its parameters"""
    unit: Count
    """What one observation counts in hits, misses, log_odds and observations: divide these by
    it"""
    seen: PrintedSeen
    """What observed the cell"""
    around: list[list[PrintedSeen]]
    """What observed the cell, in the middle, and its neighbours: rows by falling y, in them
    cells by rising x"""
    min_passes: Count | None
    """On how many visits the cell has to be hit to keep its hits (`min_passes`); null where
    nobody asked"""
    visits: Visits | None
    """When all builds together observed the cell; null where nothing did"""
    builds: tuple[BuildVisits, ...]
    """The builds that observed the cell"""
    scans_used: Count
    """Scans of the logs given that their builds used"""
    scans: list[PrintedSighting]
    """Those of them that observed the cell, by time"""
    notes: list[str]
    """What else to know of the evidence, and what the scans leave unexplained"""


def describe_seen(numbers: Numbers, kind: EvidenceKind) -> PrintedSeen:
    """Give the two numbers of a cell by name; None for what evidence of this kind does not hold."""
    first, second = numbers
    if kind is EvidenceKind.LOG_ODDS:
        odds = first * LOG_ODDS_UNIT
        return {"hits": None, "misses": None, "log_odds": odds, "observations": second}
    return {"hits": first, "misses": second, "log_odds": None, "observations": first + second}


def describe_sighting(sighting: Sighting, kind: EvidenceKind) -> PrintedSighting:
    """Give what one scan did to the cell."""
    x, y = sighting.sensor
    return {
        "stamp_ns": sighting.stamp_ns,
        "log": sighting.log,
        "build": sighting.build,
        "topic": sighting.topic,
        "seen": describe_seen(sighting.numbers, kind),
        "x": x,
        "y": y,
        "distance": sighting.distance,
    }
