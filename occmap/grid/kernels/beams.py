"""The beam and the surface update: every beam adds evidence to each cell along its line.

A beam is a line from the sensor's cell to its end (Bresenham 1965). A cell at distance d on a beam
of range r gets what the inverse sensor model says of d and r, and log-odds are summed (Thrun,
Burgard, Fox 2005, ch. 9). A model says the same about all cells up to some share of the range, and
a model that counts does so up to the end: these cells are plain.

Cells that are not plain are visited one by one, and so are all of them in tiles. What each cell
gets is first listed, and then added in a loop of its own. Neither loop has a branch, so that a
processor works on several cells at a time: along a beam, log-odds depend on nothing but the number
of the cell. The lists hold floats, as not every processor turns several of these into integers at a
time.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.lines import (
    Beam,
    Line,
    Path,
    draw_path,
    find_step,
    note_line,
    place_beam,
    steps_after,
)
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.units import (
    AT_A_TIME,
    BEAM_WEIGHT,
    CELL_SHIFT,
    COUNT_BITS,
    FIRST_HIT,
    HALF_CELL,
    MANY,
    NO_LENGTH,
    NOTHING,
    PAD,
    SKIP,
    TABLE_STEPS,
    TILE,
    TILE_BITS,
    UNITS_PER_CELL,
    Tables,
)
from occmap.jit import kernel, step
from occmap.types import Float64, Int32, Int64


class Changes(NamedTuple):
    """How often cells were plain: changes along a window's rows, and of steep lines along columns.

    All are flat; those of columns are empty where a kernel writes to rows alone.
    """

    row_runs: Int32
    """H x (W + PAD)"""
    row_steps: Int32
    """(H + 1) x (W + PAD)"""
    col_runs: Int32
    """W x (H + PAD)"""
    col_steps: Int32
    """(W + 1) x (H + PAD)"""


@kernel
def read_tiles(
    cells: Int64,
    changes: Changes,
    packing: tuple[int, int, int],
    touched: tuple[int, int, int, int],
    keys: Int64,
    tiles: Int32 | Int64,
) -> int:
    """Write the tiles in which something was observed, and return how many these are.

    Parameters
    ----------
    cells
        (H, W + PAD) of whole tiles: packed sums of what visited cells got.
    packing
        How a cell's integer holds both of its numbers: how many of the lowest bits hold the second,
        with the first above them; the mask of bits that are evidence and no notes of a kernel; and
        what a plain cell gets each time.
    touched
        First row and column of tiles, and those after the last: nothing was written elsewhere.
    keys, tiles
        (N, 2) row and column of each tile in the window, and (N, 2, TILE, TILE), written here.
    """
    (bits, kept, entry), low = packing, (1 << packing[0]) - 1
    across, up = cells.shape[1], cells.shape[0] + PAD
    row_counts, col_counts = np.zeros(TILE, np.int32), np.zeros(across, np.int32)
    plain, runs, steps = np.empty((TILE, TILE), np.int32), changes.row_runs, changes.row_steps
    size = 0
    for tile_row in range(touched[0], touched[2]):
        row_counts[:] = 0
        for tile_col in range(touched[1], touched[3]):
            row, col, tile = tile_row * TILE, tile_col * TILE, tiles[size]
            plain[:] = 0
            sum_changes(runs, steps, row * across + col, across, row_counts, plain)
            if changes.col_runs.size:
                below = col_counts[col : col + TILE]
                sum_changes(changes.col_runs, changes.col_steps, col * up + row, up, below, plain.T)
            seen = 0
            for r in range(TILE):
                # Slices: numba cannot know that `col + c` is never negative.
                visited, first, second = cells[row + r, col : col + TILE], tile[0, r], tile[1, r]
                for c in range(TILE):
                    packed = (visited[c] & kept) + plain[r, c] * entry
                    first[c] = packed >> bits
                    second[c] = packed & low
                    seen |= packed
            if seen:
                keys[size, 0], keys[size, 1] = tile_row, tile_col
                size += 1
    return size


@kernel
def sum_changes(
    runs: Int32, steps: Int32, place: int, stride: int, counts: Int32, plain: Int32
) -> None:
    """Add how often each cell of a tile was plain, by the changes along rows, or along columns.

    The tile begins at `place`, and its next row `stride` further on; `counts` (TILE,) go on from
    the tile before it.
    """
    line = np.empty(TILE, np.int32)
    for r in range(TILE):
        here = place + r * stride
        begun, stepped = runs[here : here + TILE], steps[here : here + TILE]
        above = steps[here + stride : here + stride + TILE]
        for c in range(TILE):  # a loop of its own: many changes are added up at a time
            line[c] = begun[c] + (stepped[c] - above[c] if steps.size else 0)
        count = counts[r]
        for c in range(TILE):
            count += line[c]
            plain[r, c] += count
        counts[r] = count


ENTRY_BITS = 13
"""Bits of the place of an entry in both tables of a model together."""
WEIGHT_BITS = BEAM_WEIGHT.bit_length()
NOTE_BITS = ENTRY_BITS + WEIGHT_BITS
"""A note says what a cell gets: its place above these bits, below it the weight, and in the lowest
bits the entry. Of the 53 bits of a float, 36 are left for the place, of which there are 2^28."""
INSIDE = TILE - 1
"""Mask of the row or column inside a tile."""


class Tiles(NamedTuple):
    """Where square blocks of a window's cells are kept, made when a beam first comes there."""

    table: Int32
    """(h, w) place of each tile among the numbers, in tiles; -1 where there is none yet"""
    used: Int64
    """(1,) how many tiles there are"""
    layers: int
    """Layers of cells of each tile: 2 where plain cells have one of their own, the last"""
    places: Int64
    """(TILE + AT_A_TIME,) places of the cells of a line in one tile, written anew for each"""


