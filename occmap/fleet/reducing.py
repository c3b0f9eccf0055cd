"""What workers do with blocks of the map: add up what parts of logs observed in them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from occmap.cells import Slices
from occmap.engines import make_grid
from occmap.fleet.runs import Job, Piece, Setting, once, read_pieces, write_run
from occmap.grid.slices import unite
from occmap.grid.tiles import add_stack, stack_tiles
from occmap.store.blocks import Block, BlockContent


@dataclass(frozen=True)
class BlockJob(Job):
    """A block of the map to be added up, written or painted."""

    block: Block
    pieces: tuple[Piece, ...] = ()
    """All that parts of logs observed in it"""
    logs: tuple[int, ...] = ()
    """Which files of logs observed something in it; none in a block that lies beside others"""

    store: Path = Path()
    """Where it is written"""

    @classmethod
    def of(cls, setting: Setting, block: Block) -> Self:
        """Make a job of a block of which nothing is known yet."""
        return cls(setting, f"block{block.row}_{block.col}", f"block {tuple(block)}", block)


@once
def reduce_block(job: BlockJob) -> Piece:
    """Add up all that was observed in a block, and leave it in a run file of its own.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the scratch folder cannot be written.
    """
    parts = [(job.block, add_up(job))]
    return write_run(job.setting.folder, f"{job.name}.run", parts)[job.block]


def add_up(job: BlockJob) -> BlockContent:
    """Add up all that was observed in a block.

    Raises
    ------
    OccmapError
        A run file cannot be read.
    """
    grid = make_grid(job.setting.options)
    layers: list[Slices] = []
    for content in read_pieces(job.setting.folder, job.pieces):
        add_stack(grid, content.tiles, content.cells)
        layers += content.slices
    slices = (unite(layers),) if job.setting.keep.slices else ()
    return BlockContent(*stack_tiles(grid.tiles), slices, job.logs)
