"""Maps of evidence that is read block by block: memory is that of the map and of a few blocks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from occmap.errors import MapError
from occmap.evidence import choose_tiles, to_grid, weigh
from occmap.evidence.persistence import drop_passing, list_lost, refuse_nothing_left
from occmap.grid.framing import Framing, choose_box
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.rendering import count_agreeing, measure_bounds, paint
from occmap.grid.tiles import TileGrid, refuse_large
from occmap.sensor.models import SensorModel, find_decision
from occmap.store.blocks import Block
from occmap.store.sources import Blocks, Recent, read_part
from occmap.types import Box, OccupancyMap, to_log_odds

STRIPE = 3
"""Blocks are painted in stripes so many rows high, so that few of them are read twice"""


@dataclass(frozen=True, eq=False)
class View:
    """What is seen of evidence: by a model, and of what lasts."""

    source: Blocks
    model: SensorModel
    min_passes: int | None = None

    @cached_property
    def lattice(self) -> Lattice:
        """That of the map."""
        return Lattice(self.source.manifest.resolution)

    def read_grid(self, box: CellBox) -> TileGrid:
        """What lasts of the tiles in a box of cells and beside it."""
        evidence = read_part(self.source, box)
        grid = to_grid(evidence)
        if self.min_passes is None:
            return grid
        return drop_passing(grid, evidence.slices, self.min_passes)

    def paint(self, grid: TileGrid, box: CellBox) -> OccupancyMap:
        """The map of a box of cells."""
        tiles = choose_tiles(grid, self.model)
        painted = paint(tiles, weigh(self.model), to_log_odds(self.model.prior), box)
        origin = self.lattice.to_metres(box.col), self.lattice.to_metres(box.row)
        return OccupancyMap(*painted, self.lattice.resolution, origin, find_decision(self.model))

    def measure_bounds(self, block: Block) -> CellBox | None:
        """The smallest box around the cells that are observed in a block or beside it."""
        return measure_bounds(choose_tiles(self.read_grid(block.box), self.model))


def render_blocks(
    view: View, max_cells: int, part: Box | None = None
) -> tuple[OccupancyMap, list[str]]:
    """Make a map, or the part of it that a box touches; notes say where little of it lasts.

    Cell by cell it is the map of `render_lasting`. The agreement is that of the whole map, so a
    part has none.

    Raises
    ------
    MapError
        Nothing was observed, or lasts, or lies in the box; the map would be too large, or a block
        cannot be read.
    """
    view = replace(view, source=Recent(view.source))
    made = paint_part(view, max_cells, part)
    if view.min_passes is None:
        return made, []
    return made, list(list_lost(paint_part(replace(view, min_passes=None), max_cells, part), made))


def paint_part(view: View, max_cells: int, part: Box | None) -> OccupancyMap:
    """Paint a map, or the part of it that a box touches; raises MapError as `render_blocks`."""
    box = find_bounds(view)
    if part:
        box = choose_box(box, Framing(extent=part), view.lattice)
    refuse_large(box, view.lattice, max_cells)
    log_odds = np.full((box.rows, box.cols), to_log_odds(view.model.prior), np.float32)
    observed = np.zeros((box.rows, box.cols), np.bool_)
    hits = np.zeros(2, np.int64)
    for piece in list_pieces(view.source, box):
        grid = view.read_grid(piece)
        made = view.paint(grid, piece)
        rows = slice(piece.row - box.row, piece.row_end - box.row)
        cols = slice(piece.col - box.col, piece.col_end - box.col)
        log_odds[rows, cols], observed[rows, cols] = made.log_odds, made.observed
        hits += count_agreeing(grid, made.occupied, piece)
    agreed, total = hits.tolist()
    origin = view.lattice.to_metres(box.col), view.lattice.to_metres(box.row)
    decision, agreement = find_decision(view.model), agreed / total if total and not part else None
    return OccupancyMap(log_odds, observed, view.lattice.resolution, origin, decision, agreement)


def list_pieces(source: Blocks, box: CellBox) -> Iterator[CellBox]:
    """Cut a box where blocks begin; pieces far from all that was observed are left out."""
    beside = {
        Block(block.row + up, block.col + right)
        for block in source.blocks
        for up in (-1, 0, 1)
        for right in (-1, 0, 1)
    }
    for block in sorted(beside, key=lambda each: (each.row // STRIPE, each.col, each.row)):
        piece = box.clip(block.box)
        if piece.cells:
            yield piece


def find_bounds(view: View) -> CellBox:
    """The smallest box around all cells of a map, from the blocks on its edges alone.

    Raises
    ------
    MapError
        Nothing was observed, or lasts.
    """
    found: CellBox | None = None
    known: dict[Block, CellBox | None] = {}
    for side, outward in enumerate((-1, -1, 1, 1)):
        reach = {block: view.source.find_reach(block)[side] for block in view.source.blocks}
        for block in sorted(reach, key=lambda each: -outward * reach[each]):
            # A hit speaks for the cell beside it, so a block may reach one cell farther.
            if found and outward * found[side] >= outward * reach[block] + 1:
                break
            if block not in known:
                known[block] = view.measure_bounds(block)
            box = known[block]
            if box:
                found = found.join(box) if found else box
    if found is None:
        if view.source.blocks and view.min_passes is not None:
            refuse_nothing_left(view.min_passes)
        raise MapError("no beam of any scan observed a cell, so there is no map")
    return found
