"""Written maps are scored by beams, and by the truth: expected values by hand."""

import math
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import CellClass, OccupancyMap
from occmap.difference.maps import ClassMap, Place, load_map
from occmap.errors import LogError, MapError, UsageError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.scans.tracing import ignore_progress
from occmap.scoring import ReliabilityBin, matching, score_map
from occmap.scoring.compare import combine, compare
from occmap.scoring.maps import Against, LogScore, score_by_logs, score_by_truth
from occmap.scoring.matching import Walls, find_match
from occmap.store.merging import STAY, Transform
from occmap.types import Kind, Pose
from occmap.writers import WriteOptions
from tests.difference.drawings import draw_map
from tests.grid.scans import make_scan
from tests.samples import SAMPLE_LOGS, write_csv
from tests.writers.maps import map_of

DRIVE = SAMPLE_LOGS / "drive.mcap"
HERE = Place(0.1, 0.0, 0.0)


def draw(art: str, place: Place | None = HERE) -> ClassMap:
    return draw_map(art, place)


ROOM = draw("####### #.....# #.....# #.....# #.....# #######")
"""24 cells of walls, of which 4 are corners, around 5 x 4 free ones"""


def ask(
    asked: ClassMap, *logs: Path, fitted: bool = False, **posing: Any
) -> tuple[LogScore, list[str]]:
    """Score a map by logs, of the drive unless others are named."""
    options = BuildOptions(posing=PosingOptions(**posing))
    return score_by_logs(asked, Against(logs or (DRIVE,), fit=fitted), options, ignore_progress)


def load_built(path: Path, **posing: Any) -> ClassMap:
    """A map of the drive."""
    build([DRIVE], BuildOptions(resolution=0.1, posing=PosingOptions(**posing)), [path])
    return load_map(path, WriteOptions())


def test_the_truth_itself_is_right() -> None:
    score = score_by_truth(ROOM, ROOM, 0.0)
    assert (score.edges_found, score.edges_invented, score.free_found) == (1, 0, 1)
    assert (score.occupied_called_free, score.free_called_occupied) == (0, 0)
    assert (score.wall_distance_m, score.wall_distance_95_m, score.transform) == (0, 0, STAY)


def test_what_is_missed_and_what_is_invented_by_hand() -> None:
    said = draw("####### #.....# #..#..? #.....? #.....# ##...##")
    score = score_by_truth(said, ROOM, 0.05)
    edges = 22  # all walls, as corners touch free cells, too
    assert score.edges_found == pytest.approx(1 - 5 / edges)
    assert score.occupied_called_free == pytest.approx(3 / edges)  # the others are unknown
    assert score.edges_invented == pytest.approx(1 / 18)
    assert score.free_called_occupied == pytest.approx(1 / 20)
    assert score.free_found == pytest.approx(19 / 20)
    # The invented cell lies in the third row from above: 2 cells from the upper wall.
    assert score.wall_distance_m == pytest.approx(0.2 / 18)
    colours = {tuple(pixel) for pixel in score.picture.reshape(-1, 3).tolist()}
    assert len(colours) == 6  # free, walls, missed, called free, invented, unknown around them


def test_a_wall_that_is_off_by_a_cell_is_found_within_a_cell() -> None:
    moved = replace(ROOM, place=Place(0.1, 0.1, 0.0))
    assert score_by_truth(moved, ROOM, 0.0).edges_found < 0.7
    near = score_by_truth(moved, ROOM, 0.1)
    assert (near.edges_found, near.edges_invented, near.occupied_called_free) == (1, 0, 0)


def test_walls_where_the_truth_is_unknown_are_not_judged() -> None:
    plan = draw("#######??? #.....#??? #######???")
    said = draw("#######??# #.....#.## #######..#")
    score = score_by_truth(said, plan, 0.0)
    assert (score.edges_found, score.edges_invented, score.wall_distance_m) == (1, 0, 0)


@pytest.mark.parametrize("times", [2, 5])
def test_resolutions_may_differ(times: int) -> None:
    classes = ROOM.classes.repeat(times, 0).repeat(times, 1)
    fine = replace(ROOM, classes=classes, place=Place(0.1 / times, 0.0, 0.0))
    for one, other in ((fine, ROOM), (ROOM, fine)):
        score = score_by_truth(one, other, 0.0)
        assert (score.edges_found, score.edges_invented, score.free_found) == (1, 0, 1)


