"""Windows that kernels write to: one for each combination of update and evidence.

A window covers the scans at hand with room to spare, so that it is emptied into the sparse tiles
only when the scans leave it. What its arrays hold is the business of its kernels.
"""

from abc import ABC, abstractmethod

import numpy as np

from occmap.arrays import Int32, Int64
from occmap.grid.kernels.beams import Profile, note_beams
from occmap.grid.kernels.polygon import BORDER_BITS, COUNTED, MOST_SCANS, trace_polygons
from occmap.grid.kernels.radial_polygon import trace_radial_polygons
from occmap.grid.kernels.sums import Changes, Packing, read_tiles
from occmap.grid.kernels.units import PAD, TILE, UNITS_PER_CELL
from occmap.grid.kernels.visits import Tiles, trace_tiles, trace_window
from occmap.grid.lattice import CellBox
from occmap.grid.projection import Projected
from occmap.grid.spec import GridSpec, Tables
from occmap.grid.tiles import Key, Tile
from occmap.types import Rays, Update

ALL_BITS = -1
"""The mask of numbers of which all bits are evidence."""


def count_observations(rays: Rays, spec: GridSpec) -> int:
    """How much rays may add to the observations of one cell."""
    once_a_scan = spec.update is Update.POLYGON and spec.radial is None
    return len(rays.kind) if once_a_scan else rays.kind.size * spec.unit


def find_most_observations(spec: GridSpec) -> int:
    """How often a cell may be observed before its window must be emptied."""
    once_a_scan = spec.update is Update.POLYGON and spec.radial is None
    return MOST_SCANS if once_a_scan else spec.tables.most_observations


class Window(ABC):
    """A box of whole tiles being written to."""

    most_cells_times = 1
    """Such a window may have so many times the cells of others"""

    def __init__(self, spec: GridSpec, box: CellBox) -> None:
        self.spec = spec
        self.box = box.align(TILE)
        self.touched: CellBox | None = None
        self.observations = 0
        self.allocate(self.box.rows, self.box.cols)

    @abstractmethod
    def allocate(self, rows: int, cols: int) -> None:
        """Make empty arrays."""

    @property
    def tables(self) -> Tables:
        """What the model says."""
        return self.spec.tables

    def has_room(self, projected: Projected) -> bool:
        """Whether rays lie wholly in the box and cannot make a number overflow."""
        observations = self.observations + count_observations(projected.beams.rays, self.spec)
        return self.box.contains(projected.box) and observations <= find_most_observations(
            self.spec
        )

    def observe(self, projected: Projected) -> None:
        """Observe what lies in the box."""
        self.trace(projected)
        self.observations += count_observations(projected.beams.rays, self.spec)
        touched = self.box.clip(projected.box).align(TILE)
        self.touched = touched if self.touched is None else self.touched.join(touched)

    @abstractmethod
    def trace(self, projected: Projected) -> None:
        """Call the kernel."""

    @abstractmethod
    def read(self) -> dict[Key, Tile]:
        """The tiles in which something was observed; the window is of no use afterwards."""

    @property
    def bound(self) -> int:
        """No value of `read` is larger, either way."""
        return self.observations * self.tables.largest

    @property
    def corner(self) -> Int64:
        """(2,) x and y of the lower-left corner (lattice units)."""
        return np.array([self.box.col * UNITS_PER_CELL, self.box.row * UNITS_PER_CELL], np.int64)

    def name_tiles(self, places: Int64, tiles: Int32 | Int64) -> dict[Key, Tile]:
        """Tiles (N, 2, TILE, TILE) by the keys of their places (N, 2) in the window."""
        keys = places + np.array(self.box.shrink(TILE)[:2])
        return {(row, col): tile for (row, col), tile in zip(keys.tolist(), tiles, strict=True)}

    def make_profile(self) -> Profile:
        """The tables as kernels take them."""
        tables = self.tables
        depth = tables.depth * self.spec.lattice.units_per_metre
        return Profile(depth, tables.free, tables.hit, tables.plain)


class DenseWindow(Window):
    """A window that has a place for each cell, and one for what changes from cell to cell."""

    def allocate(self, rows: int, cols: int) -> None:
        self.cells = np.zeros((rows, cols + PAD), np.int64)
        self.changes = Changes(
            row_runs=np.zeros(rows * (cols + PAD), np.int32),
            row_steps=np.zeros(0, np.int32),
            col_runs=np.zeros(0, np.int32),
            col_steps=np.zeros(0, np.int32),
        )

    @property
    def packing(self) -> Packing:
        """How `cells` hold the numbers of a cell."""
        return Packing(self.tables.bits, ALL_BITS, int(self.tables.free[0]))

    def read(self) -> dict[Key, Tile]:
        if self.touched is None:
            return {}
        box, touched = self.box.shrink(TILE), self.touched.shrink(TILE)
        inside = (
            touched.row - box.row,
            touched.col - box.col,
            touched.row_end - box.row,
            touched.col_end - box.col,
        )
        most = touched.cells
        places = np.empty((most, 2), np.int64)
        numbers = np.int32 if self.spec.radial is None else np.int64
        tiles = np.empty((most + 1, 2, TILE, TILE), numbers)  # the last is read into and not kept
        found = read_tiles(self.cells, self.changes, self.packing, inside, places, tiles)
        return self.name_tiles(places[:found], tiles[:found])


