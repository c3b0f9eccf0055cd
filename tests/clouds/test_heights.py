"""Peaks of columns of heights, and the ground that is found from them."""

from collections.abc import Sequence

import numpy as np
import pytest

from occmap.cells import Ground
from occmap.clouds import CloudOptions, draw, ground
from occmap.clouds.counting import add_tables, make_table
from occmap.clouds.kernels import growth, heights
from occmap.clouds.kernels.growth import Found
from occmap.clouds.kernels.heights import BIN_MM, BINS, ROOM, SOME, Pieces, list_peaks, pack
from occmap.types import NO_GROUND, Bool, Float64, Int32


@pytest.mark.parametrize(
    ("counts", "heights"),
    [
        ({5: 50}, [5]),  # a floor without noise fills a single bin
        ({5: 25, 6: 25}, [5]),  # or two
        ({4: 10, 5: 30, 6: 10}, [5]),
        ({2: 20, 12: 20}, [2, 12]),  # a floor and what lies on it
        (dict.fromkeys(range(16), 5), []),  # a wall
    ],
)
def test_peaks_of_a_column(counts: dict[int, int], heights: list[int]) -> None:
    bins = np.zeros((1, BINS), np.uint16)
    for height, points in counts.items():
        bins[0, height] = points
    many, found_mm, weight = np.empty(1, np.int32), np.empty(8, np.int32), np.empty(8, np.int32)
    first = np.zeros(1, np.int32)
    pieces = Pieces(first, np.array([pack(3, 4, 0)]), first, bins)
    found = list_peaks(pieces, np.empty(ROOM, np.int64), many, found_mm, weight)
    # A peak lies in its bin, or up to half a bin from its middle towards its neighbour.
    low = np.array(heights) * BIN_MM
    assert len(heights) == found == many
    assert ((found_mm[:found] >= low) & (found_mm[:found] <= low + 1.5 * BIN_MM)).all()


@pytest.mark.parametrize("step_ms", [50, 100, 200, 400, 800])
def test_clouds_at_exact_steps_are_drawn_as_others_are(step_ms: int) -> None:
    drawn = [draw(1_700_000_000_500_000_000 + k * step_ms * 1_000_000) for k in range(1000)]
    shares = np.searchsorted(np.sort(drawn), np.linspace(0.05, 0.95, 19)) / len(drawn)
    assert np.abs(shares - np.linspace(0.05, 0.95, 19)).max() < 0.05


def count_points(points: int) -> heights.Histogram:
    """Count so many points of one place."""
    table, cloud = make_table(4 * SOME), np.tile(np.array([1, 0, -1], np.float32), points)
    posed = heights.Cloud(cloud, heights.ALL_AT_ONCE, np.eye(4)[None, :3], np.zeros(3))
    room = np.empty((3, SOME)), np.empty((2, SOME), np.int64)
    assert heights.count_heights(posed, (table, table), 0, (0.0, 0.0), room) >= points
    return table


@pytest.mark.parametrize("points", [(40_000, 20_000, 30_000), (30_000, 40_000), (70_000, 1)])
def test_counts_end_at_16_bits_whatever_is_added_first(points: tuple[int, ...]) -> None:
    some = add_tables(map(count_points, points[:-1])).counts.sum()
    assert some == min(sum(points[:-1]), 65_535)
    assert add_tables(map(count_points, points)).counts.sum() == 65_535


BLOCKS = growth.index_blocks(np.array([[0, 0]]))
"""One block: column (row, col) lies at 64 row + col."""


def lay(heights: dict[int, int], empty: int = NO_GROUND) -> Int32:
    """A number for each column of a block."""
    laid = np.full(64 * 64, empty, np.int32)
    laid[list(heights)] = list(heights.values())
    return laid


@pytest.mark.parametrize(
    ("weights", "height"),
    # No peak counts that another one holds more than 16 times the points of.
    [((6, 50, 100), -160), ((7, 50, 100), -280), ((10, 100, 200), -160), ((1, 1, 17), 0)],
)
def test_a_few_stray_points_below_the_floor_are_no_ground(
    weights: tuple[int, int, int], height: int
) -> None:
    first, many = lay({0: 0}, empty=0), lay({0: 3}, empty=0)
    heights = np.array([-280, -160, 0], np.int32)
    peaks = growth.Peaks(first, many, heights, np.array(weights, np.int32))
    columns = ground.Shown(BLOCKS, peaks, 1, Pieces(*np.zeros((4, 0), np.int64)))
    found = ground.find_nothing(columns)
    ground.look_beside(
        columns, np.array([[75, 75, 900]]), (7, 0), growth.Layer(700, 1300, growth.STRAY), found
    )
    assert found.height[0] == height


