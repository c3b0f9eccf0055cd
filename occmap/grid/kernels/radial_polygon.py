"""The polygon update of a radial sensor model: what a scan says about each cell it covers, once.

A cell at distance d gets what the model says of d and the range of the beam that covers the cell's
bearing.

Clipped at p_min, such a model says the same about all cells up to some share of the range. These
are added as spans, as in `polygon`; only the cells beyond are visited. Thousands of them are
listed, and go through one short loop after the other: where a loop has no branch, a processor works
on several cells at once. Nearly all get what the model says of free cells, which takes no root; the
others are listed once more.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid import kernels
from occmap.grid.kernels import spans
from occmap.grid.kernels.lines import Field, fill_up
from occmap.grid.kernels.projection import Beams
from occmap.jit import kernel
from occmap.types import Bool, Float64, Int32, Int64, UInt8


class Listed(NamedTuple):
    """Cells to visit, each (N,): room for `MANY`, and for one more row."""

    places: Int32
    """A column + the row times the window's stride"""
    bearings: Int32
    """Which of the steps of a turn a cell lies in"""
    beyond: Int32
    """Which of these cells are not before the end of the beam that covers them"""
    squares: Float64
    """Squared distance from the sensor (lattice units)"""


BEARINGS = 1 << 14
"""Steps of a full turn to which the bearing of a cell is known."""
STEP = 5e-4
"""More than the angle of such a step (rad), which is twice as wide on diagonals as along axes."""
ROUNDED = 4
"""Lattice units by which corners may lie farther out than the sectors that they are made for."""
BESIDE = 2.0
"""How far rounding may take a corner to the side (lattice units)."""
COS_60, SIN_60 = 0.5, 0.75**0.5
ROUNDING = 1e-6
"""Unit vectors that add up to less are opposite: their sum is only rounding. A scan that turns by
less (rad) turns neither way, and a sector this narrow covers nothing. All of this happens with an
upright laser, whose beams lie in one vertical plane."""


class Sectors(NamedTuple):
    """What each beam of a scan covers: from half-way to one neighbour to half-way to the other."""

    direction: Float64
    """(B, 2) of the beams, of length 1"""
    sides: Float64
    """(B, 4) x and y of the unit vector at the side of the beam before, and of that at the side of
    the beam after, at most 60 degrees away"""
    covers: Bool
    """(B,) False where a beam is SKIP, and where its sides lie the wrong way round. That happens
    where a scan is not seen from where it was taken and a nearer thing shifts across a farther one;
    its neighbours' sectors then overlap"""
    shares_side: Bool
    """(B,) whether a sector begins where the one before ends, which 60 degrees may have ended
    earlier"""
    lengths: Float64
    """(B, 4) how far to outline a sector along each of its sides, and how far to the left of it, in
    lattice units from the sensor"""
    within: Float64
    """(B,) how far each beam surely says of all cells what it says of the first (lattice units)"""
    reach: Float64
    """(B,) to work with, as is the next"""
    inward: Float64


class Room(NamedTuple):
    """What a scan is worked out in."""

    tables: kernels.Tables
    depth: float
    """How far about the range a hit reaches (lattice units)"""
    sectors: Sectors
    covering: Int32
    """(BEARINGS + 1,) the beam that covers each step of a turn"""
    free: Int64
    """(TABLE_STEPS + 1,) the entries of free cells, and a 0"""
    scales: Float64
    """(B + 1,) what a squared distance is multiplied by to be a place there, for each beam, and inf
    for what no beam covers"""
    hits: Float64
    """(B + 1,) where each beam's hit lies, if any, or -inf"""
    listed: Listed
    outline: spans.Outline
    outer: spans.Spans
    """What the sectors cover"""
    inner: spans.Spans
    """The part of which all gets the first entry"""


def trace_radial_polygons(beams: Beams, tables: kernels.Tables, field: Field) -> None:
    """Add what every scan says about each cell that it covers, once.

    A cell belongs to the beam that covers its bearing: a beam covers the bearings that are nearer
    to it than to its neighbours, at most 60 degrees to either side, and as much beyond the first
    and the last.

    Parameters
    ----------
    field
        Its cells are sums of the entries of those that were visited; its changes count the others,
        which got the first entry of all.
    """
    (scans, count), rows = beams.rays.kind.shape, field.changes.rows
    most, crossings, done = kernels.MANY + field.changes.cols + kernels.AT_A_TIME, 4 * rows, 0
    places, bearings, beyond = np.empty((3, most), np.int32)
    listed = Listed(places, bearings, beyond, np.empty(most))
    covering, (scales, hits) = np.empty(BEARINGS + 1, np.int32), np.empty((2, count + 1))
    free = np.append(tables.entries[: kernels.TABLE_STEPS], 0)
    scales[-1], hits[-1] = np.inf, -np.inf
    depth, sectors = tables.depth * beams.units_per_metre, make_sectors(count)
    outline = spans.make_outline(4 * count + 4)
    while done < scans:
        outer, inner = (spans.make_spans(rows, crossings) for _ in range(2))
        known = covering, free, scales, hits
        room = Room(tables, depth, sectors, *known, listed, outline, outer, inner)
        done = trace_scans(beams, done, field, room)
        crossings *= 2


