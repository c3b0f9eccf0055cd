"""What part of the plane a map covers: what was observed, with a margin around it, or a box.

While a map is built, `Reach` says how large it is going to be at least.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from occmap.cells import Box, OccupancyMap, to_log_odds
from occmap.choices import check_bounds, option
from occmap.choices.values import make_box_form
from occmap.errors import MapError, require
from occmap.grid.lattice import FARTHEST_UNIT, CellBox, Lattice
from occmap.grid.tiles import TILE, refuse_large
from occmap.report.words import write_metres
from occmap.types import Kind, Rays

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
        form=make_box_form("(0, 0, 5, 4)"),
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


def frame(grid: OccupancyMap, framing: Framing, prior: float, max_cells: int) -> OccupancyMap:
    """Cut a map to the box that it is to cover; cells beyond what was observed are unknown.

    Parameters
    ----------
    prior
        The probability of occupied that unknown cells have.

    Raises
    ------
    MapError
        The extent touches no cell of the map, or has too many.
    """
    if framing == Framing():
        return grid
    lattice = Lattice(grid.resolution)
    whole = CellBox.of(grid)
    box = choose_box(whole, framing, lattice)
    refuse_large(box, lattice, max_cells)
    shared = whole.clip(box)
    log_odds = np.full(box.shape, to_log_odds(prior), np.float32)
    observed = np.zeros(box.shape, np.bool_)
    inside, own = shared.within(box), shared.within(whole)
    log_odds[inside], observed[inside] = grid.log_odds[own], grid.observed[own]
    return replace(grid, log_odds=log_odds, observed=observed, origin=lattice.measure(box)[:2])


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
