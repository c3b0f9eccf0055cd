"""ROS messages as scans and pose samples: the types that occmap understands, and what each becomes.

A type is listed under its ROS 2 name; ROS 1 names are brought to that form. To support another
type, write what is read of it, its converter, and a line in one of the tables at the end: the
table that a type stands in is its role. Foxglove's schemas stand in these tables, too.
"""

import math
from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from occmap.readers import Role, foxglove
from occmap.readers.flatten import CLOUD, convert_cloud
from occmap.readers.options import Echo, ReaderOptions
from occmap.readers.shapes import (
    HEADER,
    POSE,
    QUATERNION,
    VECTOR,
    Shape,
    ToPoses,
    ToScan,
    as_row,
    read_frame,
    read_stamp,
)
from occmap.types import Pose, PoseSample, Scan
from occmap.values import as_number, as_text

_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"


def normalise_type(name: str) -> str:
    """Bring a message type to its ROS 2 form: `tf/tfMessage` becomes `tf/msg/tfMessage`."""
    package, slash, base = name.rpartition("/")
    return f"{package}/msg/{base}" if slash and not package.endswith("/msg") else name


def find_role(name: str) -> Role:
    """Say what messages of a type can be used for; a ROS type is in its ROS 1 or ROS 2 form."""
    normal = normalise_type(name)
    if normal in SCAN_TYPES:
        return Role.CLOUD if normal == _CLOUD_TYPE else Role.SCAN
    return Role.POSE if normal in POSE_TYPES else Role.OTHER


def is_static_topic(topic: str) -> bool:
    """Say whether the transforms of a topic hold at all times: /tf_static, with any namespace."""
    return topic.rpartition("/")[2] == "tf_static"


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


def convert_transforms(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a tf2_msgs/TFMessage or the older tf/tfMessage: each transform is a sample."""
    static = is_static_topic(topic)
    return [
        PoseSample(
            stamp_ns=read_stamp(transform.header),
            parent=read_frame(transform.header.frame_id),
            child=read_frame(transform.child_frame_id),
            pose=_read_pose(transform.transform.translation, transform.transform.rotation),
            static=static,
            topic=topic,
            record_ns=record_ns,
        )
        for transform in message.transforms
    ]


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
    return PoseSample(
        stamp_ns=read_stamp(header),
        parent=read_frame(header.frame_id),
        child="",
        pose=_read_pose(pose.position, pose.orientation),
        topic=topic,
        record_ns=record_ns,
    )


def _read_pose(position: Any, rotation: Any) -> Pose:
    """Read a point (or vector) and a quaternion."""
    return Pose(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)


_LASER: Mapping[str, Shape] = {
    "header": HEADER,
    "angle_min": as_number,
    "angle_increment": as_number,
    "time_increment": as_number,
    "range_min": as_number,
    "range_max": as_number,
    "ranges": as_row,
}
_TRANSFORM: Shape = {
    "header": HEADER,
    "child_frame_id": as_text,
    "transform": {"translation": VECTOR, "rotation": QUATERNION},
}
_TRANSFORMS: Shape = {"transforms": [_TRANSFORM]}
_STAMPED: Shape = {"header": HEADER, "pose": POSE}
_UNCERTAIN: Mapping[str, Shape] = {"header": HEADER, "pose": {"pose": POSE}}


SCAN_TYPES: Mapping[str, ToScan] = {
    "sensor_msgs/msg/LaserScan": convert_laser_scan,
    "sensor_msgs/msg/MultiEchoLaserScan": convert_multi_echo,
    _CLOUD_TYPE: convert_cloud,
    **foxglove.SCAN_TYPES,
}

POSE_TYPES: Mapping[str, ToPoses] = {
    "tf2_msgs/msg/TFMessage": convert_transforms,
    "tf/msg/tfMessage": convert_transforms,
    "nav_msgs/msg/Odometry": convert_odometry,
    "geometry_msgs/msg/PoseStamped": convert_pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": convert_pose_with_covariance,
    "nav_msgs/msg/Path": convert_path,
    **foxglove.POSE_TYPES,
}

SHAPES: Mapping[str, Shape] = {
    "sensor_msgs/msg/LaserScan": _LASER,
    "sensor_msgs/msg/MultiEchoLaserScan": {**_LASER, "ranges": [{"echoes": as_row}]},
    _CLOUD_TYPE: CLOUD,
    "tf2_msgs/msg/TFMessage": _TRANSFORMS,
    "tf/msg/tfMessage": _TRANSFORMS,
    "nav_msgs/msg/Odometry": {**_UNCERTAIN, "child_frame_id": as_text},
    "geometry_msgs/msg/PoseStamped": _STAMPED,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _UNCERTAIN,
    "nav_msgs/msg/Path": {"header": HEADER, "poses": [_STAMPED]},
    **foxglove.SHAPES,
}
"""The fields that a converter reads, for logs that define a type in another way than ROS does."""
