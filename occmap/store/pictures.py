"""The pictures of a store: classes of cells, and of larger and larger squares of cells."""

from typing import Any

import numpy as np

from occmap.evidence import paint_box
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.spec import find_unit
from occmap.grid.stacks import add_stack
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid
from occmap.sensor.models import parse_model
from occmap.store.blocks import Block, gather_tiles
from occmap.store.layout import LAYERS
from occmap.types import Int64, OccupancyMap, UInt8, Update


def read_around(root: Any, head: dict[str, Any], box: CellBox) -> TileGrid:
    """Read the tiles of a box, which begins and ends with tiles, and those beside it."""
    kind, (row, col) = EvidenceKind(head["kind"]), head["offset"]
    first, second = (root[name] for name in LAYERS[kind])
    whole = CellBox(row, col, row + first.shape[0], col + first.shape[1])
    part = whole.clip(box.grow(TILE))
    place = slice(part.row - row, part.row_end - row), slice(part.col - col, part.col_end - col)
    cells: Int64 = np.stack([first[place], second[place]])
    grid = TileGrid(Lattice(head["resolution"]), kind, find_unit(Update(head["update"])))
    add_stack(grid, *gather_tiles(cells, part.row // TILE, part.col // TILE))
    return grid


def paint_block(root: Any, block: Block) -> tuple[TileGrid, OccupancyMap]:
    """Read a block and the tiles beside it; the map says what the store's own model makes of it."""
    head = root.attrs["occmap"]
    grid = read_around(root, head, block.box)
    return grid, paint_box(grid, parse_model(head["model"]), block.box)


def reduce_classes(classes: UInt8, side: int) -> UInt8:
    """Make squares of cells one pixel: occupied where any cell is, else free where any is."""
    height, width = (-(-length // side) * side for length in classes.shape)
    classes = np.pad(classes, [(0, height - classes.shape[0]), (0, width - classes.shape[1])])
    squares = classes.reshape(height // side, side, width // side, side)
    reduced: UInt8 = squares.max(axis=(1, 3))
    return reduced
