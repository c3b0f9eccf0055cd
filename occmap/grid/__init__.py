"""The grid engine: rays in, sparse integer evidence out. Here is the lattice.

All maps of one resolution share it. Cell (row, col) of a point is (floor(y / resolution),
floor(x / resolution)), anchored at the world's zero, so that maps merge without resampling. A
coordinate is rounded once, to 1/256 of a cell; everything after it is integer arithmetic, so no
result depends on batch size, thread count or the order of scans.
"""

from dataclasses import dataclass

import numpy as np

from occmap.cells import Box, CellBox
from occmap.errors import MapError, require
from occmap.grid.kernels import CELL_SHIFT, UNITS_PER_CELL
from occmap.types import Float64, Int64

MOST_CELLS_OF_BEAM = 1 << 22
"""The longest beam (cells): an int32 holds its end, with the sensor half as far from the anchor."""

SMALLEST_CELL_M, LARGEST_CELL_M = 1e-9, 1e9
"""No laser needs smaller cells or larger ones, and far beyond these a float32 overflows."""
FARTHEST_UNIT = 1 << 52
"""Beyond this a float cannot tell lattice units apart."""


@dataclass(frozen=True)
class Lattice:
    """Cells of one size.

    Parameters
    ----------
    resolution
        Side of a cell (m), above 0.
    """

    resolution: float

    def __post_init__(self) -> None:
        found = f"a resolution of {self.resolution} m is not possible"
        fix = "give the side of a cell in metres, such as `resolution=0.05`"
        require(SMALLEST_CELL_M <= self.resolution <= LARGEST_CELL_M, found, fix)

    @property
    def units_per_metre(self) -> float:
        """Lattice units in a metre; a coordinate is multiplied by this and rounded, once."""
        return UNITS_PER_CELL / self.resolution

    def to_units(self, metres: Float64) -> Int64:
        """Round coordinates in metres, of any shape, to lattice units."""
        return np.rint(metres * self.units_per_metre).astype(np.int64)

    def to_cell(self, x: float, y: float) -> tuple[int, int]:
        """The (row, col) of the cell that holds a point, however far away."""
        row, col = (round(each * self.units_per_metre) >> CELL_SHIFT for each in (y, x))
        return row, col

    def enclose(self, points: Float64, around: float = 0.0) -> CellBox:
        """The box of the cells that hold points (N, 2), at least one, and what is so near (m)."""
        x, y = points.T  # one by one: NumPy is slow at the minimum of a short axis
        low = self.to_cell(float(x.min()) - around, float(y.min()) - around)
        high = self.to_cell(float(x.max()) + around, float(y.max()) + around)
        return CellBox.at(*low).join(CellBox.at(*high))

    def to_metres(self, cells: int) -> float:
        """The coordinate of the lower or left edge of a row or column (m)."""
        return round(cells * self.resolution, 12)  # -3.05, and not -3.0500000000000003

    def measure(self, box: CellBox) -> Box:
        """Lowest x and y, highest x and y of a box of cells (m)."""
        x, y = self.to_metres(box.col), self.to_metres(box.row)
        return x, y, self.to_metres(box.col_end), self.to_metres(box.row_end)


def refuse_long(beam: float, resolution: float) -> None:
    """Refuse a beam (m) that crosses more cells, of `resolution` (m), than kernels can count.

    Raises
    ------
    MapError
        Saying how long it is, and what to do.
    """
    if beam / resolution > MOST_CELLS_OF_BEAM:
        found = f"a beam of {beam:.6g} m is too long for cells of {resolution} m"
        raise MapError(found, fix="limit ranges with `max_range`, or use a coarser `resolution`")
