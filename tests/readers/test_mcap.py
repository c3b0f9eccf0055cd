import struct
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from occmap.errors import LogError
from occmap.readers import Note, Role, Stream, open_log, probe_path
from occmap.readers.mcap import McapReader
from tests.fuzz.__main__ import alarm
from tests.readers.ros import RANGES, ROS2, SCAN, Written, drive, scan, write_mcap
from tests.readers.runs import count_scans

NONE = {"compression": CompressionType.NONE, "chunk_size": 1000}
ZSTD = {"compression": CompressionType.ZSTD, "chunk_size": 1000}
_HEAD = 9
_CHUNK_HEAD = 32
"""Of a chunk record, up to the name of its compression."""


def find_chunks(data: bytes | bytearray) -> list[tuple[int, int]]:
    """Position and length of each chunk record, its head included."""
    found, position = [], 8
    while data[position] not in {2, 15}:
        opcode, length = struct.unpack_from("<BQ", data, position)
        if opcode == 6:
            found.append((position, _HEAD + length))
        position += _HEAD + length
    return found


def test_mcap_is_recognised_by_content(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "no_suffix", drive(ROS2))

    assert McapReader().recognises(probe_path(path))


def test_what_lies_before_a_cut_is_read(tmp_path: Path) -> None:
    data = write_mcap(tmp_path / "drive.mcap", drive(ROS2), options=NONE).read_bytes()
    path = tmp_path / "cut.mcap"
    ends = [data.find((RANGES + k).tobytes()) + 4 * 5 + 4 + 4 * 3 for k in range(6)]
    for cut in range(ends[0], len(data), 97):
        path.write_bytes(data[:cut])
        log = open_log(path)
        assert count_scans(log) == sum(end <= cut for end in ends), cut
        assert all(note.damage for note in log.notes)


@pytest.mark.parametrize("options", [NONE, ZSTD])
def test_a_cut_chunk_is_told_from_a_damaged_one(options: dict[str, object], tmp_path: Path) -> None:
    """Its length stands in its head and again in its body: nothing else can follow."""
    path = write_mcap(tmp_path / "drive.mcap", drive(ROS2), options=options)
    data = path.read_bytes()
    position, length = find_chunks(data)[-1]
    path.write_bytes(data[: position + length - 20])

    cut = [note for note in open_log(path).notes if "chunk at byte" not in note.text]

    there = f"{length - 20:,} of its {length:,} bytes are there"
    assert cut == [
        Note(f"the file ends in the middle of the record at byte {position}: {there}", damage=True)
    ]


def test_a_file_without_footer_says_so(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "drive.mcap", drive(ROS2), options=NONE)
    data = path.read_bytes()
    position, length = find_chunks(data)[-1]
    path.write_bytes(data[: position + length])

    log = open_log(path)

    assert count_scans(log) == 6
    (note,) = log.notes
    assert note.damage
    assert "the file is cut before its end" in note.text


