"""What becomes of simple things in a map of clouds."""

from dataclasses import replace

import numpy as np
import pytest

from occmap.clouds import CloudOptions, engine
from occmap.clouds.counting import Counter, count_clouds
from occmap.clouds.ground import derive_ground, measure_level
from occmap.clouds.kernels.heights import Cloud
from occmap.errors import MapError, UsageError
from occmap.types import Float64, PosedScans
from tests.clouds.reference import SlowEngine
from tests.clouds.simulation import (
    ROOM,
    Room,
    change_points,
    classify,
    count,
    drive,
    find_cells,
    find_ground,
    observe,
    read_points,
    turn,
)

TABLE = [
    (3.0, 4.0, 4.5, 5.0, 0.72, 0.76),
    *((x, x + 0.04, y, y + 0.04, 0.0, 0.72) for x in (3.0, 3.96) for y in (4.5, 4.96)),
]
BOX = (5.0, 5.3, 1.5, 1.8, 0.0, 0.18)
OPTICAL = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])


Z = np.array([0.0, 0.0, 1.0])
PIT = (2.1, 4.2, 3.9, 5.1, -1.0, 0.0)


@pytest.mark.parametrize("sensor_m", [0.6, 2.2])
@pytest.mark.parametrize("room", [Room([*TABLE, BOX], slope=0.06), Room([BOX], pit=PIT)])
def test_the_kernel_equals_the_reference_in_every_cell(room: Room, sensor_m: float) -> None:
    posed = drive(room, clouds=6, sensor_m=sensor_m)
    ground = find_ground(posed)
    slow = SlowEngine(ground, CloudOptions())
    for each in posed[::2]:
        slow.add(each)

    hits, misses = count(observe(posed[::2], ground))

    for found, expected in ((hits, slow.hits), (misses, slow.misses)):
        wanted = np.zeros(found.shape, np.int64)
        for (row, col), number in expected.items():
            wanted[row - ROOM.row, col - ROOM.col] = number
        assert wanted.sum() > 500
        np.testing.assert_array_equal(found, wanted)


def test_a_table_stands_in_the_way_of_a_high_robot_only() -> None:
    posed = drive(Room(TABLE))
    top = find_cells((3.2, 3.8), (4.5, 4.6))

    assert classify(posed)[0][top].any(axis=0).all()
    assert not classify(posed, CloudOptions(max_height=0.6))[0][top].any()


def test_floor_that_is_seen_beneath_a_thing_is_not_free_and_floor_seen_over_one_is() -> None:
    # From 0.6 m above the path the plank hides the floor up to y = 5.4.
    car, plank = (2.0, 4.5, 4.0, 5.2, 0.25, 1.2), (6.0, 8.5, 4.6, 4.8, 0.0, 0.15)
    _, free = classify(drive(Room([car, plank])))

    assert not free[find_cells((2.1, 4.4), (4.1, 5.1))].any()
    assert free[find_cells((6.0, 8.5), (5.5, 5.9))].mean() > 0.9


@pytest.mark.parametrize(
    ("sensor_m", "x", "is_free"),
    # From 2.2 m the lowest beam reaches the floor 2.6 m away, and is 1.5 m above it at 0.8 m.
    [(2.2, 1.55, False), (2.2, 1.75, True), (1.4, 0.85, True)],
)
def test_floor_that_beams_pass_over_above_the_robot_is_not_free(
    sensor_m: float, x: float, is_free: bool
) -> None:
    _, free = classify(drive(Room(), clouds=1, sensor_m=sensor_m))

    assert free[find_cells((x, x + 0.05), (3.0, 3.05))].any() == is_free


def test_what_beams_only_pass_high_over_counts_a_quarter() -> None:
    """From 1.2 m, the beam to floor 3.1 m away is below 0.94 m from 0.68 m on."""
    posed = drive(Room(), clouds=2, sensor_m=1.2)
    points = np.array([[3.1, 0, -1.2], [6.0, 0, 0]])
    _, misses = count(observe([change_points(posed[0], points)], find_ground(posed)))

    x, y = posed[0].position[0, :2]
    away = x + np.array([0.6, 0.75, 3.9, 4.1, 5.9, 6.1])
    cells = int(y / 0.05) + 10, (away / 0.05).astype(int) + 10
    assert misses[cells].tolist() == [1, 4, 4, 1, 1, 0]


