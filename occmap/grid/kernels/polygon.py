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

Spans come from filling an outline row by row: where its edges cross a row's centre line, sorted. A
cell is inside when its centre is: from a crossing on, up to but not at the next (the half-open
rule). A centre that edges wind around more than once is inside once, so an outline may overlap
itself, as that of a scan of more than 360 degrees does. Seen from the sensor, an outline goes
round: so the crossings of a row nearly always are in order from the left or from the right, and
are quickly sorted.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.projection import Beams
from occmap.grid.kernels.units import AT_A_TIME, CELL_SHIFT, HALF_CELL, HIT, PAD, SKIP
from occmap.jit import kernel, step
from occmap.types import Bool, Int32, Int64, UInt8


class Outline(NamedTuple):
    """Corners of outlines, in lattice units from the window's corner."""

    x: Int64
    """(N,)"""
    y: Int64
    """(N,)"""
    begins: Bool
    """(N,) whether a corner begins an outline; to any other an edge leads from the one before"""


class Spans(NamedTuple):
    """What lies inside an outline: for each row, the first place and the last + 1 of each span.

    A place is a column + the row times the window's stride; a window has at most 2^24 cells.
    """

    starts: Int32
    """(H,) where those of a row begin in `limits`"""
    counts: Int32
    """(H + 1,) how many numbers a row has there"""
    limits: Int32
    """(N,)"""
    found: Int32
    """(2, N) to work with: the row of each crossing; 2 x the first place inside, + 1 if upward"""


def make_outline(corners: int) -> Outline:
    """Room for so many corners."""
    x, y = np.empty((2, corners), np.int64)
    return Outline(x, y, np.empty(corners, np.bool_))


def make_spans(rows: int, crossings: int) -> Spans:
    """Room for the spans of a window's rows, and for about so many crossings."""
    starts, counts = np.empty(rows, np.int32), np.empty(rows + 1, np.int32)
    return Spans(starts, counts, np.empty(crossings, np.int32), np.empty((2, crossings), np.int32))


BEHIND = np.int32(2**31 - 1)
"""Beyond all places of a window"""


@kernel
def find_rows(y: Int64, corners: int, rows: int) -> tuple[int, int]:
    """The first row of a window that corners touch, and the one after the last."""
    low = high = y[0]
    for i in range(corners):
        low, high = min(low, y[i]), max(high, y[i])
    return max(low >> CELL_SHIFT, 0), min((high >> CELL_SHIFT) + 1, rows)


@kernel
def fill_outline(
    outline: Outline, corners: int, touched: tuple[int, int], cols: int, spans: Spans
) -> int:
    """Write the spans of all cells of a window inside an outline; some may be empty.

    Parameters
    ----------
    touched
        The rows, as `find_rows` gives them; others are left as they are.

    Returns
    -------
    How many limits they have, or -1 where there is no room for these.
    """
    crossings = _cross_rows(outline, corners, touched, cols, spans)
    if crossings + AT_A_TIME > spans.limits.size:
        return -1
    _sort_by_row(touched, crossings, spans)
    _make_spans(touched, spans)
    spans.limits[crossings : crossings + AT_A_TIME] = BEHIND
    return crossings


