"""The grid engine: rays in, sparse integer evidence out. Here is the lattice.

All maps of one resolution share it. Cell (row, col) of a point is (floor(y / resolution),
floor(x / resolution)), anchored at the world's zero, so that maps merge without resampling. A
coordinate is rounded once, to 1/256 of a cell; everything after it is integer arithmetic, so no
result depends on batch size, thread count or the order of scans.
"""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from occmap.cells import Box, OccupancyMap
from occmap.errors import MapError, require
from occmap.grid.kernels.units import CELL_SHIFT, UNITS_PER_CELL
from occmap.types import Bool, Float64, Int64

MOST_CELLS_OF_BEAM = 1 << 22
"""The longest beam (cells): an int32 holds its end, with the sensor half as far from the anchor."""

SMALLEST_CELL_M, LARGEST_CELL_M = 1e-9, 1e9
"""No laser needs smaller cells or larger ones, and far beyond these a float32 overflows."""
FARTHEST_UNIT = 1 << 52
"""Beyond this a float cannot tell lattice units apart."""


class CellBox(NamedTuple):
    """A rectangle of cells; the ends are not part of it."""

    row: int
    col: int
    row_end: int
    col_end: int

    @classmethod
    def of(cls, grid: OccupancyMap) -> Self:
        """The cells of a map, on the lattice of its resolution."""
        (row, col), (rows, cols) = grid.place.tolist(), grid.shape
        return cls(row, col, row + rows, col + cols)

    @classmethod
    def around(cls, mask: Bool, row: int, col: int) -> Self | None:
        """The smallest box around the cells of a mask (H, W) that are true; None: no cell is.

        The mask begins at cell (row, col).
        """
        rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return None
        edges = rows[0], cols[0], rows[-1] + 1, cols[-1] + 1
        return cls(*map(int, edges)).move(row, col)

    @classmethod
    def at(cls, row: int, col: int) -> Self:
        """The box of a single cell."""
        return cls(row, col, row + 1, col + 1)

    @property
    def rows(self) -> int:
        """Height in cells."""
        return self.row_end - self.row

    @property
    def cols(self) -> int:
        """Width in cells."""
        return self.col_end - self.col

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.cols

    @property
    def cells(self) -> int:
        """How many cells it covers."""
        return self.rows * self.cols

    def contains(self, other: Self) -> bool:
        """Whether `other` lies wholly in this box."""
        return self.clip(other) == other

    def find(self, places: Int64) -> Int64:
        """Which of the rows and columns (N, 2) lie in this box."""
        return np.flatnonzero(((places >= self[:2]) & (places < self[2:])).all(axis=1))

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns in an array that begins at cell (0, 0)."""
        return slice(self.row, self.row_end), slice(self.col, self.col_end)

    def within(self, outer: Self) -> tuple[slice, slice]:
        """Its rows and columns in the array of a box around it."""
        return self.move(-outer.row, -outer.col).slices

    def clip(self, other: Self) -> Self:
        """The part of `other` that lies in this box."""
        return type(self)(
            min(max(other.row, self.row), self.row_end),
            min(max(other.col, self.col), self.col_end),
            max(min(other.row_end, self.row_end), self.row),
            max(min(other.col_end, self.col_end), self.col),
        )

    def move(self, rows: int, cols: int) -> Self:
        """Move the box up by `rows` and to the right by `cols`."""
        ends = (self.row + rows, self.col + cols, self.row_end + rows, self.col_end + cols)
        return type(self)(*ends)

    def grow(self, cells: int) -> Self:
        """The box with so many cells more on each side."""
        ends = self.row_end + cells, self.col_end + cells
        return type(self)(self.row - cells, self.col - cells, *ends)

    def align(self, side: int) -> Self:
        """The smallest box around this one that is made of squares of `side` by `side` cells."""
        ends = (-(-edge // side) * side for edge in (self.row_end, self.col_end))
        return type(self)(self.row // side * side, self.col // side * side, *ends)

    def scale(self, side: int) -> Self:
        """The box in cells, where it counts squares of `side` by `side` cells."""
        return type(self)(*(edge * side for edge in self))

    def shrink(self, side: int) -> Self:
        """Count the box in squares of `side` by `side` cells, of which it is made."""
        return type(self)(*(edge // side for edge in self))

    def join(self, other: Self) -> Self:
        """The smallest box around both."""
        starts, ends = map(min, self[:2], other[:2]), map(max, self[2:], other[2:])
        return type(self)(*starts, *ends)


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
