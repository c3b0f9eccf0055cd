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
from occmap.readers.message_types import TYPES
from occmap.types import Pose, PoseSample
from tests.readers.foxglove_logs import (
    SECOND,
    WRITERS,
    Message,
    drive,
    place,
    scan,
    stamp,
    write_json,
    write_protobuf,
)

each_wire = pytest.mark.parametrize("write", WRITERS.values(), ids=list(WRITERS))


def read(log: Log) -> tuple[list[Any], list[PoseSample]]:
    return list(log.scans({"/scan"})), list(log.poses())


@each_wire
def test_scans_and_transforms(write: Callable[..., Path], tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "drive.mcap", drive()))
    scans, poses = read(log)

    assert {(s.topic, s.count, s.role) for s in log.streams} == {
        ("/mount", 1, Role.POSE), ("/tf", 5, Role.POSE), ("/scan", 5, Role.SCAN),
    }  # fmt: skip
    assert [s.stamp_ns for s in scans] == [(100 + k) * SECOND + 5 for k in range(5)]
    np.testing.assert_array_equal(scans[2].ranges, np.array([1, 2.5, 3, 4, 7], np.float32))
    assert scans[2]._replace(ranges=scans[0].ranges) == scans[2]._replace(
        ranges=scans[0].ranges, frame="laser", angle_min=-1.0, angle_increment=0.5,
        range_min=0.0, range_max=math.inf, record_ns=102 * SECOND,
    )  # fmt: skip
    turn = Pose.planar(0.25, 2.0, 0.5)
    assert poses[0] == PoseSample(
        100 * SECOND + 5, "base", "laser", turn, topic="/mount", record_ns=100 * SECOND
    )
    assert [p.pose.x for p in poses[1:]] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert log.notes == []


@each_wire
def test_a_log_builds_to_the_same_map(write: Callable[..., Path], tmp_path: Path) -> None:
    built = build([write(tmp_path / "drive.mcap", drive())], BuildOptions(resolution=0.5))

    assert built.report.scans.used == 5
    expected = build([write_json(tmp_path / "j.mcap", drive())], BuildOptions(resolution=0.5))
    np.testing.assert_array_equal(built.map.log_odds, expected.map.log_odds)


@each_wire
def test_a_scan_that_states_its_origin_has_a_frame_of_its_own(
    write: Callable[..., Path], tmp_path: Path
) -> None:
    scans = [scan(index, place(0.5 * index, 0.1 * index)) for index in range(4)]
    log = open_log(write(tmp_path / "posed.mcap", scans))
    found, poses = read(log)

    assert {s.frame for s in found} == {"laser:scan"}
    assert [(p.parent, p.child) for p in poses] == [("laser", "laser:scan")] * 4
    assert poses[2].pose == Pose.planar(1.0, 2.0, 0.2)
    built = build([log.path], BuildOptions(resolution=0.5))
    assert built.report.scans.used == 4


@each_wire
def test_poses_in_a_frame(write: Callable[..., Path], tmp_path: Path) -> None:
    pose = {"timestamp": stamp(1), "frame_id": "map", "pose": place(1.0, 0.5)}
    poses = {"timestamp": stamp(2), "frame_id": "map", "poses": [place(1.0, 0.5), place(2, 0.5)]}
    path = write(
        tmp_path / "poses.mcap",
        [
            Message("/pose", "foxglove.PoseInFrame", 1, pose),
            Message("/path", "foxglove.PosesInFrame", 2, poses),
        ],
    )
    found = [(p.stamp_ns, p.parent, p.child, p.pose.x) for p in open_log(path).poses()]

    first, second = 101 * SECOND + 5, 102 * SECOND + 5
    assert found == [(first, "map", "", 1.0), (second, "map", "", 1.0), (second, "map", "", 2.0)]


def test_ranges_that_json_cannot_write(tmp_path: Path) -> None:
    message = scan(0)
    message.fields["ranges"] = [None, "Infinity", "NaN", math.inf, 1.5, 1e300]
    ((found,), _) = read(open_log(write_json(tmp_path / "odd.mcap", [message])))

    np.testing.assert_array_equal(found.ranges, [np.nan, np.inf, np.nan, np.inf, 1.5, np.inf])


def test_messages_that_are_not_what_they_claim_are_counted(tmp_path: Path) -> None:
    log = [scan(0), scan(1), Message("/scan", "foxglove.LaserScan", 1, {"ranges": "none"})]
    found = open_log(write_json(tmp_path / "bad.mcap", log))

    assert len(read(found)[0]) == 2
    assert "1 of 3 messages on /scan are damaged" in found.notes[0].text


def test_without_protobuf_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_protobuf(tmp_path / "drive.mcap", drive())
    monkeypatch.setitem(sys.modules, "google.protobuf.message", None)
    log = open_log(path)

    assert read(log) == ([], [])
    assert any("pip install '.[foxglove]'" in note.text for note in log.notes)
    with pytest.raises(LogError):
        build([path], BuildOptions())


def test_descriptors_that_are_damaged_are_noted(tmp_path: Path) -> None:
    path = write_protobuf(tmp_path / "drive.mcap", drive())
    source = open_log(path)
    assert len(read(source)[0]) == 5
    schemas = {stream.type for stream in source.streams}
    assert schemas <= TYPES.keys()
    assert "foxglove.Log" not in TYPES
