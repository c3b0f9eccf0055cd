import struct
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from occmap.errors import LogError
from occmap.readers import NoteList, Role, Stream, open_log, probe_path
from occmap.readers.mcap import McapReader, McapSource
from occmap.readers.records import Record, RecordSource
from tests.fuzz.__main__ import alarm
from tests.readers import ros
from tests.readers.mcap_variants import list_records
from tests.readers.ros import RANGES, ROS2, SCAN, Written, drive, scan, write_mcap


def test_mcap_is_recognised_by_content(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "no_suffix", drive(ROS2))

    assert McapReader().recognises(probe_path(path))


def test_few_messages_of_a_chunk_do_not_keep_it(tmp_path: Path) -> None:
    large = scan(ROS2, 2, ranges=RANGES.repeat(1000))
    log = [Written("/few", 1, scan(ROS2, 1)), Written("/most", 2, large)]
    source = McapSource(write_mcap(tmp_path / "drive.mcap", log))
    few, most = sorted(source.channels, key=lambda channel: channel.topic)

    ((_, _, data),) = source.messages({few})
    ((_, _, view),) = source.messages({most})

    assert isinstance(data, bytes)
    assert isinstance(view, memoryview)


def test_a_cut_zstd_chunk_gives_what_can_be_decompressed(tmp_path: Path) -> None:
    log = [Written("/scan", k, scan(ROS2, k, ranges=RANGES.repeat(400) + k)) for k in range(200)]
    path = write_mcap(tmp_path / "drive.mcap", log, options={"chunk_size": 1 << 30})
    data = path.read_bytes()
    ((position, length),) = list_records(data, Opcode.CHUNK)
    path.write_bytes(data[: position + length * 3 // 4])

    cut = open_log(path)
    scans = list(cut.scans({"/scan"}))

    assert [scan.stamp_ns for scan in scans] == list(range(len(scans)))
    assert 100 < len(scans) < 200
    (note,) = cut.notes  # not also that the chunk is damaged, nor that it breaks off
    assert note.text.startswith("the file ends in the middle of the record at byte ")


def test_a_record_time_beyond_64_bits_is_the_latest_there_is(tmp_path: Path) -> None:
    log = drive(ROS2)
    path = write_mcap(tmp_path / "drive.mcap", log)
    recorded = [written.record_ns for written in log if written.topic == "/scan"]
    path.write_bytes(path.read_bytes().replace(struct.pack("<Q", recorded[-1]), b"\xff" * 8))

    found = [scan.record_ns for scan in open_log(path).scans({"/scan"})]

    assert found == [*recorded[:-1], 2**63 - 1]


def test_a_file_of_nothing_but_its_magic_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")

    with pytest.raises(LogError, match=r"nothing in it can be read: .*cut before its end"):
        open_log(path)


def test_messages_of_no_known_kind_are_listed_and_not_read(tmp_path: Path) -> None:
    kinds = {
        "/log": ("foxglove.Log", "jsonschema", b"{}"),
        # The name alone is not enough: these bytes are not CDR.
        "/other": (SCAN, "jsonschema", b"{}"),
        "/bare": None,
    }
    messages = [ros.Encoded(topic, 1, b"{}", "json", schema) for topic, schema in kinds.items()]

    log = open_log(ros.write_encoded(tmp_path / "foxglove.mcap", messages))

    assert set(log.streams) == {
        Stream("/log", "foxglove.Log", 1, Role.OTHER),
        Stream("/other", SCAN, 1, Role.OTHER),
        Stream("/bare", "", 1, Role.OTHER),
    }
    assert list(log.poses()) == []


SEPARATOR = "=" * 80 + "\n"
IDL = (
    f"{SEPARATOR}IDL: geometry_msgs/msg/PoseStamped\n"
    "module geometry_msgs { module msg { struct PoseStamped {"
    " std_msgs::msg::Header header; geometry_msgs::msg::Pose pose; }; }; };\n"
    f"{SEPARATOR}IDL: geometry_msgs/msg/Pose\n"
    "module geometry_msgs { module msg {"
    " struct Point { double x; double y; double z; };"
    " struct Quaternion { double x; double y; double z; double w; };"
    " struct Pose { geometry_msgs::msg::Point position;"
    " geometry_msgs::msg::Quaternion orientation; }; }; };\n"
    f"{SEPARATOR}IDL: std_msgs/msg/Header\n"
    "module builtin_interfaces { module msg {"
    " struct Time { int32 sec; uint32 nanosec; }; }; };\n"
    "module std_msgs { module msg { struct Header {"
    " builtin_interfaces::msg::Time stamp; string frame_id; }; }; };\n"
)


@pytest.mark.parametrize(
    "definition",
    [
        IDL,
        "module a { const long X = 1 << 30000000000; };",
        "module a { const long X = " + "(" * 200 + "1" + ")" * 200 + "; };",
        "module a { " * 400 + "const long X = 1;" + " };" * 400,
    ],
    ids=["sound", "shift", "brackets", "modules"],
)
def test_messages_in_idl_are_read_as_ros_defines_them(definition: str, tmp_path: Path) -> None:
    message = ros.posed(ROS2, ros.POSED[0], 3_000_000_004, ("/map", "", 1.0))
    schema = ros.POSED[0], "ros2idl", definition.encode()
    encoded = ros.encode(Written("/pose", 1, message))._replace(schema=schema)
    path = ros.write_encoded(tmp_path / "idl.mcap", [encoded])

    with alarm(5):
        (sample,) = open_log(path).poses()

    assert sample.stamp_ns == 3_000_000_004
    assert (sample.parent, sample.pose) == ("map", (1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0))


@given(st.lists(st.tuples(st.integers(0, 3), st.binary(max_size=9)), max_size=6), st.data())
def test_messages_of_a_chunk_are_listed_as_one_by_one(
    messages: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    block = bytearray(b"")
    for key, text in messages:
        block += struct.pack("<BQHIQQ", 5, 22 + len(text), key, 7, 2**64 - 1 - key, 8) + text
    if block and data.draw(st.booleans()):
        block[data.draw(st.integers(0, len(block) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    source = McapSource.__new__(McapSource)
    source.notes, source._cut_at, source._times = NoteList(), -1, {}

    def list_messages(found: Iterable[Record]) -> list[Record]:
        return [record for record in found if record[0] >= 0]

    expected = list_messages(RecordSource._list_records(source, 0, memoryview(block)))
    damage = list(source.notes)

    assert list_messages(source._list_records(0, memoryview(block))) == expected
    assert list(source.notes) == damage
