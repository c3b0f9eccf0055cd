"""A store that workers write holds what one process writes, and the report says the same."""

from dataclasses import replace
from pathlib import Path

import pytest

from occmap.fleet import Fleet
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.scans.tracing import ignore_progress
from occmap.sensor.models import parse_model
from occmap.store import open_store
from occmap.types import Update
from tests.samples import DRIVES, SAMPLE_LOGS

TWICE = [DRIVES[0], DRIVES[4], DRIVES[0]]
"""One log is given twice"""


@pytest.mark.parametrize(
    ("logs", "options"),
    [
        (TWICE, BuildOptions(jobs=1, resolution=0.02)),  # more than a block, with hits at its edges
        (
            TWICE,
            BuildOptions(
                jobs=1,
                update=Update.BEAM,
                model=parse_model("quadratic"),
                selection=Selection(end_s=1e6),  # leaves nothing out, which is a note
            ),
        ),
        ([SAMPLE_LOGS / "hall.mcap"], BuildOptions(jobs=1)),  # clouds, over a ground
    ],
)
def test_it_holds_what_one_process_writes(
    address: str, tmp_path: Path, logs: list[Path], options: BuildOptions
) -> None:
    alone = build(logs, options, [tmp_path / "alone.zarr"]).report
    fleet = Fleet(address, tmp_path / "scratch")
    together = fleet.build(logs, options, [tmp_path / "fleet.zarr"], ignore_progress)
    assert replace(together, seconds={}, files=()) == replace(alone, seconds={}, files=())
    written = [list_files(tmp_path / f"{name}.zarr") for name in ("alone", "fleet")]
    assert written[0] == written[1]
    assert open_store(tmp_path / "fleet.zarr").blocks
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone.zarr", "fleet.zarr"]


def list_files(store: Path) -> dict[str, bytes]:
    """All that is in the folder of a store."""
    files = filter(Path.is_file, store.rglob("*"))
    return {str(file.relative_to(store)): file.read_bytes() for file in files}
