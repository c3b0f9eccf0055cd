"""Lines of text logs: line ends, damage, times to the nanosecond."""

import gzip
from pathlib import Path

import pytest

from occmap.errors import LogError
from occmap.readers import Note, NoteList, text_log
from occmap.readers.text_log import Block, Line, read_blocks


def list_lines(block: Block) -> list[Line]:
    return [block.get_line(at) for at in range(len(block))]


def read(path: Path) -> tuple[list[Line], list[Note]]:
    notes = NoteList()
    return [line for block in read_blocks(path, notes) for line in list_lines(block)], notes


def test_lines_have_numbers_and_no_ends(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(b"\xef\xbb\xbfone\r\n\ntwo\nlast")
    blocks = list(read_blocks(path, notes := NoteList()))
    assert [line for block in blocks for line in list_lines(block)] == [
        Line(1, b"one"),
        Line(2, b""),
        Line(3, b"two"),
        Line(4, b"last"),
    ]
    assert [block.ended for block in blocks] == [True, False]
    assert notes == []


@pytest.mark.parametrize("size", [4, 5, 6])
def test_a_line_feed_in_the_next_block_is_no_line(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_log, "BLOCK_BYTES", size)
    (tmp_path / "log").write_bytes(b"four\r\nlast\r\n")
    lines, _ = read(tmp_path / "log")
    assert [line.raw for line in lines] == [b"four", b"last"]


def test_gzip_and_plain_give_the_same_lines(tmp_path: Path) -> None:
    content = b"a b\nc\n" * 1000
    (tmp_path / "plain").write_bytes(content)
    (tmp_path / "packed").write_bytes(gzip.compress(content))
    assert read(tmp_path / "plain") == read(tmp_path / "packed")


def test_what_is_no_utf8_is_marked_and_not_fatal(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"a\xff\n")
    ((line,), _) = read(tmp_path / "log")
    assert line.text == "a\ufffd"


@pytest.mark.parametrize("cut", [200, 1000, 2000])
def test_a_cut_gzip_gives_complete_lines_and_one_note(tmp_path: Path, cut: int) -> None:
    lines = [f"{number} {number**7 % 999983}" for number in range(2000)]
    packed = gzip.compress("\n".join([*lines, ""]).encode())
    path = tmp_path / "log.gz"
    path.write_bytes(packed[:cut])
    found, notes = read(path)
    assert [line.text for line in found] == lines[: len(found)]
    assert notes == [
        Note(f"the gzip data is cut short; all after line {len(found)} is lost", damage=True)
    ]


def test_a_wrong_gzip_checksum_is_damage(tmp_path: Path) -> None:
    packed = bytearray(gzip.compress(b"one\ntwo\n"))
    packed[-8] ^= 1
    path = tmp_path / "log.gz"
    path.write_bytes(packed)
    lines, notes = read(path)
    assert [line.text for line in lines] == ["one", "two"]
    assert [note.damage for note in notes] == [True]


def test_a_flipped_byte_in_gzip_loses_no_line_without_a_note(tmp_path: Path) -> None:
    lines = [f"line {n * n}" for n in range(3000)]
    packed = gzip.compress("".join(f"{line}\n" for line in lines).encode())
    path = tmp_path / "log.gz"
    for at in range(2, len(packed), 211):
        flipped = bytearray(packed)
        flipped[at] ^= 0x40
        path.write_bytes(flipped)
        found, notes = read(path)
        assert notes or [line.text for line in found] == lines


def test_a_note_is_given_once_for_two_readings(tmp_path: Path) -> None:
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(b"one\n" * 999)[:-9])
    notes = NoteList()
    list(read_blocks(path, notes))
    list(read_blocks(path, notes))
    assert len(notes) == 1


def test_a_line_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_log, "MAX_LINE_BYTES", 100)
    (tmp_path / "log").write_bytes(b"1 " * 51)
    with pytest.raises(LogError, match="no end of line within 102 bytes"):
        read(tmp_path / "log")


def test_a_missing_file_is_a_log_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"log: cannot be read"):
        read(tmp_path / "log")


def test_a_block_of_lines_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_log, "BLOCK_BYTES", 10)
    (tmp_path / "log").write_bytes(b"one\ntwo\nthree\na longer line\nlast")
    blocks = read_blocks(tmp_path / "log", NoteList())
    assert [(block.number, [line.raw for line in list_lines(block)]) for block in blocks] == [
        (1, [b"one", b"two"]),
        (3, [b"three"]),
        (4, [b"a longer line"]),
        (5, [b"last"]),
    ]
