"""Windows that kernels write to: one for each combination of update and evidence.

A window covers the scans at hand with room to spare, so that it is emptied into the sparse tiles
only when the scans leave it. What its arrays hold is the business of its kernels.
"""

import math
from abc import ABC, abstractmethod

import numpy as np

from occmap.grid.kernels.beams import Canvas, Changes, Tiles, read_tiles, trace_beams
from occmap.grid.kernels.polygon import BORDER_BITS, COUNTED, MOST_SCANS, trace_polygons
from occmap.grid.kernels.projection import Beams, prepare, project
from occmap.grid.kernels.radial_polygon import trace_radial_polygons
from occmap.grid.kernels.units import AT_A_TIME, CELL_SHIFT, PAD, TILE, UNITS_PER_CELL
from occmap.grid.lattice import CellBox
from occmap.grid.tiles import GridSpec, Key, Tile, view_tiles
from occmap.types import Bool, Int64, Kind, Rays, Update


def count_observations(rays: Rays, spec: GridSpec) -> tuple[int, int]:
    """How much rays may add to the observations of one cell, and how many it has room for."""
    if spec.update is Update.POLYGON and spec.radial is None:
        return len(rays.kind), MOST_SCANS
    return rays.kind.size * spec.unit, (1 << spec.tables.bits) - 1


class Window(ABC):
    """A box of whole tiles being written to."""

    most_cells_times = 1
    """Such a window may have so many times the cells of others"""

    def __init__(self, spec: GridSpec, box: CellBox) -> None:
        self.spec, self.box = spec, box.align(TILE)
        self.touched: CellBox | None = None
        self.observations = 0
        self.allocate(*self.box.shape)

    @abstractmethod
    def allocate(self, rows: int, cols: int) -> None:
        """Make empty arrays."""

    def has_room(self, beams: Beams) -> bool:
        """Whether rays lie wholly in the box and cannot make a number overflow."""
        more, most = count_observations(beams.rays, self.spec)
        return self.box.contains(beams.box) and self.observations + more <= most

    def observe(self, beams: Beams) -> None:
        """Observe what lies in the box."""
        corner = np.array([self.box.col, self.box.row]) * UNITS_PER_CELL - beams.anchor
        self.trace(beams, corner)
        self.observations += count_observations(beams.rays, self.spec)[0]
        touched = self.box.clip(beams.box).align(TILE)
        self.touched = touched if self.touched is None else self.touched.join(touched)

    @abstractmethod
    def trace(self, beams: Beams, corner: Int64) -> None:
        """Call the kernel; `corner` (2,) is x and y of the lower-left (units from the anchor)."""

    @abstractmethod
    def read(self) -> dict[Key, Tile]:
        """The tiles in which something was observed; the window is of no use afterwards."""


class DenseWindow(Window):
    """A window that has a place for each cell, and one for what changes from cell to cell."""

    along_lines = False
    """Whether cells change along lines, or along rows alone"""

    def allocate(self, rows: int, cols: int) -> None:
        across, up = cols + PAD, rows + PAD
        sizes = (rows + 1) * across, cols * up, (cols + 1) * up
        more = (np.zeros(size if self.along_lines else 0, np.int32) for size in sizes)
        self.cells = np.zeros((rows, across), np.int64)
        self.changes = Changes(np.zeros(rows * across, np.int32), *more)

    @property
    def packing(self) -> tuple[int, int, int]:
        """How `cells` hold the numbers of a cell, as `read_tiles` takes it."""
        every_bit = -1
        return self.spec.tables.bits, every_bit, int(self.spec.tables.entries[0])

    def read(self) -> dict[Key, Tile]:
        inside = (self.touched or self.box).move(-self.box.row, -self.box.col).shrink(TILE)
        places = np.empty((inside.cells, 2), np.int64)
        numbers = np.int32 if self.spec.radial is None else np.int64
        # The last tile is read into and not kept.
        tiles = np.empty((inside.cells + 1, 2, TILE, TILE), numbers)
        found = read_tiles(self.cells, self.changes, self.packing, inside, places, tiles)
        return view_tiles(places[:found] + self.box.shrink(TILE)[:2], tiles[:found])


class BeamWindow(DenseWindow):
    """Beam by beam, with those drawn between where the update asks for them."""

    along_lines = True

    def trace(self, beams: Beams, corner: Int64) -> None:
        stride, numbers = self.cells.shape[1], self.cells.reshape(-1)
        canvas = Canvas(self.box.shape, stride, numbers, self.changes)
        trace_beams(beams, self.spec.radial, corner, canvas, None)


class PolygonWindow(DenseWindow):
    """Hits and misses, scan by scan."""

    @property
    def packing(self) -> tuple[int, int, int]:
        return BORDER_BITS, COUNTED, 1

    def trace(self, beams: Beams, corner: Int64) -> None:
        trace_polygons(
            beams,
            self.spec.jump,
            self.spec.border_gap,
            corner,
            not self.box.contains(beams.box),
            self.cells,
            self.changes.row_runs,
            self.observations,
        )


