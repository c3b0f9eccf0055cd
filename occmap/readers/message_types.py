"""The types of messages that occmap reads: a row for each, with what makes values of them.

A type is listed under its ROS 2 name, to which ROS 1 names are brought; Foxglove's schemas
(https://docs.foxglove.dev/docs/visualization/message-schemas/introduction) stand beside them. To
support another type, write its row.

Fields are checked before anything is computed of them; `Scan` and `PoseSample` check the rest.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np

from occmap.errors import DamageError
from occmap.readers import Echo, Fix, Role, cloud_messages
from occmap.readers.cloud_messages import Camera
from occmap.readers.containers import Channel
from occmap.readers.fields import get, get_frame, get_header, get_list, get_row, get_stamp, look
from occmap.readers.messages import Fields, FromBytes, Locate, Parser, read_scan_run
from occmap.types import IDENTITY, Bool, Cloud, Int64, Pose, PoseBatch, PoseSample, Scan, UInt8
from occmap.values import as_float32, as_number, name_origin

ReadMany: TypeAlias = Callable[[Locate, FromBytes[Any], UInt8, Int64], tuple[Sequence[Any], Bool]]
"""From what finds numbers in a message, what reads one, messages of one length (M, L), and when
they were recorded (M,), to what is read many at once, and which messages (M,) are left to be read
one by one; raises DamageError"""


class MessageType(NamedTuple):
    """What messages of a type are for, and what reads them."""

    converts: Mapping[Role, Callable[..., Any]] = {}
    """What makes values of a message, by what they are for; the first is what its topic is for. It
    takes what `needs` says, the decoded message, its topic and its record time in ns"""
    parser: Callable[[Channel], Parser] | None = None
    """Makes what reads a channel's messages, where a library takes too long"""
    needs: type[Echo | Camera] | None = None
    many: ReadMany | None = None
    """Reads many messages that are laid out alike"""

    @property
    def role(self) -> Role:
        """What a topic of such messages can be used for."""
        return next(iter(self.converts), Role.OTHER)

    def bind(self, needed: Echo | Camera) -> Self:
        """Give it what it needs."""
        converts = {role: partial(convert, needed) for role, convert in self.converts.items()}
        return self._replace(converts=converts)


MOST_GROUPS = 16
"""Messages of one length are grouped by the frames that they name, but not into more groups."""


class PoseFields(NamedTuple):
    """The dotted names of the fields in which messages of a type hold poses."""

    stamp: str = "header.stamp"
    parent: str = "header.frame_id"
    child: str = ""
    """Empty where a message does not name what moved"""
    position: str = "pose.position"
    rotation: str = "pose.orientation"
    unset_rotation: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
    """What a quaternion of zeros stands for"""
    items: str = ""
    """A list of which each item is a sample; what an item lacks, the message has for all"""

    def read(self, message: Any, topic: str, record_ns: int) -> list[PoseSample]:
        """Read the samples of a message.

        Those of a topic /tf_static, with any namespace, hold at all times.
        """
        static = topic.rpartition("/")[2] == "tf_static"
        samples = []
        for item in get_list(message, self.items) if self.items else [message]:
            stamp_ns = get_stamp(message if look(item, self.stamp) is None else item, self.stamp)
            named = look(item, self.parent)  # an array, where definitions are damaged
            is_named = named if isinstance(named, str) else named is not None
            whose = item if is_named or look(message, self.parent) is None else message
            parent = get_frame(whose, self.parent)
            child = get_frame(item, self.child) if self.child else ""
            pose = self.read_pose(item)
            samples.append(PoseSample(stamp_ns, parent, child, pose, static, topic, record_ns))
        return samples

    def read_pose(self, item: Any) -> Pose:
        """Read a position and a quaternion."""
        position, rotation = get(item, self.position), get(item, self.rotation)
        turn = [as_number(get(rotation, name)) for name in "xyzw"]
        place = (as_number(get(position, name)) for name in "xyz")
        return Pose(*place, *(turn if any(turn) else self.unset_rotation))

    def read_many(
        self, locate: Locate, read: FromBytes[list[PoseSample]], rows: UInt8, record_ns: Int64
    ) -> tuple[list[PoseBatch], Bool]:
        """Read messages of one length: the samples of each pose, and which messages are left."""
        batches: list[PoseBatch] = []
        left = np.ones(len(rows), np.bool_)
        for _ in range(MOST_GROUPS):
            if np.count_nonzero(left) < 2:
                break
            rest, recorded = rows[left], record_ns[left]
            # Decoded first: that it could be says that all its parts lie within the message.
            samples = read(rest[0].data, int(recorded[0]))
            places = locate(rest[0].data)
            alike = Fields(rest, places).find_alike()
            fields = Fields(rest[alike], places)
            for at, sample in enumerate(samples):
                _, parent, child, expected, static, topic, _ = sample
                item = f"{self.items}.{at}." if self.items else ""
                pose = fields.read(f"{item}{self.position}.x", f"{item}{self.rotation}.w")
                if not np.array_equal(pose[0], expected, equal_nan=True):
                    raise DamageError("has its numbers in another order")
                times = fields.read_stamps(f"{item}{self.stamp}"), recorded[alike]
                batches.append(PoseBatch(*times, pose, parent, child, static, topic))
            left[left] = ~alike
        return batches, left


