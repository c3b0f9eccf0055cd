"""The extent that a map would have, and what that costs."""

from typing import Self

import numpy as np

from occmap.arrays import Float64
from occmap.grid.lattice import CellBox, Lattice
from occmap.inspection.findings import MapFindings
from occmap.types import Kind, Rays

BYTES_PER_CELL = 4 + 1 + 8
"""In memory: log-odds, observed, and two counts of four bytes as evidence."""


class Extent:
    """The box around all cells that rays observe; it grows with the rays that it is shown.

    Parameters
    ----------
    behind
        How far behind the measured range a hit is placed (m).
    around
        How far around a hit cells are taken as observed, too (m).
    """

    def __init__(self, behind: float = 0.0, around: float = 0.0) -> None:
        self.low = np.full(2, np.inf)
        self.high = np.full(2, -np.inf)
        self.longest = 0.0
        """Of all beams (m)"""
        self._behind, self._around = behind, around

    def add(self, rays: Rays) -> None:
        """Take in the beams that are used, from where they were sent to where they end."""
        hit, used = rays.kind == Kind.HIT, rays.kind != Kind.SKIP
        ends = rays._replace(distance=rays.distance + hit * np.float32(self._behind)).end
        one_viewpoint = rays.origin.shape[1] == 1
        self._take(rays.origin[used.any(axis=1, keepdims=True) if one_viewpoint else used])
        self._take(ends[used])
        self._take(ends[hit], self._around)
        self.longest = max(self.longest, float(rays.distance.max(initial=0.0)) + self._behind)

    def _take(self, points: Float64, around: float = 0.0) -> None:
        """Take points (N, 2)."""
        if len(points):
            columns = points.T  # NumPy takes five times as long for both at once
            self.low = np.minimum(self.low, [column.min() - around for column in columns])
            self.high = np.maximum(self.high, [column.max() + around for column in columns])

    def join(self, other: Self) -> None:
        """Take in what another extent covers."""
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        self.longest = max(self.longest, other.longest)

    def sum_up(self, resolution: float) -> MapFindings | None:
        """Sum up at a resolution (m); None where nothing was seen."""
        if not np.isfinite([*self.low, *self.high]).all():
            return None
        lattice = Lattice(resolution)
        (row, col), (last_row, last_col) = (
            lattice.to_cell(float(x), float(y)) for x, y in (self.low, self.high)
        )
        box = CellBox(row, col, last_row + 1, last_col + 1)
        x, y, x_end, y_end = (round(edge, 9) for edge in lattice.measure(box))
        return MapFindings(
            resolution=resolution,
            extent=(x, y, x_end, y_end),
            columns=box.cols,
            rows=box.rows,
            file_bytes=box.cells,
            memory_bytes=box.cells * BYTES_PER_CELL,
        )