@pytest.mark.parametrize(
    ("rows", "reach_mm", "height_mm", "upper_mm", "rise_mm"),
    [(3, 10, 1000, 0, 0), (0, 10, 1000, 0, 20), (20, 10, 1000, 600, 0), (20, 2500, 600, 0, 0)],
    ids=["table", "slope", "tables", "platform"],
)
def test_ground_is_where_the_robot_went_or_what_lies_low_around(
    rows: int, reach_mm: int, height_mm: int, upper_mm: int, rise_mm: int
) -> None:
    many, level = np.zeros((2, 64, 64), np.int32)
    many[:10, 20:45] = 1  # the floor, from 3.3 m on
    many[31 : 31 + rows, 20:45], level[31:] = 1, 400
    level += (rise_mm * (COL - 31.5)).astype(np.int32)  # which is below the sensor
    first = np.arange(64 * 64, dtype=np.int32)
    peaks = growth.Peaks(first, many.ravel(), level.ravel(), np.ones_like(first))
    columns = ground.Shown(BLOCKS, peaks, 1, Pieces(*np.zeros((4, 0), np.int64)))
    place = np.array([[4800 + x, 5200, 1000] for x in range(-reach_mm, reach_mm + 1, 10)])
    seat = ground.measure_seat(columns, {("log", "topic", "lidar"): place}, None)
    assert seat is not None
    assert abs(seat.height - height_mm) < BIN_MM
    assert abs(seat.upper - upper_mm) < BIN_MM


