"""What the text formats share: lines of a plain or gzip file, exact times, notes on damage."""

import math
import sys
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from occmap.errors import LogError
from occmap.readers import Note, Probe, Span
from occmap.readers.gunzip import GUNZIP_ERRORS, MAGIC, gunzip
from occmap.readers.kernels import NUMBER, PADDING, SECONDS
from occmap.types import UNKNOWN_POSE, Float64, Int64, Pose, UInt8, as_float32, shorten

MAX_LINE_BYTES = 1 << 24
"""A scan of a million beams is shorter; a longer line is no text log."""
MAX_EXPANSION = 100
"""Text logs shrink to a tenth with gzip; what grows a hundredfold is not one."""
FREE_EXPANSION_BYTES = 1 << 30
"""Below this size gzip may expand as it likes: a robot that stands still repeats itself."""

FREE_LINES = 1_000_000
"""Beyond so many, a gzip file with more lines than compressed bytes is a bomb of blank lines."""
MALFORMED_SHARE = 0.05
"""A damaged disk spoils a line here and there; a file with more malformed lines is another kind."""
SOUND_START = 20
"""A file that begins with so many sound lines is a log, whatever follows."""

BLOCK_BYTES = 1 << 20
"""Lines are parsed so many at a time."""

NUMBER_CHARACTERS = b"+-.0123456789Ee naif"
"""What programs write numbers with; where there is more, Python and NumPy differ."""
ALL = Span(0, sys.maxsize)
"""The span of all of any file"""
NO_LOG = "this is no text log; check what the file is"


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
    """Lines of a text log that follow one another: kept as one text, since most are parsed so."""

    number: int
    """Of the first line"""
    text: bytes
    """The lines, each with its end, and `PADDING`"""
    starts: Int64
    """(S + 1,) where each line begins in the text, and where the padding does"""
    ended: bool
    """False for a block of only the last line, where that has no line end"""

    @classmethod
    def of(cls, number: int, parts: Sequence[bytes | memoryview], ended: bool = True) -> Self:
        """Find where the lines begin in a text, which comes in parts and ends with a line end."""
        text = b"".join((*parts, PADDING))
        if b"\r" in text:
            text = b"\n".join([line.rstrip(b"\r") for line in text.split(b"\n")])
        raw = np.frombuffer(text, np.uint8)[: -len(PADDING)]
        return cls(number, text, np.append(0, np.flatnonzero(raw == ord("\n")) + 1), ended)

    def __len__(self) -> int:
        """How many lines there are."""
        return len(self.starts) - 1

    def get_line(self, at: int) -> Line:
        """Get one of the lines."""
        start, end = self.starts[at : at + 2].tolist()
        return Line(self.number + at, self.text[start : end - 1], self.ended)

    def pick_lines(self, rows: Int64) -> Iterator[Line]:
        """Get some of the lines by their indices (S,)."""
        return map(self.get_line, rows.tolist())

    def list_heads(self) -> Iterator[bytes]:
        """Yield what each line begins with, up to its first blank."""
        for start, end in pairwise(self.starts.tolist()):
            yield self.text[start : end - 1].lstrip().partition(b" ")[0]


class Table(NamedTuple):
    """What S lines of N words each say."""

    values: Float64
    """(S, N), where a word is a number; NaN where nothing stands between two commas"""
    times: Int64
    """(S, N) ns, where a word is a time"""


class LineTally:
    """Counts the malformed ones among lines of one kind, to tell damage from a wrong file."""

    def __init__(self) -> None:
        self.total = 0
        self.malformed = 0
        self._first: tuple[int, int, str] | None = None

    def add(self, line: Line, fault: str = "") -> None:
        """Count a line; `fault` says what is wrong with it."""
        self.total += 1
        if fault:
            self.malformed += 1
            self._first = self._first or (self.total, line.number, fault)

    def judge(self, path: Path, notes: list[Note], fix: str) -> None:
        """Note what is damaged.

        Raises
        ------
        LogError
            The first line of all is malformed, or more than `MALFORMED_SHARE` of them where one of
            the first `SOUND_START` is and no damage is known that explains it.
        """
        if self._first is None:
            return
        at, number, fault = self._first
        is_many = self.malformed > MALFORMED_SHARE * self.total and at <= SOUND_START
        if at == 1 or (is_many and not any(note.damage for note in notes)):
            raise LogError(fault, where=f"{path}:{number}", fix=fix)
        count = f"{self.malformed} of {self.total} lines are malformed and left out"
        add_note(notes, Note(f"{count}, the first is line {number}: {fault}", damage=True))


