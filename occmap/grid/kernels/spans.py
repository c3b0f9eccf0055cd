"""The cells inside an outline, row by row: spans from one crossing of its edges to another.

Edges cross a row's centre line, and the crossings are sorted. A cell is inside when its centre is:
from a crossing on, up to but not at the next (the half-open rule). A centre that edges wind around
more than once is inside once, so an outline may overlap itself, as that of a scan of more than 360
degrees does. Seen from the sensor, an outline goes round: so the crossings of a row nearly always
are in order from the left or from the right, and are quickly sorted.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels import AT_A_TIME, CELL_SHIFT, HALF_CELL, PAD
from occmap.grid.kernels.lines import fill_up
from occmap.jit import kernel, step
from occmap.types import Bool, Int32, Int64


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
def find_rows(y: Int32 | Int64, many: int, at_y: int, bottom: int, rows: int) -> tuple[int, int]:
    """The first row of a window that the sensor or some places touch, and the one behind the last.

    Parameters
    ----------
    y, at_y
        (N,) of the places, and of the sensor, like the `bottom` of the window in lattice units.
    rows
        How many it has.
    """
    low = high = at_y
    for i in range(many):
        low, high = min(low, y[i]), max(high, y[i])
    return max((low - bottom) >> CELL_SHIFT, 0), min(((high - bottom) >> CELL_SHIFT) + 1, rows)


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
            for k in range(fill_up(last - first)):
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


@step
def count_begun(spans: Spans, row: np.uint64, place: np.int32) -> int:
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
