"""CARMEN lines, written by hand, against the values that they state."""

import math
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers.carmen import CarmenLog, imply_increment
from occmap.types import Pose, PoseSample, Scan, ScanBatch
from occmap.values import as_float32
from tests.readers.runs import expect_equal, flatten, list_fields, open_carmen

CONFIG = "0 -1.570796 3.14172 0.008727 50.0 0.01 0"
"""type start_angle fov resolution maximum_range accuracy remission_mode"""


TIMED = "FLASER 0 1 2 0 7 8 9 5 robot 5"


def join(*lines: str) -> str:
    """Lines in a log that states times, and of which a few may be damaged."""
    return "".join(f"{line}\n" for line in (TIMED, *lines))


def open_lines(*lines: str) -> CarmenLog:
    with TemporaryDirectory() as folder:
        return open_carmen(Path(folder), join(*lines))


def parse(*lines: str) -> list[Scan | ScanBatch]:
    """Read lines of scans in a log that states times."""
    log = open_lines(*lines)
    return list(log.stacked_scans({stream.topic for stream in log.streams}))


def parse_scan(line: str) -> Scan:
    """Read one line likewise; raises ValueError where it is malformed."""
    log = open_lines(line)
    if damage := [note.text for note in log.notes if note.damage]:
        raise ValueError(damage[0])
    (scan,) = log.scans({line.split(maxsplit=1)[0]})
    return scan


FLASER = Scan(
    stamp_ns=1_500_000_000,
    frame="front_laser",
    angle_min=-math.pi / 2,
    angle_increment=math.pi / 2,
    ranges=np.array([1.5, 2.25, 81.91], np.float32),
    range_min=0.0,
    range_max=math.inf,
    pose=Pose(1, 2, 0, 0, 0, 0, 1),
    topic="FLASER",
    record_ns=250_000_000,
)


def test_flaser_has_the_laser_pose_and_implied_angles() -> None:
    expect_equal(parse_scan("FLASER 3 1.5 2.25 81.91 1 2 0 7 8 9 1.5 robot 0.25"), FLASER)


def test_rlaser_is_the_rear_laser_as_logged() -> None:
    scan = parse_scan("RLASER 1 1.5 1 2 3.141592653589793 1 2 0 5 robot 5")
    assert (scan.frame, scan.topic) == ("rear_laser", "RLASER")
    assert scan.pose == pytest.approx(Pose(1, 2, 0, 0, 0, 1, 0))


@pytest.mark.parametrize("word", ["ROBOTLASER0", "ROBOTLASER1", "RAWLASER1"])
def test_other_lasers_state_their_geometry_and_raw_ones_no_pose(word: str) -> None:
    pose = "" if word == "RAWLASER1" else "1 2 0 9 9 9 1 2 3 4 5 "
    scan = parse_scan(f"{word} {CONFIG} 3 1.5 2.25 81.91 3 7 8 9 {pose}1.5 robot 0.25")
    expected = FLASER._replace(
        angle_min=-1.570796, angle_increment=0.008727, range_max=50.0, topic=word
    )
    expect_equal(scan, expected if pose else expected._replace(pose=None))


def test_stated_limits_are_rounded_as_ranges_are() -> None:
    config = CONFIG.replace("50.0", "81.83")
    scan = parse_scan(f"RAWLASER1 {config} 1 81.83 0 1 robot 1")
    assert scan.ranges[0] >= scan.range_max
    assert float(scan.ranges[0]) == scan.range_max


def test_a_stated_limit_of_zero_is_none() -> None:
    assert parse_scan(f"RAWLASER1 {CONFIG.replace('50.0', '0')} 1 5 0 1 r 1").range_max == math.inf


def test_an_unknown_pose_is_not_finite_and_harms_no_other() -> None:
    unknown = ["nan 2 0", "1 -inf 0", "1 2 nan", "1 1e400 0"]
    lines = [f"FLASER 1 1.5 {pose} 7 8 9 5 robot 5" for pose in ("1 2 0", *unknown)]
    first, *others = [scan.pose for scan in flatten(parse(*lines))]
    assert first == Pose(1, 2, 0, 0, 0, 0, 1)
    assert not np.isfinite(np.array(others)).all(axis=1).any()


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
        ("ROBOTLASER1 0 0 0 0 1 host 1", "the line is too short"),
        (f"ROBOTLASER1 {CONFIG} 2 1 2 1 host 1", "announces 1 values where 0 follow"),
        (f"RAWLASER1 {CONFIG} 2 1 2 1 1 host 1", "announces 1 values where 0 follow"),
        (f"ROBOTLASER1 {CONFIG} 4 1 2 3 4", "announces 4 values where 1 follow"),
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


@pytest.mark.parametrize(
    "other",
    [
        ROBOT_LINES[0].replace("0.008727", "0.01"),
        ROBOT_LINES[0].replace("-1.570796", "-1.5"),
        ROBOT_LINES[0].replace(" 50.0 ", " 30.0 "),
        ROBOT_LINES[0].replace(" 2 1.5 50 1 0 ", " 1 1.5 2 1 0 "),
        LINES[0].replace("2 1.5 81.91", "3 1 2 3"),
    ],
)
def test_scans_of_another_laser_are_read_between_others(other: str) -> None:
    lines = ROBOT_LINES[0], other, ROBOT_LINES[1]
    scans = flatten(parse(*lines))
    assert list_fields(scans) == list_fields(map(parse_scan, lines))


@settings(max_examples=200)
@given(st.lists(st.text("0123456789+-.eE \t\x1c\u00a0_,naif", min_size=1), min_size=1, max_size=4))
def test_a_number_is_what_python_reads(written: list[str]) -> None:
    line = f"FLASER 2 {' '.join(written)} 1 2 3 4 5 1 host 1"
    words = line.encode().split()
    expected = []
    with suppress(ValueError):
        numbers = [float(word) for word in words[2:-3] if b"_" not in word and word.isascii()]
        expected = [as_float32(numbers[:2]).tolist()] if len(numbers) == len(words) - 5 == 8 else []
    found = [scan.ranges.tolist() for scan in flatten(parse(LINES[0], line))[1:]]
    np.testing.assert_array_equal(found, expected)


def read_odometry(tmp_path: Path, line: str) -> list[PoseSample]:
    """Read a line of odometry between sound ones; ValueError where it is malformed."""
    log = open_carmen(tmp_path, join("ODOM 9 9 0 0 0 0 1 robot 1", line))
    samples = list(log.poses())[1:]
    if damage := [note.text for note in log.notes if note.damage]:
        raise ValueError(damage[0])
    return samples


def test_odometry_moves_the_base_in_odom(tmp_path: Path) -> None:
    assert read_odometry(tmp_path, "ODOM 1 2 0 0.1 0.2 0.3 5.5 robot 6.5") == [
        PoseSample(
            stamp_ns=5_500_000_000,
            parent="odom",
            child="base_link",
            pose=Pose(1, 2, 0, 0, 0, 0, 1),
            topic="ODOM",
            record_ns=6_500_000_000,
        )
    ]


@pytest.mark.parametrize("line", ["ODOM", "ODOM 1 2 5.5 robot 6.5"])
def test_malformed_odometry_is_damage(tmp_path: Path, line: str) -> None:
    with pytest.raises(ValueError, match=r"short|2 numbers before"):
        read_odometry(tmp_path, line)
