"""Logs of lines, plain or gzip: lines that are alike are parsed together, all others one by one."""

import gzip
import math
import re
import zlib
from abc import ABC, abstractmethod
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import GZIP_MAGIC, Log, NoteList
from occmap.readers.decimals import Words, parse_words
from occmap.types import Float64, Int64, Scan, ScanBatch
from occmap.values import suspect_degrees

MAX_LINE_BYTES = 1 << 24
"""A scan of a million beams is shorter; a longer line is not of a text log."""
FREE_LINES = 1_000_000
"""A gzip file of more lines than this, and of more lines than bytes, is a bomb."""
BLOCK_BYTES = 1 << 20
"""How much of a file is read before its lines are parsed together."""
_PIECE_BYTES = 1 << 12
"""How much of a gzip file is unpacked at a time: where it is corrupt, so much may be lost."""
MAX_KEPT_BYTES = 1 << 26
"""The scans of a log that take no more memory are kept; larger logs are parsed once more."""
SCAN_BYTES = 700
"""What a scan takes beside its ranges, as measured."""
NO_LOG = "this is not a text log; check what the file is"
POSE_NAMES = ("x", "y", "yaw")
_LONE_CR = re.compile(rb"\r(?=[^\r\n])")
"""How a line of an old Mac ends, before another one"""


class Line(NamedTuple):
    """One line of a text log."""

    number: int
    raw: bytes
    """Without its line end"""

    @property
    def text(self) -> str:
        """The line as text; bytes that are no UTF-8 become U+FFFD, which no parser takes."""
        return self.raw.decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class Block:
    """Lines of a text log that follow one another, as one text, since most are parsed together."""

    number: int
    """Of the first line"""
    text: bytes
    """The lines, each with its line end"""
    starts: Int64
    """(S + 1,) where each line begins in the text, and where the last one ends"""

    def __len__(self) -> int:
        """How many lines there are."""
        return len(self.starts) - 1

    def get_line(self, at: int) -> Line:
        """Get one of the lines."""
        start, end = self.starts[at : at + 2].tolist()
        return Line(self.number + at, self.text[start : end - 1])


def make_block(number: int, text: bytes) -> Block:
    """Find where the lines begin in a text that ends with a line end."""
    if number == 1:
        text = text.removeprefix(BOM_UTF8)
    if b"\r" in text:
        text = text.replace(b"\r\n", b"\n")
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
    return Block(number, text, np.append(0, ends + 1))


def read_blocks(path: Path, notes: NoteList, table: bytes | None = None) -> Iterator[Block]:
    """Yield the lines of a UTF-8 text file, plain or gzip, in blocks, translated by a table.

    Where gzip data is cut or corrupt, the complete lines before the damage are given, and a note
    says what is lost. A last line without a line end may be cut, so a note names it.

    Raises
    ------
    LogError
        The file cannot be read, has a line beyond reason, or is a gzip bomb.
    """
    with refuse_unreadable(path):
        most_lines = max(FREE_LINES, path.stat().st_size)
    text, number = bytearray(), 1
    damage: list[str] = []
    for piece in chain(_read_pieces(path, damage), [b""]):
        text += piece
        end = text.rfind(b"\n") + 1
        is_block = len(text) >= BLOCK_BYTES or not piece
        if is_block and number == 1 and len(_LONE_CR.findall(text)) > text.count(b"\n"):
            fix = r"end them in LF, as `tr '\r' '\n'` does"
            raise LogError("its lines end in CR alone", where=path, fix=fix)
        if end and is_block:
            whole = bytes(memoryview(text)[:end])
            block = make_block(number, whole.translate(table) if table else whole)
            yield block
            number += len(block)
            del text[:end]
        if not end and len(text) >= MAX_LINE_BYTES:
            raise LogError(f"no end of line within {len(text)} bytes", where=path, fix=NO_LOG)
        if number > most_lines:
            raise LogError(f"{number:,} lines, more than it has bytes", where=path, fix=NO_LOG)
    if damage:
        notes.add_damage(f"the gzip data is {damage[0]}; all after line {number - 1} is lost")
    elif text:
        notes.add(f"line {number}, the last, has no line end: the file may be cut there")
        yield make_block(number, bytes(text + b"\n").translate(table))


