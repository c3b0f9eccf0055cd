"""How a block of the map is added up, of all that parts of logs observed in it."""

from typing import NamedTuple

from occmap.engines import make_grid
from occmap.fleet.runs import (
    Content,
    Piece,
    do_once,
    read_pieces,
    write_run,
)
from occmap.fleet.tasks import Setting
from occmap.grid.slices import unite
from occmap.grid.stacks import add_stack, stack_tiles
from occmap.store.blocks import Block
from occmap.types import Slices


class ReduceJob(NamedTuple):
    """A block to be added up."""

    setting: Setting
    block: Block
    pieces: tuple[Piece, ...]

    @property
    def where(self) -> str:
        """What an error is about."""
        return f"block {tuple(self.block)}"


def reduce_block(job: ReduceJob) -> Piece:
    """Add up all that was observed in a block, and leave it in a run file of its own.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the scratch folder cannot be written.
    """
    folder, (row, col) = job.setting.folder, job.block
    name = f"block{row}_{col}"

    def reduce() -> Piece:
        return write_run(folder, f"{name}.run", [(job.block, add_up(job))])[job.block]

    return do_once(folder / f"{name}.sum", reduce)


def add_up(job: ReduceJob) -> Content:
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
    return Content(*stack_tiles(grid.tiles), (unite(layers),) if job.setting.keep.slices else ())
