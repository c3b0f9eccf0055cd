"""Sessions in frames of their own: where one lies in the other is found, or it is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Evidence, Manifest
from occmap.choices import format_mount, to_rpy
from occmap.difference.maps import Place
from occmap.errors import MapError, PoseError
from occmap.evidence import paint_box, render, to_grid
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.scans import Keep
from occmap.scans.tracing import ignore_progress, observe
from occmap.scoring.matching import Walls, find_match, fit_logs, lay_on
from occmap.store.merging import Transform, merge, move_evidence
from occmap.types import Pose, Update
from tests.clouds.simulation import HALL, hall, turn, write_leaning
from tests.evidence.saving import DRIVE, halve, save
from tests.grid.scans import are_equal, assert_same_slices, make_grid, read_cells
from tests.samples import find_real

MOVED = (1.2, -0.7, 0.2)
FIRST, SECOND = halve(BuildOptions(), 41.3)


def save_first_half(folder: Path, align: float = 0.0) -> Evidence:
    """Of the drive, where the map's frame is elsewhere."""
    posing = PosingOptions(transform=Pose.planar(*MOVED), align=align)
    return save(folder / "first.npz", replace(FIRST, posing=posing))


def fit(options: BuildOptions, past: Evidence, log: Path = DRIVE) -> tuple[PosingOptions, str]:
    """What `fit_logs` finds for one log."""
    found, note = fit_logs(
        [log], options, past, lambda each: observe([log], each, Keep(), ignore_progress)
    )
    return found.posing, note


def assert_near(pose: Pose) -> None:
    """Where the true transform moves the office, to 3 cm and 0.2 degrees."""
    true, found = Transform(*MOVED), Transform(pose.x, pose.y, to_rpy(pose)[2])
    corners = np.array([(-4.0, -3.0), (12.0, -3.0), (12.0, 9.0), (-4.0, 9.0)])
    apart = found.move(corners) - true.move(corners)
    assert np.linalg.norm(apart.mean(axis=0)) < 0.03
    assert abs(found.yaw - true.yaw) < math.radians(0.2)


@pytest.mark.parametrize("align", [0.0, 30.0])
def test_the_second_half_of_a_drive_is_laid_on_the_first(align: float, tmp_path: Path) -> None:
    """As a log, and as saved evidence."""
    past = save_first_half(tmp_path, align)
    options = replace(SECOND, posing=PosingOptions(align=align))
    found, note = fit(options, past)
    assert found.transform
    assert_near(found.transform)
    assert "`transform=(1." in note
    moved = lay_on(save(tmp_path / "second.npz", options), past)
    pose = Pose(*moved.manifest.builds[0]["options"]["posing"]["transform"])
    assert_near(pose)
    typed = format_mount(pose)
    assert f"`transform=({typed})`" in moved.notes[0]
    # Nearly all cells are those of a build with that transform.
    again = build([DRIVE], replace(options, posing=replace(options.posing, transform=pose)), [])
    box = render(to_grid(moved), options.model, 10**9).box.join(again.map.box)
    one, other = (
        paint_box(grid, options.model, box).classes
        for grid in map(to_grid, (moved, again.evidence))
    )
    known = (one | other) > 0
    assert (one == other)[known].mean() > 0.95


def test_what_fit_finds_makes_the_same_map_when_it_is_typed(tmp_path: Path) -> None:
    save_first_half(tmp_path)
    fitted = replace(SECOND, resume=tmp_path / "first.npz", fit=True)
    made = build([DRIVE], fitted, [tmp_path / "fitted.npz"])
    (note,) = [note for note in made.report.notes if "first.npz" in note]
    numbers = note.split("transform=(")[1].split(")")[0]
    posing = PosingOptions(transform=Pose.planar(*map(float, numbers.split(","))))
    typed = replace(SECOND, resume=tmp_path / "first.npz", posing=posing)
    build([DRIVE], typed, [tmp_path / "typed.npz"])
    one, other = (dict(np.load(tmp_path / f"{name}.npz")) for name in ("fitted", "typed"))
    for name in ("tiles", "observed", "first", "second"):
        assert np.array_equal(one[name], other[name])