def _read_pieces(path: Path, damage: list[str]) -> Iterator[bytes]:
    """Yield the content of a file, unpacked; add to `damage` what is wrong with gzip data."""
    with refuse_unreadable(path), path.open("rb") as file:
        is_packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        source = gzip.GzipFile(fileobj=file) if is_packed else file
        try:
            while piece := source.read1(_PIECE_BYTES if is_packed else BLOCK_BYTES):
                yield piece
        except EOFError:
            damage.append("cut short")
        except (zlib.error, gzip.BadGzipFile) as error:
            damage.append(f"corrupt: {error}")


PickLines: TypeAlias = Callable[[Block], Mapping[str, Sequence[int]]]
"""Finds lines of a block, by their kind"""


class Pattern(NamedTuple):
    """What lines that are parsed together have in common."""

    separator: bytes
    """What stands between two words: one comma, or any number of blanks"""
    kinds: Int64
    """(N,) what each word is, as `decimals` has it"""
    names: Sequence[str]
    """(N,) how a sentence about each word begins"""
    columns: Mapping[str, int]
    """Which words are stamp, stamp_nsec (added to it), record (the second time), x, y, yaw and
    time_increment"""
    constants: Mapping[str, Any]
    """Those of these numbers that stand for all lines"""
    scan: Scan
    """What is the same in all scans; whether it has a pose says whether they have"""

    def make_run(self, words: Words) -> ScanBatch:
        """Make scans of the words of lines."""

        def take(name: str) -> Float64:
            at = self.columns.get(name)
            constant = self.constants.get(name, math.nan)
            return np.full(len(words.ranges), constant) if at is None else words.numbers[at].copy()

        stamp_ns = np.full(len(words.ranges), self.scan.stamp_ns)
        if "stamp" in self.columns:
            stamp_ns = words.times[self.columns["stamp"]].copy()
        if "stamp_nsec" in self.columns:
            stamp_ns += words.times[self.columns["stamp_nsec"]]
        # Converters write 0 where they know no second time.
        record_ns = words.times[self.columns["record"]] if "record" in self.columns else stamp_ns
        record_ns = np.where(record_ns, record_ns, stamp_ns)
        increments = take("time_increment")
        increments[~np.isfinite(increments)] = 0  # it says nothing, and the scan is none the worse
        pose = None if self.scan.pose is None else stack_planar(*map(take, POSE_NAMES))
        times = {"stamp_ns": stamp_ns, "record_ns": record_ns, "time_increment": increments}
        return ScanBatch.like(self.scan, **times, ranges=words.ranges, pose=pose)