@kernel
def trace_scans(beams: Beams, done: int, field: Field, room: Room) -> int:
    """Add scans from `done` on, and return how many are done: for the next is too little room."""
    sectors, outline = room.sectors, room.outline
    outer, inner, depth, within = room.outer, room.inner, room.depth, sectors.within
    scans: int = beams.rays.kind.shape[0]
    corner, (_, rows, cols) = field.corner, field.changes
    for s in range(done, scans):
        ranges, kinds = beams.ranges[s], beams.rays.kind[s]
        at = beams.origins[s, 0, 0] - corner[0], beams.origins[s, 0, 1] - corner[1]
        sign = find_sectors(beams, s, sectors)
        side_by_side = cover_bearings(sectors, kinds, sign, room.covering)
        reach_out(beams, s, depth, sectors)
        corners = outline_sectors(at, sectors, outline)
        touched = spans.find_rows(outline.y, corners, at[1], 0, rows)
        if spans.fill_outline(outline, corners, touched, cols, outer) < 0:
            return s
        for b in range(kinds.size):
            room.scales[b] = kernels.TABLE_STEPS / max(ranges[b] - depth, 0.0) ** 2
            room.hits[b] = ranges[b] if kinds[b] == kernels.HIT else -np.inf
            plain = room.tables.plain * (ranges[b] - depth)
            within[b] = max(plain * (1 - 1e-6) - ROUNDED, 0.0)
        inner.counts[:] = 0
        if side_by_side:
            stay_inside(sign, sectors)
            corners = outline_sectors(at, sectors, outline)
            if spans.fill_outline(outline, corners, touched, cols, inner) < 0:
                return s
        _observe_spans(at, touched, room, field)
    return scans


@kernel
def _observe_spans(at: tuple[int, int], touched: tuple[int, int], room: Room, field: Field) -> None:
    """Add the inner spans of a scan from one place, and what beams say about its other cells."""
    outer, inner, listed, runs = room.outer, room.inner, room.listed, field.changes.numbers
    (at_x, at_y), stride, size = at, field.changes.cols + kernels.PAD, 0
    side, from_x = float(kernels.UNITS_PER_CELL), float(kernels.HALF_CELL - at_x)
    for r in range(touched[0], touched[1]):
        row, y = np.uint64(r), r * side + float(kernels.HALF_CELL - at_y)
        n, inner_end = inner.starts[row], inner.starts[row] + inner.counts[row]
        beyond = np.int64(0)  # an inner span may bridge a gap between two others
        for i in range(outer.starts[row], outer.starts[row] + outer.counts[row], 2):
            col = max(np.int64(outer.limits[np.uint64(i)]), beyond)
            end = np.int64(outer.limits[np.uint64(i + 1)])
            while col < end:
                until, beyond = end, end
                if n < inner_end and inner.limits[np.uint64(n)] < end:
                    until = np.int64(inner.limits[np.uint64(n)])
                    beyond = np.int64(inner.limits[np.uint64(n + 1)])
                    runs[np.uint64(until)] += 1
                    runs[np.uint64(beyond)] -= 1
                    n += 2
                first_x = (col - r * stride) * side + from_x
                for j in range(fill_up(int(until - col))):
                    k, x = np.uint64(size + j), first_x + float(np.int32(j)) * side
                    listed.places[k], listed.squares[k] = col + j, x * x + y * y
                    listed.bearings[k] = bearing_of(x, y)
                size += max(int(until - col), 0)
                col = max(col, beyond)
        if size >= kernels.MANY or r == touched[1] - 1:
            _observe_cells(room, size, field.cells)
            size = 0


