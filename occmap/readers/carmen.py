"""Reads logs of the CARMEN toolkit: text, one message a line.

The formats, as CARMEN's logger writes them; every line ends in `ipc_timestamp host
logger_timestamp`:

    FLASER n [n ranges] laser_x laser_y laser_theta robot_x robot_y robot_theta
    ROBOTLASER1 type start_angle fov resolution maximum_range accuracy remission_mode
        n [n ranges] m [m remissions] laser_x laser_y laser_theta robot_x robot_y robot_theta
        tv rv forward_safety_dist side_safety_dist turn_axis
    RAWLASER1 as ROBOTLASER1, up to the remissions
    ODOM x y theta tv rv acceleration

RLASER is FLASER for the rear laser, whose logged pose already faces backwards (robot + pi).
ROBOTLASER0 is read as ROBOTLASER1; ROBOTLASER2 and RAWLASER2 are the rear laser. The `fov` of
real logs is unreliable (it may be n * resolution), so it is not used.

FLASER and RLASER imply their angles: from -90 degrees, 180 or 181 beams 1 degree apart, 360 or
361 beams half a degree apart; the even counts lack the last beam of the half circle.

Every `parse_` function takes a whole line and raises ValueError where it is malformed.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from occmap.readers import Probe, Role, Stream
from occmap.readers.text_log import (
    Block,
    Line,
    LineTally,
    Pattern,
    TextLog,
    make_planar,
    read_blocks,
    stack_planar,
)
from occmap.report import count
from occmap.types import UNKNOWN_POSE, Float64, Int64, Pose, PoseSample, Scan, ScanRun
from occmap.values import as_float32, parse_seconds, shorten

if TYPE_CHECKING:
    from occmap.readers.decimals import Words

FRONT, REAR = "front_laser", "rear_laser"


class ScanLine(NamedTuple):
    """What lines of scans hold beside their ranges."""

    frame: str
    before: int
    """How many numbers stand before the list of ranges; 0: the line implies its angles"""
    behind: int
    """How many stand between the lists and the time, the pose of the laser first; 0: it has none"""


SCAN_LINES = {
    "FLASER": ScanLine(FRONT, 0, 6),
    "RLASER": ScanLine(REAR, 0, 6),
    "ROBOTLASER0": ScanLine(FRONT, 7, 11),
    "ROBOTLASER1": ScanLine(FRONT, 7, 11),
    "ROBOTLASER2": ScanLine(REAR, 7, 11),
    "RAWLASER1": ScanLine(FRONT, 7, 0),
    "RAWLASER2": ScanLine(REAR, 7, 0),
}
"""The lines of scans by their keywords"""
POSED = frozenset(word for word, line in SCAN_LINES.items() if line.behind)
"""Those that state the pose of the laser"""
USUAL_BEAMS = (180, 181, 360, 361)
"""How many beams a line has that is known to imply its angles."""
FRONT_OFFSET = "robot_frontlaser_offset"


class _Message(NamedTuple):
    word: str
    values: Float64
    """(N,) every number between the keyword and the time"""
    stamp_ns: int
    record_ns: int


def parse_odometry(text: str) -> PoseSample:
    """Parse an ODOM line."""
    message = split_timed(text)
    _check_rest(message.values, 0, 6)
    pose = make_planar(*message.values[:3].tolist())
    if pose is UNKNOWN_POSE:
        raise ValueError("the pose is not finite")
    return PoseSample(
        message.stamp_ns, "odom", "base_link", pose, topic="ODOM", record_ns=message.record_ns
    )


def parse_front_offset(text: str) -> PoseSample | None:
    """Parse a PARAM line: where the front laser is on the robot, or None where it says no such."""
    fields = text.split()
    if fields[1:2] != [FRONT_OFFSET]:
        return None
    offset = float(fields[2]) if len(fields) > 2 else math.nan
    if not math.isfinite(offset):
        raise ValueError("the offset is not a finite number")
    pose = Pose.planar(offset, 0.0, 0.0)
    return PoseSample(0, "base_link", FRONT, pose, static=True, topic="PARAM")


def imply_increment(beams: int) -> float:
    """Return the angle between beams (rad) where only their number is known."""
    return math.pi / max(beams - beams % 2, 1)


def split_untimed(text: str) -> _Message:
    """Split a FLASER or RLASER line after its poses; anything may follow in place of a time."""
    word, *numbers = text.split()
    if word not in {"FLASER", "RLASER"} or not numbers or not numbers[0].isdecimal():
        raise ValueError("it is not a line of a laser with its pose")
    size = 1 + int(numbers[0]) + 6
    if not size <= len(numbers) <= size + 3:
        raise ValueError(f"{len(numbers)} words where {size} numbers belong")
    return _Message(word, _parse_numbers(" ".join(numbers[:size])), 0, 0)


def split_timed(text: str) -> _Message:
    """Split a line before the time that it ends in."""
    head, *tail = text.rsplit(None, 3)
    words = head.split(None, 1)
    if len(tail) < 3 or len(words) < 2:
        raise ValueError("the line is too short")
    stamp_ns, logged_ns = parse_seconds(tail[0]), parse_seconds(tail[2])
    # Converters write 0 where they know no second time.
    return _Message(words[0], _parse_numbers(words[1]), stamp_ns, logged_ns or stamp_ns)


def _parse_numbers(text: str) -> Float64:
    """Parse numbers with blanks between; of a single line, nothing is faster."""
    try:
        return np.fromstring(text, sep=" ")
    except ValueError:
        wrong = next((word for word in text.split() if not _is_number(word)), text)
        raise ValueError(f"{shorten(wrong)} where a number belongs") from None


def _is_number(word: str) -> bool:
    try:
        return np.fromstring(word, sep=" ").size == 1
    except ValueError:
        return False


def _find_list(values: Float64, at: int) -> slice:
    """Find the list whose length stands at an index."""
    room = values.size - at - 1
    if room >= 0 and 0 <= values[at] <= room:
        return slice(at + 1, at + 1 + int(values[at]))
    announced = f"{values[at]:g}" if room >= 0 else "no"
    raise ValueError(f"the line announces {announced} values where {max(room, 0)} follow")


def _check_rest(values: Float64, at: int, size: int) -> None:
    if values.size - at != size:
        raise ValueError(f"{values.size - at} numbers before the time where {size} belong")


def _make_scan(message: _Message) -> Scan:
    line, values = SCAN_LINES[message.word], message.values
    listed = _find_list(values, line.before)
    end = _find_list(values, listed.stop).stop if line.before else listed.stop
    _check_rest(values, end, line.behind)
    ranges = as_float32(values[listed])
    angle_min, increment, range_max = -math.pi / 2, imply_increment(ranges.size), math.inf
    if line.before:
        _, angle_min, _, increment, maximum, *_ = values[: line.before].tolist()
        if not math.isfinite(angle_min + increment):
            raise ValueError("start_angle or resolution is not finite")
        range_max = float(as_float32(maximum)) if maximum > 0 else math.inf
    return Scan(
        stamp_ns=message.stamp_ns,
        frame=line.frame,
        angle_min=angle_min,
        angle_increment=increment,
        ranges=ranges,
        range_min=0.0,
        range_max=range_max,
        pose=make_planar(*values[end : end + 3].tolist()) if line.behind else None,
        topic=message.word,
        record_ns=message.record_ns,
    )


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
COMMON_WORDS = ("FLASER", "RLASER", "ODOM")
"""How most lines begin: these are told apart many at a time, by their first eight bytes."""
MOST_LETTERS = 64
"""How much of a line is searched for its keyword; a longer word is cut."""
TELLING_LINE = re.compile(rf"#.*message formats defined|\s*({'|'.join(SCAN_LINES)}|ODOM)\s+-?\.?\d")
"""By what a line of a CARMEN log is known: a keyword and a number, or how its comments begin."""
WHOLE_MESSAGE = re.compile(r"\S+\s+\S+\s+\S.*\s(?![-+.\d])\S+\s+[-+.e\d]+\s*")
"""A keyword, two words or more, the name of a host, and a time."""
NO_LINES: Int64 = np.zeros(0, np.int64)


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
    """An opened CARMEN log; a stream is a keyword.

    Raises
    ------
    LogError
        The first scan line is malformed, or so many are that it is not damage.
    """

    fix = fix_all = "correct or delete this line"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._split: Callable[[str], _Message] | None = None
        """Parts the numbers of a line from its time; all lines of a log have one, or none has"""
        self._words: Counter[str] = Counter()
        """How many lines begin with each keyword; # stands for every comment"""
        self._front_offset: PoseSample | None = None
        self._is_surveyed = False
        stamps: set[int] = set()
        for some in self._survey():
            self._count_scans(some)
            if len(stamps) < 2:
                stamps.update(np.atleast_1d(some.stamp_ns).tolist())
        self._is_surveyed = True
        self._words = +self._words  # drops keywords of which no line was a scan
        if len(stamps) == 1 and sum(self._words[word] for word in POSED) > 1:
            self.notes.add("all scans have one time: they are taken in their order")
        frames = {word: SCAN_LINES[word].frame for word in self._words if word in SCAN_LINES}
        posed = {frames[word] for word in frames.keys() & POSED}
        self._repeated = [word for word in frames if word not in POSED and frames[word] in posed]
        """RAWLASER streams whose scans are in the log once more, with their pose"""
        for word in self._repeated:
            text = f"{word} repeats scans that the log holds with their pose; it is left out"
            self.notes.add(text)
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
        tally.judge(self.path, self.notes, self.fix)

    def pick_scans(self, block: Block) -> Mapping[str, Int64]:
        """Find the lines of scans by their keywords; count all others when the log is opened."""
        lines = _sort_lines(block)
        if not self._is_surveyed:
            self._survey_others(block, lines)
        return {word: rows for word, rows in lines.items() if word in SCAN_LINES}

    def parse_scan(self, text: str) -> Scan:
        """Parse one of `SCAN_LINES`; the first shows whether all lines of the log have times."""
        if self._split is None:
            self._split = split_timed
            with suppress(ValueError):
                return _make_scan(split_timed(text))
            with suppress(ValueError):
                scan = _make_scan(split_untimed(text))
                self._split = split_untimed
                return scan
        return _make_scan(self._split(text))

    def find_pattern(self, line: Line) -> Pattern:
        """Say what lines like one have in common: all but times, ranges and poses.

        Raises
        ------
        ValueError
            The lines state no times.
        """
        from occmap.readers.decimals import NUMBER, OTHER, RANGE  # noqa: PLC0415  it brings numba

        if self._split is not split_timed:
            raise ValueError("the lines state no times")
        words = line.raw.split()
        before = SCAN_LINES[words[0].decode()].before
        begin = 2 + before  # behind the keyword and the length of the list
        end = begin + int(float(words[begin - 1]))
        kinds = np.full(len(words), NUMBER, np.uint8)
        kinds[0] = kinds[-3:] = OTHER
        kinds[begin:end] = RANGE
        # The keyword, the angles, the limit and the lengths of lists, by their places in a line.
        return Pattern(b" ", kinds, [0, 2, 4, 5, begin - 1, end] if before else [0, begin - 1])

    def make_run(self, first: Scan, words: "Words") -> ScanRun:
        """Make scans of lines like the first."""
        stamp_ns, logged_ns = words.read_times(-3, 9), words.read_times(-1, 9)
        behind = SCAN_LINES[first.topic].behind
        begin = len(words.numbers) - 3 - behind
        return ScanRun(
            first,
            stamp_ns,
            np.where(logged_ns, logged_ns, stamp_ns),
            words.ranges,
            np.zeros(len(stamp_ns)),
            stack_planar(*words.numbers[begin : begin + 3]) if behind else None,
        )

    def _survey_others(self, block: Block, lines: Mapping[str, Int64]) -> None:
        """Count the lines that hold no scan, and find the offset of the front laser."""
        if not block.ended and _is_cut(line := block.get_line(0)):
            self._note_cut(line)
            return
        for word, rows in lines.items():
            if word in SCAN_LINES:
                self._words[word] += 0  # streams are listed in the order in which they appear
            elif word:
                known = word in self._words or len(self._words) < MAX_WORDS
                self._words[word[:40] if known else "other"] += len(rows)
        for line in block.get_lines(lines.get("PARAM", NO_LINES)):
            if self._front_offset is None:
                self._front_offset = self._parse(line, parse_front_offset, self._tally)

    def _count_scans(self, some: Scan | ScanRun) -> None:
        topic, beams = some.first.topic, some.first.ranges.size
        self._words[topic if beams else f"{topic} without beams"] += some.scans
        if beams and not SCAN_LINES[topic].before and beams not in USUAL_BEAMS:
            spacing = f"{math.degrees(imply_increment(beams)):g} deg apart, from -90 deg"
            self.notes.add(f"{topic} states no angles: {beams} beams are read as {spacing}")

    def _note_other_lines(self) -> None:
        used = {*SCAN_LINES, "ODOM"}
        others = Counter({word: n for word, n in self._words.items() if word not in used})
        if others:
            top = ", ".join(_count_lines(word, n) for word, n in others.most_common(5))
            more = ", ..." if len(others) > 5 else ""
            lines = count(others.total(), "line")
            self.notes.add(f"{lines} without scan or pose passed over: {top}{more}")


