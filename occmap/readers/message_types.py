"""The types of messages that occmap reads: a row for each, with what makes values of them.

A type is listed under its ROS 2 name, to which ROS 1 names are brought; Foxglove's schemas
(https://docs.foxglove.dev/docs/visualization/message-schemas/introduction) stand beside them. To
support another type, write its row.

Messages come decoded from CDR, ROS 1, JSON or protobuf, and a log's own definitions may give any
field any type. So fields are looked up by their dotted names, and checked before anything is
computed of them; `Scan` and `PoseSample` check the rest.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from occmap.errors import DamageError
from occmap.readers import Role
from occmap.readers.containers.source import Channel
from occmap.readers.options import Echo, ReaderOptions
from occmap.types import IDENTITY, Cloud, Float32, Float64, Int64, Pose, PoseSample, Scan
from occmap.values import as_number, as_stamp, as_text

ToScan: TypeAlias = Callable[[ReaderOptions, Any, str, int], Scan]
"""From what the user chose, a decoded message, its topic and its record time in ns."""
ToCloud: TypeAlias = Callable[[Any, str, int], Cloud]
ToPoses: TypeAlias = Callable[[Any, str, int], list[PoseSample]]

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset")
"""What drivers call the time of a point."""
LONGEST_SWEEP_NS = 1_000_000_000
"""No sensor takes longer for a cloud; times beyond this are not those of points."""

_STAMP_NAMES = (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos"))
"""The parts of a time as rosbags, Foxglove's JSON and protobuf name them."""
_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the number types of sensor_msgs/PointField."""


class MessageType(NamedTuple):
    """What messages of a type are for, and what reads them."""

    role: Role
    to_scan: ToScan | None = None
    to_poses: ToPoses | None = None
    to_cloud: ToCloud | None = None


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
            is_framed = look(item, self.parent) or look(message, self.parent) is None
            parent = get_frame(item if is_framed else message, self.parent)
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


def look(message: Any, path: str) -> Any:
    """Look for a field of a decoded message by its dotted name; None where it is absent."""
    for name in path.split("."):
        message = message.get(name) if isinstance(message, dict) else getattr(message, name, None)
    return message


def get(message: Any, path: str) -> Any:
    """Get a field likewise; raises DamageError where it is absent."""
    value = look(message, path)
    if value is None:
        raise DamageError(f"has no {path}")
    return value


def get_list(message: Any, path: str) -> Sequence[Any]:
    """Get a list of messages; raises DamageError."""
    value = get(message, path)
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise DamageError(f"holds {type(value).__name__} where a list of messages belongs")
    return value


def get_whole(message: Any, path: str) -> int:
    """Get a whole number of at most 64 bits; raises DamageError."""
    return as_stamp(get(message, path))


def get_stamp(message: Any, path: str) -> int:
    """Get a time in ns; raises DamageError."""
    stamp = get(message, path)
    for names in _STAMP_NAMES:
        seconds, nanoseconds = (look(stamp, name) for name in names)
        if nanoseconds is not None:
            return as_stamp(as_stamp(seconds) * 1_000_000_000 + as_stamp(nanoseconds))
    raise DamageError(f"has no {path}")


def get_frame(message: Any, path: str) -> str:
    """Get a frame's name; old logs write `/laser` in one place and `laser` in another."""
    return as_text(get(message, path)).lstrip("/")


def get_row(message: Any, path: str) -> Float64:
    """Get a list of numbers (B,); raises DamageError.

    JSON has no infinity: writers leave a null or a name, which NumPy reads as nan or infinity.
    """
    try:
        with np.errstate(invalid="ignore"):  # a flipped bit makes a signalling NaN of infinity
            row = np.array(get(message, path), np.float64)
    except (TypeError, ValueError, OverflowError):
        row = np.empty(())
    if row.ndim != 1:
        raise DamageError("holds something else where a row of numbers belongs")
    return row