@kernel
def _observe_cells(room: Room, size: int, cells: Int64) -> None:
    """Add to each of the listed cells what the beam that covers its bearing says about it."""
    covering, free, entries = room.covering, room.free, room.tables.entries
    (places, bearings, beyond, squares), steps, number = room.listed, kernels.TABLE_STEPS, 0
    for i in range(size):
        k = np.uint64(i)
        as_free = squares[k] * room.scales[np.uint64(covering[np.uint64(bearings[k])])]
        entry = int(as_free if as_free < steps else float(steps))
        cells[np.uint64(places[k])] += free[np.uint64(entry)]
        beyond[np.uint64(number)] = i
        number += entry == steps
    to_steps = steps / room.depth
    for i in range(number):
        k = np.uint64(beyond[np.uint64(i)])
        hit = room.hits[np.uint64(covering[np.uint64(bearings[k])])]
        off = abs(np.sqrt(squares[k]) - hit) * to_steps
        as_hit = kernels.FIRST_HIT + off if off <= steps else float(kernels.NOTHING)
        cells[np.uint64(places[k])] += entries[np.uint64(int(as_hit))]


def make_sectors(count: int) -> Sectors:
    """Room for the sectors of so many beams."""
    covers, shares_side = np.empty((2, count), np.bool_)
    sides, lengths = np.empty((2, count, 4))
    return Sectors(np.empty((count, 2)), sides, covers, shares_side, lengths, *np.empty((3, count)))


@kernel
def find_sectors(beams: Beams, s: int, sectors: Sectors) -> float:
    """Find what each beam of a scan covers; all but `lengths` is written.

    Returns
    -------
    1 where the scan turns counter-clockwise or neither way, -1 where clockwise.
    """
    direction, sides = sectors.direction, sectors.sides
    covers, shares_side = sectors.covers, sectors.shares_side
    turns, bearing, kinds = beams.rays.turn[s], beams.rays.bearing, beams.rays.kind[s]
    count, turn = kinds.size, 0.0
    for b in range(count):
        t = min(b, turns.shape[0] - 1)
        x = turns[t, 0, 0] * bearing[0, b] + turns[t, 0, 1] * bearing[1, b]
        y = turns[t, 1, 0] * bearing[0, b] + turns[t, 1, 1] * bearing[1, b]
        length = max(np.sqrt(x * x + y * y), kernels.NO_LENGTH)
        direction[b, 0], direction[b, 1] = x / length, y / length
    for b in range(1, count):
        turn += direction[b - 1, 0] * direction[b, 1] - direction[b - 1, 1] * direction[b, 0]
    sign = 1.0 if turn >= -ROUNDING else -1.0
    for b in range(count):
        after = b + 1 if b < count - 1 else 0
        x, y = direction[b, 0] + direction[after, 0], direction[b, 1] + direction[after, 1]
        length = np.sqrt(x * x + y * y)
        share = 1 / length if length > ROUNDING else 0.0
        sides[b, 2], sides[b, 3] = share * x, share * y
        sides[after, 0], sides[after, 1] = share * x, share * y
    if not beams.rays.full_circle:
        # The first beam and the last cover as much beyond themselves as to their neighbour.
        for b, i in ((0, 2), (count - 1, 0)):
            cosine = sides[b, i] * direction[b, 0] + sides[b, i + 1] * direction[b, 1]
            sides[b, 2 - i] = 2 * cosine * direction[b, 0] - sides[b, i]
            sides[b, 3 - i] = 2 * cosine * direction[b, 1] - sides[b, i + 1]
    for b in range(count):
        along_x, along_y = direction[b, 0], direction[b, 1]
        for side in range(0, 4, 2):
            if sides[b, side] * along_x + sides[b, side + 1] * along_y < COS_60:
                sine = sign * (side - 1) * SIN_60
                sides[b, side] = COS_60 * along_x - sine * along_y
                sides[b, side + 1] = COS_60 * along_y + sine * along_x
        widening = sides[b, 0] * sides[b, 3] - sides[b, 1] * sides[b, 2]
        covers[b] = kinds[b] != 0 and sign * widening > ROUNDING
    for b in range(count):
        shared = sides[b - 1, 2] == sides[b, 0] and sides[b - 1, 3] == sides[b, 1]
        shares_side[b] = b > 0 and covers[b - 1] and covers[b] and shared
    return sign


@kernel
def bearing_of(x: float, y: float) -> np.int32:
    """Which of the steps of a turn a vector points to, counter-clockwise from +x.

    Steps of x / (|x| + |y|) and not of the angle: they grow and shrink together, and this needs
    no arc tangent.
    """
    part = x / max(abs(x) + abs(y), kernels.NO_LENGTH)
    turned = 1.0 - part if y >= 0 else 3.0 + part
    return np.int32(turned * (BEARINGS / 4))