def test_only_cells_around_the_truth_are_judged() -> None:
    """A map of 300 x 300 m takes no more time and memory than the truth does."""
    large = np.full((3000, 3000), CellClass.OCCUPIED, np.uint8)
    large[: ROOM.classes.shape[0], : ROOM.classes.shape[1]] = ROOM.classes
    score = score_by_truth(replace(ROOM, classes=large), ROOM, 0.2)
    assert score.picture.shape == (6 + 4, 7 + 4, 3)
    assert (score.edges_found, score.edges_invented) == (1, 0)


def test_distances_need_memory_for_a_band_of_rows_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "BAND", 128)
    occupied = np.zeros((4000, 500), np.bool_)
    tracemalloc.start()
    Walls.of(occupied, HERE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * occupied.size


@pytest.mark.parametrize("band", [5, 1024])
def test_distances_are_those_to_the_nearest_wall(
    band: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matching, "BAND", band)
    occupied = np.random.default_rng(1).random((23, 31)) < 0.01
    walls = Walls.of(occupied, HERE)
    middles = (np.argwhere(occupied)[:, ::-1] + 0.5) * 0.1
    for point in np.random.default_rng(2).uniform(-1.9, 5.0, (500, 2)):
        middle = (np.floor(point / 0.1) + 0.5) * 0.1
        nearest = min(2.0, np.linalg.norm(middles - middle, axis=1).min())
        assert walls.measure(point[None])[0] == pytest.approx(nearest, abs=1e-5)


def test_distances_in_a_map_of_millimetres_end_nearer_by() -> None:
    walls = Walls.of(np.ones((1, 1), np.bool_), Place(0.001, 0.0, 0.0))
    assert walls.measure(np.array([[1.0, 0.0]]))[0] == pytest.approx(0.2)


@pytest.mark.parametrize("moved", [(0.4, -0.3, 0.1), (-1.7, 1.5, -0.3), (0.0, 0.0, 0.0)])
def test_a_known_transform_is_found(moved: tuple[float, float, float]) -> None:
    plan = load_map(SAMPLE_LOGS / "floor_plan.yaml", WriteOptions())
    assert plan.place is not None
    occupied = plan.classes == CellClass.OCCUPIED
    walls, points = Walls.of(occupied, plan.place), plan.place.list_middles(occupied)
    true = Transform(*moved)
    found = find_match(true.move_back(points), walls).transform
    assert found.yaw == pytest.approx(true.yaw, abs=0.004)
    apart = np.linalg.norm(found.move(true.move_back(points)) - points, axis=1)
    assert apart.max() < 0.06


def test_a_map_is_scored_by_the_log_that_it_was_made_of(tmp_path: Path) -> None:
    truth = {"transform": Pose.planar(0.35, -0.2, 0.05)}
    here, there = load_built(tmp_path / "right.pgm"), load_built(tmp_path / "moved.pgm", **truth)
    right, wrong, fitted = (score for score, _ in (ask(here), ask(there), ask(there, fitted=True)))
    assert min(right.share, right.agreement, fitted.share, fitted.agreement) > 0.95
    assert right.stops_in_occupied > 0.6
    assert right.stops_in_free < 0.01
    assert wrong.share < 0.5
    assert fitted.transform == pytest.approx((0.35, -0.2, 0.05), abs=0.02)
    assert wrong.transform == STAY
    again, _ = ask(there, fitted=True, transform=Pose.planar(0.1, 0.3, -0.05))
    assert again.transform == pytest.approx((0.35, -0.2, 0.05), abs=0.02)  # with what was given
    _, notes = ask(there, fitted=True, transform=Pose.planar(4.0, 0.0, 0.0))
    assert "a first `transform`" in notes[-1]
    assert right.log_likelihood > fitted.log_likelihood > wrong.log_likelihood


def test_of_a_long_log_a_sample_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = load_built(tmp_path / "map.pgm")
    every, notes = ask(made)
    assert not any("spread" in note for note in notes)

    monkeypatch.setattr("occmap.scoring.maps.MOST_SCANS", 300)
    some, notes = ask(made)
    assert "207 of 414 scans are asked, spread over the logs" in notes
    assert some.beams == pytest.approx(every.beams / 2, rel=0.05)
    assert abs(some.share - every.share) < 3 * some.share_error
    assert some.scans == every.scans


def test_one_beam_by_hand(tmp_path: Path) -> None:
    """From the middle of one cell of 0.1 m to a wall, 31.2 cells farther."""
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 2, [3.12])
    score, _ = ask(draw("." * 31 + "#"), log)
    assert (score.beams, score.share, score.agreement) == (2, 1, 1)
    assert (score.stops_in_occupied, score.stops_in_free) == (1, 0)
    # The wall is as good as certain to stop a beam, and each free cell to let it pass. Of 29 of
    # these, and in the first, a stop would not be near; it would be in the one before the wall, and
    # in two unknown cells behind it.
    free, wall = 0.001, 0.999
    near = free + (1 - free) * (wall + (1 - wall) * (0.5 + 0.5 * 0.5))
    stops = (1 - free) ** 30 * near
    assert score.log_likelihood == pytest.approx(math.log(0.95 * stops + 0.05 * 0.05), abs=1e-5)


