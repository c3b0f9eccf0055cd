"""Messages of each type become scans and poses; one with a value of a wrong type is damaged."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from occmap.errors import DamageError
from occmap.readers import Echo, ReaderOptions, Role, message_types, open_log
from occmap.readers.cloud_messages import convert_cloud
from occmap.readers.containers import Channel
from occmap.readers.fields import get_row
from occmap.readers.message_types import TYPES, convert_laser_scan, convert_multi_echo, find_type
from occmap.readers.ros_log import RosLog
from occmap.scans.stream import list_idle
from occmap.types import Pose, PoseSample, Scan
from tests.readers import ros
from tests.readers.clouds import cloud, echoes
from tests.readers.foxglove_logs import Message, write_json
from tests.readers.foxglove_logs import scan as foxglove_scan
from tests.readers.ros import ROS2, SCAN, SECOND, Memory, both, scan, transforms
from tests.readers.runs import expect_equal
from tests.samples import SAMPLE_LOGS

STAMP = 1_600_000_000_123_456_789
HALF_TURN = Pose(1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0)


def convert(kind: str, message: Any, topic: str = "/topic") -> list[PoseSample]:
    return list(TYPES[kind].converts[Role.POSE](message, topic, 42))


@both
def test_a_laser_scan_becomes_a_scan_with_ranges_of_its_own(store: Typestore) -> None:
    message = scan(store, STAMP, "//robot/laser")

    result = convert_laser_scan(message, "/scan", 42)

    shape = -1.5, 0.75, ros.RANGES, 0.25, 30.0, 0.125
    expected = Scan(STAMP, "robot/laser", *shape, None, "/scan", 42)
    expect_equal(result, expected)
    assert not np.shares_memory(result.ranges, message.ranges)


@pytest.mark.parametrize("kind", ["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"])
def test_each_transform_is_a_sample_without_leading_slashes(kind: str) -> None:
    store = ros.ROS1 if kind == "tf/msg/tfMessage" else ROS2
    message = transforms(store, STAMP, [("/map", "/odom", 1.0), ("odom", "//base", 1.0)], kind)

    assert convert(kind, message) == [
        PoseSample(STAMP, "map", "odom", HALF_TURN, False, "/topic", 42),
        PoseSample(STAMP, "odom", "base", HALF_TURN, False, "/topic", 42),
    ]
    message.transforms[0].header.frame_id = np.arange(2)  # by a damaged definition
    with pytest.raises(DamageError, match="where text belongs"):
        convert(kind, message)


@pytest.mark.parametrize(
    ("topic", "static"),
    [("/tf_static", True), ("/robot1/tf_static", True), ("tf_static", True), ("/tf", False)],
)
def test_transforms_on_a_static_topic_hold_at_all_times(topic: str, static: bool) -> None:
    (sample,) = convert(ros.TF, transforms(ROS2, STAMP, [("base", "laser", 1.0)]), topic)

    assert sample.static is static


@both
@pytest.mark.parametrize(("kind", "child"), list(zip(ros.POSED, ["", "", "base"], strict=True)))
def test_only_odometry_names_what_moved(store: Typestore, kind: str, child: str) -> None:
    message = ros.posed(store, kind, STAMP, ("/odom", "/base", 1.0))

    assert convert(kind, message) == [
        PoseSample(STAMP, "odom", child, HALF_TURN, False, "/topic", 42)
    ]


@both
def test_each_pose_of_a_path_is_a_sample_with_its_own_stamp(store: Typestore) -> None:
    stamped = store.types["geometry_msgs/msg/PoseStamped"]
    message = store.types["nav_msgs/msg/Path"](
        ros.header(store, STAMP, "/map"),
        [
            stamped(ros.header(store, STAMP + 1, "/world"), ros.pose(store, 1.0)),
            stamped(ros.header(store, STAMP + 2, ""), ros.pose(store, 5.0)),
        ],
    )

    assert convert("nav_msgs/msg/Path", message) == [
        PoseSample(STAMP + 1, "world", "", HALF_TURN, False, "/topic", 42),
        PoseSample(STAMP + 2, "map", "", HALF_TURN._replace(x=5.0), False, "/topic", 42),
    ]


@pytest.mark.parametrize(
    ("name", "role", "encodings"),
    [
        ("sensor_msgs/LaserScan", Role.SCAN, {"cdr", "ros1"}),
        ("sensor_msgs/msg/LaserScan", Role.SCAN, {"cdr", "ros1"}),
        ("tf/tfMessage", Role.POSE, {"cdr", "ros1"}),
        ("nav_msgs/msg/Path", Role.POSE, {"cdr", "ros1"}),
        ("sensor_msgs/Image", Role.CLOUD, {"cdr", "ros1"}),
        ("foxglove.LaserScan", Role.SCAN, {"json", "protobuf"}),
        ("foxglove.Log", Role.OTHER, set()),
        ("", Role.OTHER, set()),
    ],
)
def test_a_type_has_its_role_where_it_is_written_as_it_should_be(
    name: str, role: Role, encodings: set[str]
) -> None:
    for encoding in ("cdr", "ros1", "json", "protobuf"):
        known = find_type(Channel("/x", name, encoding))
        found = known.role if known else Role.OTHER
        assert found is (role if encoding in encodings else Role.OTHER), encoding


def test_scans_that_are_written_in_an_unknown_way_are_told_of() -> None:
    channels = [
        Channel("/scan", SCAN, "xcdr2", count=5),
        Channel("/other", "sensor_msgs/msg/NavSatFix", "cdr", count=5),
    ]
    log = RosLog(ros.Memory([(channel, 1, b"") for channel in channels]))

    assert [note.text for note in log.notes] == [
        "5 messages on /scan are sensor_msgs/msg/LaserScan in 'xcdr2': they are not used"
    ]


@both
@pytest.mark.parametrize(
    ("echo", "expected"), [(Echo.FIRST, [1, 3, np.inf]), (Echo.LAST, [2, 3, np.inf])]
)
def test_one_echo_of_each_beam(store: Typestore, echo: Echo, expected: list[float]) -> None:
    message = echoes(store, [[1.0, 1.5, 2.0], [3.0], []])

    found = convert_multi_echo(echo, message, "/echo", 7)

    assert found.ranges.tolist() == expected
    assert (found.frame, found.stamp_ns, found.range_max) == ("laser", SECOND, 30)
    assert found.record_ns == 7


def test_the_echo_that_is_chosen_is_read_and_without_any_the_choice_is_told_to_do_nothing(
    tmp_path: Path,
) -> None:
    last = ReaderOptions(echo=Echo.LAST)
    message = ros.Written("/echo", SECOND, echoes(ROS2, [[1.0, 2.0]]))
    log = open_log(ros.write_mcap(tmp_path / "log.mcap", [message]), last)
    assert [scan.ranges.tolist() for scan in log.scans({"/echo"})] == [[2.0]]
    assert list(list_idle(log, ["/echo"], last)) == []

    other = open_log(SAMPLE_LOGS / "drive.csv", last)
    assert [note.split()[0] for note in list_idle(other, ["scan"], last)] == ["`echo=last`"]
    assert list(list_idle(other, ["scan"], ReaderOptions())) == []


SCANS = [foxglove_scan(index) for index in range(3)]


def spoil(message: Message, path: str, value: Any) -> Message:
    """Put a value in a place such as pose.position.x; it is taken away where it is `...`."""
    fields = json.loads(json.dumps(message.fields))
    *above, last = path.split(".")
    place = fields
    for name in above:
        place = place[int(name)] if isinstance(place, list) else place[name]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return message._replace(fields=fields)


NOT_A_NUMBER: list[Any] = [None, "1.5", True, [1.0], {}, 10**400, ...]
NOT_TEXT: list[Any] = [None, 7, ["laser"], "\ud800", ...]
NO_MESSAGE: list[Any] = [None, 7, [], ...]
NO_RANGES: list[Any] = [None, 7, {}, "none", [[1, 2], [3, 4]], [[1], [2, 3]], [10**400], ...]
NOT_A_TIME: list[Any] = [None, 2**62, -(2**62), 2**64, 1.5, "7", ...]


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *[("start_angle", value) for value in NOT_A_NUMBER],
        *[("pose.position.x", value) for value in NOT_A_NUMBER],
        *[("frame_id", value) for value in NOT_TEXT],
        *[("timestamp.sec", value) for value in NOT_A_TIME],
        *[("pose", value) for value in NO_MESSAGE],
        *[("ranges", value) for value in NO_RANGES],
    ],
)
def test_a_value_of_a_wrong_type_damages_its_scan(path: str, value: Any, tmp_path: Path) -> None:
    log = open_log(
        write_json(tmp_path / "l.mcap", [SCANS[0], spoil(SCANS[1], path, value), SCANS[2]])
    )

    assert [one.stamp_ns // SECOND for one in log.scans({"/scan"})] == [100, 102]
    assert list(log.poses()) == []
    (note,) = log.notes
    assert note.text.startswith("1 of 3 messages on /scan are damaged and not used: the first ")


def test_json_nested_without_end_is_damaged() -> None:
    channel = Channel("/scan", "foxglove.LaserScan", "json", count=2)
    deep = b'{"ranges": ' + b"[" * 200_000
    good = json.dumps(SCANS[0].fields).encode()
    log = RosLog(Memory([(channel, 1, deep), (channel, 2, good)]))

    assert [one.record_ns for one in log.scans({"/scan"})] == [2]
    assert "1 of 2 messages on /scan are damaged" in log.notes[0].text


def test_a_nan_that_a_flipped_bit_makes_of_infinity_is_read_without_a_warning() -> None:
    signalling = np.array([0x7F800001], np.uint32).view(np.float32)
    message = cloud(ROS2, [(2.0, 0.1, 0.0)])
    x = signalling.view(np.uint8)
    message.data = np.concatenate([message.data[:2], x, message.data[6:]])

    assert np.isnan(get_row({"x": signalling}, "x")).all()
    assert np.isnan(convert_cloud(message, "/p", 7).points[0, 0])


@pytest.mark.parametrize(
    ("kind", "read"), [(SCAN, lambda log: log.scans({"/it"})), (ros.TF, lambda log: log.poses())]
)
def test_a_fault_of_a_converter_is_no_damage_of_the_log(
    kind: str, read: Callable[[RosLog], Iterator[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def convert(*given: Any) -> Any:
        return given[0].anlge_min

    known = message_types.TYPES[kind]
    faulty = known._replace(converts={known.role: convert})
    monkeypatch.setitem(message_types.TYPES, kind, faulty)
    message = scan(ROS2, 5) if kind == SCAN else transforms(ROS2, 5, [("a", "b", 1.0)])
    channel = Channel("/it", kind, "cdr", count=1)
    log = RosLog(Memory([(channel, 7, ros.serialise(message))]))

    with pytest.raises(AttributeError, match="anlge_min"):
        list(read(log))
    assert log.notes == []
