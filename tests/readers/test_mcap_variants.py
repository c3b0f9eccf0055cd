"""MCAP files in every variant of the specification, and each fault that once went untold.

With OCCMAP_FAULTS set, all variants; without, a hundred drawn by lot, in which every three features
come together and apart.
"""

import os
import random
import struct
from collections.abc import Collection
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode

from occmap.errors import LogError
from occmap.readers import Log, open_log
from tests.readers import mcap_variants
from tests.readers.mcap_variants import ALONE, PACK, list_records, list_variants, write_variant
from tests.readers.ros import RANGES, ROS2, drive

SCANS = 30
LOG = drive(ROS2, SCANS)
SMALL = drive(ROS2, 4)
STAMPS = [written.record_ns - 500_000_000 for written in LOG if written.topic == "/scan"]
FULL = {*ALONE, "chunks", "message index", "chunk index"} - {"padding"}
UNCHECKED = FULL - {"checksums"}
BARE = {"chunks"}
INDEXED = {"chunks", "message index"}
COUNTED = {"statistics", "repeated schemas", "repeated channels"}


def write(has: Collection[str], compression: str = "") -> bytearray:
    return bytearray(write_variant(LOG, has, compression))


def read(tmp_path: Path, data: bytes | bytearray) -> tuple[Log, list[int]]:
    """Read a file: the log, and the stamps of its scans."""
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    log = open_log(path)
    return log, [scan.stamp_ns for scan in log.scans({"/scan"})]


def read_damaged(tmp_path: Path, data: bytes | bytearray) -> tuple[list[str], list[int]]:
    """Read a file whose damage must be noted: the notes, and the stamps of its scans."""
    log, stamps = read(tmp_path, data)
    list(log.poses())
    assert log.notes
    assert all(note.damage for note in log.notes)
    return [note.text for note in log.notes], stamps


@pytest.mark.parametrize("compression", PACK)
def test_every_variant_is_read_whole_and_has_no_note(compression: str, tmp_path: Path) -> None:
    variants = set(list_variants())
    assert len(variants) == 5 * 2 ** len(ALONE)
    chosen = sorted(map(sorted, variants))
    if "OCCMAP_FAULTS" not in os.environ:
        chosen = random.Random(compression).sample(chosen, 100)
    counts = {("/scan", 4), ("/tf", 4), ("/tf_static", 1)}
    for has in chosen:
        log, stamps = read(tmp_path, write_variant(SMALL, has, compression))

        assert stamps == STAMPS[:4], has
        assert len(list(log.poses())) == 5, has
        assert log.notes == [], has
        assert {(stream.topic, stream.count) for stream in log.streams} == counts, has


@pytest.mark.parametrize("has", [set(), COUNTED, BARE, INDEXED, FULL], ids=len)
@pytest.mark.parametrize("wrong", [1, -7, 250, -250, 1 << 20, 1 << 60])
def test_a_message_of_a_wrong_length_takes_no_other(
    tmp_path: Path, has: set[str], wrong: int
) -> None:
    data = write(has)
    place = data.index((RANGES + 8).tobytes())
    at = max(at for at, _ in list_records(data, Opcode.MESSAGE) if at < place)
    (length,) = struct.unpack_from("<Q", data, at + 1)
    struct.pack_into("<Q", data, at + 1, (length + wrong) % 2**64)

    _, stamps = read_damaged(tmp_path, data)

    assert len(stamps) >= SCANS - 1
    assert set(STAMPS) - set(stamps) <= {STAMPS[8]}


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("has", [BARE, INDEXED, FULL], ids=len)
@pytest.mark.parametrize("wrong", [1, 3000, 1 << 20, 1 << 60])
def test_a_chunk_of_a_wrong_length_is_read(
    tmp_path: Path, has: set[str], compression: str, wrong: int
) -> None:
    data = write(has, compression)
    at, length = list_records(data, Opcode.CHUNK)[4]
    struct.pack_into("<Q", data, at + 1, length - 9 + wrong)

    assert read_damaged(tmp_path, data)[1] == STAMPS


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("has", [FULL, BARE, INDEXED], ids=len)
def test_a_chunk_under_another_opcode_is_told_of(
    tmp_path: Path, has: set[str], compression: str
) -> None:
    for opcode in [0, 1, 2, 3, 4, 5, 7, 13, 14, 15, 22, 0x46, 9, 12, 0x86]:
        data = write(has, compression)
        data[list_records(data, Opcode.CHUNK)[4][0]] = opcode

        assert len(read_damaged(tmp_path, data)[1]) >= len(STAMPS) - mcap_variants.MESSAGES


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_cut_chunk_is_told_from_a_damaged_one(tmp_path: Path, compression: str) -> None:
    """Its length stands in its head and again in its body: nothing else can follow."""
    data = write(BARE, compression)
    at, length = list_records(data, Opcode.CHUNK)[-1]

    notes, _ = read_damaged(tmp_path, data[: at + length - 20])

    there = f"{length - 20:,} of its {length:,} bytes are there"
    assert [note for note in notes if "chunk at byte" not in note] == [
        f"the file ends in the middle of the record at byte {at}: {there}"
    ]


def test_a_file_without_footer_says_so(tmp_path: Path) -> None:
    data = write(BARE)
    at, length = list_records(data, Opcode.CHUNK)[-1]

    (note,), stamps = read_damaged(tmp_path, data[: at + length])

    assert stamps == STAMPS
    assert "the file is cut before its end" in note


def test_a_wrong_checksum_is_noted_once_and_the_messages_used(tmp_path: Path) -> None:
    data = write(FULL)
    data[data.find((RANGES + 3).tobytes()) + 2] ^= 1

    (note,), stamps = read_damaged(tmp_path, data)

    assert stamps == STAMPS
    assert "wrong checksum" in note


