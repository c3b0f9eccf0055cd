"""What the text formats share: blocks of lines, parsed together or one by one; notes on damage."""

import math
import sys
from abc import ABC, abstractmethod
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from occmap.errors import LogError
from occmap.readers import Note, NoteList, Probe, Span, make_part
from occmap.readers.gunzip import GUNZIP_ERRORS, MAGIC, gunzip
from occmap.readers.kernels import NUMBER, PADDING, RANGE, SAME, SECONDS
from occmap.types import (
    UNKNOWN_POSE,
    Float32,
    Float64,
    Int64,
    Pose,
    Scan,
    ScanRun,
    UInt8,
    as_float32,
    parse_nanoseconds,
    parse_seconds,
    shorten,
)

Parsed = TypeVar("Parsed")

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
    """Lines of a text log that follow one another: kept as one text, since most are parsed so.

    The next block takes its place in memory, as fresh memory costs as much time as parsing.
    """

    number: int
    """Of the first line"""
    text: bytearray
    """The lines, each with its end, and at least as many bytes as `PADDING` has"""
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
        eights = np.flatnonzero(is_end.view(np.uint64) != 0)  # few hold any, and NumPy looks slowly
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

    def pick_lines(self, rows: Int64) -> Iterator[Line]:
        """Get some of the lines by their indices (S,)."""
        return map(self.get_line, rows.tolist())

    def take_heads(self, width: int) -> NDArray[np.bytes_]:
        """Take the first bytes of each line, (S,); those of a short one reach into the next."""
        heads = np.ndarray(len(self.text) - width + 1, f"S{width}", self.text, strides=(1,))
        return heads[self.starts[:-1]]


@dataclass(frozen=True, slots=True)
class Pattern:
    """What lines that are parsed together have in common."""

    separator: bytes
    """What stands between two words: one comma, or any number of blanks"""
    kinds: UInt8
    """(N,) what each word of a line is, as `occmap.readers.kernels` lists them"""
    beams: Int64
    """(N,) of which beam each range is"""
    same: bytes
    """The words that are the same in every line, each with a separator behind it"""

    @classmethod
    def of(cls, words: list[bytes], separator: bytes, kinds: UInt8, beams: Int64) -> Self:
        """Take the words that are the same from those of one line; raises ValueError of others."""
        if len(words) != len(kinds):
            raise ValueError("there are too few or too many words")
        same = [words[at] + separator for at in np.flatnonzero(kinds == SAME).tolist()]
        return cls(separator, kinds, beams, b"".join(same))


class Table(NamedTuple):
    """What S lines of N words say that are of one pattern."""

    rows: Int64
    """(S,) which lines of the block they are"""
    ranges: Float32
    """(S, B); NaN where nothing stands between two commas"""
    values: Float64
    """(N, S) other numbers, likewise"""
    times: Int64
    """(N, S) ns, where a word is a time"""


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
            more = f", and {self.malformed - 1:,} more of {self.total:,} lines are malformed"
            found = fault + (more if self.malformed > 1 else "")
            raise LogError(found, where=f"{path}:{number}", fix=fix)
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
    number, total, begun = 1, 0, 0  # begun: how much there is of a line whose end is to come
    try:
        size = path.stat().st_size
        limit, most_lines = max(FREE_EXPANSION_BYTES, MAX_EXPANSION * size), max(FREE_LINES, size)
        for text, filled in _gather_text(_read_pieces(path, span)):
            total += filled - begun
            if end := text.rfind(b"\n", begun, filled) + 1:
                block = Block.of(number, text, end)
                yield block
                number += len(block)
            begun = filled - end
            if begun >= MAX_LINE_BYTES:
                raise LogError(f"no end of line within {begun} bytes", where=path, fix=NO_LOG)
            if total > limit or number > most_lines:
                raise LogError(f"grows more than {MAX_EXPANSION}-fold", where=path, fix=NO_LOG)
        if begun:
            text[begun] = ord("\n")
            yield Block.of(number, text, begun + 1, ended=False)
    except GUNZIP_ERRORS as error:
        reason = "cut short" if isinstance(error, EOFError) else f"corrupt: {error}"
        lost = f"the gzip data is {reason}; all after line {number - 1} is lost"
        add_note(notes, Note(lost, damage=True))
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None


def _gather_text(pieces: Iterator[bytes | memoryview]) -> Iterator[tuple[bytearray, int]]:
    """Yield text, and how much of it is there; what follows its last line end begins the next."""
    text, begun = bytearray(2 * BLOCK_BYTES), 0
    for piece in pieces:
        filled = begun + len(piece)
        if filled + len(PADDING) > len(text):
            text = text + bytes(filled + len(PADDING))
        memoryview(text)[begun:filled] = piece
        yield text, filled
        begun = filled - (text.rfind(b"\n", begun, filled) + 1)
        text[:begun] = text[filled - begun : filled]


def _read_pieces(path: Path, span: Span) -> Iterator[bytes | memoryview]:
    """Yield what is in a file, unpacked; the next piece may take the place of the one before."""
    with path.open("rb", 0) as file:
        if file.read(len(MAGIC)) == MAGIC:
            file.seek(0)
            yield from gunzip(file)
            return
        file.seek(span.start)
        piece = memoryview(bytearray(BLOCK_BYTES))
        while size := file.readinto(piece[: span.end - file.tell()]):
            yield piece[:size]