def _sort_lines(block: Block) -> dict[str, Int64]:
    """Find the lines of each keyword: `#` for every comment, "" for a line of blanks."""
    text = np.frombuffer(block.text, np.uint8)
    rows = np.flatnonzero(text[block.starts[:-1]] != ord("\n"))
    places = block.starts[rows][:, None] + np.arange(8)
    heads = text.take(places, mode="clip").view("<u8")[:, 0]
    lines: dict[str, Int64] = {}
    for word in COMMON_WORDS:
        letters = f"{word} ".encode()
        mask, number = (1 << 8 * len(letters)) - 1, int.from_bytes(letters, "little")
        is_word = heads & np.uint64(mask) == number
        lines[word] = rows[is_word]
        rows, heads = rows[~is_word], heads[~is_word]
    others: dict[str, list[int]] = defaultdict(list)
    for row in rows.tolist():
        line = block.get_line(row).raw[:MOST_LETTERS]
        word = b"".join(line.split(None, 1)[:1]).decode("utf-8", "replace")
        others["#" if word[:1] == "#" else word].append(row)
    for word, more in others.items():
        lines[word] = np.sort(np.append(lines.get(word, NO_LINES), more))
    found = [(word, rows) for word, rows in lines.items() if rows.size]
    return dict(sorted(found, key=lambda each: int(each[1][0])))  # in the order of appearance


def _count_lines(word: str, lines: int) -> str:
    """Say how many lines have a keyword, for a note; garbage is quoted."""
    if word == "#":
        return count(lines, "comment")
    return f"{lines:,} {word if word.isascii() and word.isprintable() else shorten(word)}"


def _is_cut(line: Line) -> bool:
    """Whether a last line without its end is cut; for a scan, parsing it tells."""
    word = "".join(line.text.split(None, 1)[:1])
    return word not in {"", *SCAN_LINES} and WHOLE_MESSAGE.fullmatch(line.text) is None
