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
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Container, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occmap.readers import Probe, Role, Stream, decimals
from occmap.readers.decimals import unquote
from occmap.readers.text_log import POSE_NAMES, Block, Line, Pattern, TextLog
from occmap.report import count
from occmap.types import IDENTITY, PoseBatch, PoseSample, Scan, ScanBatch
from occmap.values import SECONDS, as_float32, parse_number

FRONT, REAR = "front_laser", "rear_laser"


class LineType(NamedTuple):
    """What lines of one keyword hold."""

    frame: str
    """Which their pose is of"""
    before: int = 0
    """How many numbers stand before the first list; 0: the angles of the ranges are implied"""
    lists: int = 1
    """The ranges, and the remissions; each list stands behind its length"""
    behind: int = 6
    """How many numbers stand between the lists and the time, the pose first; 0: it has none"""


SCAN_LINES = {
    "FLASER": LineType(FRONT),
    "RLASER": LineType(REAR),
    "ROBOTLASER0": LineType(FRONT, before=7, lists=2, behind=11),
    "ROBOTLASER1": LineType(FRONT, before=7, lists=2, behind=11),
    "ROBOTLASER2": LineType(REAR, before=7, lists=2, behind=11),
    "RAWLASER1": LineType(FRONT, before=7, lists=2, behind=0),
    "RAWLASER2": LineType(REAR, before=7, lists=2, behind=0),
}
"""The lines of scans by their keywords"""
LINES = SCAN_LINES | {"ODOM": LineType("base_link", lists=0)}
"""All that are parsed: a line of odometry is like one of a scan without ranges"""
POSED = frozenset(word for word, line in SCAN_LINES.items() if line.behind)
"""Those of scans that state the pose of the laser"""
USUAL_BEAMS = (180, 181, 360, 361)
"""How many beams a line has that is known to imply its angles."""
_ANGLE_MIN, _INCREMENT, _RANGE_MAX = 2, 4, 5
"""The words of a line that states its angles"""


def imply_increment(beams: int) -> float:
    """Return the angle between beams (rad) where only their number is known."""
    return math.pi / max(beams - beams % 2, 1)


def find_lists(words: Sequence[bytes], kind: LineType) -> tuple[Sequence[slice], int]:
    """Find the lists of a line, each behind its length, and where the numbers behind them begin.

    A time, a host and a second time follow these.
    """
    end = len(words) - 3
    if end < 2 + kind.before:
        raise ValueError("the line is too short")
    lists: list[slice] = []
    at = 1 + kind.before
    for _ in range(kind.lists):
        room = max(end - at - 1, 0)
        length = parse_number(unquote(words[at])) if at < len(words) else 1
        if not 0 <= length <= room:
            raise ValueError(f"the line announces {length:g} values where {room} follow")
        lists.append(slice(at + 1, at + 1 + int(length)))
        at = lists[-1].stop
    if end - at != kind.behind:
        found = f"{end - at} numbers before the time where {kind.behind} belong"
        raise ValueError(f"{found}; a line ends in a time, a host and a second time")
    return lists, at


def state_geometry(keyword: str, words: Sequence[bytes], beams: int) -> Scan:
    """Make what is the same in all scans whose lines are like one."""
    kind = LINES[keyword]
    angle_min, increment, range_max = -math.pi / 2, imply_increment(beams), math.inf
    if kind.before:
        stated = (words[at] for at in (_ANGLE_MIN, _INCREMENT, _RANGE_MAX))
        angle_min, increment, maximum = map(parse_number, map(unquote, stated))
        if not math.isfinite(angle_min + increment):
            raise ValueError("start_angle or resolution is not finite")
        range_max = float(as_float32(maximum)) if maximum > 0 else math.inf
    limits, ranges = (0.0, range_max), np.zeros(0, np.float32)
    pose = IDENTITY if kind.behind else None
    return Scan(0, kind.frame, angle_min, increment, ranges, *limits, pose=pose, topic=keyword)


KEYWORD = re.compile(rb"[^\S\n]*((?!#)\S{1,64})")
"""How a line begins that is no comment; a longer word is cut."""
MOST_KEYWORDS = 50
"""How many are counted each by itself: the lines of a damaged file may begin in any way"""
TELLING_LINE = re.compile(
    rf"#.*message formats defined|\s*({'|'.join(LINES)}|VERTEX2)\s+-?\.?\d|PARAM\s+\w+\s+\S"
)
"""By what a line of a CARMEN log is known: how its comments begin, a keyword and a number (VERTEX2
is that of a pose graph, which some begin with), or a parameter and its value."""