def parse_table(block: Block, rows: Int64, pattern: Pattern) -> Table:
    """Parse those of some lines, by their indices (S,), that are of a pattern.

    Lines that are not are left out, and so are some that hold words that few programs write.
    """
    from occmap.readers.kernels.decimals import POWERS, parse_rows  # noqa: PLC0415  late

    data, kinds, beams = block.text, pattern.kinds, pattern.beams
    rows = rows[: len(data) // len(kinds)]  # every word has its separator
    ranges = np.empty((len(rows), np.count_nonzero(kinds == RANGE)), np.float32)
    values = np.empty((len(kinds), len(rows)))
    times, alike = values.view(np.int64), np.zeros(len(rows), np.bool_)
    left = np.empty((values.size // 8 + 64, 4), np.int64)
    count = parse_rows(
        np.frombuffer(data, np.uint8),
        np.ndarray(len(data) - 7, "<u8", data, strides=(1,)),
        block.starts[rows],
        ord(pattern.separator),
        kinds,
        beams,
        np.frombuffer(pattern.same + PADDING, np.uint8),
        POWERS,
        ranges,
        values,
        times,
        alike,
        left,
    )
    for row, col, start, end in left[:count].tolist():
        word, kind = bytes(data[start:end]), kinds[col]
        try:
            if kind == RANGE:
                ranges[row, beams[col]] = as_float32(_parse_odd(word))
            elif kind == NUMBER:
                values[col, row] = _parse_odd(word)
            else:
                parse = parse_seconds if kind == SECONDS else parse_nanoseconds
                times[col, row] = parse(word.decode("utf-8", "replace"))
        except ValueError:
            alike[row] = False
    if not alike.all():
        rows, ranges, values = rows[alike], ranges[alike], values[:, alike]
    return Table(rows, ranges, values, values.view(np.int64))


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


class TextLog(ABC):
    """An opened log of lines: what logs of all text formats do.

    Lines of one kind are parsed together as far as they are like the first sound one, and all
    others one by one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = NoteList()
        self._span = ALL
        self._kept: list[Scan | ScanRun] | None = None
        """The scans of a log that were read when it was opened"""

    @abstractmethod
    def _walk(self, span: Span) -> Iterator[tuple[Block, Mapping[str, Int64]]]:
        """Yield blocks, and which of their lines are scans, (S,) of each kind."""

    @abstractmethod
    def _parse_scan(self, text: str) -> Scan:
        """Parse a line; raises ValueError where it is malformed."""

    @abstractmethod
    def _find_pattern(self, line: Line, scan: Scan) -> Pattern:
        """Say what lines like one that is sound have in common; raises ValueError of odd ones."""

    @abstractmethod
    def _make_run(self, first: Scan, table: Table) -> ScanRun:
        """Make scans of what lines like the first say; raises ValueError where one is malformed."""

    @abstractmethod
    def _tell(self, line: Line, fault: str, tally: LineTally) -> None:
        """Count a line that is malformed."""

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order.

        Raises
        ------
        LogError
            The first line is malformed, or so many are that this is no damage.
        """
        for some in self.stacked_scans(topics):
            yield from some.split() if isinstance(some, ScanRun) else (some,)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The same, with many at once where only times, ranges and poses differ."""
        tally = LineTally()
        read = (some for each in self._walk(self._span) for some in self._parse_block(*each, tally))
        for some in read if self._kept is None else self._kept:
            if some.first.topic in topics and some.first.ranges.size:
                yield some

    def split(self, size: int) -> Sequence[Self]:
        """Cut the log into parts of about `size` bytes, as `occmap.readers.Splittable` says."""
        damaged = any(note.damage for note in self.notes)
        spans = [ALL] if damaged else split_lines(self.path, size, self._is_heading)
        return [make_part(self, _span=span, _kept=None) for span in spans]

    def _is_heading(self, _raw: bytes) -> bool:
        """Whether a line may stand before the first that counts."""
        return False

    def _parse_block(
        self, block: Block, kinds: Mapping[str, Int64], tally: LineTally
    ) -> Iterator[Scan | ScanRun]:
        """Yield the scans in some lines, in the order of the log, passing over damaged ones."""
        scans: dict[int, Scan] = {}
        for rows in kinds.values():
            if found := self._parse_together(block, rows):
                at, run = found
                if len(kinds) == 1 and run.scans == len(rows):
                    tally.total += run.scans
                    yield run
                    return
                scans |= zip(at, run.split(), strict=True)
        for at in sorted(at for rows in kinds.values() for at in rows.tolist()):
            if at in scans:
                tally.total += 1
                yield scans[at]
            elif scan := self._parse(block.get_line(at), self._parse_scan, tally):
                yield scan

    def _parse_together(self, block: Block, rows: Int64) -> tuple[list[int], ScanRun] | None:
        """Parse those lines of one kind that are like the first sound one; say which they are."""
        if len(rows) < 2:
            return None
        for line in block.pick_lines(rows):
            with suppress(ValueError):
                first = self._parse_scan(line.text)
                break
        else:
            return None
        with suppress(ValueError):
            table = parse_table(block, rows, self._find_pattern(line, first))
            if line.number in block.number + table.rows[:1]:
                return table.rows.tolist(), self._make_run(first, table)
        return None

    def _parse(self, line: Line, parse: Callable[[str], Parsed], tally: LineTally) -> Parsed | None:
        """Parse a line and count it; one that is damaged gives None."""
        try:
            parsed = parse(line.text)
        except ValueError as error:
            if line.ended:
                self._tell(line, str(error), tally)
            else:
                note_cut_line(self.notes, line)
            return None
        tally.add(line)
        return parsed
