"""The writer of stores, which are files whose names end in `.zarr`."""

from pathlib import Path

from occmap.store.blocks import Block, BlockRecord, describe_block
from occmap.store.layout import import_zarr
from occmap.store.reading import Store
from occmap.store.sharing import open_base, share_block
from occmap.store.sources import Blocks, Held
from occmap.store.writing import create_store, finish_store, write_block
from occmap.types import Evidence, Manifest
from occmap.writers.atomic import make_folder


class ZarrWriter:
    """What was observed, as a Zarr folder that is read part by part."""

    description = "evidence as a Zarr folder, for maps of a city; what an .npz does, it does, too"

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the folder."""
        import_zarr()
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
        return self.write_blocks(path, Held(evidence), evidence.manifest)

    def write_blocks(self, path: Path, source: Blocks, manifest: Manifest) -> tuple[Path, ...]:
        """Write evidence block by block; the manifest may name another model.

        Blocks that are those of the store that the evidence was read from share its files.

        Raises
        ------
        OccmapError
            As `write_evidence`, or a block cannot be read.
        """
        base = open_base(source.where)
        with make_folder(path) as folder:
            create_store(folder, manifest, source.blocks)
            records = [self._write_block(folder, base, block, source) for block in source.blocks]
            finish_store(folder, manifest, records)
        return (path,)

    def _write_block(
        self, folder: Path, base: Store | None, block: Block, source: Blocks
    ) -> BlockRecord:
        content = source.read_block(block)
        if base and block in base.blocks:
            record = describe_block(block, content)
            is_equal = record.sha256 == base.blocks[block].sha256
            if is_equal and share_block(base, folder, block):
                return record
        return write_block(folder, block, content)
