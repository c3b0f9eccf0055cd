"""Reads logs of the CARMEN toolkit: text, one message a line; `carmen_lines` has the formats."""

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from copy import copy
from itertools import islice
from pathlib import Path
from typing import TypeAlias, TypeVar

from occmap.readers import Note, NoteList, Probe, Role, Stream
from occmap.readers.carmen_lines import (
    FRAMES,
    FRONT,
    IMPLIED_INCREMENTS,
    PLAIN_FRAMES,
    RAW_FRAMES,
    ROBOT_FRAMES,
    Split,
    find_split,
    imply_increment,
    parse_front_offset,
    parse_odometry,
    parse_scan,
    parse_scans,
    split_timed,
)
from occmap.readers.text import (
    ALL,
    Line,
    LineTally,
    add_note,
    cut_blocks,
    is_worthwhile,
    note_cut_line,
    probe_lines,
    read_lines,
    shorten,
    split_lines,
)
from occmap.types import Pose, PoseSample, Scan, ScanRun

Parsed = TypeVar("Parsed")
_KindOfLine: TypeAlias = tuple[str, Line]
_SeeOther: TypeAlias = Callable[[str, Line, LineTally], None]

# fmt: off
OTHER_WORDS = frozenset({
    "PARAM", "SYNC", "COMMENT", "TRUEPOS", "GLOBALPOS", "NEFF", "SONAR", "BUMPER", "IMU", "LASER3",
    "LASER4", "RAWLASER3", "RAWLASER4", "SCANMARK", "POSITIONLASER", "NMEAGGA", "NMEARMC",
    "VERTEX2", "EDGE2", "VERTEX_SE2", "EDGE_SE2",
})
# fmt: on
"""Lines that are common in these logs (the last ones are g2o's) and hold no scan or pose."""
POSED_FRAMES = PLAIN_FRAMES | ROBOT_FRAMES
"""Lines that state the pose beside the scan, so that no time is needed"""
MAX_WORDS = 100
"""Kinds of line that are counted each by itself; garbage must not fill the memory."""
MAX_KEPT_BYTES = 1 << 26
"""A log whose scans fit is parsed once and kept; a larger one is parsed again as a stream."""
WHOLE_MESSAGE = re.compile(r"\S+\s+\S+\s+\S.*\s(?!\d)\S+\s+[-+.e\d]+\s*")
"""A keyword, two words or more, the name of a host, and a time."""
FIX = "correct or delete this line"
SCAN_BYTES = 700
"""What a scan takes beside its ranges, as measured."""


class CarmenReader:
    """CARMEN logs."""

    name = "carmen"
    description = "CARMEN text logs (FLASER, RLASER, ROBOTLASER1, RAWLASER1 + ODOM), plain or gzip"

    def recognises(self, probe: Probe) -> bool:
        """Whether the first lines are CARMEN messages; a keyword within a text is none."""
        lines = probe_lines(probe)
        if any(line.startswith("#") and "message formats defined" in line for line in lines):
            return True
        heads = [line.split(None, 2)[:2] for line in lines if line.strip() and line[0] != "#"]
        if any(_starts_message(head) for head in heads):
            return True
        # A log may begin with pages of parameters; the probe may end within its last line.
        return len(heads) > 3 and all(head[0] in OTHER_WORDS for head in heads[:-1])

    def open(self, path: Path) -> "CarmenLog":
        """Open a log and read it once.

        Raises
        ------
        LogError
            The first scan line, or so many that this is no damage, is malformed.
        """
        return CarmenLog(path)


