"""The lines of CARMEN logs that occmap uses, and how each becomes a value.

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
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.readers.text import Line
from occmap.readers.text_log import (
    ANY,
    NUMBER,
    RANGE,
    SAME,
    SECONDS,
    Pattern,
    Table,
    make_planar,
    stack_planar,
)
from occmap.types import UNKNOWN_POSE, Float64, Pose, PoseSample, Scan, ScanRun
from occmap.values import as_float32, parse_seconds, shorten

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


Split: TypeAlias = Callable[[str], _Message]
"""Parts the numbers of a line from its time; raises ValueError where they are too few."""


class CarmenForm:
    """How the lines of one log become scans: all with a time, or all without."""

    def __init__(self) -> None:
        self._split: Split | None = None

    def parse(self, text: str) -> Scan:
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
        if self._split is not split_timed:
            raise ValueError("the lines state no times")
        words = line.raw.split()
        before = SCAN_LINES[words[0].decode()].before
        begin = 2 + before  # behind the keyword and the length of the list
        end = begin + int(float(words[begin - 1]))
        kinds = np.full(len(words), NUMBER, np.uint8)
        # The keyword, the angles, the limit and the lengths of lists, by their places in a line.
        kinds[[0, 2, 4, 5, begin - 1, end] if before else [0, begin - 1]] = SAME
        kinds[begin:end] = RANGE
        kinds[-3:] = SECONDS, ANY, SECONDS
        return Pattern(words, b" ", kinds)

    def make_run(self, first: Scan, table: Table) -> ScanRun:
        """Make scans of lines like the first."""
        stamp_ns, logged_ns = table.times[-3].copy(), table.times[-1]
        behind = SCAN_LINES[first.topic].behind
        return ScanRun(
            first,
            stamp_ns,
            np.where(logged_ns, logged_ns, stamp_ns),
            table.ranges,
            np.zeros(len(table.rows)),
            stack_planar(*table.values[-3 - behind :][:3]) if behind else None,
        )


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