class CarmenLog(TextLog):
    """An opened CARMEN log; a stream is a keyword.

    Raises
    ------
    LogError
        All lines of scans are malformed.
    """

    fix = "correct or delete this line"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._words: Counter[str] = Counter()
        """How many lines begin with each keyword"""
        for some in self._survey(self._survey_block):
            self._count_scans(some)
        self._words = +self._words  # drops keywords of which no line was a scan
        frames = {word: SCAN_LINES[word].frame for word in self._words if word in SCAN_LINES}
        posed = {frames[word] for word in frames.keys() & POSED}
        roles = {**dict.fromkeys(SCAN_LINES, Role.SCAN), "ODOM": Role.POSE}
        for word in (word for word in frames if word not in POSED and frames[word] in posed):
            text = f"{word} repeats scans that the log holds with their pose; it is left out"
            self.notes.add(text)
            roles[word] = Role.OTHER
        words = self._words.items()
        self.streams = [Stream(word, word, n, roles.get(word, Role.OTHER)) for word, n in words]
        if others := sum(n for word, n in words if word not in LINES):
            self.notes.add(f"{count(others, 'line')} without scan or pose passed over")

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """The odometry."""
        lines = self._parse_all(partial(pick, ["ODOM"])) if self._words["ODOM"] else ()
        for some in lines:  # which are read as scans without ranges
            times = np.atleast_1d(some.stamp_ns), np.atleast_1d(some.record_ns)
            poses = np.atleast_2d(np.array(some.pose))
            yield PoseBatch(*times, poses, "odom", some.frame, static=False, topic=some.topic)

    def pick_scans(self, block: Block) -> Mapping[str, Sequence[int]]:
        """Find the lines of scans by their keywords."""
        return pick(SCAN_LINES, block)

    def find_pattern(self, line: Line) -> Pattern:
        """Say what lines like one have in common: all but times, ranges and poses."""
        words = line.raw.split()
        keyword = words[0].decode()
        if (kind := LINES.get(keyword)) is None:
            raise ValueError(f"{keyword!r} is no line of scans or odometry")
        lists, behind = find_lists(words, kind)
        kinds = np.full(len(words), decimals.NUMBER)
        kinds[[0, *(each.start - 1 for each in lists)]] = decimals.SAME
        kinds[behind + kind.behind :] = decimals.OTHER
        columns = dict(zip(POSE_NAMES, range(behind, behind + 3), strict=True))
        columns |= {"stamp": -3, "record": -1}
        kinds[[-3, -1]] = decimals.TIME + SECONDS
        if kind.before:
            kinds[[_ANGLE_MIN, _INCREMENT, _RANGE_MAX]] = decimals.SAME
        ranges = lists[0] if lists else slice(0, 0)
        beams = ranges.stop - ranges.start
        kinds[ranges] = decimals.RANGE + np.arange(beams)
        scan = state_geometry(keyword, words, beams)
        return Pattern(b" ", kinds, [""] * len(words), columns, {"time_increment": 0.0}, scan)

    def _survey_block(self, block: Block) -> Mapping[str, Sequence[int]]:
        """Find the lines of scans; count all others."""
        lines = sort_lines(block)
        for word, rows in lines.items():
            if word in SCAN_LINES:
                self._words[word] += 0  # streams are listed in the order in which they appear
            else:
                is_keyword = word.isascii() and word.isupper() and len(self._words) < MOST_KEYWORDS
                self._words[word if is_keyword or word in self._words else "other"] += len(rows)
        return {word: rows for word, rows in lines.items() if word in SCAN_LINES}

    def _count_scans(self, some: Scan | ScanBatch) -> None:
        topic, beams = some.topic, some.ranges.shape[-1]
        self._words[topic if beams else f"{topic} without beams"] += some.scans
        if beams and not SCAN_LINES[topic].before and beams not in USUAL_BEAMS:
            spacing = f"{math.degrees(imply_increment(beams)):g} deg apart, from -90 deg"
            self.notes.add(f"{topic} states no angles: {beams} beams are read as {spacing}")


class CarmenReader:
    """CARMEN logs."""

    name = "carmen"
    description = "CARMEN text logs (FLASER, RLASER, ROBOTLASER1, RAWLASER1 + ODOM), plain or gzip"
    open = CarmenLog

    def recognises(self, probe: Probe) -> bool:
        """Whether the first lines are CARMEN messages; a keyword within a text does not count."""
        return any(map(TELLING_LINE.match, probe.lines))


def pick(keywords: Container[str], block: Block) -> Mapping[str, Sequence[int]]:
    """Find the lines of some keywords."""
    return {word: rows for word, rows in sort_lines(block).items() if word in keywords}


def sort_lines(block: Block) -> Mapping[str, list[int]]:
    """Find the lines of each keyword, but for comments and lines of blanks."""
    lines: defaultdict[str, list[int]] = defaultdict(list)
    for row, start in enumerate(block.starts[:-1].tolist()):
        if word := KEYWORD.match(block.text, start):
            lines[word[1].decode("latin-1")].append(row)
    return lines
