"""The polygon update: a whole scan at once, its measured cells the border, the inside free.

The inside is not visited: a span of free cells is +1 at its first column and -1 after its last,
and one running sum along the rows turns thousands of scans' spans into counts. The cost of a scan
is thus its border. A border cell gets no miss from its own scan, so one that lies in a span is
taken out of it again.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.arrays import Int32
from occmap.grid.kernels.fill import PADDING, cross_rows, find_rows, make_spans
from occmap.grid.kernels.jit import kernel
from occmap.grid.kernels.project import round_to_units
from occmap.types import Bool, Float32, Float64, Int64, UInt8


class Surfaces(NamedTuple):
    """Which neighbouring beams see one surface, and the lattice that they are on."""

    units_per_metre: float
    """Of the lattice"""
    jump: float
    """Neighbours see one surface where their ranges differ by at most this (m)"""
    border_gap: int
    """... and the border is closed between their end cells where these are at most so far apart"""
    full_circle: bool
    """The last beam and the first are neighbours"""
    left: int
    """x of the window's corner (lattice units)"""
    bottom: int
    """y of the window's corner (lattice units)"""
    shift_x: int
    """x of the anchor of the ends of beams, from the window's corner (lattice units)"""
    shift_y: int
    """y of the same"""


@kernel
def trace_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    surfaces: Surfaces,
    hits: Int32,
    runs: Int32,
    marks: Int32,
    mark: int,
) -> None:
    """Note every scan's border and inside.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, 1, 2), (S, K, 2, 2), (2, B), (S, B), (S, B) as in `Rays`.
    ends_x, ends_y
        (S, B) lattice units from the anchor.
    hits, runs, marks
        (H, W) counts; H x (W + 1), flat, changes of the misses along rows; H x W, flat, the last
        scan whose border a cell was in, counted from `mark` + 1, none above `mark` before.
    """
    scans, beams = kinds.shape
    rows, cols = hits.shape
    x, y = np.empty(2 * beams + 4, np.int64), np.empty(2 * beams + 4, np.int64)
    begins = np.empty(2 * beams + 4, np.bool_)
    buckets, counts = np.empty((rows, 32), np.int32), np.empty(rows, np.int64)
    border = np.empty((beams * (surfaces.border_gap + 1), 2), np.int32)
    for s in range(scans):
        corners = outline_scan(
            origin[s, 0], turn[s], bearing, distance[s], ends_x[s], ends_y[s], kinds[s],
            surfaces, x, y, begins,
        )  # fmt: skip
        touched = find_rows(y, corners, rows)
        while not cross_rows(x, y, begins, corners, touched, buckets, counts):
            buckets = np.empty((rows, 2 * buckets.shape[1]), np.int32)
        make_spans(touched, buckets, counts, cols)
        _note_spans(touched, buckets, counts, cols, runs)
        listed = _mark_border(
            distance[s], ends_x[s], ends_y[s], kinds[s], surfaces, hits, marks, mark + s + 1,
            border,
        )  # fmt: skip
        _exempt_border(border, listed, buckets, counts, cols, runs)


@kernel
def outline_scan(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    surfaces: Surfaces,
    x: Int64,
    y: Int64,
    begins: Bool,
) -> int:
    """Write the corners of one scan's regions: one for each run of beams that are not SKIP.

    A region is closed through the sensor or, where a full circle has all its beams, on itself: the
    first corner is written again as its last. Returns the number of corners.
    """
    beams = kinds.size
    at_x = round_to_units(origin[0], surfaces.units_per_metre) - surfaces.left
    at_y = round_to_units(origin[1], surfaces.units_per_metre) - surfaces.bottom
    gap = _find_skip(kinds) if surfaces.full_circle else beams
    closed = surfaces.full_circle and gap == beams
    first = 0 if gap == beams else gap
    corners = 0
    drawing = False
    for i in range(first, first + beams + int(closed)):
        b = i if i < beams else i - beams
        if kinds[b] == 0:
            if drawing:
                corners = _add_corner(x, y, begins, corners, at_x, at_y, False)
            drawing = False
            continue
        a = b - 1 if b > 0 else beams - 1
        if not drawing and not closed:
            corners = _add_corner(x, y, begins, corners, at_x, at_y, True)
        elif drawing and abs(np.float64(distance[b]) - distance[a]) > surfaces.jump:
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
                x, y, begins, corners, step_x - surfaces.left, step_y - surfaces.bottom, False
            )
        corners = _add_corner(
            x, y, begins, corners, ends_x[b] + surfaces.shift_x, ends_y[b] + surfaces.shift_y,
            closed and not drawing,
        )  # fmt: skip
        drawing = True
    if drawing and not closed:
        corners = _add_corner(x, y, begins, corners, at_x, at_y, False)
    return corners


