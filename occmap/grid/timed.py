"""The grid engine with a clock: evidence as ever and, beside it, when each cell was observed."""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import cast

import numpy as np

from occmap.grid.engine import WINDOW_CELLS, GridEngine
from occmap.grid.kernels.time_beams import time_beams, time_radial_beams
from occmap.grid.kernels.time_polygons import time_polygons, time_radial_polygons
from occmap.grid.lattice import CellBox
from occmap.grid.projection import Projected
from occmap.grid.spec import GridSpec
from occmap.grid.tiles import MAX_CELLS, TILE
from occmap.grid.times import SliceBits, TimeGrid, cut_bits, encode_stamps
from occmap.grid.windows import (
    CellNumbers,
    Window,
    choose_window,
    describe_surfaces,
    find_corner,
    get_tables,
)
from occmap.types import Int64, Times, Update


class TimedEngine(GridEngine):
    """A grid engine that keeps when cells were observed, at the cost of visiting each."""

    def __init__(
        self,
        spec: GridSpec,
        window_cells: int = WINDOW_CELLS,
        max_cells: int = MAX_CELLS,
    ) -> None:
        super().__init__(spec, window_cells, max_cells)
        self._times = TimeGrid()

    def _open(self, box: CellBox) -> Window:
        return TimedWindow(self.spec, box)

    def _empty(self, window: Window) -> None:
        super()._empty(window)
        timed = cast(TimedWindow, window)  # `_open` makes no others
        with self._lock:
            self._times.add(timed.frame, timed.times, timed.slice_bits)

    def read_times(self) -> tuple[Times, ...]:
        """When each cell was observed of what `finish` gave."""
        return (self._times.read(),)


class TimedWindow(Window):
    """What another window holds, and when its cells were observed.

    Times cover whole tiles; where windows overlap, both say the same.
    """

    def allocate(self, rows: int, cols: int) -> None:
        del rows, cols
        self.counts = choose_window(self.spec)(self.spec, self.box)
        self.frame = align(self.box)
        shape = self.frame.rows, self.frame.cols
        self.times = np.zeros((*shape, 2), np.uint64)
        self.bits = np.zeros((2, shape[0], shape[1] // TILE), np.uint64)
        self.slice_bits: SliceBits = {}
        self._time = choose_timer(self.spec)

    def has_room(self, projected: Projected) -> bool:
        return self.counts.has_room(projected)

    def trace(self, projected: Projected) -> None:
        self.counts.observe(projected)
        for slice_, part in cut_by_slice(projected, self.spec.slice_ns):
            self._time(self, part)
            self._keep_slice(slice_, part.box)

    def _keep_slice(self, slice_: int, box: CellBox) -> None:
        """Take the bits of one slice of time out of the window."""
        touched = align(self.frame.clip(box))
        row, col = touched.row - self.frame.row, (touched.col - self.frame.col) // TILE
        words = self.bits[:, row : row + touched.rows, col : col + touched.cols // TILE]
        for tile, bits in cut_bits(words, touched.row // TILE, touched.col // TILE).items():
            known = self.slice_bits.get((tile, slice_))
            self.slice_bits[tile, slice_] = bits if known is None else known | bits
        words[:] = 0

    def read_from(self, row: int, col: int, shape: tuple[int, int]) -> CellNumbers:
        return self.counts.read_from(row, col, shape)

    @property
    def bound(self) -> int:
        return self.counts.bound

    @property
    def frame_corner(self) -> Int64:
        """(2,) x and y of the lower-left corner of the frame (lattice units)."""
        return find_corner(self.frame)


def align(box: CellBox) -> CellBox:
    """The smallest box of whole tiles around a box."""
    return CellBox(
        box.row // TILE * TILE,
        box.col // TILE * TILE,
        -(-box.row_end // TILE) * TILE,
        -(-box.col_end // TILE) * TILE,
    )


def cut_by_slice(projected: Projected, slice_ns: int) -> Iterator[tuple[int, Projected]]:
    """Runs of scans that were taken in one slice of time."""
    slices = projected.rays.stamp_ns // slice_ns
    starts = [0, *(np.flatnonzero(np.diff(slices)) + 1).tolist(), len(slices)]
    for start, end in pairwise(starts):
        yield int(slices[start]), projected.take(slice(start, end))


def _time_beams(window: TimedWindow, projected: Projected) -> None:
    time_beams(
        projected.origins,
        projected.ends_x,
        projected.ends_y,
        projected.rays.kind,
        encode_stamps(projected.rays.stamp_ns),
        window.frame_corner - projected.anchor,
        window.times,
        *window.bits,
    )


def _time_radial_beams(window: TimedWindow, projected: Projected) -> None:
    rays, scale = projected.rays, window.spec.lattice.units_per_metre
    time_radial_beams(
        projected.origins,
        projected.ends_x,
        projected.ends_y,
        rays.turn,
        rays.bearing,
        rays.distance,
        rays.kind,
        encode_stamps(rays.stamp_ns),
        window.frame_corner - projected.anchor,
        scale,
        get_tables(window.spec).depth * scale,
        window.times,
        window.bits[1],
    )


def _time_polygons(window: TimedWindow, projected: Projected) -> None:
    rays = projected.rays
    time_polygons(
        rays.origin,
        rays.turn,
        rays.bearing,
        rays.distance,
        projected.ends_x,
        projected.ends_y,
        rays.kind,
        encode_stamps(rays.stamp_ns),
        describe_surfaces(window.spec, projected, window.frame),
        window.times,
        *window.bits,
    )


def _time_radial_polygons(window: TimedWindow, projected: Projected) -> None:
    rays, tables = projected.rays, get_tables(window.spec)
    scale = window.spec.lattice.units_per_metre
    time_radial_polygons(
        rays.origin,
        rays.turn,
        rays.bearing,
        rays.distance,
        rays.kind,
        rays.full_circle,
        encode_stamps(rays.stamp_ns),
        window.frame_corner,
        scale,
        tables.depth * scale,
        tables.free.size - 1,
        tables.constant,
        window.times,
        window.bits[1],
    )


def choose_timer(spec: GridSpec) -> Callable[[TimedWindow, Projected], None]:
    """What notes times for an update and a model."""
    if spec.radial is None:
        return _time_beams if spec.update is Update.BEAM else _time_polygons
    return _time_radial_beams if spec.update is Update.BEAM else _time_radial_polygons
