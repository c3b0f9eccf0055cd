from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from occmap.cells import OccupancyMap
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing.tracks import rotate_by
from occmap.types import Journey, Pose, Trajectory
from occmap.writers import MapMode, Product, WriteOptions, write_outputs
from tests.map_loaders import load_nav2
from tests.writers.maps import map_of, map_of_art, nothing_kept

DRIVE = Path("sample_logs/drive.mcap")
ROOM = map_of_art("""
    ####?
    #..#?
    #-.#.
""")
TRINARY = WriteOptions()


def write(path: Path, grid: OccupancyMap, options: WriteOptions, *ways: Trajectory) -> None:
    journey = Journey(ways, ()) if ways else None
    write_outputs([path], Product(grid, nothing_kept, journey), options)


def read(path: Path) -> dict[str, list[Any]]:
    """All messages by topic."""
    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as bag:
        for connection, _, data in bag.messages():
            message = bag.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def read_cells(path: Path) -> Any:
    (grid,) = read(path)["/map"]
    return grid.data.reshape(grid.info.height, grid.info.width)


@pytest.mark.parametrize("mode", [MapMode.TRINARY, MapMode.RAW])
def test_cells_are_what_nav2_makes_of_the_pgm(mode: MapMode, tmp_path: Path) -> None:
    grid = map_of([[0.1, 0.9, np.nan], [0.5, 0.33, 0.644]], origin=(-3.05, -0.1))
    options = WriteOptions(mode)
    write_outputs([tmp_path / "m.pgm"], Product(grid, nothing_kept), options)
    write(tmp_path / "m.mcap", grid, options)
    np.testing.assert_array_equal(read_cells(tmp_path / "m.mcap"), load_nav2(tmp_path / "m.yaml"))


def test_scale_is_the_probability_too(tmp_path: Path) -> None:
    write(tmp_path / "m.mcap", map_of([[0.12, 0.5, np.nan]]), WriteOptions(MapMode.SCALE))
    assert read_cells(tmp_path / "m.mcap").tolist() == [[12, 50, -1]]


def test_a_drive_is_the_map_of_its_pgm_with_the_way_of_its_laser(tmp_path: Path) -> None:
    outputs = [tmp_path / name for name in ("m.pgm", "m.mcap", "m.tum")]
    made = build([DRIVE], BuildOptions(resolution=0.1), outputs)
    found = read(tmp_path / "m.mcap")
    np.testing.assert_array_equal(read_cells(tmp_path / "m.mcap"), load_nav2(tmp_path / "m.yaml"))
    (grid,), (path,) = found["/map"], found["/trajectory"]
    corner = grid.info.origin.position
    assert (corner.x, corner.y) == made.map.origin
    assert min(made.map.origin) < 0
    assert grid.info.resolution == np.float32(0.1)
    used = made.report.scans.used
    assert len(path.poses) == len(found["/tf"]) == used
    lines = np.loadtxt(tmp_path / "m.tum")
    first, last = path.poses[0], path.poses[-1]
    for line, stamped in ((lines[0], first), (lines[-1], last)):
        place, turn = stamped.pose.position, stamped.pose.orientation
        stamp = stamped.header.stamp.sec + stamped.header.stamp.nanosec / 1e9
        wanted = [stamp, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
        np.testing.assert_allclose(line, wanted, rtol=1e-8, atol=1e-8)
    (transform,) = found["/tf"][0].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "laser")
    assert transform.transform.translation.x == first.pose.position.x


def test_an_upside_down_laser_stays_so(tmp_path: Path) -> None:
    turned = Pose.from_xyzrpy((1.0, 2.0, 3.0), (np.pi, 0.0, 2.0))
    way = Trajectory("a", "/scan", "map", "laser", np.array([5]), np.array([turned]))
    write(tmp_path / "m.mcap", ROOM, TRINARY, way)
    (path,) = read(tmp_path / "m.mcap")["/trajectory"]
    turn = path.poses[0].pose.orientation
    matrix = rotate_by(np.array([[turn.x, turn.y, turn.z, turn.w]]))[0]
    np.testing.assert_allclose(matrix @ [0, 0, 1], [0, 0, -1], atol=1e-12)


def test_two_lasers_have_two_paths_and_times_that_ros_lacks_are_the_nearest(tmp_path: Path) -> None:
    pose = np.array([[0, 0, 0, 0, 0, 0, 1.0]])
    ways = [
        Trajectory("a", "/a", "odom", "front", np.array([-5]), pose),
        Trajectory("a", "/b", "odom", "rear", np.array([2**62]), pose),
    ]
    write(tmp_path / "m.mcap", ROOM, TRINARY, *ways)
    found = read(tmp_path / "m.mcap")
    assert {"/trajectory", "/trajectory_2"} < found.keys()
    (late,) = found["/trajectory_2"][0].poses
    assert (late.header.stamp.sec, late.header.frame_id) == (2**31 - 1, "odom")


def test_players_are_told_that_late_comers_get_the_map(tmp_path: Path) -> None:
    write(tmp_path / "m.mcap", ROOM, TRINARY)
    with (tmp_path / "m.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    (channel,) = summary.channels.values()
    assert "durability: 1" in channel.metadata["offered_qos_profiles"]
    assert summary.schemas[channel.schema_id].name == "nav_msgs/msg/OccupancyGrid"
