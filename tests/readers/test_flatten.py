"""Several echoes and clouds of points, brought down to one return a bearing."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from occmap.errors import LogError, UsageError
from occmap.options import BuildOptions
from occmap.readers import Role, open_log
from occmap.readers.message_types import BEARINGS, convert_cloud, convert_multi_echo
from occmap.readers.options import Echo, ReaderOptions
from occmap.scans.logs import choose_topics
from occmap.types import Float32
from tests.readers.ros import ROS1, ROS2, SECOND, Written, drive, header, scan, write_mcap

ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
FLOAT32, FLOAT64 = 7, 8
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
    kind = FLOAT32 if size == 4 else FLOAT64
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


def flatten(message: Any, options: ReaderOptions | None = None) -> Float32:
    return convert_cloud(options or ReaderOptions(), message, "/cloud", 7).ranges


def sector(bearing: float) -> int:
    return math.floor((bearing + math.pi) / (2 * math.pi) * BEARINGS) % BEARINGS


@both
@pytest.mark.parametrize(
    ("echo", "expected"), [(Echo.FIRST, [1, 3, np.inf]), (Echo.LAST, [2, 3, np.inf])]
)
def test_one_echo_of_each_beam(store: Typestore, echo: Echo, expected: list[float]) -> None:
    message = echoes(store, [[1.0, 1.5, 2.0], [3.0], []])

    found = convert_multi_echo(ReaderOptions(echo=echo), message, "/echo", 7)

    np.testing.assert_array_equal(found.ranges, np.array(expected, np.float32))
    assert (found.frame, found.stamp_ns, found.range_max, found.record_ns) == (
        "laser",
        SECOND,
        30,
        7,
    )


@both
@pytest.mark.parametrize("form", ["<f4", ">f4", "<f8"])
def test_the_nearest_point_of_a_bearing(store: Typestore, form: str) -> None:
    points = [(3.0, 0.001, 0.0), (2.0, 0.001, 0.1), (0.0, -5.0, -0.1), (-4.0, 0.001, 0.0)]

    found = convert_cloud(ReaderOptions(), cloud(store, points, form), "/cloud", 7)

    expected = np.full(BEARINGS, np.inf, np.float32)
    expected[[sector(0.0003), sector(-math.pi / 2), sector(math.pi - 0.0003)]] = [2, 5, 4]
    np.testing.assert_allclose(found.ranges, expected, rtol=1e-6)
    hit = int(np.argmin(found.ranges))
    bearing = found.angle_min + hit * found.angle_increment
    assert bearing == pytest.approx(0.0, abs=found.angle_increment)
    assert (found.frame, found.stamp_ns, found.topic) == ("lidar", SECOND, "/cloud")


def test_only_points_between_the_heights_count() -> None:
    message = cloud(ROS2, [(1.0, 0.1, -0.5), (2.0, 0.1, 0.5), (3.0, 0.1, 1.5)])

    assert flatten(message, ReaderOptions(min_height=0.0, max_height=1.0)).min() == pytest.approx(
        math.hypot(2.0, 0.1)
    )
    assert np.isinf(flatten(message)).all()


def test_points_that_are_none() -> None:
    nothing = [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (math.inf, 1.0, 0.0)]

    assert np.isinf(flatten(cloud(ROS2, nothing))).all()
    assert np.isinf(flatten(cloud(ROS2, []))).all()
    assert np.isinf(flatten(cloud(ROS2, [(1e300, 0.0, 0.0)], "<f8"))).all()


def test_an_organised_cloud_with_padded_rows() -> None:
    message = cloud(ROS2, [(2.0, 0.1, 0.0), (9.0, 9.0, 9.0), (-3.0, 0.1, 0.0), (9.0, 9.0, 9.0)])
    message.height, message.width, message.row_step = 2, 1, 2 * message.point_step

    assert np.isfinite(flatten(message)).sum() == 2


def test_heights_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(UsageError, match="`min_height` below the `max_height`"):
        ReaderOptions(min_height=1.0, max_height=1.0)


def test_clouds_are_used_where_there_are_no_scans_or_on_request(tmp_path: Path) -> None:
    points = [Written("/points", SECOND, cloud(ROS2, [(2.0, 0.1, 0.0)]))]
    alone = open_log(write_mcap(tmp_path / "alone.mcap", points))
    beside = open_log(write_mcap(tmp_path / "beside.mcap", drive(ROS2) + points))

    assert [stream.role for stream in alone.streams] == [Role.CLOUD]
    assert choose_topics(alone, ()) == ["/points"]
    assert choose_topics(beside, ()) == ["/scan"]
    assert choose_topics(beside, ["/points"]) == ["/points"]
    assert len(list(beside.scans({"/points"}))) == 1
    with pytest.raises(LogError, match="it has scans on /scan, /points"):
        choose_topics(beside, ["/other"])


def test_what_the_user_chose_reaches_the_reader(tmp_path: Path) -> None:
    log = [
        Written("/echo", SECOND, echoes(ROS2, [[1.0, 2.0]])),
        Written("/points", SECOND, cloud(ROS2, [(2.0, 0.1, 3.0)])),
    ]
    path = write_mcap(tmp_path / "both.mcap", log)
    options = BuildOptions(reading=ReaderOptions(Echo.LAST, 2.0, 4.0))

    by_topic = {
        s.topic: s.ranges for s in open_log(path, options.reading).scans({"/echo", "/points"})
    }

    assert by_topic["/echo"].tolist() == [2.0]
    assert np.isfinite(by_topic["/points"]).sum() == 1


@pytest.mark.parametrize("change", [{"point_step": 3}, {"width": 1000}, {"fields": []}])
def test_a_cloud_that_lies_is_counted_as_damaged(tmp_path: Path, change: dict[str, Any]) -> None:
    message = cloud(ROS2, [(2.0, 0.1, 0.0)])
    for name, value in change.items():
        setattr(message, name, value)
    log = open_log(write_mcap(tmp_path / "bad.mcap", [Written("/points", SECOND, message)]))

    assert list(log.scans({"/points"})) == []
    assert "1 of 1 messages on /points are damaged" in log.notes[0].text
