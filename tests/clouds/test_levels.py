"""A map whose floor leans or drifts, and its walls with it, is laid flat; a street stays."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Ground, OccupancyMap
from occmap.clouds import CloudOptions
from occmap.clouds.counting import Counted, Counter, count_clouds, join_counted, list_apart
from occmap.clouds.ground import derive_ground
from occmap.errors import MapError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.readers.ros_log import RosLog
from occmap.scans.levelling import Count, list_drifts, settle_ground
from occmap.types import Float64, Int64, Pose, PoseBatch, PosedScans, PoseSample
from occmap.writers.npz import read_evidence
from tests.cli.runner import ask, occmap
from tests.clouds.simulation import (
    HALL,
    Room,
    change_points,
    drive,
    find_ground,
    list_rays,
    read_points,
    turn,
    write_leaning,
    write_tour,
)
from tests.grid.scans import are_equal

PLACE, YAW = (300.0, -2000.0), 0.5
"""Where the logs' map is said to lie in that which is made"""
ELSEWHERE = PosingOptions(align=70.0, transform=Pose.planar(*PLACE, YAW))


def lean(clouds: Sequence[PosedScans], tilt: Float64) -> list[PosedScans]:
    """The same drive in a map that is turned as a whole."""
    return [
        replace(each, position=each.position @ tilt.T, rotation=tilt @ each.rotation)
        for each in clouds
    ]


def shift(posed: PosedScans, x: float, y: float) -> PosedScans:
    """The same clouds elsewhere in the map."""
    return replace(posed, position=posed.position + np.array([x, y, 0]))


def climb(clouds: Sequence[PosedScans], slope: float) -> list[PosedScans]:
    """The same place on a hill: what lies farther along x lies higher, and walls stay upright."""
    up = np.array([[1, 0, slope], [0, 1, 0], [0, 0, 1]])
    raised = [change_points(each, read_points(each) @ up) for each in clouds]
    return [replace(each, position=each.position @ up) for each in raised]


def count(clouds: Sequence[PosedScans]) -> Count:
    """Count clouds as a build does, in a map that is levelled as the options say."""

    def count_levelled(options: BuildOptions, ground: Ground | None) -> Counted:
        roll, pitch = options.posing.level or (0.0, 0.0)
        level = lean(clouds, turn(roll, pitch, 0))
        moved = [shift(each, *PLACE) for each in lean(level, turn(0, 0, math.degrees(YAW)))]
        placed = moved if options.posing.transform else level
        aligned = lean(placed, turn(0, 0, options.posing.align or 0.0))
        return count_clouds(aligned, ground)

    return count_levelled


@pytest.mark.parametrize(
    ("angles", "posing"),
    [
        *((angles, PosingOptions()) for angles in ((1.5, 0), (-3, 2), (0, 20), (8, -6))),
        ((-3, 2), ELSEWHERE),
    ],
)
def test_a_map_that_leans_is_laid_flat(angles: tuple[float, float], posing: PosingOptions) -> None:
    clouds, given = lean(drive(Room()), turn(*angles, 0)), BuildOptions(posing=posing)
    ground, notes, options = settle_ground(count(clouds), given, None)

    assert options.posing.level is not None
    up = turn(*options.posing.level, 0) @ turn(*angles, 0) @ [0, 0, 1]
    assert math.degrees(math.acos(up[2])) < 1  # as sharp as it needs to be
    heights = ground.height_mm[ground.measured]
    assert np.ptp(np.quantile(heights, [0.05, 0.95])) < 150  # mm, over 8 m
    assert "`level=(0,0)` leaves it as it is" in notes[-1]


def test_a_map_that_does_not_begin_at_its_zero_knows_what_is_up() -> None:
    """Such as one in UTM: to turn it about the zero would move it by far."""
    clouds = [shift(each, 5e5, 4e5) for each in lean(drive(Room()), turn(3, 0, 0))]
    assert settle_ground(count(clouds), BuildOptions(), None).options == BuildOptions()


