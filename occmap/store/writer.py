"""The writer of stores, which are files whose names end in `.zarr`."""

from pathlib import Path

from occmap.cells import Evidence, Manifest
from occmap.store import layout
from occmap.store.reading import Blocks, as_blocks
from occmap.store.writing import create_store, finish_store, paint_block, write_block
from occmap.writers.atomic import make_folder


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

        Raises
        ------
        OccmapError
            As `write_evidence`, or a block cannot be read.
        """
        with make_folder(path) as folder:
            create_store(folder, manifest, source.blocks)
            records = [
                write_block(folder, block, source.read_block(block)) for block in source.blocks
            ]
            for block in source.blocks:
                paint_block(folder, block)
            finish_store(folder, manifest, records, source.read_ground())
        return (path,)
