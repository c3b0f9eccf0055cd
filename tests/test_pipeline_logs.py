"""What the pipeline uses of small logs, what it drops and refuses, and what it says of it."""

import gzip
import json
import math
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import occmap
from occmap.cells import OccupancyMap
from occmap.errors import MapError, OccmapError, PoseError
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.readers import text_log
from occmap.scans import stream
from occmap.types import BEAM_UPDATES, Update
from tests.readers.ros import ROS2, Written, drive, transforms, write_mcap
from tests.samples import DRIVES, PLAIN, write_csv, write_late

QUARTER = math.pi / 2
BEAM = replace(PLAIN, resolution=0.1)
STILL = [(0.05, 0.05, 0.0)]
"""In the middle of cell (0, 0) at 10 cm."""


def show(grid: OccupancyMap) -> list[str]:
    """Draw a map, highest row first."""
    marks = np.full(grid.shape, ".")
    marks[grid.free] = " "
    marks[grid.occupied] = "#"
    return ["".join(row) for row in marks[::-1]]


def choose(selection: Selection) -> BuildOptions:
    return replace(BEAM, selection=selection)


def test_two_sensors_make_one_map(tmp_path: Path) -> None:
    ahead = write_csv(tmp_path / "ahead.csv", STILL, [0.3])
    fan = write_csv(tmp_path / "fan.csv", STILL, [math.nan, 0.2, 0.4], QUARTER)
    made = build([ahead, fan], BEAM)
    # Ahead three cells to the right; left (the second beam) two up; behind four to the left.
    assert show(made.map) == ["....#...", ".... ...", "#      #"]
    assert made.map.extent == pytest.approx((-0.4, 0, 0.4, 0.3))
    assert made.report.logs == (str(ahead), str(fan))
    assert made.report.scans.used == 2
    assert {name: n for name, n in made.report.beams._asdict().items() if n} == {"hit": 3, "nan": 1}


def test_mapping_a_log_twice_doubles_the_evidence_and_is_noted(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    once, twice = build([log], BEAM), build([log, log], BEAM)
    np.testing.assert_allclose(twice.map.log_odds, 2 * once.map.log_odds, rtol=1e-6)
    assert (once.report.notes, once.report.files) == ((), ())
    (note,) = twice.report.notes
    assert note.startswith("log.csv is in it more than once")
    assert twice.report.scans.used == 2


def test_notes_on_builds_do_not_depend_on_the_format(tmp_path: Path) -> None:
    log, past = write_csv(tmp_path / "log.csv", STILL, [0.3]), tmp_path / "past.npz"
    surface = replace(BEAM, update=Update.SURFACE)
    build([log], surface, [past])
    other = replace(surface, jump=0.5, resume=past)
    told = [
        build([log], other, [tmp_path / f"m.{suffix}"]).report.notes for suffix in ("pgm", "npz")
    ]
    assert told[0] == told[1]
    repeated, differing = told[0]
    assert repeated.startswith("log.csv is in it more than once")
    assert differing == "its builds differ in `jump` (0.1, 0.5)"


def test_start_end_and_stride_choose_scans(tmp_path: Path) -> None:
    path = [(float(second), 0.05, QUARTER) for second in range(10)]
    log = write_csv(tmp_path / "log.csv", path, [0.3])
    report = build([log], choose(Selection(start_s=2, end_s=7, stride=2))).report
    # Of the seconds 2, 3, 4, 5 and 6 every second one.
    assert (report.scans.read, report.scans.used) == (10, 3)
    assert report.scans.dropped == {"outside `start_s` and `end_s`": 5, "left out by `stride`": 2}
    assert (report.map.columns, report.map.rows) == (41, 4)


@pytest.mark.parametrize("cut_s", [3, 3.5])
def test_parts_that_meet_share_no_scan_and_lose_none(tmp_path: Path, cut_s: float) -> None:
    path = [(float(second), 0.05, QUARTER) for second in range(10)]
    log = write_csv(tmp_path / "log.csv", path, [0.3])
    parts = Selection(end_s=cut_s), Selection(start_s=cut_s)
    used = [build([log], choose(part)).report.scans.used for part in parts]
    assert used == ([3, 7] if cut_s == 3 else [4, 6])


def test_a_wild_pose_costs_no_memory_and_is_refused_by_its_extent(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [*STILL, (1e7, 1e7, 0.0), *STILL], [0.3])
    tracemalloc.start()
    try:
        with pytest.raises(MapError) as caught:
            build([log], BEAM)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert "to (10000000.4, 10000000.1) m: " in str(caught.value)
    assert "more than `max_cells=1000000000`; if a pose is wrong" in str(caught.value)
    assert peak < 200e6  # the world between would be 10^16 cells


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_a_wild_range_is_refused_at_once(tmp_path: Path, update: Update) -> None:
    log = write_csv(tmp_path / "log.csv", STILL * 3, [1e5, 1e5], 0.1)
    with pytest.raises(MapError, match=r"cells, more than `max_cells=1000000000`; .*millimetres"):
        build([log], BuildOptions(update=update, jobs=1))


def test_a_large_map_is_refused_in_the_same_words_with_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "BATCH_BEAMS", 4096)
    far = [(10.0 * scan, 10.0 * scan, 0.0) for scan in range(40)]
    log = write_csv(tmp_path / "log.csv", far, [5.0] * 2048, math.tau / 2048)
    pairs = choose(Selection(start_s=0))  # so that each batch is made of two scans
    said = set()
    for jobs in (1, 2, 4):
        with pytest.raises(MapError) as caught:
            build([log], replace(pairs, jobs=jobs, max_cells=10**6))
        said.add(str(caught.value))
    (sentence,) = said
    assert "the map would reach at least from (-5, -5) to (" in sentence
    assert "to (395" not in sentence  # it is refused before the last scan, at (390, 390)


