"""Lines of text logs: line ends, damage, times to the nanosecond."""

import gzip
from pathlib import Path

import pytest

from occmap.errors import LogError
from occmap.readers import NoteList, text_log
from occmap.readers.text_log import read_blocks

Blocks = list[tuple[int, list[str]]]
"""Of each the number of its first line, and its lines"""


def read(folder: Path, content: bytes | bytearray) -> tuple[Blocks, list[str]]:
    """The blocks of a text, and the notes of damage."""
    path = folder / "log"
    path.write_bytes(content)
    notes = NoteList()
    blocks = [
        (block.number, [block.get_line(at).text for at in range(len(block))])
        for block in read_blocks(path, notes)
    ]
    return blocks, [note.text for note in notes if note.damage]


def read_lines(folder: Path, content: bytes | bytearray) -> tuple[list[str], list[str]]:
    blocks, notes = read(folder, content)
    return [line for _, lines in blocks for line in lines], notes


def test_lines_have_numbers_and_no_ends(tmp_path: Path) -> None:
    ended, last = read(tmp_path, b"\xef\xbb\xbfone\r\n\ntwo\nlast")[0]
    assert ended == (1, ["one", "", "two"])
    assert last == (4, ["last"])


@pytest.mark.parametrize("size", [4, 5, 6])
def test_a_line_feed_in_the_next_block_is_no_line(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_log, "BLOCK_BYTES", size)
    assert read_lines(tmp_path, b"four\r\nlast\r\n") == (["four", "last"], [])
    assert read_lines(tmp_path, b"three\nl\ra\rt\n") == (["three", "l\ra\rt"], [])


def test_gzip_and_plain_give_the_same_lines(tmp_path: Path) -> None:
    content = b"a b\nc\n" * 1000
    assert read_lines(tmp_path, gzip.compress(content)) == read_lines(tmp_path, content)


def test_what_is_no_utf8_is_marked_and_not_fatal(tmp_path: Path) -> None:
    assert read_lines(tmp_path, b"a\xff\n") == (["a\ufffd"], [])


@pytest.mark.parametrize("cut", [200, 1000, 2000])
def test_a_cut_gzip_gives_complete_lines_and_one_note(tmp_path: Path, cut: int) -> None:
    lines = [f"{number} {number**7 % 999983}" for number in range(2000)]
    packed = gzip.compress("\n".join([*lines, ""]).encode())
    found, notes = read_lines(tmp_path, packed[:cut])
    assert found == lines[: len(found)]
    assert notes == [f"the gzip data is cut short; all after line {len(found)} is lost"]


def test_a_wrong_gzip_checksum_is_damage(tmp_path: Path) -> None:
    packed = bytearray(gzip.compress(b"one\ntwo\n"))
    packed[-8] ^= 1
    lines, (_,) = read_lines(tmp_path, packed)
    assert lines == ["one", "two"]


def test_a_flipped_byte_in_gzip_loses_no_line_without_a_note(tmp_path: Path) -> None:
    lines = [f"line {n * n}" for n in range(3000)]
    packed = gzip.compress("".join(f"{line}\n" for line in lines).encode())
    for at in range(2, len(packed), 211):
        flipped = bytearray(packed)
        flipped[at] ^= 0x40
        found, notes = read_lines(tmp_path, flipped)
        assert notes or found == lines


def test_a_note_is_given_once_for_two_readings(tmp_path: Path) -> None:
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(b"one\n" * 999)[:-9])
    notes = NoteList()
    list(read_blocks(path, notes))
    list(read_blocks(path, notes))
    assert len(notes) == 1


def test_a_line_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_log, "MAX_LINE_BYTES", 100)
    with pytest.raises(LogError, match="no end of line within 102 bytes"):
        read(tmp_path, b"1 " * 51)


def test_a_block_of_lines_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_log, "BLOCK_BYTES", 10)
    blocks, _ = read(tmp_path, b"one\ntwo\nthree\na longer line\nlast")
    assert blocks == [(1, ["one", "two"]), (3, ["three"]), (4, ["a longer line"]), (5, ["last"])]