class BeamWindow(DenseWindow):
    """Beam by beam, with those drawn between where the update asks for them."""

    def allocate(self, rows: int, cols: int) -> None:
        super().allocate(rows, cols)
        self.changes = self.changes._replace(
            row_steps=np.zeros((rows + 1) * (cols + PAD), np.int32),
            col_runs=np.zeros(cols * (rows + PAD), np.int32),
            col_steps=np.zeros((cols + 1) * (rows + PAD), np.int32),
        )

    def trace(self, projected: Projected) -> None:
        corner = self.corner - projected.beams.anchor
        if self.spec.radial is None:
            hit = int(self.tables.hit[0])
            note_beams(projected.beams, hit, corner, self.cells, self.changes)
            return
        trace_window(projected.beams, self.make_profile(), corner, self.cells, self.changes)


class SparseBeamWindow(Window):
    """Beam by beam where scans are few for the place: cells are visited, in tiles made on demand.

    Only what a beam crosses costs anything.
    """

    most_cells_times = 4

    def allocate(self, rows: int, cols: int) -> None:
        # Hits and misses have a layer each; log-odds share a number with that of observations.
        counts = self.spec.radial is None
        layers = 2 if counts else 1
        size = rows * cols * layers
        numbers = np.zeros(size, np.int32) if counts else np.zeros(size, np.int64)
        table = np.full((rows // TILE, cols // TILE), -1, np.int32)
        self.tiles = Tiles(table, np.zeros(1, np.int64), numbers, layers)

    def trace(self, projected: Projected) -> None:
        profile = self.make_profile()
        if self.spec.radial is None:
            # Hits have a layer of their own: each adds 1, and not the packed 1 << COUNT_BITS.
            profile = profile._replace(hit=profile.free)
        trace_tiles(projected.beams, profile, self.corner - projected.beams.anchor, self.tiles)

    def read(self) -> dict[Key, Tile]:
        table, used = self.tiles.table, int(self.tiles.used[0])
        places = np.empty((used, 2), np.int64)
        places[table[table >= 0]] = np.argwhere(table >= 0)
        tiles = self.tiles.numbers.reshape(-1, self.tiles.layers, TILE, TILE)[:used]
        if self.spec.radial is not None:
            # A beam may reach a tile and add nothing to it.
            seen = np.flatnonzero(tiles.any(axis=(1, 2, 3)))
            places, packed = places[seen], tiles[seen, 0]
            tiles = np.empty((len(seen), 2, TILE, TILE), np.int64)
            np.right_shift(packed, self.tables.bits, out=tiles[:, 0])
            np.bitwise_and(packed, (1 << self.tables.bits) - 1, out=tiles[:, 1])
        return self.name_tiles(places, tiles)


class PolygonWindow(DenseWindow):
    """Hits and misses, scan by scan."""

    @property
    def packing(self) -> Packing:
        return Packing(BORDER_BITS, COUNTED, 1)

    def trace(self, projected: Projected) -> None:
        trace_polygons(
            projected.beams,
            self.spec.jump,
            self.spec.border_gap,
            self.corner - projected.beams.anchor,
            not self.box.contains(projected.box),
            self.cells,
            self.changes.row_runs,
            self.observations,
        )


class RadialPolygonWindow(DenseWindow):
    """A radial model, once for each cell of a scan."""

    def trace(self, projected: Projected) -> None:
        corner, runs = self.corner - projected.beams.anchor, self.changes.row_runs
        trace_radial_polygons(projected.beams, corner, self.make_profile(), self.cells, runs)


CROSSED_OFTEN = 6
"""From so many beams a cell on, changes in a dense window cost less than visits of cells."""


def choose_window(spec: GridSpec, projected: Projected) -> type[Window]:
    """The kind of window that an update and a model need, and these rays."""
    if spec.update is Update.POLYGON and spec.radial is None:
        return PolygonWindow
    if spec.update is Update.POLYGON and projected.beams.rays.kind.shape[1] > 1:
        return RadialPolygonWindow  # a single beam has no neighbour to say how wide it is: a line
    often = projected.crossings >= CROSSED_OFTEN * projected.box.cells
    return BeamWindow if often else SparseBeamWindow
