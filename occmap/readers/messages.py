"""Messages as values: decoded by a library, one by one or many at once, and converted.

Only what goes wrong while bytes are decoded, or a value that `Scan` or `PoseSample` refuses, is
damage of the log. Any other error is a fault of occmap's, and is not caught. Scans and poses that
are laid out alike are taken from the bytes of many messages together.
"""

import json
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from occmap.errors import DamageError, LogError
from occmap.readers.containers import Channel, normalise_type
from occmap.types import Bool, Int64, PoseBatch, PoseSample, Scan, ScanRun, UInt8

T = TypeVar("T")
FromBytes: TypeAlias = Callable[[memoryview, int], T]
"""From a message's bytes and its record time in ns; it raises DamageError."""
Parse: TypeAlias = Callable[[memoryview, str], Any]
"""From a message's bytes, and how they are written, to its fields."""


class Layout(NamedTuple):
    """How ROS lays out messages of which a log holds many: a header, or a list of transforms."""

    is_cdr: bool
    """Whether numbers are aligned; ROS 1 aligns none, and counts messages in their headers"""
    is_list: bool
    names_child: bool
    """Whether a pose stands behind a second frame, the child's"""


_Parser: TypeAlias = tuple[Callable[[memoryview], Any], tuple[type[Exception], ...], Layout | None]
"""From a message's bytes to its fields, what it raises on bytes that are not well formed, and how
messages are laid out, if as ROS does"""

# What rosbags raises on definitions and on bytes that are not well formed.
_DEFINITION_ERRORS = (
    TypesysError, AssertionError, LookupError, MemoryError, NameError, RecursionError, SyntaxError,
    TypeError, ValueError,
)  # fmt: skip
_DECODE_ERRORS = (
    SerdeError, struct.error, ArithmeticError, AssertionError, LookupError, MemoryError,
    RecursionError, TypeError, ValueError,
)  # fmt: skip

MAX_DEFINITION = 1 << 15
"""Characters of a message definition at most; none of ROS has a fifth of that, with comments."""
MAX_FILES = 500
"""Files of a protobuf schema at most; Foxglove's own needs six."""
MAX_VALUES = 1000
"""Values of a message, lists aside, at most; the covariances of an odometry are 72."""

_STORES = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
"""rosbags knows all types but the older of these, and of ROS 1 neither."""
_ONE, _MOVED, _LIST = (False, False), (False, True), (True, True)
_LAYOUTS = {
    "cdr": {
        "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828": _ONE,  # LaserScan
        "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8": _ONE,  # PoseStamped
        "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e": _ONE,  # uncertain
        "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0": _MOVED,  # Odometry
        "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087": _LIST,  # TFMessage
    },
    "ros1": {
        "483198ef52b200f0d8904fbf199f72919290c84f61d8ebddc7b0b1215e3e4e0e": _ONE,
        "576be1857cf9c4af2d859f93d09be37b41aae465beccf730afad4a38fe94f160": _ONE,
        "aea1cb8d7696cf4604347c8fd72209da4d1515283c6517f36dcb58b3f06c582d": _ONE,
        "57f57a5b51343129742e281ee4dd27913daf43f90bbabed1a9c17c19ec5f388a": _MOVED,
        "0d1525cc15115cd686fb5b0c69bff596832d5f7eb8dc766b0ee926b3ad5f99e2": _LIST,
        "3a251e86098111cc45383f1ebaf07d69f5e1fd4484fabd9081da7148cf7eb5be": _LIST,  # tfMessage
    },
}
"""How most messages of a log are laid out, by the hashes (REP 2016) of their types as ROS defines
them; little-endian ones can be stacked and read many at once"""


def make_reader(
    channel: Channel, convert: Callable[[Any, str, int], T], parse_whole: Parse | None = None
) -> tuple[FromBytes[T], Layout | None]:
    """Build the function that reads a channel's messages: decodes and converts them.

    Parameters
    ----------
    convert
        Takes a decoded message, its topic and its record time in ns.
    parse_whole
        Decodes a message in place of what the log's definition says.

    Returns
    -------
    read, layout
        By which `read_scan_run` or `read_pose_batches` can read many of the messages at once.

    Raises
    ------
    LogError
        The channel's message definition cannot be understood.
    """
    topic, kind = channel.topic, channel.kind
    parser: _Parser
    if parse_whole:
        parser = lambda data: parse_whole(data, channel.encoding), (), None
    else:
        parser = _PARSERS[channel.encoding](channel)
    parse, errors, layout = parser

    def read(data: memoryview, record_ns: int) -> T:
        try:
            message = parse(data)
        except errors as error:
            raise DamageError(f"is not a {kind} ({type(error).__name__})") from error
        return convert(message, topic, record_ns)

    return read, layout


