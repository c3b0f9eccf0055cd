"""What a map says of cells beside what held-out beams find in them, counted by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from occmap.cells import OccupancyMap
from occmap.scoring import ReliabilityBin, score_map
from occmap.types import Kind
from tests.grid.scans import make_scan
from tests.writers.maps import map_of


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
