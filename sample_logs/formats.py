"""The drive in every log format that occmap reads."""

import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from drive import (
    LASER_MOUNT,
    MAP_TO_ODOM,
    NOISE_SIGMA,
    START_NS,
    Drive,
    Planar,
    Sensor,
    compose,
    invert,
)
from hall import SENSOR_HEIGHT, CloudDrive
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

CARMEN_NO_RETURN = "81.910"
"""SICK drivers write this; it is above range_max, so it means what `inf` means elsewhere."""
CHUNK_BYTES = 64 * 1024


def write_csv(drive: Drive, path: Path) -> None:
    """Write occmap's own CSV dialect."""
    sensor = drive.sensor
    constants = ("angle_min", "angle_increment", "range_min", "range_max")
    lines = [f"# {name}: {getattr(sensor, name)!r}" for name in constants]
    lines.append("stamp,x,y,yaw," + ",".join(f"r{i}" for i in range(sensor.beams)))
    for stamp_ns, pose, ranges in zip(drive.stamp_ns, drive.laser, drive.ranges, strict=True):
        place = f"{pose.x:.4f},{pose.y:.4f},{pose.yaw:.4f}"
        lines.append(f"{_seconds(stamp_ns)},{place}," + ",".join(f"{r:.3f}" for r in ranges))
    _write_lines(path, lines)


def write_carmen(drive: Drive, path: Path) -> None:
    """Write ROBOTLASER1 lines."""
    lines = ["# CARMEN log: message_name [contents] ipc_timestamp ipc_hostname logger_timestamp"]
    sensor = drive.sensor
    fov = (sensor.beams - 1) * sensor.angle_increment
    head = f"ROBOTLASER1 0 {sensor.angle_min!r} {fov!r} {sensor.angle_increment!r} "
    head += f"{sensor.range_max} {NOISE_SIGMA} 0 {sensor.beams}"
    for stamp_ns, pose, ranges in zip(drive.stamp_ns, drive.laser, drive.ranges, strict=True):
        beams = " ".join(f"{r:.3f}" if r < sensor.range_max else CARMEN_NO_RETURN for r in ranges)
        robot = compose(pose, invert(LASER_MOUNT))
        poses = f"{pose.x:.4f} {pose.y:.4f} {pose.yaw:.4f} {robot.x} {robot.y} {robot.yaw:.4f}"
        times = f"{_seconds(stamp_ns)} robot {_seconds(stamp_ns - START_NS)}"
        lines.append(f"{head} {beams} 0 {poses} 1.0 0.0 0.3 0.3 10.0 {times}")
    _write_lines(path, lines)


def _seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d}"


