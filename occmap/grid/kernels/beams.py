"""The beam and the surface update: every beam adds evidence to each cell along its line.

A beam is a line from the sensor's cell to its end (Bresenham 1965). A cell at distance d on a beam
of range r gets what the inverse sensor model says of d and r, and log-odds are summed (Thrun,
Burgard, Fox 2005, ch. 9). A model says the same about all cells up to some share of the range, and
a model that counts does so up to the end: these cells are plain.

Cells that are not plain are visited one by one, and so are all of them in tiles. Where log-odds are
summed, what each of these gets is first listed, and then added in a loop of its own. Neither loop
has a branch, so that a processor works on several cells at a time: along a beam, log-odds depend on
nothing but the number of the cell. The lists hold floats, as not every processor turns several of
these into integers at a time.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid import kernels
from occmap.grid.kernels import lines
from occmap.grid.kernels.lines import Changes, Field, Line, Path, find_step, steps_after
from occmap.grid.kernels.projection import Beams
from occmap.jit import kernel, step
from occmap.types import Float64, Int32, Int64


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
    changes
        Summed up by `sum_changes`.
    packing
        How a cell's integer holds both of its numbers: how many of the lowest bits hold the second,
        with the first above them; the mask of bits that are evidence and no notes of a kernel; and
        what a plain cell gets each time.
    touched
        First row and column of tiles, and those after the last: nothing was written elsewhere.
    keys, tiles
        (N, 2) row and column of each tile in the window, and (N, 2, TILE, TILE), written here.
    """
    bits, kept, entry = packing
    first_row, first_col, last_row, last_col = touched
    across, up = changes.cols + kernels.PAD, changes.rows + kernels.PAD
    in_cols, size = (2 * changes.rows + 1) * across, 0
    has_cols = changes.numbers.size > in_cols
    for tile_row in range(first_row, last_row):
        for tile_col in range(first_col, last_col):
            seen = 0
            for r in range(kernels.TILE):
                row, col = tile_row * kernels.TILE + r, tile_col * kernels.TILE
                for c in range(kernels.TILE):
                    plain = changes.numbers[np.uint64(row * across + col + c)]
                    if has_cols:
                        plain += changes.numbers[np.uint64(in_cols + (col + c) * up + row)]
                    packed = (cells[np.uint64(row), np.uint64(col + c)] & kept) + plain * entry
                    tiles[size, 0, r, c] = packed >> bits
                    tiles[size, 1, r, c] = packed & ((1 << bits) - 1)
                    seen |= packed
            if seen:
                keys[size, 0], keys[size, 1] = tile_row, tile_col
                size += 1
    return size


@kernel
def sum_changes(
    numbers: Int32, begin: int, stride: int, lines: int, length: int, steps: int
) -> None:
    """Turn changes along lines, in place, into how often each cell was plain.

    Parameters
    ----------
    begin, stride
        The place of the first change, and how much farther that of the next line is.
    lines, length
        How many lines, and how many cells of each.
    steps
        How much farther the steps lie; 0 where there are none.
    """
    for i in range(lines):
        place, count = np.uint64(begin + i * stride), np.int32(0)
        for j in range(length):
            here = place + np.uint64(j)
            count += numbers[here]
            if steps:
                step_place = here + np.uint64(steps)
                count += numbers[step_place] - numbers[step_place + np.uint64(stride)]
            numbers[here] = count


ENTRY_BITS = 13
"""Bits of the place of an entry in both tables of a model together."""
WEIGHT_BITS = kernels.BEAM_WEIGHT.bit_length()
NOTE_BITS = ENTRY_BITS + WEIGHT_BITS
"""A note says what a cell gets: its place above these bits, below it the weight, and in the lowest
bits the entry. Of the 53 bits of a float, 36 are left for the place, of which there are 2^28."""
INSIDE = kernels.TILE - 1
"""Mask of the row or column inside a tile."""


class Tiles(NamedTuple):
    """Where square blocks of a window's cells lie, made when a beam first comes there."""

    table: Int32
    """(h, w) number of each tile; -1 where there is none yet"""
    used: Int64
    """(1,) how many tiles there are"""
    counts: Int32
    """Flat, tile by tile: the hits of its cells, and then their misses. In the same memory, a
    window of log-odds has its cells, likewise tile by tile"""


class Ray(NamedTuple):
    """A beam, or one that is drawn between two, in lattice units from the window's corner."""

    at_x: int
    """The sensor"""
    at_y: int
    x: int
    """From where it is traced: the sensor, or a place on the way"""
    y: int
    to_x: int
    to_y: int
    is_hit: bool
    weight: int
    range: float
    """On the map; 0 where no model asks for it, like the next"""
    begun: float
    """How far from the sensor it is traced"""


