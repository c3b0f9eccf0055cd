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


@pytest.mark.parametrize(
    "options",
    [
        BuildOptions(jobs=1, resolution=0.02),  # more than a block, with hits at its edges
        BuildOptions(
            jobs=1,
            update=Update.BEAM,
            model=parse_model("quadratic"),
            selection=Selection(end_s=1e6),  # leaves nothing out, which is a note
        ),
    ],
)
def test_it_holds_what_one_process_writes(
    address: str, tmp_path: Path, options: BuildOptions
) -> None:
    logs = [DRIVES[0], DRIVES[4], DRIVES[0]]
    alone = build(logs, options, [tmp_path / "alone.zarr"]).report
    fleet = Fleet(address, tmp_path / "scratch")
    together = fleet.build(logs, options, [tmp_path / "fleet.zarr"], ignore_progress)
    assert replace(together, seconds={}, files=()) == replace(alone, seconds={}, files=())
    one, other = (open_store(tmp_path / f"{name}.zarr") for name in ("alone", "fleet"))
    assert one.digest == other.digest
    assert one.manifest == other.manifest
    assert one.blocks == other.blocks
    for name in ("hits", "misses") if one.manifest.kind == "counts" else ("log_odds",):
        assert (one.root[name][:] == other.root[name][:]).all()
    for level in one.root["classes"]:
        assert (one.root["classes"][level][:] == other.root["classes"][level][:]).all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone.zarr", "fleet.zarr"]


def test_it_holds_the_ground_of_clouds(address: str, tmp_path: Path) -> None:
    logs, options = [SAMPLE_LOGS / "hall.mcap"], BuildOptions(jobs=1)
    build(logs, options, [tmp_path / "alone.zarr"])
    fleet = Fleet(address, tmp_path / "scratch")
    fleet.build(logs, options, [tmp_path / "fleet.zarr"], ignore_progress)
    one, other = (open_store(tmp_path / f"{name}.zarr") for name in ("alone", "fleet"))
    assert one.digest == other.digest
    below, its = one.ground, other.ground
    assert below is not None
    assert its is not None
    assert (below.height_mm == its.height_mm).all()
    assert (below.measured == its.measured).all()
