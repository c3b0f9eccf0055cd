"""The grid engine: it takes rays from any number of threads and gives one grid of evidence.

One that keeps slices of time has an ordinary engine for each of them.
"""

from collections.abc import Mapping
from functools import partial
from threading import Lock

import numpy as np

from occmap.cells import Slices
from occmap.errors import MapError
from occmap.grid.kernels.projection import Beams, prepare, project
from occmap.grid.kernels.units import TILE
from occmap.grid.lattice import MOST_CELLS_OF_BEAM, CellBox
from occmap.grid.slices import mark_observed, unite
from occmap.grid.tiles import MAX_CELLS, WINDOW_CELLS, GridSpec, TileGrid, refuse_large
from occmap.grid.windows import Window, choose_windows, count_observations
from occmap.types import Rays

ROOMY_CELLS = 1 << 22
"""Only the scans at hand make a window larger than this, never the room for scans to come."""
ROOMY_CELLS_OF_SLICE = 1 << 18
"""Windows have hardly more room than a slice takes, since each is made and read for one slice."""
MOST_OPEN = 2
"""Slices that wait for more of their scans: batches of several threads share slices."""
MOST_PARTS = 64
"""A batch that needs more windows than this lies far apart: it is halved until it fits or one scan
is left."""
MARGIN = 4
"""The box around rays is larger than what they observe. A single scan is refused before it is
traced only where its box is this many times too large; otherwise when its tiles are counted."""


class GridEngine:
    """Adds up what rays observe.

    Any number of threads may call `add`: each writes to a window of its own, and integers add up to
    the same sum in any order.

    A map of more than `max_cells` is refused as soon as what was observed shows it, and a single
    scan that would make one much larger before it is traced. Nearly always a `Reach` has refused it
    before, in words that do not depend on threads.
    """

    points: Mapping[str, int] = {}
    """What became of points: rays have none"""

    def __init__(
        self,
        spec: GridSpec,
        window_cells: int = WINDOW_CELLS,
        max_cells: int = MAX_CELLS,
        roomy_cells: int = ROOMY_CELLS,
    ) -> None:
        self.spec = spec
        self.grid = TileGrid(spec.lattice, spec.kind, spec.unit)
        self._window_cells = window_cells
        self._max_cells = max_cells
        self._roomy_cells = min(roomy_cells, window_cells)
        self._idle: list[Window] = []
        self._lock = Lock()

    def add(self, rays: Rays) -> None:
        """Observe the cells that these rays cross.

        Raises
        ------
        MapError
            A sensor is too far away or a beam too long for the resolution, or one scan has too
            many beams or makes too large a map.
        """
        if rays.kind.size:
            self._add_prepared(prepare(rays, self.spec))

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
        best, *others = choose_windows(self.spec, beams)
        cells = beams.box.align(TILE).cells
        if cells <= best.most_cells_times * self._window_cells:
            self._trace(beams, best, *others)
        elif cells > MOST_PARTS * self._window_cells and scans > 1:
            self._add_halves(rays)
        else:
            self._trace_parts(beams, best)

    def _add_halves(self, rays: Rays) -> None:
        middle = len(rays.kind) // 2
        self._add_prepared(rays.take(slice(None, middle)))
        self._add_prepared(rays.take(slice(middle, None)))

    def _trace(self, beams: Beams, best: type[Window], *others: type[Window]) -> None:
        """Trace in a window that nobody else is writing to, with room for the scans to come."""
        with self._lock:
            window = self._idle.pop() if self._idle else None
        if window and not (isinstance(window, (best, *others)) and window.has_room(beams)):
            self._empty(window)
            window = None
        if window is None:
            most = best.most_cells_times * self._roomy_cells
            window = best(self.spec, add_room(beams.box, most))
        window.observe(beams)
        with self._lock:
            self._idle.append(window)

    def _trace_parts(self, beams: Beams, best: type[Window]) -> None:
        """Trace in windows that lie beside each other, one after the other."""
        if len(beams.rays.kind) == 1 and beams.box.cells > MARGIN * self._max_cells:
            refuse_large(beams.box, self.spec.lattice, self._max_cells)
        for part in split_box(beams.box, best.most_cells_times * self._window_cells):
            window = best(self.spec, part)
            window.observe(beams)
            self._empty(window)

    def _empty(self, window: Window) -> None:
        tiles = window.read()
        with self._lock:
            self.grid.add(tiles, window.observations * self.spec.tables.largest)
            self.grid.refuse_outgrown(self._max_cells)

    @property
    def bytes_held(self) -> int:
        """About what is held in memory, without scans that windows or open slices still hold."""
        return len(self.grid.tiles) * 2 * TILE * TILE * 4  # nearly all are 32 bits wide

    def finish(self) -> TileGrid:
        """Empty all windows and give the evidence; more may be added later."""
        while self._idle:
            self._empty(self._idle.pop())
        return self.grid

    def read_slices(self) -> tuple[Slices, ...]:
        """No slices of time: this engine keeps none."""
        return ()