class CarmenLog:
    """An opened CARMEN log; a stream is a keyword."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = NoteList()
        self._words: Counter[str] = Counter()
        self._front_offset: float | None = None
        self._size = 0
        self._span = ALL
        self._kept: list[Scan | ScanRun] | None = []
        self._split: Split | None = None
        self._stamps: set[int] = set()
        self._survey()
        self._note_other_lines()

    @property
    def streams(self) -> Sequence[Stream]:
        """One stream for each keyword, in order of first appearance."""
        words = ((word, n) for word, n in self._words.items() if word != "#")
        return [Stream(word, word, n, self._find_role(word)) for word, n in words]

    def poses(self) -> Iterator[PoseSample]:
        """The front laser's offset, where a PARAM states it, then the odometry."""
        if self._front_offset is not None:
            offset = Pose.planar(self._front_offset, 0.0, 0.0)
            yield PoseSample(0, "base_link", FRONT, offset, static=True, topic="PARAM")
        if not self._words["ODOM"]:
            return
        tally = LineTally()
        for word, line in self._walk(self.notes):
            if word == "ODOM" and (sample := self._parse(line, parse_odometry, tally)):
                yield sample
        tally.judge(self.path, self.notes, FIX)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these keywords."""
        for some in self.stacked_scans(topics):
            yield from some.split() if isinstance(some, ScanRun) else (some,)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The same; those that follow one another and are alike, many at a stroke."""
        for some in self._stream_scans() if self._kept is None else self._kept:
            if some.first.topic in topics:
                yield some

    def split(self, size: int) -> Sequence["CarmenLog"]:
        """Cut the log into parts of about so many bytes, as `occmap.readers.Splittable` has it."""
        spans = [ALL] if any(note.damage for note in self.notes) else split_lines(self.path, size)
        if len(spans) == 1:
            return [self]
        parts = []
        for span in spans:
            part = copy(self)
            part._span, part.notes, part._kept = span, self.notes.copy(), None
            parts.append(part)
        return parts

    def _walk(self, notes: list[Note]) -> Iterator[_KindOfLine]:
        """Yield every line that is not blank with its keyword; every comment has `#`."""
        for line in read_lines(self.path, notes, self._span):
            if head := line.raw.split(None, 1):
                word = head[0].decode("utf-8", "replace")
                yield ("#" if word[0] == "#" else word), line

    def _walk_scans(self, tally: LineTally, see_other: _SeeOther) -> Iterator[Scan | ScanRun]:
        """Yield the scans, passing over damaged ones; other lines are handed to `see_other`."""
        notes_at_end: list[Note] = []  # of a damaged file: they must follow those on its lines
        for block in cut_blocks(self._walk(notes_at_end), _get_raw):
            if self._split is None:
                texts = (line.text for word, line in block if word in FRAMES)
                self._split = next(map(find_split, texts), None)
            runs = _parse_together(block) if self._split is split_timed else {}
            items = {
                word: iter([run] if len(runs) == 1 else run.split())
                for word, run in runs.items()
                if run is not None
            }
            # Line by line, so that notes and scans come in the order of the log: a run with the
            # first line of its kind, single scans each with their own.
            for word, line in block:
                if word not in FRAMES:
                    see_other(word, line, tally)
                elif word in items:
                    tally.add(line)
                    yield from islice(items[word], 1)
                elif scan := self._parse(line, self._parse_scan, tally):
                    yield scan
        for note in notes_at_end:
            add_note(self.notes, note)

    def _stream_scans(self) -> Iterator[Scan | ScanRun]:
        judged = LineTally()  # when the log was first read
        for some in self._walk_scans(judged, lambda *_: None):
            if some.ranges.size:
                yield some

    def _parse(self, line: Line, parse: Callable[[str], Parsed], tally: LineTally) -> Parsed | None:
        """Parse a line; one that is damaged gives None, and a note where the file ends in it."""
        try:
            parsed = parse(line.text)
        except ValueError as error:
            if line.ended:
                tally.add(line, f"malformed {line.text.split(None, 1)[0]} line: {error}")
            else:
                note_cut_line(self.notes, line)
            return None
        tally.add(line)
        return parsed

    def _parse_scan(self, text: str) -> Scan:
        return parse_scan(text, self._split)

    def _survey(self) -> None:
        """Read the log once: count its lines, tally its ranges, keep its scans if they are few."""
        tally = LineTally()
        for some in self._walk_scans(tally, self._survey_other):
            self._survey_scans(some)
        tally.judge(self.path, self.notes, FIX)
        if len(self._stamps) == 1 and sum(self._words[word] for word in POSED_FRAMES) > 1:
            add_note(self.notes, Note("all scans have one time: they are taken in their order"))

    def _survey_scans(self, some: Scan | ScanRun) -> None:
        first, scans = some.first, some.scans
        if not first.ranges.size:
            self._words[f"{first.topic} without beams"] += scans
            return
        self._words[first.topic] += scans
        if len(self._stamps) < 2:
            self._stamps |= (
                {int(some.stamp_ns)} if isinstance(some, Scan) else {*some.stamp_ns.tolist()}
            )
        self._size += SCAN_BYTES * scans + some.ranges.nbytes
        if self._size > MAX_KEPT_BYTES:
            self._kept = None
        if self._kept is not None:
            self._kept.append(some)
        self._note_angles(first)

    def _survey_other(self, word: str, line: Line, tally: LineTally) -> None:
        if not line.ended and _is_cut(word, line.text):
            note_cut_line(self.notes, line)
            return
        if word == "PARAM" and self._front_offset is None:
            self._front_offset = self._parse(line, parse_front_offset, tally)
        known = word in self._words or len(self._words) < MAX_WORDS
        self._words[word[:40] if known else "other"] += 1

    def _note_angles(self, scan: Scan) -> None:
        beams = scan.ranges.size
        if scan.topic in PLAIN_FRAMES and beams not in IMPLIED_INCREMENTS:
            spacing = math.degrees(imply_increment(beams))
            text = f"{scan.topic} states no angles: {beams} beams are read as {spacing:g} deg apart"
            add_note(self.notes, Note(f"{text}, from -90 deg"))

    def _find_role(self, word: str) -> Role:
        if word == "ODOM":
            return Role.POSE
        if word not in FRAMES or self._is_repeated(word):
            return Role.OTHER
        return Role.SCAN

    def _is_repeated(self, word: str) -> bool:
        """Whether the scans of a RAWLASER stream are in the log once more, with their pose."""
        return word in RAW_FRAMES and any(
            FRAMES.get(other) == FRAMES[word] and other not in RAW_FRAMES for other in self._words
        )

    def _note_other_lines(self) -> None:
        for word in filter(self._is_repeated, self._words):
            text = f"{word} repeats scans that the log holds with their pose; it is left out"
            add_note(self.notes, Note(text))
        used = {*FRAMES, "ODOM"}
        others = Counter({word: n for word, n in self._words.items() if word not in used})
        if others:
            top = ", ".join(_count_lines(word, n) for word, n in others.most_common(5))
            lines = "1 line" if others.total() == 1 else f"{others.total()} lines"
            text = f"{lines} without scan or pose passed over: {top}"
            add_note(self.notes, Note(text + (", ..." if len(others) > 5 else "")))


