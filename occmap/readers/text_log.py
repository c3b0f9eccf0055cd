"""Logs of lines, plain or gzip: lines that are alike are parsed together, all others one by one."""

import math
from abc import ABC, abstractmethod
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import GUNZIP_ERRORS, GZIP_MAGIC, NoteList, gunzip
from occmap.types import UNKNOWN_POSE, Float32, Float64, Int64, Pose, Scan, ScanRun, UInt8, UInt64

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


Parsed = TypeVar("Parsed")

ANY, SAME, SECONDS, NANOSECONDS, NUMBER, RANGE = range(6)
"""What a word of a line is: nothing that is asked for, the same in every line, a time in either
unit, a number, or the range of a beam."""
MALFORMED_SHARE = 0.05
"""A damaged disk spoils a line here and there; a file with more malformed lines is another kind."""
SOUND_START = 20
"""A file that begins with this many sound lines is a log, whatever follows."""


class Pattern(NamedTuple):
    """What lines that are parsed together have in common."""

    words: Sequence[bytes]
    """The words of one of them, N"""
    separator: bytes
    """What stands between two words: one comma, or any number of blanks"""
    kinds: UInt8
    """(N,) what each word is, ANY, SAME or another"""


class Table(NamedTuple):
    """The values of S lines of N words that share a pattern."""

    rows: Int64
    """(S,) which lines of the block they are"""
    ranges: Float32
    """(S, B) in the order in which they stand; NaN where nothing stands between two commas"""
    values: Float64
    """(N, S) other numbers, likewise, by word"""
    times: Int64
    """(N, S) ns, by word; only the rows of times mean anything, as in `values` only the others"""


class LineForm(Protocol):
    """How the lines of a log become scans."""

    def parse(self, text: str) -> Scan:
        """Parse a line; raises ValueError where it is malformed."""

    def find_pattern(self, line: Line) -> Pattern:
        """Say what lines like a sound one have in common; raises ValueError if that is unknown."""

    def make_run(self, first: Scan, table: Table) -> ScanRun:
        """Make scans of a table whose first is given; raises ValueError where one is malformed."""


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

    def judge(self, path: Path, notes: NoteList, fix: str) -> None:
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
            count = f" ({self.malformed:,} of {self.total:,} lines are malformed)"
            found = fault + (count if self.malformed > 1 else "")
            raise LogError(found, where=f"{path}:{number}", fix=fix)
        count = f"{self.malformed} of {self.total} lines are malformed and left out"
        notes.add_damage(f"{count}, the first is line {number}: {fault}")


class TextLog(ABC):
    """An opened log of lines: what logs of all text formats do."""

    form: LineForm

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._kept: list[Scan | ScanRun] | None = None
        """The scans of a log that were read when it was opened"""

    @abstractmethod
    def _read(self) -> Iterator[Scan | ScanRun]:
        """Yield all scans of the log.

        Raises
        ------
        LogError
            As `scans`.
        """

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order.

        Raises
        ------
        LogError
            The first line is malformed, or so many are that it is not damage.
        """
        for some in self.stacked_scans(topics):
            yield from some.split() if isinstance(some, ScanRun) else (some,)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The same, with many at once where only times, ranges and poses differ."""
        for some in self._read():
            if some.first.topic in topics and some.first.ranges.size:
                yield some

    def _parse_block(
        self, block: Block, lines: Mapping[str, Int64], tally: LineTally
    ) -> Sequence[Scan | ScanRun]:
        """Parse some lines, given by kind: the scans in file order, without damaged ones.

        Where all lines are of one kind and alike they are one run, else single scans.
        """
        scans: dict[int, Scan] = {}
        for rows in lines.values():
            if found := self._parse_together(block, rows):
                parsed, run = found
                if len(lines) == 1 and run.scans == len(rows):
                    tally.total += run.scans
                    return [run]
                scans |= zip(parsed.tolist(), run.split(), strict=True)
        for row in sorted(row for rows in lines.values() for row in rows.tolist()):
            if row in scans:
                tally.total += 1
            elif scan := self._parse(block.get_line(row), self.form.parse, tally):
                scans[row] = scan
        return [scans[row] for row in sorted(scans)]

    def _parse_together(self, block: Block, rows: Int64) -> tuple[Int64, ScanRun] | None:
        """Parse the lines of one kind that are like the first sound one; say which these are.

        None: there is no sound one, or its lines are of no pattern.
        """
        from occmap.readers import decimals  # noqa: PLC0415  late: it brings numba

        if len(rows) < 2 or (sound := self._find_sound(block, rows)) is None:
            return None
        at, first = sound
        rows = rows[at:]  # those before it are malformed
        with suppress(ValueError):  # of lines that state no times, or of which one is malformed
            pattern = self.form.find_pattern(block.get_line(int(rows[0])))
            table = decimals.parse_table(block, rows, pattern)
            # The kernel leaves out a few lines that `parse` takes; the first must not be one.
            if table.rows.size and table.rows[0] == rows[0]:
                return table.rows, self.form.make_run(first, table)
        return None

    def _find_sound(self, block: Block, rows: Int64) -> tuple[int, Scan] | None:
        """Find the first of some lines that can be parsed: its index among them, and its scan."""
        for at, line in enumerate(block.get_lines(rows)):
            with suppress(ValueError):
                return at, self.form.parse(line.text)
        return None

    def _parse(self, line: Line, parse: Callable[[str], Parsed], tally: LineTally) -> Parsed | None:
        """Parse a line and count it; one that is damaged gives None."""
        try:
            parsed = parse(line.text)
        except ValueError as error:
            if line.ended:
                tally.add(line, str(error))
            else:
                self._note_cut(line)
            return None
        tally.add(line)
        return parsed

    def _note_cut(self, line: Line) -> None:
        """Say that the last line is not whole and was not used."""
        text = f"the file ends in the middle of line {line.number}; this line is lost"
        self.notes.add_damage(text)


def stack_planar(x: Float64, y: Float64, yaw: Float64) -> Float64:
    """Build poses (S, 7) from places and headings (S,), as `Pose.planar` does.

    A pose of which one of the three is not finite is unknown.
    """
    poses = np.zeros((len(x), 7))
    with np.errstate(over="ignore", invalid="ignore"):  # a log may state any number
        is_known = np.isfinite(x + y + yaw)
    half = (np.where(is_known, yaw, 0.0) / 2).tolist()
    poses[:, 0], poses[:, 1] = x, y
    poses[:, 5], poses[:, 6] = list(map(math.sin, half)), list(map(math.cos, half))
    poses[~is_known] = UNKNOWN_POSE
    return poses


def make_planar(x: float, y: float, yaw: float) -> Pose:
    """Build one pose likewise."""
    return Pose.planar(x, y, yaw) if math.isfinite(x + y + yaw) else UNKNOWN_POSE
