"""Foxglove's schemas in MCAP, as JSON and as protobuf."""

import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from mcap.writer import Writer

from occmap.errors import LogError
from occmap.pipeline import BuildOptions, build
from occmap.readers import Log, Role, open_log
from occmap.readers.foxglove import POSE_SCHEMAS, SCAN_SCHEMAS, find_foxglove_role
from occmap.types import Pose, PoseSample

SECOND = 10**9
NO_POSE: dict[str, Any] = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}


class Message(NamedTuple):
    topic: str
    schema: str
    record_ns: int
    fields: dict[str, Any]


def stamp(index: int) -> dict[str, int]:
    return {"sec": 100 + index, "nsec": 5}


def place(x: float, yaw: float) -> dict[str, Any]:
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": {"x": x, "y": 2.0, "z": 0.0}, "orientation": orientation}


def scan(index: int, pose: dict[str, Any] | None = None) -> Message:
    fields = {
        "timestamp": stamp(index),
        "frame_id": "/laser",
        "pose": pose or NO_POSE,
        "start_angle": -1.0,
        "end_angle": 1.0,
        "ranges": [1.0, 2.5, 3.0, 4.0, 5.0 + index],
        "intensities": [],
    }
    return Message("/scan", "foxglove.LaserScan", (100 + index) * SECOND, fields)


def transform(index: int, parent: str, child: str, x: float) -> dict[str, Any]:
    where = place(x, 0.5)
    return {
        "timestamp": stamp(index),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": where["position"],
        "rotation": where["orientation"],
    }


def drive() -> list[Message]:
    mount = transform(0, "base", "laser", 0.25)
    log = [Message("/mount", "foxglove.FrameTransform", 100 * SECOND, mount)]
    for index in range(5):
        moved = {"transforms": [transform(index, "odom", "base", 0.5 * index)]}
        log += [
            Message("/tf", "foxglove.FrameTransforms", (100 + index) * SECOND, moved),
            scan(index),
        ]
    return log


def write_json(path: Path, log: Sequence[Message]) -> Path:
    return _write(path, log, lambda _, fields: json.dumps(fields).encode(), "json")


def write_protobuf(path: Path, log: Sequence[Message]) -> Path:
    return _write(path, log, encode_protobuf, "protobuf")


WRITERS = {"json": write_json, "protobuf": write_protobuf}
each_wire = pytest.mark.parametrize("write", WRITERS.values(), ids=list(WRITERS))


def _write(
    path: Path,
    log: Sequence[Message],
    encode: Callable[[str, dict[str, Any]], bytes],
    wire: str,
) -> Path:
    schema_data = b"{}" if wire == "json" else b"".join([make_descriptors().SerializeToString()])
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, schema, record_ns, fields in log:
            if topic not in channels:
                kind = "jsonschema" if wire == "json" else "protobuf"
                schema_id = writer.register_schema(schema, kind, schema_data)
                channels[topic] = writer.register_channel(topic, wire, schema_id)
            writer.add_message(channels[topic], record_ns, encode(schema, fields), record_ns)
        writer.finish()  # type: ignore[no-untyped-call]  # the library's gap
    return path


# Every message of the schemas: its fields, each of a number type, another message, or a list.
SCHEMA = {
    "Vector3": {"x": "double", "y": "double", "z": "double"},
    "Quaternion": {"x": "double", "y": "double", "z": "double", "w": "double"},
    "Pose": {"position": "Vector3", "orientation": "Quaternion"},
    "LaserScan": {
        "timestamp": "Timestamp",
        "frame_id": "string",
        "pose": "Pose",
        "start_angle": "double",
        "end_angle": "double",
        "ranges": "double*",
        "intensities": "double*",
    },
    "FrameTransform": {
        "timestamp": "Timestamp",
        "parent_frame_id": "string",
        "child_frame_id": "string",
        "translation": "Vector3",
        "rotation": "Quaternion",
    },
    "FrameTransforms": {"transforms": "FrameTransform*"},
    "PoseInFrame": {"timestamp": "Timestamp", "frame_id": "string", "pose": "Pose"},
    "PosesInFrame": {"timestamp": "Timestamp", "frame_id": "string", "poses": "Pose*"},
}


def make_descriptors() -> descriptor_pb2.FileDescriptorSet:
    """The schemas, their file before that of the times that it needs."""
    time = FileDescriptorProto(
        name="google/protobuf/timestamp.proto", package="google.protobuf", syntax="proto3"
    )
    stamp_type = time.message_type.add(name="Timestamp")
    for number, (name, kind) in enumerate((("seconds", "INT64"), ("nanos", "INT32")), start=1):
        _add_field(stamp_type, name, number, kind)
    file = FileDescriptorProto(name="foxglove/all.proto", package="foxglove", syntax="proto3")
    file.dependency.append(time.name)
    for message, fields in SCHEMA.items():
        described = file.message_type.add(name=message)
        for number, (name, text) in enumerate(fields.items(), start=1):
            field = _add_field(described, name, number, text.rstrip("*"))
            if text.endswith("*"):
                field.label = FieldDescriptorProto.LABEL_REPEATED
    return descriptor_pb2.FileDescriptorSet(file=[file, time])


def _add_field(
    message: descriptor_pb2.DescriptorProto, name: str, number: int, kind: str
) -> FieldDescriptorProto:
    field = message.field.add(name=name, number=number)
    field.label = FieldDescriptorProto.LABEL_OPTIONAL
    if kind in SCHEMA or kind == "Timestamp":
        package = "google.protobuf" if kind == "Timestamp" else "foxglove"
        field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{package}.{kind}"
    else:
        field.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    return field


