"""How a store lays out what it holds: packed arrays, table and digests, in blocks.

A block is the square that a store is written and read by; evidence is cut into them and joined.
docs/formats.md lists the arrays in its folder. zarr is imported here alone, by `import_zarr`.
"""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occmap.cells import CellBox, Evidence, Key, Manifest, Slices, Tile, stack_tiles, view_tiles
from occmap.errors import MapError
from occmap.evidence.manifest import MEANING, list_inputs
from occmap.grid.tiles import INT32_LIMIT, TILE, split, take_tiles
from occmap.plugins import need_extra
from occmap.types import UInt8
from occmap.writers.npz import compute_checksum, refuse_other_version, unpack_slices

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
    return map(Block._make, box.align(BLOCK).shrink(BLOCK).places)


class BlockRecord(NamedTuple):
    """What the table of a store says of a block."""

    block: Block
    cells: int
    """How many were observed"""
    reach: CellBox
    """The smallest box around them"""
    sha256: str
    """Digest of what was observed, however it is compressed"""
    builds: tuple[int, ...]
    """Which builds observed something"""
    total: int
    """`sum_tiles` of its tiles"""


def split_evidence(evidence: Evidence) -> Iterator[tuple[Block, Evidence]]:
    """Cut evidence into blocks, in ascending order."""
    blocks = defaultdict[Block, dict[Key, Tile]](dict)
    for (row, col), tile in evidence.tiles.items():
        blocks[Block(row // SIDE, col // SIDE)][row, col] = tile
    names = sorted(blocks)
    layers = (split_slices(each, names) for each in evidence.slices)
    for block, *slices in zip(names, *layers, strict=True):
        yield block, replace(evidence, tiles=blocks[block], slices=tuple(slices), ground=None)


def split_slices(slices: Slices, blocks: Sequence[Block]) -> Iterator[Slices]:
    """Cut slices into those of each block; the blocks are in order, and hold all tiles."""
    keys = (np.array(blocks, np.int64).reshape(-1, 2), slices.tiles // SIDE)
    known, wanted = ((each[:, 0] << 32) + each[:, 1] for each in keys)
    which = np.searchsorted(known, wanted)
    in_order = take_tiles(slices, np.argsort(which, kind="stable"))
    return split(in_order, np.cumsum(np.bincount(which, minlength=len(blocks))).tolist())


FORMAT, VERSION = "occmap store", 2
LAYERS = {"counts": ("hits", "misses"), "log_odds": ("log_odds", "observations")}
"""Names of the two arrays of numbers, by the kind of evidence"""
TABLE = ("place", "cells", "reach", "sha256", "logs")
"""Arrays of the table of blocks"""


def import_zarr() -> Any:
    """Load zarr, late: it is an extra, and takes 0.4 s.

    Raises
    ------
    UsageError
        It is not installed.
    """
    with need_extra("dask", "a store needs zarr"):
        import zarr  # noqa: PLC0415  as above
    return zarr


def locate_block(block: Block, offset: tuple[int, int], side: int = 1) -> tuple[slice, slice]:
    """Rows and columns of a block in an array, of which an item is a square of so many cells."""
    row, col = offset
    return block.box.move(-row, -col).shrink(side).slices


def make_head(manifest: Manifest, offset: tuple[int, int]) -> dict[str, Any]:
    """Make what the attributes of a store say of it."""
    head = {"format": FORMAT, "version": VERSION, "block": BLOCK, "offset": list(offset)}
    return dict(json.loads(json.dumps(head | asdict(manifest), allow_nan=False)))


def read_box(root: Any, box: CellBox) -> dict[Key, Tile]:
    """Read the tiles of a box in which anything was observed.

    Parameters
    ----------
    root
        The group of a store. What of the box lies beyond its arrays was not observed.
    """
    head = root.attrs["occmap"]
    arrays = [root[name] for name in LAYERS[head["kind"]]]
    whole = CellBox(0, 0, *arrays[0].shape).move(*head["offset"])
    part = whole.clip(box)
    cells = np.stack([array[part.within(whole)] for array in arrays])
    rows, cols = part.shrink(TILE).shape
    tiles = cells.reshape(2, rows, TILE, cols, TILE).transpose(1, 3, 0, 2, 4)
    places = np.argwhere(tiles.any(axis=(2, 3, 4)))
    found = tiles[*places.T]
    if np.abs(found).max(initial=0) <= INT32_LIMIT:
        found = found.astype(np.int32)
    return view_tiles(places + np.array(part.shrink(TILE)[:2]), found)


def read_block(root: Any, block: Block, manifest: Manifest, where: str) -> Evidence:
    """Read what was observed in a block of the group of a store, as it is there."""
    array = root[f"slices/{block.row}.{block.col}"]
    slices = unpack_layers(array[:], array.attrs["arrays"], len(manifest.builds))
    return Evidence(manifest, read_box(root, block.box), slices, where)


def refuse_unfinished(path: Path, head: dict[str, Any]) -> None:
    """Refuse a folder of which the attributes are not those of a whole store; raises MapError."""
    if not head:
        raise MapError("is a Zarr folder, but not evidence of occmap", where=path)
    refuse_other_version(path, head, FORMAT, VERSION)
    if not head.get("complete"):
        found = "is not complete: what wrote it did not come to its end"
        raise MapError(found, where=path, fix="build it again")
    if head["checksum"] != compute_checksum(head, {}):
        raise MapError("its attributes were altered", where=path, fix="build it again")


def unpack_layers(data: UInt8, layout: list[dict[str, Any]], builds: int) -> tuple[Slices, ...]:
    """Take the slices of a block apart again: one for each of so many builds."""
    arrays: dict[str, Any] = {}
    start = 0
    for each in layout:
        dtype, shape = np.dtype(each["dtype"]), each["shape"]
        end = start + dtype.itemsize * math.prod(shape)
        arrays[each["name"]] = data[start:end].view(dtype).reshape(shape)
        start = end
    layers = [Slices.join([])] * builds
    for build, slices in zip(arrays["builds"].tolist(), unpack_slices(arrays), strict=True):
        layers[build] = slices
    return tuple(layers)


def pack_arrays(arrays: Mapping[str, Any]) -> tuple[UInt8, list[dict[str, Any]]]:
    """Lay arrays end to end as bytes; the list says how to take them apart again."""
    layout = [
        {"name": name, "dtype": array.dtype.str, "shape": list(array.shape)}
        for name, array in arrays.items()
    ]
    data = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays.values())
    return np.frombuffer(data, np.uint8), layout


def list_observing_builds(content: Evidence) -> tuple[int, ...]:
    """List the builds that observed something: the others do not change what a block is."""
    return tuple(build for build, each in enumerate(content.slices) if len(each.numbers))


def make_table(records: Sequence[BlockRecord], manifest: Manifest) -> dict[str, Any]:
    """Arrays of what is known of each block, N in all, and of which logs may have observed it."""
    counts = [len(list_inputs(build)) for build in manifest.builds]
    build_of_log = np.repeat(np.arange(len(counts)), counts)
    logs = np.array([np.isin(build_of_log, record.builds) for record in records], np.bool_)
    digests = b"".join(bytes.fromhex(record.sha256) for record in records)
    columns = (
        np.array([record.block for record in records], np.int64).reshape(-1, 2),
        np.array([record.cells for record in records], np.int64),
        np.array([record.reach for record in records], np.int64).reshape(-1, 4),
        np.frombuffer(digests, np.uint8).reshape(-1, 32),
        np.packbits(logs.reshape(len(records), len(build_of_log)), axis=1),
    )
    return dict(zip(TABLE, columns, strict=True))


def hash_table(table: Mapping[str, Any]) -> str:
    """SHA-256 of the arrays of a table."""
    data, layout = pack_arrays({name: table[name] for name in sorted(table)})
    return hashlib.sha256(json.dumps(layout).encode() + data.tobytes()).hexdigest()


def hash_content(content: Evidence) -> str:
    """SHA-256 of what was observed and when; who observed it is not a part of it."""
    places, cells = stack_tiles(content.tiles)
    seen = (cells != 0).any(axis=1)
    arrays = [
        places.astype("<i8"),
        np.packbits(seen, axis=-1),
        *(cells[:, part][seen].astype("<i8") for part in (0, 1)),
    ]
    for build in list_observing_builds(content):
        slices = content.slices[build]
        arrays += [np.array([build], "<i8"), slices.tiles.astype("<i8")]
        arrays += [slices.numbers.astype("<i8")]
        arrays += [slices.rows, slices.parts, slices.changes]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def compute_digest(manifest: Manifest, blocks: Mapping[Block, str]) -> str:
    """SHA-256 of all that was observed, from those of the blocks: equal for equal evidence.

    It says nothing of how the evidence is cut, compressed or kept, nor of who observed it.
    """
    meaning = {name: getattr(manifest, name) for name in MEANING}
    lines = [json.dumps(meaning), *(f"{key.row} {key.col} {blocks[key]}" for key in sorted(blocks))]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
