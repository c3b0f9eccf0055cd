"""The sparse tiles: what fits where, when they widen, and the map that they make."""

import re

import numpy as np
import pytest

from occmap.errors import MapError
from occmap.evidence import render
from occmap.grid import CellBox, Lattice
from occmap.grid.rendering import Reach, find_bounds, paint
from occmap.grid.tiles import (
    INT32_LIMIT,
    LOG_ODDS_UNIT,
    TILE,
    EvidenceKind,
    add_stack,
    refuse_large,
)
from occmap.sensor.models import CountingModel
from occmap.types import Float64
from tests.grid.scans import MIDDLE, add_cell, make_grid, make_rays, read_cells, take


def difference(first: Float64, second: Float64) -> Float64:
    return first - second


def scale(log_odds: Float64, _observations: Float64) -> Float64:
    return log_odds * LOG_ODDS_UNIT


def test_a_tile_widens_before_a_sum_can_overflow() -> None:
    grid = make_grid({(0, 0): (INT32_LIMIT, 0)})
    assert grid.tiles[0, 0].dtype == np.int32
    add_cell(grid, 0, 0, 1, 5)
    assert grid.tiles[0, 0].dtype == np.int64
    add_cell(grid, 0, 1, 0, 7)
    assert read_cells(grid) == ({(0, 0): INT32_LIMIT + 1}, {(0, 0): 5, (0, 1): 7})


def test_a_sum_that_was_widened_is_never_narrowed() -> None:
    """What was stacked has no bound that the grid knows of: adding one must not make it 32 bits."""
    cells = np.zeros((1, 2, TILE, TILE), np.int64)
    cells[0, :, 0, 0] = 3_000_000_000, 4
    grid = make_grid()
    add_stack(grid, np.zeros((1, 2), np.int64), cells)
    add_cell(grid, 0, 0, 1, 0)
    assert read_cells(grid) == ({(0, 0): 3_000_000_001}, {(0, 0): 4})


def test_a_tile_does_not_keep_the_window_that_it_is_a_part_of() -> None:
    """Of three tiles of a window only two are new: the third need not stay in memory with them."""
    grid, window = make_grid({(0, 0): (1, 0)}), np.ones((3, 2, TILE, TILE), np.int32)
    grid.add(dict(zip([(0, 0), (0, 1), (0, 2)], window, strict=True)), 1)
    assert grid.tiles[0, 0][:, 0, 0].tolist() == [2, 1]
    assert not any(np.shares_memory(tile, window) for tile in grid.tiles.values())


def test_a_grid_takes_over_what_was_stacked_in_another() -> None:
    cells = np.zeros((1, 2, TILE, TILE), np.int64)
    cells[0, 0, 0, 0] = 3_000_000_000
    mine, other = make_grid({(0, 0): (5, 0)}), make_grid()
    add_stack(other, np.zeros((1, 2), np.int64), cells)
    mine.merge(other)
    assert read_cells(mine).first == {(0, 0): 3_000_000_005}


def test_a_robot_that_stands_still_for_ten_hours() -> None:
    """40 scans a second of 1081 beams, all through one cell at p = 0.1: exact, not overflowed."""
    scans, log_odds = 10 * 3600 * 40, round(-2.1972245773362196 / LOG_ODDS_UNIT)
    grid = make_grid(kind=EvidenceKind.LOG_ODDS)
    per_minute = 60 * 40 * 1081
    for _ in range(scans // 2400):
        add_cell(grid, 4, 4, log_odds * per_minute, per_minute)
    tile = grid.tiles[0, 0]
    assert tile[:, 4, 4].tolist() == [log_odds * scans * 1081, scans * 1081]
    log_odds_of_map, _ = paint(grid, scale, 0.0, find_bounds(grid))
    assert log_odds_of_map[0, 0] == pytest.approx(-2.1972245773 * scans * 1081, rel=1e-5)


def test_bounds_are_those_of_the_observed_cells() -> None:
    grid = make_grid(dict.fromkeys([(5, -200), (70, 3), (-1, 40)], (2, 1)))
    assert find_bounds(grid) == CellBox(-1, -200, 71, 41)


def test_a_map_has_every_cell_where_it_was_observed() -> None:
    grid = make_grid({(-1, 62): (5, 1), (1, 65): (0, 3)})
    box = find_bounds(grid)
    assert box == CellBox(-1, 62, 2, 66)
    log_odds, observed = paint(grid, difference, -0.7, box)
    expected = np.full((3, 4), -0.7, np.float32)
    expected[0, 0], expected[2, 3] = 4, -3
    np.testing.assert_array_equal(log_odds, expected)
    np.testing.assert_array_equal(observed, expected != np.float32(-0.7))


def test_log_odds_of_zero_are_observed_where_there_were_observations() -> None:
    grid = make_grid({(0, 0): (0, 2), (0, 2): (9, 1)}, kind=EvidenceKind.LOG_ODDS)
    _, observed = paint(grid, difference, 0.0, find_bounds(grid))
    assert observed.tolist() == [[True, False, True]]


def test_a_map_as_large_as_allowed_is_made_and_a_larger_one_refused() -> None:
    grid = make_grid({(-3, -5): (1, 0), (6, 14): (1, 0)}, 0.25)
    box = find_bounds(grid)
    assert (box.rows, box.cols) == (10, 20)
    refuse_large(box, grid.lattice, 200)
    found = re.escape("from (-1.25, -0.75) to (3.75, 1.75) m: 20 x 10 cells")
    with pytest.raises(MapError, match=f"{found}.*max_cells=199.*start_s.*resolution.*max_range"):
        refuse_large(box, grid.lattice, 199)


@pytest.mark.parametrize(
    ("cells", "most"),
    [
        ([(5, 7)], 1),
        ([(63, 63), (64, 64)], 4),  # neighbours, in tiles of a corner each
        ([(0, 0), (127, 191)], 2 * 66),  # as good as (63, 63) and (64, 128), for all tiles tell
        ([(-1, -130), (64, 300)], 66 * 386),  # from (-1, -129) to (64, 256)
    ],
)
def test_what_is_surely_too_large_is_refused_while_it_grows(
    cells: list[tuple[int, int]], most: int
) -> None:
    grid = make_grid(dict.fromkeys(cells, (1, 0)))
    grid.refuse_outgrown(most)
    with pytest.raises(MapError, match="more than `max_cells="):
        grid.refuse_outgrown(most - 1)


def test_a_map_with_a_wild_pose_is_refused_before_it_takes_memory() -> None:
    grid = make_grid(dict.fromkeys([(0, 0), (2 * 10**8, 2 * 10**8)], (1, 0)), 0.05)
    with pytest.raises(MapError, match=r"to \(10000000.1, 10000000.1\) m"):
        render(grid, CountingModel(), 10**9)


def test_the_ends_of_hits_say_how_large_a_map_is_at_least() -> None:
    """Hits in cells (0, 2) and (300, 302): 301 x 301 cells, or some fewer, as hits are rounded."""
    rays = make_rays([[MIDDLE], [(300.5, 300.5)]], (1, 0), 2.0)
    Reach(Lattice(1.0), max_cells=301 * 301 - 1).stretch(rays)
    reach = Reach(Lattice(1.0), max_cells=160 * 160)
    reach.stretch(take(rays, [0]))
    with pytest.raises(MapError, match=r"from \(2, 0\) to \(303, 301\) m: 301 x 301 cells"):
        reach.stretch(take(rays, [1]))