@lru_cache(maxsize=64)
def _make_ros_parser(text: str, kind: str, encoding: str) -> _Parser:
    """Make what reads a message by the log's definition of it, or by ROS's where it has none.

    Cached, since all logs of a robot have the same definitions.

    Raises
    ------
    LogError
        The definition cannot be understood, or asks for more than any message needs.
    """
    name = normalise_type(kind)
    try:
        store = _make_store(text, name) if text else _load_standard(encoding)
        store.get_msgdef(name)
    except _DEFINITION_ERRORS as error:
        raise _refuse(kind, error) from error
    layout = None
    with suppress(LookupError):  # of a type that has no hash, or one of its own
        known = _LAYOUTS[encoding][store.hash_rihs01(name).removeprefix("RIHS01_")]
        layout = Layout(encoding == "cdr", *known)
    deserialise = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
    return lambda data: deserialise(data, name), _DECODE_ERRORS, layout


def _refuse(kind: str, why: Exception) -> LogError:
    reason = f"{type(why).__name__}: {why}"
    reason = reason if len(reason) <= 99 else f"{reason[:96]}..."
    return LogError(f"the definition of {kind} cannot be understood ({reason})")


@cache
def _load_standard(encoding: str) -> Typestore:
    """Load the types that ROS itself has."""
    store = get_typestore(_STORES[encoding])
    for name in _TF_TYPES:
        if name not in store.fielddefs:
            store.register(get_types_from_msg(_TF_DEFINITION, name))
    return store


def _make_store(text: str, name: str) -> Typestore:
    """Make the types of a definition and those appended to it: what one needs, without constants.

    Raises
    ------
    _DEFINITION_ERRORS
        The definition is damaged, or asks for too much.
    """
    if len(text) > MAX_DEFINITION:
        raise ValueError(f"it has {len(text)} characters")
    store = get_typestore(Stores.EMPTY)
    # Bags from before 2011 call the header by the package that it then was in.
    types = get_types_from_msg(text.replace("MSG: roslib/Header", "MSG: std_msgs/Header"), name)
    types = {**store.fielddefs, **types}  # ROS 1 has a time of its own
    counts: dict[str, int] = {}
    _count_values(types, name, counts)
    store.register({part: ([], types[part][1]) for part in counts})
    return store


def _count_values(types: Typesdict, name: str, counts: dict[str, int]) -> int:
    """Count the values that a message has before any list in it.

    rosbags writes a line of code for each value, and would read what takes no bytes for ever.

    Parameters
    ----------
    counts
        Grows by the values of the type and of all that it is made of.

    Raises
    ------
    ValueError
        Nobody can read such a message.
    """
    if name not in types:
        raise ValueError(f"{name} is not defined")
    if name in counts:
        if not counts[name]:
            raise ValueError(f"{name} contains itself")
        return counts[name]
    counts[name] = total = 0
    fields: Any = types[name][1]
    for _, (node, detail) in fields:
        part, repeat = (node, detail), 1
        if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
            part, repeat = detail[0], detail[1] if node == Nodetype.ARRAY else 1
        total += repeat * (_count_values(types, part[1], counts) if part[0] == Nodetype.NAME else 1)
    if not 0 < total <= MAX_VALUES:
        raise ValueError(f"{name} holds {total} values")
    counts[name] = total
    return total


def _make_json_parser(_channel: Channel) -> _Parser:
    return lambda data: json.loads(bytes(data)), (ValueError, RecursionError, MemoryError), None


def _make_protobuf_parser(channel: Channel) -> _Parser:
    """Make what reads a message by the descriptors that lie in the log.

    Raises
    ------
    LogError
        The protobuf package is not installed, or the descriptors are damaged.
    """
    try:
        from google.protobuf.message import DecodeError  # noqa: PLC0415  an extra
    except ImportError:
        fix = "install what reads it: pip install '.[foxglove]'"
        raise LogError(f"{channel.type} is written in protobuf", fix=fix) from None
    try:
        message_class = _load_message(channel)
    except (DecodeError, KeyError, TypeError, ValueError) as error:
        raise _refuse(channel.type, error) from error
    return lambda data: message_class.FromString(bytes(data)), (DecodeError,), None


