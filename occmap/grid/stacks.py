"""Tiles as one array, for files and sums; it imports no numba."""

from collections.abc import Mapping

import numpy as np

from occmap.errors import MapError
from occmap.grid.tiles import INT32_LIMIT, TILE, Key, Tile, TileGrid
from occmap.types import MOST_OBSERVED, Int64


def stack_tiles(tiles: Mapping[Key, Tile]) -> tuple[Int64, Int64]:
    """Row and column of each tile (T, 2), in ascending order, and their cells (T, 2, 64, 64).

    These are 64 bits wide only where a number needs it.
    """
    keys = sorted(tiles)
    fits = all(t.min() >= -INT32_LIMIT and t.max() <= INT32_LIMIT for t in tiles.values())
    cells = np.empty((len(keys), 2, TILE, TILE), np.int32 if fits else np.int64)
    for place, key in enumerate(keys):
        cells[place] = tiles[key]
    return np.array(keys, np.int64).reshape(-1, 2), cells


def view_tiles(tiles: Int64, cells: Int64) -> dict[Key, Tile]:
    """Stacked tiles by their places; they share the stack's memory."""
    return {(row, col): tile for (row, col), tile in zip(tiles.tolist(), cells, strict=True)}


def add_stack(grid: TileGrid, tiles: Int64, cells: Int64) -> None:
    """Add stacked tiles to a grid; a sum is 64 bits wide, and no tile is shared with the stack.

    Raises
    ------
    MapError
        A sum is more than evidence may hold.
    """
    for key, tile in view_tiles(tiles, cells).items():
        known = grid.tiles.get(key)
        wide = tile.astype(np.int64)
        total = grid.tiles[key] = wide if known is None else known + wide
        if max(-int(total.min()), int(total.max())) > MOST_OBSERVED:
            raise MapError(
                f"the observations of a cell add up to more than {MOST_OBSERVED:,}",
                fix="no log holds so many: build the evidence again from its logs",
            )


def drop_empty(grid: TileGrid) -> None:
    """Forget tiles in which nothing is observed any more."""
    for key in [key for key, tile in grid.tiles.items() if not tile.any()]:
        del grid.tiles[key]
