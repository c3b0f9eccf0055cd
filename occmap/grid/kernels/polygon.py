"""The polygon update: a whole scan at once, its measured cells the border, the inside free.

Each border cell gets one hit a scan, however many beams end there. Every other cell whose centre is
inside gets one miss a scan.

Each run of beams that are not SKIP makes a region, closed through the sensor; a scan that goes all
the way round closes on itself. Between neighbours whose ranges differ by more than the jump the
edge steps, at the nearer range. The border is every HIT end cell and, between two HIT neighbours of
one surface, the cells of Bresenham's line between their ends.

The inside is not visited: a span of free cells is +1 at its first column and -1 after its last,
and one running sum along the rows turns thousands of scans' spans into counts. The cost of a scan
is thus its border. A border cell gets no miss from its own scan, so it counts how often it lay in
a span of its own scan, and that is taken off in the end.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels import CELL_SHIFT, HALF_CELL, HIT, PAD, SKIP, spans
from occmap.grid.kernels.lines import Field
from occmap.grid.kernels.projection import Beams
from occmap.jit import kernel, step
from occmap.types import Int32, Int64, UInt8

BORDER_BITS = 22
"""A border cell packs, from the lowest bit: minus the number of its hits that lay inside their own
scan's region (it borrows from the next field), its hits, and the last scan that hit it."""
ONE_HIT, SCAN_SHIFT = 1 << BORDER_BITS, 2 * BORDER_BITS
COUNTED = (1 << SCAN_SHIFT) - 1
"""Mask of the bits of both counts, without those of the last scan."""
MOST_SCANS = (1 << 20) - 1
"""The bits above both counts hold no larger number of a scan."""
EDGE, JOINED = 1, 2
"""Bits of a link. EDGE: the edge from the beam before may matter. JOINED: the cells between the two
end cells belong to the border, too."""


class Room(NamedTuple):
    """What a scan is worked out in."""

    links: UInt8
    """(B,) bits as above"""
    listed: Int32
    """(B,) the beams with an edge that may matter, or with cells between; these are few"""
    outline: spans.Outline
    inside: spans.Spans


def trace_polygons(beams: Beams, limits: tuple[float, int], field: Field, mark: int) -> None:
    """Add every scan's border and inside.

    Parameters
    ----------
    limits
        Neighbours see one surface where their ranges differ by at most the first (m), and the
        border is closed between end cells of one surface at most so far apart as the second
        (cells).
    field
        Its cells are packed as `BORDER_BITS` says.
    mark
        Scans count from `mark` + 1, and none above it is there yet.
    """
    (scans, count), rows = beams.rays.kind.shape, field.changes.rows
    links, listed, crossings = np.empty(count, np.uint8), np.empty(count, np.int32), 4 * rows
    outline, done = spans.make_outline(3 * count + 4), 0
    while done < scans:
        room = Room(links, listed, outline, spans.make_spans(rows, crossings))
        done = trace_scans(beams, done, limits, field, mark, room)
        crossings *= 2


@kernel
def trace_scans(
    beams: Beams, done: int, limits: tuple[float, int], field: Field, mark: int, room: Room
) -> int:
    """Add scans from `done` on, and return how many are done: for the next is too little room."""
    limits_inside, (runs, rows, cols) = room.inside.limits, field.changes
    scans: int = beams.rays.kind.shape[0]
    for s in range(done, scans):
        size = _link_beams(beams, s, limits, room.links, room.listed)
        corners = _outline_scan(beams, s, limits[0], field.corner, room, size)
        ends_y, at_y = beams.ends_y[s], beams.origins[s, 0, 1]
        touched = spans.find_rows(ends_y, ends_y.size, at_y, field.corner[1], rows)
        crossings = spans.fill_outline(room.outline, corners, touched, cols, room.inside)
        if crossings < 0:
            return s
        for i in range(0, crossings, 2):
            runs[np.uint64(limits_inside[np.uint64(i)])] += 1
            runs[np.uint64(limits_inside[np.uint64(i + 1)])] -= 1
        _note_border(beams, s, field, mark + s + 1, room, size)
    return scans


