"""The form in which an explanation is printed."""

from dataclasses import dataclass
from typing import Literal, TypedDict

from occmap.explanation.history import Seen, Visits
from occmap.explanation.sightings import Sighting
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
    seen: Seen
    """What observed the cell"""
    around: list[list[Seen]]
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
    scans: tuple[Sighting, ...]
    """Those of them that observed the cell, by time"""
    notes: list[str]
    """What else to know of the evidence, and what the scans leave unexplained"""
