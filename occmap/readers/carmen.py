"""Reads logs of the CARMEN toolkit: text, one message a line; `carmen_lines` has the formats."""

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from occmap.readers import Note, NoteList, Probe, Role, Stream, make_part
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
    Block,
    Line,
    LineTally,
    add_note,
    note_cut_line,
    probe_lines,
    read_blocks,
    split_lines,
)
from occmap.types import Pose, PoseSample, Scan, ScanRun, shorten
from occmap.wording import count

Parsed = TypeVar("Parsed")

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
        for words, block in self._walk():
            for line in (block.get_line(at) for at, word in enumerate(words) if word == "ODOM"):
                if sample := self._parse(line, parse_odometry, tally):
                    yield sample
        tally.judge(self.path, self.notes, FIX)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these keywords."""
        for some in self.stacked_scans(topics):
            yield from some.split() if isinstance(some, ScanRun) else (some,)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The same, with many at once where scans that follow one another are alike."""
        judged = LineTally()  # not used: the lines were judged when the log was opened
        read = (some for block in self._walk() for some in self._parse_block(*block, judged))
        for some in read if self._kept is None else self._kept:
            if some.first.topic in topics and some.first.ranges.size:
                yield some

    def split(self, size: int) -> Sequence["CarmenLog"]:
        """Cut the log into parts of about `size` bytes, as `occmap.readers.Splittable` says."""
        spans = [ALL] if any(note.damage for note in self.notes) else split_lines(self.path, size)
        if len(spans) == 1:
            return [self]
        return [make_part(self, _span=span, _kept=None) for span in spans]

    def _walk(self) -> Iterator[tuple[list[str], Block]]:
        """Yield lines, some at a time, and before them the keyword of each."""
        for block in read_blocks(self.path, self.notes, self._span):
            starts = list(block.list_heads())
            words = {start: _find_word(start) for start in set(starts)}
            yield [words[start] for start in starts], block

    def _parse_block(
        self, words: list[str], block: Block, tally: LineTally
    ) -> Iterator[Scan | ScanRun]:
        """Yield the scans in some lines, passing over damaged ones."""
        if self._split is None:
            scans = (block.get_line(at).text for at, word in enumerate(words) if word in FRAMES)
            self._split = next(map(find_split, scans), None)
        together = _parse_together(words, block) if self._split is split_timed else {}
        # Line by line, so that notes and scans come in the order of the log: a run with the first
        # line of its kind, single scans each with their own.
        for at, word in enumerate(words):
            if word in together:
                tally.total += 1
                yield from islice(together[word], 1)
            elif word in FRAMES:
                if scan := self._parse(block.get_line(at), self._parse_scan, tally):
                    yield scan
            elif word == "PARAM" and self._front_offset is None:
                line = block.get_line(at)
                if not _is_cut(word, line):
                    self._front_offset = self._parse(line, parse_front_offset, tally)

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
        """Read the log once: count its lines, and keep its scans if they are few."""
        tally = LineTally()
        for words, block in self._walk():
            self._count_words(words, block)
            for some in self._parse_block(words, block, tally):
                self._survey_scans(some)
        self._words = +self._words  # drops keywords of which no line was a scan
        tally.judge(self.path, self.notes, FIX)
        if len(self._stamps) == 1 and sum(self._words[word] for word in POSED_FRAMES) > 1:
            add_note(self.notes, Note("all scans have one time: they are taken in their order"))

    def _count_words(self, words: list[str], block: Block) -> None:
        """Count lines by their keyword; scans are counted when they have been parsed."""
        for word, lines in Counter(filter(None, words)).items():
            if word in FRAMES:
                self._words[word] += 0  # streams are listed in the order in which they appear
            elif _is_cut(word, block.get_line(0)):
                note_cut_line(self.notes, block.get_line(0))
            else:
                known = word in self._words or len(self._words) < MAX_WORDS
                self._words[word[:40] if known else "other"] += lines

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
            text = f"{count(others.total(), 'line')} without scan or pose passed over: {top}"
            add_note(self.notes, Note(text + (", ..." if len(others) > 5 else "")))


def _find_word(start: bytes) -> str:
    """Find the keyword in the start of a line: `#` for every comment, "" for a blank line."""
    word = b"".join(start.split(None, 1)[:1])
    return "#" if word[:1] == b"#" else word.decode("utf-8", "replace")


def _parse_together(words: list[str], block: Block) -> dict[str, Iterator[Scan | ScanRun]]:
    """Parse the scans of a block by kind: into one run where all are of one, else into scans.

    A kind of which one line is damaged or differs is left out.
    """
    kinds = FRAMES.keys() & words
    runs: dict[str, ScanRun] = {}
    for kind in kinds:
        rows = np.array([at for at, word in enumerate(words) if word == kind])
        with suppress(ValueError):
            runs[kind] = parse_scans(block, rows)
    return {kind: iter([r] if len(kinds) == 1 else r.split()) for kind, r in runs.items()}


def _count_lines(word: str, lines: int) -> str:
    """Say how many lines have a keyword, for a note; garbage is quoted."""
    if word == "#":
        return count(lines, "comment")
    return f"{lines:,} {word if word.isascii() and word.isprintable() else shorten(word)}"


def _starts_message(head: list[str]) -> bool:
    """Whether a line starts as a scan or odometry message does: a keyword and a number."""
    if len(head) < 2 or head[0] not in {*FRAMES, "ODOM"}:
        return False
    return head[1].lstrip("-").replace(".", "", 1)[:1].isdigit()


def _is_cut(word: str, line: Line) -> bool:
    """Whether a line that is no scan is not whole, which a last line may be."""
    if line.ended:
        return False
    try:
        if word == "ODOM":
            parse_odometry(line.text)
        return WHOLE_MESSAGE.fullmatch(line.text) is None
    except ValueError:
        return True
