"""From the bytes of a ROS message to scans and pose samples, by the log's own definitions."""

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, TypeAlias, TypeVar

from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from occmap.errors import LogError
from occmap.readers.foxglove import FOXGLOVE_ENCODINGS, POSE_SCHEMAS, SCAN_SCHEMAS
from occmap.readers.foxglove_decode import make_foxglove_reader
from occmap.readers.inflate import inflate_message
from occmap.readers.messages import POSE_TYPES, find_converter, normalise_type
from occmap.readers.options import ReaderOptions
from occmap.readers.ros_cdr import (
    ROS1_DEFINITIONS,
    STANDARD_DEFINITIONS,
    is_standard,
    read_laser_scan,
    read_transforms,
)
from occmap.readers.ros_source import Channel, Encoding
from occmap.types import PoseSample, Scan

T = TypeVar("T")
FromBytes: TypeAlias = Callable[[memoryview, int], T]
"""From a message's bytes and its record time in ns."""

# rosbags' parser and the code it generates raise these on definitions that are not well formed.
_DEFINITION_ERRORS = (TypesysError, AssertionError, LookupError, SyntaxError, TypeError, ValueError)
_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms"
"""rosbags knows all types of ROS 1 but these."""
_DEFINITIONS: Mapping[Encoding, Mapping[str, str]] = {
    "cdr": STANDARD_DEFINITIONS,
    "ros1": ROS1_DEFINITIONS,
}
_IDL_SEPARATOR = "=" * 80 + "\n"


def make_scan_reader(channel: Channel, options: ReaderOptions) -> FromBytes[Scan]:
    """Build the function that reads a channel's messages as scans.

    Raises
    ------
    LogError
        The channel's message definition cannot be understood.
    """
    if channel.encoding in FOXGLOVE_ENCODINGS:
        return make_foxglove_reader(channel, SCAN_SCHEMAS[channel.type])
    return _make_reader(channel, find_converter(channel.type, options), read_laser_scan)


def make_pose_reader(channel: Channel) -> FromBytes[list[PoseSample]]:
    """Build the function that reads a channel's messages as pose samples.

    Raises
    ------
    LogError
        The channel's message definition cannot be understood.
    """
    if channel.encoding in FOXGLOVE_ENCODINGS:
        return make_foxglove_reader(channel, POSE_SCHEMAS[channel.type])
    convert = POSE_TYPES[normalise_type(channel.type)]
    return _make_reader(channel, convert, read_transforms)


def is_laid_out_plainly(channel: Channel) -> bool:
    """Say whether messages are of the types that a log holds most of, and laid out as is usual.

    Little-endian ones can then be read many at a stroke.
    """
    name, known = normalise_type(channel.type), _DEFINITIONS.get(channel.encoding, {})
    if channel.compressed or name not in known:
        return False
    try:
        return is_standard(name, _load_types(channel, name).fielddefs, known)
    except _DEFINITION_ERRORS:
        return False


def _make_reader(
    channel: Channel,
    convert: Callable[[Any, str, int], T],
    read_standard: Callable[[memoryview, str, int], T],
) -> FromBytes[T]:
    """Combine decoding and conversion, by the short way where the definition is standard."""
    name, topic = normalise_type(channel.type), channel.topic
    try:
        store = _load_types(channel, name)
        short = channel.encoding == "cdr" and is_standard(name, store.fielddefs)
        if not short:
            store.get_msgdef(name)
    except _DEFINITION_ERRORS as error:
        raise LogError(
            f"the definition of {channel.type} cannot be understood ({type(error).__name__})",
            where=topic,
        ) from error
    decode = store.deserialize_ros1 if channel.encoding == "ros1" else store.deserialize_cdr

    def read_any(data: memoryview, record_ns: int) -> T:
        return convert(decode(data, name), topic, record_ns)

    def read_short(data: memoryview, record_ns: int) -> T:
        if data[0] == 0 and data[1] == 1:
            return read_standard(data, topic, record_ns)
        return read_any(data, record_ns)

    read = read_short if short else read_any
    return _decompress_first(read) if channel.compressed else read


def _decompress_first(read: FromBytes[T]) -> FromBytes[T]:
    """Decompress each message before it is read."""
    return lambda data, record_ns: read(inflate_message(data), record_ns)


def _load_types(channel: Channel, name: str) -> Typestore:
    """Load the log's own definition of a message type, or the standard one where it has none."""
    if channel.definition:
        return _parse_definition(channel.definition, name, channel.syntax)
    if channel.encoding == "cdr" and name in STANDARD_DEFINITIONS:
        return _parse_definition(STANDARD_DEFINITIONS[name], name, "msg")
    if channel.encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TF_DEFINITION, name) if name in _TF_TYPES else {})
    return store


@lru_cache(maxsize=64)
def _parse_definition(definition: str, name: str, syntax: str) -> Typestore:
    """Parse a definition and those appended to it."""
    if syntax == "msg":
        # Bags from before 2011 call the header by the package that it then was in.
        renamed = definition.replace("MSG: roslib/Header", "MSG: std_msgs/Header")
        types = get_types_from_msg(renamed, name)
    else:
        # Where there are several, each is headed by a line that names it.
        parts = [re.sub(r"\AIDL: .*\n", "", part) for part in definition.split(_IDL_SEPARATOR)]
        types = {}
        for part in filter(str.strip, parts):
            types |= get_types_from_idl(part)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store
