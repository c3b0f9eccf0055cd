"""The beam and the surface update: every beam adds evidence to each cell along its line.

A beam is a line from the sensor's cell to its end (Bresenham 1965). A cell at distance d on a beam
of range r gets what the inverse sensor model says of d and r, and log-odds are summed (Thrun,
Burgard, Fox 2005, ch. 9). A model says the same about all cells up to some share of the range, and
a model that counts does so up to the end: these cells are plain.
"""

import numpy as np

from occmap.arrays import Int32, Int64
from occmap.grid.kernels.drawing import Path, draw_path, place_beam
from occmap.grid.kernels.lines import note_line
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.sums import Changes
from occmap.grid.kernels.units import COUNT_BITS, PAD, SKIP, Tables
from occmap.grid.kernels.visits import (
    MANY,
    Canvas,
    Tiles,
    add_notes,
    find_place,
    list_slope,
    make_notes,
    visit_line,
)
from occmap.jit import kernel, step


@kernel
def trace_beams(beams: Beams, radial: Tables | None, corner: Int64, canvas: Canvas) -> None:
    """Add to the cells of a window what a model says of every beam.

    Parameters
    ----------
    radial
        None: hits and misses are counted.
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    """
    kinds, changes, tiles = beams.rays.kind, canvas.changes, canvas.tiles
    shape, stride, numbers = canvas.shape, canvas.stride, canvas.numbers
    notes, fill = make_notes(shape), 0
    for s in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            if kinds[s, b] == SKIP:
                continue
            beam = place_beam(beams, s, b, radial, corner)
            for i in range(beam.drawn + 1):
                path = draw_path(beam, i, radial, shape)
                add_plain(path, radial, shape, numbers, changes, tiles)
                if radial is None:
                    add_hit(path, stride, numbers, tiles)
                else:
                    fill = list_slope(path, beam, stride, notes, fill)
                    if fill >= MANY:
                        add_notes(notes, fill, radial, canvas, canvas.tiles)
                        fill = 0
    if radial is not None:
        add_notes(notes, fill, radial, canvas, canvas.tiles)


@step
def add_plain(
    path: Path,
    radial: Tables | None,
    shape: tuple[int, int],
    numbers: Int32 | Int64,
    changes: Changes,
    tiles: Tiles | None,
) -> None:
    """Add a miss, or what a radial model says of near cells, to the plain cells of a path.

    Where a window is crossed often, these are not visited: `lines` says how they are noted.
    """
    line, first, end = path.line, path.first, path.plain
    if tiles is not None:
        miss = 1
        if radial is not None:
            miss = int(radial.entries[0])
        visit_line(line, first, end, path.weight * miss, numbers, tiles)
    elif first < end:
        if line.steep:
            runs, steps, stride = changes.col_runs, changes.col_steps, shape[0] + PAD
            note_line(line, first, end, runs, steps, stride, path.weight)
        else:
            runs, steps, stride = changes.row_runs, changes.row_steps, shape[1] + PAD
            note_line(line, first, end, runs, steps, stride, path.weight)


@step
def add_hit(path: Path, stride: int, numbers: Int32 | Int64, tiles: Tiles | None) -> None:
    """Add a hit to the end cell of a path, where it is not plain and lies in the window."""
    if path.plain < path.end:
        hit = path.weight if tiles is not None else path.weight << COUNT_BITS
        numbers[np.uint64(find_place(path.end_row, path.end_col, stride, tiles))] += hit
