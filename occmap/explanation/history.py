"""What evidence holds at one point: the numbers of a cell and of those around it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from occmap.cells import Box, Evidence, Manifest, Slices
from occmap.errors import UsageError
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.slices import count_visits, take, unite, unpack
from occmap.grid.spec import find_unit
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind
from occmap.report.printed import Count

FARTHEST_CELL = 1 << 44
"""Beyond this a float cannot tell the parts of a cell apart."""

Numbers = tuple[int, int]
"""Hits and misses, or log-odds in units of 1/65536 and observations"""


@dataclass(frozen=True)
class Seen:
    """What observed a cell."""

    hits: Count | None
    """Hits; null for evidence in log-odds"""
    misses: Count | None
    """Misses; null for evidence in log-odds"""
    log_odds: float | None
    """Sum of log-odds (natural logarithm); null for evidence in counts"""
    observations: Count
    """Observations: hits and misses, or those that the sum is of"""

    @classmethod
    def read(cls, numbers: Iterable[int], kind: EvidenceKind) -> Self:
        """Read the two numbers of a cell."""
        first, second = numbers
        if kind is EvidenceKind.LOG_ODDS:
            return cls(None, None, first * LOG_ODDS_UNIT, second)
        return cls(first, second, None, first + second)

    @property
    def kind(self) -> EvidenceKind:
        """What the two numbers of the cell are."""
        return EvidenceKind.COUNTS if self.log_odds is None else EvidenceKind.LOG_ODDS

    @property
    def numbers(self) -> Numbers:
        """The two numbers of the cell."""
        if self.log_odds is not None:
            return round(self.log_odds / LOG_ODDS_UNIT), self.observations
        return self.hits or 0, self.misses or 0


@dataclass(frozen=True)
class Visits:
    """When a cell was observed."""

    since_ns: int
    """When the first slice of time (`pass_gap_s`) begins in which the cell was observed (ns)"""
    until_ns: int
    """When the last slice of time ends in which the cell was observed (ns)"""
    hit_visits: Count | None
    """Visits that hit the cell; null for evidence in log-odds"""
    seen_visits: Count
    """Visits that observed the cell"""


@dataclass(frozen=True)
class Cell:
    """A cell of the map."""

    row: int
    """Row of the cell in the lattice: floor(y / resolution)"""
    column: int
    """Column of the cell in the lattice: floor(x / resolution)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""


@dataclass(frozen=True)
class CellHistory:
    """What was observed in one cell."""

    cell: Cell
    unit: int
    """What one beam, or one scan, adds to a number"""
    around: list[list[Seen]]
    """What observed the cell, in the middle, and its neighbours: 3 rows by falling y, in them 3
    cells by rising x"""
    visits: Visits | None
    """When all builds together observed the cell; None where nothing did"""
    builds: tuple[Visits | None, ...]
    """For each of the manifest's builds; None where it did not observe the cell"""

    @property
    def seen(self) -> Seen:
        """What observed the cell."""
        return self.around[1][1]


def look_at(evidence: Evidence, x: float, y: float) -> CellHistory:
    """Look up the cell that holds a point (m); one that is not in the map has zeros.

    Raises
    ------
    UsageError
        No map reaches so far.
    """
    lattice = Lattice(evidence.manifest.resolution)
    row, col = find_cell(lattice, x, y)
    tile = row // TILE, col // TILE
    layers = [
        take(layer, np.flatnonzero((layer.tiles == tile).all(axis=1))) for layer in evidence.slices
    ]
    return CellHistory(
        Cell(row, col, lattice.measure(CellBox.at(row, col))),
        unit=find_unit(evidence.manifest.update),
        around=[
            [read_cell(evidence, row + up, col + right) for right in (-1, 0, 1)]
            for up in (1, 0, -1)
        ],
        visits=read_visits(unite(layers), (row, col), evidence.manifest),
        builds=tuple(read_visits(layer, (row, col), evidence.manifest) for layer in layers),
    )


def find_cell(lattice: Lattice, x: float, y: float) -> tuple[int, int]:
    """Row and column of the cell that holds a point (m).

    Raises
    ------
    UsageError
        It is too far away, or not finite.
    """
    farthest = max(abs(x), abs(y)) / lattice.resolution
    if math.isnan(x + y) or not farthest < FARTHEST_CELL:
        raise UsageError(
            f"the point ({x:g}, {y:g}) is in no map", fix="give x and y in metres, in the map frame"
        )
    return lattice.to_cell(x, y)


def read_visits(slices: Slices, cell: tuple[int, int], manifest: Manifest) -> Visits | None:
    """Read from the slices of its tile when a cell (row, col) was observed; None: never."""
    row, col = cell[0] % TILE, cell[1] % TILE
    seen = np.unpackbits(unpack(slices)[:, 1, row], axis=1)[:, col].astype(np.bool_)
    if not seen.any():
        return None
    numbers = slices.numbers[seen].tolist()
    slice_ns = round(manifest.pass_gap_s * 1e9)
    hit, seen_visits = count_visits(slices)[:, row, col].tolist()
    hit_visits = hit if manifest.kind == EvidenceKind.COUNTS else None
    return Visits(numbers[0] * slice_ns, (numbers[-1] + 1) * slice_ns, hit_visits, seen_visits)


def read_cell(evidence: Evidence, row: int, col: int) -> Seen:
    """Read what observed a cell; a cell that is in no tile has zeros."""
    at = np.flatnonzero((evidence.tiles == (row // TILE, col // TILE)).all(axis=1))
    numbers = evidence.cells[at, :, row % TILE, col % TILE].astype(np.int64).sum(axis=0).tolist()
    return Seen.read(numbers, EvidenceKind(evidence.manifest.kind))
