"""Definitions of messages that are hostile, odd or damaged: noted, in bounded time and memory."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from occmap.readers.containers import Channel
from occmap.readers.messages import make_parser
from occmap.readers.ros_log import RosLog
from tests.fuzz.__main__ import alarm
from tests.readers.foxglove_logs import encode_protobuf, make_descriptors
from tests.readers.foxglove_logs import scan as foxglove_scan
from tests.readers.ros import RANGES, ROS2, SCAN, Memory, header, scan, serialise
from tests.readers.runs import bounded_memory, count_scans
from tests.samples import SAMPLE_LOGS

TEXT = ROS2.generate_msgdef(SCAN, ros_version=2)[0]
MESSAGE = serialise(scan(ROS2, 5))
PART = "=" * 80 + "\nMSG: sensor_msgs/"


@contextmanager
def bounded() -> Iterator[None]:
    make_parser(Channel("/warm", SCAN, "cdr"))  # loads rosbags' own types
    with alarm(5), bounded_memory():
        yield


def read(definition: str, data: bytes = MESSAGE, encoding: str = "cdr") -> RosLog:
    channel = Channel("/scan", SCAN, encoding, definition, 1)
    return RosLog(Memory([(channel, 7, data)]))


def test_constants_that_no_code_can_hold_are_of_no_matter() -> None:
    log = read("float64 X=1e999\nfloat64 Y=-1e999\nint64 Z=0x" + "f" * 9000 + "\n" + TEXT)

    (found,) = log.scans({"/scan"})

    np.testing.assert_array_equal(found.ranges, RANGES)
    assert log.notes == []


def make_types(count: int, fields: str) -> str:
    """Types A0, A1, ... of which each is made of the next."""
    return "".join(f"{PART}A{i}\n{fields.format(i + 1)}" for i in range(count))


HOSTILE = {
    "itself": "LaserScan again\n" + TEXT,
    "loop": "A0 x\n" + TEXT + f"{PART}A0\nA1 x\n{PART}A1\nA0[] x\n",
    "doubling": "A0 x\n" + TEXT + make_types(60, "A{0} x\nA{0} y\n"),
    "nothing": "A0[0] x\n" + TEXT + make_types(60, "A{0}[0] x\nA{0}[0] y\n"),
    "empty": "A0[] x\n" + TEXT + f"{PART}A0\n",
    "missing": "Missing x\n" + TEXT,
    "headers": "Header[1000000000] x\n" + TEXT,
    "strings": "string[100000000] x\n" + TEXT,
    "digits": f"float32[{'9' * 5000}] x\n" + TEXT,
    "path": "a/" * 15_000 + "A x\n" + TEXT,
    "long": "byte x\n" * 1_000_000 + TEXT,
    "zero": "\0",
    "brackets": "(" * 5000,
}


@pytest.mark.parametrize("hostile", HOSTILE.values(), ids=list(HOSTILE))
def test_a_definition_that_asks_too_much_is_noted_and_the_standard_one_used(hostile: str) -> None:
    log = read(hostile)
    with bounded():
        (found,) = log.scans({"/scan"})

    np.testing.assert_array_equal(found.ranges, RANGES)
    text = f"the definition of {SCAN} on /scan is damaged; the standard one is used"
    assert [note.text for note in log.notes] == [text]


def read_own(fields: str, **values: Any) -> RosLog:
    """Read a scan of a type of its own, which has other fields in the place of `angle_min`."""
    text = TEXT.replace("float32 angle_min\n", fields)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, SCAN))
    message = SimpleNamespace(**vars(scan(ROS2, 1_000_000_002)) | values)
    return read(text, bytes(store.serialize_cdr(message, SCAN)))


def test_a_definition_of_its_own_is_followed() -> None:
    log = read_own("uint8 mode\nfloat64 angle_min\n", mode=3, angle_min=-1.25)
    (found,) = log.scans({"/scan"})

    assert (found.stamp_ns, found.frame, found.angle_min) == (1_000_000_002, "laser", -1.25)
    np.testing.assert_array_equal(found.ranges, RANGES)
    assert log.notes == []


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("string", "1.5"),
        ("float32[]", np.ones(2, np.float32)),
        ("bool", True),
        ("string[]", ["1.5"]),
        ("Header", header(ROS2, 5, "laser")),
    ],
)
def test_a_field_of_another_type_is_damage_of_the_message(kind: str, value: Any) -> None:
    log = read_own(f"{kind} angle_min\n", angle_min=value)

    assert list(log.scans({"/scan"})) == []
    (note,) = log.notes
    assert note.text.startswith("1 of 1 messages on /scan are damaged and not used: the first ")


def make_chain(length: int, last: str = "") -> FileDescriptorSet:
    """Foxglove's schemas, above files that each need the next, and the last one another."""
    files = make_descriptors()
    files.file[0].dependency.append("f0")
    needed = [*(f"f{i + 1}" for i in range(length - 1)), last]
    for i, name in enumerate(needed):
        files.file.add(name=f"f{i}", syntax="proto3", dependency=[name] if name else [])
    return files


def read_protobuf(files: FileDescriptorSet) -> tuple[int, list[str]]:
    """Read a scan that is defined by these files: how many are found, and what is noted."""
    kind = "foxglove.LaserScan"
    channel = Channel("/scan", kind, "protobuf", count=1, descriptors=files.SerializeToString())
    log = RosLog(Memory([(channel, 7, encode_protobuf(kind, foxglove_scan(0).fields))]))
    with bounded():
        return count_scans(log), [note.text for note in log.notes]


def test_a_long_chain_of_protobuf_files_is_followed() -> None:
    assert read_protobuf(make_chain(450)) == (1, [])


@pytest.mark.parametrize(("length", "last"), [(600, ""), (30_000, ""), (3, "f0")])
def test_protobuf_files_in_a_chain_beyond_reason_or_in_a_circle_are_noted(
    length: int, last: str
) -> None:
    found, (note, *_) = read_protobuf(make_chain(length, last))
    assert found == 0
    assert "the definition of foxglove.LaserScan cannot be understood" in note


LOADED = """
import sys
from pathlib import Path
from occmap.readers import open_log
log = open_log(Path(sys.argv[1]))
assert list(log.stacked_poses()) and list(log.stacked_scans([s.topic for s in log.streams]))
print([name for name in sys.modules if name.startswith("rosbags.typesys.stores.ros")])
"""


@pytest.mark.parametrize("name", ["drive.mcap", "drive.bag"])
def test_a_log_that_defines_its_types_as_ros_does_needs_no_other_types(name: str) -> None:
    command = [sys.executable, "-c", LOADED, str(SAMPLE_LOGS / name)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
