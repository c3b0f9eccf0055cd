"""Run files: what one task observed, block by block, and the tasks that add up blocks of these.

A run file holds the parts of its blocks end to end, and beside it lies a stub that says where. Both
are renamed into place, the stub last: where it is there, the task is done for good.
"""

import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import wraps
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

import zstandard

from occmap.cells import Slices
from occmap.errors import MapError
from occmap.grid.slices import unite
from occmap.grid.tiles import TileGrid, stack_tiles, view_tiles
from occmap.options import BuildOptions
from occmap.steps.engines import make_grid
from occmap.steps.observing import Keep
from occmap.store.blocks import Block, BlockContent
from occmap.writers.atomic import open_atomic

AnyJob = TypeVar("AnyJob", bound="Job")
Result = TypeVar("Result")

ALIGNED = 64
"""Arrays begin at multiples of this (bytes)"""
COMPRESSOR = zstandard.ZstdCompressor(write_checksum=True)
"""Its checksum tells altered data from what was written"""


@dataclass(frozen=True)
class Setting:
    """What all tasks of a build share."""

    options: BuildOptions
    keep: Keep
    folder: Path
    """Where results go"""
    slice_bytes: int
    """About how much of a log is one task"""
    window_cells: int
    """The largest window of an engine"""
    most_bytes: int
    """How much evidence is kept in memory before it goes to a run file"""
    logs: int = 1
    """How many logs the build has"""


@dataclass(frozen=True)
class Job:
    """What a task is given."""

    setting: Setting
    name: str
    """What its files are called"""
    where: str
    """What it is about, as an error names it: the path of a log, or a block"""


class Piece(NamedTuple):
    """Where the part of a block lies."""

    file: str
    """Its name in the folder of all run files"""
    offset: int
    size: int


def write_run(
    folder: Path, name: str, parts: Iterable[tuple[Block, BlockContent]]
) -> dict[Block, Piece]:
    """Write a run file; say where each block lies in it.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    pieces, offset = {}, 0
    with open_atomic(folder / name) as (file,):
        for key, content in parts:
            data = COMPRESSOR.compress(pickle.dumps(content, protocol=5))
            file.write(data)
            pieces[key] = Piece(name, offset, len(data))
            offset += len(data)
    return pieces


def read_pieces(folder: Path, pieces: Iterable[Piece]) -> Iterator[BlockContent]:
    """Read parts of blocks, one after the other.

    Raises
    ------
    MapError
        A run file is not there any more, or is not as it was written.
    """
    for name, offset, size in pieces:
        try:
            with (folder / name).open("rb") as file:
                file.seek(offset)
                data = zstandard.decompress(file.read(size))
        except (OSError, zstandard.ZstdError) as error:
            found = f"cannot be read ({error})"
            raise MapError(found, where=folder / name, fix="remove it, and build again") from None
        yield pickle.loads(data)


def write_mapped(path: Path, value: Any) -> None:
    """Write a value, and its large arrays beside it: a reader loads only those it looks at.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    buffers: list[pickle.PickleBuffer] = []
    head, spans = pickle.dumps(value, protocol=5, buffer_callback=buffers.append), []
    with open_atomic(path.with_suffix(".arrays")) as (file,):
        file.write(bytes(ALIGNED))  # an empty file cannot be mapped
        for buffer in buffers:
            file.write(bytes(-file.tell() % ALIGNED))
            spans.append((file.tell(), buffer.raw().nbytes))
            file.write(buffer)
    write_stub(path, (head, spans))


def read_mapped(path: Path) -> Any:
    """Read what `write_mapped` wrote; its arrays cannot be altered."""
    head, spans = read_stub(path)
    with path.with_suffix(".arrays").open("rb") as file:
        data = memoryview(mmap(file.fileno(), 0, access=ACCESS_READ))
    return pickle.loads(head, buffers=[data[start : start + size] for start, size in spans])


def once(task: Callable[[AnyJob], Result]) -> Callable[[AnyJob], Result]:
    """Let a task keep its result, and give that at once where it is there already.

    Then it also raises OutputError, where its result cannot be written.
    """

    @wraps(task)
    def do_once(job: AnyJob) -> Result:
        stub = job.setting.folder / f"{job.name}.{task.__name__}"
        known: Result | None = read_stub(stub)
        if known is not None:
            return known
        result = task(job)
        write_stub(stub, result)
        return result

    return do_once


def write_stub(path: Path, value: Any) -> None:
    """Keep the result of a task: from now on it is done.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    with open_atomic(path) as (file,):
        pickle.dump(value, file)


def read_stub(path: Path) -> Any:
    """The result of a task that is done; None where it is not."""
    try:
        return pickle.loads(path.read_bytes())
    except FileNotFoundError:
        return None


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
    parts = [(job.block, add_up_block(job))]
    return write_run(job.setting.folder, f"{job.name}.run", parts)[job.block]


def add_up_block(job: BlockJob) -> BlockContent:
    """Add up all that was observed in a block; raises MapError as `add_up`."""
    grid, slices = add_up(job.setting, job.pieces)
    return BlockContent(*stack_tiles(grid.tiles), slices, job.logs)


def add_up(setting: Setting, pieces: Iterable[Piece]) -> tuple[TileGrid, tuple[Slices, ...]]:
    """Add up parts of blocks: what was observed, and, where that is kept, when.

    Raises
    ------
    MapError
        A run file cannot be read.
    """
    grid = make_grid(setting.options)
    layers: list[Slices] = []
    for content in read_pieces(setting.folder, pieces):
        low, high = content.cells.min(initial=0), content.cells.max(initial=0)
        grid.add(view_tiles(content.tiles, content.cells), bound=max(-int(low), int(high)))
        layers += content.slices
    return grid, (unite(layers),) if setting.keep.slices else ()
