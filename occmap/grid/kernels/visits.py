"""Cells that are visited one by one: those that are not plain, and all of them in tiles.

What each cell gets is first listed, and then added in a loop of its own. Neither loop has a branch,
so that a processor works on several cells at a time: along a beam, log-odds depend on nothing but
the number of the cell. The lists hold floats, as not every processor turns several of these into
integers at a time.
"""

from typing import NamedTuple

import numpy as np

from occmap.arrays import Float64, Int32, Int64
from occmap.grid.kernels.beams import Lines, list_lines, make_lines, note_lines
from occmap.grid.kernels.lines import count_steps, draw_line
from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.sums import Changes
from occmap.grid.kernels.units import (
    AT_A_TIME,
    BEAM_WEIGHT,
    CELL_SHIFT,
    HALF_CELL,
    NO_LENGTH,
    PAD,
    TILE,
    TILE_BITS,
    UNITS_PER_CELL,
    Tables,
)
from occmap.jit import kernel

ENTRY_BITS = 13
"""Bits of the place of an entry in both tables of a model together."""
WEIGHT_BITS = BEAM_WEIGHT.bit_length()
NOTE_BITS = ENTRY_BITS + WEIGHT_BITS
"""A note says what a cell gets: its place above these bits, below it the weight, and in the lowest
bits the entry. A window has less than 2^28 places, so that a float holds all of them."""
INSIDE = TILE - 1
"""Mask of the row or column inside a tile."""
SLOPE_BITS = 50
"""Bits of the fraction of a line's place along v. The bits above count whole steps: tiles lie in a
window of at most 2^26 cells, where a line has less than 2^13."""


class Tiles(NamedTuple):
    """Square blocks of a window's cells, made when a beam first comes there."""

    table: Int32
    """(h, w) place of each tile among `numbers`, in tiles; -1 where there is none yet"""
    used: Int64
    """(1,) how many tiles there are"""
    numbers: Int32 | Int64
    """(N,) one layer of cells after the other, tile by tile"""
    layers: int
    """Layers of each tile: 2 where plain cells have one of their own, the last"""


@kernel
def trace_window(
    beams: Beams, tables: Tables, corner: Int64, cells: Int64, changes: Changes
) -> None:
    """Add to the cells of a window what a radial model says of every beam.

    Parameters
    ----------
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    cells
        (H, W + PAD) sums of what visited cells got; all others go to `changes`.
    """
    rows, cols, numbers = cells.shape[0], cells.shape[1] - PAD, cells.ravel()
    depth = tables.depth * beams.units_per_metre
    lines, notes, entries = make_room(beams, tables, rows, cols)
    for s in range(len(beams.rays.kind)):
        size = list_lines(beams, s, tables, corner, rows, cols, lines)
        note_lines(lines, size, rows, cols, changes)
        k = 0
        while k < size:
            k, fill = list_slopes(lines, k, size, tables, depth, cols + PAD, notes)
            add_to_window(notes[:fill], entries, numbers)


@kernel
def trace_tiles(beams: Beams, tables: Tables, corner: Int64, tiles: Tiles) -> None:
    """Add to the cells of tiles what a model says of every beam; parameters as `trace_window`."""
    rows, cols = tiles.table.shape[0] * TILE, tiles.table.shape[1] * TILE
    col_bits, counts = int(np.ceil(np.log2(cols))), tables.hit.size == 1
    depth = tables.depth * beams.units_per_metre
    lines, notes, entries = make_room(beams, tables, rows, cols)
    for s in range(len(beams.rays.kind)):
        size = list_lines(beams, s, tables, corner, rows, cols, lines)
        visit_lines(lines, size, tables.free[0], counts, tiles)
        k = size if counts else 0
        while k < size:
            k, fill = list_slopes(lines, k, size, tables, depth, 1 << col_bits, notes)
            add_to_tiles(notes[:fill], entries, col_bits, tiles)