class RadialPolygonWindow(DenseWindow):
    """A radial model, once for each cell of a scan."""

    def trace(self, beams: Beams, corner: Int64) -> None:
        runs = self.changes.row_runs
        trace_radial_polygons(beams, corner, self.spec.tables, self.cells, runs)


class SparseBeamWindow(Window):
    """Beam by beam where scans are few for the place: cells are visited, in tiles made on demand.

    Only what a beam crosses costs anything.
    """

    most_cells_times = 4

    def allocate(self, rows: int, cols: int) -> None:
        # Hits and misses have a layer each; log-odds share a number with that of observations.
        counts, size = self.spec.radial is None, rows * cols
        layers = 2 if counts else 1
        numbers = np.zeros(2 * size, np.int32) if counts else np.zeros(size, np.int64)
        table = np.full((rows // TILE, cols // TILE), -1, np.int32)
        places = np.empty(TILE + AT_A_TIME, np.int64)
        self.tiles = Tiles(table, np.zeros(1, np.int64), layers, places)
        stride = 1 << (cols - 1).bit_length()
        no_changes = Changes(*[np.zeros(0, np.int32)] * 4)
        self.canvas = Canvas((rows, cols), stride, numbers, no_changes)

    def trace(self, beams: Beams, corner: Int64) -> None:
        trace_beams(beams, self.spec.radial, corner, self.canvas, self.tiles)

    def read(self) -> dict[Key, Tile]:
        table, used = self.tiles.table, int(self.tiles.used[0])
        places = np.empty((used, 2), np.int64)
        places[table[table >= 0]] = np.argwhere(table >= 0)
        tiles: Tile = self.canvas.numbers.reshape(-1, self.tiles.layers, TILE, TILE)[:used]
        if self.spec.radial is not None:
            # A beam may reach a tile and add nothing to it.
            seen, bits = tiles.any(axis=(1, 2, 3)), self.spec.tables.bits
            places, tiles = places[seen], np.repeat(tiles[seen], 2, axis=1)
            tiles[:, 0] >>= bits
            tiles[:, 1] &= (1 << bits) - 1
        return view_tiles(places + self.box.shrink(TILE)[:2], tiles)


CROSSED_OFTEN = 6
"""From so many beams a cell on, changes in a dense window cost less than visits of cells. About how
many there are is seen from every eighth beam of every eighth scan."""


def choose_windows(spec: GridSpec, beams: Beams) -> tuple[type[Window], ...]:
    """The kinds of window that serve for an update, a model and these rays, the best one first."""
    if spec.update is Update.POLYGON and spec.radial is None:
        return (PolygonWindow,)
    # A single beam has no neighbour to say how wide it is: it is a line.
    if spec.update is Update.POLYGON and beams.rays.kind.shape[1] > 1:
        return (RadialPolygonWindow,)
    some = slice(None, None, 8), slice(None, None, 8)
    across = np.abs(beams.ends_x[some] - beams.origins[*some, 0])
    up = np.abs(beams.ends_y[some] - beams.origins[*some, 1])
    cells = (np.maximum(across, up) >> CELL_SHIFT) * (beams.rays.kind[some] != Kind.SKIP)
    often = cells.mean() * beams.ends_x.size >= CROSSED_OFTEN * beams.box.cells
    # Few scans cost less in a window that is there already than one of their own does.
    return (BeamWindow,) if often else (SparseBeamWindow, BeamWindow)


def look_at_cell(rays: Rays, spec: GridSpec, row: int, col: int) -> Int64:
    """(S, 2) the two numbers that each scan adds to a cell.

    Raises
    ------
    MapError
        As `prepare`.
    """
    seen, box = np.zeros((len(rays.kind), 2), np.int64), CellBox.at(row, col)
    if not rays.kind.size:
        return seen
    rays = prepare(rays, spec)
    for scan in np.flatnonzero(find_near(rays, spec, box)):
        beams = project(rays.take(slice(scan, scan + 1)), spec)
        window = choose_windows(spec, beams)[0](spec, box)
        window.observe(beams)
        for tile in window.read().values():  # the window is a single tile
            seen[scan] = tile[:, row % TILE, col % TILE]
    return seen


def find_near(rays: Rays, spec: GridSpec, box: CellBox) -> Bool:
    """(S,): the scans that may touch a cell; all others do not.

    All that a scan touches lies in a circle about its first viewpoint: the ends of its beams, the
    lines between these, and, to a cell's diagonal, the cells that they are in.
    """
    resolution, start = spec.lattice.resolution, rays.origin[:, 0]
    away = np.hypot(*(start - (np.array([box.col, box.row]) + 0.5) * resolution).T)
    spread = np.hypot(*np.moveaxis(rays.origin - start[:, None], -1, 0)).max(axis=1)
    reach = rays.distance.max(axis=1) + spread + spec.tables.depth
    return np.asarray(away <= reach + 2 * math.sqrt(2) * resolution)
