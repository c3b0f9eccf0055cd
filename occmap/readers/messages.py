"""Messages as values: decoded by a library, and handed to what converts them.

Only what goes wrong while bytes are decoded, or a value that `Scan` or `PoseSample` refuses, is
damage of the log. Any other error is a fault of occmap's, and is not caught.
"""

import json
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any, TypeAlias, TypeVar

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from occmap.errors import DamageError, LogError
from occmap.readers.source import Channel, normalise_type

T = TypeVar("T")
FromBytes: TypeAlias = Callable[[memoryview, int], T]
"""From a message's bytes and its record time in ns; it raises DamageError."""
_Parser: TypeAlias = tuple[Callable[[memoryview], Any], tuple[type[Exception], ...], bool]
"""From a message's bytes to its fields, what it raises on bytes that are not well formed, and
whether a message is as ROS itself defines it."""

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
_PLAIN_TYPES = ("sensor_msgs/msg/LaserScan", *_TF_TYPES)
"""The types of most messages of a log."""
_PLAIN_HASHES = {
    "cdr": {
        "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    },
    "ros1": {
        "RIHS01_483198ef52b200f0d8904fbf199f72919290c84f61d8ebddc7b0b1215e3e4e0e",
        "RIHS01_0d1525cc15115cd686fb5b0c69bff596832d5f7eb8dc766b0ee926b3ad5f99e2",
        "RIHS01_3a251e86098111cc45383f1ebaf07d69f5e1fd4484fabd9081da7148cf7eb5be",
    },
}
"""The hashes (REP 2016) of these types as ROS defines them. They tell without loading all its
types, which takes a build 5 to 8% of its time, that a log defines one as ROS does."""


def make_reader(
    channel: Channel,
    convert: Callable[[Any, str, int], T],
    parse_whole: Callable[[memoryview, str], Any] | None = None,
) -> tuple[FromBytes[T], bool]:
    """Build the function that reads a channel's messages: decodes and converts them.

    Parameters
    ----------
    convert
        Takes a decoded message, its topic and its record time in ns.
    parse_whole
        Decodes a message of an encoding, in place of what the log's definition says.

    Returns
    -------
    read, is_plain
        Whether the messages are of the types that a log holds most of, and laid out as is usual:
        little-endian ones can then be stacked, and read many at once.

    Raises
    ------
    LogError
        The channel's message definition cannot be understood.
    """
    topic, kind = channel.topic, channel.kind
    parser: _Parser
    if parse_whole:
        parser = lambda data: parse_whole(data, channel.encoding), (), False
    else:
        parser = _PARSERS[channel.encoding](channel)
    parse, errors, is_standard = parser

    def read(data: memoryview, record_ns: int) -> T:
        try:
            message = parse(data)
        except errors as error:
            raise DamageError(f"is not a {kind} ({type(error).__name__})") from error
        return convert(message, topic, record_ns)

    return read, is_standard and kind in _PLAIN_TYPES


def _make_ros_parser(channel: Channel) -> _Parser:
    """Make what reads a message by the log's definition of it, or by ROS's where it has none.

    Raises
    ------
    LogError
        The definition cannot be understood, or asks for more than any message needs.
    """
    store, is_standard = _make_store(channel.definition, channel.type, channel.encoding)
    name = channel.kind
    try:
        store.get_msgdef(name)
    except _DEFINITION_ERRORS as error:
        raise _refuse(channel.type, error) from error
    deserialise = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr
    return lambda data: deserialise(data, name), _DECODE_ERRORS, is_standard


def _refuse(kind: str, why: str | Exception) -> LogError:
    reason = why if isinstance(why, str) else type(why).__name__
    return LogError(f"the definition of {kind} cannot be understood ({reason})")


@cache
def _load_standard(encoding: str) -> Typestore:
    """Load the types that ROS itself has."""
    store = get_typestore(_STORES[encoding])
    for name in _TF_TYPES:
        if name not in store.fielddefs:
            store.register(get_types_from_msg(_TF_DEFINITION, name))
    return store


@lru_cache(maxsize=64)
def _make_store(text: str, kind: str, encoding: str) -> tuple[Typestore, bool]:
    """Make the types of a definition. Cached, since all logs of a robot have the same ones."""
    if not text:
        return _load_standard(encoding), True
    own, name = _parse_definition(text, kind), normalise_type(kind)
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(own)
    except _DEFINITION_ERRORS as error:
        raise _refuse(kind, error) from error
    with suppress(LookupError):  # of a type that has no hash
        if store.hash_rihs01(name) in _PLAIN_HASHES[encoding]:
            return store, True
    standard = _load_standard(encoding)
    known = standard.fielddefs
    if all(part in known and known[part][1] == fields for part, (_, fields) in own.items()):
        return standard, True
    return store, False


def _parse_definition(text: str, kind: str) -> Typesdict:
    """Parse a definition and those appended to it; keep what the type needs, without constants."""
    name = normalise_type(kind)
    if len(text) > MAX_DEFINITION:
        raise _refuse(kind, f"it has {len(text)} characters")
    try:
        # Bags from before 2011 call the header by the package that it then was in.
        types = get_types_from_msg(text.replace("MSG: roslib/Header", "MSG: std_msgs/Header"), name)
    except _DEFINITION_ERRORS as error:
        raise _refuse(kind, error) from error
    types = {**get_typestore(Stores.EMPTY).fielddefs, **types}  # ROS 1 has a time of its own
    counts: dict[str, int] = {}
    try:
        _count_values(types, name, counts)
    except ValueError as error:
        flaw = str(error)
        raise _refuse(kind, flaw if len(flaw) <= 99 else f"{flaw[:96]}...") from None
    return {part: ([], types[part][1]) for part in counts}


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
    return lambda data: json.loads(bytes(data)), (ValueError, RecursionError, MemoryError), False


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
    return lambda data: message_class.FromString(bytes(data)), (DecodeError,), False


def _load_message(channel: Channel) -> Any:
    """Load the message class from the files of its schema."""
    from google.protobuf import descriptor_pb2, message_factory  # noqa: PLC0415  as above

    files = descriptor_pb2.FileDescriptorSet.FromString(channel.descriptors).file
    if len(files) > MAX_FILES:
        raise ValueError(f"{len(files)} files make one type")
    return message_factory.GetMessages(files)[channel.type]


_PARSERS: Mapping[str, Callable[[Channel], _Parser]] = {
    "cdr": _make_ros_parser,
    "ros1": _make_ros_parser,
    "json": _make_json_parser,
    "protobuf": _make_protobuf_parser,
}
"""What makes the parser of each way in which messages are written."""
