"""From what was noted in a window to the two numbers of each of its cells, tile by tile."""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.units import PAD, TILE
from occmap.jit import kernel
from occmap.types import Int32, Int64


class Changes(NamedTuple):
    """What plain cells change along the rows of a window, and steep lines along its columns.

    All are flat; those of columns have no entry where nothing is noted along these.
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
    """What a plain cell is told each time"""


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
        (H, W + PAD) of whole tiles: packed sums of what cells were told that were visited.
    touched
        First row and column of tiles, and those after the last: nothing was noted elsewhere.
    keys, tiles
        (N, 2) row and column of each tile in the window, and (N, 2, TILE, TILE), written here.
    """
    row_counts = np.zeros(TILE, np.int32)
    col_counts = np.zeros(cells.shape[1], np.int32)
    size = 0
    for tile_row in range(touched[0], touched[2]):
        row_counts[:] = 0
        for tile_col in range(touched[1], touched[3]):
            row, col, tile = tile_row * TILE, tile_col * TILE, tiles[size]
            sum_changes(changes, cells.shape, row, col, row_counts, col_counts, tile[1])
            seen = False
            for r in range(TILE):
                for c in range(TILE):
                    told = cells[row + r, col + c] & packing.kept
                    told += tile[1, r, c] * packing.plain
                    tile[0, r, c] = told >> packing.bits
                    tile[1, r, c] = told & ((1 << packing.bits) - 1)
                    seen |= told != 0
            if seen:
                keys[size, 0], keys[size, 1] = tile_row, tile_col
                size += 1
    return size


@kernel
def sum_changes(
    changes: Changes,
    shape: tuple[int, int],
    row: int,
    col: int,
    row_counts: Int32,
    col_counts: Int32,
    plain: Int32 | Int64,
) -> None:
    """Write how often each cell of a tile was plain.

    `row_counts` (TILE,) and `col_counts` (W,) go on from the tile to the left and the one below.
    """
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    stride = shape[1]
    for r in range(TILE):
        count, here = row_counts[r], (row + r) * stride + col
        if row_steps.size:
            for c in range(TILE):
                count += row_runs[here + c] + row_steps[here + c] - row_steps[here + stride + c]
                plain[r, c] = count
        else:
            for c in range(TILE):
                count += row_runs[here + c]
                plain[r, c] = count
        row_counts[r] = count
    if col_runs.size:
        stride = shape[0] + PAD
        for c in range(TILE):
            count, here = col_counts[col + c], (col + c) * stride + row
            for r in range(TILE):
                count += col_runs[here + r] + col_steps[here + r] - col_steps[here + stride + r]
                plain[r, c] += count
            col_counts[col + c] = count
