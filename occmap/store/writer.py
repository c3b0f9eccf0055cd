"""The writer of stores, which are files whose names end in `.zarr`."""

import os
import shutil
from pathlib import Path

from occmap.cells import Evidence, Manifest
from occmap.evidence.manifest import list_files
from occmap.store import layout
from occmap.store.blocks import BLOCK, Block, BlockContent, BlockRecord
from occmap.store.reading import Blocks, Store, as_blocks, open_store
from occmap.store.writing import create_store, finish_store, paint_block, write_block
from occmap.writers.atomic import make_folder, refuse_unwritable


class ZarrWriter:
    """What was observed, as a Zarr folder that is read part by part."""

    description = "evidence as a Zarr folder, for maps of a city; it does all that an .npz does"

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the folder."""
        layout.import_zarr()
        return (path,)

    def owns(self, path: Path) -> bool:
        """Whether a folder is one that this writer made."""
        return (path / "zarr.json").is_file() and (path / "slices").is_dir()

    def write_evidence(self, path: Path, evidence: Evidence) -> tuple[Path, ...]:
        """Write evidence; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        return self.write_blocks(path, as_blocks(evidence), evidence.manifest)

    def write_blocks(self, path: Path, source: Blocks, manifest: Manifest) -> tuple[Path, ...]:
        """Write evidence block by block; the manifest may name another model.

        Blocks that are those of the store that the evidence was read from share its files.

        Raises
        ------
        OccmapError
            As `write_evidence`, or a block cannot be read.
        """
        known = Path(source.where)
        base = open_store(known) if source.where and (known / "zarr.json").is_file() else None
        with make_folder(path) as folder:
            create_store(folder, manifest, source.blocks)
            records = [
                put_block(folder, base, block, source.read_block(block)) for block in source.blocks
            ]
            for block in source.blocks:
                paint_block(folder, block)
            finish_store(folder, manifest, records)
        return (path,)


def put_block(folder: Path, base: Store | None, block: Block, content: BlockContent) -> BlockRecord:
    """Write a block, or share the files of the base where that has the same.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    if base and block in base.blocks:
        record = layout.describe_block(block, content)
        if record.sha256 == base.records[block].sha256 and share_block(base, folder, block):
            return record
    return write_block(folder, block, content)


def share_block(base: Store, path: Path, block: Block) -> bool:
    """Put a block of one store into a new one; False where that compresses in another way.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    root = layout.import_zarr().open_group(path, mode="r")
    names = layout.LAYERS[base.manifest.kind]
    if any(base.root[name].metadata.codecs != root[name].metadata.codecs for name in names):
        return False
    old, new = (
        f"c/{block.row - row // BLOCK}/{block.col - col // BLOCK}"
        for row, col in (base.offset, root.attrs["occmap"]["offset"])
    )
    shards = [(base.path / name / old, path / name / new) for name in names]
    slices = list_files(base.path / "slices" / f"{block.row}.{block.col}")
    shards += [(file, path / file.relative_to(base.path)) for file in slices]
    with refuse_unwritable(path):
        for source, target in shards:
            if source.exists():  # a shard of zeros is not kept
                link(source, target)
    return True


def link(source: Path, target: Path) -> None:
    """Link a file, or copy it where the file system has no links."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