def _load_message(channel: Channel) -> Any:
    """Load the message class from the files of its schema."""
    from google.protobuf import descriptor_pb2, message_factory  # noqa: PLC0415  as above

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.descriptors).file
    if len(files) > MAX_FILES:
        raise ValueError(f"{len(files)} files make one type")
    return message_factory.GetMessages(files)[channel.type]


_PARSERS: Mapping[str, Callable[[Channel], _Parser]] = {
    "cdr": lambda channel: _make_ros_parser(channel.definition, channel.type, "cdr"),
    "ros1": lambda channel: _make_ros_parser(channel.definition, channel.type, "ros1"),
    "json": _make_json_parser,
    "protobuf": _make_protobuf_parser,
}
"""What makes the parser of each way in which messages are written."""


Stacked: TypeAlias = tuple[bytes, int]
"""A message of one channel and length, and its record time (ns)."""

SHORTEST_RUN = 64
"""Fewer scans are read one by one, to be stacked with others of their kind."""
MOST_GROUPS = 16
"""Messages of one length are grouped by the frames that they name, but not into more groups."""
_LITTLE_ENDIAN = b"\0\1"
"""What a CDR message begins with that can be read so."""
_STAMP = 4
"""Where a stamp begins: after the encapsulation of CDR, or the sequence number of ROS 1."""
_FRAME = 16
"""Where the letters of a scan's frame begin, after their number."""
_ANGLE_MAX, _TIME_INCREMENT, _RANGE_MIN, _RANGES = 4, 12, 20, 32
"""Bytes from the first of the seven floats on. The largest angle and the scan time are not used."""
_POSE = 56
"""Bytes of a translation and a rotation."""


def read_scan_run(
    messages: Sequence[Stacked], layout: Layout, read: FromBytes[list[Scan]]
) -> tuple[list[ScanRun], Sequence[Stacked]]:
    """Read scans of one length that follow one another.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in all of them.

    Returns
    -------
    runs, others
        One run, or all messages where they are few, not little-endian, or not alike but for times
        and ranges.

    Raises
    ------
    DamageError
        The first message is damaged.
    """
    if len(messages) < SHORTEST_RUN or not _is_stackable(messages[0][0], layout):
        return [], messages
    # Decoded first: that it could be says that all its parts lie within the message.
    (first,) = read(memoryview(messages[0][0]), messages[0][1])
    raw = _stack(messages)
    floats = _align(_FRAME + _count_at(messages[0][0], _FRAME - 4), 4, layout)
    ranges = floats + _RANGES
    intensities = ranges + 4 * len(first.ranges)
    free = (
        _span_stamp(_STAMP, layout),
        (floats + _ANGLE_MAX, floats + _ANGLE_MAX + 4),
        (floats + _TIME_INCREMENT, floats + _RANGE_MIN),
        (ranges, intensities),
        (intensities + 4, raw.shape[1]),
    )
    if not _find_alike(raw, free).all():
        return [], messages
    run = ScanRun(
        first,
        _read_stamps(raw, _STAMP),
        np.array([record_ns for _, record_ns in messages], np.int64),
        _read_columns(raw, ranges, "<f4", len(first.ranges)),
        _read_columns(raw, floats + _TIME_INCREMENT, "<f4")[:, 0].astype(np.float64),
    )
    return [run], []