def test_a_lintel_and_a_low_duct_do_not_appear_and_a_box_stays_though_beams_pass_over_it() -> None:
    lintel, duct = (6.0, 6.2, 0.0, 6.0, 2.0, 2.5), (2.0, 2.1, 0.0, 6.0, 0.0, 0.06)
    occupied, free = classify(drive(Room([lintel, duct, BOX])))

    for there in (find_cells((6.0, 6.2), (1.0, 5.0)), find_cells((1.9, 2.2), (0.5, 5.5))):
        assert not occupied[there].any()
        assert free[there].mean() > 0.97
    assert occupied[find_cells((5.0, 5.3), (1.75, 1.8))].all()


def test_a_ramp_is_free_and_what_stands_on_it_is_not() -> None:
    occupied, free = classify(drive(Room([(6.5, 6.8, 4.0, 4.3, 0.2, 0.6)], slope=0.1)))
    ramp = find_cells((4.0, 8.0), (0.5, 3.9))

    assert not occupied[ramp].any()
    assert free[ramp].mean() > 0.99
    assert occupied[find_cells((6.5, 6.8), (4.0, 4.05))].mean() > 0.6


def test_a_kerb_is_an_edge() -> None:
    occupied, _ = classify(drive(Room([(0.0, 10.0, 4.5, 6.0, 0.0, 0.14)])))

    assert occupied[find_cells((1.0, 9.0), (4.5, 4.55))].mean() > 0.8


def test_a_pavement_is_free_behind_its_kerb_and_a_pallet_is_not() -> None:
    pavement, up_to_it = (0.0, 10.0, 4.2, 6.0, 0.0, 0.14), (8.0, 10.0, 3.7, 4.2, 0.0, 0.07)
    pallet = (4.4, 5.6, 1.0, 1.8, 0.0, 0.14)
    occupied, free = classify(drive(Room([pavement, up_to_it, pallet])))

    assert occupied[find_cells((1.0, 7.5), (4.2, 4.25))].mean() > 0.8
    assert not occupied[find_cells((1.0, 9.0), (4.7, 5.8))].any()
    assert free[find_cells((1.0, 9.0), (4.7, 5.8))].mean() > 0.75  # the rest was not seen
    assert occupied[find_cells((4.4, 5.6), (1.0, 1.8))].mean() > 0.8


def test_the_ground_does_not_climb_a_kerb_that_poses_blur() -> None:
    noise = np.random.default_rng(1)
    posed = [
        replace(each, position=each.position + noise.normal(0, (0.02, 0.02, 0.03)))
        for each in drive(Room([(0.0, 10.0, 4.5, 6.0, 0.0, 0.12)]), clouds=24)
    ]
    occupied, _ = classify(posed)

    assert occupied[find_cells((1.0, 9.0), (4.5, 4.55))].mean() > 0.75


def nod(steady: list[PosedScans], seed: int) -> list[PosedScans]:
    """Let poses be off by 2 cm in height, and by 0.4 degrees."""
    noise = np.random.default_rng(seed).normal(0, [0.02, 0.4, 0.4], (len(steady), 3))
    return [
        replace(it, position=it.position + up * Z, rotation=turn(roll, pitch, 0) @ it.rotation)
        for it, (up, roll, pitch) in zip(steady, noise, strict=True)
    ]


def test_poses_that_nod_and_bob_make_the_map_of_steady_ones() -> None:
    steady = drive(Room([*TABLE, BOX]), clouds=12)
    for mine, its in zip(classify(steady), classify(nod(steady, 3)), strict=True):
        assert (mine != its).mean() < 0.01


def test_a_pavement_that_only_blurred_clouds_lead_up_to_stays_free() -> None:
    posed = nod(drive(Room([(0.0, 10.0, 4.2, 6.0, 0.0, 0.15)]), clouds=48), 5)
    occupied, free = classify(posed)

    assert occupied[find_cells((1.0, 7.5), (4.2, 4.25))].mean() > 0.8
    assert free[find_cells((1.0, 9.0), (4.7, 5.8))].mean() > 0.95


@pytest.mark.parametrize(
    "mounts",
    [
        [turn(0, 20, 30)],
        [turn(180, 0, 45)],
        [OPTICAL],
        [turn(4 * np.sin(k), 5 * np.cos(k), k) for k in range(33)],  # it walks
    ],
    ids=["tilted", "upside-down", "optical", "walking"],
)
def test_however_the_sensor_sits_the_map_is_the_same(mounts: list[Float64]) -> None:
    room = Room([*TABLE, BOX])
    level, other = (classify(drive(room, each, clouds=12)) for each in ([np.eye(3)], mounts))

    # Points are kept as float32: a few lie on the other side of the border of a cell.
    for mine, its in zip(level, other, strict=True):
        assert (mine != its).mean() < 1e-3


