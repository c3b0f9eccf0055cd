"""The beam and the surface update: every beam tells each cell along its line something.

A beam is a line from the sensor's cell to its end. A cell at distance d on a beam of range r is
told what the inverse sensor model says of d and r, and log-odds are summed (Thrun, Burgard, Fox
2005, ch. 9). Two things make it quick. A model says the same about all cells up to some share of
the range, and one that counts does up to the end: these cells are plain. And where a window is
crossed often, plain cells are noted in runs instead of being visited (`lines`).

Where scans are few for the place, cells lie in blocks that are made when a beam first comes there.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.lines import clip_line, count_steps, draw_line, lies_inside, note_line
from occmap.grid.kernels.sums import Changes
from occmap.grid.kernels.units import (
    BETWEEN,
    CELL_SHIFT,
    HALF_CELL,
    HIT,
    PAD,
    SKIP,
    UNITS_PER_CELL,
)
from occmap.jit import kernel, step
from occmap.types import Float64, Int32, Int64, UInt8

SLOPE_BITS = 50
"""Bits of the fraction of a line's place along v; the bits above count whole cells."""
FARTHEST_CENTRE = 1.25
"""Cells by which a cell's centre may be farther from the sensor than its place on the line: half a
diagonal at the first cell, and half a cell beside the line."""
BEGIN_EIGHTHS = 5
"""A beam between two others is drawn from so many eighths of its way on."""


class Beams(NamedTuple):
    """Beams on the lattice, in units from an anchor."""

    origins: Int64
    """(S, K, 2)"""
    ends_x: Int32
    """(S, B); a HIT beam is followed to its range + the model's depth"""
    ends_y: Int32
    """(S, B)"""
    kinds: UInt8
    """(S, B)"""
    ranges: Float64
    """(S, B) on the map; (0, 0) where no model asks"""
    weights: UInt8
    """(S, B) what each beam counts"""
    between: UInt8
    """(S, B) how many beams are drawn between each and the next"""


class Profile(NamedTuple):
    """What a cell is told, tabulated: see `occmap.grid.spec.Tables`."""

    depth: float
    """How far about the range a hit reaches (lattice units)"""
    free: Int64
    """(T + 1,) over (d / (r - depth))^2"""
    hit: Int64
    """(T + 1,) over |d - r| / depth; T = 0 where only the end cell is told of the hit"""
    plain: float
    """Share of r - depth up to which all cells are told `free[0]`"""


class Cells(NamedTuple):
    """The numbers of a window's cells, in square blocks of 2^bits cells a side."""

    rows: int
    cols: int
    bits: int
    """62: the window is one block"""
    stride: int
    """From row to row of a block"""
    plain: int
    """From the number that hits go to, to that of plain cells"""
    size: int
    """Numbers in a block"""
    table: Int32
    """(h, w) place of each block among `numbers`, in blocks; -1 where there is none yet"""
    used: Int64
    """(1,) how many blocks there are"""
    numbers: Int32 | Int64
    """(N,)"""


@step
def begin_between(at: int, to: int) -> int:
    """Find where a beam between two others begins on its way, along x or y (lattice units)."""
    return ((8 - BEGIN_EIGHTHS) * at + BEGIN_EIGHTHS * to) >> 3