def look_aside(degrees: float) -> list[PosedScans]:
    """A few clouds of a hill, by a lidar that leans as the road does and sees the sides of it."""
    rays, slope = list_rays(), math.tan(math.radians(degrees))
    aside = rays[np.abs(rays[:, 1]) > np.abs(rays[:, 0])] @ turn(0, -degrees, 0).T
    level = aside @ np.array([[1, 0, -slope], [0, 1, 0], [0, 0, 1]])  # as `climb` raises it
    return climb(drive(Room(), clouds=6, rays=level), slope)


def wait(clouds: list[PosedScans]) -> list[PosedScans]:
    """The same, by a robot that stood for fourteen clouds, with returns that are zero, and went."""
    seen = read_points(clouds[0])
    lost = change_points(clouds[0], np.where(np.arange(len(seen))[:, None] % 3, seen, 0))
    batches = [replace(lost.batch, stamp_ns=lost.batch.stamp_ns - n) for n in range(1, 15)]
    return [*(replace(lost, batch=batch) for batch in batches), *clouds]


@pytest.mark.parametrize(
    "make",
    [
        lambda: climb(drive(Room()), math.tan(math.radians(5))),
        lambda: look_aside(2),
        lambda: wait(look_aside(2)),
    ],
)
def test_a_street_that_climbs_stays_as_it_is(make: Callable[[], list[PosedScans]]) -> None:
    _, notes, options = settle_ground(count(make()), BuildOptions(), None)
    assert options == BuildOptions()
    assert len(notes) == 1


def test_views_and_ground_of_several_logs_do_not_depend_on_any_order() -> None:
    clouds = wait(lean(drive(Room()), turn(3, 0, 0)))
    found = []
    for order in slice(None), slice(None, None, -1):
        counters = [Counter(len(clouds), log, kept=(4, 0)) for log in "ab"]
        for each in clouds[order]:
            counters[each.batch.stamp_ns[0] % 2].add(each)
        found.append(join_counted([it.count() for it in counters][order]))
    one, other = found
    assert one.views.keys() == other.views.keys()
    for drawn, (view, points) in one.views.items():
        assert other.views[drawn][0] == view
        np.testing.assert_array_equal(other.views[drawn][1], points)
    ground, _ = derive_ground(one, CloudOptions())  # of two sensors as high as each other
    np.testing.assert_array_equal(
        derive_ground(other, CloudOptions())[0].height_mm, ground.height_mm
    )


def test_views_of_one_place_that_lies_in_two_squares_are_one() -> None:
    places = {
        (0.1, 0.2): (1500, 0),
        (0.1, 0.3): (999, 0),
        (0.1, 0.4): (1001, 0),
        (0.2, 0.1): (0, 0),
    }
    views = {
        drawn: ((0, "log", "topic", "frame", *place, 0), np.full((1, 3), float(place[0])))
        for drawn, place in places.items()
    }
    assert [points[0, 0] for points in list_apart(views)] == [1500, 999, 0]


def test_a_floor_without_walls_does_not_tell_if_it_climbs() -> None:
    clouds = lean(drive(Room()), turn(2, 1, 0))
    points = [read_points(each) for each in clouds]
    floors = [
        change_points(it, each[each[:, 2] < -0.5]) for it, each in zip(clouds, points, strict=True)
    ]
    _, notes, options = settle_ground(count(floors), BuildOptions(), None)
    assert options == BuildOptions()
    assert len(notes) == 1


@pytest.mark.parametrize("level", [(0.0, 0.0), (2.0, 0.0)])
def test_what_the_user_says_goes_before_what_clouds_show(level: tuple[float, float]) -> None:
    given = BuildOptions(posing=PosingOptions(level=level))
    clouds = lean(drive(Room()), turn(-3, 0, 0))
    _, notes, options = settle_ground(count(clouds), given, None)
    assert options is given
    assert len(notes) == 1


