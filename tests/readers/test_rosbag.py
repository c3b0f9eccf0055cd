import bz2
import os
import shutil
import struct
import sys
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import StoragePlugin

from occmap.errors import LogError
from occmap.readers import Note, Probe, Role, Stream, open_log, probe_path
from occmap.readers.rosbag import RosbagReader
from tests.fuzz.__main__ import alarm
from tests.readers.ros import (
    RANGES,
    ROS1,
    ROS2,
    SCAN,
    SECOND,
    TF,
    Bag2,
    Written,
    drive,
    transforms,
    write_bag1,
)
from tests.readers.runs import count_scans
from tests.readers.test_bombs import bounded_memory

SQLITE = Bag2(StoragePlugin.SQLITE3)
MCAP = Bag2(StoragePlugin.MCAP)


_BAG_HEAD = 13 + 4096
"""Where the first chunk starts: behind the magic and the bag header with its padding."""


def test_bags_are_recognised_by_content(tmp_path: Path) -> None:
    bag = write_bag1(tmp_path / "no_suffix", drive(ROS1))
    folder = SQLITE.write(tmp_path / "folder", drive(ROS2))
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "notes.txt").write_text("nothing here")

    reader = RosbagReader()
    assert reader.recognises(probe_path(bag))
    assert reader.recognises(probe_path(folder))
    assert reader.recognises(probe_path(folder / "folder.db3"))
    assert not reader.recognises(probe_path(plain))
    assert not reader.recognises(Probe(plain / "notes.txt", b"nothing", b"nothing"))


def test_a_bare_storage_file_is_read(tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))

    assert count_scans(open_log(folder / "drive.db3")) == 6


def test_old_transforms_are_read(tmp_path: Path) -> None:
    message = transforms(ROS1, SECOND, [("/map", "/base", 1.0)], "tf/msg/tfMessage")
    log = open_log(write_bag1(tmp_path / "old.bag", [Written("/tf", SECOND, message)]))

    assert [(sample.parent, sample.child) for sample in log.poses()] == [("map", "base")]
    assert list(log.streams) == [Stream("/tf", "tf/tfMessage", 1, Role.POSE)]


def test_a_header_named_by_its_old_package_is_understood(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "old.bag", drive(ROS1))
    data = path.read_bytes()
    # Of equal length, so that no record needs to be written anew.
    path.write_bytes(data.replace(b"MSG: std_msgs/Header", b"MSG: roslib/Header\n "))

    assert count_scans(open_log(path)) == 6


@pytest.mark.parametrize("magic", [b"#ROSRECORD V1.2\n", b"#ROSBAG V1.1\n"])
def test_formats_before_2_are_named(magic: bytes, tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    path.write_bytes(magic + bytes(100))

    with pytest.raises(LogError, match=r"old format .*rosbag fix"):
        open_log(path)


def test_an_encrypted_bag_is_named(tmp_path: Path) -> None:
    fields = b"".join(
        struct.pack("<I", len(field)) + field
        for field in (b"op=\x03", b"encryptor=rosbag/AesCbcEncryptor")
    )
    path = tmp_path / "secret.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + struct.pack("<I", len(fields)) + fields + bytes(4))

    with pytest.raises(LogError, match="encrypted with rosbag/AesCbcEncryptor"):
        open_log(path)


def test_an_index_record_of_wrong_length_loses_nothing(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1))
    data = bytearray(path.read_bytes())
    for topic, entries in ((0, 1), (1, 6), (2, 6)):
        field = b"conn=" + struct.pack("<I", topic) + struct.pack("<I", 10) + b"count="
        start = data.find(field + struct.pack("<I", entries))
        assert start > 0
        struct.pack_into("<I", data, start + len(field) + 4, 20 * entries)
    path.write_bytes(data)

    log = open_log(path)

    assert [(stream.topic, stream.count) for stream in log.streams] == [
        ("/tf_static", 1),
        ("/tf", 6),
        ("/scan", 6),
    ]
    assert count_scans(log) == 6
    assert log.notes == []


