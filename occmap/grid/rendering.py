"""Makes one dense grid of sparse tiles, with hits spread to the cells around, and frames it."""

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np

from occmap.cells import Box, CellBox, Key
from occmap.choices import check_bounds, make_box_form, option
from occmap.errors import MapError, require
from occmap.grid import FARTHEST_UNIT, Lattice
from occmap.grid.tiles import TILE, CellNumbers, EvidenceKind, TileGrid, refuse_large
from occmap.report import write_metres
from occmap.types import Bool, Kind, Rays


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

    def find_box(self, key: Key) -> CellBox | None:
        """The smallest box around the cells that a tile speaks for."""
        seen, (row, col) = super().find_box(key), key
        hit = CellBox.around(self.tiles[key][0] != 0, row * TILE, col * TILE)
        return seen.join(hit.grow(1)) if seen and hit else seen


NOTHING_LEFT = "no observation is left, as where all were subtracted: there is no map"


def find_bounds(tiles: TileGrid) -> CellBox:
    """The smallest box around all observed cells.

    Raises
    ------
    MapError
        Nothing was observed.
    """
    if box := measure_bounds(tiles):
        return box
    raise MapError(NOTHING_LEFT)


def measure_bounds(tiles: TileGrid) -> CellBox | None:
    """The smallest box around all observed cells; None: there are none."""
    if not tiles.tiles:
        return None
    rows, cols = ({min(places), max(places)} for places in zip(*tiles.tiles, strict=True))
    # Only these can lie on the edge of the map.
    edge = [key for key in tiles.tiles if key[0] in rows or key[1] in cols]
    found = list(filter(None, map(tiles.find_box, edge)))
    return reduce(CellBox.join, found) if found else None


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


CELL_SLACK = 1e-6
"""In cells: 0.15 m is three cells of 0.05 m, whatever floats say."""
FARTHEST_M = 1e8
"""Twice around the Earth; a bound refuses nan and inf, too."""
BOUNDING_BEAMS = 4
"""So many beams of each scan show how far a map reaches: a few, as all would cost time."""


@dataclass(frozen=True)
class Framing:
    """What a map shows; without a choice it is what was observed. Evidence stays whole.

    Raises
    ------
    UsageError
        A value is out of its range, or both are given.
    """

    extent: Box | None = option(
        None,
        "Cover exactly this box (m), to whole cells; by default what was observed. An .npz holds "
        "everything in any case.",
        metavar="X_MIN,Y_MIN,X_MAX,Y_MAX",
        form=make_box_form("0,0,5,4"),
    )
    margin: float = option(
        0.0, "Add unknown space around what was observed.", unit="m", bounds=(0, FARTHEST_M)
    )

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.extent is None:
            return
        found = "`margin` and `extent` exclude each other"
        require(not self.margin, found, "leave out `margin` or `extent`")
        x_min, y_min, x_max, y_max = self.extent
        fix = "write x_min,y_min,x_max,y_max in metres, such as 0,0,5,4"
        is_box = x_min < x_max and y_min < y_max
        require(is_box, f"the extent {self.extent} is not a box", fix)
        found = f"the extent {self.extent} reaches too far"
        is_near = max(map(abs, self.extent)) <= FARTHEST_M
        require(is_near, found, f"give numbers up to {FARTHEST_M:g}, in metres")


def choose_box(whole: CellBox, framing: Framing, lattice: Lattice) -> CellBox:
    """Choose the cells that a map covers, where `whole` is the box of observed cells.

    Raises
    ------
    MapError
        The extent does not touch that box.
    """
    size = lattice.resolution
    if framing.extent is None:
        return whole.grow(math.ceil(framing.margin / size - CELL_SLACK))
    x_min, y_min, x_max, y_max = (edge / size for edge in framing.extent)
    row, col = math.floor(y_min + CELL_SLACK), math.floor(x_min + CELL_SLACK)
    row_end, col_end = math.ceil(y_max - CELL_SLACK), math.ceil(x_max - CELL_SLACK)
    box = CellBox(row, col, max(row_end, row + 1), max(col_end, col + 1))
    if not whole.clip(box).cells:
        reach = ", ".join(write_metres(lattice.measure(whole)))
        raise MapError("no cell of the map lies in `extent`", fix=f"the map's own box is {reach}")
    return box


class Reach:
    """How far a map reaches at least: the box around the ends of some hits.

    It grows in the order of the scans. So a map that is too large is refused at the same scan and
    in the same words, whichever threads trace them.
    """

    def __init__(self, lattice: Lattice, max_cells: int) -> None:
        self._lattice = lattice
        self._max_cells = max_cells
        self._box: CellBox | None = None

    def stretch(self, rays: Rays) -> None:
        """Take in more scans.

        Raises
        ------
        MapError
            What they hit makes the map too large.
        """
        some = rays.thin(max(rays.kind.shape[1] // BOUNDING_BEAMS, 1))
        hits = some.end[some.kind == Kind.HIT]
        farthest = float(np.abs(hits).max(initial=0.0))
        if not len(hits) or not farthest * self._lattice.units_per_metre < FARTHEST_UNIT:
            return  # the engine refuses a sensor that is so far away
        box = self._lattice.enclose(hits)
        self._box = box = self._box.join(box) if self._box else box
        surely = box.grow(-TILE)  # a hit is moved, and rounded, by some cells
        if surely.rows > 0 and surely.cells > self._max_cells:
            refuse_large(box, self._lattice, self._max_cells)