@kernel
def trace_beams(
    beams: Beams, radial: kernels.Tables | None, field: Field, notes: Float64, tiles: Tiles | None
) -> None:
    """Add to the cells of a window what a model says of every beam.

    Parameters
    ----------
    radial
        None: hits and misses are counted.
    notes
        (`MANY` + the larger of H and W + `AT_A_TIME`,) to work with, where a model has a radius.
    tiles
        Where cells lie; None: every cell of the window has a place.
    """
    kinds, links, depth, fill = beams.rays.kind, beams.links, 0.0, 0
    stride = field.changes.cols + kernels.PAD
    if radial is not None:
        depth = radial.depth * beams.units_per_metre
    for s in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            if kinds[s, b] == kernels.SKIP:
                continue
            ray = place_ray(beams, s, b, field.corner)
            for i in range(1 + (links[1, s, b] if links.size else 0)):
                if i:
                    ray = draw_next(ray, links[2, s, b], links[3, s, b], radial, depth)
                path = lines.clip_path(find_path(ray, radial, depth), field.changes, field.clipped)
                if tiles is None and path.first < path.plain:
                    lines.note_plain(path, field.changes)
                if radial is not None:
                    if tiles is not None:
                        fill = list_in_tiles(path, ray, depth, tiles, notes, fill)
                    else:
                        fill = list_slope(path, ray, depth, (stride, 0), notes, fill)
                    if fill >= kernels.MANY:
                        add_notes(field.cells, notes, fill, radial)
                        fill = 0
                elif tiles is not None:
                    visit_path(path, tiles)
                elif path.plain < path.end:
                    row, col = ray.to_y >> kernels.CELL_SHIFT, ray.to_x >> kernels.CELL_SHIFT
                    field.cells[np.uint64(row * stride + col)] += ray.weight << kernels.COUNT_BITS
    if radial is not None:
        add_notes(field.cells, notes, fill, radial)


@step
def place_ray(beams: Beams, s: int, b: int, corner: Int64) -> Ray:
    """Place a beam of a scan in a window."""
    viewpoint, left, bottom = min(b, beams.origins.shape[1] - 1), corner[0], corner[1]
    x, y = beams.origins[s, viewpoint, 0] - left, beams.origins[s, viewpoint, 1] - bottom
    to_x, to_y = beams.ends_x[s, b] - left, beams.ends_y[s, b] - bottom
    weight = int(beams.links[0, s, b]) if beams.links.size else 1
    measured = beams.ranges[s, b] if beams.ranges.size else 0.0
    return Ray(x, y, x, y, to_x, to_y, beams.rays.kind[s, b] == kernels.HIT, weight, measured, 0.0)


@step
def draw_next(ray: Ray, right: int, up: int, radial: kernels.Tables | None, depth: float) -> Ray:
    """Draw a beam beside another one, whose end lies so far from that one's."""
    x, y, to_x, to_y = ray.at_x, ray.at_y, ray.to_x + right, ray.to_y + up
    begin = lines.begin_between(x, to_x), lines.begin_between(y, to_y)
    length = 0.0 if radial is None else np.hypot(float(to_x - x), float(to_y - y))
    measured, begun = max(length - depth, 0.0), lines.BEGIN_EIGHTHS / 8 * length
    return Ray(x, y, *begin, to_x, to_y, ray.is_hit, int(kernels.BETWEEN), measured, begun)


@step
def find_path(ray: Ray, radial: kernels.Tables | None, depth: float) -> Path:
    """Find the cells of a beam, and which of them are plain."""
    col, row = ray.x >> kernels.CELL_SHIFT, ray.y >> kernels.CELL_SHIFT
    end_col, end_row = ray.to_x >> kernels.CELL_SHIFT, ray.to_y >> kernels.CELL_SHIFT
    line = lines.draw_line(col, row, end_col, end_row)
    plain = line.n + (not ray.is_hit)
    if radial is not None:
        reach = radial.plain * max(ray.range - depth, 0.0) - ray.begun
        reach = reach / kernels.UNITS_PER_CELL - lines.FARTHEST_CENTRE
        plain = lines.count_nearer(line.n, line.m, reach)
    return Path(line, 0, plain, line.n + 1, ray.weight)


@step
def list_slope(
    path: Path, ray: Ray, depth: float, rows: tuple[int, int], notes: Float64, fill: int
) -> int:
    """List what a radial model says of the cells of a path that are not plain.

    A hit reaches `depth` about its range. How far one of the `rows` of cells lies behind the other
    comes first, and then the place at which the window's first row begins, or would begin. The
    notes stand from `fill` on; there is room. Returns how many there are now.
    """
    line, r, reach, (stride, begin) = path.line, ray.range, depth if ray.is_hit else -1.0, rows
    free_range = max(r - depth, 0.0)
    free_scale = kernels.TABLE_STEPS / max(free_range * free_range, 1.0)
    hit_scale = kernels.TABLE_STEPS / max(depth, kernels.NO_LENGTH)
    first_hit, nothing = float(kernels.FIRST_HIT), float(kernels.NOTHING)
    at_u, at_v = turn_axes(line, ray.at_x, ray.at_y)
    from_u = float((line.u << kernels.CELL_SHIFT) + kernels.HALF_CELL - at_u)
    from_v = float((line.v << kernels.CELL_SHIFT) + kernels.HALF_CELL - at_v)
    step_u = float(line.u_sign * kernels.UNITS_PER_CELL)
    step_v = float(line.v_sign * kernels.UNITS_PER_CELL)
    # A cell's note is the first cell's, and for each step along u or v as much more.
    per_u, per_v = turn_axes(line, 1, stride)
    place = line.u * per_u + line.v * per_v + begin
    note = float(((place << WEIGHT_BITS) + path.weight) << ENTRY_BITS)
    note_u = float(line.u_sign * per_u << NOTE_BITS)
    note_v = float(line.v_sign * per_v << NOTE_BITS)
    for j in range(lines.fill_up(path.end - path.plain)):
        i = float(np.int32(path.plain + j))
        made = steps_after(line, i)
        u, v = from_u + step_u * i, from_v + step_v * made
        squared = u * u + v * v
        off = abs(np.sqrt(squared) - r)
        as_hit = first_hit + np.floor(off * hit_scale) if off <= reach else nothing
        is_free = squared < free_range * free_range
        entry = np.floor(squared * free_scale) if is_free else as_hit
        notes[np.uint64(fill + j)] = note + note_u * i + note_v * made + entry
    return fill + path.end - path.plain