@kernel
def make_room(beams: Beams, tables: Tables, rows: int, cols: int) -> tuple[Lines, Float64, Int64]:
    """Room for the lines of a scan, room for notes, and the entries that notes speak of."""
    lines = make_lines(beams.rays.kind.shape[1])
    notes = np.empty(lines.ranges.size + max(rows, cols) + AT_A_TIME)
    return lines, notes, np.concatenate((tables.free, tables.hit, np.zeros(1, np.int64)))


@kernel
def list_slopes(
    lines: Lines, start: int, size: int, tables: Tables, depth: float, stride: int, notes: Float64
) -> tuple[int, int]:
    """List, in notes, what a radial model adds to the cells of lines that are not plain.

    Parameters
    ----------
    start
        The first line to list.
    depth
        How far about the range a hit reaches (lattice units).
    stride
        From row to row of the places in the notes.
    notes
        Written here, as far as there is room.

    Returns
    -------
    The first line that is not listed, and how many notes there are.
    """
    cells, parts, weights = lines.cells, lines.parts, lines.weights
    steps = float(tables.hit.size - 1)
    hit_scale = steps / max(depth, NO_LENGTH)
    first_hit, nothing = float(tables.free.size), float(tables.free.size + tables.hit.size)
    fill = 0
    for k in range(start, size):
        first, end = parts[k, 1], parts[k, 2]
        if fill + end - first + AT_A_TIME > notes.size:
            return k, fill
        line = draw_line(cells[k, 0], cells[k, 1], cells[k, 2], cells[k, 3])
        r = lines.ranges[k]
        before = max(r - depth, 0.0)
        until = before * before
        scale = steps / max(until, 1.0)
        reach = depth if lines.is_hit[k] else -1.0
        along, across = line.u_sign, line.v_sign * stride
        sensor_u, sensor_v = lines.sensors[k, 0], lines.sensors[k, 1]
        if line.steep:
            along, across = line.u_sign * stride, line.v_sign
            sensor_u, sensor_v = sensor_v, sensor_u
        from_u = float((line.u << CELL_SHIFT) + HALF_CELL - sensor_u)
        from_v = float((line.v << CELL_SHIFT) + HALF_CELL - sensor_v)
        step_u, step_v = float(line.u_sign * UNITS_PER_CELL), float(line.v_sign * UNITS_PER_CELL)
        place = cells[k, 1] * stride + cells[k, 0]
        note = float(((place << WEIGHT_BITS) + weights[k]) << ENTRY_BITS)
        note_along, note_across = float(along << NOTE_BITS), float(across << NOTE_BITS)
        # Half a unit of 1 / (2 n) keeps floor(made) from what rounding does to a whole number.
        half, twice_m, per_2n = line.n + 0.5, 2.0 * line.m, 0.5 / max(line.n, 1)
        to = np.uint64(fill)
        for j in range((end - first + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
            i = float(np.int32(first + j))
            made = np.floor((i * twice_m + half) * per_2n)
            u, v = from_u + step_u * i, from_v + step_v * made
            squared = u * u + v * v
            off = abs(np.sqrt(squared) - r)
            about = first_hit + np.floor(off * hit_scale)
            about = about if off <= reach else nothing
            entry = np.floor(squared * scale) if squared < until else about
            notes[to + np.uint64(j)] = note + note_along * i + note_across * made + entry
        fill += end - first
    return size, fill


@kernel
def add_to_window(notes: Float64, entries: Int64, numbers: Int64) -> None:
    """Add to the cells of a window what the notes say."""
    for k in range(notes.size):
        note = np.int64(notes[k])
        weight = (note >> ENTRY_BITS) & ((1 << WEIGHT_BITS) - 1)
        entry = entries[np.uint64(note & ((1 << ENTRY_BITS) - 1))]
        numbers[np.uint64(note >> NOTE_BITS)] += weight * entry


@kernel
def add_to_tiles(notes: Float64, entries: Int64, col_bits: int, tiles: Tiles) -> None:
    """Add to the first layer of tiles what the notes say."""
    table, used, numbers = tiles.table, tiles.used, tiles.numbers
    for k in range(notes.size):
        note = np.int64(notes[k])
        weight = (note >> ENTRY_BITS) & ((1 << WEIGHT_BITS) - 1)
        entry = entries[np.uint64(note & ((1 << ENTRY_BITS) - 1))]
        place = note >> NOTE_BITS
        row, col = place >> col_bits, place & ((1 << col_bits) - 1)
        up, right = np.uint64(row >> TILE_BITS), np.uint64(col >> TILE_BITS)
        tile = np.int64(table[up, right])
        if tile < 0:
            tile = table[up, right] = used[0]
            used[0] += 1
        place = tile * tiles.layers * TILE**2 + ((row & INSIDE) << TILE_BITS) + (col & INSIDE)
        numbers[np.uint64(place)] += weight * entry


@kernel
def visit_lines(lines: Lines, size: int, entry: int, ends: bool, tiles: Tiles) -> None:
    """Add an entry to the plain cells of lines, in the last layer, tile by tile.

    With `ends`, it is added to the end cells of HIT beams as well, in the first layer.
    """
    cells, parts, weights = lines.cells, lines.parts, lines.weights
    table, used, numbers = tiles.table, tiles.used, tiles.numbers
    places = np.empty(TILE + AT_A_TIME, np.int64)
    for k in range(size):
        i, plain, end = parts[k, 0], parts[k, 1], parts[k, 2 if ends else 1]
        if i >= end:
            continue
        line = draw_line(cells[k, 0], cells[k, 1], cells[k, 2], cells[k, 3])
        n, m = line.n, line.m
        # q is how far the line has moved along v since cell i, beyond the whole steps before it.
        made = count_steps(line, i)
        per_cell = (1 << SLOPE_BITS) / float(max(n, 1))
        slope = int(m * per_cell)
        q = int((2 * i * m + n - 2 * n * made) * (per_cell / 2)) + 2 * n
        u, from_v = line.u + line.u_sign * i, line.v + line.v_sign * made
        v = from_v
        along, across = line.u_sign, line.v_sign * TILE
        if line.steep:
            along, across = line.u_sign * TILE, line.v_sign
        added = weights[k] * entry
        # The line leaves a tile along u before cell `next_u`, and along v before `next_v`.
        next_u = i + (TILE - (u & INSIDE) if line.u_sign > 0 else (u & INSIDE) + 1)
        step = made + (TILE - (v & INSIDE) if line.v_sign > 0 else (v & INSIDE) + 1)
        per_2m = 0.5 / max(m, 1)
        while i < end:
            # As `find_step` has it: half a unit of 1 / (2 m) keeps it from what rounding does.
            next_v = int((float(n * (2 * step - 1) + 2 * m) - 0.5) * per_2m) if m else end
            stop = min(next_u, next_v, plain if i < plain else end)
            row, col = (u, v) if line.steep else (v, u)
            up, right = np.uint64(row >> TILE_BITS), np.uint64(col >> TILE_BITS)
            tile = np.int64(table[up, right])
            if tile < 0:
                tile = table[up, right] = used[0]
                used[0] += 1
            layer = tile * tiles.layers + (tiles.layers - 1 if i < plain else 0)
            place = layer * TILE**2 + ((row & INSIDE) << TILE_BITS) + (col & INSIDE)
            place -= (q >> SLOPE_BITS) * across
            # Places are worked out many at a time, in a loop of their own.
            for j in range((stop - i + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
                steps = (q + j * slope) >> SLOPE_BITS
                places[np.uint64(j)] = place + j * along + steps * across
            for j in range(stop - i):
                numbers[np.uint64(places[np.uint64(j)])] += added
            q += slope * (stop - i)
            i = stop
            u, v = line.u + line.u_sign * i, from_v + line.v_sign * (q >> SLOPE_BITS)
            next_u += TILE if stop == next_u else 0
            step += TILE if stop == next_v else 0
