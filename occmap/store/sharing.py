"""Blocks that a new store has in common with another: their files are linked, not written again.

A file of a store is only ever replaced, so what one store holds does not change with the other.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from occmap.grid.tiles import EvidenceKind
from occmap.store.blocks import Block
from occmap.store.layout import LAYERS, find_place, import_zarr, refuse_unwritable
from occmap.store.reading import Store, open_store

ROOT_FILE = "zarr.json"


def open_base(where: str) -> Store | None:
    """Open the store that evidence was read from; None where it was no store."""
    path = Path(where)
    return open_store(path) if where and (path / ROOT_FILE).is_file() else None


def share_block(base: Store, path: Path, block: Block) -> bool:
    """Put a block of one store into a new one; False where that compresses in another way.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    root = import_zarr().open_group(path, mode="r")
    names = LAYERS[EvidenceKind(base.manifest.kind)]
    if any(base.root[name].metadata.codecs != root[name].metadata.codecs for name in names):
        return False
    offset = root.attrs["occmap"]["offset"]
    with refuse_unwritable(path):
        for name in names:
            source, target = (
                folder / name / locate_shard(base, block, start)
                for folder, start in ((base.path, base.offset), (path, offset))
            )
            if source.exists():  # a shard of zeros is not kept
                link(source, target)
        slices = base.path / "slices" / f"{block.row}.{block.col}"
        for file in list_files(slices):
            link(file, path / file.relative_to(base.path))
    return True


def locate_shard(base: Store, block: Block, offset: tuple[int, int]) -> str:
    """Name the file of a block in an array that begins at a row and column of the lattice."""
    rows, cols = find_place(block, offset)
    height, width = base.root[LAYERS[EvidenceKind(base.manifest.kind)][0]].shards
    return f"c/{rows.start // height}/{cols.start // width}"


def list_files(folder: Path) -> Iterator[Path]:
    """All files in a folder."""
    return (each for each in sorted(folder.rglob("*")) if each.is_file())


def link(source: Path, target: Path) -> None:
    """Link a file, or copy it where the file system has no links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
