"""The real recordings: counts and oddities as the README that lies beside them has them."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from occmap.readers import Log, Role, open_log
from occmap.types import PoseSample, Scan
from tests.readers.runs import expect_equal
from tests.samples import find_real

TURTLEBOT, LASER = "ros1/test_turtlebot.bag", "ros1/mylaserdata2.bag"
MAC = "ros2/macfirst_floor_take_2"
CRASH = "ros1/test_replay_crash.bag"
EDGES = {
    TURTLEBOT: {("map", "odom"): 550, ("odom", "base_footprint"): 1376},
    CRASH: {("odom", "base_link"): 1088, ("base_link", "laser"): 54, ("base_link", "laser2"): 54},
    LASER: {("odom", "base_link"): 329},
    MAC: {("odom", "base_link"): 953, ("odom", "base_footprint"): 953},
}
"""How many samples some edges have on /tf, which is empty in the other log"""


def read(log: Log) -> tuple[list[Scan], list[PoseSample]]:
    topics = {stream.topic for stream in log.streams if stream.role is Role.SCAN}
    return list(log.scans(topics)), list(log.poses())


def read_real(name: str) -> tuple[list[Scan], list[PoseSample]]:
    return read(open_log(find_real(name)))


@pytest.mark.parametrize(
    ("name", "count", "beams", "frame"),
    [
        (TURTLEBOT, 819, 640, "camera_depth_frame"),
        (CRASH, 136, 381, "laser"),
        (LASER, 232, 360, "laser"),
        ("ros1/laser_scan_matcher_demo.bag", 360, 681, "laser"),
        (MAC, 357, 720, "rplidar_link"),
    ],
)
def test_counts_and_frames(name: str, count: int, beams: int, frame: str) -> None:
    log = open_log(find_real(name))
    scans, poses = read(log)
    edges = Counter((sample.parent, sample.child) for sample in poses if sample.topic == "/tf")

    assert len(scans) == count
    assert {(len(scan.ranges), scan.frame) for scan in scans} == {(beams, frame)}
    assert EDGES.get(name, {}).items() <= edges.items()
    assert bool(edges) is (name in EDGES)
    assert not log.notes
    assert ("/scan", count) in {(stream.topic, stream.count) for stream in log.streams}


def test_special_ranges_come_as_recorded() -> None:
    turtle, laser, mac = (read_real(name)[0] for name in (TURTLEBOT, LASER, MAC))

    assert round(100 * np.isnan([scan.ranges for scan in turtle]).mean()) == 10
    assert round(100 * np.isinf([scan.ranges for scan in laser]).mean()) == 9
    assert round(100 * np.isinf([scan.ranges for scan in mac]).mean()) == 23
    assert max(scan.ranges[np.isfinite(scan.ranges)].max() / scan.range_max for scan in mac) > 1


def test_conversion_to_mcap_changes_nothing(tmp_path: Path) -> None:
    source, target = find_real(MAC), tmp_path / "mac"
    command = [sys.executable, "-m", "rosbags.convert", "--src-typestore", "ros2_humble"]
    command += ["--dst-storage", "mcap", "--src", str(source), "--dst", str(target)]
    subprocess.run(command, check=True, capture_output=True)
    scans, poses = read_real(MAC)

    for path in (target, target / "mac.mcap"):
        found, found_poses = read(open_log(path))
        assert found_poses == poses
        for scan, other in zip(found, scans, strict=True):
            expect_equal(scan, other)