class TextLog(Log, ABC):
    """An opened log of lines: what logs of all text formats do.

    A log is parsed when it is opened, so that it is known how many of its lines are scans. A format
    says which lines are scans and how they are parsed, and calls `_survey`.
    """

    fix: ClassVar[str]
    """What to do where all lines are malformed"""
    table: bytes | None = None
    """What each byte of the text stands for, where that is not itself"""

    def __init__(self, path: Path) -> None:
        self.path, self.notes = path, NoteList()
        self._kept: list[Scan | ScanBatch] | None = []
        """The scans, where they are few enough to be kept"""

    @abstractmethod
    def pick_scans(self, block: Block) -> Mapping[str, Sequence[int]]:
        """Find the lines of a block that are scans, by their kind."""

    @abstractmethod
    def find_pattern(self, line: Line) -> Pattern:
        """Say what lines like one have in common; raises ValueError where it is malformed."""

    def _survey(self, pick: PickLines) -> Iterator[Scan | ScanBatch]:
        """Give all scans for the first time, and keep them if they are few.

        Raises
        ------
        LogError
            All lines are malformed.
        """
        size = 0
        for some in self._parse_all(pick):
            size += SCAN_BYTES * some.scans + some.ranges.nbytes
            if self._kept is not None:
                self._kept.append(some)
            if size > MAX_KEPT_BYTES:
                self._kept = None
            yield some

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanBatch]:
        """The scans of some topics, many at once where only times, ranges and poses differ."""
        for some in self._parse_all(self.pick_scans) if self._kept is None else self._kept:
            if some.topic in topics and some.ranges.size:
                yield some

    def _parse_all(self, pick: PickLines) -> Iterator[Scan | ScanBatch]:
        """Parse the lines that are picked from each block, given by kind.

        Raises
        ------
        LogError
            All of them are malformed.
        """
        total = malformed = 0
        first = 0, ""
        for block in read_blocks(self.path, self.notes, self.table):
            lines = pick(block)
            faults: dict[int, str] = {}
            yield from self._parse_block(block, lines, faults)
            total += sum(map(len, lines.values()))
            if faults and not malformed:
                first = block.number + min(faults), faults[min(faults)]
            malformed += len(faults)
        number, fault = first
        if 0 < malformed < total:
            found = f"{malformed} of {total} lines are malformed and left out"
            self.notes.add_damage(f"{found}, the first is line {number}: {fault}")
        elif malformed:
            many = f" ({malformed:,} of {total:,} lines are malformed)" if malformed > 1 else ""
            raise LogError(fault + many, where=f"{self.path}:{number}", fix=self.fix)

    def _parse_block(
        self, block: Block, lines: Mapping[str, Sequence[int]], faults: dict[int, str]
    ) -> Sequence[Scan | ScanBatch]:
        """Parse some lines, given by kind: the scans in file order, without damaged ones.

        Where all lines are alike they are one run, else single scans. What is malformed is added
        to `faults`.
        """
        runs = [run for rows in lines.values() for run in self._parse_kind(block, rows, faults)]
        if len(runs) == 1:
            return [runs[0][1]]
        scans = {row: one for rows, run in runs for row, one in zip(rows, run.split(), strict=True)}
        return [scans[row] for row in sorted(scans)]

    def _parse_kind(
        self, block: Block, rows: Sequence[int], faults: dict[int, str]
    ) -> Iterator[tuple[Sequence[int], ScanBatch]]:
        """Parse lines of one kind: at once the first and those that are like it, then the others.

        What is malformed is left out, and added to `faults`.
        """
        rest = np.array(rows)
        while len(rest):
            first = int(rest[0])
            try:
                pattern = self.find_pattern(block.get_line(first))
            except ValueError as error:
                faults[first] = str(error)
                rest = rest[1:]
                continue
            words, found = parse_words(block.text, block.starts[rest], *pattern[:3])
            alike = rest[words.alike].tolist()
            rest = np.delete(rest, words.alike)
            faults |= {alike[line]: fault for line, fault in found.items()}
            yaw = words.numbers[pattern.columns["yaw"]] if "yaw" in pattern.columns else ()
            if doubt := suspect_degrees(yaw):
                self.notes.add(doubt)
            if sound := [line for line in range(len(alike)) if line not in found]:
                run = pattern.make_run(words.take(sound) if found else words)
                yield [alike[line] for line in sound], run


def stack_planar(x: Float64, y: Float64, yaw: Float64) -> Float64:
    """Build poses (S, 7) from places and headings (S,), as `Pose.planar` does."""
    half = np.where(np.isfinite(yaw), yaw / 2, math.nan).tolist()  # infinity has no sine
    poses = np.zeros((len(x), 7))
    poses[:, 0], poses[:, 1] = x, y
    poses[:, 5], poses[:, 6] = list(map(math.sin, half)), list(map(math.cos, half))
    return poses
