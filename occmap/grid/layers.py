"""Layers of times, one for each build of evidence; it imports no numba."""

from collections.abc import Iterable

import numpy as np

from occmap.grid.tiles import TILE, TileGrid
from occmap.grid.times import BITS, TileKey
from occmap.types import Bool, Int64, Times


def unpack_cells(times: Times) -> Bool:
    """(T, TILE, TILE): the cells that a layer has times of."""
    cells = np.unpackbits(times.observed, axis=1).view(np.bool_)
    return cells.reshape(-1, TILE, TILE)


def restrict(times: Times, grid: TileGrid) -> Times:
    """Forget the times of cells that a grid has no observation of."""
    cells = unpack_cells(times)
    still = np.zeros_like(cells)
    for index, (row, col) in enumerate(times.tiles.tolist()):
        tile = grid.tiles.get((row, col))
        if tile is not None:
            still[index] = cells[index] & grid.observed(*tile)
    there, kept = still.any(axis=(1, 2)), still[cells]
    return Times(
        times.tiles[there],
        np.packbits(still[there].reshape(-1, BITS), axis=1),
        times.first_ns[kept],
        times.last_ns[kept],
        times.hit_visits[kept],
        times.seen_visits[kept],
    )


def sum_visits(layers: Iterable[Times]) -> dict[TileKey, Int64]:
    """By tile: (2, TILE, TILE) visits that hit each cell, and visits that saw it, of all layers."""
    visits: dict[TileKey, Int64] = {}
    for times in layers:
        cells = unpack_cells(times)
        sums = np.zeros((2, *cells.shape), np.int64)
        sums[0][cells], sums[1][cells] = times.hit_visits, times.seen_visits
        for index, (row, col) in enumerate(times.tiles.tolist()):
            visits[row, col] = visits.get((row, col), 0) + sums[:, index]
    return visits


def find_cell(times: Times, row: int, col: int) -> int | None:
    """The place of a cell in the arrays of a layer; None where the build did not observe it."""
    found = np.flatnonzero((times.tiles == (row // TILE, col // TILE)).all(axis=1))
    bit = row % TILE * TILE + col % TILE
    if not len(found) or not np.unpackbits(times.observed[found[0]])[bit]:
        return None
    before = np.bitwise_count(times.observed[: found[0]]).sum(dtype=np.int64)
    return int(before + np.unpackbits(times.observed[found[0]])[:bit].sum(dtype=np.int64))
