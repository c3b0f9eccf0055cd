"""Scans whose poses leap away and back: they are left out, counted and noted; moves stay."""

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from occmap.inspection import inspect
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions, Stamps
from occmap.report.results import Build
from occmap.scans import stream
from occmap.scans.stream import stack
from occmap.types import Pose, Scan, ScanBatch
from tests.posing.scenes import SECOND, at, attach_twice, batch_at, bolted, drive
from tests.posing.scenes import build as make_poser
from tests.samples import Planar, find_real, write_csv

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
    (posed,), dropped = attach_twice(poser, batch_at(seconds))
    assert {str(reason): scans for reason, scans in dropped.items()} == {LEAP: 3}
    assert posed.position[:, 0].tolist() == [s for s in seconds if not 19 < s < 21]


def state(xs: Sequence[float], seconds: Sequence[float] | None = None) -> ScanBatch:
    """Scans whose poses stand beside them, one a second unless told otherwise."""
    batch = batch_at(range(len(xs)) if seconds is None else seconds)
    return replace(batch, pose=np.array([Pose.planar(x, 0.0, 0.0) for x in xs]))


HERE = [0.5 * second for second in range(20)]
THERE = [x + 300 for x in HERE]


def leap_by_turns(times: int) -> ScanBatch:
    """Scans of a drive, so many within five seconds that all leap, and the drive again."""
    seconds = [*range(20), *(20 + 5 * leap / times for leap in range(times)), *range(26, 46)]
    return state([*HERE, *(5e3 * (1 + leap % 2) for leap in range(times)), *HERE], seconds)


WAYS = {
    "carried": (state([*HERE, *THERE]), []),
    "one scan": (state([*HERE[:9], 4e3, *HERE[10:]]), [9]),
    "near each other": (state([*HERE[:7], 4e3, 3.5, -2e3, *HERE[10:]]), [7, 8, 9]),
    "from afar and back": (state([*HERE[:9], 2e3, 4e3, 2e3, *HERE[12:]]), [9, 10, 11]),
    "a while elsewhere": (state([*HERE[:6], *THERE[6:12], *HERE[12:]]), [*range(6, 12)]),
    "long elsewhere": (state([*HERE, *THERE, *(x + 20 for x in HERE)]), []),
    "a first and a last one": (state([9e3, *HERE[1:-1], 9e3]), [0, 19]),
    "the second and the last but one": (state([0, 9e3, *HERE[2:-2], 9e3, 9.5]), [1, 18]),
    "beside a pause": (state([*HERE, 9e3, *HERE], [*range(20), *range(99, 120)]), [20]),
    "back after ten seconds": (state([*HERE, 9e3, *HERE], [*range(21), *range(29, 49)]), [20]),
    "back a little later": (
        state([*HERE, 9e3, *HERE], [*range(21), *(29.001 + s for s in range(20))]),
        [],
    ),
    "too far in ten seconds": (
        state([*HERE, 9e3, *(x + 600 for x in HERE)], [*range(21), *range(29, 49)]),
        [],
    ),
    "last after ten seconds": (state([*HERE, 9e3], [*range(20), 29]), [20]),
    "last a little later": (state([*HERE, 9e3], [*range(20), 29.001]), []),
    "two by turns": (state([x for pair in zip(HERE, THERE, strict=True) for x in pair]), []),
    "back after a thousand rows": (leap_by_turns(999), [*range(20, 1019)]),
    "back a row later": (leap_by_turns(1000), []),
    "a train": (state([80.0 * second for second in range(40)]), []),
    "three scans": (state([0, 1e3, 0]), []),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("order", [1, -1])
def test_which_scans_are_left_out(way: str, order: int) -> None:
    """In whatever order they come: their stamps tell the order."""
    whole, outliers = WAYS[way]
    poser, rows = make_poser(), np.arange(len(whole.stamp_ns))
    posed, dropped = attach_twice(
        poser, *(whole.take(rows[at : at + 3]) for at in rows[::3][::order])
    )
    stamps = np.concatenate([each.batch.stamp_ns for each in posed])
    assert np.flatnonzero(~np.isin(whole.stamp_ns, stamps)).tolist() == outliers
    assert sum(dropped.values()) == len(outliers)
    assert len(poser.notes) == (1 if outliers else 0)


def test_lasers_are_judged_one_by_one() -> None:
    """Two on one topic, 300 m apart; the scans of one of them change their geometry meanwhile."""
    lasers = ("here", 0.0, [7, 8]), ("there", 300.0, [3])
    scan = partial(Scan, angle_min=0.0, angle_increment=0.1, range_min=0.0, range_max=10.0)
    scans = []
    for second in range(20):
        for frame, x, leaps in lasers:
            pose = Pose.planar(4e3 if second in leaps else x + second / 2, 0.0, 0.0)
            ranges = np.ones(3 + second % 2, np.float32)
            scans.append(scan(second * SECOND, frame, ranges=ranges, pose=pose, topic="/scan"))
    poser = make_poser()
    _, dropped = attach_twice(poser, *stack(scans, Stamps.HEADER))
    assert dropped == {LEAP: 3}
    here, there = poser.notes
    assert here.startswith("/scan: the scan at 7.000 s lies 3,997 m from its neighbour, 1 s away")
    assert "2 scans left out" in here
    assert "the scan at 3.000 s" in there


@pytest.mark.parametrize(
    "selection", [Selection(), Selection(stride=3), Selection(start_s=4.0, end_s=31.0)]
)
def test_jobs_and_batches_leave_out_the_same_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, selection: Selection
) -> None:
    poses = [*DRIVE[:14], *((x + 900, y, yaw) for x, y, yaw in DRIVE[14:18]), *DRIVE[18:]]
    log = write_csv(tmp_path / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    reports = []
    for beams, jobs in ((1, 1), (1 << 18, 2)):
        monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
        report = build([log], BuildOptions(selection=selection, jobs=jobs)).report
        reports.append(replace(report, seconds={}))
    assert reports[0] == reports[1]
    assert reports[0].scans.dropped[LEAP] == (1 if selection.stride == 3 else 4)
    assert sum(reports[0].scans.dropped.values()) + reports[0].scans.used == 40


def test_check_sees_the_map_that_build_makes(tmp_path: Path) -> None:
    made = map_drive(tmp_path, [*DRIVE[:7], (1e5, 0.0, 0.0), *DRIVE[8:]])
    seen = inspect([tmp_path / "log.csv"], BuildOptions())
    (topic,) = seen.logs[0].scans
    assert topic.poses.dropped == {LEAP: 1}
    assert seen.map is not None
    assert abs(seen.map.columns - made.report.map.columns) <= 2


@pytest.mark.parametrize("name", ["carmen/intel-corrected.log.gz", "ros1/test_turtlebot.bag"])
def test_no_scan_of_a_real_log_leaps(name: str) -> None:
    report = build([find_real(name)], BuildOptions(resolution=0.2)).report
    assert LEAP not in report.scans.dropped
