"""Messages as values: decoded by a library, one by one or many at once, and converted.

Only what goes wrong while bytes are decoded, or a value that `Scan` or `PoseSample` refuses, is
damage of the log. Any other error is a fault of occmap's, and is not caught. Scans and poses that
are laid out alike are taken from the bytes of many messages together.
"""

import json
import struct
from collections.abc import Callable, Collection, Mapping
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from occmap.errors import DamageError, LogError
from occmap.plugins import tell_install
from occmap.readers.containers import Channel, normalise_type
from occmap.types import Bool, Int64, Scan, ScanBatch, UInt8

T = TypeVar("T")
FromBytes: TypeAlias = Callable[[memoryview, int], T]
"""From a message's bytes and its record time in ns; it raises DamageError."""


class Place(NamedTuple):
    """Where a number lies in a message, or a list of numbers."""

    start: int
    end: int
    kind: np.dtype[Any]


Locate: TypeAlias = Callable[[memoryview], Mapping[str, Place]]
"""From a message to where its numbers lie, by their dotted names; raises DamageError"""


class Parser(NamedTuple):
    """What makes fields of the bytes of a message."""

    parse: Callable[[memoryview], Any]
    errors: tuple[type[Exception], ...] = ()
    """What it raises on bytes that are not well formed"""
    locate: Locate | None = None
    """Finds the numbers of a message, if they lie as ROS lays them out"""


