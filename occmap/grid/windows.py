"""Dense windows that kernels write to: one for each combination of update and evidence.

A window covers the scans at hand with room to spare, so that it is emptied into the sparse tiles
only when the scans leave it. What its arrays hold is the business of its kernels.
"""

from abc import ABC, abstractmethod
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.grid.kernels.beams import Cells, Changes, Profile, sum_beams, trace_beams
from occmap.grid.kernels.outline import Surfaces
from occmap.grid.kernels.polygon import MOST_SCANS, read_border, sum_runs, trace_polygons
from occmap.grid.kernels.radial_polygon import trace_radial_polygons
from occmap.grid.kernels.units import UNITS_PER_CELL
from occmap.grid.lattice import CellBox
from occmap.grid.projection import Projected
from occmap.grid.spec import COUNT_BITS, GridSpec, RadialTables
from occmap.types import Int32, Int64, Rays, Update

CellNumbers: TypeAlias = tuple[NDArray[Any], NDArray[Any]]
"""(h, w) of each: hits and misses, or log-odds and observations"""


class Window(ABC):
    """A box of cells being written to."""

    most_observations: int = 2**30
    """A window is emptied before a cell could be observed more often."""

    def __init__(self, spec: GridSpec, box: CellBox) -> None:
        self.spec = spec
        self.box = box
        self.touched: CellBox | None = None
        self.observations = 0
        self.allocate(box.rows, box.cols)

    @abstractmethod
    def allocate(self, rows: int, cols: int) -> None:
        """Make empty arrays."""

    @staticmethod
    def count(rays: Rays, spec: GridSpec) -> int:
        """How much rays may add to the observations of one cell."""
        return rays.kind.size * spec.unit

    def has_room(self, projected: Projected) -> bool:
        """Whether rays lie wholly in the box and cannot make a number overflow."""
        observations = self.observations + self.count(projected.rays, self.spec)
        return self.box.contains(projected.box) and observations <= self.most_observations

    def observe(self, projected: Projected) -> None:
        """Observe what lies in the box."""
        self.trace(projected)
        self.observations += self.count(projected.rays, self.spec)
        touched = self.box.clip(projected.box)
        self.touched = touched if self.touched is None else self.touched.join(touched)

    def read(self) -> tuple[CellBox, NDArray[Any], NDArray[Any]]:
        """Where something may have been observed, and (h, w) of both numbers of its cells."""
        box = self.touched or CellBox(self.box.row, self.box.col, self.box.row, self.box.col)
        row, col = box.row - self.box.row, box.col - self.box.col
        first, second = self.read_from(row, col, (box.rows, box.cols))
        return box, first, second

    @abstractmethod
    def trace(self, projected: Projected) -> None:
        """Call the kernel."""

    @abstractmethod
    def read_from(self, row: int, col: int, shape: tuple[int, int]) -> CellNumbers:
        """(h, w) of both numbers of cells, from a row and column of the window on."""

    @property
    def bound(self) -> int:
        """No value of `read` is larger, either way."""
        return self.observations

    @property
    def corner(self) -> Int64:
        """(2,) x and y of the lower-left corner (lattice units)."""
        return find_corner(self.box)


def find_corner(box: CellBox) -> Int64:
    """(2,) x and y of the lower-left corner of a box (lattice units)."""
    return np.array([box.col * UNITS_PER_CELL, box.row * UNITS_PER_CELL], np.int64)


def allocate_changes(rows: int, cols: int) -> Changes:
    """Make what `trace_beams` notes: where runs start and end, and steps between."""
    return Changes(
        row_runs=np.zeros(rows * (cols + 1), np.int32),
        row_steps=np.zeros((rows + 1) * (cols + 1), np.int32),
        col_runs=np.zeros(cols * (rows + 1), np.int32),
        col_steps=np.zeros((cols + 1) * (rows + 1), np.int32),
    )


COUNTS = Profile(0.0, np.ones(1, np.int64), np.ones(1, np.int64), 1.0)
"""A beam tells each cell before its end of a miss, and its end of a hit."""


def list_cells(numbers: NDArray[Any]) -> Cells:
    """A window of one block."""
    rows, cols = numbers.shape
    table, used = np.zeros((1, 1), np.int32), np.ones(1, np.int64)
    return Cells(rows, cols, 62, cols, 0, numbers.size, table, used, numbers.ravel())


class BeamWindow(Window):
    """Hits and misses, beam by beam, with those drawn between where the update asks for them."""

    def allocate(self, rows: int, cols: int) -> None:
        self.hits = np.zeros((rows, cols), np.int32)
        self.changes = allocate_changes(rows, cols)

    def trace(self, projected: Projected) -> None:
        corner = self.corner - projected.anchor
        trace_beams(projected.beams, COUNTS, corner, list_cells(self.hits), self.changes)

    def read_from(self, row: int, col: int, shape: tuple[int, int]) -> CellNumbers:
        misses = np.empty(shape, np.int32)
        sum_beams(self.changes, self.hits.shape, (row, col), misses)
        return self.hits[row : row + shape[0], col : col + shape[1]], misses