@kernel
def _link_beams(
    beams: Beams, s: int, limits: tuple[float, int], links: UInt8, listed: Int32
) -> int:
    """Say how each beam of a scan is linked to the one before it.

    There are no branches, so that many beams are compared at a time. Returns how many are listed.
    """
    distance, kinds, (jump, border_gap) = beams.rays.distance[s], beams.rays.kind[s], limits
    ends_x, ends_y, last = beams.ends_x[s], beams.ends_y[s], kinds.size - 1
    for a, b, size in ((0, 1, last), (last, 0, 1)):  # the first beam comes after the last
        before, after, link = kinds[a : a + size], kinds[b : b + size], links[b : b + size]
        range_before, range_after = distance[a : a + size], distance[b : b + size]
        from_x, to_x = ends_x[a : a + size], ends_x[b : b + size]
        from_y, to_y = ends_y[a : a + size], ends_y[b : b + size]
        for i in range(size):
            one_surface = abs(np.float64(range_after[i]) - np.float64(range_before[i])) <= jump
            solid, one_is = (before[i] != 0) & (after[i] != 0), (before[i] != 0) != (after[i] != 0)
            # The next row whose centre line lies above each end.
            row, to_row = from_y[i] + HALF_CELL - 1, to_y[i] + HALF_CELL - 1
            crosses = (row >> CELL_SHIFT) != (to_row >> CELL_SHIFT)
            edge = (solid & (crosses | (not one_surface))) | one_is
            both = (before[i] == HIT) & (after[i] == HIT)
            across = abs((to_x[i] >> CELL_SHIFT) - (from_x[i] >> CELL_SHIFT))
            up = abs((to_y[i] >> CELL_SHIFT) - (from_y[i] >> CELL_SHIFT))
            steps = max(across, up)
            joined = both & one_surface & (steps > 1) & (steps <= border_gap)
            link[i] = edge * EDGE + joined * JOINED
    if not beams.rays.full_circle:
        links[0] = EDGE * (kinds[0] != SKIP)
    size = 0
    for b in range(kinds.size):
        listed[np.uint64(size)] = b
        size += (links[b] & (EDGE | JOINED)) != 0
    return size


@kernel
def _outline_scan(beams: Beams, s: int, jump: float, corner: Int64, room: Room, size: int) -> int:
    """Write the corners of one scan's regions: one region for each run of beams that are not SKIP.

    A region is closed through the sensor or, where a full circle has all its beams, on itself.
    Corners between which no row's centre line is crossed are left out. Returns the number of
    corners.
    """
    links, outline, full_circle = room.links, room.outline, beams.rays.full_circle
    distance, kinds = beams.rays.distance[s], beams.rays.kind[s]
    ends_x, ends_y, left, bottom = beams.ends_x[s], beams.ends_y[s], corner[0], corner[1]
    at_x, at_y = beams.origins[s, 0, 0] - left, beams.origins[s, 0, 1] - bottom
    corners, drawn, last = 0, -1, kinds.size - 1
    for i in range(size):
        b = int(room.listed[i])
        if not links[b] & EDGE:
            continue
        a = b - 1 if b > 0 else last
        begun = kinds[a] != SKIP and (b > 0 or full_circle)
        if not begun:
            corners = _add_corner(outline, corners, at_x, at_y, True)
        elif drawn != a:
            corners = _add_corner(outline, corners, ends_x[a] - left, ends_y[a] - bottom, True)
        if kinds[b] == SKIP:
            corners = _add_corner(outline, corners, at_x, at_y, False)
            continue
        if begun and abs(np.float64(distance[b]) - distance[a]) > jump:
            # Step at the nearer range, so that no space behind an edge is called free.
            near, far = (b, a) if distance[b] < distance[a] else (a, b)
            x, y = _end_at(beams, s, far, np.float64(distance[near]))
            corners = _add_corner(outline, corners, x - left, y - bottom, False)
        corners = _add_corner(outline, corners, ends_x[b] - left, ends_y[b] - bottom, False)
        drawn = b
    if kinds[last] != SKIP and not full_circle:
        if drawn != last:
            x, y = ends_x[last] - left, ends_y[last] - bottom
            corners = _add_corner(outline, corners, x, y, True)
        corners = _add_corner(outline, corners, at_x, at_y, False)
    return corners


