"""MCAP files in every variant of the specification, and each fault that once went untold.

With OCCMAP_FAULTS set, all variants; without, those that have or lack at most two features, and so
every pair together and apart.
"""

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from mcap.reader import NonSeekingReader, make_reader

from occmap.errors import LogError
from occmap.readers import Log, open_log
from tests.readers.mcap_variants import (
    ALONE,
    CHUNK,
    DATA_END,
    MESSAGE,
    MESSAGES,
    PACK,
    SCHEMA,
    list_variants,
    write_variant,
)
from tests.readers.ros import RANGES, ROS2, drive

SCANS = 30
LOG = drive(ROS2, SCANS)
SMALL = drive(ROS2, 4)
FULL = {*ALONE, "chunks", "message index", "chunk index"} - {"padding"}
BARE = {"chunks"}
INDEXED = {"chunks", "message index"}
COUNTED = {"statistics", "repeated schemas", "repeated channels"}


def read(path: Path) -> tuple[Log, list[int]]:
    log = open_log(path)
    return log, [scan.stamp_ns for scan in log.scans({"/scan"})]


STAMPS = [written.record_ns - 500_000_000 for written in LOG if written.topic == "/scan"]


def list_records(data: bytes | bytearray, opcode: int) -> list[tuple[int, int]]:
    """Position and length of each record of a kind, its head included."""
    found, position = [], 8
    while position < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, position)
        found += [(position, 9 + length)] if kind == opcode else []
        position += 9 + length
    return found


def find_inner_messages(data: bytes | bytearray) -> list[int]:
    """Where in the file the messages within uncompressed chunks start."""
    found = []
    for position, length in list_records(data, CHUNK):
        at = position + 9 + 40
        while at < position + length:
            kind, size = struct.unpack_from("<BQ", data, at)
            found += [at] if kind == MESSAGE else []
            at += 9 + size
    return found


