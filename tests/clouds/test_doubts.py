"""What clouds say against their own map: that they contradict each other, or show the robot."""

import math
from pathlib import Path

import numpy as np
import pytest

from occmap.evidence import count_steady, list_contradictions
from occmap.inspection.poses import see_around
from occmap.options import BuildOptions
from occmap.posing.tracks import rotate_by, to_quaternions
from tests.cli.runner import ask, occmap
from tests.clouds.simulation import HALL, Room, drive, find_ground, turn, write_leaning
from tests.grid.scans import make_grid


@pytest.mark.parametrize(
    ("cells", "told"),
    [
        ([(3, 1), (1, 3), (0, 8)], ""),
        ([(4, 1), (6, 6), (0, 50)], ""),
        ([(3, 1), (7, 7), (0, 50)], "30%"),
        ([(9, 1), (0, 10)], ""),
        ([(0, 5)], ""),
    ],
)
def test_hits_in_cells_that_mostly_were_missed_are_told(
    cells: list[tuple[int, int]], told: str
) -> None:
    grid = make_grid({(0, col): counts for col, counts in enumerate(cells)})
    notes = list(list_contradictions(count_steady(grid.tiles), {}))
    assert len(notes) == bool(told)
    assert all(told in note for note in notes)


@pytest.mark.parametrize(
    ("unsteady", "ground", "below", "is_told"),
    [(3, 4, 0, True), (3, 6, 0, False), (1, 4, 0, False), (3, 99, 3, True), (3, 99, 2, False)],
)
def test_of_too_little_ground_is_told_where_clouds_are_not_as_steady_as_in_a_corridor(
    unsteady: int, ground: int, below: int, is_told: bool
) -> None:
    grid = make_grid({(0, 0): (8, 0), (0, 1): (unsteady, 9)})
    points = {"ground": ground, "obstacle": 96, "below": below}
    notes = list(list_contradictions(count_steady(grid.tiles), points))
    assert notes == [note for note in notes if "fit a floor" in note] == notes[:is_told]


def test_a_wrong_mount_is_told_by_a_build(tmp_path: Path) -> None:
    for words, is_wrong in (((), False), (("--sensor-pose", "0,0,3.14"), True)):
        notes = ask("build", HALL, *words, "-o", tmp_path / "hall.pgm")["notes"]
        assert any("clouds contradict each other" in text for text in notes) == is_wrong


@pytest.mark.parametrize(
    ("command", "angle", "doubt"),
    [("build", 180, "does z point down in the poses"), ("check", -90, "where z is not up in")],
)
def test_poses_whose_z_is_not_up_are_told(
    command: str, angle: float, doubt: str, tmp_path: Path
) -> None:
    poses = write_leaning(tmp_path / "poses.tum", turn(angle, 0, 0))
    level = ("--level", f"{-angle},0")
    for words, is_told in (((), True), (level, False)):
        made = ("-o", tmp_path / "hall.pgm") if command == "build" else ()
        told = occmap(command, HALL, "--stride", 3, "--poses", poses, *words, *made)
        assert (doubt in told.out + told.err) == is_told


@pytest.mark.parametrize(("sway_deg", "is_told"), [(0.5, False), (2.5, True)])
def test_poses_whose_up_sways_are_told(tmp_path: Path, sway_deg: float, is_told: bool) -> None:
    poses = write_leaning(tmp_path / "poses.tum", np.eye(3))
    rows = np.loadtxt(poses)
    sways = [turn(sway_deg * math.sin(at), sway_deg * math.cos(at), 0) for at in range(len(rows))]
    rows[:, 4:] = to_quaternions(np.array(sways) @ rotate_by(rows[:, 4:]))
    np.savetxt(poses, rows, fmt="%.9f")
    warnings = ask("check", HALL, "--poses", poses)["warnings"]
    assert any("the poses' up sways" in text for text in warnings) == is_told


def test_a_number_of_the_model_leaves_the_others_those_for_clouds(tmp_path: Path) -> None:
    models = {
        ask("build", HALL, *words, "-o", tmp_path / "hall.pgm")["map"]["model"]
        for words in (("--cut", "0.2"), ("--model", "counting:cut=0.2"))
    }
    (model,) = models
    assert model.endswith("cut=0.2,spread=0.0,ceiling=1.0,doubt=0.0,repeat_from=8.0")


def test_a_low_ceiling_is_not_taken_for_the_robot() -> None:
    """0.15 m above a sensor that is 2.5 m high, and no obstacle to a robot of 1.5 m."""
    clouds = drive(Room([(3, 6, 2, 4, 2.65, 2.7)]), clouds=4, sensor_m=2.5)
    ground = find_ground(clouds)
    (row,) = see_around(clouds[1], ground, BuildOptions())
    assert row.min() > 0.5


def test_a_robot_that_stands_in_its_own_clouds_is_left_out_by_the_command(tmp_path: Path) -> None:
    """It drives round a pillar, with a plate 0.3 m ahead of it; the next hides a wider one."""
    x, y = (axis.ravel() for axis in np.mgrid[-6:6.05:0.15, -6:6.05:0.15])
    floor = np.column_stack([x, y, np.full(x.size, -0.6)])
    up, across = (axis.ravel() for axis in np.mgrid[-0.2:0.21:0.02, -0.1:0.11:0.02])
    plates = [np.column_stack([np.full(up.size, x), x / 0.3 * across, up]) for x in (0.3, 0.471)]
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    lines = []
    for number in range(40):
        yaw = math.tau * number / 40
        at = 3 * math.sin(yaw), -3 * math.cos(yaw)
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        pillar = (np.column_stack([0.05 * across, 0.05 * across]) - at) @ turn.T
        seen = np.concatenate([floor, *plates, np.column_stack([pillar, up])])
        np.save(clouds / f"{number}.npy", seen.astype(np.float32))
        z, w = math.sin(yaw / 2), math.cos(yaw / 2)
        lines.append(f"{number} {at[0]} {at[1]} 0.6 0 0 {z} {w}\n")
    (tmp_path / "way.tum").write_text("".join(lines))
    words = clouds, "--poses", tmp_path / "way.tum"
    told, found = ("the robot is in its own scans", "that the sensor itself"), ask("check", *words)
    assert all(text in str(found) for text in told)
    box = found["command"][found["command"].index("--footprint") + 1]
    assert list(map(float, box.split(","))) == pytest.approx([0.2, -0.25, 0.57, 0.25], abs=0.03)
    mended = str(ask("check", *words, "--footprint", box))
    assert not any(text in mended for text in told)
