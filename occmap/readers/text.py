"""Text files, plain or gzip: their lines in blocks."""

from codecs import BOM_UTF8
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import NoteList
from occmap.readers.probing import GUNZIP_ERRORS, GZIP_MAGIC, gunzip
from occmap.types import Int64, UInt64

MAX_LINE_BYTES = 1 << 24
"""A scan of a million beams is shorter; a longer line is not of a text log."""
MAX_EXPANSION = 100
"""Text logs shrink to a tenth with gzip; what grows a hundredfold is not one."""
FREE_EXPANSION_BYTES = 1 << 30
"""Below this size gzip may expand as it likes: a robot that stands still repeats itself."""

FREE_LINES = 1_000_000
"""A gzip file of more lines than this, and of more lines than bytes, is a bomb of blank lines."""
BLOCK_BYTES = 1 << 20
"""How much of a file is read at a time, and its lines parsed together."""

PADDING = b"\n" * 16
"""What must follow the last line: words are looked at up to sixteen bytes at a time."""
NO_LOG = "this is not a text log; check what the file is"


class Line(NamedTuple):
    """One line of a text log."""

    number: int
    raw: bytes
    """Without its line end"""
    ended: bool
    """False for a last line without a line end: the file may be cut within it"""

    @property
    def text(self) -> str:
        """The line as text; bytes that are no UTF-8 become U+FFFD, which no parser takes."""
        return self.raw.decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class Block:
    """Lines of a text log that follow one another, as one text, since most are parsed together.

    It is valid until the next block is read into the same memory: fresh memory for each would cost
    as much time as parsing does.
    """

    number: int
    """Of the first line"""
    text: bytearray
    """The lines, each with its line end, and behind them at least as many bytes as `PADDING`"""
    starts: Int64
    """(S + 1,) where each line begins in the text, and where the last one ends"""
    ended: bool
    """False for a block of only the last line, where that has no line end"""

    @classmethod
    def of(cls, number: int, text: bytearray, end: int, ended: bool = True) -> Self:
        """Find where the lines begin in a text up to the end of a line."""
        if text.find(b"\r", 0, end) >= 0:
            lines = [line.rstrip(b"\r") for line in text[:end].split(b"\n")]
            text = bytearray(b"\n".join([*lines, PADDING]))
            end = len(text) - len(PADDING) - 1
        is_end = np.frombuffer(text, np.uint8, end + -end % 8) == ord("\n")
        # NumPy looks at single bytes slowly, and of eight in a row few hold a line end.
        eights = np.flatnonzero(is_end.view(np.uint64) != 0)
        at, byte = np.nonzero(is_end.reshape(-1, 8)[eights])
        is_marked = number == 1 and text.startswith(BOM_UTF8)
        starts = np.append(len(BOM_UTF8) if is_marked else 0, 8 * eights[at] + byte + 1)
        return cls(number, text, starts[starts <= end], ended)

    def __len__(self) -> int:
        """How many lines there are."""
        return len(self.starts) - 1

    def get_line(self, at: int) -> Line:
        """Get one of the lines."""
        start, end = self.starts[at : at + 2].tolist()
        return Line(self.number + at, bytes(memoryview(self.text)[start : end - 1]), self.ended)

    def get_lines(self, rows: Int64) -> Iterator[Line]:
        """Get some of the lines by their indices (S,)."""
        return map(self.get_line, rows.tolist())

    @property
    def eights(self) -> UInt64:
        """(L - 7,) the eight bytes from each byte of the text on, as a number, the first lowest."""
        return np.ndarray(len(self.text) - 7, "<u8", self.text, strides=(1,))


def is_heading(line: bytes) -> bool:
    """Whether a line is a comment or blank, as lines at the head of a file are."""
    return line.removeprefix(BOM_UTF8).lstrip()[:1] in {b"", b"#"}


def _has_mac_ends(head: bytes) -> bool:
    """Whether a text that begins like this has CR alone at the end of a line, as Macs wrote it.

    A program of today may have ended the last line of it.
    """
    lines = head.rstrip(b"\r\n")
    return b"\r" in lines and b"\n" not in lines


def read_blocks(path: Path, notes: NoteList) -> Iterator[Block]:
    """Yield the lines of a UTF-8 text file, plain or gzip, in blocks.

    Where gzip data is cut or corrupt, every complete line before the damage is given, and a note
    says what is lost.

    Raises
    ------
    LogError
        The file cannot be read, has a line beyond reason, or is a gzip bomb.
    """
    number, total = 1, 0
    text, filled = bytearray(2 * BLOCK_BYTES), 0
    with refuse_unreadable(path):
        size = path.stat().st_size
    limit, most_lines = max(FREE_EXPANSION_BYTES, MAX_EXPANSION * size), max(FREE_LINES, size)
    try:
        for piece in _read_lines(path):
            begun, filled, total = filled, filled + len(piece), total + len(piece)
            if filled + len(PADDING) > len(text):
                text = text + bytes(filled + len(PADDING))
            memoryview(text)[begun:filled] = piece
            if end := text.rfind(b"\n", begun, filled) + 1:
                block = Block.of(number, text, end)
                yield block
                number += len(block)
                # A last line without its end begins the next block.
                text[: filled - end] = text[end:filled]
                filled -= end
            if filled >= MAX_LINE_BYTES:
                raise LogError(f"no end of line within {filled} bytes", where=path, fix=NO_LOG)
            if total > limit or number > most_lines:
                raise LogError(f"grows more than {MAX_EXPANSION}-fold", where=path, fix=NO_LOG)
        if filled:
            text[filled] = ord("\n")
            yield Block.of(number, text, filled + 1, ended=False)
    except GUNZIP_ERRORS as error:
        reason = "cut short" if isinstance(error, EOFError) else f"corrupt: {error}"
        notes.add_damage(f"the gzip data is {reason}; all after line {number - 1} is lost")


def _read_lines(path: Path) -> Iterator[bytes | memoryview]:
    """Yield the content of a file as `_read_pieces` does, with the line ends of today."""
    has_mac_ends = False
    for number, piece in enumerate(_read_pieces(path)):
        if number == 0:
            has_mac_ends = _has_mac_ends(bytes(piece))
        yield bytes(piece).replace(b"\r", b"\n") if has_mac_ends else piece


def _read_pieces(path: Path) -> Iterator[bytes | memoryview]:
    """Yield the content of a file, unpacked; a piece is valid until the next one is read."""
    with refuse_unreadable(path), path.open("rb", 0) as file:
        if file.read(len(GZIP_MAGIC)) == GZIP_MAGIC:
            file.seek(0)
            yield from gunzip(file)
            return
        file.seek(0)
        piece = memoryview(bytearray(BLOCK_BYTES))
        while size := file.readinto(piece):
            yield piece[:size]