def test_a_bag_that_was_never_closed_is_read(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1))
    data = path.read_bytes()
    (header_length,) = struct.unpack_from("<I", data, _BAG_HEAD)
    start = _BAG_HEAD + 4 + header_length
    (length,) = struct.unpack_from("<I", data, start)
    # As rosbag leaves it: no index position, a chunk without its length, no index behind it.
    index = data.index(b"index_pos=") + 10
    path.write_bytes(
        data[:index]
        + bytes(8)
        + data[index + 8 : start]
        + bytes(4)
        + data[start + 4 : start + 4 + length]
    )

    log = open_log(path)

    assert count_scans(log) == 6
    assert [stream.count for stream in log.streams] == [1, 6, 6]
    assert all(note.damage for note in log.notes)
    assert log.notes


def test_what_lies_before_a_cut_is_read(tmp_path: Path) -> None:
    data = write_bag1(tmp_path / "drive.bag", drive(ROS1)).read_bytes()
    path = tmp_path / "cut.bag"
    ends = [data.find((RANGES + k).tobytes()) + 4 * 5 + 4 + 4 * 3 for k in range(6)]
    for cut in range(ends[0], len(data), 97):
        path.write_bytes(data[:cut])
        log = open_log(path)
        assert count_scans(log) == sum(end <= cut for end in ends), cut
        assert all(note.damage for note in log.notes)
        assert log.notes


PACKED = pytest.mark.parametrize("packed", ["none", "bz2", "lz4"])


def list_records(
    data: bytes | bytearray, opcode: int, at: int = 13, last: int = 0
) -> list[tuple[int, int, int]]:
    """Where each record of a kind starts, where its data does, and where it ends."""
    found = []
    while at < (last or len(data)):
        (length,) = struct.unpack_from("<I", data, at)
        start = at + 8 + length
        end = start + struct.unpack_from("<I", data, start - 4)[0]
        found += [(at, start, end)] if b"op=" + bytes([opcode]) in data[at:start] else []
        at = end
    return found


def write_chunks(path: Path, packed: str, chunk_size: int = 500) -> bytes:
    """A bag of 30 scans, by default in chunks of a few messages."""
    writer = Writer(path)
    writer.chunk_threshold = chunk_size
    if packed != "none":
        writer.set_compression(Writer.CompressionFormat[packed.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for topic, record_ns, message in drive(ROS1, 30):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], record_ns, ROS1.serialize_ros1(message, kind))
    return path.read_bytes()


