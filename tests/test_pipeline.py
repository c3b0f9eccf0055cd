"""One simulated drive makes one map in any way; what is used of small logs, dropped, refused."""

import gzip
import json
import math
import tracemalloc
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import occmap
from occmap.cells import Decision, OccupancyMap
from occmap.errors import MapError, OccmapError, PoseError, UsageError
from occmap.grid.rendering import Framing
from occmap.inspection import inspect
from occmap.options import BuildOptions, Selection, choose_model
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.readers import text_log
from occmap.scans import make_engine, stream, tracing
from occmap.scoring.compare import combine, compare
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import parse_model
from occmap.store.merging import merge
from occmap.types import BEAM_UPDATES, Bool, Pose, Update
from occmap.writers.npz import read_evidence
from tests.evidence import saving
from tests.grid.scans import are_equal
from tests.inspection_logs import Drive, write_bag
from tests.inspection_logs import write_csv as write_room
from tests.map_loaders import load_nav2
from tests.posing.scenes import attach, batch_at, bolted, yaw_of
from tests.posing.scenes import build as make_poser
from tests.posing.scenes import drive as move
from tests.readers.ros import ROS2, Written, drive, transforms, write_mcap
from tests.samples import DRIVES, PLAIN, SAMPLE_LOGS, Planar, write_csv, write_late

MODELS = ("simple", "quadratic", "counting")


def choose(update: Update, model: str, jobs: int = 1) -> BuildOptions:
    return BuildOptions(update=update, model=parse_model(model), jobs=jobs)


def write_map(folder: Path, logs: list[Path], options: BuildOptions) -> bytes:
    """Return the bytes of the PGM, of its YAML and of the log-odds, which hide no difference.

    Of the YAML the last line names the logs.
    """
    grid = build(logs, options, [folder / "map.pgm"]).map
    *lines, of_logs = (folder / "map.yaml").read_bytes().splitlines()
    assert of_logs.startswith(b"# logs: ")
    files = [(folder / "map.pgm").read_bytes(), *lines]
    return b"".join([*files, grid.log_odds.tobytes()])


@pytest.mark.parametrize(("update", "model"), list(zip(BEAM_UPDATES, MODELS, strict=True)))
def test_five_formats_give_one_map(tmp_path: Path, update: Update, model: str) -> None:
    maps = {write_map(tmp_path, [log], choose(update, model)) for log in DRIVES}
    assert len(maps) == 1


def grow(cells: Bool) -> Bool:
    """Add the eight neighbours of every cell."""
    rows, cols = cells.shape
    padded = np.pad(cells, 1)
    shifted = [padded[r : r + rows, c : c + cols] for r in range(3) for c in range(3)]
    grown: Bool = np.logical_or.reduce(shifted)
    return grown


def crop_to_plan(grid: OccupancyMap, cells: Bool) -> Bool:
    """Cut out what the floor plan shows: 16 by 12 m from (-4, -3)."""
    row, col = round((-3 - grid.origin[1]) / 0.05), round((-4 - grid.origin[0]) / 0.05)
    return cells[row : row + 240, col : col + 320]


LONE = {"simple": "simple:spread=0", "counting": "counting:spread=0,ceiling=1,doubt=0"}
"""Models by which a hit speaks for its own cell alone"""


@pytest.mark.parametrize("no_return", NoReturn)
@pytest.mark.parametrize(("update", "model"), list(product(BEAM_UPDATES, (*MODELS, ""))))
def test_the_map_agrees_with_the_floor_plan(
    update: Update, model: str, no_return: NoReturn
) -> None:
    """With a model that is named, beams end where they were measured, and classes are as nav2's
    map_saver has them. As usual, hits are half a cell deeper and speak for the cells beside them,
    so that walls are a cell thicker."""
    plan = load_nav2(SAMPLE_LOGS / "floor_plan.yaml")
    wall, free = plan == 100, plan == 0
    rule = parse_model(LONE.get(model, model)) if model else choose_model(update)
    returns, offset = ReturnOptions(no_return=no_return), 0.0 if model else BuildOptions.hit_offset
    options = BuildOptions(update=update, model=rule, returns=returns, hit_offset=offset)
    grid = build(DRIVES[:1], options).map
    if model:
        grid = replace(grid, decision=Decision(0.196, 0.65))
    occupied_cells, free_cells = (crop_to_plan(grid, each) for each in (grid.occupied, grid.free))
    # Of the faces 98.9% were hit within a cell; the rest was never in sight.
    assert grow(occupied_cells)[wall].mean() > 0.98
    assert free_cells[free].mean() > 0.97
    assert grow(wall)[occupied_cells].mean() > (0.999 if model else 0.98)
    assert grow(grow(wall))[occupied_cells].mean() > 0.999
    assert free_cells[wall].mean() < 0.002
    assert model or (grid.agreement or 0.0) > 0.9  # poses of a simulated drive are true


