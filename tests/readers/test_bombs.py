"""Files that announce or hide far more than they are: an error, in bounded memory and time."""

import bz2
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard

from occmap.errors import LogError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import open_log, text_log
from occmap.readers.containers import MAX_INFLATED, inflate, inflate_message, unzip_file
from tests.readers.ros import ROS1, ROS2, bag1_record, drive, write_bag1, write_mcap
from tests.readers.runs import bounded_memory, count_scans
from tests.samples import SAMPLE_LOGS

HUGE = 2**31
BOMB = 100_000_000
"""Bytes that a bomb truly holds: below what a block may have, far more than it is worth."""


@pytest.fixture(autouse=True, scope="module")
def load_kernels() -> None:
    """Load what a build of a text log needs: numba and its kernels are not part of a bomb."""
    build([SAMPLE_LOGS / "drive.csv"], BuildOptions())


def compress_zeros(compressor: Callable[[bytes], bytes], flush: Callable[[], bytes]) -> bytes:
    piece = bytes(1_000_000)
    packed = [compressor(piece) for _ in range(BOMB // len(piece))]
    return b"".join([*packed, flush()])


def refuse(path: Path, complaint: str) -> None:
    with bounded_memory(), pytest.raises(LogError, match=complaint):
        build([path], BuildOptions())


def test_one_long_line_before_many_short_ones(tmp_path: Path) -> None:
    """Room for as many words in each line as in the first would be 3 GB."""
    words = 20_000
    carmen, csv = tmp_path / "log.log", tmp_path / "log.csv"
    scan = f"FLASER {words} {'1 ' * words}0 0 0 0 0 0 1 host 1\n"
    carmen.write_text(scan + "FLASER 0\n" * words)
    constants = ("angle_min", "angle_increment", "x", "y", "yaw")
    header = "".join(f"# {name}: 0\n" for name in constants) + "stamp"
    names = "".join(f",r{beam}" for beam in range(words))
    csv.write_text(f"{header}{names}\n0{',1' * words}\n" + "1\n" * words)
    for path, found in (
        (carmen, "line 2: the line is too short"),
        (csv, "line 8: 1 cells where the header has 20001"),
    ):
        with bounded_memory():
            log = open_log(path)
            assert [stream.count for stream in log.streams] == [1]
        (note,) = (note for note in log.notes if note.damage)
        assert note.text.startswith("20000 of 20001 lines are malformed and left out")
        assert note.text.endswith(found)


@pytest.mark.parametrize("filler", [b"\n", b"ODOM 0 0 0 0 0 0 1 h 1\n", b"x"])
def test_a_gzip_bomb(tmp_path: Path, filler: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_log, "FREE_LINES", 20_000)  # by default it takes some seconds
    deflater = zlib.compressobj(wbits=31)
    start = b"FLASER 2 1.5 2.5 0 0 0 0 0 0 1 host 1\n"
    piece = filler * (1_000_000 // len(filler))
    packed = [deflater.compress(start), *(deflater.compress(piece) for _ in range(50))]
    path = tmp_path / "bomb.log.gz"
    path.write_bytes(b"".join([*packed, deflater.flush()]))

    refuse(path, "more than it has bytes|no end of line within")


def test_a_zstd_bomb_in_an_mcap_chunk(tmp_path: Path) -> None:
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    bomb = compress_zeros(packer.compress, packer.flush)
    data = write_mcap(tmp_path / "drive.mcap", drive(ROS2)).read_bytes()
    head = struct.pack("<QQQII", 0, 1, BOMB, 0, 4) + b"zstd" + struct.pack("<Q", len(bomb))
    chunk = struct.pack("<BQ", 6, len(head) + len(bomb)) + head + bomb
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data[:8] + chunk)

    refuse(path, "announces 100000000 bytes in .*, as only a bomb does")


def test_a_bz2_bomb_in_a_bag(tmp_path: Path) -> None:
    packer = bz2.BZ2Compressor()
    bomb = compress_zeros(packer.compress, packer.flush)
    data = write_bag1(tmp_path / "drive.bag", drive(ROS1)).read_bytes()
    chunk = bag1_record(bomb, op=b"\x05", compression=b"bz2", size=struct.pack("<I", BOMB))
    path = tmp_path / "bomb.bag"
    path.write_bytes(data[: 13 + 4096] + chunk)

    refuse(path, "as only a bomb does")


def test_a_message_that_announces_2_to_31_beams(tmp_path: Path) -> None:
    for path, at in (
        (write_mcap(tmp_path / "a.mcap", drive(ROS2)), 0),
        (write_bag1(tmp_path / "a.bag", drive(ROS1)), 0),
    ):
        data = bytearray(path.read_bytes())
        beams = struct.pack("<ffI", 0.25, 30.0, 5)  # range_min, range_max and the count
        while (at := data.find(beams, at + 1)) > 0:
            struct.pack_into("<I", data, at + 8, HUGE)
        path.write_bytes(data)

        with bounded_memory():
            log = open_log(path)
            assert count_scans(log) == 0
        assert any("6 of 6 messages on /scan are damaged" in note.text for note in log.notes)
        refuse(path, "no scan can be read")


NOISE = np.random.default_rng(1).integers(0, 4, 3_000_000, dtype=np.uint8).tobytes()
COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
each = pytest.mark.parametrize("name", COMPRESSORS)


@each
@pytest.mark.parametrize("content", [b"", b"x", NOISE], ids=["empty", "one byte", "3 MB"])
def test_a_sound_block_comes_out_whole(name: str, content: bytes) -> None:
    assert inflate(COMPRESSORS[name](content), name, len(content)) == (content, "")


def test_an_uncompressed_block_is_passed_on() -> None:
    assert inflate(b"abc", "", 3) == inflate(b"abc", "none", 3) == (b"abc", "")
    assert inflate(b"ab", "", 3) == (b"ab", "holds 2 bytes instead of 3")


@each
def test_a_cut_block_gives_its_start(name: str) -> None:
    packed = COMPRESSORS[name](NOISE)

    block, problem = inflate(packed[: len(packed) * 3 // 4], name, len(NOISE))

    assert len(NOISE) // 4 < len(block) < len(NOISE)
    assert NOISE.startswith(block)
    assert f"{len(block)} of its {len(NOISE)} bytes" in problem


@each
def test_a_bomb_gives_no_more_than_was_announced(name: str) -> None:
    bomb = COMPRESSORS[name](bytes(100_000_000))
    with bounded_memory(10_000_000):
        block, _ = inflate(bomb, name, 1000)

    assert len(block) == 1000


@each
def test_an_absurd_size_is_refused(name: str) -> None:
    block, problem = inflate(COMPRESSORS[name](b"x"), name, MAX_INFLATED + 1)

    assert block == b""
    assert "as only a bomb does" in problem


def test_an_unknown_compression_is_named() -> None:
    assert inflate(b"x", "snappy", 1)[1].startswith("is compressed with 'snappy'")


def test_messages_compressed_on_their_own() -> None:
    assert bytes(inflate_message(memoryview(zstandard.compress(NOISE)))) == NOISE
    for damaged in (zstandard.compress(NOISE)[:1000], b"", b"no zstd"):
        assert inflate_message(memoryview(damaged)) == damaged


def test_files(tmp_path: Path) -> None:
    packed, target = tmp_path / "log.zstd", tmp_path / "log"
    packed.write_bytes(zstandard.compress(NOISE))
    assert unzip_file(packed, target) == ""
    assert target.read_bytes() == NOISE

    packed.write_bytes(zstandard.compress(NOISE)[:-1000])  # its reader will see that it is cut
    assert unzip_file(packed, target) == ""
    assert NOISE.startswith(target.read_bytes())

    packed.write_bytes(b"\0" + zstandard.compress(NOISE)[1:])
    assert unzip_file(packed, target).startswith("is damaged: 0 bytes")