def test_a_log_may_reach_as_far_as_cells_of_the_map_allow(tmp_path: Path) -> None:
    places = [(0.0, 0.0, 0.0), (6e4, 6e4, 0.0)]  # 1.4e12 cells of 0.05 m
    log = write_csv(tmp_path / "log.csv", places, [3.12])
    score, _ = ask(draw(".#", Place(25.0, -10.0, -10.0)), log, max_speed=math.inf)
    assert (score.beams, score.share) == (2, 0.5)


def test_what_cannot_be_scored_is_refused(tmp_path: Path) -> None:
    far, fine = (replace(ROOM, place=place) for place in (Place(0.1, 1e6, 1e6), Place(1e-6, 0, 0)))
    for written, truth, found in (
        (draw("#.", None), ROOM, "not say where it lies"),
        (draw("..?"), ROOM, "no occupied cell"),
        (far, ROOM, "m.pgm has no edge of a wall, or is not known where"),
        (ROOM, draw(".#", Place(0.1, 0.3, 0.2)), "no edge of a wall, or is not"),
        (ROOM, draw("###?."), "no edge of a wall"),
        (fine, ROOM, "too many to compare"),
    ):
        with pytest.raises(MapError, match=found):
            score_by_truth(written, truth, 0.1)
    blind = write_csv(tmp_path / "log.csv", [(0.0, 0.0, 0.0)] * 2, [math.nan])
    with pytest.raises(LogError, match="no beam measured a range"):
        ask(ROOM, blind)


def test_clouds_have_no_beams_to_score_by() -> None:
    clouds = SAMPLE_LOGS / "hall.mcap"
    with pytest.raises(UsageError, match="holds clouds of points"):
        ask(ROOM, clouds)
    with pytest.raises(UsageError, match="holds clouds of points"):
        compare([clouds], combine([], []), BuildOptions())


def make_map(probabilities: list[float | None]) -> OccupancyMap:
    """One row of cells of 1 m from x = 0; None is unknown."""
    return replace(map_of([[math.nan if p is None else p for p in probabilities]]), resolution=1.0)


def test_each_look_counts_in_the_bin_of_its_cell() -> None:
    """Two beams end in the third cell; one crosses it, one more without return ends in it."""
    grid = make_map([0.04, 0.06, 0.75, 0.95])
    beams = (2, Kind.HIT), (2, Kind.HIT), (3, Kind.HIT), (2, Kind.FREE), (3, Kind.SKIP)
    low, wall, behind = score_map(grid, [make_scan(*beams)], jobs=1).score.reliability
    assert (low.looks, low.observed) == (8, 0)
    assert low.predicted == pytest.approx(0.05)
    assert (wall.looks, wall.observed) == (4, 0.5)
    assert wall.predicted == pytest.approx(0.75)
    assert (behind.looks, behind.observed) == (1, 1)


def test_unknown_cells_and_what_lies_beyond_the_map_do_not_count() -> None:
    grid = make_map([0.05, None, 0.5, None])
    found = score_map(grid, [make_scan((3, Kind.HIT), (9, Kind.HIT))], jobs=1).score.reliability
    assert [(each.looks, each.observed) for each in found] == [(2, 0), (2, 0)]
    assert [each.predicted for each in found] == pytest.approx([0.05, 0.5])


def test_certainty_is_in_the_last_bin_and_a_tenth_in_the_second() -> None:
    grid = make_map([1e-9, 0.1001, 1 - 1e-12])
    found = score_map(grid, [make_scan((2, Kind.HIT))], jobs=1).score.reliability
    assert [(each.looks, each.observed) for each in found] == [(1, 0), (1, 0), (1, 1)]
    assert found[2] == ReliabilityBin(1, 1.0, 1.0)


def test_batches_and_threads_change_nothing() -> None:
    rng = np.random.default_rng(3)
    grid = make_map(rng.uniform(0.01, 0.99, 40).tolist())
    scans = [make_scan(*((reach, Kind.HIT) for reach in rng.uniform(1, 45, 9))) for _ in range(12)]
    one, other = (score_map(grid, scans, jobs).score for jobs in (1, 3))
    assert one == other
    assert len(one.reliability) == 10
