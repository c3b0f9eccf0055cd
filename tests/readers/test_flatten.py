"""Several echoes of a beam, brought down to one, and clouds of points as they are written."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from occmap.errors import LogError
from occmap.readers import Echo, ReaderOptions, Role, open_log, read_recorded
from occmap.readers.cloud_messages import convert_cloud, find_offsets
from occmap.readers.message_types import convert_multi_echo
from occmap.scans.logs import choose_topics
from occmap.scans.stream import list_idle
from tests.readers.ros import ROS1, ROS2, SECOND, Written, drive, header, scan, write_mcap
from tests.samples import SAMPLE_LOGS

ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
INT16, FLOAT32, FLOAT64 = 3, 7, 8
both = pytest.mark.parametrize("store", [ROS1, ROS2], ids=["ros1", "ros2"])


def echoes(store: Typestore, beams: list[list[float]]) -> Any:
    single = scan(store, SECOND, "/laser")
    beam = store.types["sensor_msgs/msg/LaserEcho"]
    shared = (
        "header", "angle_min", "angle_max", "angle_increment", "time_increment", "scan_time",
        "range_min", "range_max",
    )  # fmt: skip
    return store.types[ECHO](
        **{name: getattr(single, name) for name in shared},
        ranges=[beam(np.array(values, np.float32)) for values in beams],
        intensities=[],
    )


def cloud(store: Typestore, points: list[tuple[float, float, float]], form: str = "<f4") -> Any:
    """With a column of something else before x, and two bytes of padding behind each point."""
    size = np.dtype(form).itemsize
    layout = np.dtype(
        {
            "names": ["ring", "x", "y", "z"],
            "formats": ["<u2", form, form, form],
            "offsets": [0, 2, 2 + size, 2 + 2 * size],
            "itemsize": 4 + 3 * size,
        }
    )
    data = np.zeros(len(points), layout)
    for name, column in zip("xyz", np.array(points, np.float64).reshape(-1, 3).T, strict=True):
        data[name] = column
    field = store.types["sensor_msgs/msg/PointField"]
    kind = {2: INT16, 4: FLOAT32, 8: FLOAT64}[size]
    return store.types[CLOUD](
        header=header(store, SECOND, "/lidar"),
        height=1,
        width=len(points),
        fields=[field("ring", 0, 4, 1)]
        + [field(name, layout.fields[name][1], kind, 1) for name in "xyz"],  # type: ignore[index]
        is_bigendian=form[0] == ">",
        point_step=layout.itemsize,
        row_step=layout.itemsize * len(points),
        data=np.frombuffer(data.tobytes(), np.uint8),
        is_dense=False,
    )


@both
@pytest.mark.parametrize(
    ("echo", "expected"), [(Echo.FIRST, [1, 3, np.inf]), (Echo.LAST, [2, 3, np.inf])]
)
def test_one_echo_of_each_beam(store: Typestore, echo: Echo, expected: list[float]) -> None:
    message = echoes(store, [[1.0, 1.5, 2.0], [3.0], []])

    found = convert_multi_echo(echo, message, "/echo", 7)

    np.testing.assert_array_equal(found.ranges, np.array(expected, np.float32))
    assert (found.frame, found.stamp_ns, found.range_max, found.record_ns) == (
        "laser",
        SECOND,
        30,
        7,
    )


def test_an_option_for_echoes_that_no_scan_has_is_named(tmp_path: Path) -> None:
    reading = ReaderOptions(echo=Echo.LAST)
    log = open_log(SAMPLE_LOGS / "drive.csv", reading)
    assert list(list_idle(log, ["scan"], reading)) == [
        "`echo=last` does nothing: no topic of scans holds MultiEchoLaserScan"
    ]
    assert list(list_idle(log, ["scan"], ReaderOptions())) == []
    path = write_mcap(tmp_path / "log.mcap", [Written("/echo", SECOND, echoes(ROS2, [[1.0, 2.0]]))])
    assert list(list_idle(open_log(path, reading), ["/echo"], reading)) == []


def decode(message: Any) -> list[list[float]]:
    points: list[list[float]] = convert_cloud(message, "/cloud", 7).points.tolist()
    return points


@both
@pytest.mark.parametrize("form", ["<f4", ">f4", "<f8", ">f8", "<i2"])
def test_points_in_any_form(store: Typestore, form: str) -> None:
    points = [(3.0, 1.0, 0.0), (2.0, 5.0, -1.0), (0.0, 0.0, 0.0)]

    found = convert_cloud(cloud(store, points, form), "/cloud", 7)

    assert found.points.dtype == np.float32
    assert found.points.tolist() == [list(point) for point in points]
    assert (found.frame, found.stamp_ns, found.topic) == ("lidar", SECOND, "/cloud")
    assert found.offset_ns is None


def test_points_that_are_none_stay_as_their_driver_wrote_them() -> None:
    nothing = [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (math.inf, 1.0, 0.0)]

    np.testing.assert_array_equal(decode(cloud(ROS2, nothing)), nothing)
    assert decode(cloud(ROS2, [])) == []
    assert decode(cloud(ROS2, [(1e300, 0.0, 0.0)], "<f8")) == [[math.inf, 0.0, 0.0]]


def test_an_organised_cloud_with_padded_rows() -> None:
    message = cloud(ROS2, [(2.0, 0.5, 0.0), (9.0, 9.0, 9.0), (-3.0, 0.5, 0.0), (9.0, 9.0, 9.0)])
    message.height, message.width, message.row_step = 2, 1, 2 * message.point_step

    assert decode(message) == [[2.0, 0.5, 0.0], [-3.0, 0.5, 0.0]]


NOW, TENTH = 1_700_000_000_000_000_000, 100_000_000


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        (np.array([0, TENTH // 2, TENTH], "u4"), [0, TENTH // 2, TENTH]),  # Ouster, ns
        (np.array([0, 50_000, 100_000], "u4"), [0, TENTH // 2, TENTH]),  # us
        (np.array([-0.125, -0.0625, 0.0], "f4"), [-TENTH * 5 // 4, -TENTH * 5 // 8, 0]),  # s
        (NOW / 1e9 + np.array([0.0, 0.5, 0.75]), [0, 5 * TENTH, TENTH * 15 // 2]),  # a clock's
        (NOW + np.array([0.0, 512.0, TENTH]), [0, 512, TENTH]),  # likewise, in ns
        (1.5e9 + np.array([0.0, 0.5, 0.75]), [0, 5 * TENTH, TENTH * 15 // 2]),  # another clock's
        (np.array([0.0, 0.1, 1.5], "f4"), None),  # no sweep takes so long
        (np.array([math.nan] * 3, "f4"), None),
        (np.zeros(3, "u4"), None),
    ],
)
def test_times_of_points_in_any_unit(times: Any, expected: list[int] | None) -> None:
    points = np.ones((3, 3), np.float32)

    found, _ = find_offsets(times, points, NOW)

    assert (found if found is None else found.tolist()) == expected


def test_points_without_a_return_tell_no_time() -> None:
    points = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [3.0, 1.0, 0.0]], np.float32)

    found, _ = find_offsets(np.array([0, 2**32 - 1, TENTH], "u4"), points, SECOND)

    assert found is not None
    assert found.tolist() == [0, 0, TENTH]


def test_clouds_are_used_where_there_are_no_scans_or_on_request(tmp_path: Path) -> None:
    points = [Written("/points", SECOND, cloud(ROS2, [(2.0, 0.1, 0.0)]))]
    alone = open_log(write_mcap(tmp_path / "alone.mcap", points))
    beside = open_log(write_mcap(tmp_path / "beside.mcap", drive(ROS2) + points))

    assert [stream.role for stream in alone.streams] == [Role.CLOUD]
    assert choose_topics(alone, ()) == ["/points"]
    assert choose_topics(beside, ()) == ["/scan"]
    assert choose_topics(beside, ["/points"]) == ["/points"]
    assert len(list(read_recorded(beside, ["/points"]))) == 1
    with pytest.raises(LogError, match="it has scans on /scan, /points"):
        choose_topics(beside, ["/other"])


def test_what_the_user_chose_reaches_the_reader(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", [Written("/echo", SECOND, echoes(ROS2, [[1.0, 2.0]]))])

    (found,) = open_log(path, ReaderOptions(Echo.LAST)).scans({"/echo"})

    assert found.ranges.tolist() == [2.0]


@pytest.mark.parametrize("change", [{"point_step": 3}, {"width": 1000}, {"fields": []}])
def test_a_cloud_that_lies_is_counted_as_damaged(tmp_path: Path, change: dict[str, Any]) -> None:
    message = cloud(ROS2, [(2.0, 0.1, 0.0)])
    for name, value in change.items():
        setattr(message, name, value)
    log = open_log(write_mcap(tmp_path / "bad.mcap", [Written("/points", SECOND, message)]))

    assert list(read_recorded(log, ["/points"])) == []
    assert "1 of 1 messages on /points are damaged" in log.notes[0].text
