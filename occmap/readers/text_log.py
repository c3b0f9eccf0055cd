"""Logs of lines: lines that are alike are parsed together, all others one by one.

The way of a line from the file to a `Scan`:

1. `text.read_blocks` reads the file in blocks of lines.
2. `_read` of the format says which lines of a block are scans, and of which kind.
3. `_parse_together` lets the format's `parse` make a `Scan` of the first sound line of each kind.
   From that line, `find_pattern` says what each word of lines like it is.
4. `decimals.parse_table` has all lines of that pattern parsed by a kernel, and `make_run`
   makes a `ScanRun` of the table.
5. `_parse_block` gives every line that does not fit the pattern to `parse`, one by one.

Malformed lines are counted. All lines of a log together show whether it is damaged, or a file of
another kind (`LineTally.judge`). A CARMEN log is judged when it is opened, as it is parsed then. A
CSV is judged when the first malformed row turns up: then all its rows are parsed once more.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from occmap.errors import LogError
from occmap.readers import NoteList
from occmap.readers.text import Block, Line
from occmap.types import UNKNOWN_POSE, Float32, Float64, Int64, Pose, Scan, ScanRun, UInt8

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