def test_grounds_that_hardly_overlap_are_not_compared() -> None:
    clouds = drive(Room())
    for away, is_compared in ((0.0, True), (9.0, False)):
        moved = [
            replace(each, position=each.position + np.array([away, 0, 0.4])) for each in clouds
        ]
        with pytest.raises(MapError, match=r"0\.40 m lower") if is_compared else nullcontext():
            settle_ground(count(clouds), BuildOptions(), find_ground(moved))


def test_a_build_says_how_it_was_levelled_and_a_session_takes_it_over(tmp_path: Path) -> None:
    first, both = tmp_path / "first.npz", tmp_path / "both.npz"
    line = ["build", HALL, "--poses", write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))]
    done = occmap(*line, "--end", "2", "-o", first, "--json")
    assert done.code == 0
    (note,) = (note for note in json.loads(done.out)["notes"] if "--level" in note)
    roll, pitch = map(float, note.split("--level ")[1].split()[0].split(","))
    assert (turn(roll, pitch, 0) @ turn(4, -6, 0))[2, 2] > math.cos(math.radians(0.5))

    assert occmap(*line, "--start", "2", "--resume", first, "-o", both).code == 0
    one, other = read_evidence(first), read_evidence(both)
    levels = [build["options"]["posing"]["level"] for build in other.manifest.builds]
    assert levels == [[roll, pitch]] * 2
    assert one.ground
    assert other.ground
    assert other.ground.measured.sum() > one.ground.measured.sum()


def test_a_build_reads_the_poses_of_a_log_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses, reads = RosLog.stacked_poses, []

    def count_reads(log: RosLog) -> Iterator[PoseSample | PoseBatch]:
        reads.append(log)
        return poses(log)

    monkeypatch.setattr(RosLog, "stacked_poses", count_reads)
    leaning = write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))  # so its ground is found anew
    reads.clear()
    build([HALL], BuildOptions(posing=PosingOptions(poses=str(leaning))), [tmp_path / "map.pgm"])
    assert len(reads) == 1


SECONDS = np.arange(0, 120, 0.5)
"""Three times round a square of 10 m, in 40 s each"""


SIDES = [0, 10, 20, 30, 40], [0, 10, 10, 0, 0]


def go_round(height: Callable[[Float64], Float64], slope: float = 0.02) -> Int64:
    """A way (N, 4) round a square on a hill, as high above it as a function of time says."""
    x, y = (np.interp((SECONDS + ahead) % 40, *SIDES) for ahead in (0, 30))
    way = np.stack([x, y, slope * (x + y) + height(SECONDS), SECONDS], axis=1)
    return np.asarray(np.rint(way * [1e3, 1e3, 1e3, 1e9]).astype(np.int64))


@pytest.mark.parametrize(
    ("drift", "within_mm"),
    [
        (lambda t: t * 0.005, 8),
        (lambda t: t * -0.01, 8),
        (lambda t: np.where(t < 70, t * 0.004, 0), 25),
    ],
    ids=["up", "down", "mended at once"],
)
def test_a_drift_is_found_as_it_is(drift: Callable[[Float64], Float64], within_mm: float) -> None:
    way = go_round(drift)
    (stamps, added), _ = list_drifts(np.random.default_rng(0).permutation(way))
    assert stamps == tuple(way[:, 3])
    off = np.abs(np.array(added) + 1000 * drift(SECONDS))
    assert np.quantile(off, 0.9) < within_mm  # of up to 1200


@pytest.mark.parametrize(
    "height",
    [
        lambda t: 0 * t,
        lambda t: 2.8 * t / 40,
        lambda t: np.random.default_rng(0).normal(0, 0.02, len(t)),
    ],
    ids=["as high", "a spiral", "noise"],
)
def test_what_is_no_drift_is_left(height: Callable[[Float64], Float64]) -> None:
    assert not list(list_drifts(go_round(height)))


