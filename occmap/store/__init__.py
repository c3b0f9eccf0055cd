"""Saved evidence: read, merged, rendered again, and kept in blocks for maps larger than memory.

A store is such evidence as a Zarr v3 folder. It is made block by block, by as many processes as
there are: `writing.create_store`, then `writing.write_block` and `writing.paint_block` for each
block, then `writing.finish_store`. docs/formats.md says what is in it. Here evidence is read: all
of it as blocks, which are read when they are asked for; what a file holds is in memory at once. A
block is the square that a store is written and read by; evidence is cut into them and joined.
"""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from occmap import cells
from occmap.cells import CellBox, Evidence, Ground, Key, Manifest, Slices, Tile
from occmap.errors import MapError
from occmap.grid.tiles import INT32_LIMIT, TILE, split, take_tiles, unite
from occmap.plugins import need_extra
from occmap.types import UInt8
from occmap.writers import npz
from occmap.writers.npz import GROUND, refuse_damage, unpack_ground

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


@dataclass(frozen=True, eq=False)
class Blocks:
    """Saved evidence, block by block: a store, what is in memory, or a sum of these."""

    manifest: Manifest
    where: str
    """What it was read from"""
    blocks: Mapping[Block, CellBox]
    """Those that anything was observed in, in ascending order, and how far it reaches at most"""
    read_block: Callable[[Block], Evidence]
    """Gives what was observed in one of them; raises MapError where it is damaged"""
    ground: Ground | None
    """What clouds were traced over"""
    name: str = ""
    """As `identify` gives it; "" where it is not known"""
    root: Any = None
    """The group of Zarr, of a store"""
    whole: Evidence | None = None
    """All of it, where that is in memory"""

    @classmethod
    def of(cls, evidence: Evidence) -> Self:
        """Cut evidence into blocks; it stays in memory, and is cut when a block is asked for."""
        blocks = sorted({Block(row // SIDE, col // SIDE) for row, col in evidence.tiles})
        reach = {block: block.box for block in blocks}
        cut = cache(lambda: dict(split_evidence(evidence)))
        what, where, ground = evidence.manifest, evidence.where, evidence.ground
        return cls(what, where, reach, lambda block: cut()[block], ground, whole=evidence)


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


def open_saved(path: Path) -> Blocks:
    """Read an evidence file, or open a store.

    Raises
    ------
    UsageError
        It is a store, and zarr is not installed.
    MapError
        It is missing, damaged, or no evidence.
    """
    if path.is_dir() or path.suffix.lower() == ".zarr":
        return open_store(path)
    return Blocks.of(npz.read_evidence(path))


def open_store(path: Path) -> Blocks:
    """Open a store that is whole, as its head and its table say; blocks are checked when read.

    Raises
    ------
    UsageError
        zarr is not installed.
    MapError
        It is missing, not a store, of another format, not complete, or not as it was written.
    """
    if not path.exists():
        raise MapError("no such folder", where=path, fix="check the path")
    if not (path / "zarr.json").is_file():
        files = any(path.glob("*.npz"))
        fix = f"merge {path}/*.npz" if files else "build one with `outputs=map.zarr`"
        raise MapError("is not a store of evidence", where=path, fix=fix)
    zarr = import_zarr()
    with refuse_damage(path):
        root = zarr.open_group(path, mode="r", zarr_format=3)
        head = root.attrs.get("occmap", {})
        refuse_unfinished(path, head)
        manifest = Manifest.from_json(head)
        table = {name: root[f"blocks/{name}"][...] for name in TABLE}
        below = {name: root[f"ground/{name}"][...] for name in GROUND if "ground" in root}
        if head["table"] != hash_table(table | below):
            found = "its table of blocks, or its ground, was altered"
            raise MapError(found, where=path, fix="build it again")
        blocks = [Block(*place) for place in table["place"].tolist()]
        reaches = zip(blocks, map(CellBox._make, table["reach"].tolist()), strict=True)
        reach = {block: box for block, box in reaches if box.cells}  # older ones have empty blocks
        digest_of = dict(zip(blocks, map(bytes, table["sha256"]), strict=True))
        ground = unpack_ground(below)

    def read_block(block: Block) -> Evidence:
        with refuse_damage(path):
            content = read_content(root, block, manifest, str(path))
        if hash_content(content) != digest_of[block].hex():
            found = f"its block {tuple(block)} was altered or a file of it is missing"
            raise MapError(found, where=path, fix="build it again")
        return content

    name = head.get("evidence", "")
    return Blocks(manifest, str(path), reach, read_block, ground, name, root)


def identify(saved: Blocks) -> str:
    """Name what was observed, by `Manifest.identify`; a sum of stores is read for that."""
    parts = [saved.whole] if saved.whole else map(saved.read_block, saved.blocks)
    return saved.name or saved.manifest.identify(sum(cells.sum_tiles(each.tiles) for each in parts))


def read_all(saved: Blocks) -> Evidence:
    """Read all blocks at once."""
    if saved.whole:
        return replace(saved.whole, manifest=saved.manifest)
    return join_blocks(saved, map(saved.read_block, saved.blocks))


def read_part(saved: Blocks, box: CellBox) -> Evidence:
    """Read the tiles that lie in a box of cells or beside it; of evidence in memory, all."""
    if saved.whole:
        return saved.whole
    near = box.align(TILE).grow(TILE)
    blocks = (block for block in list_blocks(near) if block in saved.blocks)
    parts = (keep_inside(saved.read_block(block), near.shrink(TILE)) for block in blocks)
    return join_blocks(saved, parts)


def join_blocks(saved: Blocks, parts: Iterable[Evidence]) -> Evidence:
    """Make evidence of what was read of some blocks."""
    known = list(parts)
    tiles = {key: tile for each in known for key, tile in each.tiles.items()}
    builds = range(len(saved.manifest.builds))
    slices = tuple(unite(each.slices[build] for each in known) for build in builds)
    return Evidence(saved.manifest, tiles, slices, saved.where, ground=saved.ground)


def keep_inside(part: Evidence, box: CellBox) -> Evidence:
    """Keep the tiles in a box, which counts tiles."""
    tiles = {key: part.tiles[key] for key in box.places if key in part.tiles}
    slices = tuple(take_tiles(layer, box.find(layer.tiles)) for layer in part.slices)
    return replace(part, tiles=tiles, slices=slices)


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
    numbers = np.stack([array[part.within(whole)] for array in arrays])
    rows, cols = part.shrink(TILE).shape
    tiles = numbers.reshape(2, rows, TILE, cols, TILE).transpose(1, 3, 0, 2, 4)
    places = np.argwhere(tiles.any(axis=(2, 3, 4)))
    found = tiles[*places.T]
    if np.abs(found).max(initial=0) <= INT32_LIMIT:
        found = found.astype(np.int32)
    return cells.view_tiles(places + np.array(part.shrink(TILE)[:2]), found)


def read_content(root: Any, block: Block, manifest: Manifest, where: str) -> Evidence:
    """Read what was observed in a block of the group of a store, as it is there."""
    array = root[f"slices/{block.row}.{block.col}"]
    slices = unpack_layers(array[:], array.attrs["arrays"], len(manifest.builds))
    return Evidence(manifest, read_box(root, block.box), slices, where)


def refuse_unfinished(path: Path, head: dict[str, Any]) -> None:
    """Refuse a folder of which the attributes are not those of a whole store; raises MapError."""
    if not head:
        raise MapError("is a Zarr folder, but not evidence of occmap", where=path)
    npz.refuse_other_version(path, head, FORMAT, VERSION)
    if not head.get("complete"):
        found = "is not complete: what wrote it did not come to its end"
        raise MapError(found, where=path, fix="build it again")
    if head["checksum"] != npz.compute_checksum(head, {}):
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
    for build, slices in zip(arrays["builds"].tolist(), npz.unpack_slices(arrays), strict=True):
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


def hash_table(table: Mapping[str, Any]) -> str:
    """SHA-256 of the arrays of a table."""
    data, layout = pack_arrays({name: table[name] for name in sorted(table)})
    return hashlib.sha256(json.dumps(layout).encode() + data.tobytes()).hexdigest()


def hash_content(content: Evidence) -> str:
    """SHA-256 of what was observed and when; who observed it is not a part of it."""
    places, numbers = cells.stack_tiles(content.tiles)
    seen = (numbers != 0).any(axis=1)
    arrays = [
        places.astype("<i8"),
        np.packbits(seen, axis=-1),
        *(numbers[:, part][seen].astype("<i8") for part in (0, 1)),
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
