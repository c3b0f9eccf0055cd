"""Saved evidence: read, merged, rendered again, and kept in blocks for maps larger than memory.

A store is such evidence as a Zarr v3 folder. It is made block by block, by as many processes as
there are: `writing.create_store`, then `writing.write_block` and `writing.paint_block` for each
block, then `writing.finish_store`. docs/formats.md says what is in it. Here evidence is read: all
of it as blocks, which are read when they are asked for; what a file holds is in memory at once.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Self

from occmap.cells import CellBox, Evidence, Ground, Manifest, sum_tiles
from occmap.errors import MapError
from occmap.grid.tiles import TILE, take_tiles, unite
from occmap.store import layout
from occmap.store.layout import SIDE, Block
from occmap.writers.npz import GROUND, read_evidence, refuse_damage, unpack_ground


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
        cut = cache(lambda: dict(layout.split_evidence(evidence)))
        what, where, ground = evidence.manifest, evidence.where, evidence.ground
        return cls(what, where, reach, lambda block: cut()[block], ground, whole=evidence)


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
    return Blocks.of(read_evidence(path))


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
    zarr = layout.import_zarr()
    with refuse_damage(path):
        root = zarr.open_group(path, mode="r", zarr_format=3)
        head = root.attrs.get("occmap", {})
        layout.refuse_unfinished(path, head)
        manifest = Manifest.from_json(head)
        table = {name: root[f"blocks/{name}"][...] for name in layout.TABLE}
        below = {name: root[f"ground/{name}"][...] for name in GROUND if "ground" in root}
        if head["table"] != layout.hash_table(table | below):
            found = "its table of blocks, or its ground, was altered"
            raise MapError(found, where=path, fix="build it again")
        blocks = [Block(*place) for place in table["place"].tolist()]
        reaches = zip(blocks, map(CellBox._make, table["reach"].tolist()), strict=True)
        reach = {block: box for block, box in reaches if box.cells}  # older ones have empty blocks
        digest_of = dict(zip(blocks, map(bytes, table["sha256"]), strict=True))
        ground = unpack_ground(below)

    def read_block(block: Block) -> Evidence:
        with refuse_damage(path):
            content = layout.read_block(root, block, manifest, str(path))
        if layout.hash_content(content) != digest_of[block].hex():
            found = f"its block {tuple(block)} was altered or a file of it is missing"
            raise MapError(found, where=path, fix="build it again")
        return content

    name = head.get("evidence", "")
    return Blocks(manifest, str(path), reach, read_block, ground, name, root)


def identify(saved: Blocks) -> str:
    """Name what was observed, by `Manifest.identify`; a sum of stores is read for that."""
    parts = [saved.whole] if saved.whole else map(saved.read_block, saved.blocks)
    return saved.name or saved.manifest.identify(sum(sum_tiles(each.tiles) for each in parts))


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
    blocks = (block for block in layout.list_blocks(near) if block in saved.blocks)
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
