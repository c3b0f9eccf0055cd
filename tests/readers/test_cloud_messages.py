"""Clouds of points in messages: Livox's, Foxglove's, depth images, and what is none of them."""

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from occmap.readers import HoldingClouds, Role, open_log
from occmap.readers.cloud_messages import find_offsets
from occmap.types import Cloud, Pose
from tests.readers.foxglove_logs import Message, place, stamp, write_json
from tests.readers.ros import ROS1, ROS2, SECOND, Written, header, write_bag1, write_mcap

DEPTH, INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
)
for _package in ("livox_ros_driver", "livox_ros_driver2"):
    _text = (
        "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
        f"uint8[3] rsvd\n{_package}/CustomPoint[] points"
    )
    for _store in (ROS1, ROS2):
        _store.register(get_types_from_msg(POINT, f"{_package}/msg/CustomPoint"))
        _store.register(get_types_from_msg(_text, f"{_package}/msg/CustomMsg"))
both = pytest.mark.parametrize("store", [ROS1, ROS2], ids=["ros1", "ros2"])


def read(path: Path) -> tuple[list[Cloud], list[str]]:
    log = open_log(path)
    assert isinstance(log, HoldingClouds)
    clouds = list(log.clouds({s.topic for s in log.streams if s.role is Role.CLOUD}))
    return clouds, [note.text for note in log.notes]


def livox(store: Typestore, package: str, frame: str) -> Any:
    point = store.types[f"{package}/msg/CustomPoint"]
    points = [point(0, 1.0, 2.0, 3.0, 9, 16, 0), point(50_000_000, -4.0, 5.5, 0.25, 9, 0, 1)]
    make = store.types[f"{package}/msg/CustomMsg"]
    return make(header(store, SECOND, frame), SECOND, 2, 0, np.zeros(3, np.uint8), points)


@both
@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
@pytest.mark.parametrize("frame", ["livox", "livox_frame", ""])
def test_livox_points_have_their_times(
    store: Typestore, package: str, frame: str, tmp_path: Path
) -> None:
    log = [Written("/livox/lidar", 2 * SECOND, livox(store, package, frame))]
    (cloud,), notes = read(write_mcap(tmp_path / "l.mcap", log, store))

    assert cloud.points.tolist() == [[1, 2, 3], [-4, 5.5, 0.25]]
    assert cloud.offset_ns is not None
    assert cloud.offset_ns.tolist() == [0, 50_000_000]
    assert (cloud.stamp_ns, cloud.frame, cloud.record_ns) == (SECOND, frame, 2 * SECOND)
    assert notes == ["/livox/lidar: its points have the time offset_time, in ns after the stamp"]


def test_livox_points_that_are_not_all_there_are_damaged(tmp_path: Path) -> None:
    path = write_bag1(
        tmp_path / "l.bag", [Written("/livox", SECOND, livox(ROS1, "livox_ros_driver", "livox"))]
    )
    data = path.read_bytes()
    count = (2).to_bytes(4, "little")
    at = data.rindex(count, 0, data.index(np.array([1, 2, 3], "<f4").tobytes()))
    path.write_bytes(data[:at] + (3).to_bytes(4, "little") + data[at + 4 :])

    clouds, notes = read(path)

    assert clouds == []
    assert any("1 of 1 messages on /livox are damaged" in note for note in notes)


@pytest.mark.parametrize(
    ("times", "found"),
    [
        (np.array([0, 99_000], "<u4"), "in us after the stamp"),
        (np.array([17 * 10**17, 17 * 10**17 + 512], "<u8"), "in ns of a clock"),
        (np.array([10**18 + 256, 10**18 + 768], "<u8"), "other than the stamp's"),
        (np.array([0.0, 1.5]), "more than a second"),
    ],
)
def test_how_times_are_read_is_told(times: Any, found: str) -> None:
    points = np.ones((2, 3), np.float32)
    assert found in find_offsets(times, points, 1_700_000_000 * SECOND)[1]


FIELDS = [{"name": name, "offset": 4 * at, "type": 7} for at, name in enumerate("xyz")]


OWN = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 0}}


@pytest.mark.parametrize("at", [OWN, place(1.0, 0.5)], ids=["own", "posed"])
def test_a_cloud_of_foxglove(at: dict[str, Any], tmp_path: Path) -> None:
    data = np.array([(1, 2, 3, 9), (4, 5, 6, 9)], "<f4").tobytes()
    message = {
        "timestamp": stamp(0), "frame_id": "lidar", "pose": at, "point_stride": 16,
        "fields": FIELDS, "data": base64.b64encode(data).decode(),
    }  # fmt: skip
    path = write_json(tmp_path / "f.mcap", [Message("/p", "foxglove.PointCloud", 0, message)])

    (cloud,), _ = read(path)

    assert cloud.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    poses = list(open_log(path).poses())
    assert [(p.parent, p.child, p.pose) for p in poses] == (
        [] if cloud.frame == "lidar" else [("lidar", "lidar:p", Pose.planar(1.0, 2.0, 0.5))]
    )
    assert cloud.frame == ("lidar" if at is OWN else "lidar:p")


