"""Foxglove's schemas as scans and pose samples, decoded from JSON or protobuf.

https://docs.foxglove.dev/docs/visualization/message-schemas/introduction. What is decoded is
brought into shape, so that messages of both encodings have the same fields as attributes.
"""

import math
from collections.abc import Mapping
from typing import Any

from occmap.readers import Role
from occmap.readers.conversion import MessageType, read_frame
from occmap.readers.decoding import shapes
from occmap.readers.decoding.shapes import Shape
from occmap.readers.options import ReaderOptions
from occmap.types import IDENTITY, Pose, PoseSample, Scan
from occmap.values import as_number, as_stamp, as_text


def convert_scan(_options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a foxglove.LaserScan, which has no range limits.

    Where it states an origin other than its frame's, it gets a frame of its own, whose pose
    `convert_origin` gives.
    """
    beams = len(message.ranges)
    frame = read_frame(message.frame_id)
    return Scan(
        stamp_ns=message.timestamp,
        frame=frame if _read_origin(message) == IDENTITY else name_origin(frame, topic),
        angle_min=message.start_angle,
        angle_increment=(message.end_angle - message.start_angle) / max(beams - 1, 1),
        ranges=message.ranges,
        range_min=0.0,
        range_max=math.inf,
        topic=topic,
        record_ns=record_ns,
    )


def convert_origin(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Give the pose of a foxglove.LaserScan in its frame; none where it is the frame's own."""
    origin, frame = _read_origin(message), read_frame(message.frame_id)
    if origin == IDENTITY:
        return []
    child = name_origin(frame, topic)
    stamp_ns = message.timestamp
    return [PoseSample(stamp_ns, frame, child, origin, topic=topic, record_ns=record_ns)]


def name_origin(frame: str, topic: str) -> str:
    """Name the frame of scans that are not taken at the origin of theirs."""
    return f"{frame}:{topic.strip('/')}"


def convert_transform(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a foxglove.FrameTransform."""
    parent, child = read_frame(message.parent_frame_id), read_frame(message.child_frame_id)
    pose = _read_pose(message.translation, message.rotation)
    stamp_ns = message.timestamp
    return [PoseSample(stamp_ns, parent, child, pose, topic=topic, record_ns=record_ns)]


def convert_transforms(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a foxglove.FrameTransforms."""
    transforms = (convert_transform(each, topic, record_ns) for each in message.transforms)
    return [sample for (sample,) in transforms]


def convert_pose(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a foxglove.PoseInFrame, which does not name what moved."""
    return [_make_sample(message, message.pose, topic, record_ns)]


def convert_poses(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Convert a foxglove.PosesInFrame: all poses have one stamp, so the last will hold."""
    return [_make_sample(message, pose, topic, record_ns) for pose in message.poses]


def _make_sample(message: Any, pose: Any, topic: str, record_ns: int) -> PoseSample:
    stamp_ns, parent = message.timestamp, read_frame(message.frame_id)
    position = _read_pose(pose.position, pose.orientation)
    return PoseSample(stamp_ns, parent, "", position, topic=topic, record_ns=record_ns)


def _read_origin(message: Any) -> Pose:
    return _read_pose(message.pose.position, message.pose.orientation)


def _read_pose(position: Any, rotation: Any) -> Pose:
    """Read a position and a quaternion; one that was never set is no rotation at all."""
    turn = (rotation.x, rotation.y, rotation.z, rotation.w)
    return Pose(position.x, position.y, position.z, *(turn if any(turn) else IDENTITY[3:]))


def as_time(value: Any) -> int:
    """Bring a time to ns: JSON calls its parts sec and nsec, protobuf seconds and nanos."""
    names = ("sec", "nsec") if isinstance(value, dict) else ("seconds", "nanos")
    seconds, nanoseconds = (as_stamp(shapes.get_field(value, name)) for name in names)
    return as_stamp(seconds * 1_000_000_000 + nanoseconds)


_FRAMED: Mapping[str, Shape] = {"timestamp": as_time, "frame_id": as_text}
_SCAN: Shape = {
    **_FRAMED,
    "pose": shapes.POSE,
    "start_angle": as_number,
    "end_angle": as_number,
    "ranges": shapes.as_row,
}
_TRANSFORM: Shape = {
    "timestamp": as_time,
    "parent_frame_id": as_text,
    "child_frame_id": as_text,
    "translation": shapes.VECTOR,
    "rotation": shapes.QUATERNION,
}
_TRANSFORMS: Shape = {"transforms": [_TRANSFORM]}

TYPES: Mapping[str, MessageType] = {
    "foxglove.LaserScan": MessageType(Role.SCAN, _SCAN, convert_scan, convert_origin),
    "foxglove.FrameTransform": MessageType(Role.POSE, _TRANSFORM, to_poses=convert_transform),
    "foxglove.FrameTransforms": MessageType(Role.POSE, _TRANSFORMS, to_poses=convert_transforms),
    "foxglove.PoseInFrame": MessageType(
        Role.POSE, {**_FRAMED, "pose": shapes.POSE}, to_poses=convert_pose
    ),
    "foxglove.PosesInFrame": MessageType(
        Role.POSE, {**_FRAMED, "poses": [shapes.POSE]}, to_poses=convert_poses
    ),
}