class Canvas(NamedTuple):
    """The cells of a window that beams are traced in."""

    shape: tuple[int, int]
    """Rows and columns"""
    stride: int
    """From row to row of the places in notes: a power of 2 where there are tiles"""
    numbers: Int32 | Int64
    """Flat: what visited cells got. That is `stride` for each row; or tile by tile, one layer of
    cells after the other"""
    changes: Changes
    """How often cells were plain; empty where there are tiles, and all cells are visited"""


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


@kernel
def make_notes(shape: tuple[int, int]) -> Float64:
    """Room for notes, in which a line of a window always fits."""
    return np.empty(MANY + max(shape[0], shape[1]) + AT_A_TIME)


@step
def list_slope(path: Path, beam: Beam, stride: int, notes: Float64, fill: int) -> int:
    """List what a radial model says of the cells of a path that are not plain.

    Parameters
    ----------
    stride
        From row to row of the places in the notes.
    notes
        Written here from `fill` on; there is room.

    Returns
    -------
    How many notes there are now.
    """
    line, r, depth = path.line, path.range, beam.depth
    free_range = max(r - depth, 0.0)
    free_scale = TABLE_STEPS / max(free_range * free_range, 1.0)
    hit_scale = TABLE_STEPS / max(depth, NO_LENGTH)
    reach = depth if beam.is_hit else -1.0
    at_u, at_v = turn_axes(line, beam.at_x, beam.at_y)
    from_u = float((line.u << CELL_SHIFT) + HALF_CELL - at_u)
    from_v = float((line.v << CELL_SHIFT) + HALF_CELL - at_v)
    step_u, step_v = float(line.u_sign * UNITS_PER_CELL), float(line.v_sign * UNITS_PER_CELL)
    # A cell's note is the first cell's, and for each step along u or v as much more.
    per_u, per_v = turn_axes(line, 1, stride)
    place = line.u * per_u + line.v * per_v
    note = float(((place << WEIGHT_BITS) + path.weight) << ENTRY_BITS)
    note_u, note_v = (
        float(line.u_sign * per_u << NOTE_BITS),
        float(line.v_sign * per_v << NOTE_BITS),
    )
    for j in range((path.end - path.plain + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
        i = float(np.int32(path.plain + j))
        made = steps_after(line, i)
        u, v = from_u + step_u * i, from_v + step_v * made
        squared = u * u + v * v
        off = abs(np.sqrt(squared) - r)
        as_hit = float(FIRST_HIT) + np.floor(off * hit_scale) if off <= reach else float(NOTHING)
        is_free = squared < free_range * free_range
        entry = np.floor(squared * free_scale) if is_free else as_hit
        notes[np.uint64(fill + j)] = note + note_u * i + note_v * made + entry
    return fill + path.end - path.plain


@step
def turn_axes(line: Line, x: int, y: int) -> tuple[int, int]:
    """Take what belongs to x and y, columns and rows, to a line's own axes u and v."""
    return (y, x) if line.steep else (x, y)


@kernel
def add_notes(
    notes: Float64, size: int, radial: Tables, canvas: Canvas, tiles: Tiles | None
) -> None:
    """Add to the cells of a window what the notes say."""
    numbers, entries = canvas.numbers, radial.entries
    col_bits = int(np.log2(canvas.stride))
    for k in range(size):
        note = int(notes[k])
        place = note >> NOTE_BITS
        if tiles is not None:
            row, col = place >> col_bits, place & (canvas.stride - 1)
            place = find_place(tiles, row, col)
        weight = (note >> ENTRY_BITS) & ((1 << WEIGHT_BITS) - 1)
        entry = entries[np.uint64(note & ((1 << ENTRY_BITS) - 1))]
        numbers[np.uint64(place)] += weight * entry


@step
def find_place(tiles: Tiles, row: int, col: int) -> int:
    """Find the place of a cell, in the first layer of its tile, which is made if need be."""
    up, right = np.uint64(row >> TILE_BITS), np.uint64(col >> TILE_BITS)
    tile = int(tiles.table[up, right])
    if tile < 0:
        tile = int(tiles.used[0])
        tiles.table[up, right] = tile
        tiles.used[0] += 1
    return tile * tiles.layers * TILE**2 + ((row & INSIDE) << TILE_BITS) + (col & INSIDE)


@step
def visit_path(path: Path, radial: Tables | None, numbers: Int32 | Int64, tiles: Tiles) -> None:
    """Add to the plain cells of a path, in the last layer, and where hits are counted to its end.

    The line is followed from tile to tile. In each, the places of its cells are worked out many at
    a time, in a loop of their own.
    """
    line, places, last_layer = path.line, tiles.places, (tiles.layers - 1) * TILE**2
    if radial is None:
        added, end = path.weight, path.end
    else:
        added, end = path.weight * int(radial.entries[0]), path.plain
    along, across = line.u_sign, line.v_sign * TILE
    if line.steep:
        along, across = line.u_sign * TILE, line.v_sign
    i = path.first
    while i < end:
        made = int(steps_after(line, float(i)))
        u, v = line.u + line.u_sign * i, line.v + line.v_sign * made
        row, col = (u, v) if line.steep else (v, u)
        place = find_place(tiles, row, col) + last_layer
        # How many cells, and how many steps, until the line leaves the tile.
        left_u = TILE - (u & INSIDE) if line.u_sign > 0 else (u & INSIDE) + 1
        left_v = TILE - (v & INSIDE) if line.v_sign > 0 else (v & INSIDE) + 1
        stop = min(i + left_u, find_step(line, made + left_v), end)
        for j in range((stop - i + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
            steps = int(np.int32(steps_after(line, float(np.int32(i + j))))) - made
            places[np.uint64(j)] = place + j * along + steps * across
        for j in range(min(stop, path.plain) - i):
            numbers[np.uint64(places[np.uint64(j)])] += added
        if stop > path.plain:  # the hit, in the first layer
            numbers[np.uint64(places[np.uint64(path.plain - i)] - last_layer)] += path.weight
        i = stop
