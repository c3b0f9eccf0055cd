"""Many workers make what one process makes, byte for byte: maps, stores and what tasks leave."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from occmap.clouds import CloudOptions
from occmap.fleet import Fleet
from occmap.fleet.cluster import Job
from occmap.fleet.tasks import Setting, add_up, trace_log
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.readers import text_log
from occmap.report.results import Report
from occmap.scans import Keep
from occmap.scans.tracing import ignore_progress
from occmap.sensor.models import QuadraticModel
from occmap.store import open_store
from occmap.types import Pose, Update
from occmap.writers import WriteOptions
from tests.clouds.simulation import HALL, turn, write_leaning, write_tour
from tests.grid.scans import are_equal
from tests.samples import DRIVES, SAMPLE_LOGS, write_late
from tests.store.test_store import list_files

LOGS = [*DRIVES, DRIVES[0]]
"""One of them twice"""


SUFFIXES = "npz", "pgm", "tum"
Made = tuple[Report, list[bytes]]
"""What a build says, and all that it writes"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Callable[[BuildOptions], Made]:
    """What one process makes of the logs; it is asked once."""

    @cache
    def build_alone(options: BuildOptions) -> Made:
        folder = tmp_path_factory.mktemp("alone")
        outputs = [folder / f"alone.{suffix}" for suffix in SUFFIXES]
        report = build(LOGS, options, outputs).report
        return report, [output.read_bytes() for output in outputs]

    return build_alone


def hold_equal(expected: Made, options: BuildOptions, fleet: Fleet, folder: Path) -> None:
    """Build by workers, and hold all that was written and said equal."""
    outputs = [folder / f"fleet.{suffix}" for suffix in SUFFIXES]
    report = build(LOGS, options, outputs, observe=fleet.observe).report
    assert [output.read_bytes() for output in outputs] == expected[1]
    said = [replace(each, seconds={}, files=()) for each in (expected[0], report)]
    assert said[0] == said[1]
    assert not fleet.scratch.exists()


PLAIN = BuildOptions(jobs=1, resolution=0.2)


@pytest.mark.parametrize(
    "options",
    [
        PLAIN,
        replace(PLAIN, posing=PosingOptions(align=None)),
        *(
            replace(PLAIN, selection=selection, min_passes=2, pass_gap_s=1.0)
            for selection in (Selection(start_s=3.3, end_s=21.7), Selection(start_s=5.0, stride=4))
        ),
    ],
)
def test_the_files_and_the_report_are_those_of_one_process(
    address: str, alone: Callable[[BuildOptions], Made], tmp_path: Path, options: BuildOptions
) -> None:
    hold_equal(alone(options), options, Fleet(address, tmp_path / "scratch"), tmp_path)


def draw(folder: Path, shapes: str) -> WriteOptions:
    """Ask for edits over a map, in a file beside the folder of a test."""
    edits = folder.with_suffix(".csv")
    edits.write_text(shapes)
    return WriteOptions(edits=edits)


def test_a_worker_of_its_own_makes_the_same(
    alone: Callable[[BuildOptions], Made], tmp_path: Path
) -> None:
    """Edits go over its maps, too."""
    options = replace(PLAIN, writing=draw(tmp_path, "free,box,10.9,-1.5,11.5,-0.9\n"))
    assert alone(options)[1][1] != alone(PLAIN)[1][1]
    hold_equal(alone(options), options, Fleet("local", tmp_path / "scratch"), tmp_path)


@pytest.mark.parametrize("corrected", ["", "level", "height_drift"])
def test_clouds_of_several_logs_are_traced_over_one_ground(
    address: str, tmp_path: Path, corrected: str
) -> None:
    """By threads, too: as their poses are, where these lean, and where they drift."""
    logs, options = [HALL] * 2, BuildOptions(jobs=1, resolution=0.1)
    if corrected == "level":
        poses = write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))
        options = replace(options, posing=PosingOptions(poses=str(poses)))
    elif corrected:
        logs = [tmp_path / "tour"]
        options = write_tour(logs[0], drift_m=0.3)
    files = [tmp_path / name for name in ("alone.npz", "threads.npz", "fleet.npz")]
    alone = build(logs, options, files[:1]).report
    build(logs, replace(options, jobs=2), files[1:2])
    fleet = Fleet(address, tmp_path / "scratch")
    report = build(logs, options, files[2:], observe=fleet.observe).report
    assert len({file.read_bytes() for file in files}) == 1
    assert sorted(report.notes) == sorted(alone.notes)
    for option in ("level", "height_drift"):
        assert any(f"`{option}=" in note for note in alone.notes) == (option == corrected)


TWICE = [DRIVES[0], DRIVES[4], DRIVES[0]]
"""One log is given twice"""


TURNED = BuildOptions(jobs=1, posing=PosingOptions(sensor_pose=Pose.planar(0, 0, 3.14)))
RADIAL = BuildOptions(update=Update.BEAM, model=QuadraticModel(), jobs=1)


@pytest.mark.parametrize(
    ("logs", "options"),
    [
        (TWICE, BuildOptions(jobs=1, resolution=0.02)),  # more than a block, with hits at its edges
        (TWICE, RADIAL),
        ([HALL], TURNED),  # clouds, over a ground, that contradict each other
    ],
)
def test_it_holds_what_one_process_writes(
    address: str, tmp_path: Path, logs: list[Path], options: BuildOptions
) -> None:
    if options is RADIAL:
        options = replace(options, writing=draw(tmp_path, "occupied,box,-100,-100,100,0\n"))
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


def test_a_log_that_is_read_twice_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory holds next to nothing, so run files are written in both readings."""
    monkeypatch.setattr(text_log, "BLOCK_BYTES", 3000)  # ten scans or so
    log = write_late(tmp_path / "late.csv", scans=60, marked_from=30)
    options = BuildOptions(jobs=1, pass_gap_s=2.0)
    alone = build([log], options)
    folder = tmp_path / "scratch"
    folder.mkdir()
    setting = Setting(options, Keep(slices=True), folder, 1, window_cells=1 << 20, most_bytes=1)
    tally, traced = trace_log(setting, Job("log", str(log)))
    pieces = [piece for block in sorted(traced) for piece in traced[block]]
    seen = add_up(setting, pieces)
    files = {piece.file for piece in pieces}
    assert len(files) > 1
    assert len(list(folder.glob("*.run"))) > len(files)
    assert tally.scans_used == 60
    assert tally.beams == alone.report.beams
    assert are_equal(seen.tiles, alone.evidence.tiles)
    assert any("30 m" in note for note in tally.notes)