@pytest.mark.parametrize(
    ("points", "holes"),
    [
        # Of columns 2 to 16 none is measured, and column 8 has points: by height (mm), how many.
        ({8: {-320: 2}}, range(2, 17)),
        ({8: {-300: 2}}, []),
        ({8: {-320: 1}}, []),
        ({8: {-320: 1, -640: 1}, 10: {120: 2}}, range(2, 10)),  # something stands there
        ({8: {-320: 2}, 10: {80: 9}, 11: {1500: 9}}, range(2, 17)),  # too low, and too high
        ({8: {-320: 2, 120: 2}}, [*range(2, 8), *range(9, 17)]),  # a wall that goes on below
        ({3: {-320: 2}}, range(2, 14)),  # 10 columns away it ends
        ({1: {-320: 2}}, []),  # floor that mirrors
    ],
)
def test_ground_that_was_not_measured_around_points_deep_below_it_is_a_hole(
    points: dict[int, dict[int, int]], holes: Sequence[int]
) -> None:
    height, measured = lay(dict.fromkeys(range(19), 0)), lay(dict.fromkeys([0, 1, 17, 18], 1), 0)
    counted = [(at, mm // 20, many) for at, of in points.items() for mm, many in of.items()]
    keys = np.array([pack(0, at, up >> 4) for at, up, _ in counted])
    counts = np.zeros((len(keys), BINS), np.uint16)
    counts[np.arange(len(keys)), [up & 15 for _, up, _ in counted]] = [many for *_, many in counted]
    column, at = np.array([[at for at, *_ in counted], range(len(keys))], np.int32)
    pieces = Pieces(column, keys, at, counts)
    columns = ground.Shown(BLOCKS, growth.Peaks(*np.zeros((4, 0), np.int32)), 1, pieces)
    found, stands = ground.find_holes(columns, height, measured.astype(np.bool_), CloudOptions())
    assert np.flatnonzero(found).tolist() == list(holes)
    assert np.flatnonzero(stands).tolist() == [at for at, of in points.items() if 120 in of]


def drop(height: Int32, weight: Int32, stood: Bool) -> Int32:
    """Give the heights after low things were looked for."""
    base = np.empty_like(height)
    growth.drop_raised(BLOCKS, growth.Found(height, weight, stood), base)
    return base


@pytest.mark.parametrize(("points", "height"), [(99, 40), (101, -160)])
def test_a_column_is_a_low_thing_where_lower_ones_hold_more_points(
    points: int, height: int
) -> None:
    heights = lay({650: 40, 651: -160, 652: -160})
    weight = lay({650: 100, 651: 1, 652: points - 1}, 0)

    base = drop(heights, weight, np.zeros(heights.size, np.bool_))

    assert base[650] == height
    assert base[651] == -160


@pytest.mark.parametrize(
    ("step", "stood", "is_dropped"),
    # A step from one column to the next is more than 60 + 0.12 x 150 = 78 mm.
    [(77, 0, False), (79, 0, True), (79, 1, False), (299, 0, True), (300, 0, False)],
)
def test_a_step_is_of_a_low_thing_where_the_robot_did_not_stand(
    step: int, stood: int, is_dropped: bool
) -> None:
    where = lay({650: stood}, 0).astype(np.bool_)

    base = drop(lay({650: step, 651: 0}), lay({650: 5, 651: 9}, 0), where)

    assert base[650] == (0 if is_dropped else step)


def lay_rows(rows: list[int]) -> Int32:
    """Heights of ground of some columns of a block, by row; none elsewhere."""
    laid = np.full((64, 64), NO_GROUND, np.int32)
    laid[: len(rows), 26:34] = np.array(rows, np.int32)[:, None]
    return laid.ravel()


@pytest.mark.parametrize(
    ("level", "wide", "lost"),
    [(140, 20, [0]), (140, 8, [0, 1, 2, 3]), (70, 20, [])],
    ids=["a pavement loses its brink", "a pallet is gone", "too low for a step"],
)
def test_a_level_that_goes_on_is_given_back_but_for_its_brink(
    level: int, wide: int, lost: list[int]
) -> None:
    first = lay_rows([0] * 20 + [level] * wide + [0] * 20)
    near = np.zeros(first.size, np.bool_)
    base = lay_rows([0] * 60)  # all that was raised is lowered

    growth.restore_levels(BLOCKS, growth.Found(first, np.ones_like(first), near), base)

    rows = base.reshape(64, 64)[20 : 20 + wide // 2, 30]
    assert np.flatnonzero(rows == 0).tolist() == lost


@pytest.mark.parametrize(
    ("level", "first", "stood", "smooth"),
    [
        (20, 0, False, 54),
        (100, 0, False, 14),  # a brink has the ground below it
        (100, 0, True, 80),
        (100, 90, False, 80),  # what lies lower is the brink
    ],
)
def test_ground_is_the_mean_of_peaks_around_that_are_about_as_high(
    level: int, first: int, stood: bool, smooth: int
) -> None:
    found, points = np.array([[0, 100, 20, 80], [6, 9, 3, 1]], np.int32)
    peaks = growth.Peaks(lay({650: 0, 651: 2}, 0), lay({650: 2, 651: 2}, 0), found, points)
    was, base = Found(lay({650: first}), lay({}, 0), np.full(4096, stood)), lay({})

    growth.smooth_ground(BLOCKS, peaks, was, lay({650: 0, 651: level}), base)

    assert base[650:652].tolist() == [(6 * 0 + 3 * 20 + 1 * 80) // 10, smooth]


@pytest.mark.parametrize(("rise", "notes"), [(1500, 0), (3000, 1)])
def test_a_way_over_itself_is_said(rise: int, notes: int) -> None:
    below = np.array([[x, 300, 600] for x in range(0, 5000, 200)])
    above = below[3:6] + np.array([0, 200, rise])

    told = list(ground.list_storeys(np.concatenate([below, above])))

    assert len(told) == notes
    assert all("`start_s`" in each for each in told)


def test_the_height_of_the_ground_at_a_place_by_hand() -> None:
    height, measured = np.zeros((2, 4096), np.int32), np.zeros((2, 4096), np.bool_)
    height[0, 63 * 64 + 62], measured[0, 63 * 64 + 62] = -250, True  # columns (-1, -2)
    height[1, 2 * 64 + 1], measured[1, 2 * 64 + 1] = 400, True  # and (2, 65)
    height[1, 2 * 64 + 2] = 500  # not measured
    ground = Ground(np.array([[-1, -1], [0, 1]]), height, measured)
    places = np.array(
        [[-0.2, -0.1], [65.5 * 0.15, 0.44], [66.5 * 0.15, 0.44], [0.1, 0.1], [1e4, -1e4]]
    )
    np.testing.assert_array_equal(ground.find_heights(places), [-0.25, 0.4, *[np.nan] * 3])


def lay_slope(height: Float64) -> tuple[growth.Blocks, Int32]:
    """Ground in the lower half of a block, none in the upper one."""
    return BLOCKS, np.where(ROW < 32, np.rint(height), NO_GROUND).astype(np.int32).ravel()


COL, ROW = (each.astype(np.float64) for each in np.meshgrid(np.arange(64), np.arange(64)))


def test_a_floor_of_one_level_goes_on_by_its_plane() -> None:
    """2 mm and -1 mm a column, with a pallet in a corner."""
    slope: Float64 = 2 * COL - ROW - 700
    plane = ground.find_level_floor(*lay_slope(slope + np.where(COL + ROW < 6, 150.0, 0.0)))
    assert plane is not None
    places = ground.list_places(BLOCKS, np.arange(64 * 64))
    np.testing.assert_allclose(plane.find_heights(places).reshape(64, 64), slope, atol=1)


def test_what_is_no_plane_does_not_go_on() -> None:
    assert ground.find_level_floor(*lay_slope(np.where(COL > 50, 300.0, 0.0))) is None
    blocks, level = lay_slope(0 * COL)
    for part in (np.arange(4096) < 400, np.arange(4096) % 64 == 7):  # too few, and a line
        assert ground.find_level_floor(blocks, np.where(part, level, NO_GROUND)) is None


@pytest.mark.parametrize(("rise", "goes_on"), [(0, True), (18, True), (-30, True), (50, False)])
def test_ground_goes_on_over_a_gap_as_it_rises_before_it(rise: int, goes_on: bool) -> None:
    """By so many mm a column: in columns 0 to 20 of a row it is found, and 33 to 36 have peaks."""
    level = {at: rise * at for at in range(64)}
    first, many = np.arange(64 * 64, dtype=np.int32), lay(dict.fromkeys(range(33, 37), 1), 0)
    peaks = growth.Peaks(first, many, lay(level), first + 1)
    found = Found(lay({at: level[at] for at in range(21)}), lay({}, 0), np.zeros(4096, np.uint8))
    queue = np.empty((2, 64 * 64), np.int64)

    growth.grow_ground(BLOCKS, peaks, found, 16, 9, queue)

    beyond = found.height[21:64] == lay(level)[21:64]
    assert (21 + np.flatnonzero(beyond)).tolist() == goes_on * [33, 34, 35, 36]


def test_levels_that_were_ground_are_kept_where_a_peak_still_shows_them() -> None:
    first, many = np.array([[0, 1, 3], [1, 2, 1]], np.int32)
    height, weight = np.array([[100, 148, 300, 500], [5, 7, 9, 4]], np.int32)
    before, now = np.array([[100, 150, 150], [20, none := NO_GROUND, none]], np.int32)
    found = Found(now, np.zeros(3, np.int32), np.zeros(3, np.bool_))

    growth.keep_levels(growth.Peaks(first, many, height, weight), before, found)

    assert found.height.tolist() == [20, 148, none]
    assert found.weight.tolist() == [0, 7, 0]


@pytest.mark.parametrize(
    ("back", "below"), [(0, -70), (NO_GROUND, -70), (70, 0)], ids=["brink", "edge", "slope"]
)
def test_a_column_at_a_brink_has_the_ground_of_the_lower_side(back: int, below: int) -> None:
    heights = lay({64 * 5 + 5: 0, 64 * 5 + 6: -70, 64 * 5 + 4: back})
    first = Found(heights.copy(), np.zeros_like(heights), np.zeros(len(heights), np.bool_))
    assert growth.find_below(BLOCKS, first, heights, 64 * 5 + 5) == below


@pytest.mark.parametrize("is_seen", [True, False])
def test_a_level_ends_where_what_lies_beside_it_is_hidden(is_seen: bool) -> None:
    """The lower floor is two columns away from it, and the one between may lie in a shadow."""
    rows = [64 * row for row in range(20)]
    heights = lay({row + col: 0 for row in rows for col in range(12)})
    heights[[row + 13 for row in rows]] = -200
    heights[[row + 12 for row in rows]] = 0 if is_seen else NO_GROUND
    found = Found(heights, np.ones_like(heights), np.zeros(len(heights), np.bool_))
    assert growth.is_level(BLOCKS, found, 64 * 10 + 11) == is_seen


def test_a_ridge_is_no_level() -> None:
    """The ways to what lies lower, on both sides, cancel out."""
    heights = lay({64 * row + col: -200 * (col != 10) for row in range(20) for col in range(21)})
    found = Found(heights, np.ones_like(heights), np.zeros(len(heights), np.bool_))
    assert not growth.is_level(BLOCKS, found, 64 * 10 + 10)