@kernel
def _cross_rows(
    outline: Outline, corners: int, touched: tuple[int, int], cols: int, spans: Spans
) -> int:
    """Find where edges cross the centre lines of rows; `counts` gets what changes at each row.

    What lies beside the window crosses at its side.

    Returns how many crossings there are; without room for these all must be found again.
    """
    x, y, begins = outline.x, outline.y, outline.begins
    counts, found = spans.counts, spans.found
    rows, room, stride = counts.size - 1, found.shape[1], cols + PAD
    crossings = 0
    counts[touched[0] : touched[1] + 1] = 0
    row_after = 0
    for i in range(corners):
        row_before, row_after = row_after, (int(y[i]) + HALF_CELL - 1) >> CELL_SHIFT
        if begins[i] or row_before == row_after:
            continue
        upward = int(row_before < row_after)
        first, last = max(min(row_before, row_after), 0), min(max(row_before, row_after), rows)
        if last <= first:
            continue
        if crossings + last - first + AT_A_TIME <= room:
            counts[np.uint64(first)] += 1
            counts[np.uint64(last)] -= 1
            sign = 2 * upward - 1
            rise, run = sign * (y[i] - y[i - 1]), sign * (x[i] - x[i - 1])
            # The first column whose centre is at or right of the edge, on the row's centre line.
            centre = (first << CELL_SHIFT) + HALF_CELL
            numerator = (x[i] + HALF_CELL) * rise + (centre - y[i]) * run - 1
            inverse = 1.0 / float(rise << CELL_SHIFT)
            slope, base = run << CELL_SHIFT, rise << CELL_SHIFT
            for k in range((last - first + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
                col = min(max(_floor_divide(numerator + k * slope, base, inverse), 0), cols)
                found[0, np.uint64(crossings + k)] = first + k
                found[1, np.uint64(crossings + k)] = 2 * (col + (first + k) * stride) + upward
        crossings += last - first
    return crossings


@kernel
def _floor_divide(numerator: int, denominator: int, inverse: float) -> int:
    """Divide integers exactly; a float product and two checks are faster than dividing them."""
    quotient = int(np.floor(float(numerator) * inverse))
    rest = numerator - quotient * denominator
    return quotient + (rest >= denominator) - (rest < 0)


@kernel
def _sort_by_row(touched: tuple[int, int], crossings: int, spans: Spans) -> None:
    """Put the crossings of each row together in `limits`, at `starts`."""
    starts, counts, limits, found = spans.starts, spans.counts, spans.limits, spans.found
    count, total = np.int32(0), 0
    for r in range(touched[0], touched[1]):
        count += counts[np.uint64(r)]
        counts[np.uint64(r)] = count
        total += count
        starts[np.uint64(r)] = total
    for i in range(crossings - 1, -1, -1):
        row = np.uint64(found[0, i])
        place = starts[row] - 1
        starts[row] = place
        limits[np.uint64(place)] = found[1, i]


@kernel
def _make_spans(touched: tuple[int, int], spans: Spans) -> None:
    """Turn each row's crossings, in place, into first place and last + 1 of its spans."""
    starts, counts, limits = spans.starts, spans.counts, spans.limits
    for r in range(touched[0], touched[1]):
        row = np.uint64(r)
        begin, crossings = starts[row], counts[row]
        if crossings == 2:  # nearly always
            _pair_two(limits, begin)
        elif crossings == 4:
            _pair_four(limits, begin)
        elif crossings:
            _sort(limits, begin, begin + crossings)
            _keep_ends(limits, begin, begin + crossings)


@step
def _pair_two(limits: Int32, begin: int) -> None:
    """Make a span of two crossings; it does not matter which of them leads up."""
    first, last = np.uint64(begin), np.uint64(begin + 1)
    a, b = limits[first] >> 1, limits[last] >> 1
    limits[first], limits[last] = min(a, b), max(a, b)


@step
def _pair_four(limits: Int32, begin: int) -> None:
    """Make two spans of four crossings, sorted without a branch."""
    first, second = np.uint64(begin), np.uint64(begin + 1)
    third, last = np.uint64(begin + 2), np.uint64(begin + 3)
    a, b, c, d = limits[first], limits[second], limits[third], limits[last]
    a, b, c, d = min(a, b), max(a, b), min(c, d), max(c, d)
    a, b, c, d = min(a, c), min(b, d), max(a, c), max(b, d)
    b, c = min(b, c), max(b, c)
    if (a ^ b) & 1 == 0:  # both lead the same way: one span lies about another
        b = c = d
    limits[first], limits[second] = a >> 1, b >> 1
    limits[third], limits[last] = c >> 1, d >> 1


@kernel
def _sort(crossings: Int32, begin: int, end: int) -> None:
    """Sort a row's crossings.

    By insertion, once they are turned round where they come from the right: then hardly one moves.
    """
    if crossings[begin] > crossings[end - 1]:
        for i in range((end - begin) // 2):
            left, right = np.uint64(begin + i), np.uint64(end - 1 - i)
            crossings[left], crossings[right] = crossings[right], crossings[left]
    for i in range(begin + 1, end):
        value, place = crossings[np.uint64(i)], i
        while place > begin and crossings[np.uint64(place - 1)] > value:
            crossings[np.uint64(place)] = crossings[np.uint64(place - 1)]
            place -= 1
        crossings[np.uint64(place)] = value


@kernel
def _keep_ends(crossings: Int32, begin: int, end: int) -> None:
    """Keep the places of those sorted crossings where a span begins or ends."""
    winding, place = 0, begin
    for i in range(begin, end):
        outside, crossing = winding == 0, crossings[np.uint64(i)]
        winding += 2 * (crossing & 1) - 1
        if outside or winding == 0:
            crossings[np.uint64(place)] = crossing >> 1
            place += 1
    crossings[place:end] = crossings[place - 1]  # empty spans


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


class Field(NamedTuple):
    """The cells of a window that scans are added to."""

    corner: Int64
    """(2,) x and y of the window's corner (lattice units from the anchor)"""
    cells: Int64
    """(H, W + PAD) what single cells got"""
    runs: Int32
    """H x (W + PAD), flat: changes along rows of how often cells were plainly inside"""


class Room(NamedTuple):
    """What a scan is worked out in."""

    links: UInt8
    """(B,) bits as above"""
    listed: Int32
    """(B,) the beams with an edge that may matter, or with cells between; these are few"""
    outline: Outline
    spans: Spans


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
    (scans, count), rows = beams.rays.kind.shape, len(field.cells)
    links, listed, crossings = np.empty(count, np.uint8), np.empty(count, np.int32), 4 * rows
    outline, done = make_outline(3 * count + 4), 0
    while done < scans:
        room = Room(links, listed, outline, make_spans(rows, crossings))
        done = trace_scans(beams, done, limits, field, mark, room)
        crossings *= 2


@kernel
def trace_scans(
    beams: Beams, done: int, limits: tuple[float, int], field: Field, mark: int, room: Room
) -> int:
    """Add scans from `done` on, and return how many are done: for the next is too little room."""
    spans, runs = room.spans, field.runs
    rows, cols = field.cells.shape[0], field.cells.shape[1] - PAD
    scans: int = beams.rays.kind.shape[0]
    for s in range(done, scans):
        size = _link_beams(beams, s, limits, room.links, room.listed)
        corners = _outline_scan(beams, s, limits[0], field.corner, room, size)
        touched = _find_rows(beams, s, field.corner[1], rows)
        crossings = fill_outline(room.outline, corners, touched, cols, spans)
        if crossings < 0:
            return s
        for i in range(0, crossings, 2):
            runs[np.uint64(spans.limits[np.uint64(i)])] += 1
            runs[np.uint64(spans.limits[np.uint64(i + 1)])] -= 1
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
def _find_rows(beams: Beams, s: int, bottom: int, rows: int) -> tuple[int, int]:
    """Find the first row of a window that a scan touches, and the one after the last."""
    ends_y, at_y = beams.ends_y[s], beams.origins[s, 0, 1]
    low = high = ends_y[0]
    for b in range(ends_y.size):
        low, high = min(low, ends_y[b]), max(high, ends_y[b])
    lowest, highest = min(at_y, low) - bottom, max(at_y, high) - bottom
    return max(lowest >> CELL_SHIFT, 0), min((highest >> CELL_SHIFT) + 1, rows)


@kernel
def _add_corner(outline: Outline, corners: int, at_x: int, at_y: int, first: bool) -> int:
    i = np.uint64(corners)
    outline.x[i], outline.y[i], outline.begins[i] = at_x, at_y, first
    return corners + 1


@kernel
def _note_border(beams: Beams, s: int, field: Field, mark: int, room: Room, size: int) -> None:
    """Give each cell of a scan's border one hit, and count whether it lies in a span."""
    ends_x, ends_y, kinds = beams.ends_x[s], beams.ends_y[s], beams.rays.kind[s]
    links, spans, border = room.links, room.spans, field.cells
    to_col, to_row = field.corner[0] >> CELL_SHIFT, field.corner[1] >> CELL_SHIFT
    for b in range(links.size):
        if kinds[b] == HIT:
            row, col = (ends_y[b] >> CELL_SHIFT) - to_row, (ends_x[b] >> CELL_SHIFT) - to_col
            _note_cell(row, col, spans, mark, border)
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
            _note_cell(row - above * steps_y, col - right * steps_x, spans, mark, border)


@step
def _note_cell(at_row: int, at_col: int, spans: Spans, mark: int, border: Int64) -> None:
    """Give a cell of the border one hit, if it lies in the window and has none of this scan.

    What it gets is chosen without a branch: whether neighbours share a cell is a coin toss.
    """
    row, col, cols = np.uint64(at_row), np.uint64(at_col), border.shape[1] - PAD
    if row >= np.uint64(border.shape[0]) or col >= np.uint64(cols):
        return
    cell = border[row, col]
    inside = _count_begun(spans, row, np.int32(at_row * border.shape[1] + at_col)) & 1
    is_new = (cell >> SCAN_SHIFT) != mark
    hit = (cell & COUNTED) + ONE_HIT - inside
    border[row, col] = hit | (mark << SCAN_SHIFT) if is_new else cell


@step
def _count_begun(spans: Spans, row: np.uint64, place: np.int32) -> int:
    """How many limits of a row's spans lie at or before a place: an odd number inside a span.

    A wall along a row may make hundreds of them, so they are halved until few are left.
    """
    limits, begin, size = spans.limits, spans.starts[row], spans.counts[row]
    at, begun = begin, np.int32(0)
    while size > AT_A_TIME:
        half = size >> 1
        at += half if limits[np.uint64(at + half - 1)] <= place else 0
        size -= half
    for k in range(AT_A_TIME):  # what comes after these lies behind the place
        begun += np.int32(limits[np.uint64(at + k)] <= place)
    return int(at - begin + begun)
