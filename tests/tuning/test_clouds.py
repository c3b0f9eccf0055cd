"""Clouds are tuned by a planar scan out of each, at the height of its sensor."""

import math
from dataclasses import replace

import numpy as np
import pytest

from occmap.options import BuildOptions
from occmap.posing import PosingOptions
from occmap.sensor import ReturnOptions
from occmap.tuning import tune
from occmap.tuning.search import Verdict, slice_clouds, thin_clouds
from occmap.types import Cloud, Kind
from tests.clouds.simulation import HALL, place, turn

POINTS = [
    (2.0, 0.1, 0.1),
    (3.0, 0.15, 0.0),  # behind it, in the same half degree
    (0.0, 4.0, -0.15),
    (-5.0, 0.1, 0.3),  # too high
    (0.1, 0.1, 0.0),  # the robot itself
    (0.0, -40.0, 0.0),  # too far away
    (math.nan, 1.0, 0.0),
]


def test_a_scan_has_the_nearest_point_of_each_bearing_at_the_height_of_the_sensor() -> None:
    """Whatever way the sensor is turned."""
    turned = turn(20, -10, 30)
    cloud = Cloud(7, "lidar", (np.array(POINTS) @ turned).astype(np.float32))
    rays = slice_clouds(place(cloud, np.array([1.0, 2.0, 3.0]), turned[None]), ReturnOptions())
    (hit,) = rays.kind == Kind.HIT
    ends = rays.end[0, hit]
    assert sorted(ends.tolist()) == [pytest.approx((1, 6)), pytest.approx((3, 2.1))]
    bearings = np.flatnonzero(hit) * (math.tau / 720)
    assert bearings == pytest.approx([math.atan2(0.1, 2), math.pi / 2], abs=math.radians(0.5))


def test_points_that_may_be_of_no_scan_are_not_kept() -> None:
    points = np.zeros((50_000, 3), np.float32)
    points[:, 0], points[:25_000, 2] = 1, 5
    offset_ns = np.arange(len(points))
    cloud = Cloud(7, "lidar", points, offset_ns)
    (kept,) = thin_clouds(place(cloud, np.zeros(3), np.eye(3)[None])).batch.clouds or ()
    assert kept.offset_ns is not None
    assert kept.offset_ns.min() >= 25_000  # those that do not lie 5 m above the sensor
    assert len(kept.points) == len(kept.offset_ns) == pytest.approx(25_000 / 6, abs=2)


def test_a_late_clock_is_found_by_clouds() -> None:
    posing = PosingOptions(time_offset_s=0.15)
    found = tune([HALL], BuildOptions(posing=posing))
    assert found.time.verdict is Verdict.FOUND
    assert found.correction.time_s == pytest.approx(-0.15, abs=0.02)
    (few,) = found.doubts  # three seconds are not much
    assert "too few to tell" in few
    right = tune([HALL], BuildOptions(posing=replace(posing, time_offset_s=0.0)))
    assert not right.correction.is_any
