"""The writer of stores, which are files whose names end in `.zarr`."""

import secrets
import shutil
from pathlib import Path

from occmap.store.layout import import_zarr
from occmap.store.sources import Blocks, Held
from occmap.store.writing import create_store, finish_store, publish_store, write_block
from occmap.types import Evidence, Manifest
from occmap.writers.atomic import follow_links


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

        Raises
        ------
        OccmapError
            As `write_evidence`, or a block cannot be read.
        """
        target = follow_links(path)
        temporary = target.with_name(f".occmap-{secrets.token_hex(8)}.tmp")
        try:
            create_store(temporary, manifest, source.blocks)
            records = [
                write_block(temporary, block, source.read_block(block)) for block in source.blocks
            ]
            finish_store(temporary, manifest, records)
            publish_store(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        return (path,)
