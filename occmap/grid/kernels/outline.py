"""The polygon update's region and border, beam by beam.

Each run of beams that are not SKIP makes a region, closed through the sensor; a scan that goes all
the way round closes on itself. Between neighbours whose ranges differ by more than the jump the
edge steps, at the nearer range. The border is every HIT end cell and, between two HIT neighbours of
one surface, the cells of Bresenham's line between their ends.
"""

from typing import NamedTuple

import numpy as np

from occmap.arrays import Float32, Float64, Int32, UInt8
from occmap.grid.kernels.fill import Outline
from occmap.grid.kernels.project import round_to_units
from occmap.grid.kernels.units import AT_A_TIME, CELL_SHIFT, HALF_CELL, HIT, SKIP
from occmap.jit import kernel

EDGE, CELL, JOINED = 1, 2, 4
"""Bits of a link. EDGE: the edge from the beam before may matter. CELL: the beam's end cell is
listed. JOINED: so are the cells between the two end cells."""


class Surfaces(NamedTuple):
    """Which neighbouring beams see one surface, and the lattice that they are on."""

    units_per_metre: float
    """Lattice units in a metre"""
    jump: float
    """Neighbours see one surface where their ranges differ by at most this (m)"""
    border_gap: int
    """The border is closed between end cells of one surface at most so far apart (cells)"""
    full_circle: bool
    """The last beam and the first are neighbours"""
    left: int
    """x of the window's corner (lattice units)"""
    bottom: int
    """y of the window's corner (lattice units)"""
    shift_x: int
    """x of the anchor of the ends of beams, from the window's corner (lattice units)"""
    shift_y: int
    """y of that anchor from the window's corner (lattice units)"""
    clipped: bool
    """The scans may reach beyond the window"""


class ScanBeams(NamedTuple):
    """The beams of one scan, as in `Rays`, and where on the lattice they end."""

    origin: Float64
    """(2,)"""
    turn: Float64
    """(K, 2, 2)"""
    bearing: Float64
    """(2, B)"""
    distance: Float32
    """(B,)"""
    kinds: UInt8
    """(B,)"""
    ends_x: Int32
    """(B,) lattice units from the anchor"""
    ends_y: Int32
    """(B,) lattice units from the anchor"""


@kernel
def link_beams(beams: ScanBeams, surfaces: Surfaces, links: UInt8, listed: Int32) -> Int32:
    """Say how each beam of a scan is linked to the one before it.

    There are no branches, so that many beams are compared at a time. Returns the beams with an edge
    that may matter, or with cells between, from the start of `listed`: these are few.
    """
    distance, kinds, ends_x, ends_y = beams.distance, beams.kinds, beams.ends_x, beams.ends_y
    last = kinds.size - 1
    jump, gap = surfaces.jump, surfaces.border_gap
    for b in range(1, kinds.size):
        links[b] = _link(
            kinds[b - 1], kinds[b], np.float64(distance[b - 1]), np.float64(distance[b]),
            ends_x[b - 1], ends_x[b], ends_y[b - 1], ends_y[b], jump, gap,
        )  # fmt: skip
    before = int(kinds[last]) if surfaces.full_circle else 0
    links[0] = _link(
        before, kinds[0], np.float64(distance[last]), np.float64(distance[0]),
        ends_x[last], ends_x[0], ends_y[last], ends_y[0], jump, gap,
    )  # fmt: skip
    links[0] |= CELL * (kinds[0] == HIT)  # all beams may end in one cell
    size = 0
    for b in range(kinds.size):
        listed[np.uint64(size)] = b
        size += (links[b] & (EDGE | JOINED)) != 0
    return listed[:size]


@kernel
def _link(
    kind_before: int,
    kind: int,
    distance_before: float,
    distance: float,
    x_before: int,
    x: int,
    y_before: int,
    y: int,
    jump: float,
    border_gap: int,
) -> int:
    one_surface = abs(distance - distance_before) <= jump
    solid = (kind_before != 0) & (kind != 0)
    crosses = ((y_before + HALF_CELL - 1) >> CELL_SHIFT) != ((y + HALF_CELL - 1) >> CELL_SHIFT)
    edge = (solid & (crosses | (not one_surface))) | ((kind_before != 0) != (kind != 0))
    both = (kind_before == HIT) & (kind == HIT)
    across = abs((x >> CELL_SHIFT) - (x_before >> CELL_SHIFT))
    up = abs((y >> CELL_SHIFT) - (y_before >> CELL_SHIFT))
    steps = max(across, up)
    cell = (kind == HIT) & (not (both & (steps == 0)))
    joined = both & one_surface & (steps > 1) & (steps <= border_gap)
    return edge * EDGE + cell * CELL + joined * JOINED