def convert_laser_scan(message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/LaserScan."""
    return _make_scan(message, get_row(message, "ranges"), topic, record_ns)


def convert_multi_echo(echo: Echo, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/MultiEchoLaserScan, taking one echo of each beam.

    A beam without an echo becomes +inf: nothing came back (REP 117).
    """
    at = 0 if echo is Echo.FIRST else -1
    beams = [get_row(beam, "echoes") for beam in get_list(message, "ranges")]
    ranges = [echoes[at] if len(echoes) else math.inf for echoes in beams]
    return _make_scan(message, np.array(ranges, np.float64), topic, record_ns)


def _make_scan(message: Any, ranges: Any, topic: str, record_ns: int) -> Scan:
    angles = get(message, "angle_min"), get(message, "angle_increment")
    limits = get(message, "range_min"), get(message, "range_max")
    increment = get(message, "time_increment")
    return Scan(*get_header(message), *angles, ranges, *limits, increment, None, topic, record_ns)


def convert_foxglove_scan(message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a foxglove.LaserScan, which has no range limits.

    Where it states an origin other than its frame's, it gets a frame of its own, whose pose
    `convert_origin` gives.
    """
    ranges = as_float32(get_row(message, "ranges"))
    start, end = (as_number(get(message, name)) for name in ("start_angle", "end_angle"))
    angles = start, (end - start) / max(len(ranges) - 1, 1)
    header = _find_header(message, topic, record_ns)
    return Scan(*header, *angles, ranges, 0.0, math.inf, topic=topic, record_ns=record_ns)


def _find_header(message: Any, topic: str, record_ns: int) -> tuple[int, str]:
    """Find the time and the frame of a message of Foxglove's: its own frame if it has an origin."""
    origin = convert_origin(message, topic, record_ns)
    frame = origin[0].child if origin else get_frame(message, "frame_id")
    return get_stamp(message, "timestamp"), frame


def convert_origin(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Give the pose of a foxglove.LaserScan in its frame; none where it is the frame's own."""
    (sample,) = FOXGLOVE.read(message, topic, record_ns)
    child = name_origin(sample.parent, topic)
    return [] if sample.pose == IDENTITY else [sample._replace(child=child)]


def convert_foxglove_cloud(message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a foxglove.PointCloud, whose origin is stated as that of a scan."""
    columns, header = cloud_messages.view_packed(message), _find_header(message, topic, record_ns)
    return cloud_messages.make_cloud(columns, header, topic, record_ns)


def convert_fix(message: Any, _topic: str, _record_ns: int) -> list[Fix]:
    """Convert a sensor_msgs/NavSatFix; without satellites it says nothing."""
    place = as_number(get(message, "latitude")), as_number(get(message, "longitude"))
    if as_number(get(message, "status.status")) < 0 or not all(map(math.isfinite, place)):
        return []
    return [Fix(*get_header(message), *place)]


FOXGLOVE = PoseFields("timestamp", "frame_id", unset_rotation=IDENTITY[3:])
"""Protobuf leaves out zeros, so that a rotation of zeros is one that was never set."""
_TRANSFORM = FOXGLOVE._replace(
    parent="parent_frame_id", child="child_frame_id", position="translation", rotation="rotation"
)
_POSES = FOXGLOVE._replace(position="position", rotation="orientation", items="poses")
_UNCERTAIN = PoseFields(position="pose.pose.position", rotation="pose.pose.orientation")
_TF = PoseFields(
    child="child_frame_id",
    position="transform.translation",
    rotation="transform.rotation",
    items="transforms",
)

_LIVOX = MessageType(
    {Role.CLOUD: cloud_messages.convert_livox},
    parser=lambda channel: Parser(partial(cloud_messages.parse_livox, channel.encoding)),
)

TYPES = {
    "sensor_msgs/msg/LaserScan": MessageType({Role.SCAN: convert_laser_scan}, many=read_scan_run),
    "sensor_msgs/msg/MultiEchoLaserScan": MessageType({Role.SCAN: convert_multi_echo}, needs=Echo),
    "sensor_msgs/msg/PointCloud": MessageType({Role.CLOUD: cloud_messages.convert_listed}),
    "sensor_msgs/msg/PointCloud2": MessageType({Role.CLOUD: cloud_messages.convert_cloud}),
    "livox_ros_driver/msg/CustomMsg": _LIVOX,
    "livox_ros_driver2/msg/CustomMsg": _LIVOX,
    "sensor_msgs/msg/Image": MessageType({Role.CLOUD: cloud_messages.convert_depth}, needs=Camera),
    "sensor_msgs/msg/CompressedImage": MessageType(
        {Role.CLOUD: cloud_messages.convert_compressed_depth}, needs=Camera
    ),
    "sensor_msgs/msg/NavSatFix": MessageType({Role.OTHER: convert_fix}),
    "foxglove.LaserScan": MessageType(
        {Role.SCAN: convert_foxglove_scan, Role.POSE: convert_origin}
    ),
    "foxglove.PointCloud": MessageType(
        {Role.CLOUD: convert_foxglove_cloud, Role.POSE: convert_origin}
    ),
} | {
    name: MessageType({Role.POSE: fields.read}, many=fields.read_many)
    for name, fields in {
        "tf2_msgs/msg/TFMessage": _TF,
        "tf/msg/tfMessage": _TF,
        "nav_msgs/msg/Odometry": _UNCERTAIN._replace(child="child_frame_id"),
        "geometry_msgs/msg/PoseStamped": PoseFields(),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _UNCERTAIN,
        "geometry_msgs/msg/TransformStamped": _TF._replace(items=""),
        "nav_msgs/msg/Path": PoseFields(items="poses"),
        "foxglove.FrameTransform": _TRANSFORM,
        "foxglove.FrameTransforms": _TRANSFORM._replace(items="transforms"),
        "foxglove.PoseInFrame": FOXGLOVE,
        "foxglove.PosesInFrame": _POSES,
    }.items()
}


PACKETS = {
    "velodyne_msgs/msg/VelodyneScan": "`velodyne_transform_node` of velodyne_pointcloud",
    "ouster_ros/msg/PacketMsg": "`os_cloud` of ouster_ros",
    "ouster_sensor_msgs/msg/PacketMsg": "`os_cloud` of ouster_ros",
}
"""Types of raw packets, and the node of their driver that makes clouds of them"""


UNUSED = MessageType()


def find_type(channel: Channel) -> MessageType:
    """Find how messages are read, if at all: ROS and Foxglove each write them in two ways."""
    encodings = {"cdr", "ros1"} if "/" in channel.type else {"json", "protobuf"}
    return TYPES.get(channel.kind, UNUSED) if channel.encoding in encodings else UNUSED
