"""Makes one dense grid of sparse tiles, and spreads hits to the cells around them."""

from collections.abc import Callable

import numpy as np

from occmap.errors import MapError
from occmap.grid.lattice import CellBox
from occmap.grid.tiles import TILE, CellNumbers, EvidenceKind, TileGrid
from occmap.types import Bool, Float32, Float64


class SpreadHits(TileGrid):
    """A grid of hits and misses in which a hit speaks for the cells around it as well.

    Poses and ranges are a cell off at times; so a hit counts a `share` of itself for each of the
    four cells beside it, and the square of that for each of the four at its corners.
    """

    def __init__(self, grid: TileGrid, share: float) -> None:
        super().__init__(grid.lattice, grid.kind, grid.unit)
        self.tiles, self.share = grid.tiles, share

    def read(self, box: CellBox) -> CellNumbers:
        """The numbers of the cells of a box; the misses are the grid's own."""
        hits, misses = super().read(box.grow(1))
        beside = hits[1:-1] + self.share * (hits[:-2] + hits[2:])
        spread = beside[:, 1:-1] + self.share * (beside[:, :-2] + beside[:, 2:])
        return spread, misses[1:-1, 1:-1]


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
    if not tiles.tiles:
        return None
    rows, cols = ({min(places), max(places)} for places in zip(*tiles.tiles, strict=True))
    box: CellBox | None = None
    for row, col in tiles.tiles:
        if row in rows or col in cols:  # only these can lie on the edge of the map
            around = CellBox.at(row, col).scale(TILE).grow(1)  # as far as a hit speaks
            seen = tiles.observed(*tiles.read(around))
            if part := CellBox.around(seen, around.row, around.col):
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
    for part in tiles.list_parts(box):
        first, second = tiles.read(part)
        seen, inside = tiles.observed(first, second), part.within(box)
        observed[inside] = seen
        grid[inside][seen] = log_odds(first[seen], second[seen])
    return grid, observed


def count_agreeing(grid: TileGrid, occupied: Bool, box: CellBox) -> tuple[int, int]:
    """Hits in the cells of a box that are called occupied (H, W), and in all of them.

    Their share is what a map says of its own poses. Both are 0 where the evidence keeps no hits.
    """
    if grid.kind is not EvidenceKind.COUNTS:
        return 0, 0
    total = agreed = 0
    for part in grid.list_parts(box):
        hits, _ = grid.gather(part)
        total += int(hits.sum())
        agreed += int(hits[occupied[part.within(box)]].sum())
    return agreed, total