@kernel
def _find_skip(kinds: UInt8) -> int:
    """The first SKIP beam, or the number of beams where there is none."""
    for b in range(kinds.size):
        if kinds[b] == 0:
            return b
    return kinds.size


@kernel
def _add_corner(
    x: Int64, y: Int64, begins: Bool, corners: int, at_x: int, at_y: int, first: bool
) -> int:
    i = np.uint64(corners)
    x[i], y[i], begins[i] = at_x, at_y, first
    return corners + 1


@kernel
def _note_spans(
    touched: tuple[int, int], spans: Int32, counts: Int64, cols: int, runs: Int32
) -> None:
    """Note one miss for every cell of every span."""
    for row in range(touched[0], touched[1]):
        for i in range(0, counts[row], 2):
            start = row * (cols + 1)
            runs[np.uint64(start + spans[np.uint64(row), np.uint64(i)])] += 1
            runs[np.uint64(start + spans[np.uint64(row), np.uint64(i + 1)])] -= 1


@kernel
def _mark_border(
    distance: Float32,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    surfaces: Surfaces,
    hits: Int32,
    marks: Int32,
    mark: int,
    border: Int32,
) -> int:
    """Give every cell of one scan's border one hit, and list these cells of the window.

    `border` (N, 2) is written: rows and columns. Returns how many.
    """
    beams = kinds.size
    rows, cols = hits.shape
    shift_col, shift_row = surfaces.shift_x >> 8, surfaces.shift_y >> 8
    listed = 0
    beside = surfaces.full_circle and kinds[beams - 1] == 2
    from_col, from_row = ends_x[beams - 1] >> 8, ends_y[beams - 1] >> 8
    for b in range(beams):
        col, row = ends_x[b] >> 8, ends_y[b] >> 8
        if kinds[b] == 2:
            across, up = col - from_col, row - from_row
            n = max(abs(across), abs(up))
            if not (
                beside
                and n <= surfaces.border_gap
                and abs(np.float64(distance[b]) - distance[b - 1]) <= surfaces.jump
            ):
                n = 1
            # From the end cell back along the Bresenham line, up to the neighbour's own.
            for i in range(max(n, 1)):
                c, r = col, row
                if i > 0:
                    c = col - _round_half_down(i * across, n)
                    r = row - _round_half_down(i * up, n)
                c, r = c + shift_col, r + shift_row
                if 0 <= r < rows and 0 <= c < cols:
                    # No branches: whether neighbours share a cell is a coin toss to a processor.
                    place = np.uint64(r * cols + c)
                    is_new = marks[place] != mark
                    marks[place] = mark
                    hits[np.uint64(r), np.uint64(c)] += is_new
                    border[np.uint64(listed), 0], border[np.uint64(listed), 1] = r, c
                    listed += is_new
        beside = kinds[b] == 2
        from_col, from_row = col, row
    return listed


@kernel
def _round_half_down(numerator: int, denominator: int) -> int:
    """Divide, rounding a half towards zero: seen from a line's end, Bresenham's rounding."""
    size = (2 * abs(numerator) + denominator - 1) // (2 * denominator)
    return size if numerator > 0 else -size


@kernel
def _exempt_border(
    border: Int32, listed: int, spans: Int32, counts: Int64, cols: int, runs: Int32
) -> None:
    """Take the miss back from the listed cells that lie in a span."""
    for n in range(listed):
        row, col = np.uint64(border[n, 0]), border[n, 1]
        # In a span where the number of limits at or left of the cell is odd.
        passed = np.int32(0)
        for i in range(PADDING):
            passed += spans[row, np.uint64(i)] <= col
        for i in range(PADDING, counts[row]):
            passed += spans[row, np.uint64(i)] <= col
        inside = passed & 1
        place = np.uint64(np.int64(border[n, 0]) * (cols + 1) + col)
        runs[place] -= inside
        runs[place + np.uint64(1)] += inside


@kernel
def sum_runs(runs: Int32, stride: int, first: tuple[int, int], misses: Int32) -> None:
    """Turn noted spans into counts: `misses` (h, w), from row and column `first` of the window."""
    rows, cols = misses.shape
    for row in range(rows):
        count = np.int32(0)
        for col in range(cols):
            count += runs[(first[0] + row) * stride + first[1] + col]
            misses[row, col] = count
