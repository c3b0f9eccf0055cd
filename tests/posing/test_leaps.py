"""Scans whose poses leap away and back: they are left out, counted and noted; moves stay."""

import math
import struct
from pathlib import Path

import pytest

from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.pipeline import Build, build
from occmap.posing.options import PosingOptions
from occmap.types import Pose
from tests.posing.scenes import at, batch_at, bolted, drive
from tests.posing.scenes import build as make_poser
from tests.samples import REAL_LOGS, Planar, write_csv

DRIVE: list[Planar] = [(second / 2, 0.0, 0.0) for second in range(40)]
LEAP = "further from their neighbours than `max_speed` allows"


def flip(value: float, bit: int) -> float:
    (number,) = struct.unpack("<Q", struct.pack("<d", value))
    (flipped,) = struct.unpack("<d", struct.pack("<Q", number ^ 1 << bit))
    return float(flipped)


def map_drive(folder: Path, poses: list[Planar], **posing: float) -> Build:
    log = write_csv(folder / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    return build([log], BuildOptions(posing=PosingOptions(**posing)))  # type: ignore[arg-type]


@pytest.mark.parametrize("scan", [0, 1, 7, 38, 39])
@pytest.mark.parametrize("x", [1e3, -2e6, flip(3.5, 57), flip(19.5, 56)])
def test_a_scan_that_leaps_is_left_out_and_told(tmp_path: Path, scan: int, x: float) -> None:
    report = map_drive(tmp_path, [*DRIVE[:scan], (x, 0.0, 0.0), *DRIVE[scan + 1 :]]).report
    assert report.scans.dropped == {LEAP: 1}
    assert (report.scans.read, report.scans.used) == (40, 39)
    (note,) = (note for note in report.notes if "`max_speed=inf`" in note)
    assert f"the scan at {scan}.000 s lies" in note
    assert report.map.columns < 600


def test_all_is_kept_on_request(tmp_path: Path) -> None:
    poses = [*DRIVE[:7], (1e3, 0.0, 0.0), *DRIVE[8:]]
    report = map_drive(tmp_path, poses, max_speed=math.inf).report
    assert not report.scans.dropped
    assert report.map.columns > 1000 / 0.05
    (note,) = (note for note in report.notes if "max_speed" in note)
    assert "the scan at 7.000 s lies 997 m from its neighbour, 1 s away: the map reaches" in note


@pytest.mark.parametrize(
    "poses",
    [
        [*DRIVE[:20], *((x + 300, y, yaw) for x, y, yaw in DRIVE[20:])],
        [(30.0 * second, 0.0, 0.0) for second in range(40)],
        [(0.0, 0.0, 0.0), (1e3, 0.0, 0.0), (0.0, 0.0, 0.0)],
        [(80.0 * second, 0.0, 0.0) for second in range(40)],
    ],
    ids=["carried elsewhere", "a car", "three scans", "a train, or wrong units"],
)
def test_what_may_be_so_is_kept(tmp_path: Path, poses: list[Planar]) -> None:
    report = map_drive(tmp_path, poses).report
    assert report.scans.used == len(poses)
    assert not any("`max_speed=inf`" in note for note in report.notes)


def test_a_transform_that_leaps_takes_its_scans_along() -> None:
    """Scans twice as often as transforms: the ones halfway there and back are wrong, too."""
    samples = drive("odom", "base_link", seconds=range(41))
    samples[20] = at(20, "odom", "base_link", Pose.planar(4000.0, 0.0, 0.0))
    poser = make_poser(*samples, bolted("base_link", "laser", Pose.planar(0, 0, 0)))
    seconds = [half / 2 for half in range(81)]
    (posed,), dropped = poser.attach(batch_at(seconds))
    assert {str(reason): scans for reason, scans in dropped.items()} == {LEAP: 3}
    assert posed.position[:, 0].tolist() == [s for s in seconds if not 19 < s < 21]


def test_how_scans_are_batched_changes_nothing() -> None:
    samples = drive("odom", "base_link", seconds=range(61))
    samples[50] = at(50, "odom", "base_link", Pose.planar(4000.0, 0.0, 0.0))
    mount = bolted("base_link", "laser", Pose.planar(0, 0, 0))
    together, apart = (make_poser(*samples, mount) for _ in range(2))
    whole, dropped = together.attach(batch_at(range(61)))
    parts = [apart.attach(batch_at(range(at, min(at + 8, 61)))) for at in range(0, 61, 8)]
    assert sum(sum(each.values()) for _, each in parts) == sum(dropped.values()) == 1
    assert together.notes == apart.notes
    places = [x for posed, _ in parts for each in posed for x in each.position[:, 0]]
    assert places == whole[0].position[:, 0].tolist()


def test_check_sees_the_map_that_build_makes(tmp_path: Path) -> None:
    made = map_drive(tmp_path, [*DRIVE[:7], (1e5, 0.0, 0.0), *DRIVE[8:]])
    seen = inspect([tmp_path / "log.csv"], BuildOptions())
    (topic,) = seen.logs[0].scans
    assert topic.poses.dropped == {LEAP: 1}
    assert seen.map is not None
    assert abs(seen.map.columns - made.report.map.columns) <= 2


@pytest.mark.parametrize("name", ["carmen/intel-corrected.log.gz", "ros1/test_turtlebot.bag"])
def test_no_scan_of_a_real_log_leaps(name: str) -> None:
    path = REAL_LOGS / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    report = build([path], BuildOptions(resolution=0.2)).report
    assert LEAP not in report.scans.dropped
