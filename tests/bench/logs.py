"""A workload as a log of every format, written as recorders write them: nothing is compressed."""

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from occmap.types import Float32
from tests.bench.workloads import Workload

Planar: TypeAlias = tuple[float, float, float]
"""x, y, yaw (m, m, rad)"""

CARMEN_NO_RETURN = "81.910"
TF, SCAN = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/LaserScan"
TOPICS = {"/tf_static": TF, "/tf": TF, "/scan": SCAN}
MOUNT, MAP_TO_ODOM = (0.25, 0.0, 0.0), (0.75, -0.5, 0.125)


def write_csv(workload: Workload, folder: Path) -> Path:
    """Write occmap's CSV dialect."""
    sensor = workload.sensor
    constants = ("angle_min", "angle_increment", "range_min", "range_max")
    lines = [f"# {name}: {getattr(sensor, name)!r}" for name in constants]
    lines.append("stamp,x,y,yaw," + ",".join(f"r{b}" for b in range(sensor.beams)))
    lines += [
        f"{stamp_ns / 1e9:.6f},{x},{y},{yaw}," + ",".join(f"{r:.3f}" for r in ranges)
        for stamp_ns, (x, y, yaw), ranges in _scans(workload)
    ]
    return _write_lines(folder / "drive.csv", lines)


def write_carmen(workload: Workload, folder: Path) -> Path:
    """Write ROBOTLASER1 lines."""
    sensor = workload.sensor
    fov = (sensor.beams - 1) * sensor.angle_increment
    head = f"ROBOTLASER1 0 {sensor.angle_min!r} {fov!r} {sensor.angle_increment!r}"
    head += f" {sensor.range_max} 0.01 0 {sensor.beams} "
    lines = []
    for stamp_ns, (x, y, yaw), ranges in _scans(workload):
        beams = " ".join(f"{r:.3f}" if r < sensor.range_max else CARMEN_NO_RETURN for r in ranges)
        pose, stamp = f"{x} {y} {yaw}", f"{stamp_ns / 1e9:.6f}"
        lines.append(f"{head}{beams} 0 {pose} {pose} 1.0 0.0 0.3 0.3 10.0 {stamp} robot {stamp}")
    return _write_lines(folder / "drive.log", lines)


def _scans(workload: Workload) -> Iterator[tuple[int, Planar, Float32]]:
    poses = (tuple(pose) for pose in workload.poses.tolist())
    return zip(workload.stamp_ns, poses, workload.ranges, strict=True)


def _write_lines(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


class Message(NamedTuple):
    """A ROS message on its topic."""

    topic: str
    stamp_ns: int
    content: Any


class RosMessages:
    """A workload as messages of one ROS version: map -> odom -> base_link -> laser, and scans."""

    def __init__(self, store: Stores) -> None:
        self.store = get_typestore(store)
        if TF not in self.store.types:  # no part of rosbags' ROS 1 types
            self.store.register(
                get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF)
            )
        self._types: dict[str, Any] = dict(self.store.types)
        has_seq = "seq" in self._types["std_msgs/msg/Header"].__annotations__  # ROS 1 counts
        self._sequence = {"seq": 0} if has_seq else {}

    def of(self, workload: Workload) -> Iterator[Message]:
        """Yield the mount once, then for every scan the poses and the scan."""
        start_ns = workload.stamp_ns[0]
        mount = self._transform(start_ns, "base_link", "laser", MOUNT)
        yield Message("/tf_static", start_ns, self._types[TF](transforms=[mount]))
        for stamp_ns, pose, ranges in _scans(workload):
            base = compose(invert(MAP_TO_ODOM), compose(pose, invert(MOUNT)))
            edges = [
                self._transform(stamp_ns, "map", "odom", MAP_TO_ODOM),
                self._transform(stamp_ns, "odom", "base_link", base),
            ]
            yield Message("/tf", stamp_ns, self._types[TF](transforms=edges))
            yield Message("/scan", stamp_ns, self._scan(stamp_ns, workload, ranges))

    def _transform(self, stamp_ns: int, parent: str, child: str, pose: Planar) -> Any:
        x, y, yaw = pose
        qz, qw = math.sin(yaw / 2), math.cos(yaw / 2)
        return self._types["geometry_msgs/msg/TransformStamped"](
            header=self._header(stamp_ns, parent),
            child_frame_id=child,
            transform=self._types["geometry_msgs/msg/Transform"](
                translation=self._types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0),
                rotation=self._types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=qz, w=qw),
            ),
        )

    def _scan(self, stamp_ns: int, workload: Workload, ranges: Float32) -> Any:
        sensor = workload.sensor
        return self._types[SCAN](
            header=self._header(stamp_ns, "laser"),
            angle_min=sensor.angle_min,
            angle_max=sensor.angle_min + (sensor.beams - 1) * sensor.angle_increment,
            angle_increment=sensor.angle_increment,
            time_increment=0.0,
            scan_time=0.025,
            range_min=sensor.range_min,
            range_max=sensor.range_max,
            ranges=ranges,
            intensities=np.empty(0, np.float32),
        )

    def _header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **self._sequence)


def write_ros1(workload: Workload, folder: Path) -> Path:
    """Write a ROS 1 bag."""
    messages = RosMessages(Stores.ROS1_NOETIC)
    with Ros1Writer(folder / "drive.bag") as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=messages.store)
            for topic, kind in TOPICS.items()
        }
        for topic, stamp_ns, content in messages.of(workload):
            data = messages.store.serialize_ros1(content, TOPICS[topic])
            writer.write(topics[topic], stamp_ns, data)
    return folder / "drive.bag"


def write_ros2(workload: Workload, folder: Path) -> Path:
    """Write a ROS 2 folder with sqlite3 storage."""
    return _write_ros2(workload, folder / "drive_ros2", StoragePlugin.SQLITE3)


def write_mcap(workload: Workload, folder: Path) -> Path:
    """Write an MCAP file, with the folder around it that ROS 2 makes."""
    bag = _write_ros2(workload, folder / f"drive_mcap_{workload.scans}", StoragePlugin.MCAP)
    return bag / f"{bag.name}.mcap"


def _write_ros2(workload: Workload, folder: Path, storage: StoragePlugin) -> Path:
    messages = RosMessages(Stores.ROS2_HUMBLE)
    with Ros2Writer(folder, version=9, storage_plugin=storage) as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=messages.store)
            for topic, kind in TOPICS.items()
        }
        for topic, stamp_ns, content in messages.of(workload):
            data = messages.store.serialize_cdr(content, TOPICS[topic])
            writer.write(topics[topic], stamp_ns, data)
    return folder


FORMATS: Mapping[str, Callable[[Workload, Path], Path]] = {
    "CSV": write_csv,
    "CARMEN": write_carmen,
    "MCAP": write_mcap,
    "ROS 1 bag": write_ros1,
    "ROS 2 sqlite3": write_ros2,
}


def compose(outer: Planar, inner: Planar) -> Planar:
    """The pose `inner`, which is given in the frame `outer`, in the frame of `outer`."""
    cosine, sine = math.cos(outer[2]), math.sin(outer[2])
    return (
        outer[0] + cosine * inner[0] - sine * inner[1],
        outer[1] + sine * inner[0] + cosine * inner[1],
        outer[2] + inner[2],
    )


def invert(pose: Planar) -> Planar:
    """The inverse transform."""
    x, y, yaw = pose
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return (-cosine * x - sine * y, sine * x - cosine * y, -yaw)