def read_damaged(path: Path, data: bytes | bytearray) -> list[int]:
    """The numbers of the scans that are read; what is lost must have been noted."""
    path.write_bytes(data)
    log = open_log(path)
    numbers = [scan.stamp_ns // SECOND - 1 for scan in log.scans({"/scan"})]
    assert log.notes or numbers == list(range(30))
    assert all(note.damage for note in log.notes)
    return numbers


@PACKED
@pytest.mark.parametrize("wrong", [1, 300, 1 << 20, 2**32 - 2000])
def test_a_chunk_of_a_wrong_length_is_read(tmp_path: Path, packed: str, wrong: int) -> None:
    data = bytearray(write_chunks(tmp_path / "drive.bag", packed))
    _, start, end = list_records(data, 5)[7]
    struct.pack_into("<I", data, start - 4, (end - start + wrong) % 2**32)

    assert read_damaged(tmp_path / "damaged.bag", data) == list(range(30))


def test_a_message_of_a_wrong_length_takes_no_other(tmp_path: Path) -> None:
    data = write_chunks(tmp_path / "drive.bag", "none", chunk_size=1 << 20)
    at = data.index((RANGES + 8).tobytes())
    chunks = list_records(data, 5)
    messages = [found for _, *chunk in chunks for found in list_records(data, 2, *chunk)]
    (start,) = [start for _, start, end in messages if start < at < end]
    for wrong in (1, -5, 300, 1 << 20):
        damaged = bytearray(data)
        (length,) = struct.unpack_from("<I", data, start - 4)
        struct.pack_into("<I", damaged, start - 4, length + wrong)

        numbers = read_damaged(tmp_path / "damaged.bag", damaged)
        assert set(range(30)) - set(numbers) <= {8}


@PACKED
def test_a_record_that_is_damaged_takes_no_other_chunk(tmp_path: Path, packed: str) -> None:
    data = write_chunks(tmp_path / "drive.bag", packed)
    head, start, end = list_records(data, 5)[7]
    of_chunk = set(range(30)) - set(
        read_damaged(tmp_path / "damaged.bag", data[:start] + bytes(end - start) + data[end:])
    )
    assert 0 < len(of_chunk) < 4
    for at in range(head, start):
        damaged = bytearray(data)
        damaged[at] ^= 0x55
        numbers = read_damaged(tmp_path / "damaged.bag", damaged)
        assert set(range(30)) - set(numbers) <= of_chunk, at - head


@pytest.mark.parametrize("damaged", [b"sensor_msgs/LaserScam", b"float33 angle_min"])
def test_a_connection_that_is_described_in_two_ways_is_told_of(
    tmp_path: Path, damaged: bytes
) -> None:
    data = write_chunks(tmp_path / "drive.bag", "none")
    sound = damaged.replace(b"Scam", b"Scan").replace(b"33", b"32")
    at = data.rindex(sound)
    path = tmp_path / "damaged.bag"
    path.write_bytes(data[:at] + damaged + data[at + len(damaged) :])

    log = open_log(path)
    assert len(list(log.poses())) == 31

    text = "connection 2 is described in two ways"
    assert any(text in note.text for note in log.notes)


@pytest.mark.parametrize("closed", [True, False])
def test_messages_of_a_connection_that_is_not_named_are_told_of(
    closed: bool, tmp_path: Path
) -> None:
    data = bytearray(write_chunks(tmp_path / "log.bag", "none", 1 << 20))
    if not closed:  # the record before the first chunk says where the index is
        at = data.index(b"index_pos=") + len(b"index_pos=")
        data[at : at + 8] = bytes(8)
    start = 0
    while (at := data.find(b"\x09\0\0\0conn=\x02", start)) >= 0:
        end = data.find(b"topic=/scan", at - 60, at + 60)
        if end >= 0:
            data[at + 9] = 9
        start = at + 1

    (tmp_path / "log.bag").write_bytes(data)
    log = open_log(tmp_path / "log.bag")

    assert any("names no connection for" in note.text for note in log.notes if note.damage)


def test_a_chunk_that_is_gone_is_told_of(tmp_path: Path) -> None:
    data = write_chunks(tmp_path / "drive.bag", "lz4")
    at, _, end = list_records(data, 5)[7]

    assert set(read_damaged(tmp_path / "damaged.bag", data[:at] + data[end:])) < set(range(30))


@PACKED
def test_damage_in_a_record_behind_a_chunk_is_one_note_that_names_its_place(
    tmp_path: Path, packed: str
) -> None:
    data = write_chunks(tmp_path / "drive.bag", packed)
    _, _, chunk_end = list_records(data, 5)[7]
    behind = [(at, end) for at, _, end in list_records(data, 4) if at >= chunk_end][:2]
    assert behind[0][0] == chunk_end
    for at, end in behind:
        damaged = bytearray(data)
        damaged[at] ^= 0x55  # of the length of its header

        assert read_damaged(tmp_path / "damaged.bag", damaged) == list(range(30))
        log = open_log(tmp_path / "damaged.bag")
        assert count_scans(log) == 30
        assert [note.text for note in log.notes] == [
            f"damaged at byte {at}, read on from byte {end}"
        ]
        assert [stream.count for stream in log.streams] == [1, 30, 30]


def test_bytes_that_are_added_to_a_chunk_push_one_message_out_of_it(tmp_path: Path) -> None:
    data = write_chunks(tmp_path / "drive.bag", "none", chunk_size=1 << 20)
    at = data.index((RANGES + 8).tobytes())

    numbers = read_damaged(tmp_path / "damaged.bag", data[:at] + b"\xff\x05" * 20 + data[at:])

    assert set(range(30)) - set(numbers) <= {8, 29}  # a chunk ends where it says


def test_reading_goes_on_behind_the_place_that_is_said_to_be_damaged(tmp_path: Path) -> None:
    data = bytearray(write_chunks(tmp_path / "drive.bag", "none"))
    at, start, end = list_records(data, 7)[0]
    struct.pack_into("<I", data, start - 4, end - start + 100)

    assert read_damaged(tmp_path / "damaged.bag", data) == list(range(30))

    (note, *_) = open_log(tmp_path / "damaged.bag").notes
    assert note.text == f"damaged at byte {at}, read on from byte {end}"


@pytest.mark.parametrize("opcode", [4, 5, 6, 7])
def test_a_record_that_states_4_gib_is_read_in_bounded_memory(tmp_path: Path, opcode: int) -> None:
    data = bytearray(write_chunks(tmp_path / "drive.bag", "none"))
    _, start, _ = list_records(data, opcode)[-1]
    struct.pack_into("<I", data, start - 4, 2**32 - 1)

    with bounded_memory():
        assert set(read_damaged(tmp_path / "damaged.bag", data)) >= set(range(29))


def test_a_bz2_bomb_gives_no_more_than_it_announces(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1), compression="bz2")
    data = path.read_bytes()
    start = data.find(b"BZh")
    (length,) = struct.unpack_from("<I", data, start - 4)
    bomb = bz2.compress(bytes(50_000_000))
    path.write_bytes(
        data[: start - 4] + struct.pack("<I", len(bomb)) + bomb + data[start + length :]
    )

    log = open_log(path)

    assert count_scans(log) == 0
    assert "the chunk at byte" in log.notes[0].text


