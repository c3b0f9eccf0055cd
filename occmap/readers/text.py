"""What the text formats share: lines of a plain or gzip file, exact times, notes on damage."""

import io
import math
import sys
from codecs import BOM_UTF8
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np

from occmap.errors import LogError
from occmap.readers import Note, Probe, Span
from occmap.readers.gunzip import GUNZIP_ERRORS, MAGIC, GunzipStream
from occmap.types import UNKNOWN_POSE, Float64, Int64, as_float32

Item = TypeVar("Item")

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
READ_BYTES = 1 << 20
LINE_BYTES = 200
"""What a `Line` takes in memory beside its text."""

NUMBER_CHARACTERS = b"+-.0123456789Ee naif"
"""What programs write numbers with; where there is more, Python and NumPy differ."""
ALL = Span(0, sys.maxsize)
"""Of any file"""
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


class Table(NamedTuple):
    """The numbers of lines that hold as many each."""

    values: Float64
    """(S, N)"""
    places: Int64
    """(S, 2) where in their lines the numbers begin and end"""


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
        with _open_bytes(path) as file:
            if not isinstance(file.raw, io.FileIO):
                return [ALL]
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


def read_lines(path: Path, notes: list[Note], span: Span = ALL) -> Iterator[Line]:
    """Yield the lines of a UTF-8 text file, plain or gzip, or of a part of it, one at a time.

    Where gzip data is cut or corrupt, every complete line before the damage is given and a note
    says the rest.

    Raises
    ------
    LogError
        The file cannot be read, has a line beyond reason, or is a gzip bomb.
    """
    number = 0
    try:
        with _open_bytes(path) as file:
            if span.start:
                file.seek(span.start)
            for number, raw in enumerate(_split_lines(file, path, span), start=1):
                line = raw.removeprefix(BOM_UTF8) if number == 1 else raw
                yield Line(number, line.rstrip(b"\r\n"), raw.endswith(b"\n"))
    except GUNZIP_ERRORS as error:
        reason = "cut short" if isinstance(error, EOFError) else f"corrupt: {error}"
        text = f"the gzip data is {reason}; all after line {number} is lost"
        add_note(notes, Note(text, damage=True))
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None


def cut_blocks(items: Iterable[Item], get_raw: Callable[[Item], bytes]) -> Iterator[list[Item]]:
    """Cut items that hold a line each into lists that take a bounded part of the memory."""
    block: list[Item] = []
    size = 0
    for item in items:
        block.append(item)
        size += LINE_BYTES + len(get_raw(item))
        if size >= BLOCK_BYTES:
            yield block
            block, size = [], 0
    if block:
        yield block


def is_worthwhile(lines: Sequence[bytes]) -> bool:
    """Whether to parse lines together: numba takes as long to load as 3 MB one by one."""
    return "numba" in sys.modules or sum(map(len, lines)) > BLOCK_BYTES // 2


def parse_table(lines: Sequence[bytes], separator: bytes, head: int, columns: int) -> Table:
    """Parse the numbers in lines.

    Parameters
    ----------
    separator
        What stands between two words: one comma, or any number of blanks.
    head, columns
        How many words come before the numbers, and how many numbers there are.

    Raises
    ------
    ValueError
        A line has fewer numbers, or one that is written as few programs write numbers.
    """
    from occmap.readers.kernels.decimals import PADDING, POWERS, parse_rows  # noqa: PLC0415  late

    data = b"\n".join(lines) + PADDING
    eights = np.ndarray(len(data) - 7, "<u8", data, strides=(1,))
    values = np.empty((len(lines), columns))
    places = np.empty((len(lines), 2), np.int64)
    left = np.empty((values.size // 8 + 64, 4), np.int64)
    raw = np.frombuffer(data, np.uint8)
    count = parse_rows(raw, eights, ord(separator), head, POWERS, values, places, left)
    if count < 0:
        raise ValueError("there are too few numbers in a line, or too many that are odd")
    for row, col, start, end in left[:count].tolist():
        word = data[start:end]
        if word.translate(None, NUMBER_CHARACTERS):
            raise ValueError(f"{shorten(word.decode(errors='replace'))} where a number belongs")
        values[row, col] = float(word.strip() or "nan")
    lengths = np.fromiter(map(len, lines), np.int64, len(lines))
    return Table(values, places - (np.cumsum(lengths + 1) - lengths - 1)[:, None])


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


def _open_bytes(path: Path) -> io.BufferedReader:
    file: io.BufferedReader = io.BufferedReader(path.open("rb", 0), READ_BYTES)
    if not file.peek(2).startswith(MAGIC):
        return file
    return io.BufferedReader(GunzipStream(file), READ_BYTES)


def _split_lines(file: BinaryIO, path: Path, span: Span) -> Iterator[bytes]:
    """Read line by line within bounds, as a bomb may hide in one line or in many."""
    size = path.stat().st_size
    limit, most_lines = max(FREE_EXPANSION_BYTES, MAX_EXPANSION * size), max(FREE_LINES, size)
    total = lines = 0
    while raw := file.readline(MAX_LINE_BYTES):
        total += len(raw)
        lines += 1
        if len(raw) == MAX_LINE_BYTES:
            raise LogError(f"no end of line within {len(raw)} bytes", where=path, fix=NO_LOG)
        if total > limit or lines > most_lines:
            raise LogError(f"grows more than {MAX_EXPANSION}-fold", where=path, fix=NO_LOG)
        yield raw
        if span.start + total >= span.end:
            return


def parse_stamp(text: str) -> int:
    """Convert seconds, as text, to nanoseconds exactly; a float would round to 0.2 us.

    Raises
    ------
    ValueError
        The text is no number, or none that fits 64 bits of nanoseconds.
    """
    seconds, _, part = text.partition(".")
    with suppress(ArithmeticError):  # what decimal raises for words and for NaN
        if len(seconds) <= 10 and len(part) <= 9 and text.isascii() and (seconds + part).isdigit():
            # As nearly all times are written: a third of the time that decimal takes.
            nanoseconds: Any = int(seconds + part.ljust(9, "0"))
        else:
            nanoseconds = Decimal(text).scaleb(9)
        if abs(nanoseconds) < 2**63:
            whole: int = round(nanoseconds)
            return whole
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


def shorten(text: str) -> str:
    """Quote what was found, for a message of one line."""
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


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