def test_a_way_that_comes_by_nowhere_shows_none() -> None:
    straight: Int64 = np.arange(100)[:, None] * np.array([1000, 0, 10, 10**9])
    for way in (straight, straight[:1], straight * np.array([1, 1, 1, 0])):
        assert not list(list_drifts(way))


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> OccupancyMap:
    """The map of a tour whose poses are right."""
    log = tmp_path_factory.mktemp("steady") / "tour"
    return build([log], write_tour(log, drift_m=0)).map


@pytest.mark.parametrize(("drift_m", "told"), [(0.3, "0.30 m"), (-0.3, "0.30 m"), (1.0, "0.99 m")])
def test_a_tour_that_drifts_makes_the_map_of_one_that_does_not(
    tmp_path: Path, steady: OccupancyMap, drift_m: float, told: str
) -> None:
    options, made = write_tour(tmp_path / "tour", drift_m), tmp_path / "made.tum"
    built = build([tmp_path / "tour"], options, [made, tmp_path / "made.npz"])
    np.testing.assert_array_equal(built.map.occupied, steady.occupied)
    assert (built.map.free != steady.free).sum() < 10
    (note,) = (note for note in built.report.notes if "`height_drift=off`" in note)
    assert f"drift by {told}" in note
    posing = built.evidence.manifest.builds[0]["options"]["posing"]
    assert posing["height_drift"]["tour"] == pytest.approx(abs(drift_m), abs=0.02)
    heights = [np.loadtxt(path)[[0, -1], 3] for path in (made, tmp_path / "tour.tum")]
    assert heights[0] - heights[1] == pytest.approx([0, -drift_m], abs=0.02)


def test_a_sensor_that_is_lifted_and_heights_that_are_to_stay_are_left(
    tmp_path: Path, steady: OccupancyMap
) -> None:
    options = write_tour(tmp_path / "lifted", drift_m=0, lift_m=0.2)
    notes = build([tmp_path / "lifted"], options).report.notes
    options = write_tour(tmp_path / "tour", drift_m=0.3)
    stays = replace(options, posing=replace(options.posing, height_drift={}))
    built = build([tmp_path / "tour"], stays, [tmp_path / "made.npz"])
    assert not any("height_drift" in note for note in [*notes, *built.report.notes])
    assert built.map.occupied.sum() > 5 * steady.occupied.sum()
    assert built.evidence.manifest.builds[0]["options"]["posing"]["height_drift"] == {}


def test_a_later_part_goes_on_over_the_ground_of_an_earlier_one(tmp_path: Path) -> None:
    """Each part begins where it is: the second one has drifted by half of it all by then."""
    tour, made = tmp_path / "tour", [tmp_path / name for name in ("1.npz", "both.npz", "2.npz")]
    write_tour(tour, drift_m=0.3)
    line = "build", tour, "--poses", tour.with_suffix(".tum")
    second = *line, "--start", "30", "--transform", "0,0,0,-0.15"
    ask(*line, "--end", "30", "-o", made[0])
    ask(*second, "--resume", made[0], "-o", made[1])
    ask(*second, "--ground", made[0], "-o", made[2])
    ask("merge", made[0], made[2], "-o", tmp_path / "merged.npz")
    both, merged = read_evidence(made[1]), read_evidence(tmp_path / "merged.npz")
    assert are_equal(both.tiles, merged.tiles)
    drifts = [each["options"]["posing"]["height_drift"]["tour"] for each in both.manifest.builds]
    assert drifts == pytest.approx([0.15, 0.15], abs=0.01)


def test_check_tells_of_drift_and_of_no_mount(tmp_path: Path) -> None:
    tour = tmp_path / "tour"
    write_tour(tour, drift_m=1.0)
    found = ask("check", tour, "--poses", tour.with_suffix(".tum"))
    assert any("drift by 0.99 m" in note for log in found["logs"] for note in log["notes"])
    assert found["warnings"] == []