def test_a_message_that_does_not_decode_is_counted_and_passed_over(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1))
    data = bytearray(path.read_bytes())
    start = data.find((RANGES + 2).tobytes())
    struct.pack_into("<I", data, start - 4, 2**31)  # beams
    path.write_bytes(data)

    log = open_log(path)

    assert count_scans(log) == count_scans(log) == 5
    (note,) = log.notes
    assert note.damage
    why = f": the first is not a {SCAN} ("
    assert note.text.startswith(f"1 of 6 messages on /scan are damaged and not used{why}")


def test_where_a_definition_is_damaged_the_standard_one_is_used(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"float32 angle_min\n", b"flaot32 angle_min\n"))

    log = open_log(path)

    assert count_scans(log) == 6
    text = "the definition of sensor_msgs/LaserScan on /scan is damaged; the standard one is used"
    assert log.notes == [Note(text, damage=True)]


def test_a_transform_whose_definition_is_damaged_is_read(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "drive.bag", drive(ROS1))
    data = path.read_bytes()
    path.write_bytes(
        data.replace(b"TransformStamped[] transforms", b"TransformStomped[] transforms")
    )

    assert len(list(open_log(path).poses())) == 7


def test_a_folder_without_metadata_is_read(tmp_path: Path) -> None:
    for bag in (SQLITE, MCAP):
        folder = bag.write(tmp_path / bag.storage.name, drive(ROS2))
        (folder / "metadata.yaml").unlink()
        assert count_scans(open_log(folder)) == 6


ANCHORS = "\n".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}, *a{i - 1}]" for i in range(1, 60))
UNFOLDING = (
    f"a0: &a0 [x, x]\n{ANCHORS}\nrosbag2_bagfile_information:\n"
    "  relative_file_paths: *a59\n  compression_mode: *a59\n"
)
MERGING = "a0: &a0 {x: 1}\n" + "\n".join(
    f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}], x{i}: 1}}" for i in range(1, 40)
)