def test_a_cut_zstd_chunk_gives_what_can_be_decompressed(tmp_path: Path) -> None:
    log = [Written("/scan", k, scan(ROS2, k, ranges=RANGES.repeat(400) + k)) for k in range(200)]
    path = write_mcap(tmp_path / "drive.mcap", log, options={"chunk_size": 1 << 30})
    data = path.read_bytes()
    ((position, length),) = find_chunks(data)
    path.write_bytes(data[: position + length * 3 // 4])

    cut = open_log(path)
    scans = list(cut.scans({"/scan"}))

    assert [scan.stamp_ns for scan in scans] == list(range(len(scans)))
    assert 100 < len(scans) < 200
    (note,) = cut.notes  # not also that the chunk is damaged, nor that it breaks off
    assert note.text.startswith("the file ends in the middle of the record at byte ")


def test_a_record_time_beyond_64_bits_is_the_latest_there_is(tmp_path: Path) -> None:
    log = drive(ROS2)
    path = write_mcap(tmp_path / "drive.mcap", log, options=NONE)
    recorded = [written.record_ns for written in log if written.topic == "/scan"]
    path.write_bytes(path.read_bytes().replace(struct.pack("<Q", recorded[-1]), b"\xff" * 8))

    found = [scan.record_ns for scan in open_log(path).scans({"/scan"})]

    assert found == [*recorded[:-1], 2**63 - 1]


def test_a_wrong_checksum_is_noted_once_and_the_messages_used(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "drive.mcap", drive(ROS2), options=NONE)
    data = bytearray(path.read_bytes())
    data[data.find((RANGES + 3).tobytes()) + 2] ^= 1
    path.write_bytes(data)

    log = open_log(path)

    assert count_scans(log) == count_scans(log) == 6
    (note,) = log.notes
    assert "wrong checksum" in note.text
    assert note.damage


@pytest.mark.parametrize("announced", [1000, 1 << 40])
def test_a_zstd_bomb_gives_no_more_than_it_announces(announced: int, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "drive.mcap", drive(ROS2), options=ZSTD)
    data = path.read_bytes()
    position, length = find_chunks(data)[-1]
    bomb = zstandard.compress(bytes(50_000_000))
    chunk = bytearray(data[position + _HEAD : position + _HEAD + _CHUNK_HEAD + 4])
    struct.pack_into("<Q", chunk, 16, announced)
    body = bytes(chunk) + struct.pack("<Q", len(bomb)) + bomb
    path.write_bytes(
        data[:position] + struct.pack("<BQ", 6, len(body)) + body + data[position + length :]
    )

    log = open_log(path)

    assert 0 < count_scans(log) < 6
    assert f"the chunk at byte {position}" in log.notes[0].text


def test_a_file_of_nothing_but_its_magic_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")

    with pytest.raises(LogError, match=r"empty\.mcap: holds nothing behind"):
        open_log(path)


def test_messages_of_no_known_kind_are_listed_and_not_read(tmp_path: Path) -> None:
    path = tmp_path / "foxglove.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("foxglove.Log", "jsonschema", b"{}")
        # The name alone is not enough: these bytes are not CDR.
        other = writer.register_schema(SCAN, "jsonschema", b"{}")
        for topic, kind in (("/log", schema), ("/other", other), ("/bare", 0)):
            channel = writer.register_channel(topic, "json", kind)
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call]

    log = open_log(path)

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
def test_messages_defined_in_idl_are_read_as_ros_defines_them(
    definition: str, tmp_path: Path
) -> None:
    path = tmp_path / "idl.mcap"
    kind = "geometry_msgs/msg/PoseStamped"
    types: dict[str, Any] = ROS2.types
    message = types[kind](
        types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](3, 4), "/map"),
        types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        ),
    )
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2idl", definition.encode())
        channel = writer.register_channel("/pose", "cdr", schema)
        writer.add_message(channel, 1, bytes(ROS2.serialize_cdr(message, kind)), 1)
        writer.finish()  # type: ignore[no-untyped-call]

    with alarm(5):
        (sample,) = open_log(path).poses()

    assert sample.stamp_ns == 3_000_000_004
    assert (sample.parent, sample.pose) == ("map", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))


@pytest.fixture(scope="module", params=[NONE, ZSTD], ids=["none", "zstd"])
def sound(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap")
    return write_mcap(folder / "drive.mcap", drive(ROS2), options=request.param)


@given(st.data())
@settings(max_examples=60)
def test_no_damage_is_answered_with_anything_but_a_log_error(
    sound: Path, data: st.DataObject
) -> None:
    content = bytearray(sound.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    damaged = sound.with_name("damaged.mcap")
    damaged.write_bytes(content)

    try:
        log = open_log(damaged)
        assert count_scans(log) <= 6
        assert len(list(log.poses())) <= 7
    except LogError:
        pass
