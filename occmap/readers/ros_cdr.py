"""The two messages that a log holds most of, read from their CDR bytes without decoding the rest.

Reading only what a map needs takes a fifth of the time of the general decoder, and generating that
decoder takes as long as reading ten thousand scans. Valid only for little-endian bytes, and where
the log's own definition has the standard layout, which `is_standard` answers for ROS 1 as well.
"""

from collections.abc import Mapping
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING

import numpy as np
from rosbags.typesys import get_types_from_msg

from occmap.readers.header import read_frame
from occmap.readers.messages import is_static_topic
from occmap.types import Pose, PoseSample, Scan

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

_HEADER = """
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_ROS1_HEADER = """
uint32 seq
time stamp
string frame_id
"""
_LASER_SCAN = """
std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
================================================================================
MSG: std_msgs/Header"""
_TRANSFORMS = """
geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
Transform transform
================================================================================
MSG: geometry_msgs/Transform
Vector3 translation
Quaternion rotation
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: std_msgs/Header"""
STANDARD_DEFINITIONS: Mapping[str, str] = {
    "sensor_msgs/msg/LaserScan": _LASER_SCAN + _HEADER,
    "tf2_msgs/msg/TFMessage": _TRANSFORMS + _HEADER,
}
ROS1_DEFINITIONS: Mapping[str, str] = {
    "sensor_msgs/msg/LaserScan": _LASER_SCAN + _ROS1_HEADER,
    "tf2_msgs/msg/TFMessage": _TRANSFORMS + _ROS1_HEADER,
    "tf/msg/tfMessage": _TRANSFORMS + _ROS1_HEADER,
}

_count = Struct("<I").unpack_from
_header = Struct("<iII").unpack_from
_geometry = Struct("<7fI").unpack_from
_transform = Struct("<7d").unpack_from


def is_standard(
    name: str, types: "Typesdict", standard: Mapping[str, str] = STANDARD_DEFINITIONS
) -> bool:
    """Say whether a message type and all that it is made of have the standard fields."""
    if name not in standard:
        return False
    parts = _parse(standard[name], name)
    return all(part in types and types[part][1] == fields for part, (_, fields) in parts.items())


@cache
def _parse(definition: str, name: str) -> "Typesdict":
    return get_types_from_msg(definition, name)


def read_laser_scan(data: memoryview, topic: str, record_ns: int) -> Scan:
    """Read a sensor_msgs/LaserScan from a CDR message, its encapsulation header included.

    Raises
    ------
    ValueError, struct.error
        The message is not as long as its own counts say.
    """
    seconds, nanoseconds, length = _header(data, 4)
    at = align(16 + length, 4)
    angle_min, _, increment, time_increment, _, range_min, range_max, beams = _geometry(data, at)
    end = at + 32 + 4 * beams
    _check_end(data, end + 4 + 4 * count_at(data, end))
    return Scan(
        seconds * 1_000_000_000 + nanoseconds,
        _read_frame(data, 16, length),
        angle_min,
        increment,
        np.frombuffer(data, np.dtype("<f4"), beams, at + 32).copy(),
        range_min,
        range_max,
        time_increment,
        None,
        topic,
        record_ns,
    )


def read_transforms(data: memoryview, topic: str, record_ns: int) -> list[PoseSample]:
    """Read a tf2_msgs/TFMessage from a CDR message, its encapsulation header included.

    Raises
    ------
    ValueError, struct.error
        The message is not as long as its own counts say.
    """
    static = is_static_topic(topic)
    samples = []
    at = 8
    for _ in range(count_at(data, 4)):
        at = align(at, 4)
        seconds, nanoseconds, length = _header(data, at)
        parent = _read_frame(data, at + 12, length)
        at = align(at + 12 + length, 4)
        length = count_at(data, at)
        child = _read_frame(data, at + 4, length)
        at = align(at + 4 + length, 8)
        pose = Pose(*_transform(data, at))
        at += 56
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        samples.append(PoseSample(stamp_ns, parent, child, pose, static, topic, record_ns))
    _check_end(data, at)
    return samples


def count_at(data: memoryview, at: int) -> int:
    """Read the count of what follows, as a sequence and a string begin with one."""
    count: int = _count(data, at)[0]
    return count


def align(at: int, size: int) -> int:
    """Round an offset up; CDR counts its alignment from behind the four encapsulation bytes."""
    return at + (4 - at) % size


def _read_frame(data: memoryview, at: int, length: int) -> str:
    """Read a frame's name; its length counts a closing zero byte."""
    return read_frame(str(data[at : at + length - 1], "utf-8"))


def _check_end(data: memoryview, end: int) -> None:
    """Raise unless a message ends where its counts say, but for up to three bytes of padding."""
    if not end <= len(data) <= end + 3:
        raise ValueError(f"the message has {len(data)} bytes where its counts say {end}")
