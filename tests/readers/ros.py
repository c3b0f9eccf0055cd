"""Small ROS logs in every container, and what is in them."""

import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from occmap.readers import NoteList
from occmap.readers.containers import Channel, RawMessage
from occmap.types import Float32

ROS1: Typestore = get_typestore(Stores.ROS1_NOETIC)
ROS2: Typestore = get_typestore(Stores.ROS2_HUMBLE)
SCAN = "sensor_msgs/msg/LaserScan"
TF = "tf2_msgs/msg/TFMessage"
POSED = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
for _kind in (TF, "tf/msg/tfMessage"):
    ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _kind))

both = pytest.mark.parametrize("store", [ROS1, ROS2], ids=["ros1", "ros2"])

RANGES: Float32 = np.array([1.0, 2.5, np.inf, np.nan, 0.0], dtype=np.float32)
SECOND = 1_000_000_000


class Written(NamedTuple):
    """A message and when and where it was recorded."""

    topic: str
    record_ns: int
    message: Any


Write = Callable[[Path, Sequence[Written]], Path]


class Memory:
    """A container whose messages are given."""

    path = Path("memory")

    def __init__(self, messages: Iterable[tuple[Channel, int, bytes]]) -> None:
        self.notes = NoteList()
        self._messages = list(messages)

    @property
    def channels(self) -> Sequence[Channel]:
        return list(dict.fromkeys(channel for channel, _, _ in self._messages))

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        return (each for each in self._messages if each[0] in wanted)


def header(store: Typestore, stamp_ns: int, frame: str) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, SECOND))
    make = store.types["std_msgs/msg/Header"]
    return make(seq=7, stamp=time, frame_id=frame) if store is ROS1 else make(time, frame)


def scan(store: Typestore, stamp_ns: int, frame: str = "laser", ranges: Float32 = RANGES) -> Any:
    return store.types[SCAN](
        header=header(store, stamp_ns, frame),
        angle_min=-1.5,
        angle_max=1.5,
        angle_increment=0.75,
        time_increment=0.125,
        scan_time=0.5,
        range_min=0.25,
        range_max=30.0,
        ranges=ranges,
        intensities=np.ones(3, dtype=np.float32),
    )


def pose(store: Typestore, x: float) -> Any:
    """At (x, 2, 3), turned half round about z."""
    types = store.types
    point = types["geometry_msgs/msg/Point"](x, 2.0, 3.0)
    return types["geometry_msgs/msg/Pose"](
        point, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 1.0, 0.0)
    )


def posed(store: Typestore, kind: str, stamp_ns: int, edge: tuple[str, str, float]) -> Any:
    """A message of one of the types `POSED`; its covariance and speed, if any, are `x`, too."""
    parent, child, x = edge
    types, head, row = store.types, header(store, stamp_ns, parent), np.full(36, x)
    if kind == POSED[0]:
        return types[kind](head, pose(store, x))
    uncertain = types["geometry_msgs/msg/PoseWithCovariance"](pose(store, x), row)
    if kind == POSED[1]:
        return types[kind](head, uncertain)
    speed = types["geometry_msgs/msg/Vector3"](x, x, x)
    twist = types["geometry_msgs/msg/Twist"](speed, speed)
    speed_of = types["geometry_msgs/msg/TwistWithCovariance"](twist, row)
    return types[kind](head, child, uncertain, speed_of)


def transforms(
    store: Typestore, stamp_ns: int, edges: Iterable[tuple[str, str, float]], kind: str = TF
) -> Any:
    types = store.types
    rotation = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 1.0, 0.0)
    return types[kind](
        [
            types["geometry_msgs/msg/TransformStamped"](
                header(store, stamp_ns, parent),
                child,
                types["geometry_msgs/msg/Transform"](
                    types["geometry_msgs/msg/Vector3"](x, 2.0, 3.0), rotation
                ),
            )
            for parent, child, x in edges
        ]
    )


