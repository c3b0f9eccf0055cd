"""How a store is read: what it is, one block, or all of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from occmap.arrays import Int64
from occmap.cells import Evidence, Manifest
from occmap.errors import MapError
from occmap.grid.tiles import INT32_LIMIT, EvidenceKind
from occmap.store.blocks import (
    SIDE,
    TABLE,
    Block,
    BlockContent,
    BlockRecord,
    gather_tiles,
    hash_content,
    hash_table,
    read_table,
    unpack_layers,
)
from occmap.store.writing import FORMAT, LAYERS, VERSION, find_place, import_zarr
from occmap.writers.npz import compute_checksum
from occmap.writers.soundness import list_faults, list_manifest_faults, refuse_damage, refuse_faults


@dataclass(frozen=True, eq=False)
class Store:
    """A store that is whole, as its attributes and its table say; blocks are checked when read."""

    path: Path
    manifest: Manifest
    digest: str
    """SHA-256 of all that was observed"""
    blocks: dict[Block, BlockRecord]
    """In ascending order"""
    offset: tuple[int, int]
    """Row and column of the lattice that its arrays begin with"""
    root: Any
    """The group of Zarr"""

    @property
    def where(self) -> str:
        """The folder."""
        return str(self.path)

    def read_block(self, block: Block) -> BlockContent:
        """Read what was observed in one of its blocks.

        Raises
        ------
        MapError
            It is not as it was written, or not what occmap writes.
        """
        record, place = self.blocks[block], find_place(block, self.offset)
        with refuse_damage(self.path):
            names = LAYERS[EvidenceKind(self.manifest.kind)]
            whole = np.stack([self.root[name][place] for name in names])
            tiles, numbers = gather_tiles(whole, block.row * SIDE, block.col * SIDE)
            array = self.root[f"slices/{block.row}.{block.col}"]
            builds = len(self.manifest.builds)
            slices = unpack_layers(array[:], array.attrs["arrays"], builds)
            fits = numbers.min(initial=0) >= -INT32_LIMIT and numbers.max(initial=0) <= INT32_LIMIT
            cells: Int64 = numbers.astype(np.int32) if fits else numbers
            content = BlockContent(tiles, cells, slices, record.logs)
        if hash_content(content) != record.sha256:
            found = f"its block ({block.row}, {block.col}) was altered or a file of it is missing"
            raise MapError(found, where=self.path, fix="build it again")
        refuse_faults(self.path, list_faults(Evidence(self.manifest, tiles, numbers, slices)))
        return content


def open_store(path: Path) -> Store:
    """Open a store, and check what is read of all of it.

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
        fix = "build one with `outputs=map.zarr`"
        raise MapError("is not a store of evidence", where=path, fix=fix)
    zarr = import_zarr()
    with refuse_damage(path):
        root = zarr.open_group(path, mode="r", zarr_format=3)
        head = root.attrs.get("occmap", {})
        if head.get("format") != FORMAT:
            raise MapError("is a Zarr folder, but not evidence of occmap", where=path)
        if head["version"] > VERSION:
            found = f"{FORMAT} of version {head['version']}, while this occmap reads {VERSION}"
            raise MapError(found, where=path, fix="use a newer occmap")
        if not head.get("complete"):
            found = "is not complete: what wrote it did not come to its end"
            raise MapError(found, where=path, fix="build it again")
        if head["checksum"] != compute_checksum(head, {}):
            raise MapError("its attributes were altered", where=path, fix="build it again")
        manifest = Manifest.from_json(head)
        refuse_faults(path, list_manifest_faults(manifest))
        table = {name: root[f"blocks/{name}"][...] for name in TABLE}
        if head["table"] != hash_table(table):
            raise MapError("its table of blocks was altered", where=path, fix="build it again")
        blocks = {record.block: record for record in read_table(table)}
        row, col = head["offset"]
    return Store(path, manifest, head["digest"], blocks, (row, col), root)