@kernel
def note_beams(beams: Beams, hit: int, corner: Int64, cells: Int64, changes: Changes) -> None:
    """Note what every beam says to a model that counts, and those drawn between it and the next.

    It does what `trace_beams` does. As all cells but the end are plain, none of them is visited.

    Parameters
    ----------
    hit
        What the end cell of a HIT beam is told.
    cells
        (H, W + PAD) what cells were told that were visited: the ends.
    """
    origins, ends_x, ends_y, kinds = beams.origins, beams.ends_x, beams.ends_y, beams.kinds
    weights, between = beams.weights, beams.between
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    rows, cols = cells.shape[0], cells.shape[1] - PAD
    scans, count = kinds.shape
    viewpoints = origins.shape[1]
    for s in range(scans):
        for b in range(count):
            if kinds[s, b] == SKIP:
                continue
            k = b if viewpoints > 1 else 0
            at_x, at_y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
            x, y = at_x, at_y
            to_x, to_y = ends_x[s, b] - corner[0], ends_y[s, b] - corner[1]
            weight = np.int64(weights[s, b])
            parts, step_x, step_y = np.int64(between[s, b]) + 1, np.int64(0), np.int64(0)
            for part in range(1, parts + 1):  # the beam itself, then those between it and the next
                col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
                end_col, end_row = to_x >> CELL_SHIFT, to_y >> CELL_SHIFT
                line = draw_line(col, row, end_col, end_row)
                first, end = 0, line.n + 1
                if not lies_inside(col, row, end_col, end_row, rows, cols):
                    first, end = clip_line(line, rows, cols)
                if kinds[s, b] == HIT and end == line.n + 1:
                    end = line.n
                    if first <= end:
                        cells[np.uint64(end_row), np.uint64(end_col)] += weight * hit
                if first < end:
                    if line.steep:
                        note_line(line, first, end, col_runs, col_steps, rows + PAD, int(weight))
                    else:
                        note_line(line, first, end, row_runs, row_steps, cols + PAD, int(weight))
                if part < parts:
                    if part == 1:
                        c = b + 1 if b + 1 < count else 0
                        step_x = np.int64(ends_x[s, c] - ends_x[s, b]) // parts
                        step_y = np.int64(ends_y[s, c] - ends_y[s, b]) // parts
                    to_x, to_y = to_x + step_x, to_y + step_y
                    x, y = begin_between(at_x, to_x), begin_between(at_y, to_y)
                    weight = np.int64(BETWEEN)