def _get_raw(item: _KindOfLine) -> bytes:
    return item[1].raw


def _parse_together(block: list[_KindOfLine]) -> dict[str, ScanRun | None]:
    """Parse the scans of a block, by kind; None where one is damaged, or differs."""
    runs: dict[str, ScanRun | None] = {}
    for kind in {word for word, _ in block}.intersection(FRAMES):
        runs[kind] = None
        lines = [line.raw for word, line in block if word == kind]
        with suppress(ValueError):
            if is_worthwhile(lines):
                runs[kind] = parse_scans(lines)
    return runs


def _count_lines(word: str, lines: int) -> str:
    """Say how many lines have a keyword, for a note; garbage is quoted."""
    if word == "#":
        return "1 comment" if lines == 1 else f"{lines} comments"
    return f"{lines} {word if word.isascii() and word.isprintable() else shorten(word)}"


def _starts_message(head: list[str]) -> bool:
    """Whether a line starts as a scan or odometry message does: a keyword and a number."""
    if len(head) < 2 or head[0] not in {*FRAMES, "ODOM"}:
        return False
    return head[1].lstrip("-").replace(".", "", 1)[:1].isdigit()


def _is_cut(word: str, text: str) -> bool:
    """Whether a last line without a line end is not whole."""
    try:
        if word == "ODOM":
            parse_odometry(text)
        return WHOLE_MESSAGE.fullmatch(text) is None
    except ValueError:
        return True
