"""The beam and the surface update: every beam adds evidence to each cell along its line.

A beam is a line from the sensor's cell to its end (Bresenham 1965). A cell at distance d on a beam
of range r gets what the inverse sensor model says of d and r, and log-odds are summed (Thrun,
Burgard, Fox 2005, ch. 9). A model says the same about all cells up to some share of the range, and
a model that counts does so up to the end: these cells are plain.
"""

import numpy as np

from occmap.grid.kernels.drawing import Path, draw_path, place_beam
from occmap.grid.kernels.lines import note_line
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.sums import Changes
from occmap.grid.kernels.units import COUNT_BITS, MANY, PAD, SKIP, Tables
from occmap.grid.kernels.visits import (
    Canvas,
    Tiles,
    add_notes,
    list_slope,
    make_notes,
    visit_path,
)
from occmap.jit import kernel, step
from occmap.types import Int32, Int64


@kernel
def trace_beams(
    beams: Beams, radial: Tables | None, corner: Int64, canvas: Canvas, tiles: Tiles | None
) -> None:
    """Add to the cells of a window what a model says of every beam.

    Parameters
    ----------
    radial
        None: hits and misses are counted.
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    tiles
        None: every cell of the window has a place.
    """
    kinds = beams.rays.kind
    shape, stride, numbers, changes = canvas
    notes, fill = make_notes(shape), 0
    for s in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            if kinds[s, b] == SKIP:
                continue
            beam = place_beam(beams, s, b, radial, corner)
            for i in range(beam.drawn + 1):
                path = draw_path(beam, i, radial, shape)
                if tiles is None:
                    note_plain(path, changes, shape)
                    note_hit(path, radial, stride, numbers)
                else:
                    visit_path(path, radial, numbers, tiles)
                if radial is not None:
                    fill = list_slope(path, beam, stride, notes, fill)
                    if fill >= MANY:
                        add_notes(notes, fill, radial, canvas, tiles)
                        fill = 0
    if radial is not None:
        add_notes(notes, fill, radial, canvas, tiles)


@step
def note_plain(path: Path, changes: Changes, shape: tuple[int, int]) -> None:
    """Add the plain cells of a path, as changes along rows, or of a steep line along columns."""
    line, first, end = path.line, path.first, path.plain
    if first < end:
        if line.steep:
            runs, steps, stride = changes.col_runs, changes.col_steps, shape[0] + PAD
            note_line(line, first, end, runs, steps, stride, path.weight)
        else:
            runs, steps, stride = changes.row_runs, changes.row_steps, shape[1] + PAD
            note_line(line, first, end, runs, steps, stride, path.weight)


@step
def note_hit(path: Path, radial: Tables | None, stride: int, numbers: Int32 | Int64) -> None:
    """Add a hit to the end cell of a path, where hits are counted and it lies in the window."""
    if radial is None and path.plain < path.end:
        place = path.end_row * stride + path.end_col
        numbers[np.uint64(place)] += path.weight << COUNT_BITS
