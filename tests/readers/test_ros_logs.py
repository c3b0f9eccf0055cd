"""One drive in every container gives the same scans and poses; real recordings give theirs."""

import shutil
import subprocess
import sys
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys.store import Typestore

from occmap.readers import Log, Role, Stream, open_log
from occmap.types import Pose, PoseSample, Scan
from tests.readers.ros import RANGES, ROS1, ROS2, SECOND, Bag2, Write, drive, write_bag1, write_mcap
from tests.readers.runs import count_scans, expect_equal
from tests.samples import find_real

SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
FILES, MESSAGES = CompressionMode.FILE, CompressionMode.MESSAGE
LZ4, ZSTD = CompressionType.LZ4, CompressionType.ZSTD
NO_SUMMARY = {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False}


def mcap(**options: Any) -> Write:
    """Write MCAP files whose chunks, a kilobyte long, hold a few messages."""
    return partial(write_mcap, options={"chunk_size": 1000, **options})


WRITERS: dict[str, tuple[Typestore, Write]] = {
    "bag": (ROS1, write_bag1),
    "bag bz2": (ROS1, partial(write_bag1, compression="bz2")),
    "bag lz4": (ROS1, partial(write_bag1, compression="lz4")),
    "sqlite": (ROS2, Bag2(SQLITE).write),
    "sqlite, files compressed": (ROS2, Bag2(SQLITE, FILES).write),
    "sqlite, messages compressed": (ROS2, Bag2(SQLITE, MESSAGES).write),
    "mcap folder": (ROS2, Bag2(MCAP).write),
    "mcap folder, files compressed": (ROS2, Bag2(MCAP, FILES).write),
    "mcap folder, messages compressed": (ROS2, Bag2(MCAP, MESSAGES).write),
    "mcap": (ROS2, write_mcap),
    "mcap lz4": (ROS2, mcap(compression=LZ4)),
    "mcap zstd": (ROS2, mcap(compression=ZSTD)),
    "mcap without chunks": (ROS2, mcap(use_chunking=False)),
    "mcap without summary": (ROS2, mcap(**NO_SUMMARY)),
    "mcap of ROS 1": (ROS1, partial(write_mcap, store=ROS1)),
}


@pytest.fixture(params=WRITERS)
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Log:
    store, write = WRITERS[request.param]
    return open_log(write(tmp_path / "drive", drive(store)))


def test_every_container_lists_its_streams(log: Log) -> None:
    streams = {
        stream.topic: (stream.type.replace("/msg/", "/"), stream.count, stream.role)
        for stream in log.streams
    }

    assert streams == {
        "/scan": ("sensor_msgs/LaserScan", 6, Role.SCAN),
        "/tf": ("tf2_msgs/TFMessage", 6, Role.POSE),
        "/tf_static": ("tf2_msgs/TFMessage", 1, Role.POSE),
    }