def info(store: Typestore, width: int = 3) -> Any:
    roi = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([2.0, 0, 1.0, 0, 4.0, 0.5, 0, 0, 1])
    p = np.array([2.0, 0, 1.0, 0, 0, 4.0, 0.5, 0, 0, 0, 1, 0])
    make = store.types["sensor_msgs/msg/CameraInfo"]
    rest = np.zeros(5), k, np.eye(3).ravel(), p, 0, 0, roi
    return make(header(store, SECOND, "optical"), 2, width, "plumb_bob", *rest)


def image(store: Typestore, depths: Any, encoding: str) -> Any:
    rows, columns = depths.shape
    make, step = store.types["sensor_msgs/msg/Image"], depths.dtype.itemsize * columns
    head, big = header(store, SECOND, "optical"), int(depths.dtype.byteorder == ">")
    data = np.frombuffer(depths.tobytes(), np.uint8)
    return make(head, rows, columns, encoding, big, step, data)


def packed(store: Typestore, depths: Any, text: str, head: tuple[float, float]) -> Any:
    file = io.BytesIO()
    Image.fromarray(depths.astype(np.uint16)).save(file, "PNG")
    data = np.array([0], "<i4").tobytes() + np.array(head, "<f4").tobytes() + file.getvalue()
    make = store.types["sensor_msgs/msg/CompressedImage"]
    return make(header(store, SECOND, "optical"), text, np.frombuffer(data, np.uint8))


MILLIMETRES = np.array([[0, 2000, 0], [0, 0, 4000]])
# (column - 1) / 2 * z and (row - 0.5) / 4 * z, by the camera of `info`
SEEN = [[0.0, -0.25, 2.0], [2.0, 0.5, 4.0]]


@both
@pytest.mark.parametrize(
    ("topic", "make"),
    [
        (DEPTH, lambda store: image(store, MILLIMETRES.astype("<u2"), "16UC1")),
        (DEPTH, lambda store: image(store, MILLIMETRES.astype(">u2"), "16UC1")),
        (DEPTH, lambda store: image(
            store, np.where(MILLIMETRES > 0, MILLIMETRES / 1000, np.nan).astype("<f4"), "32FC1")),
        (f"{DEPTH}/compressedDepth", lambda store: packed(
            store, MILLIMETRES, "16UC1; compressedDepth png", (0, 0))),
        # 100 / (60 - 10) = 2 m and 100 / (35 - 10) = 4 m
        (f"{DEPTH}/compressedDepth", lambda store: packed(
            store, np.array([[0, 60, 0], [0, 0, 35]]), "32FC1; compressedDepth", (100, 10))),
    ],
    ids=["16UC1", "big-endian", "32FC1", "png", "png of floats"],
)  # fmt: skip
def test_a_depth_image_is_a_point_for_each_pixel(
    store: Typestore, topic: str, make: Any, tmp_path: Path
) -> None:
    log = [Written(INFO, SECOND, info(store)), Written(topic, SECOND, make(store))]
    (cloud,), notes = read(write_mcap(tmp_path / "d.mcap", log, store))

    np.testing.assert_allclose(cloud.points, SEEN, rtol=1e-6)
    assert (cloud.frame, cloud.topic, cloud.offset_ns) == ("optical", topic, None)
    assert notes == []


def test_a_camera_that_never_comes_is_told_of(tmp_path: Path) -> None:
    log = [Written(DEPTH, SECOND, image(ROS2, MILLIMETRES.astype("<u2"), "16UC1"))]
    clouds, notes = read(write_mcap(tmp_path / "d.mcap", log))

    assert clouds == []
    (note,) = notes
    assert DEPTH in note
    assert INFO in note


def test_an_image_of_zeros_has_no_points(tmp_path: Path) -> None:
    black = image(ROS2, np.zeros((2, 3), "<u2"), "16UC1")
    log = [Written(INFO, SECOND, info(ROS2)), Written(DEPTH, SECOND, black)]
    (cloud,), notes = read(write_mcap(tmp_path / "d.mcap", log))

    assert cloud.points.shape == (0, 3)
    assert [DEPTH in note for note in notes] == [True]


def test_an_image_of_another_size_than_its_camera_is_damaged(tmp_path: Path) -> None:
    depth = image(ROS2, MILLIMETRES.astype("<u2"), "16UC1")
    log = [Written(INFO, SECOND, info(ROS2, width=4)), Written(DEPTH, SECOND, depth)]
    clouds, notes = read(write_mcap(tmp_path / "d.mcap", log))

    assert clouds == []
    assert "1 of 1 messages" in notes[0]


def test_images_of_colours_are_no_clouds(tmp_path: Path) -> None:
    colours = image(ROS2, np.zeros((2, 9), np.uint8), "rgb8")
    log = [Written("/c/camera_info", SECOND, info(ROS2)), Written("/c/image", SECOND, colours)]

    assert read(write_mcap(tmp_path / "c.mcap", log)) == ([], [])


@pytest.mark.parametrize("kind", ["velodyne_msgs/msg/VelodyneScan", "ouster_ros/msg/PacketMsg"])
def test_packets_are_named_with_the_node_that_makes_clouds_of_them(
    kind: str, tmp_path: Path
) -> None:
    ROS2.register(get_types_from_msg("uint8[] buf", kind))
    packet = ROS2.types[kind](np.zeros(9, np.uint8))
    clouds, notes = read(write_mcap(tmp_path / "p.mcap", [Written("/packets", SECOND, packet)]))

    assert clouds == []
    (note,) = notes
    assert "/packets" in note
    assert kind[:6] in note