@step
def turn_axes(line: Line, x: int, y: int) -> tuple[int, int]:
    """Take what belongs to x and y, columns and rows, to a line's own axes u and v."""
    return (y, x) if line.steep else (x, y)


@step
def add_notes(cells: Int64, notes: Float64, size: int, radial: kernels.Tables) -> None:
    """Add to the cells of a window what the notes say."""
    for k in range(size):
        note = int(notes[k])
        weight = (note >> ENTRY_BITS) & ((1 << WEIGHT_BITS) - 1)
        entry = radial.entries[np.uint64(note & ((1 << ENTRY_BITS) - 1))]
        cells[np.uint64(note >> NOTE_BITS)] += weight * entry


@step
def find_tile(tiles: Tiles, row: int, col: int) -> int:
    """Find the number of the tile of a cell; it is made if need be."""
    up, right = np.uint64(row >> kernels.TILE_BITS), np.uint64(col >> kernels.TILE_BITS)
    tile = int(tiles.table[up, right])
    if tile < 0:
        tile = int(tiles.used[0])
        tiles.table[up, right] = tile
        tiles.used[0] += 1
    return tile


@step
def leave_tile(line: Line, i: int, made: int) -> int:
    """Find the first cell of a line, behind the i-th and so many steps, that is in another tile."""
    u, v = line.u + line.u_sign * i, line.v + line.v_sign * made
    left_u = kernels.TILE - (u & INSIDE) if line.u_sign > 0 else (u & INSIDE) + 1
    left_v = kernels.TILE - (v & INSIDE) if line.v_sign > 0 else (v & INSIDE) + 1
    return min(i + left_u, find_step(line, made + left_v))


@step
def list_in_tiles(
    path: Path, ray: Ray, depth: float, tiles: Tiles, notes: Float64, fill: int
) -> int:
    """List what a radial model says of all cells of a path, which lie in tiles, as `list_slope`."""
    line, i = path.line, path.first
    while i < path.end:
        made = int(steps_after(line, float(i)))
        stop = min(leave_tile(line, i, made), path.end)
        col, row = turn_axes(line, line.u + line.u_sign * i, line.v + line.v_sign * made)
        tile = find_tile(tiles, row, col)
        begin = (tile - (row >> kernels.TILE_BITS)) * kernels.TILE**2 - (col & ~INSIDE)
        piece = Path(line, i, i, stop, path.weight)
        fill = list_slope(piece, ray, depth, (kernels.TILE, begin), notes, fill)
        i = stop
    return fill


@step
def visit_path(path: Path, tiles: Tiles) -> None:
    """Count a miss of each plain cell of a path, and a hit of its end, if that is one.

    The line is followed from tile to tile. Within one, steps are counted in fixed point: they are
    too few by less than 2^-25, and a quarter of 1 / n separates them from the next whole number.
    """
    line, counts = path.line, tiles.counts
    along, across = line.u_sign, line.v_sign * kernels.TILE
    if line.steep:
        along, across = line.u_sign * kernels.TILE, line.v_sign
    per_cell = 1.0 / max(line.n, 1)
    slope, half = line.m * per_cell, 0.5 + 0.25 * per_cell
    i = path.first
    while i < path.end:
        steps = i * slope + half  # rounded down, it is what `steps_after` gives
        made = int(steps)
        col, row = turn_axes(line, line.u + line.u_sign * i, line.v + line.v_sign * made)
        tile = find_tile(tiles, row, col)
        place = (2 * tile + 1) * kernels.TILE**2 + (row & INSIDE) * kernels.TILE + (col & INSIDE)
        stop = min(leave_tile(line, i, made), path.end)
        part, more = int((steps - made) * 2.0**32), int(slope * 2.0**32)
        for _ in range(min(stop, path.plain) - i):
            counts[np.uint64(place + (part >> 32) * across)] += path.weight
            place += along
            part += more
        if stop > path.plain:
            counts[np.uint64(place + (part >> 32) * across - kernels.TILE**2)] += path.weight
        i = stop
