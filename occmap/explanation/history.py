"""What evidence holds at one point: the numbers of a cell and of those around it."""

import math
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np

from occmap.errors import UsageError
from occmap.grid.lattice import Lattice
from occmap.grid.slices import count_visits, take, unite, unpack
from occmap.grid.spec import find_unit
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind
from occmap.plain import Count
from occmap.types import Box, Evidence, Int64, Manifest, Slices, Update

FARTHEST_CELL = 1 << 44
"""Beyond this a float cannot tell the parts of a cell apart."""


Numbers: TypeAlias = tuple[int, int]
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
    def read(cls, numbers: Numbers, kind: EvidenceKind) -> Self:
        """Read the two numbers of a cell."""
        first, second = numbers
        if kind is EvidenceKind.LOG_ODDS:
            return cls(None, None, first * LOG_ODDS_UNIT, second)
        return cls(first, second, None, first + second)

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


@dataclass(frozen=True, eq=False)
class CellHistory:
    """What was observed in one cell."""

    row: int
    col: int
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    kind: EvidenceKind
    """What the two numbers are"""
    unit: int
    """What one beam, or one scan, adds to a number"""
    around: Int64
    """(3, 3, 2) the two numbers of the cell, in the middle, and its neighbours; row 0 is the lowest
    y"""
    visits: Visits | None
    """When all builds together observed the cell; None where nothing did"""
    builds: tuple[Visits | None, ...]
    """For each of the manifest's builds; None where it did not observe the cell"""

    @property
    def first(self) -> int:
        """Hits, or the sum of log-odds in units of 1/65536."""
        return int(self.around[1, 1, 0])

    @property
    def second(self) -> int:
        """Misses, or observations."""
        return int(self.around[1, 1, 1])

    @property
    def observed(self) -> bool:
        """Whether anything observed the cell."""
        return bool(self.around[1, 1].any())


def look_at(evidence: Evidence, x: float, y: float) -> CellHistory:
    """Look up the cell that holds a point (m); one that is not in the map has zeros.

    Raises
    ------
    UsageError
        No map reaches so far.
    """
    lattice = Lattice(evidence.manifest.resolution)
    row, col = find_cell(lattice, x, y)
    low_x, low_y, high_x, high_y = (lattice.to_metres(at) for at in (col, row, col + 1, row + 1))
    steps = -1, 0, 1
    tile = row // TILE, col // TILE
    layers = [
        take(layer, np.flatnonzero((layer.tiles == tile).all(axis=1))) for layer in evidence.slices
    ]
    around = [[read_cell(evidence, row + up, col + right) for right in steps] for up in steps]
    return CellHistory(
        row,
        col,
        extent=(low_x, low_y, high_x, high_y),
        kind=EvidenceKind(evidence.manifest.kind),
        unit=find_unit(Update(evidence.manifest.update)),
        around=np.array(around),
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
    """Read when slices of its tile observed a cell (row, col); None where none of them did."""
    row, col = cell[0] % TILE, cell[1] % TILE
    seen = np.unpackbits(unpack(slices)[:, 1, row], axis=1)[:, col].astype(np.bool_)
    if not seen.any():
        return None
    numbers = slices.numbers[seen].tolist()
    slice_ns = round(manifest.pass_gap_s * 1e9)
    hit, seen_visits = count_visits(slices)[:, row, col].tolist()
    hit_visits = hit if manifest.kind == EvidenceKind.COUNTS else None
    return Visits(numbers[0] * slice_ns, (numbers[-1] + 1) * slice_ns, hit_visits, seen_visits)


def read_cell(evidence: Evidence, row: int, col: int) -> Int64:
    """(2,) the two numbers of a cell; zeros where it is in no tile."""
    tile = row // TILE, col // TILE
    at = np.flatnonzero((evidence.tiles == tile).all(axis=1))
    if not len(at):
        return np.zeros(2, np.int64)
    return evidence.cells[at[0], :, row % TILE, col % TILE].astype(np.int64)
