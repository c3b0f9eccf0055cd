"""Makes one dense grid of sparse tiles, and spreads hits to the cells around them."""

from collections.abc import Callable, Collection, Iterator
from itertools import product
from typing import TypeAlias

import numpy as np

from occmap.arrays import Bool, Float32, Float64
from occmap.errors import MapError
from occmap.grid.lattice import CellBox
from occmap.grid.tiles import TILE, CellNumbers, EvidenceKind, Key, TileGrid

Part: TypeAlias = tuple[slice, slice]
"""Rows and columns."""
ENDS: dict[int, int | slice] = {-1: 0, 0: slice(None), 1: -1}
"""The rows, or columns, of a tile that touch the tile before it (-1) or after it (1); 0: all"""
RIM = TILE + 2
"""Cells along the side of a tile with those around it."""


class SpreadHits(TileGrid):
    """A grid of hits and misses in which a hit speaks for the cells around it as well.

    Poses and ranges are a cell off at times; so a hit counts a `share` of itself for each of the
    four cells beside it, and the square of that for each of the four at its corners.
    """

    def __init__(self, grid: TileGrid, share: float) -> None:
        super().__init__(grid.lattice, grid.kind, grid.unit)
        self.tiles, self.share = grid.tiles, share

    @property
    def keys(self) -> Collection[Key]:
        """Row and column of each tile that has observations, or lies beside a hit."""
        reached = set(self.tiles)
        for (row, col), (hits, _) in self.tiles.items():
            for (up, rows), (right, cols) in product(ENDS.items(), repeat=2):
                if hits[rows, cols].any():
                    reached.add((row + up, col + right))
        return reached

    def read(self, key: Key) -> CellNumbers:
        """The numbers of a tile's cells; the misses are the grid's own."""
        hits = self._gather(key) / self.unit
        beside = hits[1:-1] + self.share * (hits[:-2] + hits[2:])
        spread = beside[:, 1:-1] + self.share * (beside[:, :-2] + beside[:, 2:])
        tile = self.tiles.get(key)
        misses = np.zeros((TILE, TILE)) if tile is None else tile[1] / self.unit
        return spread, misses

    def _gather(self, key: Key) -> Float64:
        """(RIM, RIM) hits of a tile and of the cells around it."""
        hits = np.zeros((RIM, RIM))
        here, before, after = slice(1, -1), slice(0, 1), slice(RIM - 1, RIM)
        whole, last, first = slice(None), slice(-1, None), slice(0, 1)
        places = ((-1, before, last), (0, here, whole), (1, after, first))
        for up, to_row, from_row in places:
            for right, to_col, from_col in places:
                tile = self.tiles.get((key[0] + up, key[1] + right))
                if tile is not None:
                    hits[to_row, to_col] = tile[0, from_row, from_col]
        return hits


def find_bounds(tiles: TileGrid) -> CellBox:
    """The smallest box around all observed cells.

    Raises
    ------
    MapError
        Nothing was observed.
    """
    if box := measure_bounds(tiles):
        return box
    raise MapError("no beam of any scan observed a cell, so there is no map")


def measure_bounds(tiles: TileGrid) -> CellBox | None:
    """The smallest box around all observed cells; None: there are none."""
    if not (keys := tiles.keys):
        return None
    rows, cols = ({min(places), max(places)} for places in zip(*keys, strict=True))
    box: CellBox | None = None
    for row, col in keys:
        if row in rows or col in cols:  # only these can lie on the edge of the map
            seen = tiles.observed(*tiles.read((row, col)))
            if part := CellBox.around(seen, row * TILE, col * TILE):
                box = part if box is None else box.join(part)
    return box


def paint(
    tiles: TileGrid, log_odds: Callable[[Float64, Float64], Float64], prior: float, box: CellBox
) -> tuple[Float32, Bool]:
    """Let a model say what the numbers mean, cell by cell.

    Parameters
    ----------
    log_odds
        Of (N,) first and second numbers of observed cells.
    prior
        Log-odds of a cell that nothing observed.
    box
        The cells to paint.

    Returns
    -------
    log_odds, observed
        (H, W) each, of the cells of the box.
    """
    grid = np.full((box.rows, box.cols), prior, np.float32)
    observed = np.zeros((box.rows, box.cols), np.bool_)
    for key, inner, outer in _list_overlaps(tiles, box):
        first, second = (numbers[inner] for numbers in tiles.read(key))
        seen = tiles.observed(first, second)
        observed[outer] = seen
        grid[outer][seen] = log_odds(first[seen], second[seen])
    return grid, observed


def read_cells(tiles: TileGrid, box: CellBox) -> Float64:
    """(2, H, W): the two numbers of each cell of a box, in observations."""
    cells = np.zeros((2, box.rows, box.cols))
    for key, inner, outer in _list_overlaps(tiles, box):
        for layer, numbers in zip(cells, tiles.read(key), strict=True):
            layer[outer] = numbers[inner]
    return cells


def _list_overlaps(tiles: TileGrid, box: CellBox) -> Iterator[tuple[Key, Part, Part]]:
    """List the tiles that lie in a box, and where: as part of the tile, and as part of the box."""
    for key in tiles.keys:
        tile = CellBox.at(*key).scale(TILE)
        shared = box.clip(tile)
        if shared.cells:
            yield key, shared.within(tile), shared.within(box)


def count_agreeing(grid: TileGrid, occupied: Bool, box: CellBox) -> tuple[int, int]:
    """Hits in the cells of a box that are called occupied (H, W), and in all of them.

    Their share is what a map says of its own poses. Both are 0 where the evidence keeps no hits.
    """
    if grid.kind is not EvidenceKind.COUNTS:
        return 0, 0
    total = agreed = 0
    for key, inner, outer in _list_overlaps(grid, box):
        hits = grid.tiles[key][0]
        total += int(hits[inner].sum())
        agreed += int(hits[inner][occupied[outer]].sum())
    return agreed, total