def test_max_cells_is_a_limit_that_may_be_met(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    assert build([log], replace(BEAM, max_cells=4)).map.shape == (1, 4)
    with pytest.raises(MapError, match="4 x 1 cells, more than `max_cells=3`"):
        build([log], replace(BEAM, max_cells=3))


UNUSABLE = "pose not finite or beyond 1e12 m or without a rotation"


@pytest.mark.parametrize("unknown", [0, 1, 2])
@pytest.mark.parametrize("x", [math.nan, 1e17])
def test_a_scan_whose_pose_is_unknown_is_dropped(tmp_path: Path, unknown: int, x: float) -> None:
    poses = [(0.0, 0.0, 0.0)] * 3
    poses[unknown] = (x, 0.0, 0.0)
    report = build([write_csv(tmp_path / "log.csv", poses, [0.3])], BEAM).report
    assert (report.scans.used, report.scans.dropped) == (2, {UNUSABLE: 1})


def test_every_log_is_checked_before_the_first_is_mapped(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    good = write_csv(tmp_path / "good.csv", STILL, [0.3])
    bad = write_mcap(tmp_path / "bad.mcap", [Written("/chatter", 0, drive(ROS2)[0].message)])
    with pytest.raises(OccmapError, match=r"bad\.mcap"):
        build([good, bad], BEAM, progress=lambda scans, total: seen.append((scans, total)))
    assert seen == []


def test_progress_counts_the_scans_of_all_logs() -> None:
    seen: list[tuple[int, int]] = []
    build(DRIVES[:2], BEAM, progress=lambda scans, total: seen.append((scans, total)))
    assert sum(scans for scans, _ in seen) == 828
    assert {total for _, total in seen} == {828}


def test_progress_goes_back_where_a_log_is_read_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That 30 m stands for "no return" shows late: so many other ranges come before."""
    monkeypatch.setattr(text_log, "BLOCK_BYTES", 3000)  # ten scans or so
    log = write_late(tmp_path / "late.csv", scans=60, marked_from=30)
    seen: list[int] = []
    build([log], BEAM, progress=lambda scans, _total: seen.append(scans))
    assert min(seen) == -60
    assert sum(seen) == 60
    assert max(np.cumsum(seen)) == 60


def test_a_report_is_json_and_tells_damage_from_other_notes(tmp_path: Path) -> None:
    """The gzip data of the log ends early."""
    whole = write_csv(tmp_path / "log.csv", STILL * 3000, [0.3])
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    report = build([cut], BEAM, [tmp_path / "map.pgm"]).report
    (lost,) = report.damage
    assert lost in report.notes
    assert lost.startswith(f"{cut}: the gzip data is cut short")
    assert 0 < report.scans.used < 3000
    values = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert values["scans"] == {"read": report.scans.read, "used": report.scans.used, "dropped": {}}
    assert values["map"]["columns"] == 4
    assert values["map"]["occupied"] == pytest.approx(1 / 4)
    assert values["damage"] == [lost]
    assert values["files"] == [str(tmp_path / "map.pgm"), str(tmp_path / "map.yaml")]
    assert {"open", "poses", "read", "trace", "render", "write"} <= values["seconds"].keys()


def test_a_name_that_occmap_lacks_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'build_maps'"):
        _ = occmap.build_maps
    assert set(occmap.__all__) <= set(dir(occmap))
    assert all(getattr(occmap, name) for name in occmap.__all__)


def test_a_damaged_mount_is_named_where_it_is_missed(tmp_path: Path) -> None:
    broken = transforms(ROS2, 10**9, [("base", "/laser", math.nan)])
    log = [Written("/tf_static", 10**9, broken), *drive(ROS2)[1:]]
    with pytest.raises(PoseError, match=r"1 pose of base -> /?laser left out: not finite.*; give"):
        build([write_mcap(tmp_path / "log.mcap", log)], BEAM)


def test_a_base_frame_that_nothing_asks_for_is_noted(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", drive(ROS2))
    report = build([log], replace(BEAM, posing=PosingOptions(base_frame="base"))).report
    assert any("`base_frame` does nothing" in note for note in report.notes)