def _write_lines(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


Message: TypeAlias = tuple[str, int, Any]
"""Topic, stamp (ns) and the message."""
TF_TYPE, TF_DEFINITION = "tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms"
TOPIC_TYPES = {"/tf_static": TF_TYPE, "/tf": TF_TYPE, "/scan": "sensor_msgs/msg/LaserScan"}
CLOUD_TYPES = {"/tf_static": TF_TYPE, "/tf": TF_TYPE, "/points": "sensor_msgs/msg/PointCloud2"}
FLOAT32 = 7
"""What PointField calls numbers of four bytes"""


class RosMessages:
    """The drive as messages of one ROS version."""

    def __init__(self, store: Stores) -> None:
        self.store = get_typestore(store)
        if TF_TYPE not in self.store.types:  # no part of rosbags' ROS 1 types
            self.store.register(get_types_from_msg(TF_DEFINITION, TF_TYPE))
        self._types: dict[str, Any] = dict(self.store.types)
        # Only ROS 1 headers count messages.
        has_seq = "seq" in self._types["std_msgs/msg/Header"].__annotations__
        self._sequence = {"seq": 0} if has_seq else {}

    def of(self, drive: Drive) -> Iterator[Message]:
        """Yield the mount once, then for every scan the poses and the scan itself."""
        yield "/tf_static", START_NS, self._tf(START_NS, {("base_link", "laser"): LASER_MOUNT})
        to_odom = invert(MAP_TO_ODOM)
        for stamp_ns, laser, ranges in zip(drive.stamp_ns, drive.laser, drive.ranges, strict=True):
            base = compose(to_odom, compose(laser, invert(LASER_MOUNT)))
            edges = {("map", "odom"): MAP_TO_ODOM, ("odom", "base_link"): base}
            yield "/tf", stamp_ns, self._tf(stamp_ns, edges)
            yield "/scan", stamp_ns, self._scan(stamp_ns, drive.sensor, ranges)

    def of_clouds(self, drive: CloudDrive) -> Iterator[Message]:
        """Yield the mount once, then for every cloud the pose and the cloud itself."""
        vector = self._types["geometry_msgs/msg/Vector3"]
        upright = self._types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        mount = vector(x=0.0, y=0.0, z=SENSOR_HEIGHT), upright
        yield "/tf_static", START_NS, self._move(START_NS, ("base_link", "lidar"), mount)
        columns = drive.stamp_ns, drive.place.tolist(), drive.turn, drive.points
        for stamp_ns, (x, y, z), turn, points in zip(*columns, strict=True):
            pose = vector(x=x, y=y, z=z), self._rotate(turn)
            yield "/tf", stamp_ns, self._move(stamp_ns, ("map", "base_link"), pose)
            yield "/points", stamp_ns, self._cloud(stamp_ns, points)

    def _move(self, stamp_ns: int, edge: tuple[str, str], pose: tuple[Any, Any]) -> Any:
        transform = self._types["geometry_msgs/msg/Transform"](*pose)
        stamped = self._types["geometry_msgs/msg/TransformStamped"](
            header=self._header(stamp_ns, edge[0]), child_frame_id=edge[1], transform=transform
        )
        return self._types[TF_TYPE](transforms=[stamped])

    def _rotate(self, turn: NDArray[np.float64]) -> Any:
        """Turn a rotation by yaw and then pitch into a quaternion."""
        half_yaw = math.atan2(turn[1, 0], turn[0, 0]) / 2
        half_pitch = math.asin(-turn[2, 0]) / 2
        cy, sy, cp, sp = *_turn(half_yaw), *_turn(half_pitch)
        parts = -sy * sp, cy * sp, sy * cp, cy * cp
        return self._types["geometry_msgs/msg/Quaternion"](*(round(each, 12) for each in parts))

    def _cloud(self, stamp_ns: int, points: NDArray[np.float64]) -> Any:
        field = self._types["sensor_msgs/msg/PointField"]
        places = [field(name, 4 * at, FLOAT32, 1) for at, name in enumerate("xyz")]
        data = points.astype("<f4").view(np.uint8).reshape(-1)
        return self._types["sensor_msgs/msg/PointCloud2"](
            header=self._header(stamp_ns, "lidar"),
            height=1,
            width=len(points),
            fields=places,
            is_bigendian=False,
            point_step=12,
            row_step=len(data),
            data=data,
            is_dense=True,
        )

    def _tf(self, stamp_ns: int, edges: dict[tuple[str, str], Planar]) -> Any:
        transforms = [
            self._types["geometry_msgs/msg/TransformStamped"](
                header=self._header(stamp_ns, parent),
                child_frame_id=child,
                transform=self._transform(pose),
            )
            for (parent, child), pose in edges.items()
        ]
        return self._types[TF_TYPE](transforms=transforms)

    def _transform(self, pose: Planar) -> Any:
        qz, qw = round(math.sin(pose.yaw / 2), 12), round(math.cos(pose.yaw / 2), 12)
        return self._types["geometry_msgs/msg/Transform"](
            translation=self._types["geometry_msgs/msg/Vector3"](x=pose.x, y=pose.y, z=0.0),
            rotation=self._types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=qz, w=qw),
        )

    def _scan(self, stamp_ns: int, sensor: Sensor, ranges: NDArray[np.float64]) -> Any:
        return self._types["sensor_msgs/msg/LaserScan"](
            header=self._header(stamp_ns, "laser"),
            angle_min=sensor.angle_min,
            angle_max=sensor.angle_min + (sensor.beams - 1) * sensor.angle_increment,
            angle_increment=sensor.angle_increment,
            time_increment=0.0,
            scan_time=sensor.interval_ns / 1e9,
            range_min=sensor.range_min,
            range_max=sensor.range_max,
            ranges=ranges.astype(np.float32),
            intensities=np.empty(0, np.float32),
        )

    def _header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **self._sequence)


def _turn(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def write_ros1(drive: Drive, path: Path) -> None:
    """Write a ROS 1 bag."""
    path.unlink(missing_ok=True)
    messages = RosMessages(Stores.ROS1_NOETIC)
    writer = Ros1Writer(path)
    writer.chunk_threshold = CHUNK_BYTES
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=messages.store)
            for topic, name in TOPIC_TYPES.items()
        }
        for topic, stamp_ns, message in messages.of(drive):
            data = messages.store.serialize_ros1(message, TOPIC_TYPES[topic])
            writer.write(connections[topic], stamp_ns, data)


def write_ros2(drive: Drive, path: Path, storage: StoragePlugin = StoragePlugin.SQLITE3) -> None:
    """Write a ROS 2 bag, a folder."""
    shutil.rmtree(path, ignore_errors=True)
    messages = RosMessages(Stores.ROS2_JAZZY)
    with Ros2Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=messages.store)
            for topic, name in TOPIC_TYPES.items()
        }
        for topic, stamp_ns, message in messages.of(drive):
            data = messages.store.serialize_cdr(message, TOPIC_TYPES[topic])
            writer.write(connections[topic], stamp_ns, data)


def write_mcap(drive: Drive, path: Path) -> None:
    """Write the ROS 2 messages into one MCAP file."""
    messages = RosMessages(Stores.ROS2_JAZZY)
    _write_mcap(path, messages, TOPIC_TYPES, messages.of(drive))


def write_clouds(drive: CloudDrive, path: Path) -> None:
    """Write a drive with a 3D lidar into one MCAP file."""
    messages = RosMessages(Stores.ROS2_JAZZY)
    _write_mcap(path, messages, CLOUD_TYPES, messages.of_clouds(drive))


def _write_mcap(
    path: Path, ros: RosMessages, types: dict[str, str], messages: Iterator[Message]
) -> None:
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="occmap sample log")
        schemas = {
            name: writer.register_schema(
                name, "ros2msg", ros.store.generate_msgdef(name, ros_version=2)[0].encode()
            )
            for name in dict.fromkeys(types.values())
        }
        channels = {
            topic: writer.register_channel(topic, "cdr", schemas[name])
            for topic, name in types.items()
        }
        for topic, stamp_ns, message in messages:
            data = bytes(ros.store.serialize_cdr(message, types[topic]))
            writer.add_message(channels[topic], stamp_ns, data, publish_time=stamp_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # the library's gap
