"""What workers do with blocks of the map: add up what parts of logs observed in them."""

from typing import NamedTuple

from occmap.cells import Slices
from occmap.engines import make_grid
from occmap.fleet.runs import Piece, do_once, read_pieces, write_run
from occmap.fleet.tasks import Setting
from occmap.grid.slices import unite
from occmap.grid.tiles import add_stack, stack_tiles
from occmap.store.blocks import Block, BlockContent


class BlockJob(NamedTuple):
    """A block of the map to be added up, written or painted."""

    setting: Setting
    block: Block
    pieces: tuple[Piece, ...] = ()
    """All that parts of logs observed in it"""
    logs: tuple[int, ...] = ()
    """Which files of logs observed something in it; none in a block that lies beside others"""

    @property
    def where(self) -> str:
        """What an error is about."""
        return f"block {tuple(self.block)}"


def reduce_block(job: BlockJob) -> Piece:
    """Add up all that was observed in a block, and leave it in a run file of its own.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the scratch folder cannot be written.
    """
    folder, name = job.setting.folder, "block{}_{}".format(*job.block)

    def reduce() -> Piece:
        return write_run(folder, f"{name}.run", [(job.block, add_up(job))])[job.block]

    return do_once(folder / f"{name}.sum", reduce)


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
