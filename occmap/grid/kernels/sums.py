"""From what kernels wrote to a window to the two numbers of each cell, tile by tile."""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.units import PAD, TILE
from occmap.jit import kernel
from occmap.types import Int32, Int64


class Changes(NamedTuple):
    """How often cells were plain: changes along a window's rows, and of steep lines along columns.

    All are flat; those of columns are empty where a kernel writes to rows alone.
    """

    row_runs: Int32
    """H x (W + PAD)"""
    row_steps: Int32
    """(H + 1) x (W + PAD)"""
    col_runs: Int32
    """W x (H + PAD)"""
    col_steps: Int32
    """(W + 1) x (H + PAD)"""


@kernel
def read_tiles(
    cells: Int64,
    changes: Changes,
    packing: tuple[int, int, int],
    touched: tuple[int, int, int, int],
    keys: Int64,
    tiles: Int32 | Int64,
) -> int:
    """Write the tiles in which something was observed, and return how many these are.

    Parameters
    ----------
    cells
        (H, W + PAD) of whole tiles: packed sums of what visited cells got.
    packing
        How a cell's integer holds both of its numbers: how many of the lowest bits hold the second,
        with the first above them; the mask of bits that are evidence and no notes of a kernel; and
        what a plain cell gets each time.
    touched
        First row and column of tiles, and those after the last: nothing was written elsewhere.
    keys, tiles
        (N, 2) row and column of each tile in the window, and (N, 2, TILE, TILE), written here.
    """
    (bits, kept, entry), low = packing, (1 << packing[0]) - 1
    across, up = cells.shape[1], cells.shape[0] + PAD
    row_counts, col_counts = np.zeros(TILE, np.int32), np.zeros(across, np.int32)
    plain, runs, steps = np.empty((TILE, TILE), np.int32), changes.row_runs, changes.row_steps
    size = 0
    for tile_row in range(touched[0], touched[2]):
        row_counts[:] = 0
        for tile_col in range(touched[1], touched[3]):
            row, col, tile = tile_row * TILE, tile_col * TILE, tiles[size]
            plain[:] = 0
            sum_changes(runs, steps, row * across + col, across, row_counts, plain)
            if changes.col_runs.size:
                below = col_counts[col : col + TILE]
                sum_changes(changes.col_runs, changes.col_steps, col * up + row, up, below, plain.T)
            seen = 0
            for r in range(TILE):
                # Slices: numba cannot know that `col + c` is never negative.
                visited, first, second = cells[row + r, col : col + TILE], tile[0, r], tile[1, r]
                for c in range(TILE):
                    packed = (visited[c] & kept) + plain[r, c] * entry
                    first[c] = packed >> bits
                    second[c] = packed & low
                    seen |= packed
            if seen:
                keys[size, 0], keys[size, 1] = tile_row, tile_col
                size += 1
    return size


@kernel
def sum_changes(
    runs: Int32, steps: Int32, place: int, stride: int, counts: Int32, plain: Int32
) -> None:
    """Add how often each cell of a tile was plain, by the changes along rows, or along columns.

    The tile begins at `place`, and its next row `stride` further on; `counts` (TILE,) go on from
    the tile before it.
    """
    line = np.empty(TILE, np.int32)
    for r in range(TILE):
        here = place + r * stride
        begun, stepped = runs[here : here + TILE], steps[here : here + TILE]
        above = steps[here + stride : here + stride + TILE]
        for c in range(TILE):  # a loop of its own: many changes are added up at a time
            line[c] = begun[c] + (stepped[c] - above[c] if steps.size else 0)
        count = counts[r]
        for c in range(TILE):
            count += line[c]
            plain[r, c] += count
        counts[r] = count
