"""ROS 1 bags: old ones, odd ones, unfinished ones, and what damage takes and does not take."""

import struct
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest

from occmap.readers import Log, Note, Role, Stream, open_log
from occmap.readers.bag1 import CHUNK, CHUNK_INFO, CONNECTION, INDEX, MESSAGE
from tests.readers import ros
from tests.readers.ros import RANGES, ROS1, SECOND, bag1_record, drive, write_bag1
from tests.readers.runs import bounded_memory, count_scans

PACKED = pytest.mark.parametrize("packed", ["none", "bz2", "lz4"])
ALL = set(range(30))
Data = bytes | bytearray


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "drive.bag"


def write(path: Path, packed: str = "none", chunk_size: int = 500) -> bytearray:
    """A bag of 30 scans, by default in chunks of a few messages."""
    return bytearray(write_bag1(path, drive(ROS1, 30), packed, chunk_size).read_bytes())


def read(path: Path, data: Data) -> tuple[Log, list[int]]:
    """Read a bag: the log, and the numbers of its scans."""
    path.write_bytes(data)
    log = open_log(path)
    return log, [scan.stamp_ns // SECOND - 1 for scan in log.scans({"/scan"})]


def read_damaged(path: Path, data: Data) -> tuple[list[str], set[int]]:
    """Read a bag whose damage must be noted: the notes, and the numbers of its scans."""
    log, numbers = read(path, data)
    list(log.poses())
    assert log.notes
    assert all(note.damage for note in log.notes)
    assert len(numbers) == len(set(numbers))
    return [note.text for note in log.notes], set(numbers)


def list_records(
    data: Data, opcode: int, at: int = 13, last: int | None = None
) -> list[tuple[int, int, int]]:
    """Where each record of a kind starts, where its data does, and where it ends."""
    found = []
    while at < (len(data) if last is None else last):
        (length,) = struct.unpack_from("<I", data, at)
        start = at + 8 + length
        end = start + struct.unpack_from("<I", data, start - 4)[0]
        found += [(at, start, end)] if b"op=" + bytes([opcode]) in data[at:start] else []
        if b"compression=none" in data[at:start]:
            found += list_records(data, opcode, start, end)
        at = end
    return found


def test_old_transforms_are_read(path: Path) -> None:
    message = ros.transforms(ROS1, SECOND, [("/map", "/base", 1.0)], "tf/msg/tfMessage")
    log = open_log(write_bag1(path, [ros.Written("/tf", SECOND, message)]))

    assert [(sample.parent, sample.child) for sample in log.poses()] == [("map", "base")]
    assert list(log.streams) == [Stream("/tf", "tf/tfMessage", 1, Role.POSE)]


@pytest.mark.parametrize(
    ("sound", "changed", "damaged"),
    [
        # Of equal length, so that no record needs to be written anew.
        (b"MSG: std_msgs/Header", b"MSG: roslib/Header\n ", []),
        (b"float32 angle_min", b"flaot32 angle_min", ["LaserScan on /scan"]),
        (b"TransformStamped[] ", b"TransformStomped[] ", ["TFMessage on /tf_static", "on /tf"]),
    ],
    ids=["old package", "scan", "transforms"],
)
def test_where_a_definition_is_old_or_damaged_the_standard_one_is_used(
    path: Path, sound: bytes, changed: bytes, damaged: list[str]
) -> None:
    log, scans = read(path, write(path).replace(sound, changed))

    assert scans == list(range(30))
    assert len(list(log.poses())) == 31
    for note, what in zip(log.notes, damaged, strict=True):
        assert note.damage
        assert f"{what} is damaged; the standard one is used" in note.text


@pytest.mark.parametrize(
    "order", [("time", "op", "conn"), ("conn", "time", "op"), ("time", "extra", "conn", "op")]
)
@pytest.mark.parametrize(("timeless", "lost"), [(None, set()), (19, set()), (20, {9})])
def test_a_message_has_its_fields_in_any_order_and_is_damaged_without_a_time(
    path: Path, order: Sequence[str], timeless: int | None, lost: set[int]
) -> None:
    data = write(path, chunk_size=1 << 20)
    ((head, start, end),) = list_records(data, CHUNK)
    whole = bytes(data)
    body = whole[start:end]
    for number, (at, first, last) in enumerate(list_records(data, MESSAGE)):
        values = {"op": b"\2", "conn": whole[at + 21 : at + 25], "time": whole[at + 34 : at + 42]}
        fields = {name: values.get(name, b"(.*=") for name in order}
        if number == timeless:
            del fields["time"]
        body = body.replace(whole[at:last], bag1_record(whole[first:last], **fields))
    chunk = bag1_record(body, op=b"\5", compression=b"none", size=struct.pack("<I", len(body)))
    (index,) = struct.unpack_from("<Q", data, at := data.index(b"index_pos=") + 10)
    struct.pack_into("<Q", data, at, index + len(chunk) - (end - head))

    log, numbers = read(path, data[:head] + chunk + data[end:])

    assert set(numbers) == ALL - lost
    assert len(list(log.poses())) == 31 - (timeless == 19)
    assert {note.damage for note in log.notes} == (set() if timeless is None else {True})


def test_an_index_record_of_wrong_length_loses_nothing(path: Path) -> None:
    data = write(path)
    for _, start, end in list_records(data, INDEX):
        struct.pack_into("<I", data, start - 4, (end - start) // 12 * 20)

    log, numbers = read(path, data)

    assert [stream.count for stream in log.streams] == [1, 30, 30]
    assert numbers == list(range(30))
    assert log.notes == []


def test_a_bag_that_was_never_closed_is_read(path: Path) -> None:
    data = write(path, chunk_size=1 << 20)
    _, start, end = list_records(data, CHUNK)[0]
    # As rosbag leaves it: no index position, a chunk without its length, no index behind it.
    index = data.index(b"index_pos=") + 10
    data[index : index + 8] = bytes(8)
    data[start - 4 : start] = bytes(4)

    log, numbers = read(path, data[:end])

    assert numbers == list(range(30))
    assert [stream.count for stream in log.streams] == [1, 30, 30]
    assert log.notes
    assert all(note.damage for note in log.notes)


@PACKED
@pytest.mark.parametrize("wrong", [1, 300, 1 << 20, 2**32 - 2000])
def test_a_chunk_of_a_wrong_length_is_read(path: Path, packed: str, wrong: int) -> None:
    data = write(path, packed)
    _, start, end = list_records(data, CHUNK)[7]
    struct.pack_into("<I", data, start - 4, (end - start + wrong) % 2**32)

    assert read_damaged(path, data)[1] == ALL


@PACKED
def test_a_record_that_is_damaged_takes_no_other_chunk(path: Path, packed: str) -> None:
    data = write(path, packed)
    head, start, end = list_records(data, CHUNK)[7]
    _, beside = read_damaged(path, data[:start] + bytes(end - start) + data[end:])
    assert 0 < len(ALL - beside) < 4
    for at, flipped in product(range(head, start), (0x55, 0x80)):
        damaged = bytearray(data)
        damaged[at] ^= flipped
        assert set(read(path, damaged)[1]) >= beside, at - head


def test_an_index_that_counts_messages_of_a_connection_it_lacks_is_not_used(path: Path) -> None:
    data = write(path)
    at = [at for at, start, _ in list_records(data, CONNECTION) if b"topic=/scan" in data[at:start]]
    data[data.index(b"conn=", at[-1]) + 5] ^= 64

    notes, numbers = read_damaged(path, data)

    assert numbers == ALL
    assert "index at its end cannot be used" in notes[0]


@pytest.mark.parametrize("closed", [True, False])
def test_messages_of_a_connection_that_is_not_named_are_told_of(path: Path, closed: bool) -> None:
    data = write(path)
    if not closed:  # the record before the first chunk says where the index is
        at = data.index(b"index_pos=") + len(b"index_pos=")
        data[at : at + 8] = bytes(8)
    for at, start, _ in list_records(data, CONNECTION):
        if b"topic=/scan" in data[at:start]:
            data[data.index(b"conn=", at) + 5] = 9

    notes, _ = read_damaged(path, data)

    assert any("names no connection for" in note for note in notes)


@PACKED
def test_damage_in_a_record_behind_a_chunk_is_one_note_that_names_its_place(
    path: Path, packed: str
) -> None:
    data = write(path, packed)
    _, _, chunk_end = list_records(data, CHUNK)[7]
    behind = [(at, end) for at, _, end in list_records(data, INDEX) if at >= chunk_end][:2]
    assert behind[0][0] == chunk_end
    for at, end in behind:
        damaged = bytearray(data)
        damaged[at] ^= 0x55  # of the length of its header

        log, numbers = read(path, damaged)

        assert numbers == list(range(30))
        assert log.notes == [Note(f"damaged at byte {at}, read on from byte {end}", damage=True)]
        assert [stream.count for stream in log.streams] == [1, 30, 30]


def test_reading_goes_on_behind_the_place_that_is_said_to_be_damaged(path: Path) -> None:
    data = write(path)
    at, start, end = list_records(data[: list_records(data, CHUNK_INFO)[0][0]], CONNECTION)[-3]
    struct.pack_into("<I", data, start - 4, end - start + 100)

    notes, numbers = read_damaged(path, data)

    assert numbers == ALL
    assert notes[0] == f"damaged at byte {at}, read on from byte {end}"


@pytest.mark.parametrize("opcode", [INDEX, CHUNK, CHUNK_INFO, CONNECTION])
def test_a_record_that_states_4_gib_is_read_in_bounded_memory(path: Path, opcode: int) -> None:
    data = write(path)
    _, start, _ = list_records(data, opcode)[-1]
    struct.pack_into("<I", data, start - 4, 2**32 - 1)

    with bounded_memory():
        log, numbers = read(path, data)
    assert set(numbers) >= ALL - {29}
    assert log.notes or set(numbers) == ALL


def test_a_message_that_does_not_decode_is_counted_and_passed_over(path: Path) -> None:
    data = write(path)
    struct.pack_into("<I", data, data.index((RANGES + 2).tobytes()) - 4, 2**31)  # beams
    path.write_bytes(data)

    log = open_log(path)

    assert count_scans(log) == count_scans(log) == 29
    (note,) = log.notes
    assert note.damage
    assert note.text.startswith("1 of 30 messages on /scan are damaged and not used: ")
    assert ros.SCAN in note.text