class SlicedEngine(GridEngine):
    """Adds up what rays observe, and keeps which slice of time observed what.

    Each thread takes an engine of the slice for itself. When a slice is over, its evidence is added
    to the whole and its bits are kept. If scans of it come later, it is opened anew.
    """

    def __init__(
        self,
        spec: GridSpec,
        slice_ns: int,
        window_cells: int = WINDOW_CELLS,
        max_cells: int = MAX_CELLS,
    ) -> None:
        super().__init__(spec, window_cells, max_cells)
        self._slice_ns = slice_ns
        self._make_engine = partial(GridEngine, spec, window_cells, max_cells, ROOMY_CELLS_OF_SLICE)
        self._slices: list[Slices] = []
        self._open: list[tuple[int, GridEngine]] = []

    def add(self, rays: Rays) -> None:
        """Observe the cells that these rays cross, slice by slice; errors as of `GridEngine`."""
        numbers = rays.stamp_ns // self._slice_ns
        for number in np.unique(numbers).tolist():
            engine = self._take(number)
            engine.add(rays.take(numbers == number))
            with self._lock:
                self._open.append((number, engine))
                over = self._open.pop(0) if len(self._open) > MOST_OPEN else None
            if over:
                self._fold(*over)

    def _take(self, number: int) -> GridEngine:
        """An engine of a slice that no other thread uses."""
        with self._lock:
            for place, (other, engine) in enumerate(self._open):
                if other == number:
                    del self._open[place]
                    return engine
        return self._make_engine()

    def _fold(self, number: int, engine: GridEngine) -> None:
        """Add a slice to the whole."""
        grid = engine.finish()
        observed = mark_observed(grid, number)
        with self._lock:
            self.grid.merge(grid)
            self._slices.append(observed)
            self.grid.refuse_outgrown(self._max_cells)

    @property
    def bytes_held(self) -> int:
        """As of `GridEngine`, and what the slices take."""
        return super().bytes_held + sum(slices.nbytes for slices in self._slices)

    def finish(self) -> TileGrid:
        """Fold all slices and give the evidence; more may be added later."""
        while self._open:
            self._fold(*self._open.pop())
        return self.grid

    def read_slices(self) -> tuple[Slices, ...]:
        """Which cells each slice observed of what `finish` gave."""
        self._slices = [unite(self._slices)]
        return tuple(self._slices)


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


def split_box(box: CellBox, most_cells: int) -> list[CellBox]:
    """Cut a box, grown to whole tiles, into boxes of at most so many cells, or of one tile."""
    box = box.align(TILE)
    side = max(int(most_cells**0.5) // TILE, 1) * TILE
    return [
        CellBox(row, col, min(row + side, box.row_end), min(col + side, box.col_end))
        for row in range(box.row, box.row_end, side)
        for col in range(box.col, box.col_end, side)
    ]
