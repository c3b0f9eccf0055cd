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
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occmap.readers.text import as_float32, parse_stamp, round_limit, shorten
from occmap.types import Float64, Pose, PoseSample, Scan

FRONT, REAR = "front_laser", "rear_laser"
PLAIN_FRAMES = {"FLASER": FRONT, "RLASER": REAR}
"""Lines that imply their angles and state no limits."""
ROBOT_FRAMES = {"ROBOTLASER0": FRONT, "ROBOTLASER1": FRONT, "ROBOTLASER2": REAR}
RAW_FRAMES = {"RAWLASER1": FRONT, "RAWLASER2": REAR}
FRAMES = PLAIN_FRAMES | ROBOT_FRAMES | RAW_FRAMES
IMPLIED_INCREMENTS = {beams: math.radians(1.0) for beams in (180, 181)} | {
    beams: math.radians(0.5) for beams in (360, 361)
}
FRONT_OFFSET = "robot_frontlaser_offset"
NUMBER_CHARACTERS = b"+-.0123456789Ee "


class _Words(NamedTuple):
    word: str
    numbers: str
    """All between the keyword and the time"""
    stamp_ns: int
    record_ns: int


class _Message(NamedTuple):
    word: str
    values: Float64
    """(N,) every number between the keyword and the time"""
    stamp_ns: int
    record_ns: int


def parse_scan(text: str) -> Scan:
    """Parse a line whose keyword is one of `FRAMES`."""
    return _make_scan(_parse_message(text))


def parse_scans(texts: Sequence[str]) -> list[Scan]:
    """Parse lines of as many numbers each together, which takes half the time.

    Raises ValueError where one is malformed or unlike the others: `parse_scan` tells which.
    """
    lines = [_split_message(text) for text in texts]
    table = _parse_table([line.numbers for line in lines])
    return [
        _make_scan(_Message(line.word, values, line.stamp_ns, line.record_ns))
        for line, values in zip(lines, table, strict=True)
    ]


def parse_odometry(text: str) -> PoseSample:
    """Parse an ODOM line."""
    message = _parse_message(text)
    pose = _make_pose(_take_rest(message.values, 0, 6)[:3])
    if pose is None:
        raise ValueError("the pose is not finite")
    return PoseSample(
        message.stamp_ns, "odom", "base_link", pose, topic="ODOM", record_ns=message.record_ns
    )


def parse_front_offset(text: str) -> float | None:
    """Parse a PARAM line: how far the front laser is before the robot's centre (m), or None."""
    fields = text.split()
    if fields[1:2] != [FRONT_OFFSET]:
        return None
    offset = float(fields[2]) if len(fields) > 2 else math.nan
    if not math.isfinite(offset):
        raise ValueError("the offset is not a finite number")
    return offset


def imply_increment(beams: int) -> float:
    """Return the angle between beams (rad) where only their number is known."""
    if beams in IMPLIED_INCREMENTS:
        return IMPLIED_INCREMENTS[beams]
    return math.pi / max(beams - beams % 2, 1)


def _parse_message(text: str) -> _Message:
    word, numbers, stamp_ns, record_ns = _split_message(text)
    return _Message(word, _parse_numbers(numbers), stamp_ns, record_ns)


def _split_message(text: str) -> _Words:
    head, *tail = text.rsplit(None, 3)
    words = head.split(None, 1)
    if len(tail) < 3 or len(words) < 2:
        raise ValueError("it is too short")
    stamp, _, logged = tail
    stamp_ns = parse_stamp(stamp)
    record_ns = stamp_ns if logged == stamp else parse_stamp(logged)
    # Converters write 0 where they know no second time.
    return _Words(words[0], words[1], stamp_ns, record_ns or stamp_ns)


def _parse_table(texts: list[str]) -> Float64:
    """Parse rows of as many numbers each, (S, N), where all is as plain as a logger writes it.

    What `np.loadtxt` and `np.fromstring` differ in takes other characters: Unicode's blanks, nan.
    """
    if any(text.encode().translate(None, NUMBER_CHARACTERS) for text in texts):
        raise ValueError("there is more in it than numbers")
    return np.loadtxt(texts, comments=None, ndmin=2)


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


def _take_list(values: Float64, at: int) -> tuple[Float64, int]:
    """Take the list whose length stands at an index; return it and the index after it."""
    room = values.size - at - 1
    if room >= 0 and 0 <= values[at] <= room:
        end = at + 1 + int(values[at])
        return values[at + 1 : end], end
    announced = f"{values[at]:g}" if room >= 0 else "no"
    raise ValueError(f"it announces {announced} values where {max(room, 0)} follow")


def _take_rest(values: Float64, at: int, size: int) -> Float64:
    if values.size - at != size:
        raise ValueError(f"{values.size - at} numbers before the time where {size} belong")
    return values[at:]


def _make_pose(values: Float64) -> Pose | None:
    """Build a pose from x, y, theta; None where it is not finite, as nobody knew it."""
    x, y, theta = values.tolist()
    return Pose.planar(x, y, theta) if math.isfinite(x + y + theta) else None


def _make_scan(message: _Message) -> Scan:
    return _make_plain(message) if message.word in PLAIN_FRAMES else _make_configured(message)


def _make_plain(message: _Message) -> Scan:
    ranges, end = _take_list(message.values, 0)
    poses = _take_rest(message.values, end, 6)
    return Scan(
        stamp_ns=message.stamp_ns,
        frame=FRAMES[message.word],
        angle_min=-math.pi / 2,
        angle_increment=imply_increment(ranges.size),
        ranges=as_float32(ranges),
        range_min=0.0,
        range_max=math.inf,
        pose=_make_pose(poses[:3]),
        topic=message.word,
        record_ns=message.record_ns,
    )


def _make_configured(message: _Message) -> Scan:
    ranges, after_ranges = _take_list(message.values, 7)
    _, end = _take_list(message.values, after_ranges)
    with_pose = message.word in ROBOT_FRAMES
    rest = _take_rest(message.values, end, 11 if with_pose else 0)
    _, angle_min, _, increment, maximum, *_ = message.values[:7].tolist()
    if not math.isfinite(angle_min + increment):
        raise ValueError("start_angle or resolution is not finite")
    return Scan(
        stamp_ns=message.stamp_ns,
        frame=FRAMES[message.word],
        angle_min=angle_min,
        angle_increment=increment,
        ranges=as_float32(ranges),
        range_min=0.0,
        range_max=round_limit(maximum) if maximum > 0 else math.inf,
        pose=_make_pose(rest[:3]) if with_pose else None,
        topic=message.word,
        record_ns=message.record_ns,
    )