def read_pose_batches(
    messages: Sequence[Stacked], layout: Layout, read: FromBytes[list[PoseSample]]
) -> tuple[list[PoseBatch], Sequence[Stacked]]:
    """Read messages of poses of one length.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in those that are like it.

    Returns
    -------
    batches, others
        The samples of each pose, and the messages of groups beyond `MOST_GROUPS`, or all where
        the first is not little-endian.

    Raises
    ------
    DamageError
        The first message of its group is damaged.
    """
    raw = _stack(messages)
    record_ns = np.array([record_ns for _, record_ns in messages], np.int64)
    batches: list[PoseBatch] = []
    left = np.arange(len(messages))
    for _ in range(MOST_GROUPS):
        if not len(left) or not _is_stackable(first := messages[int(left[0])][0], layout):
            break
        # Decoded first: that it could be says that all its parts lie within the message.
        samples = read(memoryview(first), 0)
        places = _locate(first, layout)
        stamps = [_span_stamp(stamp, layout) for stamp, _ in places]
        poses = [(pose, pose + _POSE if layout.is_list else raw.shape[1]) for _, pose in places]
        alike = _find_alike(raw[left], stamps + poses)
        rows = left[alike]
        own, own_ns = raw[rows], record_ns[rows]  # once: a message may hold very many transforms
        for (stamp, pose), sample in zip(places, samples, strict=True):
            times, numbers = _read_stamps(own, stamp), _read_columns(own, pose, "<f8", 7)
            frames = sample.parent, sample.child, sample.static, sample.topic
            batches.append(PoseBatch(times, own_ns, numbers, *frames))
        left = left[~alike]
    return batches, [messages[i] for i in left.tolist()]


def _locate(message: bytes, layout: Layout) -> list[tuple[int, int]]:
    """Find where the stamp and the pose of each transform of a message lie, or of its only pose."""
    at, count, places = 4 if layout.is_cdr else 0, 1, []
    if layout.is_list:
        count, at = _count_at(message, at), at + 4
    for _ in range(count):
        stamp = _align(at, 4, layout) + (0 if layout.is_cdr else 4)
        names = _pass_name(message, stamp + 8, layout)
        if layout.names_child:
            names = _pass_name(message, names, layout)
        pose = _align(names, 8, layout)
        places.append((stamp, pose))
        at = pose + _POSE
    return places


def _pass_name(message: bytes, at: int, layout: Layout) -> int:
    """Find where a name ends that begins, with its length, at an offset or, in CDR, behind it."""
    start = _align(at, 4, layout)
    return start + 4 + _count_at(message, start)


def _count_at(message: bytes, at: int) -> int:
    """Read the count of what follows, as a sequence and a string begin with one."""
    return int.from_bytes(message[at : at + 4], "little")


def _align(at: int, size: int, layout: Layout) -> int:
    """Round an offset up, as CDR does from behind its four encapsulation bytes; ROS 1 does not."""
    return at + (4 - at) % size if layout.is_cdr else at


def _span_stamp(at: int, layout: Layout) -> tuple[int, int]:
    """Find the bytes of a stamp, and of the number that counts messages before it in ROS 1."""
    return at if layout.is_cdr else at - 4, at + 8


def _is_stackable(message: bytes, layout: Layout) -> bool:
    """Whether the numbers of a message lie as NumPy reads them here: little-endian."""
    return not layout.is_cdr or message.startswith(_LITTLE_ENDIAN)


def _stack(messages: Sequence[Stacked]) -> UInt8:
    """Stack messages of one length as rows (M, L)."""
    raw = np.frombuffer(b"".join(data for data, _ in messages), np.uint8)
    return raw.reshape(len(messages), -1)


def _find_alike(raw: UInt8, free: Iterable[tuple[int, int]]) -> Bool:
    """Say which of M messages (M, L) are as the first but for some bytes.

    Parameters
    ----------
    free
        Where spans of bytes that may differ begin and end; the end is outside.

    Returns
    -------
    alike
        (M,)
    """
    fixed = np.ones(raw.shape[1], np.bool_)
    for start, end in free:
        fixed[start:end] = False
    alike: Bool = (raw[:, fixed] == raw[0, fixed]).all(axis=1)
    return alike


def _read_columns(raw: UInt8, at: int, kind: str, count: int = 1) -> NDArray[Any]:
    """Read `count` numbers of a NumPy type that begin at an offset in each of M messages (M, L).

    Returns
    -------
    numbers
        (M, count)
    """
    size = count * np.dtype(kind).itemsize
    return np.ascontiguousarray(raw[:, at : at + size]).view(kind)


def _read_stamps(raw: UInt8, at: int) -> Int64:
    """Read the stamps (M,) in ns of messages (M, L): seconds, then nanoseconds."""
    seconds = _read_columns(raw, at, "<i4")[:, 0].astype(np.int64)
    stamp_ns: Int64 = seconds * 1_000_000_000 + _read_columns(raw, at + 4, "<u4")[:, 0]
    return stamp_ns
