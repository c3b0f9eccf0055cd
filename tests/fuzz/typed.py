"""Typed fuzzing: one field of one message takes a nasty value, or a type that it should not have.

A case is known by its number: it is made from that alone.
"""

import json
import random
import struct
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from occmap.errors import OccmapError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import Role, open_log
from occmap.types import Cloud, Scan
from tests.readers import foxglove_logs as foxglove
from tests.readers.clouds import CLOUD, ECHO, cloud, echoes
from tests.readers.ros import POSED, ROS1, ROS2, SCAN, SECOND, TF, header, posed, scan, transforms
from tests.readers.runs import list_fields

MESSAGES = 5
SPOILT = 2
"""Which of the messages is the nasty one."""
ALL = frozenset(range(MESSAGES))
MOST_SECONDS = 20.0
PATH = "nav_msgs/msg/Path"
DEEP = "@deep"
"""Stands in a JSON message for lists within lists."""

NUMBERS = (
    0.0, -0.0, 1.5, -1.0, np.nan, np.inf, -np.inf, 1e-45, 3.4e38, -3.4e38, 1e300, -1e308, 1e12,
)  # fmt: skip
INTEGERS = (0, 1, -1, 7, 255, 2**16, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, 2**63 - 1, -(2**63))
TEXTS = (
    "", "/", "laser", "a" * 70_000, "\x1b[31m", "x\0y", "::error::", "../../x", "ü\u2028", "{}",
)  # fmt: skip
ANYTHING: Sequence[Any] = (
    None, True, "abc", "NaN", "Infinity", "1e999", 10**400, -(10**400), 2**62, 2**63, 2**64, 1.5,
    np.nan, np.inf, 1e308, [], [[1, 2], [3, 4]], [[1], [2, 3]], [None], ["x"], [{}], {}, {"x": {}},
    [1e300, 10**400], "\ud800", DEEP, -1, 0,
)  # fmt: skip
ROS_TYPES = (
    "string", "bool", "int8", "uint64", "float64", "float32[]", "float32[3]", "string[]", "Header",
    "time", "Header[]", "float32[100000000]", "Header[1000000000]", "float32[<=2]", "string<=2",
    "float64 X=1e999\nfloat32", "Missing", "byte[]", "duration[2]",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A log in which something is wrong with the messages of one kind."""

    name: str
    encoding: str
    kind: str
    schema: bytes
    messages: Sequence[bytes]
    spoilt: frozenset[int]
    """Which messages are not as they should be; all where their definition is not."""

    @property
    def topic(self) -> str:
        return "/tf" if "ransform" in self.kind or "TF" in self.kind else "/it"

    def write(self, path: Path) -> Path:
        """Write an MCAP file with sound scans and transforms around the messages."""
        with path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start(profile="")
            forms = {"cdr": "ros2msg", "ros1": "ros1msg", "json": "jsonschema"}

            def add_channel(topic: str, encoding: str, kind: str, schema: bytes) -> int:
                number = writer.register_schema(kind, forms.get(encoding, "protobuf"), schema)
                return writer.register_channel(topic, encoding, number)

            channel = add_channel(self.topic, self.encoding, self.kind, self.schema)
            sound = add_channel("/sound", "cdr", SCAN, define(ROS2, SCAN))
            tf = add_channel("/tf_static", "cdr", TF, define(ROS2, TF))
            mount = transforms(ROS2, SECOND, [("odom", "laser", 0.5), ("odom", "lidar", 0.5)])
            writer.add_message(tf, 1, serialise(ROS2, mount, TF), 1)
            for i, data in enumerate(self.messages):
                writer.add_message(channel, i, data, i)
                at = serialise(ROS2, scan(ROS2, (100 + i) * SECOND), SCAN)
                writer.add_message(sound, i, at, i)
            writer.finish()  # type: ignore[no-untyped-call]
        return path


def define(store: Typestore, kind: str) -> bytes:
    """The definition of a type of messages, as files hold it."""
    text, _ = store.generate_msgdef(kind, ros_version=1 if store is ROS1 else 2)
    return text.encode()


def make_ros_message(store: Typestore, kind: str, index: int) -> Any:
    """A sound message."""
    stamp_ns = (100 + index) * SECOND
    if kind in POSED:
        return posed(store, kind, stamp_ns, ("map", "laser", 0.1 * index))
    makers: dict[str, Callable[[], Any]] = {
        SCAN: lambda: scan(store, stamp_ns),
        ECHO: lambda: echoes(store, [[1.0, 1.5], [3.0], [], [2.0, 4.0]]),
        CLOUD: lambda: cloud(store, [(3.0, 0.1, 0.0), (2.0, 1.0, 0.1), (0.0, -5.0, -0.1)]),
        TF: lambda: transforms(store, stamp_ns, [("map", "odom", 0.1 * index), ("odom", "b", 1.0)]),
        PATH: lambda: store.types[PATH](
            header(store, stamp_ns, "map"),
            [posed(store, POSED[0], stamp_ns, ("map", "", x)) for x in (1.0, 2.0)],
        ),
    }
    return makers[kind]()


def serialise(store: Typestore, message: Any, kind: str) -> bytes:
    write = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    return bytes(write(message, kind))


def list_leaves(value: Any) -> Iterator[tuple[Callable[[Any], None], Any]]:
    """Every value within a message, and what puts another in its place."""
    if is_dataclass(value):
        fields = {name: part for name, part in vars(value).items() if not name.startswith("_")}
        parts = [(partial(setattr, value, name), part) for name, part in fields.items()]
    elif isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        parts = [(partial(value.__setitem__, key), part) for key, part in items]
    else:
        return
    for put, part in parts:
        yield put, part
        yield from list_leaves(part)


def spoil_value(value: Any, dice: random.Random) -> Any:
    """Another value of the same type."""
    if isinstance(value, np.ndarray):
        row = np.array([dice.choice(NUMBERS) for _ in range(dice.choice((0, 1, 5, 700)))])
        with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):
            return row.astype(value.dtype)
    if isinstance(value, list):
        return value * dice.choice((0, 2, 50))
    others = {str: TEXTS, bool: (not value,), int: INTEGERS, float: NUMBERS}
    return dice.choice(others.get(type(value), (value,)))


def make_ros_value(dice: random.Random, name: str, store: Typestore, kind: str) -> Case:
    """One field takes another value of its type."""
    sound = [serialise(store, make_ros_message(store, kind, i), kind) for i in range(MESSAGES)]
    while True:
        message = deepcopy(make_ros_message(store, kind, SPOILT))
        put, value = dice.choice(list(list_leaves(message)))
        put(spoil_value(value, dice))
        try:
            with warnings.catch_warnings(action="ignore"):
                sound[SPOILT] = serialise(store, message, kind)
        except (SerdeError, struct.error, OverflowError, ValueError):  # the field cannot hold it
            continue
        if dice.random() < 0.1:  # a string that is no UTF-8
            sound[SPOILT] = sound[SPOILT].replace(b"la", b"\xff\xfe").replace(b"odom", b"od\xc3m")
        return Case(name, _encoding(store), kind, define(store, kind), sound, frozenset({SPOILT}))


def make_ros_type(dice: random.Random, name: str, store: Typestore, kind: str) -> Case:
    """One field has another type; the messages are written by that, where anybody can."""
    lines = define(store, kind).decode().splitlines()
    fields = [i for i, line in enumerate(lines) if len(line.split()) == 2 and ":" not in line]
    at = dice.choice(fields)
    field = lines[at].split()[1]
    others = [f"{other} {field}" for other in (*ROS_TYPES, kind)]
    lines[at] = dice.choice([*others, "", f"{field} x"])
    odd = "\n".join(lines) + "\n"
    sound = [serialise(store, make_ros_message(store, kind, i), kind) for i in range(MESSAGES)]
    if dice.random() < 0.7 and "0000000" not in odd and "1e999" not in odd:
        own = get_typestore(Stores.EMPTY)
        try:
            own.register(get_types_from_msg(odd, kind))
            messages = [make_blank(own, kind, dice) for _ in range(MESSAGES)]
            write = own.serialize_ros1 if store is ROS1 else own.serialize_cdr
            with warnings.catch_warnings(action="ignore"):
                sound = [bytes(write(message, kind)) for message in messages]
        except Exception:  # noqa: BLE001  rosbags cannot write it: it is read all the same
            pass
    return Case(name, _encoding(store), kind, odd.encode(), sound, ALL)


def make_blank(store: Typestore, kind: str, dice: random.Random) -> Any:
    """A message with some value in each field of its definition."""
    names = {}
    fields: Any = store.fielddefs[kind][1]
    for field, (node, detail) in fields:
        if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
            part, size = detail
            size = size if node == Nodetype.ARRAY else dice.randrange(4)
            items = [_make_part(store, part, dice) for _ in range(size)]
            plain = part[0] == Nodetype.BASE and part[1][0] != "string"
            names[field] = np.array(items, part[1][0]) if plain else items
        else:
            names[field] = _make_part(store, (node, detail), dice)
    return store.types[kind](**names)


def _make_part(store: Typestore, part: Any, dice: random.Random) -> Any:
    node, detail = part
    if node == Nodetype.NAME:
        return make_blank(store, detail, dice)
    if detail[0] == "string":
        return dice.choice(TEXTS)
    return bool(dice.randrange(2)) if detail[0] == "bool" else dice.randrange(100)


def _encoding(store: Typestore) -> str:
    return "ros1" if store is ROS1 else "cdr"


def make_foxglove_fields(kind: str, index: int) -> dict[str, Any]:
    """A sound message."""
    moved = foxglove.transform(index, "map", "odom", 0.1 * index)
    framed = {"timestamp": foxglove.stamp(index), "frame_id": "map"}
    fields = {
        "LaserScan": foxglove.scan(index, foxglove.place(0.1, 0.2)).fields,
        "FrameTransform": moved,
        "FrameTransforms": {"transforms": [moved, foxglove.transform(index, "odom", "b", 1.0)]},
        "PoseInFrame": {**framed, "pose": foxglove.place(1.0, 0.5)},
        "PosesInFrame": {**framed, "poses": [foxglove.place(1.0, 0.5)] * 2},
    }
    return deepcopy(fields[kind.partition(".")[2]])


def make_json(dice: random.Random, name: str, kind: str) -> Case:
    """One field holds anything, or is not there."""
    messages = [make_foxglove_fields(kind, i) for i in range(MESSAGES)]
    put, _ = dice.choice(list(list_leaves(messages[SPOILT])))
    put(dice.choice(ANYTHING))
    if dice.random() < 0.1:
        messages[SPOILT].pop(dice.choice(list(messages[SPOILT])))
    sound = [json.dumps(message).encode() for message in messages]
    sound[SPOILT] = sound[SPOILT].replace(b'"@deep"', b"[" * 100_000)
    if dice.random() < 0.05:
        nonsense = (b"", b"7", b"null", b"[]", b'"x"', b"{", b"\xff", b"9" * 10_000)
        sound[SPOILT] = dice.choice(nonsense)
    return Case(name, "json", kind, b"{}", sound, frozenset({SPOILT}))


def make_protobuf_value(dice: random.Random, name: str, kind: str) -> Case:
    """One field takes another value of its type, or is not there."""
    messages = [make_foxglove_fields(kind, i) for i in range(MESSAGES)]
    sound = [foxglove.encode_protobuf(kind, message) for message in messages]
    while True:
        message = deepcopy(messages[SPOILT])
        put, value = dice.choice(list(list_leaves(message)))
        put(spoil_value(value, dice) if not isinstance(value, dict) else {})
        try:
            sound[SPOILT] = foxglove.encode_protobuf(kind, message)
        except (json_format.ParseError, ValueError):
            continue
        schema = foxglove.make_descriptors().SerializeToString()
        return Case(name, "protobuf", kind, schema, sound, frozenset({SPOILT}))


def make_protobuf_type(dice: random.Random, name: str, kind: str) -> Case:
    """One field has another type, is a list, or is not there; so it is in the messages, or not."""
    files = foxglove.make_descriptors()
    described = dice.choice([message for file in files.file for message in file.message_type])
    field = dice.choice(described.field)
    change = dice.randrange(4)
    if change == 0:
        field.label = FieldDescriptorProto.LABEL_REPEATED
    elif change == 1:
        described.field.remove(field)
    elif change == 2:
        field.type = FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".foxglove.{dice.choice(list(foxglove.SCHEMA))}"
    else:
        other = dice.choice(("STRING", "BYTES", "BOOL", "INT64", "UINT64", "FLOAT", "SINT32"))
        field.type = FieldDescriptorProto.Type.Value(f"TYPE_{other}")
        field.ClearField("type_name")
    sound = [foxglove.encode_protobuf(kind, make_foxglove_fields(kind, i)) for i in range(MESSAGES)]
    with suppress(TypeError):  # the types do not fit together: sound messages lie under them
        if dice.random() < 0.5:
            sound = [_fill(files, kind, dice) for _ in range(MESSAGES)]
    schema = files.SerializeToString()
    return Case(name, "protobuf", kind, schema, sound, ALL)


def _fill(files: descriptor_pb2.FileDescriptorSet, kind: str, dice: random.Random) -> bytes:
    """A message with a value in each field that takes one."""
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(files.file):
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(kind))()
    _fill_fields(message, dice, 4)
    data: bytes = message.SerializeToString()
    return data


def _fill_fields(message: Any, dice: random.Random, depth: int) -> None:
    for field in message.DESCRIPTOR.fields:
        if field.message_type is not None:
            if depth:
                part = getattr(message, field.name)
                _fill_fields(part.add() if field.is_repeated else part, dice, depth - 1)
            continue
        for value in (dice.choice(NUMBERS), dice.choice(INTEGERS), "text", b"bytes", True):
            try:
                if field.is_repeated:
                    getattr(message, field.name).append(value)
                else:
                    setattr(message, field.name, value)
            except (TypeError, ValueError):
                continue


ROS_KINDS = (SCAN, ECHO, CLOUD, TF, *POSED, PATH)
FOXGLOVE_KINDS = tuple(
    f"foxglove.{name}"
    for name in ("LaserScan", "FrameTransform", "FrameTransforms", "PoseInFrame", "PosesInFrame")
)
MAKERS: Mapping[str, Callable[[random.Random, str, str], Case]] = {
    "cdr value": lambda dice, name, kind: make_ros_value(dice, name, ROS2, kind),
    "ros1 value": lambda dice, name, kind: make_ros_value(dice, name, ROS1, kind),
    "cdr type": lambda dice, name, kind: make_ros_type(dice, name, ROS2, kind),
    "ros1 type": lambda dice, name, kind: make_ros_type(dice, name, ROS1, kind),
    "json": make_json,
    "protobuf value": make_protobuf_value,
    "protobuf type": make_protobuf_type,
}
PAIRS = [
    (maker, kind)
    for maker in MAKERS
    for kind in (ROS_KINDS if maker.startswith(("cdr", "ros1")) else FOXGLOVE_KINDS)
]


def make_case(number: int) -> Case:
    """Each way of spoiling each kind of message, in turn."""
    maker, kind = PAIRS[number % len(PAIRS)]
    return MAKERS[maker](random.Random(number), f"{number}: {maker} {kind}", kind)


def run_case(case: Case, folder: Path) -> str:
    """Read and build the log of a case, and say how it ended.

    Raises
    ------
    AssertionError
        A sound message was lost, one was lost without a note, or it took too long.
    """
    path = case.write(folder / "case.mcap")
    start = time.monotonic()
    log = open_log(path)
    topics = [stream.topic for stream in log.streams if stream.role in {Role.SCAN, Role.CLOUD}]
    scans: list[Scan | Cloud] = [*log.scans(topics), *log.clouds(topics)]
    poses = list(log.poses())
    by_topic = {topic: [one for one in scans if one.topic == topic] for topic in topics}
    damaged = any(note.damage for note in log.notes)
    assert len(by_topic["/sound"]) == MESSAGES, case.name
    if case.topic in by_topic:
        check_scans(case, by_topic[case.topic], damaged)
    elif not damaged and len(case.spoilt) == 1:
        assert {one.record_ns for one in poses} >= set(range(MESSAGES)) - case.spoilt, case.name
    try:
        build([path], BuildOptions(resolution=0.5, max_cells=1_000_000, jobs=1))
        end = "built"
    except OccmapError:
        end = "refused"
    assert time.monotonic() - start < MOST_SECONDS, case.name
    return f"{end}, {'noted' if damaged else 'no note'}"


def check_scans(case: Case, scans: Sequence[Scan | Cloud], damaged: bool) -> None:
    """See that what is not spoilt is read as it was written, and that no other is lost unsaid."""
    assert len(scans) == MESSAGES or damaged, case.name
    if len(case.spoilt) == 1:
        others = [one._replace(stamp_ns=0, record_ns=0) for one in scans]
        rows = [
            list_fields([one])[0] for i, one in enumerate(others) if scans[i].record_ns != SPOILT
        ]
        assert len(rows) == MESSAGES - 1, case.name
        assert "foxglove" in case.kind or all(row == rows[0] for row in rows), case.name
