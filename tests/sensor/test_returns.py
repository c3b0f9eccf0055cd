"""What range values mean, against tables written by hand; where beams point, against geometry."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap import sensor
from occmap.cells import Box
from occmap.errors import UsageError
from occmap.sensor import NoReturn, ReturnCounts, ReturnOptions, classify, interpret
from occmap.types import Cloud, Kind, PosedScans, Rays, Scan, ScanBatch
from tests.clouds.simulation import place
from tests.posing.scenes import matrix_of
from tests.samples import make_batch

INF, NAN = math.inf, math.nan
HIT, FREE, SKIP = Kind.HIT, Kind.FREE, Kind.SKIP


def look(batch: ScanBatch, place: tuple[float, ...] = (0, 0, 0), **angles: float) -> Rays:
    """Where the beams go of a sensor at a place, turned by roll, pitch and yaw."""
    scans = len(batch.stamp_ns)
    position, rotation = np.array([place] * scans, float), np.array([matrix_of(**angles)] * scans)
    return interpret(PosedScans(batch, position, rotation), ReturnOptions())[0]


# The sensor states 0.1 to 10 m; --max-range is 8. Value, meaning by --no-return=ignore and =clear.
TABLE = [
    (NAN, SKIP, SKIP, 0),
    (-INF, SKIP, SKIP, 0),
    (-3.0, SKIP, SKIP, 0),
    (-0.0, SKIP, SKIP, 0),
    (0.0, SKIP, SKIP, 0),
    (1e-42, SKIP, SKIP, 0),
    (0.09999, SKIP, SKIP, 0),
    (0.1, HIT, HIT, 0.1),  # the limit in float32, as the sensor writes it, is within
    (2.0, HIT, HIT, 2.0),
    (8.0, HIT, HIT, 8.0),
    (8.0001, FREE, FREE, 8.0),
    (9.999, FREE, FREE, 8.0),
    (10.0, SKIP, FREE, 8.0),
    (81.83, SKIP, FREE, 8.0),
    (INF, SKIP, FREE, 8.0),
]  # fmt: skip


@pytest.mark.parametrize(("value", "ignoring", "clearing", "reach"), TABLE)
@pytest.mark.parametrize("no_return", list(NoReturn))
def test_meaning_of_a_range(
    value: float, ignoring: Kind, clearing: Kind, reach: float, no_return: NoReturn
) -> None:
    kind, distance, _ = classify(
        make_batch([[value]]), ReturnOptions(max_range=8.0, no_return=no_return)
    )
    expected = ignoring if no_return is NoReturn.IGNORE else clearing
    assert kind.tolist() == [[expected]]
    assert distance[0, 0] == (np.float32(reach) if expected else 0)


def test_tally_of_the_table() -> None:
    batch = make_batch([[value for value, *_ in TABLE]])
    _, _, counts = classify(batch, ReturnOptions(max_range=8.0))
    assert counts == ReturnCounts(hit=3, beyond_max_range=2, no_return=3, too_close=6, nan=1)
    assert sum(counts) == len(TABLE)


CLEAR = NoReturn.CLEAR
LIMITS_OF_BOTH = {
    "the sensor's is nearer": ([INF], 10.0, ReturnOptions(no_return=CLEAR), [FREE], [10.0]),
    "the user's is nearer": (
        [INF, 7.0], INF, ReturnOptions(max_range=6.0, no_return=CLEAR), [FREE, FREE], [6.0, 6.0],
    ),
    "there is none": ([INF, 1e30], INF, ReturnOptions(no_return=CLEAR), [SKIP, HIT], [0.0, 1e30]),
    "the user's is for the sensor": (
        [4.0, 6.0], 10.0, ReturnOptions(range_max=5.0), [HIT, SKIP], [4.0, 0.0],
    ),
    "they cross": (
        [1.0, 6.0, 9.0, 11.0, INF], 5.0, ReturnOptions(8.0, 10.0, no_return=CLEAR),
        [SKIP, SKIP, FREE, FREE, FREE], [0.0, 0.0, 5.0, 5.0, 5.0],
    ),
    **{
        f"no float32 holds {limit}": (
            [3.0, INF], 10.0, ReturnOptions(range_max=limit), [HIT, SKIP], [3.0, 0.0],
        )
        for limit in (1e39, 1.7976931348623157e308, INF)
    },
}  # fmt: skip
"""Ranges, the limit that a log states, what a user says; what the ranges mean, and their reach"""


@pytest.mark.parametrize("case", LIMITS_OF_BOTH)
def test_the_limits_of_a_sensor_and_of_a_user_hold_together(case: str) -> None:
    ranges, range_max, options, kinds, reach = LIMITS_OF_BOTH[case]
    batch = make_batch([ranges], range_min=1e-300, range_max=range_max)
    kind, distance, counts = classify(batch, options)
    assert kind.tolist() == [kinds]
    assert distance[0].tolist() == np.array(reach, np.float32).tolist()
    assert sum(counts) == len(ranges)


LIMITS = st.sampled_from([0.0, 0.1, 2.5, 10.0, INF])


@settings(max_examples=100, derandomize=True, database=None)
@given(
    values=st.lists(st.floats(width=32), min_size=1, max_size=20),
    range_min=LIMITS,
    range_max=LIMITS,
    no_return=st.sampled_from(NoReturn),
)
def test_every_beam_is_counted_once(
    values: list[float], range_min: float, range_max: float, no_return: NoReturn
) -> None:
    options = ReturnOptions(0.2, 5.0, no_return=no_return)
    batch = make_batch([values], range_min=range_min, range_max=range_max)
    kind, distance, counts = classify(batch, options)
    assert min(counts) >= 0
    assert sum(counts) == len(values)
    assert counts.hit == np.count_nonzero(kind == HIT)
    free = counts.beyond_max_range + (counts.no_return if no_return is NoReturn.CLEAR else 0)
    assert free == np.count_nonzero(kind == FREE)
    assert np.isfinite(distance).all()
    assert not distance[kind == SKIP].any()


def test_tallies_add_up() -> None:
    total = ReturnCounts(1, 2, 3, 4, 5, 6) + ReturnCounts(10, 20, 30, 40, 50, 60)
    assert total == (11, 22, 33, 44, 55, 66)
    assert ReturnCounts() + total == total


@pytest.mark.parametrize(
    ("stated", "read"),
    [
        ((0.1, 0.8), (0.1, 0.8)),
        ((0.0, 30.0), (0.0, 30.0)),
        ((-0.1, 0.0), (0.0, INF)),
        ((NAN, NAN), (0.0, INF)),
        ((-INF, -1.0), (0.0, INF)),
    ],
)
def test_a_limit_that_no_range_is_within_is_none(
    stated: tuple[float, float], read: tuple[float, float]
) -> None:
    ranges = np.ones(1, np.float32)
    assert sensor.read_limits(Scan(0, "laser", 0.0, 0.1, ranges, *stated)) == read


def test_a_beam_ends_where_range_and_bearing_say() -> None:
    batch = make_batch([[2.0, 3.0]], angle_min=0.3, angle_increment=0.2)
    rays = look(batch, (7.0, -4.0, 1.0), yaw=0.5)
    expected = [
        [7 + 2 * math.cos(0.8), -4 + 2 * math.sin(0.8)],
        [7 + 3 * math.cos(1.0), -4 + 3 * math.sin(1.0)],
    ]
    np.testing.assert_allclose(rays.end[0], expected, atol=1e-12)


def test_rays_know_when_each_scan_was_taken() -> None:
    batch = make_batch([[2.0], [3.0], [4.0]], stamp_ns=np.array([7, 5, 9]))
    rays = look(batch)
    assert rays.stamp_ns.tolist() == [7, 5, 9]
    some = rays.take(np.array([True, False, True]))
    assert (some.stamp_ns.tolist(), some.distance[:, 0].tolist()) == ([7, 9], [2, 4])


def test_an_upside_down_lidar_sees_bearings_mirrored() -> None:
    batch = make_batch([[2.0] * 5], angle_min=-0.4, angle_increment=0.3)
    level = look(batch)
    inverted = look(batch, roll=math.pi)
    np.testing.assert_allclose(inverted.end, level.end * [1, -1], atol=1e-12)


@pytest.mark.parametrize("pitch", [0.6, math.pi / 2])
def test_a_tilted_lidar_is_shortened_along_its_tilt_and_not_across_it(pitch: float) -> None:
    """One that looks straight down ends below itself."""
    rays = look(make_batch([[2.0, 2.0]], angle_increment=math.pi / 2), pitch=pitch)
    np.testing.assert_allclose(rays.end[0], [(2 * math.cos(pitch), 0), (0, 2)], atol=1e-12)


def test_each_beam_may_have_its_own_pose() -> None:
    batch = make_batch([[1.0, 2.0]])
    posed = PosedScans(
        batch,
        position=np.array([[[0.0, 0.0, 0.0], [5.0, 1.0, 0.0]]]),
        rotation=np.array([[matrix_of(yaw=0.0), matrix_of(yaw=0.4)]]),
    )
    rays, _ = interpret(posed, ReturnOptions())
    assert rays.origin.shape == (1, 2, 2)
    expected: list[list[float]] = [[1.0, 0.0], [5 + 2 * math.cos(0.5), 1 + 2 * math.sin(0.5)]]
    np.testing.assert_allclose(rays.end[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("beams", "increment", "round_it_goes"),
    [
        (360, math.radians(1), True),
        (361, math.radians(1), True),  # both ends written
        (359, math.radians(1), False),  # one beam is missing, so the gap is two increments
        (360, -math.radians(1), True),
        (720, math.radians(0.5) * (1 - 1e-7), True),  # float32 increments are not exact
        (400, math.radians(1), True),
        (181, math.radians(1), False),
        (1, 0.0, False),
    ],
)
def test_whether_a_scan_goes_all_the_way_round(
    beams: int, increment: float, round_it_goes: bool
) -> None:
    batch = make_batch([[1.0] * beams], angle_increment=increment)
    assert sensor.goes_round(batch) is round_it_goes
    rays = look(batch)
    assert rays.full_circle is round_it_goes


def test_batches_of_other_geometry_are_not_mixed_up() -> None:
    batch = make_batch([[1.0]])
    turned = replace(batch, angle_min=1.0)
    for one, bearing in ((batch, 0.0), (turned, 1.0), (batch, 0.0)):
        rays = look(one)
        np.testing.assert_allclose(rays.direction[0, 0], [math.cos(bearing), math.sin(bearing)])


FRONT, LEFT, BACK, RIGHT = range(4)
ALL = {FRONT, LEFT, BACK, RIGHT}


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


def test_a_slanted_beam_leaves_the_box_at_its_corner_and_clears() -> None:
    reach = math.hypot(0.5, 0.5)
    ranges = [[reach - 0.01] * 4, [reach + 0.01] * 4, [5.0, np.inf, 9.0, 7.9]]
    box = ReturnOptions(footprint=(-0.5, -0.5, 0.5, 0.5), no_return=NoReturn.CLEAR)
    kind, _, _ = classify(four_beams(ranges, angle_min=math.pi / 4), box)
    assert kind.tolist() == [[SKIP] * 4, [HIT] * 4, [HIT, FREE, FREE, HIT]]


@pytest.mark.parametrize(
    "given",
    [
        *({"min_range": low, "max_range": high} for low, high in ((-1, INF), (3, 3), (NAN, 5))),
        {"range_max": 0.0},
        *({"ignore_sectors": [it]} for it in ((1.0, 1.0), (math.nan, 1.0), (0.0, math.inf))),
        *({"footprint": it} for it in ((0, 0, 0, 1), (1, 0, 0, 1), (0, 0, 1, math.inf))),
    ],
)
def test_options_that_leave_nothing_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=r"`(min|max)_range=|range_max|sectors=|give x_min"):
        ReturnOptions(**given)


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