@pytest.fixture(params=saving.COMBINATIONS, ids=lambda pair: f"{pair[0]}-{pair[1]}", scope="module")
def reference(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Update, str, bytes]:
    """Build two logs one after the other, in one thread."""
    update, model = request.param
    folder = tmp_path_factory.mktemp("reference")
    return update, model, write_map(folder, DRIVES[:2], choose(update, model))


@pytest.mark.parametrize(
    ("jobs", "backwards", "beams", "window"),
    [
        (1, True, 1 << 18, 0),
        (2, False, 1 << 18, 0),
        (5, False, 1 << 18, 0),
        (1, False, 5000, 0),
        (1, False, 1 << 20, 0),
        (1, False, 1 << 18, 20_000),
    ],
    ids=["order", "2 threads", "5 threads", "small batches", "large batches", "small windows"],
)
def test_the_way_it_is_made_changes_nothing(
    tmp_path: Path,
    reference: tuple[Update, str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    jobs: int,
    backwards: bool,
    beams: int,
    window: int,
) -> None:
    update, model, expected = reference
    monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
    if window:
        monkeypatch.setattr(tracing, "make_engine", partial(make_engine, window_cells=window))
    logs = DRIVES[1::-1] if backwards else DRIVES[:2]
    assert write_map(tmp_path, logs, choose(update, model, jobs)) == expected


DRIVE = [Drive().pose(index) for index in range(20)]
SHIFT = (16.0, -8.5, math.pi / 2)
"""A frame so far away that binary fractions of a metre are moved exactly, a quarter turn round."""


def move_back(pose: Planar) -> Planar:
    """Say where a pose is in a frame that lies at SHIFT."""
    x, y, yaw = pose
    right, up, turn = SHIFT
    return y - up, right - x, yaw - turn


def test_logs_in_frames_of_different_names_are_noted(tmp_path: Path) -> None:
    level = [(0.0, 0.0)]
    first = write_bag(tmp_path / "first.bag", Drive(), level)
    second = write_bag(tmp_path / "second.bag", Drive(), level, correct=lambda _: (0.0, 0.0, 0.0))
    (note,) = (it for it in build([first, second], PLAIN).report.notes if "different frames" in it)
    told = f"{first} in odom, {second} in map", "`map_frame`", "`transform`"
    assert all(words in note for words in told)
    assert inspect([first, second], PLAIN).warnings[-1] == note
    one_frame = replace(PLAIN, posing=PosingOptions(map_frame="odom"))
    for made in (build([first, second], one_frame), build([first, first], PLAIN)):
        assert not [each for each in made.report.notes if "different frames" in each]
    with pytest.raises(UsageError, match=rf"{first} in odom, {second} in map; .* `map_frame`"):
        compare([first, second], combine([Update.BEAM], []), PLAIN)
    build([first], PLAIN, [tmp_path / "m.npz"])
    scored = occmap.score(tmp_path / "m.npz", logs=[first, second], within_m=0.1)
    assert any(f"different frames: {told[0]}" in note for note in scored.notes)


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_two_sessions_in_different_frames_make_one_map(tmp_path: Path, update: Update) -> None:
    whole = write_room(tmp_path / "whole.csv", Drive(), poses=DRIVE)
    first = write_room(tmp_path / "first.csv", Drive(), poses=DRIVE[:8])
    poses = [move_back(pose) for pose in DRIVE[8:]]
    second = write_room(tmp_path / "second.csv", Drive(), poses=poses, first=8)
    options = replace(PLAIN, update=update)
    moved = replace(options, posing=PosingOptions(transform=Pose.planar(*SHIFT)))

    expected = build([whole], options).map
    build([first], options, [tmp_path / "first.npz"])
    resumed = build([second], replace(moved, resume=tmp_path / "first.npz")).map
    assert resumed.box == expected.box
    assert np.array_equal(resumed.log_odds, expected.log_odds)
    unmoved = build([second], replace(options, resume=tmp_path / "first.npz")).map
    assert unmoved.shape != expected.shape

    build([second], moved, [tmp_path / "second.npz"])
    halves = [read_evidence(tmp_path / f"{name}.npz") for name in ("first", "second")]
    build([whole], options, [tmp_path / "whole.npz"])
    assert are_equal(merge(halves).tiles, read_evidence(tmp_path / "whole.npz").tiles)


def test_a_transform_moves_the_sensor_of_every_source_of_poses() -> None:
    samples = [*move("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0.5, 0, 0))]
    poser = make_poser(*samples, transform=Pose.planar(10.0, 20.0, math.pi / 2))
    (posed,), _ = attach(poser, batch_at([0, 4]))
    # On the way along x, 0.5 m ahead of the base; along y in the frame of the map.
    assert posed.position == pytest.approx(np.array([[10, 20.5, 0], [10, 24.5, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)
    # A given angle turns the map after that.
    poser = make_poser(*samples, transform=Pose.planar(10.0, 0.0, 0.0), align=90.0)
    (posed,), _ = attach(poser, batch_at([0, 4]))
    assert posed.position == pytest.approx(np.array([[0, 10.5, 0], [0, 14.5, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)


def test_each_beam_of_a_deskewed_scan_is_moved() -> None:
    samples = [*move("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0, 0, 0))]
    poser = make_poser(*samples, deskew=Deskew.ON, transform=Pose.planar(0.0, 5.0, 0.0))
    (posed,), _ = attach(poser, batch_at([2], beams=3, time_increment=1.0))
    assert posed.position == pytest.approx(np.array([[[2, 5, 0], [3, 5, 0], [4, 5, 0]]]))


def test_an_extent_leaves_the_evidence_whole(tmp_path: Path) -> None:
    log = write_room(tmp_path / "log.csv", Drive(), poses=DRIVE)
    whole = build([log], PLAIN, [tmp_path / "whole.npz"])
    framed = replace(PLAIN, framing=Framing(extent=(0.0, 0.0, 2.0, 1.0)))
    made = build([log], framed, [tmp_path / "framed.npz", tmp_path / "framed.pgm"])
    assert (made.report.map.columns, made.report.map.rows) == (40, 20)
    assert made.report.map.extent == made.map.extent == (0.0, 0.0, 2.0, 1.0)
    assert (tmp_path / "framed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert whole.report.map.agreement == 1
    assert made.report.map.agreement is None  # no hit lies in it


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
    report = build([log], replace(BEAM, selection=Selection(start_s=2, end_s=7, stride=2))).report
    # Of the seconds 2, 3, 4, 5 and 6 every second one.
    assert (report.scans.read, report.scans.used) == (10, 3)
    assert report.scans.dropped == {"outside `start_s` and `end_s`": 5, "left out by `stride`": 2}
    assert (report.map.columns, report.map.rows) == (41, 4)


@pytest.mark.parametrize("cut_s", [3, 3.5])
def test_parts_that_meet_share_no_scan_and_lose_none(tmp_path: Path, cut_s: float) -> None:
    path = [(float(second), 0.05, QUARTER) for second in range(10)]
    log = write_csv(tmp_path / "log.csv", path, [0.3])
    parts = Selection(end_s=cut_s), Selection(start_s=cut_s)
    used = [build([log], replace(BEAM, selection=part)).report.scans.used for part in parts]
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
    pairs = replace(BEAM, selection=Selection(start_s=0))  # so that each batch is made of two scans
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
