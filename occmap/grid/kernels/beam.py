"""The beam update: a miss for every cell that a beam crosses, a hit where it ended.

Bresenham's line (1965) is a staircase: runs of cells along its major axis, and a step to the next
row between two runs. Instead of visiting its cells, a line is noted by what changes along a row:
+1 where a run starts, -1 after its end, so that a running sum along the row gives the counts
back. A step from row v - 1 to row v in column u ends a run below and starts one above, so that a
single entry says both:

    change[v, u] = runs[v, u] + steps[v, u] - steps[v + 1, u]

A beam thus costs one addition for each step and not for each cell: a third of them, on average.
Lines that rise more than they run are noted in the same way in a transposed pair of arrays.

Arrays are passed flat, row by row: slicing one inside a loop would cost more than the loop.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.units import BETWEEN, CELL_SHIFT, HIT, SKIP
from occmap.jit import kernel
from occmap.types import Int32, Int64, UInt8

FRACTION_BITS = 36
"""Of the fixed-point number that walks along a row; the rest holds a cell's place in a window."""

BLOCK = 16
"""Columns that are summed at the same time: a cache line of counts."""


class Changes(NamedTuple):
    """What lines change along the rows of a window, and steep ones along its columns; all flat."""

    row_runs: Int32
    """H x (W + 1)"""
    row_steps: Int32
    """(H + 1) x (W + 1)"""
    col_runs: Int32
    """W x (H + 1)"""
    col_steps: Int32
    """(W + 1) x (H + 1)"""


@kernel
def trace_beams(
    origins: Int64,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    weights: UInt8,
    between: UInt8,
    corner: Int64,
    hits: Int32,
    changes: Changes,
) -> None:
    """Note every beam's hit and misses, and those of the beams between it and the next.

    Parameters
    ----------
    origins, ends_x, ends_y, kinds
        (S, K, 2) and (S, B) in lattice units from an anchor; (S, B) of Kind.
    weights, between
        (S, B) as in `Projected`.
    corner
        (2,) x and y of the window's corner in lattice units from the anchor.
    hits
        (H, W) counts.
    """
    scans, beams = kinds.shape
    viewpoints = origins.shape[1]
    rows, cols = hits.shape
    left, bottom = corner[0] >> CELL_SHIFT, corner[1] >> CELL_SHIFT
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    for s in range(scans):
        for b in range(beams):
            if kinds[s, b] == SKIP:
                continue
            k = b if viewpoints > 1 else 0
            col = (origins[s, k, 0] >> CELL_SHIFT) - left
            row = (origins[s, k, 1] >> CELL_SHIFT) - bottom
            x, y, weight = ends_x[s, b], ends_y[s, b], int(weights[s, b])
            parts, step_x, step_y = np.int32(between[s, b]) + 1, 0, 0
            for part in range(1, parts + 1):  # the beam itself, then those between it and the next
                end_col, end_row = (x >> CELL_SHIFT) - left, (y >> CELL_SHIFT) - bottom
                if 0 <= end_row < rows and 0 <= end_col < cols:
                    if kinds[s, b] == HIT:
                        hits[np.uint64(end_row), np.uint64(end_col)] += weight
                    else:
                        end = np.uint64(end_row * (cols + 1) + end_col)
                        row_runs[end] += weight
                        row_runs[end + np.uint64(1)] -= weight
                inside = (
                    min(row, end_row) >= 0
                    and max(row, end_row) < rows
                    and min(col, end_col) >= 0
                    and max(col, end_col) < cols
                )
                across, up = abs(end_col - col), abs(end_row - row)
                if across < up:
                    if inside:
                        add_line(
                            col_runs, col_steps, rows + 1, row, col, end_row, end_col, up, weight
                        )
                    else:
                        _add_clipped_line(
                            col_runs, col_steps, cols, rows, row, col, end_row, end_col, weight
                        )
                elif across:
                    if inside:
                        add_line(
                            row_runs,
                            row_steps,
                            cols + 1,
                            col,
                            row,
                            end_col,
                            end_row,
                            across,
                            weight,
                        )
                    else:
                        _add_clipped_line(
                            row_runs, row_steps, rows, cols, col, row, end_col, end_row, weight
                        )
                if part < parts:
                    if part == 1:
                        c = b + 1 if b + 1 < beams else 0
                        step_x, step_y = (ends_x[s, c] - x) // parts, (ends_y[s, c] - y) // parts
                    x, y = x + step_x, y + step_y
                    col = ((3 * origins[s, k, 0] + 5 * x) >> (CELL_SHIFT + 3)) - left
                    row = ((3 * origins[s, k, 1] + 5 * y) >> (CELL_SHIFT + 3)) - bottom
                    weight = BETWEEN