@kernel
def trace_beams(
    beams: Beams, profile: Profile, corner: Int64, cells: Cells, changes: Changes
) -> None:
    """Tell all cells what every beam says, and those drawn between it and the next.

    Parameters
    ----------
    corner
        (2,) x and y of the window's corner (lattice units from the anchor).
    changes
        For plain cells; empty arrays where these are visited like the others.
    """
    origins, ends_x, ends_y, kinds = beams.origins, beams.ends_x, beams.ends_y, beams.kinds
    ranges, weights, between = beams.ranges, beams.weights, beams.between
    free, hit, depth = profile.free, profile.hit, profile.depth
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    rows, cols, bits, stride = cells.rows, cells.cols, cells.bits, cells.stride
    table, used, numbers = cells.table, cells.used, cells.numbers
    side = (1 << bits) - 1
    noting, steps = row_runs.size > 0, hit.size - 1
    scans, count = kinds.shape
    viewpoints = origins.shape[1]
    for s in range(scans):
        for b in range(count):
            if kinds[s, b] == SKIP:
                continue
            is_hit = kinds[s, b] == HIT
            k = b if viewpoints > 1 else 0
            at_x, at_y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
            x, y = at_x, at_y
            to_x, to_y = ends_x[s, b] - corner[0], ends_y[s, b] - corner[1]
            r = ranges[s, b] if steps else 0.0
            begun = 0.0
            weight = np.int64(weights[s, b])
            parts, step_x, step_y = np.int64(between[s, b]) + 1, np.int64(0), np.int64(0)
            for part in range(1, parts + 1):  # the beam itself, then those between it and the next
                col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
                end_col, end_row = to_x >> CELL_SHIFT, to_y >> CELL_SHIFT
                line = draw_line(col, row, end_col, end_row)
                n, m = line.n, line.m
                i, end = 0, n + 1
                if not lies_inside(col, row, end_col, end_row, rows, cols):
                    i, end = clip_line(line, rows, cols)
                # The first `plain` cells are plain.
                plain = n + (not is_hit)
                before = max(r - depth, 0.0)
                if steps:
                    near = (profile.plain * before - begun) / UNITS_PER_CELL - FARTHEST_CENTRE
                    plain = (
                        min(max(int(near * n / np.sqrt(float(n * n + m * m))), 0), n) if n else 0
                    )
                elif is_hit and i < end == n + 1:
                    block = table[end_row >> bits, end_col >> bits]
                    if block < 0:
                        block = used[0]
                        table[end_row >> bits, end_col >> bits] = block
                        used[0] += 1
                    place = block * cells.size + (end_row & side) * stride + (end_col & side)
                    numbers[np.uint64(place)] += weight * hit[0]
                    end = n
                if noting and i < min(plain, end):
                    if line.steep:
                        note_line(
                            line, i, min(plain, end), col_runs, col_steps, rows + PAD, int(weight)
                        )
                    else:
                        note_line(
                            line, i, min(plain, end), row_runs, row_steps, cols + PAD, int(weight)
                        )
                    i = min(plain, end)
                if i < end:
                    # q is how far the line has moved along v, beyond the whole steps in v.
                    made = count_steps(line, i)
                    slope = q = 1 << (SLOPE_BITS - 1)
                    if m:
                        per_cell = (1 << SLOPE_BITS) / float(n)
                        slope = int(m * per_cell)
                        q = int((2 * i * m + n - 2 * n * made) * (per_cell / 2)) + 2 * n
                    else:
                        slope = 0
                    u, v = line.u + line.u_sign * i, line.v + line.v_sign * made
                    across, along = (
                        (line.v_sign, line.u_sign * stride)
                        if line.steep
                        else (line.v_sign * stride, line.u_sign)
                    )
                    sensor_u, sensor_v = (at_y, at_x) if line.steep else (at_x, at_y)
                    until = before * before
                    scale = steps / max(until, 1.0)
                while i < end:  # block by block
                    length = ((side - (u & side)) if line.u_sign > 0 else (u & side)) + 1
                    length = min(length, end - i)
                    room = (side - (v & side)) if line.v_sign > 0 else (v & side)
                    if (q + (length - 1) * slope) >> SLOPE_BITS > room:
                        length = (((room + 1) << SLOPE_BITS) - q + slope - 1) // slope
                    row, col = (u, v) if line.steep else (v, u)
                    block = table[row >> bits, col >> bits]
                    if block < 0:
                        block = used[0]
                        table[row >> bits, col >> bits] = block
                        used[0] += 1
                    place = block * cells.size + (row & side) * stride + (col & side)
                    from_u = (u << CELL_SHIFT) + HALF_CELL - sensor_u
                    from_v = (v << CELL_SHIFT) + HALF_CELL - sensor_v
                    few = max(min(length, plain - i), 0)
                    entry = weight * free[0]
                    to_plain = place + cells.plain
                    for _ in range(few):
                        numbers[np.uint64(to_plain + (q >> SLOPE_BITS) * across)] += entry
                        to_plain += along
                        q += slope
                    place += few * along
                    from_u += few * line.u_sign * UNITS_PER_CELL
                    for _ in range(few, length):
                        moved = q >> SLOPE_BITS
                        off_v = from_v + line.v_sign * (moved << CELL_SHIFT)
                        squared = float(from_u * from_u + off_v * off_v)
                        if squared < until:
                            entry = free[np.uint64(squared * scale)]
                            numbers[np.uint64(place + moved * across)] += weight * entry
                        elif is_hit:
                            d = np.sqrt(squared)
                            off = abs(d - r)
                            if off <= depth:
                                entry = hit[np.uint64(off / depth * steps)]
                                numbers[np.uint64(place + moved * across)] += weight * entry
                            elif d > r:
                                end = i
                                break
                        else:
                            end = i
                            break
                        place += along
                        from_u += line.u_sign * UNITS_PER_CELL
                        q += slope
                    u += line.u_sign * length
                    v += line.v_sign * (q >> SLOPE_BITS)
                    q &= (1 << SLOPE_BITS) - 1
                    i += length
                if part < parts:
                    if part == 1:
                        c = b + 1 if b + 1 < count else 0
                        step_x = np.int64(ends_x[s, c] - ends_x[s, b]) // parts
                        step_y = np.int64(ends_y[s, c] - ends_y[s, b]) // parts
                    to_x, to_y = to_x + step_x, to_y + step_y
                    x, y = begin_between(at_x, to_x), begin_between(at_y, to_y)
                    weight = np.int64(BETWEEN)
                    if steps:
                        span = np.hypot(float(to_x - at_x), float(to_y - at_y))
                        r, begun = max(span - depth, 0.0), BEGIN_EIGHTHS / 8 * span