def test_a_first_transform_is_where_the_search_begins(tmp_path: Path) -> None:
    past = save_first_half(tmp_path)
    near = Pose.planar(2.0, -1.4, 0.3)
    options = replace(SECOND, posing=PosingOptions(transform=near))
    found, _ = fit(options, past)
    assert (pose := found.transform)
    assert (pose.x, pose.y, to_rpy(pose)[2]) == pytest.approx(MOVED, abs=0.05)


def test_a_corridor_lets_the_search_slide() -> None:
    occupied = np.zeros((60, 400), np.bool_)
    occupied[[5, 55], :] = True  # two walls 2.5 m apart, 20 m long
    walls = Walls.of(occupied, Place(0.05, 0.0, 0.0))
    along = np.arange(5.0, 15.0, 0.02)
    points = np.concatenate(
        [np.column_stack([along, np.full_like(along, y)]) for y in (0.28, 2.78)]
    )
    found = find_match(points, walls)
    assert found.share > 0.9
    assert found.rival > 0.9
    assert "not sure" in found.doubt("the corridor", "itself")


def test_sessions_of_different_buildings_are_not_fitted(tmp_path: Path) -> None:
    past = save_first_half(tmp_path)
    elsewhere = replace(SECOND, posing=PosingOptions(transform=Pose.planar(4.0, 3.0, 1.0)))
    with pytest.raises(PoseError, match="not sure") as caught:
        fit(elsewhere, past)
    assert "transform" in caught.value.fix


@pytest.mark.parametrize("lean", [(0, 0), (2, -3)])
def test_clouds_are_laid_on_clouds(lean: tuple[float, float], tmp_path: Path) -> None:
    """As SLAM that knows no gravity gives them; as a log, and as saved evidence."""
    past = save(tmp_path / "past.npz", BuildOptions(), HALL)
    turned = turn(*lean, 5)
    poses = write_leaning(tmp_path / "leaning.tum", turned)
    shifted = Pose(0.8, -0.5, 0.35, 0, 0, 0, 1)
    options = BuildOptions(posing=PosingOptions(poses=str(poses), transform=shifted))
    found, note = fit(replace(options, update=Update.CLOUD), past, HALL)
    assert ("`level=(" in note) == any(lean)
    moved = lay_on(save(tmp_path / "second.npz", options, HALL), past)
    of_moved = moved.manifest.builds[0]["options"]["posing"]["transform"]
    level = turn(*found.level, 0) if found.level else np.eye(3)
    for pose in (found.transform, Pose(*of_moved)):
        assert pose
        # The poses are the sensor's, taken for the robot's: it is as high again above the floor.
        assert pose[:3] == pytest.approx((0, 0, -hall.SENSOR_HEIGHT), abs=0.03)
        back = turn(0, 0, math.degrees(to_rpy(pose)[2])) @ level @ turned
        assert back == pytest.approx(np.eye(3), abs=math.radians(0.5))
    assert len(merge([past, moved]).manifest.builds) == 2  # their grounds agree


def test_clouds_of_another_storey_are_not_fitted(tmp_path: Path) -> None:
    past = save(tmp_path / "past.npz", BuildOptions(), HALL)
    upstairs = PosingOptions(transform=Pose(0, 0, 3, 0, 0, 0, 1))
    with pytest.raises(PoseError, match=r"3\.00 m higher"):
        lay_on(save(tmp_path / "second.npz", BuildOptions(posing=upstairs), HALL), past)


def test_there_must_be_something_to_fit_to() -> None:
    (note,) = BuildOptions(fit=True).list_idle()
    assert "`fit`" in note
    assert "`resume`" in note


def test_what_lies_right_already_is_not_moved_by_half_a_cell(tmp_path: Path) -> None:
    past = save_first_half(tmp_path)
    same = lay_on(past, past)
    assert same.manifest.builds[0]["moved"] == [0, 0, 0]
    assert are_equal(same.tiles, past.tiles)