def describe_surfaces(spec: GridSpec, projected: Projected, box: CellBox) -> Surfaces:
    """What a polygon kernel needs to know beside the rays and the arrays of a box of cells."""
    left, bottom = find_corner(box).tolist()
    shift_x, shift_y = (projected.anchor - (left, bottom)).tolist()
    return Surfaces(
        units_per_metre=spec.lattice.units_per_metre,
        jump=spec.jump,
        border_gap=spec.border_gap,
        full_circle=projected.rays.full_circle,
        left=left,
        bottom=bottom,
        shift_x=shift_x,
        shift_y=shift_y,
        clipped=not box.contains(projected.box),
    )


class PolygonWindow(Window):
    """Hits and misses, scan by scan."""

    most_observations = MOST_SCANS

    @staticmethod
    def count(rays: Rays, _spec: GridSpec) -> int:
        """A scan observes a cell once."""
        return len(rays.kind)

    def allocate(self, rows: int, cols: int) -> None:
        self.border = np.zeros((rows, cols), np.int64)
        self.runs = np.zeros(rows * (cols + 1), np.int32)

    def trace(self, projected: Projected) -> None:
        rays = projected.rays
        surfaces = describe_surfaces(self.spec, projected, self.box)
        trace_polygons(
            rays.origin,
            rays.turn,
            rays.bearing,
            rays.distance,
            projected.beams.ends_x,
            projected.beams.ends_y,
            rays.kind,
            surfaces,
            self.border,
            self.runs,
            self.observations,
        )

    def read_from(self, row: int, col: int, shape: tuple[int, int]) -> CellNumbers:
        hits, misses = np.empty(shape, np.int32), np.empty(shape, np.int32)
        read_border(self.border, self.runs, (row, col), hits, misses)
        return hits, misses


def get_tables(spec: GridSpec) -> RadialTables:
    """The tables of the model; a radial window has one."""
    if spec.radial is None:
        raise TypeError("a radial window needs a radial model")
    return spec.radial


class RadialWindow(Window):
    """Sums of log-odds and numbers of observations, packed in one integer for each cell."""

    most_observations = (1 << COUNT_BITS) - 1

    def allocate(self, rows: int, cols: int) -> None:
        self.cells = np.zeros((rows, cols), np.int64)

    @property
    def tables(self) -> RadialTables:
        return get_tables(self.spec)

    def trace_lines(self, projected: Projected, constant: int, changes: Changes) -> None:
        """Trace beam by beam; the first `constant` entries of the free table go to `changes`."""
        tables = self.tables
        depth = tables.depth * self.spec.lattice.units_per_metre
        plain = float(np.sqrt(constant / (len(tables.free) - 1)))
        profile = Profile(depth, tables.free, tables.hit, plain)
        corner = self.corner - projected.anchor
        trace_beams(projected.beams, profile, corner, list_cells(self.cells), changes)

    @abstractmethod
    def sum_plain(self, row: int, col: int, plain: Int32) -> None:
        """Write how often each cell got the first entry of the free table without being visited."""

    def read_from(self, row: int, col: int, shape: tuple[int, int]) -> CellNumbers:
        plain = np.empty(shape, np.int32)
        self.sum_plain(row, col, plain)
        visited = self.cells[row : row + shape[0], col : col + shape[1]]
        total = visited + plain * self.tables.free[0]
        return total >> COUNT_BITS, total & self.most_observations

    @property
    def bound(self) -> int:
        return self.observations * self.tables.largest


class RadialBeamWindow(RadialWindow):
    """A radial model along each beam."""

    def allocate(self, rows: int, cols: int) -> None:
        super().allocate(rows, cols)
        self.changes = allocate_changes(rows, cols)

    def trace(self, projected: Projected) -> None:
        self.trace_lines(projected, self.tables.constant, self.changes)

    def sum_plain(self, row: int, col: int, plain: Int32) -> None:
        sum_beams(self.changes, self.cells.shape, (row, col), plain)


class RadialPolygonWindow(RadialWindow):
    """A radial model, once for each cell of a scan."""

    def allocate(self, rows: int, cols: int) -> None:
        super().allocate(rows, cols)
        self.runs = np.zeros(rows * (cols + 1), np.int32)

    def trace(self, projected: Projected) -> None:
        rays, tables = projected.rays, self.tables
        if rays.kind.shape[1] == 1:  # no neighbour says how wide the beam is: it is a line
            self.trace_lines(projected, 0, allocate_changes(0, 0))
            return
        units_per_metre = self.spec.lattice.units_per_metre
        trace_radial_polygons(
            rays.origin,
            rays.turn,
            rays.bearing,
            rays.distance,
            rays.kind,
            rays.full_circle,
            self.corner,
            units_per_metre,
            tables.depth * units_per_metre,
            tables.free,
            tables.hit,
            tables.constant,
            self.cells,
            self.runs,
        )

    def sum_plain(self, row: int, col: int, plain: Int32) -> None:
        sum_runs(self.runs, self.box.cols + 1, (row, col), plain)


def choose_window(spec: GridSpec) -> type[Window]:
    """The kind of window that an update and a model need."""
    if spec.radial is None:
        return PolygonWindow if spec.update is Update.POLYGON else BeamWindow
    return RadialPolygonWindow if spec.update is Update.POLYGON else RadialBeamWindow