def split_lines(
    path: Path, size: int, is_heading: Callable[[bytes], bool] = lambda _line: False
) -> list[Span]:
    """Cut a text file into spans of whole lines, of about so many bytes; gzip cannot be cut.

    Parameters
    ----------
    is_heading
        Whether a line may stand before the first that counts, which is in the first span.

    Raises
    ------
    LogError
        The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            if file.read(2) == MAGIC:
                return [ALL]
            file.seek(0)
            while is_heading(file.readline(MAX_LINE_BYTES)):
                pass
            heading, length = file.tell(), file.seek(0, 2)
            cuts = [0]
            for start in range(max(size, heading), length, size):
                file.seek(start - 1)
                file.readline(MAX_LINE_BYTES)
                cuts += [file.tell()] if cuts[-1] < file.tell() < length else []
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None
    return [Span(*ends) for ends in pairwise([*cuts, length])]


def read_blocks(path: Path, notes: list[Note], span: Span = ALL) -> Iterator[Block]:
    """Yield the lines of a UTF-8 text file, plain or gzip, or of a part of it, some at a time.

    Where gzip data is cut or corrupt, every complete line before the damage is given, and then a
    note says the rest.

    Raises
    ------
    LogError
        The file cannot be read, has a line beyond reason, or is a gzip bomb.
    """
    number, total, rest = 1, 0, b""
    try:
        size = path.stat().st_size
        limit, most_lines = max(FREE_EXPANSION_BYTES, MAX_EXPANSION * size), max(FREE_LINES, size)
        for piece in _read_pieces(path, span):
            text = piece if total else piece.removeprefix(BOM_UTF8)
            total += len(piece)
            if end := text.rfind(b"\n") + 1:
                block = Block.of(number, (rest, memoryview(text)[:end]))
                yield block
                number += len(block)
                rest = b""
            rest += text[end:]
            if len(rest) >= MAX_LINE_BYTES:
                raise LogError(f"no end of line within {len(rest)} bytes", where=path, fix=NO_LOG)
            if total > limit or number > most_lines:
                raise LogError(f"grows more than {MAX_EXPANSION}-fold", where=path, fix=NO_LOG)
        if rest:
            yield Block.of(number, (rest, b"\n"), ended=False)
    except GUNZIP_ERRORS as error:
        reason = "cut short" if isinstance(error, EOFError) else f"corrupt: {error}"
        lost = f"the gzip data is {reason}; all after line {number - 1} is lost"
        add_note(notes, Note(lost, damage=True))
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None


def _read_pieces(path: Path, span: Span) -> Iterator[bytes]:
    with path.open("rb", 0) as file:
        if file.read(len(MAGIC)) == MAGIC:
            file.seek(0)
            yield from gunzip(file)
            return
        file.seek(span.start)
        while piece := file.read(min(BLOCK_BYTES, span.end - file.tell())):
            yield piece


def parse_table(block: Block, rows: Int64, separator: bytes, kinds: UInt8) -> Table:
    """Parse those lines of a block, by their indices (S,), that hold the same kinds of words.

    Parameters
    ----------
    separator
        What stands between two words: one comma, or any number of blanks.
    kinds
        (N,) what each word of a line is, as `occmap.readers.kernels` lists them.

    Raises
    ------
    ValueError
        A line has more or fewer words, or one that is written as few programs write it.
    """
    from occmap.readers.kernels.decimals import POWERS, parse_rows  # noqa: PLC0415  late

    data = block.text
    if len(rows) * len(kinds) > len(data):  # every word has its separator
        raise ValueError("there are too few words in a line")
    eights = np.ndarray(len(data) - 7, "<u8", data, strides=(1,))
    values = np.empty((len(rows), len(kinds)))
    times = values.view(np.int64)
    left = np.empty((values.size // 8 + 64, 4), np.int64)
    raw, starts = np.frombuffer(data, np.uint8), block.starts[rows]
    count = parse_rows(raw, eights, starts, ord(separator), kinds, POWERS, values, times, left)
    if count < 0:
        raise ValueError("there are too few or too many words in a line, or many that are odd")
    for row, col, start, end in left[:count].tolist():
        word = data[start:end]
        if kinds[col] == NUMBER:
            values[row, col] = _parse_odd(word)
        else:
            parse = parse_stamp if kinds[col] == SECONDS else parse_nanoseconds
            times[row, col] = parse(word.decode("utf-8", "replace"))
    return Table(values, times)


@lru_cache(maxsize=64)
def _parse_odd(word: bytes) -> float:
    """Parse a number that few programs write so; a log repeats those of its laser in every line."""
    if word.translate(None, NUMBER_CHARACTERS):
        raise ValueError(f"{shorten(word.decode(errors='replace'))} where a number belongs")
    return float(word.strip() or "nan")


def stack_planar(x: Float64, y: Float64, yaw: Float64) -> Float64:
    """Build poses (S, 7) from places and headings (S,), as `Pose.planar` does.

    Where one of the three is not finite, nobody knew the pose.
    """
    poses = np.zeros((len(x), 7))
    is_known = np.isfinite(x + y + yaw)
    half = (np.where(is_known, yaw, 0.0) / 2).tolist()
    poses[:, 0], poses[:, 1] = x, y
    poses[:, 5], poses[:, 6] = list(map(math.sin, half)), list(map(math.cos, half))
    poses[~is_known] = UNKNOWN_POSE
    return poses


def make_planar(x: float, y: float, yaw: float) -> Pose:
    """Build one pose likewise."""
    return Pose.planar(x, y, yaw) if math.isfinite(x + y + yaw) else UNKNOWN_POSE


def parse_stamp(text: str) -> int:
    """Convert seconds, as text, to nanoseconds exactly; a float would round to 0.2 us.

    Raises
    ------
    ValueError
        The text is no number, or none that fits 64 bits of nanoseconds.
    """
    with suppress(ArithmeticError):  # what decimal raises for words and for NaN
        nanoseconds = Decimal(text).scaleb(9)
        if abs(nanoseconds) < 2**63:
            return round(nanoseconds)
    raise ValueError(f"{shorten(text)} is no time in seconds")


def parse_nanoseconds(text: str) -> int:
    """Convert whole nanoseconds, as text.

    Raises
    ------
    ValueError
        The text is no whole number, or none that fits 64 bits.
    """
    try:
        nanoseconds = int(text)
    except ValueError:
        nanoseconds = 2**63
    if abs(nanoseconds) < 2**63:
        return nanoseconds
    raise ValueError(f"{shorten(text)} is no time in nanoseconds")


def round_limit(limit: float) -> float:
    """Round a range limit as the ranges are, so that a range at the limit compares as equal."""
    return float(as_float32(limit))


def add_note(notes: list[Note], note: Note) -> None:
    """Add a note unless an earlier reading of the log has added it."""
    if note not in notes:
        notes.append(note)


def probe_lines(probe: Probe) -> list[str]:
    """Return the first lines of a file that may be text; the probe may end within the last."""
    if b"\0" in probe.content:
        return []
    return probe.content.decode("utf-8-sig", "replace").splitlines()


def note_cut_line(notes: list[Note], line: Line) -> None:
    """Say that the last line is not whole and was not used."""
    text = f"the file ends in the middle of line {line.number}; this line is lost"
    add_note(notes, Note(text, damage=True))