def drive(store: Typestore, scans: int = 6) -> list[Written]:
    """Go 0.5 m a second; scan k lies at second k + 1 and is recorded half a second later."""
    log = [Written("/tf_static", SECOND, transforms(store, SECOND, [("base", "/laser", 0.25)]))]
    for k in range(scans):
        stamp = (k + 1) * SECOND + 5
        log += [
            Written("/tf", stamp, transforms(store, stamp, [("/odom", "base", 0.5 * k)])),
            Written("/scan", stamp + SECOND // 2, scan(store, stamp, "/laser", RANGES + k)),
        ]
    return log


def write_bag1(
    path: Path, log: Sequence[Written], compression: str = "none", chunk_size: int = 1 << 20
) -> Path:
    writer = Writer1(path)
    writer.chunk_threshold = chunk_size
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    write_messages(writer, log, ROS1, ROS1.serialize_ros1)
    return path


def write_messages(
    writer: Any, log: Sequence[Written], store: Typestore, serialize: Callable[..., Any]
) -> None:
    connections: dict[str, Any] = {}
    with writer:
        for topic, record_ns, message in log:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], record_ns, serialize(message, kind))


def bag1_record(data: bytes, **fields: bytes) -> bytes:
    """A record of a ROS 1 bag, with these fields in its header."""
    head = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


class Bag2(NamedTuple):
    storage: StoragePlugin
    compressed: CompressionMode = CompressionMode.NONE

    def write(self, path: Path, log: Sequence[Written]) -> Path:
        writer = Writer2(path, version=9, storage_plugin=self.storage)
        if self.compressed is not CompressionMode.NONE:
            writer.set_compression(self.compressed, CompressionFormat.ZSTD)
        write_messages(writer, log, ROS2, ROS2.serialize_cdr)
        return path


class Encoded(NamedTuple):
    """A message as an MCAP file holds it."""

    topic: str
    record_ns: int
    data: bytes
    encoding: str
    schema: tuple[str, str, bytes] | None
    """Name, encoding and definition"""


def serialise(message: Any, store: Typestore = ROS2) -> bytes:
    write = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    return bytes(write(message, message.__msgtype__))


def make_channel(topic: str, kind: str, count: int, store: Typestore = ROS2) -> Channel:
    """A channel of a log that defines its types."""
    encoding = "ros1" if store is ROS1 else "cdr"
    return Channel(topic, kind, encoding, store.generate_msgdef(kind)[0], count)


def encode(written: Written, store: Typestore = ROS2) -> Encoded:
    """Encode a message, in ROS 1 form where the store is of ROS 1."""
    topic, record_ns, message = written
    kind, is_ros1 = message.__msgtype__, store is ROS1
    definition = store.generate_msgdef(kind, ros_version=1 if is_ros1 else 2)[0].encode()
    name, encoding, form = (
        (kind.replace("/msg", ""), "ros1", "ros1msg") if is_ros1 else (kind, "cdr", "ros2msg")
    )
    return Encoded(topic, record_ns, serialise(message, store), encoding, (name, form, definition))


def add_messages(writer: McapWriter, log: Iterable[Encoded], channels: dict[str, int]) -> None:
    """Add messages to an MCAP file; the number of each channel, by its topic, to `channels`."""
    for topic, record_ns, data, encoding, schema in log:
        if topic not in channels:
            schema_id = writer.register_schema(*schema) if schema else 0
            channels[topic] = writer.register_channel(topic, encoding, schema_id)
        writer.add_message(channels[topic], record_ns, data, record_ns)


def write_encoded(path: Path, log: Iterable[Encoded], profile: str = "", **options: Any) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile, library="occmap's tests")
        add_messages(writer, log, {})
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_mcap(
    path: Path,
    log: Sequence[Written],
    store: Typestore = ROS2,
    options: Mapping[str, Any] | None = None,
) -> Path:
    """Write an MCAP file, in ROS 1 form where the store is of ROS 1."""
    profile = "ros1" if store is ROS1 else "ros2"
    chosen = options or {"compression": CompressionType.NONE}
    return write_encoded(path, [encode(each, store) for each in log], profile, **chosen)