# What rosbags raises on definitions and on bytes that are not well formed.
_ERRORS = (
    SerdeError, TypesysError, struct.error, ArithmeticError, AssertionError, LookupError,
    MemoryError, NameError, RecursionError, SyntaxError, TypeError, ValueError,
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
MAX_PLACES = 1 << 16
"""Numbers of a message that are looked for, at most; one with more is read by itself."""


@lru_cache(maxsize=64)
def _make_ros_parser(text: str, kind: str, encoding: str) -> Parser:
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
    except _ERRORS as error:
        raise _refuse(kind, error) from error
    locate = partial(_locate, store.fielddefs, name, encoding == "cdr")
    deserialise = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
    return Parser(lambda data: deserialise(data, name), _ERRORS, locate)


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
    _ERRORS
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


def _make_protobuf_parser(channel: Channel) -> Parser:
    """Make what reads a message by the descriptors that lie in the log.

    Raises
    ------
    LogError
        The protobuf package is not installed, or the descriptors are damaged.
    """
    try:
        from google.protobuf import descriptor_pb2, message, message_factory  # noqa: PLC0415  extra
    except ImportError:
        fix = f"install what reads it: {tell_install('foxglove')}"
        raise LogError(f"{channel.type} is written in protobuf", fix=fix) from None
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(channel.descriptors).file
        if len(files) > MAX_FILES:
            raise ValueError(f"{len(files)} files make one type")
        message_class = message_factory.GetMessages(files)[channel.type]
    except (message.DecodeError, KeyError, TypeError, ValueError) as error:
        raise _refuse(channel.type, error) from error
    return Parser(lambda data: message_class.FromString(bytes(data)), (message.DecodeError,))


def make_parser(channel: Channel) -> Parser:
    """Make what reads the messages of a channel, by the way in which they are written.

    Raises
    ------
    LogError
        Its message definition cannot be understood.
    """
    if channel.encoding == "json":
        errors = ValueError, RecursionError, MemoryError
        return Parser(lambda data: json.loads(bytes(data)), errors)
    if channel.encoding == "protobuf":
        return _make_protobuf_parser(channel)
    return _make_ros_parser(channel.definition, channel.type, channel.encoding)


_LITTLE_ENDIAN = b"\0\1"
"""What a CDR message begins with whose numbers are read so."""
_OF_ALL = ("angle_min", "angle_increment", "range_min", "range_max")
"""The numbers that are the same in all scans of a run"""


class _Finder:
    """Finds the numbers of a message that could be decoded, by the types that it is made of.

    CDR aligns each number to its size, from behind four bytes on; ROS 1 aligns none.
    """

    def __init__(self, types: Typesdict, message: memoryview, is_cdr: bool) -> None:
        self.places: dict[str, Place] = {}
        self._types, self._message, self._is_cdr = types, message, is_cdr
        self._at = 4 if is_cdr else 0

    def find(self, path: str, node: Nodetype, detail: Any) -> None:
        """Pass over a part of the message, and add the places of its numbers."""
        parts: Any = ()
        if node == Nodetype.NAME:
            parts = self._types[detail][1]
        elif node == Nodetype.BASE and detail[0] == "string":
            letters = self._read_count()
            self._at += letters
        else:
            inner, many = ((node, detail), 1) if node == Nodetype.BASE else detail
            many = self._read_count() if node == Nodetype.SEQUENCE else many
            if inner[0] == Nodetype.BASE and inner[1][0] != "string":
                self.places[path] = self._pass(inner[1][0], many)
            else:
                parts = ((index, inner) for index in range(many))
        for part, inner in parts:
            self.find(f"{path}.{part}" if path else part, *inner)
        if len(self.places) > MAX_PLACES:
            raise DamageError(f"holds more than {MAX_PLACES} numbers")

    def _pass(self, kind: str, many: int = 1) -> Place:
        number = np.dtype("uint8" if kind == "octet" else kind).newbyteorder("<")
        start = self._at
        if self._is_cdr and many:
            start += (4 - start) % number.itemsize
        self._at = start + many * number.itemsize
        return Place(start, self._at, number)

    def _read_count(self) -> int:
        start, end, _ = self._pass("uint32")
        if end > len(self._message):
            raise DamageError("ends before its numbers do")
        return int.from_bytes(self._message[start:end], "little")


def _locate(types: Typesdict, name: str, is_cdr: bool, message: memoryview) -> Mapping[str, Place]:
    if is_cdr and message[:2] != _LITTLE_ENDIAN:
        raise DamageError("is not little-endian")
    finder = _Finder(types, message, is_cdr)
    finder.find("", Nodetype.NAME, name)
    return finder.places


class Fields(NamedTuple):
    """The numbers of messages of one length, which lie where the first has its own."""

    rows: UInt8
    """(M, L) the messages, so that a number of all of them is one slice"""
    places: Mapping[str, Place]

    def find_alike(self, same: Collection[str] = ()) -> Bool:
        """Say which messages (M,) are as the first but for their numbers, save some."""
        fixed = np.ones(self.rows.shape[1], np.bool_)
        for name, place in self.places.items():
            fixed[place.start : place.end] = name in same
        rest = self.rows[:, fixed]
        return np.asarray((rest == rest[0]).all(axis=1))

    def read(self, first: str, last: str = "") -> NDArray[Any]:
        """Read a number, a list, or numbers that lie side by side, in each message (M, B).

        Raises
        ------
        DamageError
            They are not there, or not so.
        """
        start, end = self.places.get(first), self.places.get(last or first)
        if not start or not end or (end.end - start.start) % start.kind.itemsize:
            raise DamageError(f"has no numbers {first}")
        return np.require(self.rows[:, start.start : end.end].view(start.kind), None, "A")

    def read_stamps(self, name: str) -> Int64:
        """Read times (M,) in ns; raises DamageError."""
        seconds, nanoseconds = (self.read(f"{name}.{part}")[:, 0] for part in ("sec", "nanosec"))
        if max(seconds.itemsize, nanoseconds.itemsize) > 4:
            raise DamageError(f"has a {name} of another kind")
        return np.asarray(seconds.astype(np.int64) * 1_000_000_000 + nanoseconds)


def read_scan_run(
    locate: Locate, read: FromBytes[list[Scan]], rows: UInt8, record_ns: Int64
) -> tuple[list[ScanBatch], Bool]:
    """Read scans of one length that follow one another.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in all of them.
    rows, record_ns
        The messages (M, L), and when each was recorded (M,).

    Returns
    -------
    runs, left
        One run, or none where messages differ in more than times and ranges; and which messages
        (M,) are still to be read.

    Raises
    ------
    DamageError
        The first message is damaged, or its numbers cannot be found.
    """
    # Decoded first: that it could be says that all its parts lie within the message.
    (first,) = read(rows[0].data, int(record_ns[0]))
    fields = Fields(rows, locate(rows[0].data))
    left = np.full(len(rows), not fields.find_alike(_OF_ALL).all())
    if left.any():
        return [], left
    ranges = fields.read("ranges").astype(np.float32, copy=False)
    increments = fields.read("time_increment")[:, 0].astype(np.float64)
    stamps = {"stamp_ns": fields.read_stamps("header.stamp"), "record_ns": record_ns}
    return [ScanBatch.like(first, **stamps, ranges=ranges, time_increment=increments)], left
