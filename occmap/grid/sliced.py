"""Evidence that keeps its slices of time: an ordinary grid engine for each of them."""

from functools import partial
from threading import Lock

import numpy as np

from occmap.cells import Slices
from occmap.grid.engine import GridEngine
from occmap.grid.slices import mark_observed, unite
from occmap.grid.spec import WINDOW_CELLS, GridSpec
from occmap.grid.tiles import MAX_CELLS, TileGrid
from occmap.types import Rays

MOST_IDLE = 2
"""Engines that wait for more scans of their slice: batches of several threads share slices."""
ROOMY_CELLS = 1 << 18
"""Windows have hardly more room than a slice takes, since each is made and read for one slice."""


class SlicedEngine:
    """Adds up what rays observe, as a `GridEngine` does, and keeps which slice observed what.

    Any number of threads may call `add`: each takes an engine of the slice for itself. When a slice
    is over, its evidence is added to the whole and its bits are kept. If scans of it come later, it
    is opened anew.
    """

    def __init__(
        self,
        spec: GridSpec,
        slice_ns: int,
        window_cells: int = WINDOW_CELLS,
        max_cells: int = MAX_CELLS,
    ) -> None:
        self._slice_ns = slice_ns
        self._max_cells = max_cells
        self._make_engine = partial(GridEngine, spec, window_cells, max_cells, ROOMY_CELLS)
        self._grid = self._make_engine().grid
        self._slices: list[Slices] = []
        self._idle: list[tuple[int, GridEngine]] = []
        self._lock = Lock()

    def add(self, rays: Rays) -> None:
        """Observe the cells that these rays cross, slice by slice.

        Raises
        ------
        MapError
            As `GridEngine.add`.
        """
        numbers = rays.stamp_ns // self._slice_ns
        for number in np.unique(numbers).tolist():
            engine = self._take(number)
            engine.add(rays.take(numbers == number))
            with self._lock:
                self._idle.append((number, engine))
                over = self._idle.pop(0) if len(self._idle) > MOST_IDLE else None
            if over:
                self._fold(*over)

    def _take(self, number: int) -> GridEngine:
        """An engine of a slice that no other thread uses."""
        with self._lock:
            for place, (other, engine) in enumerate(self._idle):
                if other == number:
                    del self._idle[place]
                    return engine
        return self._make_engine()

    def _fold(self, number: int, engine: GridEngine) -> None:
        """Add a slice to the whole."""
        grid = engine.finish()
        observed = mark_observed(grid, number)
        with self._lock:
            self._grid.merge(grid)
            self._slices.append(observed)
            self._grid.refuse_outgrown(self._max_cells)

    @property
    def bytes_held(self) -> int:
        """What tiles and slices take in memory, without slices that are not over yet."""
        return self._grid.nbytes + sum(slices.nbytes for slices in self._slices)

    def finish(self) -> TileGrid:
        """Fold all slices and give the evidence; more may be added later."""
        while self._idle:
            self._fold(*self._idle.pop())
        return self._grid

    def read_slices(self) -> tuple[Slices, ...]:
        """Which cells each slice observed of what `finish` gave."""
        self._slices = [unite(self._slices)]
        return tuple(self._slices)
