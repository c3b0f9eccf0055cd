"""What a build did: numbers for people and for programs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from occmap.cells import Box, Evidence, Manifest, OccupancyMap
from occmap.grid.tiles import TileGrid
from occmap.plain import Count, Printed, Share
from occmap.sensor.returns import ReturnCounts
from occmap.steps.tally import ScanCounts
from occmap.types import Int64, Update
from occmap.writers import WriteOptions


@dataclass(frozen=True)
class Resumed:
    """The evidence that a build was added to."""

    file: str
    """The evidence file"""
    read: Count
    """Scans that its builds read"""
    used: Count
    """Scans that its builds used"""


class MapFacts(NamedTuple):
    """What is measured of a map for its report."""

    resolution: float
    """Side of a cell, or of a pixel of an overview (m)"""
    extent: Box
    shape: tuple[int, int]
    """Rows and columns"""
    counts: Int64
    """(4,) as `count_cells` gives them"""
    agreement: float | None
    lost: Sequence[str] = ()
    """What there is to say of cells that do not last"""

    @property
    def has_walls(self) -> bool:
        """Whether the model calls any cell occupied."""
        return bool(self.counts[3])


@dataclass(frozen=True)
class MapSummary:
    """The map."""

    update: Update
    """How scans became observations of cells"""
    model: str
    """Sensor model with all its parameters, as `model` takes it"""
    min_passes: Count | None
    """On how many visits a cell had to be hit to keep its hits (`min_passes`); null: all keep
    theirs"""
    resolution: float
    """Side of a cell (m)"""
    columns: Count
    """Cells from left to right (along x)"""
    rows: Count
    """Cells from bottom to top (along y)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    align: float
    """By what the map is turned against the frame of its poses, counter-clockwise (degrees)"""
    occupied: Share
    """Share of the map's cells that are occupied, by `occupied_thresh`"""
    free: Share
    """Share of the map's cells that are free, by `free_thresh`"""
    unknown: Share
    """Share of the map's cells that nothing observed"""
    undecided: Share
    """Share of the map's cells that were observed and are neither occupied nor free"""
    agreement: Share | None
    """Share of hits that lie in cells called occupied, low where poses are wrong; null where hits
    are not kept"""

    @property
    def cells(self) -> int:
        """How many there are."""
        return self.columns * self.rows

    @property
    def area(self) -> float:
        """Area of the cells that are not unknown (m²)."""
        return self.cells * (1 - self.unknown) * self.resolution**2

    @classmethod
    def describe(cls, facts: MapFacts, manifest: Manifest, min_passes: int | None) -> Self:
        """Sum up a map of evidence."""
        rows, columns = facts.shape
        cells = rows * columns
        observed, occupied, free, _ = facts.counts.tolist()
        return cls(
            update=Update(manifest.update),
            model=manifest.model,
            min_passes=min_passes,
            resolution=facts.resolution,
            columns=columns,
            rows=rows,
            extent=facts.extent,
            align=manifest.align or 0.0,
            occupied=occupied / cells,
            free=free / cells,
            unknown=(cells - observed) / cells,
            undecided=(observed - occupied - free) / cells,
            agreement=facts.agreement,
        )


@dataclass(frozen=True)
class Report(Printed):
    """A map and how it came about: what occmap build, render and merge print."""

    logs: tuple[str, ...]
    """Logs of the map: as they were given, or, where it is made of evidence, by the names of their
    files"""
    scans: ScanCounts
    """What became of the scans"""
    builds: Count
    """How many builds the logs, scans and beams are of: more than one in evidence that was
    merged"""
    resumed: Resumed | None
    """The evidence that the build was added to (`resume`), whose scans and beams are not counted
    here; null where there is none"""
    beams: ReturnCounts
    """How many beams of the used scans were read as what"""
    map: MapSummary
    """The map"""
    notes: tuple[str, ...]
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = ()
    """Those of the notes that tell of damage to a log"""
    files: tuple[str, ...] = ()
    """Files that were written"""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time by stage (s); where threads work at the same time, their times add up; empty where no
    log was read"""

    @property
    def hit_share(self) -> float:
        """The share of beams that hit something; 0 of nothing."""
        return self.beams.hit / max(sum(self.beams), 1)

    @property
    def no_return_share(self) -> float:
        """The share of beams that nothing came back to; 0 of nothing."""
        return self.beams.no_return / max(sum(self.beams), 1)


class Build(NamedTuple):
    """A map and how it came about."""

    map: OccupancyMap
    report: Report
    observed: TileGrid
    """What the map was made of, before `min_passes` forgets anything"""
    evidence: Evidence | None
    """The same with its slices of time, to write and to merge; None where no output needs it"""


def describe_map(grid: OccupancyMap, writing: WriteOptions) -> MapFacts:
    """Measure a map, as it is written."""
    counts = count_cells(grid, writing)
    return MapFacts(grid.resolution, grid.extent, grid.shape, counts, grid.agreement)


def count_cells(grid: OccupancyMap, writing: WriteOptions) -> Int64:
    """(4,) how many cells are observed, occupied and free as written, and occupied by the model."""
    written = replace(grid, decision=writing.decide(grid.decision))
    masks = grid.observed, written.occupied, written.free, grid.occupied
    return np.array([np.count_nonzero(mask) for mask in masks])