@pytest.mark.parametrize("compression", PACK)
def test_every_variant_is_read_whole_and_has_no_note(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "variant.mcap"
    variants = set(list_variants())
    assert len(variants) == 5 * 2 ** len(ALONE)
    chosen = sorted(map(sorted, variants))
    if compression:
        chosen = chosen[:: len(chosen) // 200]
    elif "OCCMAP_FAULTS" not in os.environ:
        chosen = [has for has in chosen if min(len({*ALONE} & {*has}), len({*ALONE} - {*has})) <= 2]
    for has in chosen:
        path.write_bytes(write_variant(SMALL, has, compression))
        log, stamps = read(path)

        assert stamps == STAMPS[:4], has
        assert len(list(log.poses())) == 5, has
        assert log.notes == [], has
        assert {(s.topic, s.count) for s in log.streams} == {
            ("/scan", 4),
            ("/tf", 4),
            ("/tf_static", 1),
        }


def test_the_variants_are_files_that_the_library_reads() -> None:
    for has in (FULL, BARE, set(), COUNTED):  # within chunks it takes no padding
        data = write_variant(SMALL, has)
        stream = NonSeekingReader(BytesIO(data), validate_crcs=True)
        assert len(list(stream.iter_messages())) == len(SMALL)
    reader = make_reader(BytesIO(write_variant(SMALL, FULL)), validate_crcs=True)
    assert len(list(reader.iter_messages())) == len(SMALL)
    assert len(list(reader.iter_attachments())) == len(list(reader.iter_metadata())) == 1


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    """Where a test leaves a damaged file; what it lacks must have been noted."""
    yield tmp_path / "damaged.mcap"
    log, _ = read(tmp_path / "damaged.mcap")
    assert log.notes
    assert all(note.damage for note in log.notes)


@pytest.mark.parametrize("has", [set(), COUNTED, BARE, INDEXED, FULL], ids=len)
@pytest.mark.parametrize("wrong", [1, -7, 250, -250, 1 << 20, 1 << 60])
def test_a_message_of_a_wrong_length_takes_no_other(path: Path, has: set[str], wrong: int) -> None:
    data = bytearray(write_variant(LOG, has))
    at = data.index((RANGES + 8).tobytes())
    messages = find_inner_messages(data) or [at for at, _ in list_records(data, MESSAGE)]
    at = max(start for start in messages if start < at)
    (length,) = struct.unpack_from("<Q", data, at + 1)
    struct.pack_into("<Q", data, at + 1, (length + wrong) % 2**64)
    path.write_bytes(data)

    _, stamps = read(path)

    assert len(stamps) >= SCANS - 1
    assert set(STAMPS) - set(stamps) <= {STAMPS[8]}


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("has", [BARE, INDEXED, FULL], ids=len)
@pytest.mark.parametrize("wrong", [1, 3000, 1 << 20, 1 << 60])
def test_a_chunk_of_a_wrong_length_is_read(
    path: Path, has: set[str], compression: str, wrong: int
) -> None:
    data = bytearray(write_variant(LOG, has, compression))
    at, length = list_records(data, CHUNK)[4]
    struct.pack_into("<Q", data, at + 1, length - 9 + wrong)
    path.write_bytes(data)

    assert read(path)[1] == STAMPS


@pytest.mark.parametrize("has", [FULL, BARE, {*BARE, "padding"}], ids=len)
@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("opcode", [0, 1, 3, 4, 5, 7, 9, 12, 15, 22, 0x46, 0x86])
def test_a_chunk_under_another_opcode_is_told_of(
    path: Path, has: set[str], compression: str, opcode: int
) -> None:
    data = bytearray(write_variant(LOG, has, compression))
    at, _ = list_records(data, CHUNK)[4]
    data[at] = opcode
    path.write_bytes(data)

    log, stamps = read(path)

    assert len(stamps) >= len(STAMPS) - MESSAGES
    assert any(note.damage for note in log.notes)
    if opcode in {7, 9, 12, 15, 0x86}:  # those of records that hold no messages
        assert stamps == STAMPS
        assert f"the chunk at byte {at} is marked as another kind" in log.notes[0].text


def test_two_chunks_of_which_nothing_can_be_read_are_not_one_that_is_there_twice(
    path: Path,
) -> None:
    data = bytearray(write_variant(LOG, FULL - {"statistics"}, "zstd"))
    for at, _ in list_records(data, CHUNK)[2:4]:
        data[data.index(b"\x28\xb5\x2f\xfd", at)] ^= 1
    path.write_bytes(data)

    log, stamps = read(path)

    assert set(stamps) < set(STAMPS)
    assert len([note for note in log.notes if ": 0 of its" in note.text]) == 2


@pytest.mark.parametrize("has", [FULL, FULL - {"checksums"}, FULL - {"statistics"}], ids=len)
def test_a_chunk_that_is_gone_is_told_of(path: Path, has: set[str]) -> None:
    data = write_variant(LOG, has, "zstd")
    at, length = list_records(data, CHUNK)[4]
    path.write_bytes(data[:at] + data[at + length :])  # nor is the summary where it was

    assert set(read(path)[1]) < set(STAMPS)


@pytest.mark.parametrize("has", [FULL, FULL - {"checksums"}, BARE], ids=len)
def test_a_summary_that_is_damaged_is_told_of(path: Path, has: set[str]) -> None:
    data = bytearray(write_variant(LOG, has))
    ((at, _),) = list_records(data, DATA_END)
    data[at + 9 + 4 : len(data) - 8] = bytes(len(data) - 8 - at - 9 - 4)
    path.write_bytes(data)

    assert read(path)[1] == STAMPS


def test_statistics_that_count_otherwise_are_told_of(path: Path) -> None:
    data = bytearray(write_variant(LOG, {"chunks", *COUNTED}))
    (at, _) = list_records(data, 11)[0]
    struct.pack_into("<Q", data, at + 9, len(LOG) + 5)
    path.write_bytes(data)

    log, stamps = read(path)

    assert stamps == STAMPS
    assert "statistics" in log.notes[0].text


@pytest.mark.parametrize("has", [BARE, BARE | {"statistics"}], ids=len)
def test_a_message_of_an_unknown_channel_is_told_of(path: Path, has: frozenset[str]) -> None:
    data = bytearray(write_variant(LOG, has))
    at = find_inner_messages(data)[-1]
    struct.pack_into("<H", data, at + 9, 77)
    path.write_bytes(data)

    log, _ = read(path)

    assert log.notes[0].text == "the file names no channel for 1 message"
    assert len(log.notes) == (1 if has == BARE else 2)  # its statistics count it elsewhere


def test_messages_whose_channels_were_in_a_lost_chunk_are_counted_as_they_are(
    tmp_path: Path,
) -> None:
    path = tmp_path / "lost.mcap"
    data = bytearray(write_variant(LOG, BARE | {"statistics"}, "zstd"))
    data[data.index(zstandard.FRAME_HEADER)] ^= 1  # of the first chunk, which alone has channels
    path.write_bytes(data)

    with pytest.raises(LogError) as caught:
        open_log(path)

    assert f"no channel for {len(LOG) - MESSAGES} messages" in str(caught.value)


def test_a_chunk_that_states_to_be_empty_is_told_of(path: Path) -> None:
    data = bytearray(write_variant(LOG, BARE, "zstd"))
    at, _ = list_records(data, CHUNK)[4]
    data[at + 9 + 16 : at + 9 + 44] = bytes(28)  # its size, checksum, compression and length
    path.write_bytes(data)

    log, stamps = read(path)

    assert len(stamps) < SCANS
    assert "bytes that it does not state" in log.notes[0].text


def test_a_channel_that_lost_its_schema_is_told_of(path: Path) -> None:
    data = bytearray(write_variant(LOG, set()))
    at, _ = list_records(data, 4)[1]
    struct.pack_into("<H", data, at + 9 + 2, 0)
    path.write_bytes(data)

    assert read(path)[0].notes[0].text == "the type of the messages on /tf is not stated"


def test_a_channel_that_is_described_in_two_ways_is_told_of(tmp_path: Path) -> None:
    path = tmp_path / "damaged.mcap"
    data = bytearray(write_variant(LOG, FULL - {"checksums"}))
    at = data.rindex(b"sensor_msgs/msg/LaserScan")
    data[at] = ord("x")
    path.write_bytes(data)

    log = open_log(path)
    list(log.poses())

    assert [note.text for note in log.notes] == ["channel 3 is described in two ways: /scan"]


def test_an_index_without_checksum_is_not_relied_on(tmp_path: Path) -> None:
    data = bytearray(write_variant(LOG, FULL - {"checksums"}))
    place = struct.pack("<Q", list_records(data, CHUNK)[4][0])
    at = data.rindex(place) + 16 + 4
    while struct.unpack_from("<H", data, at) != (3,):  # of the channels, /scan is the third
        at += 10
    struct.pack_into("<H", data, at, 77)
    (tmp_path / "damaged.mcap").write_bytes(data)

    assert read(tmp_path / "damaged.mcap")[1] == STAMPS


@pytest.mark.parametrize("has", [set(), BARE, FULL], ids=len)
def test_bytes_that_are_lost_or_added_take_what_lies_there(path: Path, has: set[str]) -> None:
    data = write_variant(LOG, has)
    at = data.index((RANGES + 8).tobytes())
    for damaged in (data[: at - 40] + data[at:], data[:at] + b"\xff\x05" * 20 + data[at:]):
        path.write_bytes(damaged)
        log, stamps = read(path)

        # A chunk ends where it says, so bytes that were added push its last ones out of it.
        assert set(STAMPS) - set(stamps) <= {STAMPS[8], STAMPS[9]}
        assert log.notes


def test_a_record_that_became_a_footer_ends_nothing(path: Path) -> None:
    data = bytearray(write_variant(LOG, ()))
    at, _ = list_records(data, SCHEMA)[1]
    data[at] ^= 1  # of a schema, a footer

    path.write_bytes(data)
    log, stamps = read(path)

    assert len(stamps) > 0
    assert any(note.damage for note in log.notes)


def test_a_chunk_is_read_behind_a_first_record_of_another_kind(path: Path) -> None:
    data = bytearray(write_variant(LOG, FULL - {"checksums"}))
    chunk, _ = list_records(data, CHUNK)[1]
    first = chunk + 9 + 8 + 8 + 8 + 4 + 4 + 8
    assert data[first] == MESSAGE  # on /tf
    data[first] = 12  # its length still leads to the next record
    path.write_bytes(data)

    log, stamps = read(path)

    assert stamps == STAMPS
    assert f"the chunk at byte {chunk} is damaged at byte 0" in [note.text for note in log.notes]
