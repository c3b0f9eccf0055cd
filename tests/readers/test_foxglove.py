"""Foxglove's schemas in MCAP, as JSON and as protobuf."""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.errors import LogError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import Log, Role, open_log
from occmap.types import Pose, PoseSample
from tests.readers import foxglove_logs as foxglove

each_wire = pytest.mark.parametrize("write", foxglove.WRITERS.values(), ids=list(foxglove.WRITERS))


def read(log: Log) -> tuple[list[Any], list[PoseSample]]:
    return list(log.scans({"/scan"})), list(log.poses())


@each_wire
def test_scans_and_transforms(write: Callable[..., Path], tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "drive.mcap", foxglove.drive()))
    scans, poses = read(log)

    assert {(s.topic, s.count, s.role) for s in log.streams} == {
        ("/mount", 1, Role.POSE), ("/tf", 5, Role.POSE), ("/scan", 5, Role.SCAN),
    }  # fmt: skip
    assert [s.stamp_ns for s in scans] == [(100 + k) * foxglove.SECOND + 5 for k in range(5)]
    np.testing.assert_array_equal(scans[2].ranges, np.array([1, 2.5, 3, 4, 7], np.float32))
    assert scans[2]._replace(ranges=scans[0].ranges) == scans[2]._replace(
        ranges=scans[0].ranges, frame="laser", angle_min=-1.0, angle_increment=0.5,
        range_min=0.0, range_max=math.inf, record_ns=102 * foxglove.SECOND,
    )  # fmt: skip
    turn = Pose.planar(0.25, 2.0, 0.5)
    assert poses[0] == PoseSample(
        100 * foxglove.SECOND + 5,
        "base",
        "laser",
        turn,
        topic="/mount",
        record_ns=100 * foxglove.SECOND,
    )
    assert [p.pose.x for p in poses[1:]] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert log.notes == []


@each_wire
def test_a_scan_that_states_its_origin_has_a_frame_of_its_own(
    write: Callable[..., Path], tmp_path: Path
) -> None:
    scans = [foxglove.scan(index, foxglove.place(0.5 * index, 0.1 * index)) for index in range(4)]
    log = open_log(write(tmp_path / "posed.mcap", scans))
    found, poses = read(log)

    assert {s.frame for s in found} == {"laser:scan"}
    assert [(p.parent, p.child) for p in poses] == [("laser", "laser:scan")] * 4
    assert poses[2].pose == Pose.planar(1.0, 2.0, 0.2)
    built = build([log.path], BuildOptions(resolution=0.5))
    assert built.report.scans.used == 4


@each_wire
def test_poses_in_a_frame(write: Callable[..., Path], tmp_path: Path) -> None:
    here, there = foxglove.place(1.0, 0.5), foxglove.place(2, 0.5)
    pose = {"timestamp": foxglove.stamp(1), "frame_id": "map", "pose": here}
    poses = {"timestamp": foxglove.stamp(2), "frame_id": "map", "poses": [here, there]}
    messages = [
        foxglove.Message("/pose", "foxglove.PoseInFrame", 1, pose),
        foxglove.Message("/path", "foxglove.PosesInFrame", 2, poses),
    ]
    path = write(tmp_path / "poses.mcap", messages)
    found = [(p.stamp_ns, p.parent, p.child, p.pose.x) for p in open_log(path).poses()]

    first, second = 101 * foxglove.SECOND + 5, 102 * foxglove.SECOND + 5
    assert found == [(first, "map", "", 1.0), (second, "map", "", 1.0), (second, "map", "", 2.0)]


def test_ranges_that_json_cannot_write(tmp_path: Path) -> None:
    message = foxglove.scan(0)
    message.fields["ranges"] = [None, "Infinity", "NaN", math.inf, 1.5, 1e300]
    ((found,), _) = read(open_log(foxglove.write_json(tmp_path / "odd.mcap", [message])))

    np.testing.assert_array_equal(found.ranges, [np.nan, np.inf, np.nan, np.inf, 1.5, np.inf])


def test_without_protobuf_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = foxglove.write_protobuf(tmp_path / "drive.mcap", foxglove.drive())
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    log = open_log(path)

    assert read(log) == ([], [])
    assert any("pip install 'protobuf>=4.25'" in note.text for note in log.notes)
    with pytest.raises(LogError, match=r"pip install 'protobuf>=4\.25'"):
        build([path], BuildOptions())
