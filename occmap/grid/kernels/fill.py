"""Filling outlines row by row: where edges cross a row's centre line, sorted, made into spans.

A cell is inside when its centre is: from a crossing on, up to but not at the next (the half-open
rule). A centre that edges wind around more than once is inside once, so an outline may overlap
itself, as that of a scan of more than 360 degrees does.

What rows have, crossings and then limits of spans, is kept in one short array, row after row.
"""

import numpy as np

from occmap.grid.kernels.units import CELL_SHIFT, HALF_CELL
from occmap.jit import kernel
from occmap.types import Bool, Int32, Int64


@kernel
def find_rows(y: Int64, corners: int, rows: int) -> tuple[int, int]:
    """The first row of a window that corners touch, and the one after the last."""
    low = high = y[0]
    for i in range(corners):
        low, high = min(low, y[i]), max(high, y[i])
    return max(low >> CELL_SHIFT, 0), min((high >> CELL_SHIFT) + 1, rows)


@kernel
def fill_outline(
    x: Int64,
    y: Int64,
    begins: Bool,
    corners: int,
    touched: tuple[int, int],
    cols: int,
    starts: Int32,
    counts: Int32,
    found: Int32,
    spans: Int32,
) -> tuple[Int32, Int32]:
    """Write the spans of all cells inside an outline, row by row.

    Parameters
    ----------
    x, y, begins
        Corners in lattice units from the window's corner; an edge leads to a corner from the one
        before, unless it begins an outline.
    touched
        The rows, as `find_rows` gives them; others are left as they are.
    starts, counts, spans
        (H,), (H,), (N,): the spans of row r are from `spans[starts[r]]` on, and are `counts[r]`
        numbers: first column, last + 1, and so on.
    found
        (2, N) to work with; see `_cross_rows`.

    Returns
    -------
    `found` and `spans`, or larger ones where these were too small.
    """
    crossings = _cross_rows(x, y, begins, corners, touched, counts, found)
    if crossings + 1 >= min(found.shape[1], len(spans)):  # one is read beyond the last
        room = 2 * crossings + 2
        found, spans = np.empty((2, room), np.int32), np.empty(room, np.int32)
        _cross_rows(x, y, begins, corners, touched, counts, found)
    _sort_by_row(touched, found, crossings, starts, counts, spans)
    _make_spans(touched, starts, counts, spans, cols)
    return found, spans


@kernel
def _cross_rows(
    x: Int64,
    y: Int64,
    begins: Bool,
    corners: int,
    touched: tuple[int, int],
    counts: Int32,
    found: Int32,
) -> int:
    """Write where edges cross the centre lines of rows, and how many crossings each row has.

    A crossing is its row in `found[0]`, and in `found[1]` 2 x the first column inside, + 1 if
    upward. Returns how many there are; if `found` cannot hold these, it must be made larger.
    """
    rows, room = counts.size, found.shape[1]
    crossings = 0
    counts[touched[0] : touched[1]] = 0
    row_after = 0
    for i in range(corners):
        row_before, row_after = row_after, (int(y[i]) + HALF_CELL - 1) >> CELL_SHIFT
        if begins[i] or row_before == row_after:
            continue
        upward = int(row_before < row_after)
        low, high = i - upward, i - 1 + upward
        first, last = max(min(row_before, row_after), 0), min(max(row_before, row_after), rows)
        if last <= first:
            continue
        if crossings + last - first <= room:
            rise, run = y[high] - y[low], x[high] - x[low]
            # The first column whose centre is at or right of the edge, on the row's centre line.
            centre = (first << CELL_SHIFT) + HALF_CELL
            numerator = (x[low] + HALF_CELL) * rise + (centre - y[low]) * run - 1
            inverse = 1.0 / float(rise << CELL_SHIFT)
            slope, base = run << CELL_SHIFT, rise << CELL_SHIFT
            for k in range(last - first):
                col = _floor_divide(numerator + k * slope, base, inverse)
                found[1, np.uint64(crossings + k)] = 2 * col + upward
                found[0, np.uint64(crossings + k)] = first + k
                counts[np.uint64(first + k)] += 1
        crossings += last - first
    return crossings


@kernel
def _floor_divide(numerator: int, denominator: int, inverse: float) -> int:
    """Divide integers exactly; a float product and two checks are faster than dividing them."""
    quotient = int(np.floor(float(numerator) * inverse))
    quotient -= quotient * denominator > numerator
    quotient += (quotient + 1) * denominator <= numerator
    return quotient


@kernel
def _sort_by_row(
    touched: tuple[int, int],
    found: Int32,
    crossings: int,
    starts: Int32,
    counts: Int32,
    limits: Int32,
) -> None:
    """Put the crossings of each row together in `limits`, at `starts`."""
    total = 0
    for r in range(touched[0], touched[1]):
        total += counts[np.uint64(r)]
        starts[np.uint64(r)] = total
    for i in range(crossings - 1, -1, -1):
        row = np.uint64(found[0, i])
        place = starts[row] - 1
        starts[row] = place
        limits[np.uint64(place)] = found[1, i]


@kernel
def _make_spans(
    touched: tuple[int, int], starts: Int32, counts: Int32, limits: Int32, cols: int
) -> None:
    """Turn each row's crossings, in place, into first column and last + 1 of its spans."""
    for r in range(touched[0], touched[1]):
        row = np.uint64(r)
        begin, crossings = starts[row], counts[row]
        if crossings == 2:  # nearly always; then it does not matter which of them leads up
            one, other = limits[np.uint64(begin)] >> 1, limits[np.uint64(begin + 1)] >> 1
            first, end = min(max(min(one, other), 0), cols), min(max(one, other, 0), cols)
            limits[np.uint64(begin)], limits[np.uint64(begin + 1)] = first, end
            counts[row] = 2 if end > first else 0
            continue
        _sort(limits, begin, begin + crossings)
        winding, first, place = 0, 0, begin
        for i in range(begin, begin + crossings):
            crossing = limits[i]
            col = min(max(crossing >> 1, 0), cols)
            if winding == 0:
                first = col
            winding += 2 * (crossing & 1) - 1
            if winding == 0 and col > first:
                limits[place], limits[place + 1] = first, col
                place += 2
        counts[row] = place - begin


@kernel
def _sort(values: Int32, begin: int, end: int) -> None:
    """Sort a part of an array in place by insertion: it is short, or nearly in order either way."""
    if end > begin and values[begin] > values[end - 1]:
        low, high = begin, end - 1
        while low < high:
            values[low], values[high] = values[high], values[low]
            low, high = low + 1, high - 1
    for i in range(begin + 1, end):
        value, place = values[i], i
        while place > begin and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
