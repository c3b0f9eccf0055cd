"""Logs of Foxglove's schemas in MCAP, as JSON and as protobuf."""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2 as pb2
from google.protobuf import descriptor_pool, json_format, message_factory, timestamp_pb2

from tests.readers.ros import Encoded, write_encoded

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
    definition = "jsonschema", b"{}"
    return _write(path, log, "json", definition, lambda _, fields: json.dumps(fields).encode())


def write_protobuf(path: Path, log: Sequence[Message]) -> Path:
    definition = "protobuf", make_descriptors().SerializeToString()
    return _write(path, log, "protobuf", definition, encode_protobuf)


WRITERS = {"json": write_json, "protobuf": write_protobuf}


def _write(
    path: Path,
    log: Sequence[Message],
    encoding: str,
    definition: tuple[str, bytes],
    encode: Callable[[str, dict[str, Any]], bytes],
) -> Path:
    encoded = [
        Encoded(topic, record_ns, encode(schema, fields), encoding, (schema, *definition))
        for topic, schema, record_ns, fields in log
    ]
    return write_encoded(path, encoded)


# Every message of the schemas: its fields, each of a number type, another message, or a list.
SCHEMA = {
    "Vector3": {"x": "double", "y": "double", "z": "double"},
    "Quaternion": {"x": "double", "y": "double", "z": "double", "w": "double"},
    "Pose": {"position": "Vector3", "orientation": "Quaternion"},
    "LaserScan": {"timestamp": "Timestamp", "frame_id": "string", "pose": "Pose",
        "start_angle": "double", "end_angle": "double", "ranges": "double*",
        "intensities": "double*"},
    "FrameTransform": {"timestamp": "Timestamp", "parent_frame_id": "string",
        "child_frame_id": "string", "translation": "Vector3", "rotation": "Quaternion"},
    "FrameTransforms": {"transforms": "FrameTransform*"},
    "PoseInFrame": {"timestamp": "Timestamp", "frame_id": "string", "pose": "Pose"},
    "PosesInFrame": {"timestamp": "Timestamp", "frame_id": "string", "poses": "Pose*"},
}  # fmt: skip


def make_descriptors() -> pb2.FileDescriptorSet:
    """The schemas, their file before that of the times that it needs."""
    file = pb2.FileDescriptorProto(name="foxglove/all.proto", package="foxglove", syntax="proto3")
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    for message, fields in SCHEMA.items():
        described = file.message_type.add(name=message)
        for number, (name, text) in enumerate(fields.items(), start=1):
            kind = text.rstrip("*")
            field = described.field.add(name=name, number=number)
            field.label = field.LABEL_REPEATED if kind != text else field.LABEL_OPTIONAL
            if kind in SCHEMA or kind == "Timestamp":
                package = "foxglove" if kind in SCHEMA else "google.protobuf"
                field.type, field.type_name = field.TYPE_MESSAGE, f".{package}.{kind}"
            else:
                field.type = pb2.FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    time = pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    return pb2.FileDescriptorSet(file=[file, time])


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