def convert_laser_scan(_options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/LaserScan."""
    return _make_scan(message, get_row(message, "ranges"), topic, record_ns)


def convert_multi_echo(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/MultiEchoLaserScan, taking one echo of each beam.

    A beam without an echo becomes +inf: nothing came back (REP 117).
    """
    at = 0 if options.echo is Echo.FIRST else -1
    beams = [get_row(beam, "echoes") for beam in get_list(message, "ranges")]
    ranges = [echoes[at] if len(echoes) else math.inf for echoes in beams]
    return _make_scan(message, np.array(ranges, np.float64), topic, record_ns)


def _make_scan(message: Any, ranges: ArrayLike, topic: str, record_ns: int) -> Scan:
    return Scan(
        stamp_ns=get_stamp(message, "header.stamp"),
        frame=get_frame(message, "header.frame_id"),
        angle_min=get(message, "angle_min"),
        angle_increment=get(message, "angle_increment"),
        ranges=ranges,
        range_min=get(message, "range_min"),
        range_max=get(message, "range_max"),
        time_increment=get(message, "time_increment"),
        topic=topic,
        record_ns=record_ns,
    )


def convert_foxglove_scan(
    _options: ReaderOptions, message: Any, topic: str, record_ns: int
) -> Scan:
    """Convert a foxglove.LaserScan, which has no range limits.

    Where it states an origin other than its frame's, it gets a frame of its own, whose pose
    `convert_origin` gives.
    """
    ranges = get_row(message, "ranges")
    start, end = (as_number(get(message, name)) for name in ("start_angle", "end_angle"))
    origin = convert_origin(message, topic, record_ns)
    return Scan(
        stamp_ns=get_stamp(message, "timestamp"),
        frame=origin[0].child if origin else get_frame(message, "frame_id"),
        angle_min=start,
        angle_increment=(end - start) / max(len(ranges) - 1, 1),
        ranges=ranges,
        range_min=0.0,
        range_max=math.inf,
        topic=topic,
        record_ns=record_ns,
    )


def convert_origin(message: Any, topic: str, record_ns: int) -> list[PoseSample]:
    """Give the pose of a foxglove.LaserScan in its frame; none where it is the frame's own."""
    (sample,) = FOXGLOVE.read(message, topic, record_ns)
    child = f"{sample.parent}:{topic.strip('/')}"
    return [] if sample.pose == IDENTITY else [sample._replace(child=child)]


def convert_cloud(message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a sensor_msgs/PointCloud2.

    Raises
    ------
    DamageError
        The cloud has no x, y, z, or is not as long as it says.
    """
    stamp_ns = get_stamp(message, "header.stamp")
    columns = read_columns(message)
    if not all(name in columns for name in "xyz"):
        raise DamageError("is a cloud of points without x, y and z")
    points = np.empty((len(columns["x"]), 3), np.float32)
    with np.errstate(invalid="ignore", over="ignore"):  # a flipped bit makes any number
        for axis, name in enumerate("xyz"):
            points[:, axis] = columns[name]
    times = next((columns[name] for name in TIME_FIELDS if name in columns), None)
    offset_ns = None if times is None else find_offsets(times, points, stamp_ns)
    frame = get_frame(message, "header.frame_id")
    return Cloud(stamp_ns, frame, points, offset_ns, None, topic, record_ns)


def read_columns(message: Any) -> dict[str, NDArray[Any]]:
    """Read the fields of points that occmap uses, (N,) each, by their names.

    Raises
    ------
    DamageError
        The cloud is not as long as it says.
    """
    order = ">" if get_whole(message, "is_bigendian") else "<"
    sizes = ("height", "width", "point_step", "row_step")
    rows, width, step, row_step = (get_whole(message, name) for name in sizes)
    row_step = row_step if rows > 1 else width * step
    data = get(message, "data")
    if not isinstance(data, np.ndarray) or data.dtype.itemsize != 1:
        raise DamageError("holds something else where bytes belong")
    if min(rows, width) < 0 or (rows - 1) * row_step + width * step > len(data):
        raise DamageError(f"announces {rows} x {width} points in {len(data)} bytes")
    data, columns = np.ascontiguousarray(data).data, {}
    for field in get_list(message, "fields"):
        name, kind = as_text(get(field, "name")), _FORMATS.get(get_whole(field, "datatype"))
        if kind is None or name not in (*"xyz", *TIME_FIELDS):
            continue
        dtype, at = np.dtype(f"{order}{kind}"), get_whole(field, "offset")
        if row_step < width * step or not 0 <= at <= step - dtype.itemsize:
            raise DamageError("is a cloud whose points lie over one another")
        shape = rows, width
        is_empty = rows * width == 0
        column = (
            np.empty(shape, dtype)
            if is_empty
            else np.ndarray(shape, dtype, data, at, (row_step, step))
        )
        columns[name] = column.ravel()
    return columns


def find_offsets(times: NDArray[Any], points: Float32, stamp_ns: int) -> Int64 | None:
    """Find when points were measured, in ns after the stamp (N,), whatever their driver's unit.

    Times may be relative to the stamp or absolute, in s, us or ns. Those of a clock other than
    the stamp's are taken from the first point on. None where all points have one time, or times
    are further apart than any sensor's sweep.
    """
    with np.errstate(invalid="ignore"):
        values = times.astype(np.float64)
        used = np.isfinite(values) & np.isfinite(points).all(axis=1) & points.any(axis=1)
    if not used.any():
        return None
    low, high = float(values[used].min()), float(values[used].max())
    unit, is_absolute = find_time_unit(low, high)
    # Counted from the earliest one, since nanoseconds of a clock are more than a float can tell.
    offset_ns = np.rint((np.where(used, values, low) - low) * unit).astype(np.int64)
    start_ns = round(low * unit) - (stamp_ns if is_absolute else 0)
    if is_absolute and abs(start_ns) > LONGEST_SWEEP_NS:
        start_ns = 0
    offset_ns += start_ns
    longest = max(abs(int(offset_ns.min())), abs(int(offset_ns.max())))
    return offset_ns if 0 < longest <= LONGEST_SWEEP_NS else None


def find_time_unit(low: float, high: float) -> tuple[float, bool]:
    """Find how many ns the unit of points' times has, and whether they are a clock's.

    A clock has counted 1e9 seconds since 2001; a sweep takes less than two seconds.
    """
    for unit in (1.0, 1e3, 1e9):
        if low * unit > 1e18 and (high - low) * unit <= 10 * LONGEST_SWEEP_NS:
            return unit, True
    largest = max(abs(low), abs(high))
    return next((unit for unit, most in ((1e9, 2), (1e3, 2e6)) if largest <= most), 1.0), False


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

TYPES = {
    "sensor_msgs/msg/LaserScan": MessageType(Role.SCAN, convert_laser_scan),
    "sensor_msgs/msg/MultiEchoLaserScan": MessageType(Role.SCAN, convert_multi_echo),
    "sensor_msgs/msg/PointCloud2": MessageType(Role.CLOUD, to_cloud=convert_cloud),
    "foxglove.LaserScan": MessageType(Role.SCAN, convert_foxglove_scan, convert_origin),
} | {
    name: MessageType(Role.POSE, to_poses=fields.read)
    for name, fields in {
        "tf2_msgs/msg/TFMessage": _TF,
        "tf/msg/tfMessage": _TF,
        "nav_msgs/msg/Odometry": _UNCERTAIN._replace(child="child_frame_id"),
        "geometry_msgs/msg/PoseStamped": PoseFields(),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _UNCERTAIN,
        "nav_msgs/msg/Path": PoseFields(items="poses"),
        "foxglove.FrameTransform": _TRANSFORM,
        "foxglove.FrameTransforms": _TRANSFORM._replace(items="transforms"),
        "foxglove.PoseInFrame": FOXGLOVE,
        "foxglove.PosesInFrame": _POSES,
    }.items()
}


def find_type(channel: Channel) -> MessageType | None:
    """Find how messages are read, if at all: ROS and Foxglove each write them in two ways."""
    encodings = {"cdr", "ros1"} if "/" in channel.type else {"json", "protobuf"}
    return TYPES.get(channel.kind) if channel.encoding in encodings else None
