"""Beams that the robot blocks, and hits on the robot itself."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from occmap import sensor
from occmap.cells import Box
from occmap.errors import UsageError
from occmap.sensor import NoReturn, ReturnOptions, classify
from occmap.types import Cloud, Kind
from tests.clouds.simulation import place
from tests.samples import make_batch

FRONT, LEFT, BACK, RIGHT = range(4)
ALL = {FRONT, LEFT, BACK, RIGHT}
SKIP, FREE, HIT = Kind.SKIP, Kind.FREE, Kind.HIT


four_beams = partial(make_batch, angle_increment=math.pi / 2, range_max=8.0)
"""To the front, the left, the back and the right."""


@pytest.mark.parametrize(
    ("sector", "expected"),
    [
        ((-0.1, 0.1), {FRONT}),
        ((0.1, -0.1), {LEFT, BACK, RIGHT}),
        ((3.0, -3.0), {BACK}),
        ((math.pi / 2, math.pi), {LEFT, BACK}),  # both edges are inside
        ((-math.pi, math.pi), ALL),
        ((0.0, 2 * math.pi), ALL),
        ((math.radians(260), math.radians(280)), {RIGHT}),
        ((0.2, 0.3), set()),
    ],
)
@pytest.mark.parametrize("turns", [0, -1, 3])
def test_beams_in_a_sector(sector: sensor.Sector, expected: set[int], turns: int) -> None:
    bearings = turns * 2 * math.pi + math.pi / 2 * np.arange(4, dtype=np.float64)
    assert set(np.flatnonzero(sensor.find_inside(bearings, (sector,)))) == expected


def test_sectors_run_counter_clockwise_whatever_way_the_beams_do() -> None:
    bearings = -math.pi / 2 * np.arange(4, dtype=np.float64)
    assert sensor.find_inside(bearings, ((1.0, 2.0),)).tolist() == [False, False, False, True]


def test_what_a_sector_holds_is_skipped_and_counted() -> None:
    batch = four_beams([[1.0, 2.0, np.inf, np.nan], [0.0, 9.0, 3.0, 4.0]])
    options = ReturnOptions(no_return=NoReturn.CLEAR, ignore_sectors=((3.0, -3.0), (-1.6, -1.5)))

    kind, reach, counts = classify(batch, options)

    assert kind.tolist() == [[HIT, HIT, SKIP, SKIP], [SKIP, FREE, SKIP, SKIP]]
    assert reach.tolist() == [[1, 2, 0, 0], [0, 8, 0, 0]]
    assert counts == sensor.ReturnCounts(hit=2, no_return=1, too_close=1, own_robot=4)
    assert sum(counts) == batch.ranges.size


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ((-0.5, -0.3, 0.5, 0.3), [[SKIP, SKIP, SKIP, SKIP], [HIT, HIT, HIT, HIT]]),
        ((-0.25, -0.3, 0.25, 0.3), [[HIT, SKIP, HIT, SKIP], [HIT, HIT, HIT, HIT]]),
        # Before the sensor, and not around it: what is nearer than the box is not the robot.
        ((0.6, -0.1, 1.0, 0.1), [[HIT, HIT, HIT, HIT], [SKIP, HIT, HIT, HIT]]),
    ],
)
def test_hits_in_the_footprint_are_skipped(box: Box, expected: list[list[Kind]]) -> None:
    batch = four_beams([[0.4, 0.3, 0.5, 0.2], [0.75, 0.5, 2.0, 3.0]])

    kind, _, counts = classify(batch, ReturnOptions(footprint=box))

    assert kind.tolist() == expected
    assert counts.own_robot == int((kind == SKIP).sum())


def test_a_footprint_says_nothing_of_beams_that_leave_it() -> None:
    batch = four_beams([[5.0, np.inf, 9.0, 7.9]])
    with_box = classify(batch, ReturnOptions(footprint=(-1, -1, 1, 1), no_return=NoReturn.CLEAR))

    assert with_box[0].tolist() == [[HIT, FREE, FREE, HIT]]


def test_a_slanted_beam_leaves_the_box_at_its_corner() -> None:
    reach = math.hypot(0.5, 0.5)
    batch = four_beams([[reach - 0.01] * 4, [reach + 0.01] * 4], angle_min=math.pi / 4)

    kind, _, _ = classify(batch, ReturnOptions(footprint=(-0.5, -0.5, 0.5, 0.5)))

    assert kind.tolist() == [[SKIP] * 4, [HIT] * 4]


@pytest.mark.parametrize("sector", [(1.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_an_empty_sector_is_refused(sector: sensor.Sector) -> None:
    with pytest.raises(UsageError, match="`ignore_sectors="):
        ReturnOptions(ignore_sectors=(sector,))


@pytest.mark.parametrize("box", [(0, 0, 0, 1), (1, 0, 0, 1), (0, 0, 1, math.inf)])
def test_an_empty_footprint_is_refused(box: Box) -> None:
    with pytest.raises(UsageError, match="is not a footprint; give x_min,y_min,x_max,y_max"):
        ReturnOptions(footprint=box)


PLACES = [(1, 0, 0.5), (0, 1, -2), (-1, 0, 0), (-3, 0.2, 0), (0, -1, 0)]
"""Of points: ahead, to the left, near behind, far behind and to the right"""


@pytest.mark.parametrize(
    ("options", "kept"),
    [
        (ReturnOptions(), {0, 1, 2, 3, 4}),
        (ReturnOptions(footprint=(-1.5, -0.5, 0.2, 0.5)), {0, 1, 3, 4}),
        (ReturnOptions(footprint=(-1, -1, 1, 1)), {3}),
        (ReturnOptions(ignore_sectors=((3.0, -3.0),)), {0, 1, 4}),
        (ReturnOptions(ignore_sectors=((0.1, -0.1),), footprint=(-9, -9, 9, 9)), set()),
    ],
)
def test_points_of_the_robot_are_no_returns(options: ReturnOptions, kept: set[int]) -> None:
    cloud = Cloud(0, "lidar", np.array(PLACES, np.float32))
    seen = sensor.drop_own_points(place(cloud, np.zeros(3), np.eye(3)[None]), options)
    (left,) = seen.batch.clouds or ()
    expected = [each if at in kept else (0, 0, 0) for at, each in enumerate(PLACES)]
    assert np.array_equal(left.points, np.array(expected, np.float32))
    assert cloud.points.any(axis=1).all()  # those of the log stay


def test_points_in_the_frame_of_the_map_are_not_seen_as_the_sensor_saw_them() -> None:
    posed = place(Cloud(0, "map", np.ones((1, 3), np.float32)), np.zeros(3), np.eye(3)[None])
    posed = replace(posed, origin=np.zeros((1, 3)))
    assert sensor.drop_own_points(posed, ReturnOptions(footprint=(-2, -2, 2, 2))) is posed