@kernel
def outline_scan(
    beams: ScanBeams,
    surfaces: Surfaces,
    links: UInt8,
    listed: Int32,
    outline: Outline,
    rows: int,
) -> tuple[int, tuple[int, int]]:
    """Write the corners of one scan's regions: one region for each run of beams that are not SKIP.

    A region is closed through the sensor or, where a full circle has all its beams, on itself.
    Corners between which no row's centre line is crossed are left out. Returns the number of
    corners; and of the window's `rows` the first that the scan touches, and the one after the last.
    """
    origin, turn, bearing = beams.origin, beams.turn, beams.bearing
    distance, kinds, ends_x, ends_y = beams.distance, beams.kinds, beams.ends_x, beams.ends_y
    at_x = round_to_units(origin[0], surfaces.units_per_metre) - surfaces.left
    at_y = round_to_units(origin[1], surfaces.units_per_metre) - surfaces.bottom
    low, high = ends_y[0], ends_y[0]
    for b in range(kinds.size):
        low, high = min(low, ends_y[b]), max(high, ends_y[b])
    corners, drawn = 0, -1
    for i in range(listed.size):
        b = int(listed[i])
        if not links[b] & EDGE:
            continue
        a = b - 1 if b > 0 else kinds.size - 1
        begun = kinds[a] != 0 and (b > 0 or surfaces.full_circle)
        if not begun:
            corners = _add_corner(outline, corners, at_x, at_y, True)
        elif drawn != a:
            from_x, from_y = ends_x[a] + surfaces.shift_x, ends_y[a] + surfaces.shift_y
            corners = _add_corner(outline, corners, from_x, from_y, True)
        if kinds[b] == SKIP:
            corners = _add_corner(outline, corners, at_x, at_y, False)
            continue
        if begun and abs(np.float64(distance[b]) - distance[a]) > surfaces.jump:
            # Step at the nearer range, so that no space behind an edge is called free.
            near, far = (b, a) if distance[b] < distance[a] else (a, b)
            t = min(far, turn.shape[0] - 1)
            along_x = turn[t, 0, 0] * bearing[0, far] + turn[t, 0, 1] * bearing[1, far]
            along_y = turn[t, 1, 0] * bearing[0, far] + turn[t, 1, 1] * bearing[1, far]
            step_x = round_to_units(
                origin[0] + np.float64(distance[near]) * along_x, surfaces.units_per_metre
            )
            step_y = round_to_units(
                origin[1] + np.float64(distance[near]) * along_y, surfaces.units_per_metre
            )
            corners = _add_corner(
                outline, corners, step_x - surfaces.left, step_y - surfaces.bottom, False
            )
        to_x, to_y = ends_x[b] + surfaces.shift_x, ends_y[b] + surfaces.shift_y
        corners = _add_corner(outline, corners, to_x, to_y, False)
        drawn = b
    last = kinds.size - 1
    if kinds[last] != 0 and not surfaces.full_circle:
        if drawn != last:
            from_x, from_y = ends_x[last] + surfaces.shift_x, ends_y[last] + surfaces.shift_y
            corners = _add_corner(outline, corners, from_x, from_y, True)
        corners = _add_corner(outline, corners, at_x, at_y, False)
    lowest = min(at_y, int(low) + surfaces.shift_y) >> CELL_SHIFT
    highest = max(at_y, int(high) + surfaces.shift_y) >> CELL_SHIFT
    return corners, (max(lowest, 0), min(highest + 1, rows))


@kernel
def _add_corner(outline: Outline, corners: int, at_x: int, at_y: int, first: bool) -> int:
    i = np.uint64(corners)
    outline.x[i], outline.y[i], outline.begins[i] = at_x, at_y, first
    return corners + 1


@kernel
def list_border(
    beams: ScanBeams,
    links: UInt8,
    listed: Int32,
    surfaces: Surfaces,
    rows: int,
    cols: int,
    cells: Int32,
) -> int:
    """Write row and column of the cells of a scan's border that lie in the window; some twice.

    Returns how many.
    """
    ends_x, ends_y = beams.ends_x, beams.ends_y
    size, to_row, to_col = 0, surfaces.shift_y >> CELL_SHIFT, surfaces.shift_x >> CELL_SHIFT
    for b in range(links.size):
        k = np.uint64(size)
        cells[k, 0] = (ends_y[b] >> CELL_SHIFT) + to_row
        cells[k, 1] = (ends_x[b] >> CELL_SHIFT) + to_col
        size += (links[b] & CELL) != 0
    for i in range(listed.size):
        b = int(listed[i])
        if not links[b] & JOINED:
            continue
        a = b - 1 if b > 0 else links.size - 1
        col, row = ends_x[b] >> CELL_SHIFT, ends_y[b] >> CELL_SHIFT
        across, up = col - (ends_x[a] >> CELL_SHIFT), row - (ends_y[a] >> CELL_SHIFT)
        right, above = np.sign(across), np.sign(up)
        n = max(abs(across), abs(up))
        # From the end cell back along Bresenham's line that begins at the neighbour's cell: halves
        # are rounded away from the neighbour, so towards this end. Half a unit of 1 / (2 n) keeps
        # whole numbers from what rounding does.
        twice_x, twice_y, half, per_2n = 2.0 * abs(across), 2.0 * abs(up), n - 0.5, 0.5 / n
        for j in range((n - 1 + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
            steps_x = int(((j + 1) * twice_x + half) * per_2n)
            steps_y = int(((j + 1) * twice_y + half) * per_2n)
            k = np.uint64(size + j)
            cells[k, 0] = row + to_row - above * steps_y
            cells[k, 1] = col + to_col - right * steps_x
        size += n - 1
    return _keep_inside(cells, size, rows, cols) if surfaces.clipped else size


@kernel
def _keep_inside(cells: Int32, size: int, rows: int, cols: int) -> int:
    kept = 0
    for i in range(size):
        row, col = cells[i, 0], cells[i, 1]
        if 0 <= row < rows and 0 <= col < cols:
            cells[kept, 0], cells[kept, 1] = row, col
            kept += 1
    return kept
