"""CARMEN lines, written by hand, against the values that they state."""

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers.carmen import (
    CarmenLog,
    imply_increment,
    parse_front_offset,
    parse_odometry,
)
from occmap.readers.text_log import make_block
from occmap.types import UNKNOWN_POSE, Pose, PoseSample, Scan, ScanRun

CONFIG = "0 -1.570796 3.14172 0.008727 50.0 0.01 0"
"""type start_angle fov resolution maximum_range accuracy remission_mode"""


TIMED = "FLASER 0 1 2 0 7 8 9 5 robot 5"


def open_timed() -> CarmenLog:
    """A log that states times."""
    with NamedTemporaryFile("w") as file:
        file.write(f"{TIMED}\n")
        file.flush()
        return CarmenLog(Path(file.name))


def parse_scan(line: str) -> Scan:
    """Parse a line of a log that states times."""
    return open_timed().parse_scan(line)


def expect_equal(scan: Scan, expected: Scan) -> None:
    np.testing.assert_array_equal(scan.ranges, expected.ranges)
    assert scan.ranges.dtype == np.float32
    np.testing.assert_array_equal(scan.pose or (), expected.pose or ())  # also where it is nan
    assert scan._replace(ranges=expected.ranges, pose=expected.pose) == expected


def test_flaser_has_the_laser_pose_and_implied_angles() -> None:
    scan = parse_scan("FLASER 3 1.5 2.25 81.91 1 2 0 7 8 9 1079.123456789 robot 1080.5")
    expected = Scan(
        stamp_ns=1_079_123_456_789,
        frame="front_laser",
        angle_min=-math.pi / 2,
        angle_increment=math.pi / 2,
        ranges=np.array([1.5, 2.25, 81.91], np.float32),
        range_min=0.0,
        range_max=math.inf,
        pose=Pose(1, 2, 0, 0, 0, 0, 1),
        topic="FLASER",
        record_ns=1_080_500_000_000,
    )
    expect_equal(scan, expected)


def test_rlaser_is_the_rear_laser_as_logged() -> None:
    scan = parse_scan("RLASER 1 1.5 1 2 3.141592653589793 1 2 0 5 robot 5")
    assert (scan.frame, scan.topic) == ("rear_laser", "RLASER")
    assert scan.pose == pytest.approx(Pose(1, 2, 0, 0, 0, 1, 0))


@pytest.mark.parametrize("word", ["ROBOTLASER0", "ROBOTLASER1"])
def test_robotlaser_states_its_own_geometry(word: str) -> None:
    poses = "0.5 0.25 0 9 9 9"
    scan = parse_scan(f"{word} {CONFIG} 2 1.5 2.5 3 7 8 9 {poses} 1 2 3 4 5 1.5 robot 0.25")
    expected = Scan(
        stamp_ns=1_500_000_000,
        frame="front_laser",
        angle_min=-1.570796,
        angle_increment=0.008727,
        ranges=np.array([1.5, 2.5], np.float32),
        range_min=0.0,
        range_max=50.0,
        pose=Pose(0.5, 0.25, 0, 0, 0, 0, 1),
        topic=word,
        record_ns=250_000_000,
    )
    expect_equal(scan, expected)


def test_rawlaser_has_no_pose() -> None:
    scan = parse_scan(f"RAWLASER1 {CONFIG} 2 1.5 2.5 0 1.5 robot 0.25")
    assert scan.pose is None
    assert (scan.frame, scan.angle_increment, scan.range_max) == ("front_laser", 0.008727, 50.0)


def test_stated_limits_are_rounded_as_ranges_are() -> None:
    config = CONFIG.replace("50.0", "81.83")
    scan = parse_scan(f"RAWLASER1 {config} 1 81.83 0 1 robot 1")
    assert scan.ranges[0] >= scan.range_max
    assert float(scan.ranges[0]) == scan.range_max


def test_a_stated_limit_of_zero_is_none() -> None:
    assert parse_scan(f"RAWLASER1 {CONFIG.replace('50.0', '0')} 1 5 0 1 r 1").range_max == math.inf