@kernel
def cover_bearings(sectors: Sectors, kinds: UInt8, sign: float, covering: Int32) -> bool:
    """Write for each step of a turn the beam that covers it, the later of two; B where none does.

    Returns
    -------
    Whether the beams lie side by side: each that is not SKIP has a step, and none has another's.
    """
    sides, covers = sectors.sides, sectors.covers
    covering[:] = covers.size
    right = 0 if sign > 0 else 2
    side_by_side, given = True, np.int64(0)
    for b in range(covers.size):
        first = bearing_of(sides[b, right], sides[b, right + 1])
        last = bearing_of(sides[b, 2 - right], sides[b, 3 - right])
        if not covers[b] or first == last:
            side_by_side = side_by_side and kinds[b] == kernels.SKIP
        elif last < first:
            covering[first:] = b
            covering[:last] = b
            given += BEARINGS - first + last
        else:
            covering[first:last] = b
            given += last - first
    covered = np.int64(0)
    for i in range(BEARINGS):
        covered += covering[i] < covers.size
    return bool(side_by_side and given == covered)


@kernel
def reach_out(beams: Beams, s: int, depth: float, sectors: Sectors) -> None:
    """Write how far sectors must go to hold every cell that their beams reach.

    That is to the tangent at the outermost circle, and a little more for rounding. A side lies at
    most 60 degrees from its beam; a beam straight up has no sides.
    """
    sides, direction, lengths = sectors.sides, sectors.direction, sectors.lengths
    ranges, kinds = beams.ranges[s], beams.rays.kind[s]
    for b in range(kinds.size):
        reach = ranges[b] + (depth if kinds[b] == kernels.HIT else 0.0) + ROUNDED
        for i in range(0, 4, 2):
            cosine = sides[b, i] * direction[b, 0] + sides[b, i + 1] * direction[b, 1]
            lengths[b, i], lengths[b, i + 1] = reach / max(cosine, COS_60 / 2), 0.0
    for b in range(0 if beams.rays.full_circle else 1, kinds.size):
        lengths[b - 1, 2] = lengths[b, 0] = max(lengths[b - 1, 2], lengths[b, 0])


@kernel
def stay_inside(sign: float, sectors: Sectors) -> None:
    """Write how far sectors go so that what is outlined is surely theirs, and within what is plain.

    Where neighbours differ (B,), the outline runs within the longer, so far from their side that no
    cell of it is the shorter's. A sector that is too narrow for that goes only as far as both of
    its neighbours do.
    """
    sides, shares_side, lengths = sectors.sides, sectors.shares_side, sectors.lengths
    own, reach, inward = sectors.within, sectors.reach, sectors.inward
    for b in range(own.size):
        after = b + 1 if b + 1 < own.size else 0
        width = abs(sides[b, 0] * sides[b, 3] - sides[b, 1] * sides[b, 2])
        is_wide = own[b] * width > 2 * (BESIDE + STEP * own[b])
        inward[b] = sign if is_wide else 0.0
        reach[b] = own[b] if is_wide else min(own[b - 1], own[b], own[after])
    for b in range(own.size):
        least, shift_before, shift = 0.0, -inward[b - 1], inward[b]
        if shares_side[b]:
            least = min(reach[b - 1], reach[b])
            shift_before = shift = shift if reach[b] > reach[b - 1] else shift_before
        length = reach[b - 1] if shift_before else least
        lengths[b - 1, 2] = length
        lengths[b - 1, 3] = shift_before * (min(BESIDE, length) + STEP * length)
        length = reach[b] if shift else least
        lengths[b, 0], lengths[b, 1] = length, shift * (min(BESIDE, length) + STEP * length)


@kernel
def outline_sectors(at: tuple[int, int], sectors: Sectors, outline: spans.Outline) -> int:
    """Write corners around the sectors of beams; returns their number.

    A run of sectors that share their sides is closed at the sensor, `at` x and y.
    """
    sides, lengths = sectors.sides, sectors.lengths
    covers, shares_side, (at_x, at_y) = sectors.covers, sectors.shares_side, at
    x, y, begins = outline.x, outline.y, outline.begins
    corners = 0
    for b in range(covers.size):
        if not covers[b]:
            continue
        if not shares_side[b]:
            x[corners], y[corners], begins[corners] = at_x, at_y, True
            corners += 1
        for i in range(0, 4, 2):
            along, left = lengths[b, i], lengths[b, i + 1]
            x[corners] = at_x + int(np.rint(along * sides[b, i] - left * sides[b, i + 1]))
            y[corners] = at_y + int(np.rint(along * sides[b, i + 1] + left * sides[b, i]))
            begins[corners] = False
            corners += 1
        if b + 1 == covers.size or not shares_side[b + 1]:
            x[corners], y[corners], begins[corners] = at_x, at_y, False
            corners += 1
    return corners