@kernel
def add_line(
    runs: Int32,
    steps: Int32,
    stride: int,
    u0: int,
    v0: int,
    u1: int,
    v1: int,
    cells: int,
    weight: int,
) -> None:
    """Note the first cells of a line from (u0, v0) to (u1, v1) in the window; u is its major axis.

    After i of its n cells along u the line has made floor((2 i m + n) / (2 n)) of its m steps, so
    step j comes at i = ceil(n (2 j - 1) / (2 m)). The place of a step advances by n / m along the
    row and by one row: both in one fixed-point number. Its fraction is cut below by less than
    (m + 1) / 2^36, and 1 / (2 m) is the least that separates it from the next whole number, so
    the steps are exact in every window of fewer than 2^27 cells and 2^17 rows and columns.
    """
    n, m = abs(u1 - u0), abs(v1 - v0)
    made = m if cells == n else (2 * cells * m + n) // (2 * n)
    v_end = v0 + made if v1 > v0 else v0 - made
    if u1 > u0:
        runs[np.uint64(v0 * stride + u0)] += weight
        runs[np.uint64(v_end * stride + u0 + cells)] -= weight
        first, change = u0 + 1, weight
    else:
        runs[np.uint64(v_end * stride + u0 - cells + 1)] += weight
        runs[np.uint64(v0 * stride + u0 + 1)] -= weight
        first, change = u0, -weight
    if made == 0:
        return
    slope = (n << FRACTION_BITS) // m
    place = (slope >> 1) - 1
    if change < 0:  # walking left, a step lies one cell to the right of where it is made
        place, slope = (1 << FRACTION_BITS) - 1 - place, -slope
    if v1 > v0:
        place += ((v0 + 1) * stride + first) << FRACTION_BITS
        slope += stride << FRACTION_BITS
    else:
        place += (v0 * stride + first) << FRACTION_BITS
        slope -= stride << FRACTION_BITS
        change = -change
    for _ in range(made):
        steps[np.uint64(place) >> np.uint64(FRACTION_BITS)] += change
        place += slope


@kernel
def _add_clipped_line(
    runs: Int32,
    steps: Int32,
    height: int,
    width: int,
    u0: int,
    v0: int,
    u1: int,
    v1: int,
    weight: int,
) -> None:
    """Note what the window has of a line: rows outside are left out, columns count at its edge."""
    stride, right = width + 1, int(u1 < u0)
    n, m = abs(u1 - u0), abs(v1 - v0)
    u_sign, v_sign = 1 - 2 * right, (1 if v1 > v0 else -1)
    change = u_sign * weight
    if 0 <= v0 < height:
        runs[v0 * stride + min(max(u0 + right, 0), width)] += change
    if 0 <= v1 < height:
        runs[v1 * stride + min(max(u1 + right, 0), width)] -= change
    v_first = v0 + 1 if v1 > v0 else v0
    for j in range(1, m + 1):
        v = v_first + v_sign * (j - 1)
        if 0 <= v <= height:
            u = u0 + right + u_sign * ((n * (2 * j - 1) + 2 * m - 1) // (2 * m))
            steps[v * stride + min(max(u, 0), width)] += change * v_sign


@kernel
def sum_beams(
    changes: Changes,
    shape: tuple[int, int],
    first: tuple[int, int],
    misses: Int32,
) -> None:
    """Turn what `trace_beams` noted into misses.

    Parameters
    ----------
    shape
        Rows and columns of the window.
    first
        Row and column from which on `misses` is wanted; nothing was noted before them.
    misses
        (h, w) counts, written here.
    """
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    rows, cols = misses.shape
    for row in range(rows):
        count = np.int32(0)
        for col in range(cols):
            here = (first[0] + row) * (shape[1] + 1) + first[1] + col
            count += row_runs[here] + row_steps[here] - row_steps[here + shape[1] + 1]
            misses[row, col] = count
    counts = np.empty(BLOCK, np.int32)
    for start in range(0, cols, BLOCK):  # so that a few columns at a time stay in the cache
        counts[:] = 0
        for row in range(rows):
            for col in range(start, min(start + BLOCK, cols)):
                here = (first[1] + col) * (shape[0] + 1) + first[0] + row
                counts[col - start] += (
                    col_runs[here] + col_steps[here] - col_steps[here + shape[0] + 1]
                )
                misses[row, col] += counts[col - start]
