from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from occmap.readers import Role
from occmap.readers.containers import Channel, normalise_type
from occmap.readers.message_types import TYPES, convert_laser_scan, find_type
from occmap.readers.ros_log import RosLog
from occmap.types import Pose, PoseSample
from tests.readers.ros import (
    POSED,
    RANGES,
    ROS1,
    ROS2,
    SCAN,
    Memory,
    header,
    pose,
    posed,
    scan,
    transforms,
)

STAMP = 1_600_000_000_123_456_789
HALF_TURN = Pose(1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0)


def convert(kind: str, message: Any, topic: str = "/topic") -> list[PoseSample]:
    to_poses = TYPES[kind].to_poses
    assert to_poses is not None
    return to_poses(message, topic, 42)


@pytest.fixture(params=[ROS1, ROS2], ids=["ros1", "ros2"])
def store(request: pytest.FixtureRequest) -> Typestore:
    chosen: Typestore = request.param
    return chosen


def test_laser_scan_becomes_a_scan(store: Typestore) -> None:
    result = convert_laser_scan(scan(store, STAMP, "//robot/laser"), "/scan", 42)

    np.testing.assert_array_equal(result.ranges, RANGES)
    assert result.ranges.dtype == np.float32
    assert result._replace(ranges=RANGES) == (
        STAMP, "robot/laser", -1.5, 0.75, RANGES, 0.25, 30.0, 0.125, None, "/scan", 42,
    )  # fmt: skip


def test_ranges_are_a_copy(store: Typestore) -> None:
    message = scan(store, STAMP)

    ranges = convert_laser_scan(message, "/scan", 42).ranges
    assert not np.shares_memory(ranges, message.ranges)


@pytest.mark.parametrize("kind", ["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"])
def test_each_transform_is_a_sample_without_leading_slashes(kind: str) -> None:
    store = ROS1 if kind == "tf/msg/tfMessage" else ROS2
    message = transforms(store, STAMP, [("/map", "/odom", 1.0), ("odom", "//base", 1.0)], kind)

    assert convert(kind, message) == [
        PoseSample(STAMP, "map", "odom", HALF_TURN, False, "/topic", 42),
        PoseSample(STAMP, "odom", "base", HALF_TURN, False, "/topic", 42),
    ]


@pytest.mark.parametrize(
    ("topic", "static"),
    [("/tf_static", True), ("/robot1/tf_static", True), ("tf_static", True), ("/tf", False)],
)
def test_transforms_on_a_static_topic_hold_at_all_times(topic: str, static: bool) -> None:
    message = transforms(ROS2, STAMP, [("base", "laser", 1.0)])

    (sample,) = convert("tf2_msgs/msg/TFMessage", message, topic)

    assert sample.static is static


@pytest.mark.parametrize(("kind", "child"), list(zip(POSED, ["", "", "base"], strict=True)))
def test_only_odometry_names_what_moved(store: Typestore, kind: str, child: str) -> None:
    message = posed(store, kind, STAMP, ("/odom", "/base", 1.0))

    assert convert(kind, message) == [
        PoseSample(STAMP, "odom", child, HALF_TURN, False, "/topic", 42)
    ]


def test_each_pose_of_a_path_is_a_sample_with_its_own_stamp(store: Typestore) -> None:
    stamped = store.types["geometry_msgs/msg/PoseStamped"]
    message = store.types["nav_msgs/msg/Path"](
        header(store, STAMP, "/map"),
        [
            stamped(header(store, STAMP + 1, "/world"), pose(store, 1.0)),
            stamped(header(store, STAMP + 2, ""), pose(store, 5.0)),
        ],
    )

    assert convert("nav_msgs/msg/Path", message) == [
        PoseSample(STAMP + 1, "world", "", HALF_TURN, False, "/topic", 42),
        PoseSample(STAMP + 2, "map", "", HALF_TURN._replace(x=5.0), False, "/topic", 42),
    ]


def find_role(kind: str, encoding: str) -> Role:
    known = find_type(Channel("/x", kind, encoding))
    return known.role if known else Role.OTHER


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("sensor_msgs/LaserScan", Role.SCAN),
        ("sensor_msgs/msg/LaserScan", Role.SCAN),
        ("tf/tfMessage", Role.POSE),
        ("nav_msgs/msg/Path", Role.POSE),
        ("sensor_msgs/Image", Role.CLOUD),
        ("foxglove.LaserScan", Role.SCAN),
        ("foxglove.Log", Role.OTHER),
        ("", Role.OTHER),
    ],
)
def test_the_type_decides_the_role(name: str, role: Role) -> None:
    encodings = ("cdr", "ros1", "json", "protobuf")
    roles = {find_role(name, encoding) for encoding in encodings}
    assert roles == {role, Role.OTHER}  # no type is written in all of these ways


def test_only_foxglove_states_the_pose_of_a_scan_in_it() -> None:
    both = {name for name, each in TYPES.items() if each.role is Role.SCAN and each.to_poses}
    assert both == {"foxglove.LaserScan"}
    assert all(normalise_type(name) == name for name in TYPES)


def test_a_type_counts_only_as_it_is_written() -> None:
    assert find_role("sensor_msgs/LaserScan", "ros1") is Role.SCAN
    assert find_role("sensor_msgs/LaserScan", "json") is Role.OTHER
    assert find_role("foxglove.LaserScan", "json") is Role.SCAN
    assert find_role("foxglove.LaserScan", "cdr") is Role.OTHER


def test_scans_that_are_written_in_an_unknown_way_are_told_of() -> None:
    channels = [
        Channel("/scan", SCAN, "xcdr2", count=5),
        Channel("/other", "sensor_msgs/msg/NavSatFix", "cdr", count=5),
    ]
    log = RosLog(Memory([(channel, 1, b"") for channel in channels]))

    assert [note.text for note in log.notes] == [
        "5 messages on /scan are sensor_msgs/msg/LaserScan in 'xcdr2': they are not used"
    ]
