"""What the pipeline uses of small logs, what it drops and refuses, and what it says of it."""

import gzip
import json
import math
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import occmap
from occmap.cells import OccupancyMap
from occmap.errors import LogError, MapError, OccmapError, OutputError, PoseError, UsageError
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.report.results import Build, Report
from occmap.scans import stream
from occmap.types import BEAM_UPDATES, Update
from tests.readers.ros import ROS2, Written, drive, transforms, write_mcap
from tests.samples import DRIVES, PLAIN, write_csv

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
    assert made.report.beams._asdict() == {
        "hit": 3,
        "beyond_max_range": 0,
        "no_return": 0,
        "too_close": 0,
        "nan": 1,
        "own_robot": 0,
    }


def test_mapping_a_log_twice_doubles_the_evidence(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    once, twice = build([log], BEAM).map, build([log, log], BEAM).map
    np.testing.assert_allclose(twice.log_odds, 2 * once.log_odds, rtol=1e-6)


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
    with pytest.raises(MapError, match=r"cells, more than `max_cells=1000000000`; .*`max_range`"):
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


def test_without_the_wild_scan_the_map_is_made(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [*STILL, (1e7, 1e7, 0.0)], [0.3])
    report = build([log], choose(Selection(end_s=0.5))).report
    assert (report.map.columns, report.map.rows) == (4, 1)


def test_max_cells_is_a_limit_that_may_be_met(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    assert build([log], replace(BEAM, max_cells=4)).map.shape == (1, 4)
    with pytest.raises(MapError, match="4 x 1 cells, more than `max_cells=3`"):
        build([log], replace(BEAM, max_cells=3))


def test_nothing_seen_is_no_map(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [math.nan])
    with pytest.raises(MapError, match="no beam of any scan observed a cell"):
        build([log], BEAM)


def test_no_usable_scan_says_why(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    with pytest.raises(
        PoseError, match="none of 1 scans can be used: 1 outside `start_s` and `end_s`"
    ):
        build([log], choose(Selection(start_s=5)))


UNUSABLE = "pose not finite or beyond 1e12 m or without a rotation"


@pytest.mark.parametrize("unknown", [0, 1, 2])
@pytest.mark.parametrize("x", [math.nan, 1e17])
def test_a_scan_whose_pose_is_unknown_is_dropped(tmp_path: Path, unknown: int, x: float) -> None:
    poses = [(0.0, 0.0, 0.0)] * 3
    poses[unknown] = (x, 0.0, 0.0)
    report = build([write_csv(tmp_path / "log.csv", poses, [0.3])], BEAM).report
    assert (report.scans.used, report.scans.dropped) == (2, {UNUSABLE: 1})


def test_a_carmen_scan_whose_pose_nobody_knew_is_dropped_alone(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    poses = ["1 2 0", "1 2 0.5", "nan 2 0", "1 2 1"]
    lines = [f"FLASER 2 1.5 2 {pose} 1 2 0 {stamp} host 0" for stamp, pose in enumerate(poses)]
    path.write_text("".join(f"{line}\n" for line in lines))
    report = build([path], BuildOptions()).report
    assert (report.scans.used, report.scans.dropped) == (3, {UNUSABLE: 1})


def test_a_topic_that_is_not_there_names_those_that_are(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", drive(ROS2))
    with pytest.raises(LogError, match=r"no scans on the topic /front; it has scans on /scan"):
        build([log], choose(Selection(topics=("/front",))))


def test_a_log_without_scans_says_what_it_holds(tmp_path: Path) -> None:
    others = [message for message in drive(ROS2) if message.topic != "/scan"]
    log = write_mcap(tmp_path / "log.mcap", others)
    with pytest.raises(LogError, match=r"no clouds; it holds .*/tf \(tf2_msgs/msg/TFM"):
        build([log], BEAM)


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


def test_progress_goes_back_where_a_log_is_read_once_more(tmp_path: Path) -> None:
    # That 30 m stands for "no return" shows late: so many other ranges come before.
    rng = np.random.default_rng(1)
    beams = [rng.uniform(1, 9, 200).round(3).tolist() for _ in range(1500)]
    late = [[30.0] * 50 + row[50:] for row in beams[1400:]]
    head = "stamp,x,y,yaw," + ",".join(f"r{beam}" for beam in range(200))
    rows = [f"{n},0,0,0,{','.join(map(str, row))}" for n, row in enumerate(beams[:1400] + late)]
    log = tmp_path / "late.csv"
    log.write_text("\n".join(["# angle_min: 0", "# angle_increment: 0.01", head, *rows]) + "\n")
    seen: list[int] = []
    build([log], BEAM, progress=lambda scans, _total: seen.append(scans))
    assert min(seen) == -1500
    assert sum(seen) == 1500
    assert max(np.cumsum(seen)) == 1500


def build_cut(tmp_path: Path) -> Build:
    """Build from a CSV whose gzip data ends early."""
    whole = write_csv(tmp_path / "log.csv", STILL * 3000, [0.3])
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(gzip.compress(whole.read_bytes())[:-1000])
    return build([cut], BEAM, [tmp_path / "map.pgm"])


def test_damage_is_told_from_other_notes(tmp_path: Path) -> None:
    report = build_cut(tmp_path).report
    (lost,) = report.damage
    assert lost in report.notes
    assert lost.startswith(f"{tmp_path / 'cut.csv.gz'}: the gzip data is cut short")
    assert 0 < report.scans.used < 3000


def test_a_report_is_json(tmp_path: Path) -> None:
    report = build_cut(tmp_path).report
    values = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert values["scans"] == {"read": report.scans.read, "used": report.scans.used, "dropped": {}}
    assert values["map"]["columns"] == 4
    assert values["map"]["occupied"] == pytest.approx(1 / 4)
    assert values["damage"] == list(report.damage)
    assert values["files"] == [str(tmp_path / "map.pgm"), str(tmp_path / "map.yaml")]
    assert {"open", "poses", "read", "trace", "render", "write"} <= values["seconds"].keys()


@pytest.mark.parametrize(
    ("outputs", "error", "found"),
    [
        (["a.pgm", "a.pgm"], UsageError, "would be written twice"),
        (["nowhere/a.pgm"], OutputError, "does not exist"),
        (["a.jpg"], UsageError, "unknown suffix"),
    ],
)
def test_outputs_are_checked_before_the_logs(
    tmp_path: Path, outputs: list[str], error: type[OccmapError], found: str
) -> None:
    with pytest.raises(error, match=found):
        build([Path("there is no such log")], BEAM, [tmp_path / name for name in outputs])


def test_build_map_takes_names(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    model = "simple:p_hit=0.9,spread=0"
    grid = occmap.build_map(log, update="beam", model=model, resolution=0.1, hit_offset=0.0)
    assert isinstance(grid, occmap.OccupancyMap)
    # One miss at 0.4 in each of three cells, then one hit at 0.9.
    np.testing.assert_allclose(grid.probability, [[0.4, 0.4, 0.4, 0.9]], atol=1e-6)
    assert grid.observed.all()


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"update": "polgon"}, "`update` is 'polgon'; give .*polygon"),
        ({"model": "smiple"}, "no model is called 'smiple'; did you mean 'simple'"),
        ({"resolution": 0.0}, "a resolution of 0.0 m"),
        ({"jobs": 0}, "`jobs=0`"),
    ],
)
def test_build_map_refuses_what_makes_no_sense(
    tmp_path: Path, options: dict[str, Any], found: str
) -> None:
    log = write_csv(tmp_path / "log.csv", STILL, [0.3])
    with pytest.raises(UsageError, match=found):
        occmap.build_map(log, **options)


def test_build_map_needs_a_log() -> None:
    with pytest.raises(UsageError, match="no file is given; see help"):
        occmap.build_map()


def test_read_log_gives_scans_and_poses() -> None:
    log = occmap.read_log(DRIVES[-1])
    assert sum(1 for _ in log.scans(["/scan"])) == 414
    assert next(iter(log.poses())).topic in ("/tf", "/tf_static")


def test_a_name_that_occmap_lacks_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'build_maps'"):
        _ = occmap.build_maps
    assert set(occmap.__all__) <= set(dir(occmap))
    assert all(getattr(occmap, name) for name in occmap.__all__)


def test_a_report_needs_no_files(tmp_path: Path) -> None:
    report = build([write_csv(tmp_path / "log.csv", STILL, [0.3])], BEAM).report
    assert isinstance(report, Report)
    assert report.files == ()
    assert list(tmp_path.iterdir()) == [tmp_path / "log.csv"]


def test_a_log_that_is_given_twice_is_noted() -> None:
    once = build([DRIVES[0]], BuildOptions()).report
    twice = build([DRIVES[0], DRIVES[0]], BuildOptions()).report
    assert once.notes == ()
    assert twice.notes == (f"{DRIVES[0]}: given 2 times, and counted as often",)
    assert twice.scans.used == 2 * once.scans.used


def test_a_damaged_mount_is_named_where_it_is_missed(tmp_path: Path) -> None:
    broken = transforms(ROS2, 10**9, [("base", "/laser", math.nan)])
    log = [Written("/tf_static", 10**9, broken), *drive(ROS2)[1:]]
    with pytest.raises(PoseError, match=r"1 pose of base -> /?laser left out: not finite.*; give"):
        build([write_mcap(tmp_path / "log.mcap", log)], BEAM)


def test_damage_is_named_where_it_leaves_no_scan(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", drive(ROS2))
    content = log.read_bytes()
    log.write_bytes(content[: content.index(b"sensor_msgs/msg/LaserScan")])
    with pytest.raises(LogError, match=r"no clouds; it holds .*; the file ends in the middle"):
        build([log], BEAM)


def test_a_base_frame_that_nothing_asks_for_is_noted(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", drive(ROS2))
    report = build([log], replace(BEAM, posing=PosingOptions(base_frame="base"))).report
    assert any("`base_frame` does nothing" in note for note in report.notes)
