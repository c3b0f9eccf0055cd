"""Logs in frames of their own, put into one map by --transform; evidence that stays whole."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.errors import UsageError
from occmap.grid.rendering import Framing
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.scoring.compare import combine, compare
from occmap.store.merging import merge
from occmap.types import BEAM_UPDATES, Pose, Update
from occmap.writers.npz import read_evidence
from tests.grid.scans import are_equal
from tests.inspection_logs import Drive, write_bag, write_csv
from tests.posing.scenes import attach, batch_at, bolted, drive, yaw_of
from tests.posing.scenes import build as make_poser
from tests.samples import PLAIN, Planar

DRIVE = [Drive().pose(index) for index in range(20)]
SHIFT = (16.0, -8.5, math.pi / 2)
"""A frame so far away that binary fractions of a metre are moved exactly, a quarter turn round."""


def move_back(pose: Planar) -> Planar:
    """Say where a pose is in a frame that lies at SHIFT."""
    x, y, yaw = pose
    right, up, turn = SHIFT
    return y - up, right - x, yaw - turn


def test_logs_in_frames_of_different_names_are_noted(tmp_path: Path) -> None:
    level = [(0.0, 0.0)]
    first = write_bag(tmp_path / "first.bag", Drive(), level)
    second = write_bag(tmp_path / "second.bag", Drive(), level, correct=lambda _: (0.0, 0.0, 0.0))
    (note,) = (it for it in build([first, second], PLAIN).report.notes if "different frames" in it)
    told = f"{first} in odom, {second} in map", "`map_frame`", "`transform`"
    assert all(words in note for words in told)
    one_frame = replace(PLAIN, posing=PosingOptions(map_frame="odom"))
    for made in (build([first, second], one_frame), build([first, first], PLAIN)):
        assert not [each for each in made.report.notes if "different frames" in each]
    with pytest.raises(UsageError, match=rf"{first} in odom, {second} in map; .* `map_frame`"):
        compare([first, second], combine([Update.BEAM], []), PLAIN)


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_two_sessions_in_different_frames_make_one_map(tmp_path: Path, update: Update) -> None:
    whole = write_csv(tmp_path / "whole.csv", Drive(), poses=DRIVE)
    first = write_csv(tmp_path / "first.csv", Drive(), poses=DRIVE[:8])
    poses = [move_back(pose) for pose in DRIVE[8:]]
    second = write_csv(tmp_path / "second.csv", Drive(), poses=poses, first=8)
    options = replace(PLAIN, update=update)
    moved = replace(options, posing=PosingOptions(transform=Pose.planar(*SHIFT)))

    expected = build([whole], options).map
    build([first], options, [tmp_path / "first.npz"])
    resumed = build([second], replace(moved, resume=tmp_path / "first.npz")).map
    assert resumed.place.tolist() == expected.place.tolist()
    assert np.array_equal(resumed.log_odds, expected.log_odds)
    unmoved = build([second], replace(options, resume=tmp_path / "first.npz")).map
    assert unmoved.shape != expected.shape

    build([second], moved, [tmp_path / "second.npz"])
    halves = [read_evidence(tmp_path / f"{name}.npz") for name in ("first", "second")]
    build([whole], options, [tmp_path / "whole.npz"])
    assert are_equal(merge(halves).tiles, read_evidence(tmp_path / "whole.npz").tiles)


def test_a_transform_moves_the_sensor_of_every_source_of_poses() -> None:
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0.5, 0, 0))]
    poser = make_poser(*samples, transform=Pose.planar(10.0, 20.0, math.pi / 2))
    (posed,), _ = attach(poser, batch_at([0, 4]))
    # On the way along x, 0.5 m ahead of the base; along y in the frame of the map.
    assert posed.position == pytest.approx(np.array([[10, 20.5, 0], [10, 24.5, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)


def test_a_given_angle_turns_the_map_after_the_transform() -> None:
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0, 0, 0))]
    poser = make_poser(*samples, transform=Pose.planar(10.0, 0.0, 0.0), align=90.0)
    (posed,), _ = attach(poser, batch_at([0, 4]))
    assert posed.position == pytest.approx(np.array([[0, 10, 0], [0, 14, 0]]))
    assert yaw_of(posed.rotation) == pytest.approx([math.pi / 2] * 2)


def test_each_beam_of_a_deskewed_scan_is_moved() -> None:
    samples = [*drive("odom", "base_link"), bolted("base_link", "laser", Pose.planar(0, 0, 0))]
    poser = make_poser(*samples, deskew=Deskew.ON, transform=Pose.planar(0.0, 5.0, 0.0))
    (posed,), _ = attach(poser, batch_at([2], beams=3, time_increment=1.0))
    assert posed.position == pytest.approx(np.array([[[2, 5, 0], [3, 5, 0], [4, 5, 0]]]))


def test_an_extent_leaves_the_evidence_whole(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", Drive(), poses=DRIVE)
    whole = build([log], PLAIN, [tmp_path / "whole.npz"])
    framed = replace(PLAIN, framing=Framing(extent=(0.0, 0.0, 2.0, 1.0)))
    made = build([log], framed, [tmp_path / "framed.npz", tmp_path / "framed.pgm"])
    assert (made.report.map.columns, made.report.map.rows) == (40, 20)
    assert made.report.map.extent == made.map.extent == (0.0, 0.0, 2.0, 1.0)
    assert (tmp_path / "framed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    assert whole.report.map.agreement == 1
    assert made.report.map.agreement is None  # no hit lies in it
