"""ROS messages as scans and pose samples: the types that occmap understands, and what each becomes.

A type is listed under its ROS 2 name; ROS 1 names are brought to that form. To support another
type, write what is read of it, its converter, and a line in the table at the end. Foxglove's
schemas stand in it, too.
"""

import math
from collections.abc import Mapping
from operator import ne
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from occmap.errors import DamageError
from occmap.readers import Role
from occmap.readers.containers.source import Channel
from occmap.readers.conversion import MessageType, foxglove, read_frame, read_stamp
from occmap.readers.decoding import shapes
from occmap.readers.decoding.shapes import Shape
from occmap.readers.options import Echo, ReaderOptions
from occmap.types import Float32, Float64, Pose, PoseSample, Scan
from occmap.values import as_float32, as_number, as_stamp, as_text

BEARINGS = 720
"""A cloud is flattened to half a degree: finer than most spinning lidars in the plane, and coarse
enough that one turn leaves few bearings empty."""

_MOST_LETTERS = 2
"""The name of a type may differ in this many letters from the one that is meant."""
_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the number types of sensor_msgs/PointField."""


def convert_laser_scan(_options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/LaserScan."""
    return _make_scan(message, message.ranges, topic, record_ns)


def convert_multi_echo(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/MultiEchoLaserScan, taking one echo of each beam.

    A beam without an echo becomes +inf: nothing came back (REP 117).
    """
    at = 0 if options.echo is Echo.FIRST else -1
    ranges = [beam.echoes[at] if len(beam.echoes) else math.inf for beam in message.ranges]
    return _make_scan(message, ranges, topic, record_ns)


def _make_scan(message: Any, ranges: ArrayLike, topic: str, record_ns: int) -> Scan:
    return Scan(
        stamp_ns=read_stamp(message.header),
        frame=read_frame(message.header.frame_id),
        angle_min=message.angle_min,
        angle_increment=message.angle_increment,
        ranges=ranges,
        range_min=message.range_min,
        range_max=message.range_max,
        time_increment=message.time_increment,
        topic=topic,
        record_ns=record_ns,
    )


def convert_cloud(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/PointCloud2: the nearest point of each bearing between two heights.

    Heights and bearings are those of the cloud's own frame, whose z is taken to point up; not so
    in a camera's optical frame. A bearing without a point is +inf. The limits are unknown.

    Raises
    ------
    DamageError
        The cloud has no x, y, z, or is not as long as it says.
    """
    points = read_points(message)
    level = (points[:, 2] >= options.min_height) & (points[:, 2] <= options.max_height)
    step = 2 * math.pi / BEARINGS
    return Scan(
        stamp_ns=read_stamp(message.header),
        frame=read_frame(message.header.frame_id),
        angle_min=step / 2 - math.pi,
        angle_increment=step,
        ranges=find_nearest(points[level, :2]),
        range_min=0.0,
        range_max=math.inf,
        topic=topic,
        record_ns=record_ns,
    )


def read_points(message: Any) -> Float64:
    """Read x, y, z (N, 3) of a sensor_msgs/PointCloud2, without the points that are not finite."""
    order = ">" if message.is_bigendian else "<"
    fields = {field.name: field for field in message.fields if field.datatype in _FORMATS}
    if not fields.keys() >= set("xyz"):
        raise DamageError("is a cloud of points without x, y and z")
    columns = [(np.dtype(order + _FORMATS[fields[c].datatype]), fields[c].offset) for c in "xyz"]
    rows, width, step = message.height, message.width, message.point_step
    row_step = message.row_step if rows > 1 else width * step
    if row_step < width * step or any(not 0 <= at <= step - t.itemsize for t, at in columns):
        raise DamageError("is a cloud whose points lie over one another")
    if min(rows, width) < 0 or (rows - 1) * row_step + width * step > len(message.data):
        raise DamageError(f"announces {rows} x {width} points in {len(message.data)} bytes")
    if rows * width == 0:
        return np.empty((0, 3))
    data = np.ascontiguousarray(message.data).data
    points = [
        np.ndarray((rows, width), kind, data, at, (row_step, step)).ravel() for kind, at in columns
    ]
    with np.errstate(invalid="ignore"):  # a flipped bit makes a signalling NaN of infinity
        stacked = np.stack(points, axis=1).astype(np.float64)
    return stacked[np.isfinite(stacked).all(axis=1)]


def find_nearest(points: Float64) -> Float32:
    """Find the distance (BEARINGS,) of the nearest of points (N, 2) in each sector around zero.

    Points at zero itself stand for no return with some drivers.
    """
    distance = as_float32(np.hypot(points[:, 0], points[:, 1]))
    bearing = np.arctan2(points[:, 1], points[:, 0])
    sector = ((bearing + math.pi) * (BEARINGS / (2 * math.pi))).astype(np.int64) % BEARINGS
    nearest = np.full(BEARINGS, np.inf, np.float32)
    np.minimum.at(nearest, sector[distance > 0], distance[distance > 0])
    return nearest


def convert_transforms(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a tf2_msgs/TFMessage or the older tf/tfMessage: each transform is a sample.

    Those of a topic /tf_static, with any namespace, hold at all times.
    """
    static = topic.rpartition("/")[2] == "tf_static"
    samples = []
    for item in message.transforms:
        stamp_ns, parent = read_stamp(item.header), read_frame(item.header.frame_id)
        child = read_frame(item.child_frame_id)
        pose = _read_pose(item.transform.translation, item.transform.rotation)
        samples.append(PoseSample(stamp_ns, parent, child, pose, static, topic, record_ns))
    return samples


def convert_odometry(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a nav_msgs/Odometry, which names both of its frames."""
    (sample,) = convert_pose_with_covariance(message, topic, record_ns)
    return [sample._replace(child=read_frame(message.child_frame_id))]


def convert_pose(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a geometry_msgs/PoseStamped, which does not name what moved."""
    return [_make_sample(message.header, message.pose, topic, record_ns)]


def convert_pose_with_covariance(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a geometry_msgs/PoseWithCovarianceStamped; the covariance is not used."""
    return [_make_sample(message.header, message.pose.pose, topic, record_ns)]


def convert_path(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a nav_msgs/Path: each pose is a sample; one without a frame has that of the path."""
    frame = read_frame(message.header.frame_id)
    samples = (_make_sample(item.header, item.pose, topic, record_ns) for item in message.poses)
    return [sample if sample.parent else sample._replace(parent=frame) for sample in samples]


def _make_sample(header: Any, pose: Any, topic: str, record_ns: int) -> PoseSample:
    """Build the sample of a pose that has a header and no name for what moved."""
    stamp_ns, parent = read_stamp(header), read_frame(header.frame_id)
    position = _read_pose(pose.position, pose.orientation)
    return PoseSample(stamp_ns, parent, "", position, topic=topic, record_ns=record_ns)


def _read_pose(position: Any, rotation: Any) -> Pose:
    """Read a point (or vector) and a quaternion."""
    return Pose(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)


_LASER: Mapping[str, Shape] = {
    "header": shapes.HEADER,
    "angle_min": as_number,
    "angle_increment": as_number,
    "time_increment": as_number,
    "range_min": as_number,
    "range_max": as_number,
    "ranges": shapes.as_row,
}
_CLOUD: Shape = {
    "header": shapes.HEADER,
    "height": as_stamp,
    "width": as_stamp,
    "fields": [{"name": as_text, "offset": as_stamp, "datatype": as_stamp}],
    "is_bigendian": shapes.as_flag,
    "point_step": as_stamp,
    "row_step": as_stamp,
    "data": shapes.as_bytes,
}
_TRANSFORM: Shape = {
    "header": shapes.HEADER,
    "child_frame_id": as_text,
    "transform": {"translation": shapes.VECTOR, "rotation": shapes.QUATERNION},
}
_STAMPED: Shape = {"header": shapes.HEADER, "pose": shapes.POSE}
_UNCERTAIN: Mapping[str, Shape] = {"header": shapes.HEADER, "pose": {"pose": shapes.POSE}}

_ECHOES: Shape = {**_LASER, "ranges": [{"echoes": shapes.as_row}]}
_ODOMETRY: Shape = {**_UNCERTAIN, "child_frame_id": as_text}
_PATH: Shape = {"header": shapes.HEADER, "poses": [_STAMPED]}
_TRANSFORMS = MessageType(Role.POSE, {"transforms": [_TRANSFORM]}, to_poses=convert_transforms)

TYPES: Mapping[str, MessageType] = {
    "sensor_msgs/msg/LaserScan": MessageType(Role.SCAN, _LASER, convert_laser_scan),
    "sensor_msgs/msg/MultiEchoLaserScan": MessageType(Role.SCAN, _ECHOES, convert_multi_echo),
    "sensor_msgs/msg/PointCloud2": MessageType(Role.CLOUD, _CLOUD, convert_cloud),
    "tf2_msgs/msg/TFMessage": _TRANSFORMS,
    "tf/msg/tfMessage": _TRANSFORMS,
    "nav_msgs/msg/Odometry": MessageType(Role.POSE, _ODOMETRY, to_poses=convert_odometry),
    "geometry_msgs/msg/PoseStamped": MessageType(Role.POSE, _STAMPED, to_poses=convert_pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": MessageType(
        Role.POSE, _UNCERTAIN, to_poses=convert_pose_with_covariance
    ),
    "nav_msgs/msg/Path": MessageType(Role.POSE, _PATH, to_poses=convert_path),
    **foxglove.TYPES,
}


def find_type(channel: Channel) -> MessageType | None:
    """Find how messages are read, if at all: ROS and Foxglove each write them in two ways."""
    encodings = {"cdr", "ros1"} if "/" in channel.type else {"json", "protobuf"}
    return TYPES.get(channel.kind) if channel.encoding in encodings else None


def find_oddity(channel: Channel) -> str:
    """Say what suggests that messages of no known type were meant to be used; "" if nothing does.

    Damage to the name of a type, or of an encoding, leaves a file that is sound otherwise.
    """
    kind = channel.type
    if channel.kind in TYPES:
        return "which are written in a way that occmap does not know"
    if not (kind.isascii() and kind.isprintable()):
        return "which is not the name of a type"
    names = [*TYPES, *(known.replace("/msg/", "/") for known in TYPES)]  # of ROS 2 and of ROS 1
    alike = (name for name in names if len(name) == len(kind))
    meant = (name for name in alike if sum(map(ne, name, kind)) <= _MOST_LETTERS)
    return next((f"which may be meant to be {name}" for name in meant), "")
