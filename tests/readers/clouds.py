"""ROS messages of echoes, points and depths, as drivers write them."""

import io
from typing import Any

import numpy as np
from PIL import Image
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from tests.readers.ros import ROS1, ROS2, SECOND, header, scan

ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
INT16, FLOAT32, FLOAT64 = 3, 7, 8
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
    layout = np.dtype([("ring", "<u2"), *((axis, form) for axis in "xyz"), ("padding", "V2")])
    data = np.zeros(len(points), layout)
    for name, column in zip("xyz", np.array(points, np.float64).reshape(-1, 3).T, strict=True):
        data[name] = column
    field = store.types["sensor_msgs/msg/PointField"]
    kind = {2: INT16, 4: FLOAT32, 8: FLOAT64}[np.dtype(form).itemsize]
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


def listed(store: Typestore) -> Any:
    names = ("geometry_msgs/msg/Point32", "sensor_msgs/msg/ChannelFloat32")
    point, channel = (store.types[name] for name in names)
    points = [point(1.0, 2.0, 3.0), point(-4.0, 5.5, 0.25)]
    channels = [channel(name, np.array([0, 0.0625], np.float32)) for name in ("i", "time")]
    return store.types["sensor_msgs/msg/PointCloud"](header(store, SECOND, "it"), points, channels)


def livox(store: Typestore, package: str, frame: str) -> Any:
    point = store.types[f"{package}/msg/CustomPoint"]
    points = [point(0, 1.0, 2.0, 3.0, 9, 16, 0), point(50_000_000, -4.0, 5.5, 0.25, 9, 0, 1)]
    make = store.types[f"{package}/msg/CustomMsg"]
    return make(header(store, SECOND, frame), SECOND, 2, 0, np.zeros(3, np.uint8), points)


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
