"""One simulated drive: the same map from every format, in any order and in frames of its own."""

import math
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Decision, OccupancyMap
from occmap.errors import UsageError
from occmap.grid.rendering import Framing
from occmap.options import BuildOptions, choose_model
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.scans import make_engine, stream, tracing
from occmap.scoring.compare import combine, compare
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import parse_model
from occmap.store.merging import merge
from occmap.types import BEAM_UPDATES, Bool, Pose, Update
from occmap.writers.npz import read_evidence
from tests.grid.scans import are_equal
from tests.inspection_logs import Drive, write_bag, write_csv
from tests.map_loaders import load_nav2
from tests.posing.scenes import attach, batch_at, bolted, drive, yaw_of
from tests.posing.scenes import build as make_poser
from tests.samples import DRIVES, PLAIN, SAMPLE_LOGS, Planar

COMBINATIONS = list(product(BEAM_UPDATES, ["simple", "quadratic", "counting"]))
each_combination = pytest.mark.parametrize(("update", "model"), COMBINATIONS)


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


@each_combination
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
@pytest.mark.parametrize(
    ("update", "model"), [*COMBINATIONS, *((update, "") for update in BEAM_UPDATES)]
)
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


@pytest.fixture(params=COMBINATIONS, ids=lambda pair: f"{pair[0]}-{pair[1]}", scope="module")
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
    one_frame = replace(PLAIN, posing=PosingOptions(map_frame="odom"))
    for made in (build([first, second], one_frame), build([first, first], PLAIN)):
        assert not [each for each in made.report.notes if "different frames" in each]
    with pytest.raises(UsageError, match=rf"{first} in odom, {second} in map; .* `map_frame`"):
        compare([first, second], combine([Update.BEAM], []), PLAIN)


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_two_sessions_in_different_frames_make_one_map(tmp_path: Path, update: Update) -> None:
    whole = write_csv(tmp_path / "whole.csv", Drive(), poses=DRIVE)
    first = write_csv(tmp_path / "first.csv", Drive(), poses=DRIVE[:8])
    poses = [move_back(pose) for pose in DRIVE[8:]]
    second = write_csv(tmp_path / "second.csv", Drive(), poses=poses, first=8)
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
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0.5, 0, 0))]
    poser = make_poser(*samples, transform=Pose.planar(10.0, 20.0, math.pi / 2))
    (posed,), _ = attach(poser, batch_at([0, 4]))
    # On the way along x, 0.5 m ahead of the base; along y in the frame of the map.
    assert posed.position == pytest.approx(np.array([[10, 20.5, 0], [10, 24.5, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)


def test_a_given_angle_turns_the_map_after_the_transform() -> None:
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0, 0, 0))]
    poser = make_poser(*samples, transform=Pose.planar(10.0, 0.0, 0.0), align=90.0)
    (posed,), _ = attach(poser, batch_at([0, 4]))
    assert posed.position == pytest.approx(np.array([[0, 10, 0], [0, 14, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)


def test_each_beam_of_a_deskewed_scan_is_moved() -> None:
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0, 0, 0))]
    poser = make_poser(*samples, deskew=Deskew.ON, transform=Pose.planar(0.0, 5.0, 0.0))
    (posed,), _ = attach(poser, batch_at([2], beams=3, time_increment=1.0))
    assert posed.position == pytest.approx(np.array([[[2, 5, 0], [3, 5, 0], [4, 5, 0]]]))


def test_an_extent_leaves_the_evidence_whole(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", Drive(), poses=DRIVE)
    whole = build([log], PLAIN, [tmp_path / "whole.npz"])
    framed = replace(PLAIN, framing=Framing(extent=(0.0, 0.0, 2.0, 1.0)))
    made = build([log], framed, [tmp_path / "framed.npz", tmp_path / "framed.pgm"])
    assert (made.report.map.columns, made.report.map.rows) == (40, 20)
    assert made.report.map.extent == made.map.extent == (0.0, 0.0, 2.0, 1.0)
    assert (tmp_path / "framed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert whole.report.map.agreement == 1
    assert made.report.map.agreement is None  # no hit lies in it
