"""A store that workers write holds what one process writes, and the report says the same."""

from dataclasses import replace
from pathlib import Path

import pytest

from occmap.clouds import CloudOptions
from occmap.fleet import Fleet
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.scans.tracing import ignore_progress
from occmap.sensor.models import QuadraticModel
from occmap.store import open_store
from occmap.types import Update
from tests.samples import DRIVES, SAMPLE_LOGS
from tests.store.test_store import list_files

TWICE = [DRIVES[0], DRIVES[4], DRIVES[0]]
"""One log is given twice"""


EVERY_SCAN = Selection(end_s=1e6)
"""It leaves nothing out, which is a note"""
RADIAL = BuildOptions(update=Update.BEAM, model=QuadraticModel(), selection=EVERY_SCAN, jobs=1)


@pytest.mark.parametrize(
    ("logs", "options"),
    [
        (TWICE, BuildOptions(jobs=1, resolution=0.02)),  # more than a block, with hits at its edges
        (TWICE, RADIAL),
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


def test_it_lies_over_the_ground_that_is_given(address: str, tmp_path: Path) -> None:
    logs, first = [SAMPLE_LOGS / "hall.mcap"], tmp_path / "first.npz"
    build(logs, BuildOptions(jobs=1, selection=Selection(end_s=2.0)), [first])
    options = BuildOptions(jobs=1, clouds=CloudOptions(ground=str(first)))
    build(logs, options, [tmp_path / "alone.zarr"])
    fleet = Fleet(address, tmp_path / "scratch")
    fleet.build(logs, options, [tmp_path / "fleet.zarr"], ignore_progress)
    assert list_files(tmp_path / "alone.zarr") == list_files(tmp_path / "fleet.zarr")
