"""Filling outlines row by row: where edges cross a row's centre line, sorted, made into spans.

A cell is inside when its centre is: from a crossing on, up to but not at the next (the half-open
rule). A centre that edges wind around more than once is inside once, so an outline may overlap
itself, as that of a scan of more than 360 degrees does.

Rows keep their crossings in `buckets` (H, C); `counts` (H,) says how many each has.
"""

import numpy as np

from occmap.grid.kernels.arrays import Int32
from occmap.grid.kernels.jit import kernel
from occmap.types import Bool, Int64

PADDING = 8
"""Limits of spans that a row has at least, so that most rows are searched without a branch."""
NOWHERE = 2**31 - 1


@kernel
def find_rows(y: Int64, corners: int, rows: int) -> tuple[int, int]:
    """The first row of a window that corners touch, and the one after the last."""
    low = high = y[0]
    for i in range(corners):
        low, high = min(low, y[i]), max(high, y[i])
    return max(low >> 8, 0), min((high >> 8) + 1, rows)


@kernel
def cross_rows(
    x: Int64,
    y: Int64,
    begins: Bool,
    corners: int,
    touched: tuple[int, int],
    buckets: Int32,
    counts: Int64,
) -> bool:
    """Sort the crossings of all edges into their rows: 2 x first column inside, + 1 if upward.

    Parameters
    ----------
    x, y, begins
        Corners in lattice units from the window's corner; an edge leads to a corner from the one
        before, unless it begins an outline.
    touched
        The rows, as `find_rows` gives them; others are left as they are.

    Returns
    -------
    False where a row has more crossings than `buckets` can hold; it must then be made wider.
    """
    rows, capacity = buckets.shape
    most = 0
    counts[touched[0] : touched[1]] = 0
    row_after = 0
    for i in range(corners):
        row_before, row_after = row_after, (int(y[i]) + 127) >> 8
        if begins[i] or row_before == row_after:
            continue
        if row_before < row_after:
            low, high, upward = i - 1, i, 1
        else:
            low, high, upward = i, i - 1, 0
        first, last = max(min(row_before, row_after), 0), min(max(row_before, row_after), rows)
        rise, run = y[high] - y[low], x[high] - x[low]
        # The first column whose centre is at or right of the edge, on the row's centre line.
        numerator = (x[low] + 128) * rise + ((first << 8) + 128 - y[low]) * run - 1
        for row in range(first, last):
            crossing = 2 * _floor_divide(numerator, rise << 8) + upward
            numerator += run << 8
            place = counts[np.uint64(row)]
            counts[np.uint64(row)] = place + 1
            most = max(most, place + 1)
            if place < capacity:
                _insert(buckets, row, place, crossing)
    return bool(most <= capacity)


@kernel
def _floor_divide(numerator: int, denominator: int) -> int:
    """Divide integers exactly; a float division and two checks are faster than dividing them."""
    quotient = int(np.floor(float(numerator) / float(denominator)))
    if quotient * denominator > numerator:
        return quotient - 1
    if (quotient + 1) * denominator <= numerator:
        return quotient + 1
    return quotient


@kernel
def _insert(buckets: Int32, row: int, place: int, crossing: int) -> None:
    """Put a crossing where it belongs among the sorted ones of its row."""
    r = np.uint64(row)
    while place > 0 and buckets[r, np.uint64(place - 1)] > crossing:
        buckets[r, np.uint64(place)] = buckets[r, np.uint64(place - 1)]
        place -= 1
    buckets[r, np.uint64(place)] = crossing


@kernel
def make_spans(touched: tuple[int, int], buckets: Int32, counts: Int64, cols: int) -> None:
    """Turn each row's crossings, in place, into first column and last + 1 of its spans.

    A row with fewer than `PADDING` limits of spans is padded with limits beyond every column.
    """
    for row in range(touched[0], touched[1]):
        winding, first, place = 0, 0, 0
        for i in range(counts[row]):
            crossing = buckets[np.uint64(row), np.uint64(i)]
            col = min(max(crossing >> 1, 0), cols)
            if winding == 0:
                first = col
            winding += 2 * (crossing & 1) - 1
            if winding == 0 and col > first:
                buckets[np.uint64(row), np.uint64(place)] = first
                buckets[np.uint64(row), np.uint64(place + 1)] = col
                place += 2
        counts[row] = place
        for i in range(place, PADDING):
            buckets[np.uint64(row), np.uint64(i)] = NOWHERE