def test_every_container_gives_the_scans(log: Log) -> None:
    scans = list(log.scans({"/scan"}))

    assert [scan.stamp_ns for scan in scans] == [k * SECOND + 5 for k in range(1, 7)]
    assert [scan.record_ns - scan.stamp_ns for scan in scans] == [SECOND // 2] * 6
    assert {(scan.frame, scan.topic, scan.range_max) for scan in scans} == {("laser", "/scan", 30)}
    for k, scan in enumerate(scans):
        np.testing.assert_array_equal(scan.ranges, RANGES + k)
        assert scan.ranges.flags.aligned
    assert log.notes == []


def test_every_container_gives_the_poses(log: Log) -> None:
    mount = Pose(0.25, 2, 3, 0, 0, 1, 0)
    static = PoseSample(SECOND, "base", "laser", mount, True, "/tf_static", SECOND)
    moving = [
        static._replace(
            stamp_ns=k * SECOND + 5,
            parent="odom",
            child="base",
            pose=mount._replace(x=0.5 * (k - 1)),
            static=False,
            topic="/tf",
            record_ns=k * SECOND + 5,
        )
        for k in range(1, 7)
    ]

    assert list(log.poses()) == [static, *moving]
    assert log.notes == []


def test_both_iterators_start_again(log: Log) -> None:
    first = next(log.scans({"/scan"}))
    scans, poses = log.scans({"/scan"}), log.poses()

    assert next(poses).topic == "/tf_static"
    assert next(scans).stamp_ns == first.stamp_ns
    assert len(list(poses)) == 6
    assert len(list(scans)) == 5
    assert len(list(log.poses())) == 7


def test_only_the_topics_asked_for_are_read(log: Log) -> None:
    assert list(log.scans({"/tf", "/other"})) == []
    assert list(log.scans(())) == []


def test_publishers_of_one_topic_are_one_stream(tmp_path: Path) -> None:
    one = drive(ROS2, scans=2)
    folder = Bag2(SQLITE).write(tmp_path / "split", one)
    Bag2(SQLITE).write(tmp_path / "more", one)
    (folder / "metadata.yaml").unlink()
    shutil.move(tmp_path / "more" / "more.db3", folder / "split_10.db3")
    shutil.move(folder / "split.db3", folder / "split_9.db3")

    log = open_log(folder)

    assert Stream("/scan", "sensor_msgs/msg/LaserScan", 4, Role.SCAN) in log.streams
    assert len(list(log.scans({"/scan"}))) == 4


@pytest.mark.parametrize("name", ["bag", "mcap"])
def test_what_lies_before_a_cut_is_read(name: str, tmp_path: Path) -> None:
    store, write = WRITERS[name]
    path = write(tmp_path / "drive", drive(store))
    data = path.read_bytes()
    behind = RANGES.nbytes + 4 + 4 * 3  # the ranges, and the intensities with their number
    ends = [data.find((RANGES + k).tobytes()) + behind for k in range(6)]
    for cut in range(ends[0], len(data), 97):
        path.write_bytes(data[:cut])
        log = open_log(path)
        assert count_scans(log) == sum(end <= cut for end in ends), cut
        assert [note.damage for note in log.notes] == [True] * len(log.notes) != []


TURTLEBOT, LASER = "ros1/test_turtlebot.bag", "ros1/mylaserdata2.bag"
MAC = "ros2/macfirst_floor_take_2"
CRASH = "ros1/test_replay_crash.bag"
EDGES = {
    TURTLEBOT: {("map", "odom"): 550, ("odom", "base_footprint"): 1376},
    CRASH: {("odom", "base_link"): 1088, ("base_link", "laser"): 54, ("base_link", "laser2"): 54},
    LASER: {("odom", "base_link"): 329},
    MAC: {("odom", "base_link"): 953, ("odom", "base_footprint"): 953},
}
"""How many samples some edges have on /tf, which is empty in the other log"""


def read(log: Log) -> tuple[list[Scan], list[PoseSample]]:
    topics = {stream.topic for stream in log.streams if stream.role is Role.SCAN}
    return list(log.scans(topics)), list(log.poses())


def read_real(name: str) -> tuple[list[Scan], list[PoseSample]]:
    return read(open_log(find_real(name)))


@pytest.mark.parametrize(
    ("name", "count", "beams", "frame"),
    [
        (TURTLEBOT, 819, 640, "camera_depth_frame"),
        (CRASH, 136, 381, "laser"),
        (LASER, 232, 360, "laser"),
        ("ros1/laser_scan_matcher_demo.bag", 360, 681, "laser"),
        (MAC, 357, 720, "rplidar_link"),
    ],
)
def test_counts_and_frames(name: str, count: int, beams: int, frame: str) -> None:
    log = open_log(find_real(name))
    scans, poses = read(log)
    edges = Counter((sample.parent, sample.child) for sample in poses if sample.topic == "/tf")

    assert len(scans) == count
    assert {(len(scan.ranges), scan.frame) for scan in scans} == {(beams, frame)}
    assert EDGES.get(name, {}).items() <= edges.items()
    assert bool(edges) is (name in EDGES)
    assert not log.notes
    assert ("/scan", count) in {(stream.topic, stream.count) for stream in log.streams}


def test_special_ranges_come_as_recorded() -> None:
    turtle, laser, mac = (read_real(name)[0] for name in (TURTLEBOT, LASER, MAC))

    assert round(100 * np.isnan([scan.ranges for scan in turtle]).mean()) == 10
    assert round(100 * np.isinf([scan.ranges for scan in laser]).mean()) == 9
    assert round(100 * np.isinf([scan.ranges for scan in mac]).mean()) == 23
    assert max(scan.ranges[np.isfinite(scan.ranges)].max() / scan.range_max for scan in mac) > 1


def test_conversion_to_mcap_changes_nothing(tmp_path: Path) -> None:
    source, target = find_real(MAC), tmp_path / "mac"
    command = [sys.executable, "-m", "rosbags.convert", "--src-typestore", "ros2_humble"]
    command += ["--dst-storage", "mcap", "--src", str(source), "--dst", str(target)]
    subprocess.run(command, check=True, capture_output=True)
    scans, poses = read_real(MAC)

    for path in (target, target / "mac.mcap"):
        found, found_poses = read(open_log(path))
        assert found_poses == poses
        for scan, other in zip(found, scans, strict=True):
            expect_equal(scan, other)
