"""What clouds say against their own map: that they contradict each other, or show the robot."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.clouds.counting import count_clouds
from occmap.evidence import count_steady, list_contradictions
from occmap.posing.tracks import rotate_by, to_quaternions
from occmap.sensor import ReturnOptions, drop_own_points
from tests.cli.runner import ask, occmap
from tests.clouds.simulation import (
    HALL,
    Room,
    Solid,
    change_points,
    classify,
    drive,
    read_points,
    turn,
    write_leaning,
)
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


PLATE = np.mgrid[0.3:0.6:0.03, -0.2:0.21:0.03, -0.3:-0.2:0.05].reshape(3, -1).T.copy("C")
"""A part of the robot ahead of its sensor (m)"""


def test_the_robot_itself_is_left_out_wherever_it_drives() -> None:
    """It does not even turn, and is far on by the next cloud."""
    clouds = drive(Room([(4.0, 4.4, 4.4, 4.8, 0.0, 0.5)]), clouds=11)
    seen = [change_points(it, np.concatenate([read_points(it), PLATE])) for it in clouds]
    (body,) = count_clouds(seen).bodies.values()
    assert len(body) < 40  # voxels of 10 cm
    cleaned = [drop_own_points(it, ReturnOptions(), body) for it in seen]
    for map_, of_all, other in zip(*map(classify, (cleaned, seen, clouds)), strict=True):
        assert (map_ != other).mean() < 0.002 < (of_all != other).mean()
    only = [change_points(it, PLATE) for it in seen]
    in_map = [replace(it, origin=it.position) for it in seen]
    for some in (seen[:3], only, in_map):
        assert not count_clouds(some).bodies


@pytest.mark.parametrize(
    "solids",
    [
        [(-1.0, 11.0, 3.8, 4.5, 0.0, 2.0)],  # a wall that it follows
        [(-1.0, 11.0, 3.3, 3.33, 0.7, 0.8)],  # a rail
        [(-1.0, 11.0, 4.2, 5.5, z, z + 0.02) for z in (0.0, 0.3, 0.6, 0.9)],  # a shelf
        [(-1.0, 11.0, 0.0, 6.0, 1.0, 1.1)],  # a ceiling
    ],
)
def test_what_it_drives_along_is_not_taken_for_the_robot(solids: list[Solid]) -> None:
    assert not count_clouds(drive(Room(solids))).bodies


def test_a_build_leaves_the_robot_out_and_says_so(tmp_path: Path) -> None:
    clouds, lines = tmp_path / "clouds", []
    clouds.mkdir()
    for number, posed in enumerate(drive(Room())):
        seen = np.concatenate([read_points(posed), PLATE])
        np.save(clouds / f"{number}.npy", seen.astype(np.float32))
        lines.append(f"{number} {' '.join(map(str, posed.position[0]))} 0 0 0 1\n")
    (tmp_path / "way.tum").write_text("".join(lines))
    words = clouds, "--poses", tmp_path / "way.tum"

    told = [str(ask("build", *words, "-o", tmp_path / "map.npz"))]
    told.append(str(ask("check", *words)))
    told.append(str(ask("build", *words, "-o", tmp_path / "own.npz", "--own-points", "off")))

    assert ["it is the robot itself" in each for each in told] == [True, True, False]
    assert ["that the sensor itself" in each for each in told] == [False, False, True]
    for name, is_hit in (("map.npz", False), ("own.npz", True)):
        found = ask("explain", tmp_path / name, "5", "3", "--log", *words)
        hits = sum(scan["seen"]["hits"] for scan in found["scans"])
        assert (found["seen"]["hits"] > 0) == is_hit
        assert hits == found["seen"]["hits"]
