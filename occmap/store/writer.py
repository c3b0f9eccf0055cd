"""The writer of `-o map.zarr`."""

import secrets
import shutil
from pathlib import Path

from occmap.evidence.manifest import list_inputs
from occmap.store.blocks import split_evidence
from occmap.store.layout import import_zarr
from occmap.store.writing import create_store, finish_store, publish_store, write_block
from occmap.types import Evidence
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
        logs = tuple(range(sum(len(list_inputs(each)) for each in evidence.manifest.builds)))
        contents = dict(split_evidence(evidence, logs))
        temporary = follow_links(path).with_name(f".occmap-{secrets.token_hex(8)}.tmp")
        try:
            create_store(temporary, evidence.manifest, contents)
            records = [write_block(temporary, *each) for each in contents.items()]
            finish_store(temporary, evidence.manifest, records)
            publish_store(temporary, follow_links(path))
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        return (path,)