def test_what_lies_elsewhere_is_not_merged_by_guess(tmp_path: Path) -> None:
    past, second = save_first_half(tmp_path), save(tmp_path / "b.npz", SECOND)
    far = move_evidence(second, Transform(9.0, -4.0, 1.2))
    with pytest.raises(PoseError, match=r"not sure|beyond"):
        lay_on(far, past)
    with pytest.raises(MapError, match="update"):
        lay_on(replace(second, manifest=replace(second.manifest, update="beam")), past)


def test_halves_of_a_real_log_merge_nearly_to_the_whole(tmp_path: Path) -> None:
    log, true = find_real("carmen/fr079-robotlaser.log.gz"), Transform(-1.5, 0.2, -0.25)
    x, y = true.move_back(np.zeros((1, 2)))[0].tolist()
    moved = PosingOptions(transform=Pose.planar(x, y, -true.yaw))
    before, after = halve(BuildOptions(), 550.0)
    halves = before, replace(after, posing=moved)
    first, second = (save(tmp_path / "half.npz", options, log) for options in halves)
    whole = build([log], BuildOptions())
    box = whole.map.box
    x_min, y_min, x_max, y_max = whole.map.extent
    laid = lay_on(second, first)
    found = Transform(*laid.manifest.builds[0]["moved"])
    middle = true.move_back(np.array([[(x_min + x_max) / 2, (y_min + y_max) / 2]]))
    assert np.linalg.norm(found.move(middle) - true.move(middle)) < 0.03
    assert abs(found.yaw - true.yaw) < math.radians(0.2)
    one, other = (
        paint_box(grid, BuildOptions().model, box).classes
        for grid in map(to_grid, (merge([first, laid]), whole.evidence))
    )
    assert (one == other)[(one | other) > 0].mean() > 0.96


def make_evidence(cells: dict[tuple[int, int], tuple[int, int]]) -> Evidence:
    """Evidence of 1 m cells (row, column) with hits and misses, all seen in slice 7."""
    manifest = Manifest(1.0, "beam", "counts", "", 10.0, 0.5, "counting", ())
    grid = make_grid(cells)
    return Evidence(manifest, grid.tiles, (grid.mark_seen(7),))


def list_cells(evidence: Evidence) -> dict[tuple[int, int], tuple[int, int]]:
    hits, misses = read_cells(to_grid(evidence))
    return {cell: (hits[cell], misses[cell]) for cell in hits.keys() | misses.keys()}


CELLS = {(0, 0): (3, 0), (0, 63): (1, 5), (70, -1): (0, 9), (-130, 200): (2**40, 1)}


def test_whole_cells_and_quarter_turns_move_evidence_exactly() -> None:
    evidence = make_evidence(CELLS)
    moved = move_evidence(evidence, Transform(100.0, -7.0, 0.0))
    assert list_cells(moved) == {(r - 7, c + 100): both for (r, c), both in CELLS.items()}
    # (x, y) goes to (-y, x), so the cell from (c, r) to (c + 1, r + 1) to row c, column -r - 1.
    turned = move_evidence(evidence, Transform(0.0, 0.0, math.pi / 2))
    assert list_cells(turned) == {(c, -r - 1): both for (r, c), both in CELLS.items()}
    (slices,) = turned.slices
    assert_same_slices(slices, to_grid(turned).mark_seen(7))


def test_a_turn_leaves_neither_holes_in_a_floor_nor_gaps_in_a_wall() -> None:
    floor = {(row, col): (0, 4) for row in range(100) for col in range(100)}
    wall = {(50, col): (8, 0) for col in range(100)}
    turn = Transform(0.3, 0.4, math.radians(17.0))
    moved = list_cells(move_evidence(make_evidence(floor | wall), turn))
    for (row, col), numbers in moved.items():  # each has what the cell has that its middle was in
        x, y = turn.move_back(np.array([col + 0.5, row + 0.5])).tolist()
        assert numbers == (floor | wall)[math.floor(y), math.floor(x)]
    assert len(moved) == pytest.approx(100 * 100, rel=0.01)
    columns = {col for (_, col), (hits, _) in moved.items() if hits}
    assert columns == set(range(min(columns), max(columns) + 1))
    rows = [[row for (row, c), (hits, _) in moved.items() if hits and c == col] for col in columns]
    assert all(max(each) - min(each) < 2 for each in rows)
