"""What evidence holds at one point: the numbers of a cell and of those around it."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occmap.errors import UsageError
from occmap.grid.lattice import Lattice
from occmap.grid.layers import find_cell
from occmap.grid.tiles import TILE, EvidenceKind
from occmap.types import Box, Evidence, Int64, Times

FARTHEST_CELL = 1 << 44
"""Beyond this a float cannot tell the parts of a cell apart."""


class Visits(NamedTuple):
    """When one build observed a cell."""

    first_ns: int
    last_ns: int
    hit_visits: int
    """On how many visits the cell was hit; 0 where the evidence is log-odds"""
    seen_visits: int
    """On how many it was observed at all"""


@dataclass(frozen=True, eq=False)
class CellHistory:
    """What was observed in one cell."""

    row: int
    col: int
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    kind: EvidenceKind
    """What the two numbers are"""
    around: Int64
    """(3, 3, 2) the two numbers of the cell, in the middle, and its neighbours; row 0 is the lowest
    y"""
    builds: tuple[Visits | None, ...] = ()
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
    def visits(self) -> Int64:
        """(2,) on how many visits the cell was hit, and observed at all; builds add up."""
        each = [(visits.hit_visits, visits.seen_visits) for visits in self.builds if visits]
        total: Int64 = np.array(each, np.int64).reshape(-1, 2).sum(axis=0)
        return total

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
    refuse_far_point(lattice, x, y)
    row, col = lattice.to_cell(x, y)
    low_x, low_y, high_x, high_y = (lattice.to_metres(at) for at in (col, row, col + 1, row + 1))
    steps = (-1, 0, 1)
    around = [[read_cell(evidence, row + up, col + right) for right in steps] for up in steps]
    return CellHistory(
        row,
        col,
        extent=(low_x, low_y, high_x, high_y),
        kind=EvidenceKind(evidence.manifest.kind),
        around=np.array(around),
        builds=tuple(read_visits(times, row, col) for times in evidence.times),
    )


def refuse_far_point(lattice: Lattice, x: float, y: float) -> None:
    """Refuse a point that is no cell.

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


def read_visits(times: Times, row: int, col: int) -> Visits | None:
    """When a build observed a cell; None where it did not."""
    at = find_cell(times, row, col)
    if at is None:
        return None
    columns = (times.first_ns, times.last_ns, times.hit_visits, times.seen_visits)
    return Visits(*(int(column[at]) for column in columns))


def read_cell(evidence: Evidence, row: int, col: int) -> Int64:
    """(2,) the two numbers of a cell; zeros where it is in no tile."""
    tile = row // TILE, col // TILE
    at = np.flatnonzero((evidence.tiles == tile).all(axis=1))
    if not len(at):
        return np.zeros(2, np.int64)
    return evidence.cells[at[0], :, row % TILE, col % TILE].astype(np.int64)
