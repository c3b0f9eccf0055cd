"""How the grid engine is to turn rays into evidence: update, lattice, and a model's tables."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from occmap.grid.kernels.units import BEAM_WEIGHT, COUNT_BITS, TABLE_STEPS, Tables
from occmap.grid.lattice import Lattice
from occmap.grid.tiles import LOG_ODDS_UNIT, EvidenceKind
from occmap.types import Float64, Update

WINDOW_CELLS = 1 << 24
"""The largest window; scans that need more are traced part by part."""
COUNTS = Tables(0.0, np.ones(1, np.int64), 1.0, 1, COUNT_BITS)
"""What stands for a model that counts: a plain cell gets a miss."""

Formula = Callable[[Float64], Float64]
"""(T,) shares in [0, 1] to (T,) probabilities of being occupied."""

SUREST = 2.0**-53
"""No probability is tabulated nearer to 0 or 1 than this: a float has none between it and 1, and
sums of log-odds fit a window's integers, whatever a model says."""


def tabulate(free: Formula, hit: Formula, depth: float) -> Tables:
    """Tabulate a radial model's probabilities, each at the middle of its step."""
    middle = np.minimum((np.arange(TABLE_STEPS + 1) + 0.5) / TABLE_STEPS, 1)
    tables = []
    for formula in (free, hit):
        p = np.clip(formula(middle), SUREST, 1 - SUREST)
        tables.append(np.rint(np.log(p / (1 - p)) / LOG_ODDS_UNIT).astype(np.int64))
    largest = max(int(np.abs(table).max()) for table in tables)
    # A cell's sum of log-odds and number of observations, its sign apart, share 63 bits.
    bits = (63 - largest.bit_length()) // 2
    entries = np.append((np.concatenate(tables) << bits) + 1, 0)
    constant = int(np.argmax(np.append(entries[:TABLE_STEPS], 0) != entries[0]))
    plain = float(np.sqrt(constant / TABLE_STEPS))
    return Tables(depth, entries, plain, largest, bits)


def find_unit(update: str) -> int:
    """What one beam, or one scan, weighs in the numbers of a cell; raises ValueError if unknown."""
    return BEAM_WEIGHT if Update(update) is Update.SURFACE else 1


@dataclass(frozen=True)
class GridSpec:
    """How rays become evidence."""

    update: Update
    lattice: Lattice
    jump: float = 0.1
    """Neighbours see the same surface if their ranges differ by at most this (m) or, in the surface
    update, by a tenth of the nearer range; the beam update has no neighbours"""
    border_gap: int = 8
    """The border of a surface is closed over at most so many cells (polygon)"""
    hit_offset: float = 0.0
    """Cells by which a hit lies behind the measured point: that is on a surface, not in it"""
    radial: Tables | None = None
    """None: hits and misses are counted"""

    @property
    def tables(self) -> Tables:
        """What a beam adds to a cell."""
        return COUNTS if self.radial is None else self.radial

    @property
    def unit(self) -> int:
        """What one beam, or one scan, weighs in the numbers of a cell."""
        return find_unit(self.update)

    @property
    def kind(self) -> EvidenceKind:
        """What the two numbers of a cell are."""
        return EvidenceKind.COUNTS if self.radial is None else EvidenceKind.LOG_ODDS