@kernel
def _end_at(beams: Beams, s: int, b: int, reach: float) -> tuple[int, int]:
    """Find where a beam of a scan would end if it reached so far (m); x and y, in lattice units."""
    rays, anchor, scale = beams.rays, beams.anchor, beams.units_per_metre
    origin, turn = rays.origin[s, 0], rays.turn[s, min(b, rays.turn.shape[1] - 1)]
    x, y = rays.bearing[0, b], rays.bearing[1, b]
    along_x, along_y = turn[0, 0] * x + turn[0, 1] * y, turn[1, 0] * x + turn[1, 1] * y
    end_x = int(np.rint((origin[0] + reach * along_x) * scale)) - anchor[0]
    return end_x, int(np.rint((origin[1] + reach * along_y) * scale)) - anchor[1]


@kernel
def _add_corner(outline: spans.Outline, corners: int, at_x: int, at_y: int, first: bool) -> int:
    i = np.uint64(corners)
    outline.x[i], outline.y[i], outline.begins[i] = at_x, at_y, first
    return corners + 1


@kernel
def _note_border(beams: Beams, s: int, field: Field, mark: int, room: Room, size: int) -> None:
    """Give each cell of a scan's border one hit, and count whether it lies in a span."""
    ends_x, ends_y, kinds = beams.ends_x[s], beams.ends_y[s], beams.rays.kind[s]
    links, inside = room.links, room.inside
    to_col, to_row = field.corner[0] >> CELL_SHIFT, field.corner[1] >> CELL_SHIFT
    for b in range(links.size):
        if kinds[b] == HIT:
            row, col = (ends_y[b] >> CELL_SHIFT) - to_row, (ends_x[b] >> CELL_SHIFT) - to_col
            _note_cell(row, col, inside, mark, field)
    for i in range(size):
        b = int(room.listed[i])
        if not links[b] & JOINED:
            continue
        a = b - 1 if b > 0 else links.size - 1
        row, col = (ends_y[b] >> CELL_SHIFT) - to_row, (ends_x[b] >> CELL_SHIFT) - to_col
        across = col - ((ends_x[a] >> CELL_SHIFT) - to_col)
        up = row - ((ends_y[a] >> CELL_SHIFT) - to_row)
        right, above = np.sign(across), np.sign(up)
        n = max(abs(across), abs(up))
        # From the end cell back along Bresenham's line that begins at the neighbour's cell: halves
        # are rounded away from the neighbour, so towards this end. Half a unit of 1 / (2 n) keeps
        # whole numbers from what rounding does.
        twice_x, twice_y, half, per_2n = 2.0 * abs(across), 2.0 * abs(up), n - 0.5, 0.5 / n
        for j in range(1, n):
            steps_x = int((j * twice_x + half) * per_2n)
            steps_y = int((j * twice_y + half) * per_2n)
            _note_cell(row - above * steps_y, col - right * steps_x, inside, mark, field)


@step
def _note_cell(at_row: int, at_col: int, inside: spans.Spans, mark: int, field: Field) -> None:
    """Give a cell of the border one hit, if it lies in the window and has none of this scan.

    What it gets is chosen without a branch: whether neighbours share a cell is a coin toss.
    """
    border, (_, rows, cols) = field.cells, field.changes
    if not (0 <= at_row < rows and 0 <= at_col < cols):
        return
    place = np.int32(at_row * (cols + PAD) + at_col)
    cell = border[np.uint64(place)]
    is_inside = spans.count_begun(inside, np.uint64(at_row), place) & 1
    is_new = (cell >> SCAN_SHIFT) != mark
    hit = (cell & COUNTED) + ONE_HIT - is_inside
    border[np.uint64(place)] = hit | (mark << SCAN_SHIFT) if is_new else cell
