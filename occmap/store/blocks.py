"""Blocks: the squares that a store is written and read by; evidence cut into them and joined."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, product
from typing import NamedTuple

import numpy as np

from occmap.cells import Evidence, Manifest, Slices
from occmap.evidence.manifest import list_inputs
from occmap.grid.lattice import CellBox
from occmap.grid.slices import take, unite
from occmap.grid.tiles import TILE, Key, Tile, stack_tiles, view_tiles
from occmap.types import Int64

BLOCK = 1024
"""Cells along the side of a block"""
SIDE = BLOCK // TILE
"""Tiles along it"""


class Block(NamedTuple):
    """A block (r, c) begins at cell (1024 r, 1024 c) of the lattice, which may be negative."""

    row: int
    col: int

    @property
    def box(self) -> CellBox:
        """Its cells."""
        return CellBox.at(*self).scale(BLOCK)


def list_blocks(box: CellBox) -> Iterator[Block]:
    """The blocks that the cells of a box lie in."""
    row, col, row_end, col_end = box.align(BLOCK).shrink(BLOCK)
    return (Block(*place) for place in product(range(row, row_end), range(col, col_end)))


@dataclass(frozen=True, slots=True, eq=False)
class BlockContent:
    """What was observed in a block."""

    tiles: Int64
    """(T, 2) row and column of each tile, as in `Evidence`"""
    cells: Int64
    """(T, 2, 64, 64) the two numbers of every cell"""
    slices: tuple[Slices, ...] = ()
    """When cells were observed, for each build"""
    logs: tuple[int, ...] = ()
    """Which logs observed something: places among the logs of all builds, one after the other"""


class BlockRecord(NamedTuple):
    """What the table of a store says of a block."""

    block: Block
    cells: int
    """How many were observed"""
    reach: CellBox
    """The smallest box around them"""
    sha256: str
    """Digest of what was observed, however it is compressed"""
    logs: tuple[int, ...]
    """As in `BlockContent`"""


NO_CONTENT = BlockContent(np.zeros((0, 2), np.int64), np.zeros((0, 2, TILE, TILE), np.int32))


def split_evidence(evidence: Evidence) -> Iterator[tuple[Block, BlockContent]]:
    """Cut evidence into blocks; all logs of a build are said to have observed its blocks."""
    tiles = view_tiles(evidence.tiles, evidence.cells)
    for block, content in split_blocks(tiles, evidence.slices):
        yield block, replace(content, logs=list_observing_logs(evidence.manifest, content.slices))


def split_blocks(
    tiles: Mapping[Key, Tile], slices: Sequence[Slices]
) -> Iterator[tuple[Block, BlockContent]]:
    """Cut tiles and slices of time into blocks, in ascending order; one is copied at a time."""
    keys = np.array(sorted(tiles), np.int64).reshape(-1, 2)
    of_tiles, *of_slices = (group_by_block(each) for each in (keys, *(s.tiles for s in slices)))
    nothing = np.zeros(0, np.int64)
    for block in sorted(set(of_tiles).union(*of_slices)):
        places = of_tiles.get(block, nothing)
        own = {(row, col): tiles[row, col] for row, col in keys[places].tolist()}
        parts = tuple(
            take(layer, found.get(block, nothing))
            for layer, found in zip(slices, of_slices, strict=True)
        )
        yield block, BlockContent(*stack_tiles(own), parts)


def group_by_block(tiles: Int64) -> dict[Block, Int64]:
    """Which of the tiles (T, 2) lie in each block, in their order."""
    blocks, which = np.unique(tiles // SIDE, axis=0, return_inverse=True)
    order = np.argsort(which, kind="stable")
    ends = np.cumsum(np.bincount(which, minlength=len(blocks)))
    keys = (Block(row, col) for row, col in blocks.tolist())
    # Of no tiles at all, `split` makes one empty part.
    return dict(zip(keys, np.split(order, ends[:-1]), strict=False))


def list_observing_logs(manifest: Manifest, slices: Sequence[Slices]) -> tuple[int, ...]:
    """All logs of the builds that observed something here: a build does not say which did."""
    counts = [len(list_inputs(build)) for build in manifest.builds]
    starts = accumulate(counts, initial=0)
    return tuple(
        log
        for start, count, layer in zip(starts, counts, slices, strict=False)  # one more start
        if len(layer.numbers)
        for log in range(start, start + count)
    )


def join_contents(contents: Iterable[BlockContent], manifest: Manifest, where: str) -> Evidence:
    """Make evidence of some blocks."""
    known = [NO_CONTENT, *contents]
    tiles = np.concatenate([each.tiles for each in known])
    cells = np.concatenate([each.cells for each in known])
    order = np.lexsort(tiles.T[::-1])
    slices = tuple(
        unite(each.slices[build] for each in known if each.slices)
        for build in range(len(manifest.builds))
    )
    return Evidence(manifest, tiles[order], cells[order], slices, where)


def spread_cells(block: Block, content: BlockContent) -> Int64:
    """(2, 1024, 1024): the two numbers of each cell of a block."""
    cells = np.zeros((2, BLOCK, BLOCK), np.int64)
    rows, cols = (content.tiles - np.array(block) * SIDE).T
    cut_tiles(cells)[rows, cols] = content.cells
    return cells


def gather_tiles(cells: Int64, row: int, col: int) -> tuple[Int64, Int64]:
    """The tiles (T, 2) in which anything was observed, and their cells (T, 2, 64, 64).

    Parameters
    ----------
    cells
        (2, H, W): the two numbers of each cell of some tiles.
    row, col
        Row and column of the first of these tiles.
    """
    tiles = cut_tiles(cells)
    places = np.argwhere(tiles.any(axis=(2, 3, 4)))
    return places + np.array([row, col]), tiles[*places.T]


def cut_tiles(cells: Int64) -> Int64:
    """(R, C, 2, 64, 64): a view of the tiles of whole rows and columns of tiles (2, H, W)."""
    _, height, width = cells.shape
    parts = cells.reshape(2, height // TILE, TILE, width // TILE, TILE)
    return parts.transpose(1, 3, 0, 2, 4)