def shuffle(posed: PosedScans) -> PosedScans:
    return change_points(posed, np.random.default_rng(7).permutation(read_points(posed)))


def test_the_rim_of_a_pit_is_an_edge_that_is_seen_from_above_and_its_inside_is_not_free() -> None:
    occupied, free = classify(drive(Room(pit=PIT)))

    assert not free[find_cells((2.4, 3.9), (4.2, 4.8))].any()
    assert occupied[find_cells((2.3, 4.0), (3.75, 3.95))].any(axis=0).mean() > 0.9
    assert free[find_cells((2.3, 4.0), (3.2, 3.7))].all()


def test_a_pit_is_not_free_for_a_session_that_did_not_look_into_it() -> None:
    posed = drive(Room(pit=PIT))
    counted = count_clouds(posed[-5:])
    inside = find_cells((2.4, 3.9), (4.2, 4.8))

    for known, is_free in ((find_ground(posed), False), (None, True)):
        ground, _ = derive_ground(counted, CloudOptions(), known)
        assert count(observe(posed[-5:], ground))[1][inside].any() == is_free


def test_a_floor_that_mirrors_has_no_holes() -> None:
    posed = drive(Room([BOX]))
    points = [read_points(each) for each in posed]
    below = [turned * (1, 1, -1) - (0, 0, 1.2) for turned in (p[p[:, 2] > -0.5] for p in points)]
    mirrored = [
        change_points(each, np.concatenate([p, q]))
        for each, p, q in zip(posed, points, below, strict=True)
    ]

    for map_, other in zip(classify(posed), classify(mirrored), strict=True):
        assert (map_ != other).mean() < 0.002


def test_neither_the_order_of_points_nor_that_of_clouds_counts() -> None:
    posed = drive(Room([BOX], slope=0.05, pit=PIT), clouds=8)
    mixed = [shuffle(each) for each in posed[::-1]]

    ground, other = find_ground(posed), find_ground(mixed)

    np.testing.assert_array_equal(ground.height_mm, other.height_mm)
    np.testing.assert_array_equal(count(observe(posed, ground)), count(observe(mixed, other)))


def test_halves_over_one_ground_and_in_small_sheets_add_up_to_the_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    posed = drive(Room([BOX]), clouds=8)
    whole = count(observe(posed, ground := find_ground(posed)))

    monkeypatch.setattr(engine, "MANY_TILES", 1)
    monkeypatch.setattr(engine, "MOST_CLOUDS", 1)
    begun, clear = iter(range(6)), engine.Sheet.clear
    monkeypatch.setattr(engine.Sheet, "clear", lambda *it: (next(begun), clear(*it)))
    halves = [count(observe(some, ground)) for some in (posed[:3], posed[3:])]
    np.testing.assert_array_equal(sum(halves), whole)
    assert next(begun) == 5  # whichever begins anew has room to go on


def test_the_ground_is_measured_to_a_centimetre() -> None:
    room = Room(slope=0.08)
    ground = find_ground(drive(room))
    (at,) = np.flatnonzero((ground.blocks == 0).all(axis=1))  # 0 to 9.6 m along x and y
    height, measured = ground.height_mm[at], ground.measured[at]
    x = (np.arange(64) + 0.5) * 0.15
    level = np.broadcast_to(room.floor(np.asarray(x, np.float64)) * 1000, (64, 64)).reshape(-1)

    assert measured.sum() > 200
    assert np.quantile(np.abs(height - level)[measured], 0.95) < 16


def test_the_ground_is_the_same_wherever_in_the_world_a_drive_is() -> None:
    near = drive(Room([BOX]), clouds=6)
    far_away = np.array([600_000, -6_000_000, 300])
    far = [replace(each, position=each.position + far_away) for each in near]

    here, there = find_ground(near), find_ground(far)

    assert here.measured.any()
    blocks_away = np.array([-625_000, 62_500])  # rows and columns of 9.6 m
    np.testing.assert_array_equal(there.blocks, here.blocks + blocks_away)
    np.testing.assert_array_equal(there.height_mm - 300_000, here.height_mm)