@pytest.mark.parametrize("pose", ["nan 2 0", "1 -inf 0", "1 2 nan"])
def test_an_unknown_pose_is_not_finite(pose: str) -> None:
    assert parse_scan(f"FLASER 1 1.5 {pose} 7 8 9 5 robot 5").pose is UNKNOWN_POSE


def test_an_unknown_pose_harms_no_other() -> None:
    lines = [f"FLASER 1 1.5 {pose} 7 8 9 5 robot 5" for pose in ("1 2 0", "1 1e400 0")]
    poses = parse_together(*lines)[1].pose
    np.testing.assert_array_equal(poses, [Pose(1, 2, 0, 0, 0, 0, 1), UNKNOWN_POSE])


def test_a_record_time_of_zero_is_the_stamp() -> None:
    assert parse_scan("FLASER 1 1.5 1 2 0 7 8 9 5 nohost 0").record_ns == 5_000_000_000


def test_ranges_beyond_float32_become_infinite() -> None:
    assert parse_scan("FLASER 1 1e39 1 2 0 7 8 9 5 nohost 0").ranges[0] == np.inf


@pytest.mark.parametrize(
    ("beams", "degrees"),
    [(180, 1), (181, 1), (360, 0.5), (361, 0.5), (91, 2), (90, 2), (1, 180), (0, 180)],
)
def test_the_number_of_beams_implies_their_spacing(beams: int, degrees: float) -> None:
    assert imply_increment(beams) == pytest.approx(math.radians(degrees))


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("FLASER", "too short"),
        ("FLASER 1 2 3", "too short"),
        ("FLASER 2 1 2 0 0 0 0 0 0 now host 1", "'now' is not a time"),
        ("FLASER 2 1 2 0 0 0 0 0 0 1 host then", "'then' is not a time"),
        ("FLASER 2 1 two 0 0 0 0 0 0 1 host 1", "'two' where a number belongs"),
        ("FLASER 2 1 0x2 0 0 0 0 0 0 1 host 1", "'0x2' where a number belongs"),
        ("FLASER 3 1 2 0 0 0 0 0 0 1 host 1", "5 numbers before the time where 6 belong"),
        ("FLASER 2147483647 1 2 0 0 0 0 0 0 1 host 1", "announces 2.14748e"),
        ("FLASER -1 1 2 0 0 0 0 0 0 1 host 1", "announces -1 values"),
        ("FLASER nan 1 2 0 0 0 0 0 0 1 host 1", "announces nan values"),
        ("ROBOTLASER1 0 0 0 0 1 host 1", "announces no values where 0 follow"),
        (f"ROBOTLASER1 {CONFIG} 2 1 2 1 host 1", "announces no values where 0 follow"),
        (f"RAWLASER1 {CONFIG} 2 1 2 1 1 host 1", "announces 1 values where 0 follow"),
        (f"ROBOTLASER1 {CONFIG} 2 1 2 0 1 2 3 1 host 1", "3 numbers before the time where 11"),
        ("RAWLASER1 0 nan 3 0.1 50 0 0 1 5 0 1 host 1", "not finite"),
    ],
)
def test_malformed_lines_say_what_is_wrong(line: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        parse_scan(line)


LINES = [
    "FLASER 2 1.5 81.91 1 -2 0.25 7 8 9 1.25 robot 1.5",
    "FLASER 2 .5 1e39 1e-3 +2. 1E30 7 8 9 2 robot 2",
]
ROBOT_LINES = [
    f"ROBOTLASER1 {CONFIG} 2 1.5 50 1 0 1 -2 0.25 4 5 6 7 8 9 10 11 1.25 robot 0",
    f"ROBOTLASER1 1{CONFIG[1:]} 2 2.5 60 1 9 3 -4 7.25 0 0 0 0 0 0 0 0 2 robot 3",
]
RAW_LINES = [
    f"RAWLASER1 {CONFIG} 3 1.5 50 2 0 1.25 robot 1.25",
    f"RAWLASER1 {CONFIG} 3 2.5 60 2 0 2 robot 2",
]


def parse_together(*lines: str) -> tuple[list[int], ScanRun]:
    """Parse those lines that are like the first, and say which they are."""
    block = make_block(1, "".join(f"{line}\n" for line in lines).encode())
    found = open_timed()._parse_together(block, np.arange(len(lines)))
    assert found is not None
    rows, run = found
    return rows.tolist(), run


@pytest.mark.parametrize("lines", [LINES, ROBOT_LINES, RAW_LINES])
def test_lines_parsed_together_are_as_parsed_alone(lines: Sequence[str]) -> None:
    rows, run = parse_together(*lines)
    assert rows == [0, 1]
    for scan, line in zip(run.split(), lines, strict=True):
        expect_equal(scan, parse_scan(line))


@pytest.mark.parametrize(
    "other",
    [
        ROBOT_LINES[0].replace("0.008727", "0.01"),
        ROBOT_LINES[0].replace("-1.570796", "-1.5"),
        ROBOT_LINES[0].replace(" 50.0 ", " 30.0 "),
        ROBOT_LINES[0].replace(" 2 1.5 50 1 0 ", " 1 1.5 2 1 0 "),
    ],
)
def test_scans_of_another_laser_are_not_parsed_together(other: str) -> None:
    assert parse_scan(other)
    rows, run = parse_together(ROBOT_LINES[0], other, ROBOT_LINES[1])
    assert rows == [0, 2]
    expect_equal(run.split()[1], parse_scan(ROBOT_LINES[1]))


@pytest.mark.parametrize(
    "other",
    [
        "FLASER 3 1 2 3 0 0 0 0 0 0 1 host 1",
        "FLASER 3 1 2 0 0 0 0 0 0 1 host 1",
        "FLASER 2 1 infinity 0 0 0 0 0 0 1 host 1",
        "FLASER 2 1-2 0 0 0 0 0 0 1 host 1",
        "FLASER 2 1\x1c2 0 0 0 0 0 0 1 host 1",
        "FLASER 2 1\u00a02 0 0 0 0 0 0 1 host 1",
        "FLASER 2 1 2 0 0 0 0 0 0 now host 1",
        "FLASER",
    ],
)
def test_lines_that_differ_are_not_parsed_together(other: str) -> None:
    assert parse_together(LINES[0], other, LINES[1])[0] == [0, 2]


@settings(max_examples=200)
@given(st.lists(st.text("0123456789+-.eE \t\x1c\u00a0_,naif", min_size=1), min_size=1, max_size=4))
def test_no_number_is_read_in_two_ways(words: list[str]) -> None:
    line = f"FLASER 2 {' '.join(words)} 1 2 3 4 5 1 host 1"
    for scan in parse_together(LINES[0], line)[1].split()[1:]:
        expect_equal(scan, parse_scan(line))


def test_odometry_moves_the_base_in_odom() -> None:
    sample = parse_odometry("ODOM 1 2 0 0.1 0.2 0.3 5.5 robot 6.5")
    assert sample == PoseSample(
        stamp_ns=5_500_000_000,
        parent="odom",
        child="base_link",
        pose=Pose(1, 2, 0, 0, 0, 0, 1),
        topic="ODOM",
        record_ns=6_500_000_000,
    )


@pytest.mark.parametrize("line", ["ODOM", "ODOM 1 2 5.5 robot 6.5", "ODOM 1 2 inf 0 0 0 5 r 6"])
def test_malformed_odometry_is_a_value_error(line: str) -> None:
    with pytest.raises(ValueError, match=r"short|2 numbers before|finite"):
        parse_odometry(line)


def test_front_offset() -> None:
    sample = parse_front_offset("PARAM robot_frontlaser_offset -0.04 1 merci 1")
    pose = Pose(-0.04, 0, 0, 0, 0, 0, 1)
    assert sample == PoseSample(0, "base_link", "front_laser", pose, static=True, topic="PARAM")
    assert parse_front_offset("PARAM robot_rearlaser_offset 0.1 1 merci 1") is None
    assert parse_front_offset("PARAM") is None


@pytest.mark.parametrize("value", ["", " far", " nan"])
def test_a_front_offset_that_is_no_number_is_a_value_error(value: str) -> None:
    with pytest.raises(ValueError, match=r"number|float"):
        parse_front_offset(f"PARAM robot_frontlaser_offset{value}")
