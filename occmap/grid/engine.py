"""The grid engine: it takes rays from any number of threads and gives one grid of evidence.

Kernels write to windows, one for each combination of update and evidence. A window covers the
scans at hand with room to spare, so that it is emptied into the sparse tiles only when the scans
leave it. What its arrays hold is the business of its kernels.

Where slices of time are kept, a window is emptied when its slice is over, too.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Any

import numpy as np

from occmap.cells import CellBox, Key, Slices, Tile, view_tiles
from occmap.errors import MapError
from occmap.grid import MOST_CELLS_OF_BEAM
from occmap.grid.kernels import AT_A_TIME, CELL_SHIFT, MANY, PAD, TILE, UNITS_PER_CELL
from occmap.grid.kernels.beams import Tiles, read_tiles, sum_changes, trace_beams
from occmap.grid.kernels.lines import Changes, Field
from occmap.grid.kernels.polygon import BORDER_BITS, COUNTED, MOST_SCANS, trace_polygons
from occmap.grid.kernels.projection import Beams, prepare, project
from occmap.grid.kernels.radial_polygon import trace_radial_polygons
from occmap.grid.tiles import MAX_CELLS, WINDOW_CELLS, GridSpec, TileGrid, refuse_large, unite
from occmap.types import Bool, Int64, Kind, Rays, Update


def count_observations(rays: Rays, spec: GridSpec) -> tuple[int, int]:
    """How much rays may add to the observations of one cell, and how many it has room for."""
    if spec.update is Update.POLYGON and spec.radial is None:
        return len(rays.kind), MOST_SCANS
    return rays.kind.size * spec.unit, (1 << spec.tables.bits) - 1


class Window(ABC):
    """A box of whole tiles being written to, in a slice of time.

    It has a place for each cell, and one for what changes from cell to cell.
    """

    along_lines = False
    """Whether cells change along lines, or along rows alone"""

    def __init__(self, spec: GridSpec, box: CellBox, number: int = 0) -> None:
        self.spec, self.box, self.number = spec, box.align(TILE), number
        self.touched: CellBox | None = None
        self.observations = 0
        self.allocate(*self.box.shape)

    @property
    def bound(self) -> int:
        """No number that it holds of a cell is larger than this, either way."""
        return self.observations * self.spec.tables.largest

    def allocate(self, rows: int, cols: int) -> None:
        """Make empty arrays."""
        across, up = cols + PAD, rows + PAD
        size = rows * across
        if self.along_lines:
            size += (rows + 1) * across + (2 * cols + 1) * up
        self.cells: Int64 = np.zeros((rows, across), np.int64)
        self.changes = Changes(np.zeros(size, np.int32), rows, cols)

    def has_room(self, beams: Beams) -> bool:
        """Whether rays lie wholly in the box and cannot make a number overflow."""
        more, most = count_observations(beams.rays, self.spec)
        return self.box.contains(beams.box) and self.observations + more <= most

    def observe(self, beams: Beams) -> None:
        """Observe what lies in the box."""
        corner = np.array([self.box.col, self.box.row]) * UNITS_PER_CELL - beams.anchor
        # Kernels that clip no beam are compiled sooner; what is filled is clipped row by row.
        clipped = True if self.along_lines and not self.box.contains(beams.box) else None
        self.trace(beams, Field(corner, self.cells.reshape(-1), self.changes, clipped))
        self.observations += count_observations(beams.rays, self.spec)[0]
        touched = self.box.clip(beams.box).align(TILE)
        self.touched = touched if self.touched is None else self.touched.join(touched)

    @abstractmethod
    def trace(self, beams: Beams, field: Field) -> None:
        """Call the kernel."""

    @property
    def packing(self) -> tuple[int, int, int]:
        """How `cells` hold the numbers of a cell, as `read_tiles` takes it."""
        every_bit = -1
        return self.spec.tables.bits, every_bit, int(self.spec.tables.entries[0])

    def read(self) -> dict[Key, Tile]:
        """The tiles in which something was observed; the window is of no use afterwards."""
        inside = (self.touched or self.box).move(-self.box.row, -self.box.col)
        (rows, cols), changes = self.box.shape, self.changes.numbers
        across, up = cols + PAD, rows + PAD
        begin = inside.row * across + inside.col
        sum_changes(changes, begin, across, *inside.shape, rows * across * self.along_lines)
        if self.along_lines:
            begin = (2 * rows + 1) * across + inside.col * up + inside.row
            sum_changes(changes, begin, up, *inside.shape[::-1], cols * up)
        places, tiles = self.read_tiles(self.cells, self.changes, inside.shrink(TILE))
        return view_tiles(places + self.box.shrink(TILE)[:2], tiles)

    def read_tiles(self, cells: Int64, changes: Changes, inside: CellBox) -> tuple[Int64, Tile]:
        """Read the tiles of a box, which counts tiles, in which something was observed."""
        places = np.empty((inside.cells, 2), np.int64)
        numbers = np.int32 if self.bound <= np.iinfo(np.int32).max else np.int64
        # The last tile is read into and not kept.
        tiles = np.empty((inside.cells + 1, 2, TILE, TILE), numbers)
        found = read_tiles(cells, changes, self.packing, inside, places, tiles)
        return places[:found], tiles[:found]


class BeamWindow(Window):
    """Beam by beam, with those drawn between where the update asks for them."""

    along_lines = True
    tiles: Tiles | None = None
    """Where cells lie, if not all of them have a place"""

    def trace(self, beams: Beams, field: Field) -> None:
        notes = np.empty(MANY + max(self.box.shape) + AT_A_TIME)  # a line always fits
        trace_beams(beams, self.spec.radial, field, notes, self.tiles)


class SparseBeamWindow(BeamWindow):
    """Beam by beam, where scans are few for the place: all cells of a beam are visited.

    They lie in tiles made on demand, so that only what a beam crosses costs anything.
    """

    tiles: Tiles

    def allocate(self, rows: int, cols: int) -> None:
        table = np.full((rows // TILE, cols // TILE), -1, np.int32)
        self.cells = np.zeros(rows * cols, np.int64)
        self.tiles = Tiles(table, np.zeros(1, np.int64), self.cells.view(np.int32))
        self.changes = Changes(np.zeros(0, np.int32), rows, cols)

    def read(self) -> dict[Key, Tile]:
        table, used, counts = self.tiles.table, int(self.tiles.used[0]), self.tiles.counts
        places = np.empty((used, 2), np.int64)
        places[table[table >= 0]] = np.argwhere(table >= 0) + self.box.shrink(TILE)[:2]
        if self.spec.radial is None:
            return view_tiles(places, counts.reshape(-1, 2, TILE, TILE)[:used])
        # They lie as in a window of one column of tiles. To some of them a beam added nothing.
        cells, rows = self.cells.reshape(-1, TILE), used * TILE
        none = Changes(np.zeros(rows * (TILE + PAD), np.int32), rows, TILE)
        numbers, tiles = self.read_tiles(cells, none, CellBox(0, 0, used, 1))
        return view_tiles(places[numbers[:, 0]], tiles)


class PolygonWindow(Window):
    """Hits and misses, scan by scan."""

    @property
    def packing(self) -> tuple[int, int, int]:
        return BORDER_BITS, COUNTED, 1

    def trace(self, beams: Beams, field: Field) -> None:
        trace_polygons(beams, (self.spec.jump, self.spec.border_gap), field, self.observations)


class RadialPolygonWindow(Window):
    """A radial model, once for each cell of a scan."""

    def trace(self, beams: Beams, field: Field) -> None:
        trace_radial_polygons(beams, self.spec.tables, field)


CROSSED_OFTEN = 6
"""From so many beams a cell on, changes in a dense window cost less than visits of cells. About how
many there are is seen from every eighth beam of every eighth scan."""


def choose_windows(
    spec: GridSpec, beams: Beams, most_cells: int = WINDOW_CELLS
) -> tuple[type[Window], ...]:
    """The kinds of window that serve for an update, a model and these rays, the best one first.

    None of them has more than `most_cells`; rays that need more are traced part by part.
    """
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
    # A model with a radius lists what cells get, and is as quick wherever they are. But hardly any
    # of a place that needs many windows is crossed.
    often |= spec.radial is not None and beams.box.cells <= most_cells
    # Few scans cost less in a window that is there already than one of their own does.
    return (BeamWindow,) if often else (SparseBeamWindow, BeamWindow)


LOOKS = 16
"""So many scans are looked at together until they touch a cell."""


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

    def look(scans: slice | Int64) -> Int64:
        beams = project(rays.take(scans), spec)
        window = choose_windows(spec, beams)[0](spec, box)
        window.observe(beams)
        tiles = window.read().values()  # the window is a single tile
        return sum((tile[:, row % TILE, col % TILE] for tile in tiles), np.zeros(2, np.int64))

    near = np.flatnonzero(find_near(rays, spec, box))
    for at in range(0, len(near), LOOKS):
        some = near[at : at + LOOKS]
        # Most scans near a cell do not touch it, and a look at a few takes no longer than at one.
        for scan in some if look(some).any() else ():
            seen[scan] = look(slice(scan, scan + 1))
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


ROOMY_CELLS = 1 << 22
"""Only the scans at hand make a window larger than this, never the room for scans to come."""
ROOMY_CELLS_OF_SLICE = 1 << 18
"""Windows have hardly more room than a slice takes, since each is made and read for one slice."""
MOST_PARTS = 64
"""A batch that needs more windows than this lies far apart: it is halved until it fits or one scan
is left."""
MARGIN = 4
"""The box around rays is larger than what they observe. A single scan is refused before it is
traced only where its box is this many times too large; otherwise when its tiles are counted."""


class Engine(ABC):
    """Adds up what scans observe, and keeps which slice of time observed what, if asked to.

    Any number of threads may call `add`: each writes to a window of its own, and integers add up to
    the same sum in any order.

    Parameters
    ----------
    grid
        Empty.
    slice_ns
        How long slices of time are; None: none are kept.
    """

    def __init__(self, grid: TileGrid, slice_ns: int | None) -> None:
        self.grid = grid
        self._slice_ns = slice_ns
        self._slices: list[Slices] = []
        self._idle: list[Any] = []
        """What no thread is writing to"""
        self._lock = Lock()

    @abstractmethod
    def add(self, scans: Any) -> None:
        """Observe cells."""

    @abstractmethod
    def _empty(self, window: Any) -> None:
        """Keep what was observed in a window."""

    def _number(self, stamp_ns: Int64) -> Int64:
        """The slices of time (S,) of some stamps."""
        return np.zeros_like(stamp_ns) if self._slice_ns is None else stamp_ns // self._slice_ns

    def _keep(self, tiles: Mapping[Key, Tile], bound: int, number: int) -> None:
        """Add what was observed in a slice of time to the whole; no value is above the bound."""
        seen = [] if self._slice_ns is None else [self.grid.like(tiles).mark_seen(number)]
        with self._lock:
            self.grid.add(tiles, bound)
            self._slices += seen

    @property
    def points(self) -> dict[str, int]:
        """What became of all points so far, by kind; rays have none."""
        return {}

    @property
    def bytes_held(self) -> int:
        """About what is held in memory, without what windows still hold."""
        of_tiles = sum(tile.nbytes for tile in self.grid.tiles.values())
        return of_tiles + sum(slices.nbytes for slices in self._slices)

    def finish(self) -> TileGrid:
        """Empty all windows and give the evidence; more may be added later."""
        while self._idle:
            self._empty(self._idle.pop())
        return self.grid

    def read_slices(self) -> tuple[Slices, ...]:
        """Which cells each slice observed of what `finish` gave; none where none are kept."""
        if self._slice_ns is None:
            return ()
        self._slices = [unite(self._slices)]
        return tuple(self._slices)


class GridEngine(Engine):
    """Adds up what rays observe.

    A single scan that would make a map of much more than `max_cells` is refused before it is
    traced. Nearly always a `Reach` has refused such a map before.
    """

    def __init__(
        self,
        spec: GridSpec,
        window_cells: int = WINDOW_CELLS,
        max_cells: int = MAX_CELLS,
        slice_ns: int | None = None,
    ) -> None:
        super().__init__(TileGrid(spec.lattice, spec.kind, spec.unit), slice_ns)
        self.spec = spec
        self._window_cells = window_cells
        self._max_cells = max_cells
        roomy_cells = ROOMY_CELLS if slice_ns is None else ROOMY_CELLS_OF_SLICE
        self._roomy_cells = min(roomy_cells, window_cells)

    def add(self, rays: Rays) -> None:
        """Observe the cells that these rays cross.

        Raises
        ------
        MapError
            A sensor is too far away or a beam too long for the resolution, or one scan has too
            many beams or makes too large a map.
        """
        if not rays.kind.size:
            return
        if self._slice_ns is None:
            self._add_prepared(prepare(rays, self.spec))
            return
        numbers = self._number(rays.stamp_ns)
        for number in np.unique(numbers):
            self._add_prepared(prepare(rays.take(numbers == number), self.spec))

    def _add_prepared(self, rays: Rays) -> None:
        """Trace rays in one window, else in halves, else a part of the window at a time."""
        scans, beams_of_scan = rays.kind.shape
        observations, most = count_observations(rays, self.spec)
        # Where sensors are so far apart, one anchor cannot serve the ends of all beams.
        apart = float(np.ptp(rays.origin, axis=(0, 1)).max()) / self.spec.lattice.resolution
        if scans > 1 and (observations > most or apart > MOST_CELLS_OF_BEAM / 2):
            self._add_halves(rays)
            return
        if observations > most:
            found = f"a scan of {beams_of_scan} beams is more than this model can count"
            fix = "no laser has so many: see what is in the log with `occmap check`"
            raise MapError(found, fix=fix)
        beams = project(rays, self.spec)
        kinds = choose_windows(self.spec, beams, self._window_cells)
        cells = beams.box.align(TILE).cells
        if cells <= self._window_cells:
            self._trace(beams, kinds)
        elif cells > MOST_PARTS * self._window_cells and scans > 1:
            self._add_halves(rays)
        else:
            self._trace_parts(beams, kinds[0])

    def _add_halves(self, rays: Rays) -> None:
        middle = len(rays.kind) // 2
        self._add_prepared(rays.take(slice(None, middle)))
        self._add_prepared(rays.take(slice(middle, None)))

    def _trace(self, beams: Beams, kinds: Sequence[type[Window]]) -> None:
        """Trace in a window that nobody else is writing to, with room for the scans to come."""
        with self._lock:
            window: Window | None = self._idle.pop() if self._idle else None
        number = int(self._number(beams.rays.stamp_ns[:1])[0])
        fits = window and window.number == number and window.has_room(beams)
        if window and not (fits and type(window) in kinds):
            self._empty(window)
            window = None
        if window is None:
            window = kinds[0](self.spec, add_room(beams.box, self._roomy_cells), number)
        window.observe(beams)
        with self._lock:
            self._idle.append(window)

    def _trace_parts(self, beams: Beams, best: type[Window]) -> None:
        """Trace in windows that lie beside each other, one after the other."""
        if len(beams.rays.kind) == 1 and beams.box.cells > MARGIN * self._max_cells:
            refuse_large(beams.box, self.spec.lattice, self._max_cells)
        side = max(int(self._window_cells**0.5) // TILE, 1) * TILE
        for part in beams.box.align(TILE).cut(side):
            window = best(self.spec, part, int(self._number(beams.rays.stamp_ns)[0]))
            window.observe(beams)
            self._empty(window)

    def _empty(self, window: Window) -> None:
        self._keep(window.read(), window.bound, window.number)


def add_room(box: CellBox, most_cells: int) -> CellBox:
    """Grow a box by half its size on each side, as far as its number of cells, in whole tiles, may.

    It may be that of the box itself.
    """
    box = box.align(TILE)
    limit = max(most_cells, box.cells)
    room = max(box.rows // 2, box.cols // 2, 128)
    while room > 0 and box.grow(room).align(TILE).cells > limit:
        room //= 2
    return box.grow(room)