def encode_protobuf(schema: str, fields: dict[str, Any]) -> bytes:
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(make_descriptors().file):
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))()
    text = json.dumps(fields)
    for index in range(9):  # protobuf's JSON writes a time as text
        text = text.replace(json.dumps(stamp(index)), f'"1970-01-01T00:01:4{index}.000000005Z"')
    encoded: bytes = json_format.Parse(text, message).SerializeToString()
    return encoded


def read(log: Log) -> tuple[list[Any], list[PoseSample]]:
    return list(log.scans({"/scan"})), list(log.poses())


@each_wire
def test_scans_and_transforms(write: Callable[..., Path], tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "drive.mcap", drive()))
    scans, poses = read(log)

    assert {(s.topic, s.count, s.role) for s in log.streams} == {
        ("/mount", 1, Role.POSE), ("/tf", 5, Role.POSE), ("/scan", 5, Role.SCAN),
    }  # fmt: skip
    assert [s.stamp_ns for s in scans] == [(100 + k) * SECOND + 5 for k in range(5)]
    np.testing.assert_array_equal(scans[2].ranges, np.array([1, 2.5, 3, 4, 7], np.float32))
    assert scans[2]._replace(ranges=scans[0].ranges) == scans[2]._replace(
        ranges=scans[0].ranges, frame="laser", angle_min=-1.0, angle_increment=0.5,
        range_min=0.0, range_max=math.inf, record_ns=102 * SECOND,
    )  # fmt: skip
    turn = Pose.planar(0.25, 2.0, 0.5)
    assert poses[0] == PoseSample(
        100 * SECOND + 5, "base", "laser", turn, topic="/mount", record_ns=100 * SECOND
    )
    assert [p.pose.x for p in poses[1:]] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert log.notes == []


@each_wire
def test_a_log_builds_to_the_same_map(write: Callable[..., Path], tmp_path: Path) -> None:
    built = build([write(tmp_path / "drive.mcap", drive())], BuildOptions(resolution=0.5))

    assert built.report.scans_used == 5
    expected = build([write_json(tmp_path / "j.mcap", drive())], BuildOptions(resolution=0.5))
    np.testing.assert_array_equal(built.map.log_odds, expected.map.log_odds)


@each_wire
def test_a_scan_that_states_its_origin_has_a_frame_of_its_own(
    write: Callable[..., Path], tmp_path: Path
) -> None:
    scans = [scan(index, place(0.5 * index, 0.1 * index)) for index in range(4)]
    log = open_log(write(tmp_path / "posed.mcap", scans))
    found, poses = read(log)

    assert {s.frame for s in found} == {"laser:scan"}
    assert [(p.parent, p.child) for p in poses] == [("laser", "laser:scan")] * 4
    assert poses[2].pose == Pose.planar(1.0, 2.0, 0.2)
    built = build([log.path], BuildOptions(resolution=0.5))
    assert built.report.scans_used == 4


@each_wire
def test_poses_in_a_frame(write: Callable[..., Path], tmp_path: Path) -> None:
    pose = {"timestamp": stamp(1), "frame_id": "map", "pose": place(1.0, 0.5)}
    poses = {"timestamp": stamp(2), "frame_id": "map", "poses": [place(1.0, 0.5), place(2, 0.5)]}
    path = write(
        tmp_path / "poses.mcap",
        [
            Message("/pose", "foxglove.PoseInFrame", 1, pose),
            Message("/path", "foxglove.PosesInFrame", 2, poses),
        ],
    )
    found = [(p.stamp_ns, p.parent, p.child, p.pose.x) for p in open_log(path).poses()]

    first, second = 101 * SECOND + 5, 102 * SECOND + 5
    assert found == [(first, "map", "", 1.0), (second, "map", "", 1.0), (second, "map", "", 2.0)]


def test_ranges_that_json_cannot_write(tmp_path: Path) -> None:
    message = scan(0)
    message.fields["ranges"] = [None, "Infinity", "NaN", math.inf, 1.5, 1e300]
    ((found,), _) = read(open_log(write_json(tmp_path / "odd.mcap", [message])))

    np.testing.assert_array_equal(found.ranges, [np.nan, np.inf, np.nan, np.inf, 1.5, np.inf])


def test_messages_that_are_not_what_they_claim_are_counted(tmp_path: Path) -> None:
    log = [scan(0), scan(1), Message("/scan", "foxglove.LaserScan", 1, {"ranges": "none"})]
    found = open_log(write_json(tmp_path / "bad.mcap", log))

    assert len(read(found)[0]) == 2
    assert "1 of 3 messages on /scan are damaged" in found.notes[0].text


def test_without_protobuf_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_protobuf(tmp_path / "drive.mcap", drive())
    monkeypatch.setitem(sys.modules, "google.protobuf.message", None)
    log = open_log(path)

    assert read(log) == ([], [])
    assert any("pip install 'occmap[foxglove]'" in note.text for note in log.notes)
    with pytest.raises(LogError):
        build([path], BuildOptions())


def test_descriptors_that_are_damaged_are_noted(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "drive.mcap", drive())
    source = open_log(path)
    assert len(read(source)[0]) == 5
    schemas = {stream.type for stream in source.streams}
    assert schemas <= {*SCAN_SCHEMAS, *POSE_SCHEMAS}
    assert find_foxglove_role("foxglove.Log") is Role.OTHER
