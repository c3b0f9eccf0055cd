"""Run files: what one task observed, block by block, for the tasks that add up blocks.

A run file holds the parts of its blocks end to end, and beside it lies a stub that says where. Both
are renamed into place, the stub last: where it is there, the task is done for good.
"""

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BytesIO
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import zstandard

from occmap.errors import MapError
from occmap.grid.slices import take
from occmap.grid.stacks import stack_tiles
from occmap.grid.tiles import TileGrid
from occmap.store.blocks import Block, group_by_block
from occmap.types import Int64, Slices
from occmap.writers.atomic import open_atomic

Result = TypeVar("Result")

ALIGNED = 64
"""Arrays begin at multiples of this (bytes)"""


class Piece(NamedTuple):
    """Where the part of a block lies."""

    file: str
    """Its name in the folder of all run files"""
    offset: int
    size: int


class Content(NamedTuple):
    """What was observed in a block."""

    tiles: Int64
    """(T, 2), as in `Evidence`"""
    cells: Int64
    """(T, 2, 64, 64), as in `Evidence`"""
    slices: tuple[Slices, ...]
    """One where slices of time are kept, in order; else none"""


def split_blocks(grid: TileGrid, slices: Sequence[Slices]) -> Iterator[tuple[Block, Content]]:
    """Cut evidence into blocks, one after the other: a copy of all of it would not fit."""
    keys = np.array(sorted(grid.keys), np.int64).reshape(-1, 2)
    layers = [(layer, group_by_block(layer.tiles)) for layer in slices]
    nothing = np.zeros(0, np.int64)
    for block, which in group_by_block(keys).items():
        part = {(row, col): grid.tiles[row, col] for row, col in keys[which].tolist()}
        of_block = (take(layer, places.get(block, nothing)) for layer, places in layers)
        yield block, Content(*stack_tiles(part), tuple(of_block))


def write_run(
    folder: Path, name: str, parts: Iterable[tuple[Block, Content]]
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
            data = pack_content(content)
            file.write(data)
            pieces[key] = Piece(name, offset, len(data))
            offset += len(data)
    return pieces


def read_pieces(folder: Path, pieces: Iterable[Piece]) -> Iterable[Content]:
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
                yield unpack_content(file.read(size))
        except (OSError, ValueError, LookupError, zstandard.ZstdError) as error:
            raise MapError(
                f"cannot be read ({error})", where=folder / name, fix="remove it, and build again"
            ) from None


def pack_content(content: Content) -> bytes:
    """Make bytes of a part of a block."""
    names = Slices.__dataclass_fields__
    arrays = {
        f"{n}.{name}": getattr(s, name) for n, s in enumerate(content.slices) for name in names
    }
    buffer = BytesIO()
    np.savez(buffer, tiles=content.tiles, cells=content.cells, **arrays)
    return zstandard.compress(buffer.getbuffer())


def unpack_content(data: bytes) -> Content:
    """Make a part of a block of bytes."""
    with np.load(BytesIO(zstandard.decompress(data)), allow_pickle=False) as arrays:
        layers = sorted({name.partition(".")[0] for name in arrays.files if "." in name})
        names = Slices.__dataclass_fields__
        slices = tuple(Slices(*(arrays[f"{n}.{name}"] for name in names)) for n in layers)
        return Content(arrays["tiles"], arrays["cells"], slices)


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
    """A value that `write_mapped` kept, with arrays that cannot be altered; None: there is none."""
    if (known := read_stub(path)) is None:
        return None
    head, spans = known
    with path.with_suffix(".arrays").open("rb") as file:
        data = memoryview(mmap(file.fileno(), 0, access=ACCESS_READ))
    return pickle.loads(head, buffers=[data[start : start + size] for start, size in spans])


def do_once(stub: Path, task: Callable[[], Result]) -> Result:
    """Do a task and keep its result, or give the result of a task that is done.

    Raises
    ------
    OccmapError
        As the task, or its result cannot be written.
    """
    known: Result | None = read_stub(stub)
    if known is not None:
        return known
    result = task()
    write_stub(stub, result)
    return result


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
