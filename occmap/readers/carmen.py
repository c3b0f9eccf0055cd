"""Reads logs of the CARMEN toolkit: text, one message a line; `carmen_lines` has the formats."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from occmap.readers import Role, Stream
from occmap.readers.carmen_lines import (
    POSED,
    SCAN_LINES,
    USUAL_BEAMS,
    CarmenForm,
    imply_increment,
    parse_front_offset,
    parse_odometry,
)
from occmap.readers.probing import Probe
from occmap.readers.text import Block, Line, read_blocks
from occmap.readers.text_log import LineTally, TextLog
from occmap.report.words import count
from occmap.types import Int64, PoseSample, Scan, ScanRun
from occmap.values import shorten

# fmt: off
OTHER_WORDS = frozenset({
    "PARAM", "SYNC", "COMMENT", "TRUEPOS", "GLOBALPOS", "NEFF", "SONAR", "BUMPER", "IMU", "LASER3",
    "LASER4", "RAWLASER3", "RAWLASER4", "SCANMARK", "POSITIONLASER", "NMEAGGA", "NMEARMC",
    "VERTEX2", "EDGE2", "VERTEX_SE2", "EDGE_SE2",
})
# fmt: on
"""Lines that are common in these logs (the last ones are g2o's) and hold no scan or pose."""
MAX_WORDS = 100
"""Keywords that are counted one by one; the many of a damaged file must not fill the memory."""
MOST_LETTERS = 64
"""How much of a line is searched for its keyword; a longer word is cut."""
LONGER = " "
"""Stands for the keyword of a line that its first eight bytes do not tell."""
MAX_KEPT_BYTES = 1 << 26
"""The scans of a log that take no more memory are kept; larger logs are parsed once more."""
TELLING_LINE = re.compile(rf"#.*message formats defined|\s*({'|'.join(SCAN_LINES)}|ODOM)\s+-?\.?\d")
"""By what a line of a CARMEN log is known: a keyword and a number, or how its comments begin."""
WHOLE_MESSAGE = re.compile(r"\S+\s+\S+\s+\S.*\s(?![-+.\d])\S+\s+[-+.e\d]+\s*")
"""A keyword, two words or more, the name of a host, and a time."""
FIX = "correct or delete this line"
NO_LINES: Int64 = np.zeros(0, np.int64)
SCAN_BYTES = 700
"""What a scan takes beside its ranges, as measured."""


class CarmenReader:
    """CARMEN logs."""

    name = "carmen"
    description = "CARMEN text logs (FLASER, RLASER, ROBOTLASER1, RAWLASER1 + ODOM), plain or gzip"

    def recognises(self, probe: Probe) -> bool:
        """Whether the first lines are CARMEN messages; a keyword within a text does not count."""
        lines = probe.lines
        if any(map(TELLING_LINE.match, lines)):
            return True
        # A log may begin with pages of parameters; the probe may end within its last line.
        words = [line.split(None, 1)[0] for line in lines if line.strip() and line[0] != "#"]
        return len(words) > 3 and all(word in OTHER_WORDS for word in words[:-1])

    def open(self, path: Path) -> "CarmenLog":
        """Open a log and read it once.

        Raises
        ------
        LogError
            The first scan line is malformed, or so many are that it is not damage.
        """
        return CarmenLog(path)


class CarmenLog(TextLog):
    """An opened CARMEN log; a stream is a keyword."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.form = CarmenForm()
        self._words: Counter[str] = Counter()
        """How many lines begin with each keyword; # stands for every comment"""
        self._front_offset: PoseSample | None = None
        self._stamps: set[int] = set()
        self._size = 0
        self._kept = []
        self._survey()
        frames = {word: SCAN_LINES[word].frame for word in self._words if word in SCAN_LINES}
        posed = {frames[word] for word in frames.keys() & POSED}
        self._repeated = [word for word in frames if word not in POSED and frames[word] in posed]
        """RAWLASER streams whose scans are in the log once more, with their pose"""
        self._note_other_lines()

    @property
    def streams(self) -> Sequence[Stream]:
        """One stream for each keyword, in order of first appearance."""
        roles = {**dict.fromkeys(SCAN_LINES, Role.SCAN), "ODOM": Role.POSE}
        roles |= dict.fromkeys(self._repeated, Role.OTHER)
        words = ((word, n) for word, n in self._words.items() if word != "#")
        return [Stream(word, word, n, roles.get(word, Role.OTHER)) for word, n in words]

    def poses(self) -> Iterator[PoseSample]:
        """Give the front laser's offset, where a PARAM states it, then the odometry."""
        if self._front_offset is not None:
            yield self._front_offset
        if not self._words["ODOM"]:
            return
        tally = LineTally()
        for block in read_blocks(self.path, self.notes):
            for line in block.get_lines(_sort_lines(block).get("ODOM", NO_LINES)):
                if sample := self._parse(line, parse_odometry, tally):
                    yield sample
        tally.judge(self.path, self.notes, FIX)

    def _read(self) -> Iterator[Scan | ScanRun]:
        """Yield all scans; they were judged when the log was opened."""
        if self._kept is not None:
            yield from self._kept
            return
        for block in read_blocks(self.path, self.notes):
            yield from self._parse_block(block, _pick_scans(_sort_lines(block)), LineTally())

    def _survey(self) -> None:
        """Read the log once: count its lines, and keep its scans if they are few."""
        tally = LineTally()
        for block in read_blocks(self.path, self.notes):
            if not block.ended and _is_cut(block.get_line(0)):
                self._note_cut(block.get_line(0))
                continue
            lines = _sort_lines(block)
            self._count_words(lines)
            for line in block.get_lines(lines.get("PARAM", NO_LINES)):
                if self._front_offset is None:
                    self._front_offset = self._parse(line, parse_front_offset, tally)
            for some in self._parse_block(block, _pick_scans(lines), tally):
                self._survey_scans(some)
        self._words = +self._words  # drops keywords of which no line was a scan
        tally.judge(self.path, self.notes, FIX)
        if len(self._stamps) == 1 and sum(self._words[word] for word in POSED) > 1:
            self.notes.add("all scans have one time: they are taken in their order")

    def _count_words(self, lines: Mapping[str, Int64]) -> None:
        """Count lines by their keyword; scans are counted when they have been parsed."""
        for word, rows in lines.items():
            if word in SCAN_LINES:
                self._words[word] += 0  # streams are listed in the order in which they appear
            elif word:
                known = word in self._words or len(self._words) < MAX_WORDS
                self._words[word[:40] if known else "other"] += len(rows)

    def _survey_scans(self, some: Scan | ScanRun) -> None:
        first, beams = some.first, some.first.ranges.size
        if not beams:
            self._words[f"{first.topic} without beams"] += some.scans
            return
        self._words[first.topic] += some.scans
        if len(self._stamps) < 2:
            self._stamps.update(np.atleast_1d(some.stamp_ns).tolist())
        self._size += SCAN_BYTES * some.scans + some.ranges.nbytes
        if self._size > MAX_KEPT_BYTES:
            self._kept = None
        if self._kept is not None:
            self._kept.append(some)
        if not SCAN_LINES[first.topic].before and beams not in USUAL_BEAMS:
            spacing = f"{math.degrees(imply_increment(beams)):g} deg apart, from -90 deg"
            text = f"{first.topic} states no angles: {beams} beams are read as {spacing}"
            self.notes.add(text)

    def _note_other_lines(self) -> None:
        for word in self._repeated:
            text = f"{word} repeats scans that the log holds with their pose; it is left out"
            self.notes.add(text)
        used = {*SCAN_LINES, "ODOM"}
        others = Counter({word: n for word, n in self._words.items() if word not in used})
        if others:
            top = ", ".join(_count_lines(word, n) for word, n in others.most_common(5))
            more = ", ..." if len(others) > 5 else ""
            lines = count(others.total(), "line")
            self.notes.add(f"{lines} without scan or pose passed over: {top}{more}")


def _sort_lines(block: Block) -> dict[str, Int64]:
    """Find the lines of each keyword: `#` for every comment, "" for a blank line."""
    # The first eight bytes of nearly all lines tell the keyword, and few of them differ.
    heads, which = np.unique(block.eights[block.starts[:-1]], return_inverse=True)
    numbers = {LONGER: 0}
    for_head = [numbers.setdefault(_find_short_word(head), len(numbers)) for head in heads.tolist()]
    number = np.array(for_head)[which]
    for row in np.flatnonzero(number == numbers[LONGER]).tolist():
        start, end = block.starts[row : row + 2].tolist()
        word = _find_word(block.text[start : min(end, start + MOST_LETTERS)])
        number[row] = numbers.setdefault(word, len(numbers))
    ends = np.cumsum(np.bincount(number, minlength=len(numbers)))
    parts = np.split(np.argsort(number, kind="stable"), ends[:-1])
    lines = [(word, rows) for word, rows in zip(numbers, parts, strict=True) if rows.size]
    return dict(sorted(lines, key=lambda each: int(each[1][0])))  # as they appear


def _find_short_word(head: int) -> str:
    """Find the keyword in the first eight bytes of a line; `LONGER` where it may go on."""
    start, is_ended, _ = head.to_bytes(8, "little").partition(b"\n")
    return _find_word(start) if is_ended or b" " in start.lstrip() else LONGER


def _find_word(line: bytes | bytearray) -> str:
    word = b"".join(line.split(None, 1)[:1])
    return "#" if word[:1] == b"#" else word.decode("utf-8", "replace")


def _pick_scans(lines: Mapping[str, Int64]) -> dict[str, Int64]:
    return {word: rows for word, rows in lines.items() if word in SCAN_LINES}


def _count_lines(word: str, lines: int) -> str:
    """Say how many lines have a keyword, for a note; garbage is quoted."""
    if word == "#":
        return count(lines, "comment")
    return f"{lines:,} {word if word.isascii() and word.isprintable() else shorten(word)}"


def _is_cut(line: Line) -> bool:
    """Whether a last line without its end is cut; for a scan, parsing it tells."""
    word = _find_word(line.raw)
    return word not in {"", *SCAN_LINES} and WHOLE_MESSAGE.fullmatch(line.text) is None