def test_a_message_beside_the_time_of_a_chunk_with_a_wrong_checksum_is_lost(tmp_path: Path) -> None:
    data = write(FULL)
    ranges, record_ns = data.find((RANGES + 3).tobytes()), STAMPS[3] + 500_000_000
    data[data.rfind(struct.pack("<QQ", *[record_ns] * 2), 0, ranges) + 7] ^= 1

    notes, stamps = read_damaged(tmp_path, data)

    assert stamps == STAMPS[:3] + STAMPS[4:]
    assert ["wrong checksum" in note for note in notes] == [True, False]
    assert notes[1] == f"{SCANS - 1} messages are read on /scan, where the log announces {SCANS}"


def test_two_chunks_of_which_nothing_can_be_read_are_not_one_that_is_there_twice(
    tmp_path: Path,
) -> None:
    data = write(FULL - {"statistics"}, "zstd")
    for at, _ in list_records(data, Opcode.CHUNK)[2:4]:
        data[data.index(zstandard.FRAME_HEADER, at)] ^= 1

    notes, stamps = read_damaged(tmp_path, data)

    assert set(stamps) < set(STAMPS)
    assert len([note for note in notes if ": 0 of its" in note]) == 2


@pytest.mark.parametrize("has", [FULL, UNCHECKED, FULL - {"statistics"}], ids=len)
def test_a_chunk_that_is_gone_is_told_of(tmp_path: Path, has: set[str]) -> None:
    data = write(has, "zstd")
    at, length = list_records(data, Opcode.CHUNK)[4]
    del data[at : at + length]  # nor is the summary where it was

    assert set(read_damaged(tmp_path, data)[1]) < set(STAMPS)


@pytest.mark.parametrize("has", [FULL, UNCHECKED, BARE], ids=len)
def test_a_summary_that_is_damaged_is_told_of(tmp_path: Path, has: set[str]) -> None:
    data = write(has)
    ((at, length),) = list_records(data, Opcode.DATA_END)
    data[at + length : -8] = bytes(len(data[at + length : -8]))

    assert read_damaged(tmp_path, data)[1] == STAMPS


@pytest.mark.parametrize(
    ("has", "record", "changed", "told"),
    [
        ({"chunks", *COUNTED}, (Opcode.STATISTICS, 0), (9, "<Q", len(LOG) + 5), "statistics"),
        (set(), (Opcode.CHANNEL, 1), (11, "<H", 0), "type of the messages on /tf is not stated"),
        (set(), (Opcode.SCHEMA, 1), (0, "B", Opcode.FOOTER), ""),
    ],
)
def test_a_record_that_says_something_else_is_told_of_and_takes_no_scan(
    tmp_path: Path, has: set[str], record: tuple[int, int], changed: tuple[int, str, int], told: str
) -> None:
    """Not even one that became a footer, which ends nothing."""
    data, (opcode, which), (place, layout, value) = write(has), record, changed
    struct.pack_into(layout, data, list_records(data, opcode)[which][0] + place, value)

    notes, stamps = read_damaged(tmp_path, data)

    assert told in notes[0]
    assert stamps == STAMPS


@pytest.mark.parametrize("has", [BARE, BARE | {"statistics"}], ids=len)
def test_a_message_of_an_unknown_channel_is_told_of(tmp_path: Path, has: set[str]) -> None:
    data = write(has)
    at, _ = list_records(data, Opcode.MESSAGE)[-1]
    struct.pack_into("<H", data, at + 9, 77)

    notes, _ = read_damaged(tmp_path, data)

    assert notes[0] == "the file names no channel for 1 message"
    assert len(notes) == (1 if has == BARE else 2)  # its statistics count it elsewhere


def test_messages_whose_channels_were_in_a_lost_chunk_are_counted(tmp_path: Path) -> None:
    data = write(BARE | {"statistics"}, "zstd")
    data[data.index(zstandard.FRAME_HEADER)] ^= 1  # of the first chunk, which alone has channels

    with pytest.raises(LogError, match=f"no channel for {len(LOG)} messages"):
        read(tmp_path, data)


def test_a_chunk_that_states_to_be_empty_is_told_of(tmp_path: Path) -> None:
    data = write(BARE, "zstd")
    at, _ = list_records(data, Opcode.CHUNK)[4]
    data[at + 9 + 16 : at + 9 + 44] = bytes(28)  # its size, checksum, compression and length

    notes, stamps = read_damaged(tmp_path, data)

    assert len(stamps) < SCANS
    assert "bytes that it does not state" in notes[0]


def test_an_index_without_checksum_is_not_relied_on(tmp_path: Path) -> None:
    data = write(UNCHECKED)
    place = struct.pack("<Q", list_records(data, Opcode.CHUNK)[4][0])
    at = data.rindex(place) + 16 + 4
    while struct.unpack_from("<H", data, at) != (3,):  # of the channels, /scan is the third
        at += 10
    struct.pack_into("<H", data, at, 77)

    assert read(tmp_path, data)[1] == STAMPS


@pytest.mark.parametrize("has", [set(), BARE, FULL], ids=len)
@pytest.mark.parametrize(("lost", "added"), [(40, b""), (0, b"\xff\x05" * 20)])
def test_bytes_that_are_lost_or_added_take_what_lies_there(
    tmp_path: Path, has: set[str], lost: int, added: bytes
) -> None:
    data = write(has)
    at = data.index((RANGES + 8).tobytes())

    _, stamps = read_damaged(tmp_path, data[: at - lost] + added + data[at:])

    # A chunk ends where it says, so bytes that were added push its last ones out of it.
    assert set(STAMPS) - set(stamps) <= {STAMPS[8], STAMPS[9]}
