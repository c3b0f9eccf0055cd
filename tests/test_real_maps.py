"""Real recordings: what check finds in each, what a build uses, and what is refused and how."""

from functools import cache

import pytest

from occmap.errors import PoseError
from occmap.inspection import Inspection, inspect
from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.inspection_logs import read_line
from tests.samples import find_real


@cache
def check(name: str) -> Inspection:
    return inspect([find_real(name)], BuildOptions())


@pytest.mark.parametrize(
    ("name", "words", "used", "dropped"),
    [
        ("carmen/intel-corrected.log.gz", "", 910, {}),
        ("carmen/freiburg-079-corrected.log.gz", "", 4791, {}),
        ("carmen/csail-corrected.log.gz", "", 406, {}),
        ("carmen/fr079-robotlaser.log.gz", "", 1464, {}),
        ("ros1/test_turtlebot.bag", "", 819, {}),
        ("ros1/test_replay_crash.bag", "", 135, {"before the first pose": 1}),
        ("ros1/mylaserdata2.bag", "--sensor-pose 0,0,3.14159", 231, {"before the first pose": 1}),
        ("ros2/macfirst_floor_take_2", "", 356, {"after the last pose": 1}),
    ],
)
def test_a_log_builds_with_the_line_of_check_which_is_bare_where_it_can_be(
    name: str, words: str, used: int, dropped: dict[str, int]
) -> None:
    found = check(name)
    assert (" ".join(found.command[3:-2]), found.warnings) == (words, ())
    assert found.buildable == (words == "")
    report = build([find_real(name)], read_line(found.command)).report
    assert (report.scans.used, report.scans.dropped) == (used, dropped)
    occupied, free, unknown = report.map.occupied, report.map.free, report.map.unknown
    assert 0.001 < occupied < 0.1
    assert free > 3 * occupied
    assert unknown > 0.3


def test_oddities_are_found() -> None:
    crash = check("ros1/test_replay_crash.bag").topics[0]
    turtlebot = check("ros1/test_turtlebot.bag").topics[0]
    fr079 = check("carmen/fr079-robotlaser.log.gz").topics[0]
    assert crash.mount is not None
    assert crash.mount.upside_down
    assert turtlebot.times.offset_s == pytest.approx(44317, abs=1)
    (code,) = fr079.ranges.repeated
    assert (round(code.value, 2), code.is_no_return) == (81.91, True)


def test_a_log_without_poses_says_where_it_looked() -> None:
    name = "ros1/laser_scan_matcher_demo.bag"
    with pytest.raises(PoseError, match="looked for tf, odometry and topics of poses"):
        build([find_real(name)], BuildOptions())
    assert check(name).command == ()
    assert "`poses=FILE`" in check(name).problems[0]