@pytest.mark.parametrize(
    "text",
    [
        *("", "just words", "{", "rosbag2_bagfile_information: 3"),
        *("[" * 900 + "]" * 900, UNFOLDING, MERGING, "x" * (1 << 20) + ": 1"),
        "rosbag2_bagfile_information: {relative_file_paths: [drive.db3],"
        " topics_with_message_count: [{message_count: many, topic_metadata: {name: /tf}}]}",
    ],
    ids=range(9),
)
def test_the_files_of_a_folder_with_damaged_metadata_are_read(text: str, tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    (folder / "metadata.yaml").write_text(text)

    with alarm(5):
        log = open_log(folder)

    assert count_scans(log) == 6
    assert log.notes == [Note("metadata.yaml is damaged and not used", damage=True)]


@pytest.mark.parametrize("bag", [SQLITE, MCAP], ids=["sqlite", "mcap"])
def test_messages_that_only_the_metadata_counts_are_told_of(bag: Bag2, tmp_path: Path) -> None:
    folder = bag.write(tmp_path / "drive", drive(ROS2, scans=9))
    metadata = (folder / "metadata.yaml").read_text()
    assert open_log(folder).notes == []
    shutil.rmtree(folder)
    bag.write(folder, drive(ROS2, scans=6))
    (folder / "metadata.yaml").write_text(metadata)

    assert open_log(folder).notes == [
        Note(f"metadata.yaml announces 9 messages of {kind} on {topic}, the files 6", damage=True)
        for topic, kind in (("/tf", TF), ("/scan", SCAN))
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="needs named pipes")
@pytest.mark.parametrize("name", ["metadata.yaml", "drive_1.db3", "drive.db3-wal"])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(name: str, tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- drive.db3", "- drive.db3\n  - drive_1.db3"))
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)

    with alarm(5):
        assert count_scans(open_log(folder)) == 6


def test_files_that_the_metadata_names_and_are_missing_are_named(tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    renamed = shutil.copytree(folder, tmp_path / "renamed")
    (renamed / "drive.db3").rename(renamed / "other.db3")
    (folder / "drive.db3").unlink()

    with pytest.raises(LogError, match=r"names files that are missing: drive\.db3"):
        open_log(folder)
    log = open_log(renamed)
    assert count_scans(log) == 6
    assert log.notes == [Note("metadata.yaml names files that are missing: drive.db3", True)]


def test_a_file_that_the_metadata_does_not_name_is_told_of(tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    shutil.copy(folder / "drive.db3", folder / "drive_1.db3")
    (folder / "drive.db3.zstd").write_bytes(b"what a player unpacked")

    (note,) = open_log(folder).notes

    assert note.damage
    assert "does not name drive_1.db3: not read" in note.text


def test_a_storage_file_that_cannot_be_read_does_not_spoil_the_others(tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    (folder / "metadata.yaml").unlink()
    (folder / "drive_2.db3").write_bytes(b"no database")

    log = open_log(folder)

    assert count_scans(log) == 6
    assert log.notes == [Note("drive_2.db3 is not used: neither SQLite nor MCAP", True)]


@pytest.mark.parametrize("other", ["walk_0.db3", "drive.mcap", "drive.db3.zstd"])
def test_a_folder_of_several_recordings_is_refused(other: str, tmp_path: Path) -> None:
    folder = SQLITE.write(tmp_path / "drive", drive(ROS2))
    shutil.copy(folder / "drive.db3", folder / other)
    assert count_scans(open_log(folder)) == 6  # the metadata says which file it is
    (folder / "metadata.yaml").unlink()

    with pytest.raises(
        LogError, match=r"more than one recording and no metadata\.yaml: "
    ) as caught:
        open_log(folder)
    assert other in caught.value.found
    assert caught.value.fix.startswith(f"give one of them, such as {folder}/")
