"""The real recordings: counts and oddities as the README that lies beside them has them."""

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from occmap.readers import Log, Role, open_log
from occmap.types import PoseSample, Scan

LOGS = Path(os.environ.get("OCCMAP_REAL_LOGS", "../shared/logs"))
MAC = "ros2/macfirst_floor_take_2"

pytestmark = pytest.mark.skipif(
    not (LOGS / "ros1").is_dir(), reason=f"no real logs in {LOGS} (set OCCMAP_REAL_LOGS)"
)


class Facts(NamedTuple):
    scans: int
    beams: int
    frame: str
    edges: dict[tuple[str, str], int]
    """Samples of some edges on /tf."""


FACTS = {
    "ros1/test_turtlebot.bag": Facts(
        819, 640, "camera_depth_frame", {("map", "odom"): 550, ("odom", "base_footprint"): 1376}
    ),
    "ros1/test_replay_crash.bag": Facts(
        136,
        381,
        "laser",
        {("odom", "base_link"): 1088, ("base_link", "laser"): 54, ("base_link", "laser2"): 54},
    ),
    "ros1/mylaserdata2.bag": Facts(232, 360, "laser", {("odom", "base_link"): 329}),
    "ros1/laser_scan_matcher_demo.bag": Facts(360, 681, "laser", {}),
    MAC: Facts(
        357, 720, "rplidar_link", {("odom", "base_link"): 953, ("odom", "base_footprint"): 953}
    ),
}


def read(log: Log) -> tuple[list[Scan], list[PoseSample]]:
    topics = {stream.topic for stream in log.streams if stream.role is Role.SCAN}
    return list(log.scans(topics)), list(log.poses())


@pytest.mark.parametrize("name", FACTS)
def test_counts_and_frames(name: str) -> None:
    facts = FACTS[name]
    log = open_log(LOGS / name)
    scans, poses = read(log)
    edges = Counter((sample.parent, sample.child) for sample in poses if sample.topic == "/tf")

    assert len(scans) == facts.scans
    assert {(len(scan.ranges), scan.frame) for scan in scans} == {(facts.beams, facts.frame)}
    assert facts.edges.items() <= edges.items()
    assert bool(edges) is bool(facts.edges)
    assert not log.notes
    counts = {stream.topic: stream.count for stream in log.streams}
    assert counts["/scan"] == facts.scans


def test_turtlebot_stamps_lie_ahead_of_the_recording() -> None:
    scans, _ = read(open_log(LOGS / "ros1/test_turtlebot.bag"))

    offsets = {(scan.stamp_ns - scan.record_ns) // 10**9 for scan in scans}

    assert offsets <= {44316, 44317}


def test_special_ranges_come_as_recorded() -> None:
    turtle, _ = read(open_log(LOGS / "ros1/test_turtlebot.bag"))
    laser, _ = read(open_log(LOGS / "ros1/mylaserdata2.bag"))
    mac, _ = read(open_log(LOGS / MAC))

    assert round(100 * np.isnan([scan.ranges for scan in turtle]).mean()) == 10
    assert round(100 * np.isinf([scan.ranges for scan in laser]).mean()) == 9
    assert round(100 * np.isinf([scan.ranges for scan in mac]).mean()) == 23
    finite = [scan.ranges[np.isfinite(scan.ranges)].max() / scan.range_max for scan in mac]
    assert max(finite) > 1


def test_static_transforms_are_static() -> None:
    _, poses = read(open_log(LOGS / MAC))

    assert {sample.topic for sample in poses if sample.static} == {"/tf_static"}
    assert sum(sample.topic == "/odom" for sample in poses) == 920
    assert any(sample.static and sample.child == "rplidar_link" for sample in poses)


def test_conversion_to_mcap_changes_nothing(tmp_path: Path) -> None:
    target = tmp_path / "mac"
    subprocess.run(
        [
            *(sys.executable, "-m", "rosbags.convert", "--dst-storage", "mcap"),
            *("--src-typestore", "ros2_humble", "--src", str(LOGS / MAC), "--dst", str(target)),
        ],
        check=True,
        capture_output=True,
    )
    scans, poses = read(open_log(LOGS / MAC))

    for path in (target, target / "mac.mcap"):
        scans2, poses2 = read(open_log(path))
        assert poses2 == poses
        assert len(scans2) == len(scans)
        for scan, scan2 in zip(scans, scans2, strict=True):
            np.testing.assert_array_equal(scan.ranges, scan2.ranges)
            assert scan._replace(ranges=scan2.ranges) == scan2