def test_no_floor_in_view_is_refused_with_what_to_type() -> None:
    clouds = [(posed, read_points(posed)) for posed in drive(Room(), clouds=4)]
    above = [change_points(posed, points[points[:, 2] > 0]) for posed, points in clouds]
    with pytest.raises(MapError, match="sensor_height"):
        find_ground(above)


def test_points_in_millimetres_are_refused_and_clouds_of_zeros_not_as_such() -> None:
    clouds = drive(Room(), clouds=4)
    with pytest.raises(MapError, match="are these millimetres"):
        find_ground([change_points(each, 1000 * read_points(each)) for each in clouds])
    with pytest.raises(MapError, match="sensor_height"):
        find_ground([change_points(each, 0 * read_points(each)) for each in clouds])


def test_clouds_in_the_map_may_be_seen_from_where_the_robot_stands() -> None:
    clouds = drive(Room(), clouds=4)
    standing = [replace(it, origin=it.position - [0, 0, 0.61]) for it in clouds]
    seen, expected = (find_ground(some).measured.sum() for some in (standing, clouds))
    assert seen == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("sensor_m", "set_off_m"), [(0.0, 0.9), (5000.0, 0.0)])
def test_tiles_reach_as_far_from_the_sensor_as_points(sensor_m: float, set_off_m: float) -> None:
    """It sets off late in a cloud, or that is in the map already, of which a zero is no point."""
    points = np.array([sensor_m + 20.95, 0, 0, 0, 0, 0], np.float32)
    poses = np.eye(3, 4) + np.reshape([0, 0, set_off_m], (3, 1, 1)) * np.eye(3, 4, 3)
    cloud = Cloud(points, np.array([2, 0], np.int32), poses, np.array([sensor_m, 0, 0]))
    assert 20.95 + set_off_m <= engine.find_farthest(cloud) <= 21.95 + set_off_m


@pytest.mark.parametrize(("height_m", "notes"), [(None, 1), (0.6, 1), (0.3, 2)])
def test_that_hardly_any_floor_is_seen_is_told(height_m: float | None, notes: int) -> None:
    """A box of 0.3 m is all that lies as deep as the sensor is said to be high."""
    counted = count_clouds(drive(Room([(4.0, 4.4, 3.4, 3.8, 0.0, 0.3)]), clouds=4))
    told = derive_ground(counted, CloudOptions(sensor_height=height_m))[1]
    assert len(told) == notes
    assert all("hardly any floor" in note for note in told[1:])


def test_a_roof_that_is_left_out_is_not_taken_for_the_floor() -> None:
    roof = np.mgrid[-1:1:160j, -0.7:0.7:120j, -0.25:-0.25:1j].reshape(3, -1).T
    clouds = [(it, read_points(it)[::4]) for it in drive(Room(), clouds=40)]
    covered = [change_points(it, np.concatenate([some, roof])) for it, some in clouds]
    for near, height in (0.0, "0.25 m"), (1.3, "0.59 m"):
        counter = Counter(len(covered), kept=(0, 0), min_range=near)
        for each in covered:
            counter.add(each)
        assert height in derive_ground(counter.count(), CloudOptions())[1][0]
    assert measure_level(np.repeat([250, 1800], [80, 20]), 0.5) == (250, 140, 0, 1800)


def test_heights_that_leave_no_band_are_refused() -> None:
    with pytest.raises(UsageError, match="`min_height` below the `max_height`"):
        CloudOptions(min_height=1.0, max_height=1.0)
    with pytest.raises(UsageError, match="`ground=flat`"):
        CloudOptions(ground="level")


def test_each_sensor_finds_the_ground_by_its_own_height() -> None:
    load = (3.0, 5.0, 3.6, 4.6, 0.0, 1.4)
    low, high = (drive(Room([load]), sensor_m=height) for height in (0.4, 1.8))
    counter = Counter(len(low), "two.bag")
    for topic, drives in (("/low", low), ("/top", high)):
        for each in drives:
            counter.add(replace(each, batch=replace(each.batch, topic=topic)))

    ground, (note,) = derive_ground(counter.count(), CloudOptions())

    beside_and_on_it = np.array([[2.5, 3.4], [4.0, 4.0]])
    np.testing.assert_allclose(ground.find_heights(beside_and_on_it), [0.0, np.nan], atol=0.03)
    assert "0.39 m (two.bag /low)" in note
    assert "1.79 m (two.bag /top)" in note
