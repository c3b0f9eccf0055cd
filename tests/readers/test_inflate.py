import bz2
from collections.abc import Callable
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard

from occmap.readers.containers import MAX_INFLATED, inflate, inflate_message, unzip_file
from tests.readers.runs import bounded_memory

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
    assert "more than any recorder writes" in problem


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

    packed.write_bytes(zstandard.compress(NOISE)[:-1000])
    assert unzip_file(packed, target) != ""
    assert NOISE.startswith(target.read_bytes())
