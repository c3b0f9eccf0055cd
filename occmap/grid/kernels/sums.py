"""From what kernels wrote to a window to the two numbers of each cell, tile by tile."""

from typing import NamedTuple

import numpy as np

from occmap.arrays import Int32, Int64
from occmap.grid.kernels.units import PAD, TILE
from occmap.jit import kernel


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


class Packing(NamedTuple):
    """How an integer of a cell holds both of its numbers."""

    bits: int
    """The second number is in the lowest bits, and the first above them"""
    kept: int
    """Mask of the bits that are evidence; the others are a kernel's own notes"""
    plain: int
    """What a plain cell gets each time"""


@kernel
def read_tiles(
    cells: Int64,
    changes: Changes,
    packing: Packing,
    touched: tuple[int, int, int, int],
    keys: Int64,
    tiles: Int32 | Int64,
) -> int:
    """Write the tiles in which something was observed, and return how many these are.

    Parameters
    ----------
    cells
        (H, W + PAD) of whole tiles: packed sums of what visited cells got.
    touched
        First row and column of tiles, and those after the last: nothing was written elsewhere.
    keys, tiles
        (N, 2) row and column of each tile in the window, and (N, 2, TILE, TILE), written here.
    """
    bits, kept, low = packing.bits, packing.kept, (1 << packing.bits) - 1
    row_counts = np.zeros(TILE, np.int32)
    col_counts = np.zeros(cells.shape[1], np.int32)
    plain = np.empty((TILE, TILE), np.int32)
    size = 0
    for tile_row in range(touched[0], touched[2]):
        row_counts[:] = 0
        for tile_col in range(touched[1], touched[3]):
            row, col, tile = tile_row * TILE, tile_col * TILE, tiles[size]
            sum_rows(changes, cells.shape[1], row, col, row_counts, plain)
            if changes.col_runs.size:
                sum_cols(changes, cells.shape[0] + PAD, row, col, col_counts, plain)
            seen = 0
            for r in range(TILE):
                # Slices: numba cannot know that `col + c` is never negative.
                visited, first, second = cells[row + r, col : col + TILE], tile[0, r], tile[1, r]
                for c in range(TILE):
                    packed = (visited[c] & kept) + plain[r, c] * packing.plain
                    first[c] = packed >> bits
                    second[c] = packed & low
                    seen |= packed
            if seen:
                keys[size, 0], keys[size, 1] = tile_row, tile_col
                size += 1
    return size


@kernel
def sum_rows(
    changes: Changes, stride: int, row: int, col: int, counts: Int32, plain: Int32
) -> None:
    """Write how often each cell of a tile was plain, by the changes along rows.

    `counts` (TILE,) go on from the tile to the left.
    """
    runs, steps = changes.row_runs, changes.row_steps
    for r in range(TILE):
        count, here = counts[r], np.uint64((row + r) * stride + col)
        above = here + np.uint64(stride)
        for c in range(TILE):
            count += runs[here]
            if steps.size:
                count += steps[here] - steps[above]
            plain[r, c] = count
            here += np.uint64(1)
            above += np.uint64(1)
        counts[r] = count


@kernel
def sum_cols(
    changes: Changes, stride: int, row: int, col: int, counts: Int32, plain: Int32
) -> None:
    """Add how often each cell of a tile was plain, by the changes along columns.

    `counts` (W,) go on from the tile below.
    """
    line = np.empty(TILE, np.int32)
    for c in range(col, col + TILE):
        here = c * stride + row
        runs, steps = changes.col_runs[here : here + TILE], changes.col_steps[here : here + TILE]
        right = changes.col_steps[here + stride : here + stride + TILE]
        for r in range(TILE):  # a loop of its own: many changes are added up at a time
            line[r] = runs[r] + steps[r] - right[r]
        count = counts[c]
        for r in range(TILE):
            count += line[r]
            plain[r, c - col] += count
        counts[c] = count
