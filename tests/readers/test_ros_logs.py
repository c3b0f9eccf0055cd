"""One drive, recorded in every container: the same scans and poses come out."""

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys.store import Typestore

from occmap.readers import Log, Role, Stream, open_log
from occmap.types import Pose, PoseSample
from tests.readers.ros import RANGES, ROS1, ROS2, SECOND, Bag2, Write, drive, write_bag1, write_mcap
from tests.readers.runs import count_scans

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
