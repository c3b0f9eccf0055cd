"""A map whose floor leans, and its walls with it, is laid flat; a street that climbs is not."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.clouds.ground import GroundFinder
from occmap.errors import MapError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.readers.ros_log import RosLog
from occmap.scans.tracing import level_ground
from occmap.types import Float64, Pose, PoseBatch, PosedScans, PoseSample
from occmap.writers.npz import read_evidence
from tests.cli.runner import occmap
from tests.clouds.simulation import (
    HALL,
    Room,
    change_points,
    drive,
    find_ground,
    read_points,
    turn,
    write_leaning,
)

PLACE, YAW = (300.0, -2000.0), 0.5
"""Where the logs' map is said to lie in that which is made"""
ELSEWHERE = PosingOptions(align=70.0, transform=Pose.planar(*PLACE, YAW))


def lean(clouds: Sequence[PosedScans], tilt: Float64) -> list[PosedScans]:
    """The same drive in a map that is turned as a whole."""
    return [
        replace(each, position=each.position @ tilt.T, rotation=tilt @ each.rotation)
        for each in clouds
    ]


def shift(posed: PosedScans, x: float, y: float) -> PosedScans:
    """The same clouds elsewhere in the map."""
    return replace(posed, position=posed.position + np.array([x, y, 0]))


def climb(clouds: Sequence[PosedScans], slope: float) -> list[PosedScans]:
    """The same place on a hill: what lies farther along x lies higher, and walls stay upright."""
    up = np.array([[1, 0, slope], [0, 1, 0], [0, 0, 1]])
    raised = [change_points(each, read_points(each) @ up) for each in clouds]
    return [replace(each, position=each.position @ up) for each in raised]


def count(clouds: Sequence[PosedScans]) -> Callable[[BuildOptions], GroundFinder]:
    """Count clouds as a build does, in a map that is levelled as the options say."""

    def count_levelled(options: BuildOptions) -> GroundFinder:
        finder = GroundFinder(len(clouds))
        roll, pitch = options.posing.level or (0.0, 0.0)
        level = lean(clouds, turn(roll, pitch, 0))
        moved = [shift(each, *PLACE) for each in lean(level, turn(0, 0, math.degrees(YAW)))]
        placed = moved if options.posing.transform else level
        for each in lean(placed, turn(0, 0, options.posing.align or 0.0)):
            finder.add(each)
        return finder

    return count_levelled


@pytest.mark.parametrize("angles", [(1.5, 0), (-3, 2), (0, 20), (8, -6)])
@pytest.mark.parametrize("posing", [PosingOptions(), ELSEWHERE])
def test_a_map_that_leans_is_laid_flat(angles: tuple[float, float], posing: PosingOptions) -> None:
    clouds, given = lean(drive(Room()), turn(*angles, 0)), BuildOptions(posing=posing)
    ground, notes, options = level_ground(count(clouds), given, None)

    assert options.posing.level is not None
    up = turn(*options.posing.level, 0) @ turn(*angles, 0) @ [0, 0, 1]
    assert math.degrees(math.acos(up[2])) < 1  # as sharp as it needs to be
    heights = ground.height_mm[ground.measured]
    assert np.ptp(np.quantile(heights, [0.05, 0.95])) < 150  # mm, over 8 m
    assert "`level=(0,0)` leaves it as it is" in notes[-1]


def test_a_map_that_does_not_begin_at_its_zero_knows_what_is_up() -> None:
    """Such as one in UTM: to turn it about the zero would move it by far."""
    clouds = [shift(each, 5e5, 4e5) for each in lean(drive(Room()), turn(3, 0, 0))]
    assert level_ground(count(clouds), BuildOptions(), None).options == BuildOptions()


def test_a_street_that_climbs_stays_as_it_is() -> None:
    clouds = climb(drive(Room()), math.tan(math.radians(5)))
    _, notes, options = level_ground(count(clouds), BuildOptions(), None)
    assert options == BuildOptions()
    assert len(notes) == 1


def test_a_floor_without_walls_does_not_tell_if_it_climbs() -> None:
    clouds = lean(drive(Room()), turn(2, 1, 0))
    points = [read_points(each) for each in clouds]
    floors = [
        change_points(it, each[each[:, 2] < -0.5]) for it, each in zip(clouds, points, strict=True)
    ]
    _, notes, options = level_ground(count(floors), BuildOptions(), None)
    assert options == BuildOptions()
    assert len(notes) == 1


@pytest.mark.parametrize("level", [(0.0, 0.0), (2.0, 0.0)])
def test_what_the_user_says_goes_before_what_clouds_show(level: tuple[float, float]) -> None:
    given = BuildOptions(posing=PosingOptions(level=level))
    clouds = lean(drive(Room()), turn(-3, 0, 0))
    _, notes, options = level_ground(count(clouds), given, None)
    assert options is given
    assert len(notes) == 1


def test_grounds_that_hardly_overlap_are_not_compared() -> None:
    clouds = drive(Room())
    for away, is_compared in ((0.0, True), (9.0, False)):
        moved = [
            replace(each, position=each.position + np.array([away, 0, 0.4])) for each in clouds
        ]
        with pytest.raises(MapError, match=r"0\.40 m lower") if is_compared else nullcontext():
            level_ground(count(clouds), BuildOptions(), find_ground(moved))


def test_a_build_says_how_it_was_levelled_and_a_session_takes_it_over(tmp_path: Path) -> None:
    first, both = tmp_path / "first.npz", tmp_path / "both.npz"
    line = ["build", HALL, "--poses", write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))]
    done = occmap(*line, "--end", "2", "-o", first, "--json")
    assert done.code == 0
    (note,) = (note for note in json.loads(done.out)["notes"] if "--level" in note)
    roll, pitch = map(float, note.split("--level ")[1].split()[0].split(","))
    assert (turn(roll, pitch, 0) @ turn(4, -6, 0))[2, 2] > math.cos(math.radians(0.5))

    assert occmap(*line, "--start", "2", "--resume", first, "-o", both).code == 0
    one, other = read_evidence(first), read_evidence(both)
    levels = [build["options"]["posing"]["level"] for build in other.manifest.builds]
    assert levels == [[roll, pitch]] * 2
    assert one.ground
    assert other.ground
    assert other.ground.measured.sum() > one.ground.measured.sum()


def test_a_build_reads_the_poses_of_a_log_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses, reads = RosLog.stacked_poses, []

    def count_reads(log: RosLog) -> Iterator[PoseSample | PoseBatch]:
        reads.append(log)
        return poses(log)

    monkeypatch.setattr(RosLog, "stacked_poses", count_reads)
    leaning = write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))  # so its ground is found anew
    reads.clear()
    build([HALL], BuildOptions(posing=PosingOptions(poses=str(leaning))), [tmp_path / "map.pgm"])
    assert len(reads) == 1
