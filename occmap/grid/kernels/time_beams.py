"""When cells were observed, by the beam update: every beam is followed cell by cell.

For each cell of a window two numbers are kept that only grow, so that a maximum is all it takes to
note a scan and 0 says that there was none: a scan's `early` falls with its time, its `late` rises.
Which cells a slice of time hit, and which it saw, are bits: 64 columns a word.
"""

import numpy as np

from occmap.grid.kernels.jit import kernel
from occmap.grid.kernels.units import CELL_SHIFT, HALF_CELL, HIT, SKIP
from occmap.types import Float32, Float64, Int32, Int64, UInt8, UInt64


@kernel
def mark_cell(times: UInt64, seen: UInt64, row: int, col: int, early: int, late: int) -> None:
    """Note that a cell of the window was seen."""
    r, c = np.uint64(row), np.uint64(col)
    times[r, c, 0] = max(times[r, c, 0], early)
    times[r, c, 1] = max(times[r, c, 1], late)
    set_bit(seen, row, col)


@kernel
def set_bit(bits: UInt64, row: int, col: int) -> None:
    """Set a cell's bit."""
    bits[np.uint64(row), np.uint64(col >> 6)] |= np.uint64(1) << np.uint64(col & 63)


@kernel
def time_beams(
    origins: Int64,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    stamps: UInt64,
    corner: Int64,
    times: UInt64,
    hit: UInt64,
    seen: UInt64,
) -> None:
    """Note when every beam observed the cells of its line: those that `trace_beams` counts.

    Parameters
    ----------
    origins, ends_x, ends_y, kinds
        (S, K, 2) and (S, B) in lattice units from an anchor; (S, B) of Kind.
    stamps
        (S, 2) early and late.
    corner
        (2,) x and y of the window's corner in lattice units from the anchor.
    times, hit, seen
        (H, W, 2) early and late; (H, W / 64) bits, of the scans' slice of time.
    """
    scans, beams = kinds.shape
    viewpoints = origins.shape[1]
    rows, cols = times.shape[0], times.shape[1]
    left, bottom = corner[0] >> CELL_SHIFT, corner[1] >> CELL_SHIFT
    for s in range(scans):
        early, late = stamps[s, 0], stamps[s, 1]
        for b in range(beams):
            if kinds[s, b] == SKIP:
                continue
            k = b if viewpoints > 1 else 0
            col = (origins[s, k, 0] >> CELL_SHIFT) - left
            row = (origins[s, k, 1] >> CELL_SHIFT) - bottom
            end_col = (ends_x[s, b] >> CELL_SHIFT) - left
            end_row = (ends_y[s, b] >> CELL_SHIFT) - bottom
            if kinds[s, b] == HIT and 0 <= end_row < rows and 0 <= end_col < cols:
                set_bit(hit, end_row, end_col)
            across, up = abs(end_col - col), abs(end_row - row)
            right, rise = (1 if end_col > col else -1), (1 if end_row > row else -1)
            steep = up > across
            n, m = (up, across) if steep else (across, up)
            error = n
            for _ in range(n + 1):
                if 0 <= row < rows and 0 <= col < cols:
                    mark_cell(times, seen, row, col, early, late)
                error += 2 * m
                aside = error >= 2 * n
                error -= 2 * n * aside
                col += right * (aside if steep else 1)
                row += rise * (1 if steep else aside)


@kernel
def time_radial_beams(
    origins: Int64,
    ends_x: Int32,
    ends_y: Int32,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    stamps: UInt64,
    corner: Int64,
    units_per_metre: float,
    depth: float,
    times: UInt64,
    seen: UInt64,
) -> None:
    """Note when every beam said something about the cells of its line.

    Those are the cells that `trace_radial_beams` counts as observed: before `depth` before the
    range and, where the beam hit something, up to `depth` behind it.

    Parameters
    ----------
    origins, ends_x, ends_y, turn, bearing, distance, kinds, corner, units_per_metre, depth
        As for `trace_radial_beams`.
    stamps, times, seen
        As for `time_beams`.
    """
    scans, beams = kinds.shape
    viewpoints, turns = origins.shape[1], turn.shape[1]
    rows, cols = times.shape[0], times.shape[1]
    for s in range(scans):
        early, late = stamps[s, 0], stamps[s, 1]
        for b in range(beams):
            if kinds[s, b] == SKIP:
                continue
            k, t = min(b, viewpoints - 1), min(b, turns - 1)
            along_x = turn[s, t, 0, 0] * bearing[0, b] + turn[s, t, 0, 1] * bearing[1, b]
            along_y = turn[s, t, 1, 0] * bearing[0, b] + turn[s, t, 1, 1] * bearing[1, b]
            length = np.sqrt(along_x * along_x + along_y * along_y)
            r = distance[s, b] * length * units_per_metre
            before = max(r - depth, 0.0)
            until, is_hit = before * before, kinds[s, b] == HIT
            x, y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
            col, row = x >> CELL_SHIFT, y >> CELL_SHIFT
            end_col = (ends_x[s, b] - corner[0]) >> CELL_SHIFT
            end_row = (ends_y[s, b] - corner[1]) >> CELL_SHIFT
            across, up = abs(end_col - col), abs(end_row - row)
            right, rise = (1 if end_col > col else -1), (1 if end_row > row else -1)
            steep = up > across
            n, m = (up, across) if steep else (across, up)
            error = n
            for _ in range(n + 1):
                if 0 <= row < rows and 0 <= col < cols:
                    from_x = (col << CELL_SHIFT) + HALF_CELL - x
                    from_y = (row << CELL_SHIFT) + HALF_CELL - y
                    squared = float(from_x * from_x + from_y * from_y)
                    if squared < until or (is_hit and abs(np.sqrt(squared) - r) <= depth):
                        mark_cell(times, seen, row, col, early, late)
                error += 2 * m
                aside = error >= 2 * n
                error -= 2 * n * aside
                col += right * (aside if steep else 1)
                row += rise * (1 if steep else aside)
