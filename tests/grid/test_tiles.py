"""The sparse tiles: what fits where, the map that they make, and which slices of time saw them."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from occmap.cells import Slices
from occmap.errors import MapError
from occmap.evidence import render
from occmap.grid import Lattice, tiles
from occmap.grid.rendering import Reach, find_bounds
from occmap.grid.tiles import TILE, EvidenceKind
from occmap.sensor.models import QuadraticModel
from tests.grid import scans


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_a_tile_widens_before_a_sum_can_overflow(bits: int) -> None:
    most = 2 ** (bits - 1) - 1
    grid, tile = scans.make_grid(), np.zeros((2, TILE, TILE), f"i{bits // 8}")
    tile[0, 0, 0] = most - 1
    grid.add({(0, 0): tile}, most - 1)
    scans.add_cell(grid, 0, 0, 1, 1)
    assert grid.tiles[0, 0].itemsize == bits // 8
    scans.add_cell(grid, 0, 0, 1, 5)
    assert grid.tiles[0, 0].itemsize == bits // 4
    scans.add_cell(grid, 0, 1, 0, 7)
    assert scans.read_cells(grid) == ({(0, 0): most + 1}, {(0, 0): 6, (0, 1): 7})


def test_a_sum_that_was_widened_is_never_narrowed() -> None:
    """What was saved has no bound that the grid knows of: adding one must not make it 32 bits."""
    tile = np.zeros((2, TILE, TILE), np.int64)
    tile[:, 0, 0] = 3_000_000_000, 4
    grid = scans.make_grid().like({(0, 0): tile})
    scans.add_cell(grid, 0, 0, 1, 0)
    assert scans.read_cells(grid) == ({(0, 0): 3_000_000_001}, {(0, 0): 4})


def test_a_tile_does_not_keep_the_window_that_it_is_a_part_of() -> None:
    """Of three tiles of a window only two are new: the third need not stay in memory with them."""
    grid, window = scans.make_grid({(0, 0): (1, 0)}), np.ones((3, 2, TILE, TILE), np.int32)
    grid.add(dict(zip([(0, 0), (0, 1), (0, 2)], window, strict=True)), 1)
    assert grid.tiles[0, 0][:, 0, 0].tolist() == [2, 1]
    assert not any(np.shares_memory(tile, window) for tile in grid.tiles.values())


def test_a_grid_takes_over_what_was_saved_of_another() -> None:
    tile = np.zeros((2, TILE, TILE), np.int64)
    tile[0, 0, 0] = 3_000_000_000
    mine = scans.make_grid({(0, 0): (5, 0)})
    mine.merge(mine.like({(0, 0): tile}))
    assert scans.read_cells(mine).first == {(0, 0): 3_000_000_005}


def test_a_robot_that_stands_still_for_ten_hours() -> None:
    """40 scans a second of 1081 beams, all through one cell at p = 0.1: exact, not overflowed."""
    times, log_odds = 10 * 3600 * 40, round(-2.1972245773362196 / tiles.LOG_ODDS_UNIT)
    grid = scans.make_grid(kind=EvidenceKind.LOG_ODDS)
    per_minute = 60 * 40 * 1081
    for _ in range(times // 2400):
        scans.add_cell(grid, 4, 4, log_odds * per_minute, per_minute)
    tile = grid.tiles[0, 0]
    assert tile[:, 4, 4].tolist() == [log_odds * times * 1081, times * 1081]
    made = render(grid, QuadraticModel(clamp_min=0.0, clamp_max=1.0), 10)
    assert made.log_odds[0, 0] == pytest.approx(-2.1972245773 * times * 1081, rel=1e-5)


def test_log_odds_of_zero_are_observed_where_there_were_observations() -> None:
    grid = scans.make_grid({(0, 0): (0, 2), (0, 2): (9, 1)}, kind=EvidenceKind.LOG_ODDS)
    assert render(grid, QuadraticModel(), 10).observed.tolist() == [[True, False, True]]


def test_a_map_as_large_as_allowed_is_made_and_a_larger_one_refused() -> None:
    grid = scans.make_grid({(-3, -5): (1, 0), (6, 14): (1, 0)}, 0.25)
    box = find_bounds(grid)
    assert (box.rows, box.cols) == (10, 20)
    tiles.refuse_large(box, grid.lattice, 200)
    found = re.escape("from (-1.25, -0.75) to (3.75, 1.75) m: 20 x 10 cells")
    with pytest.raises(MapError, match=f"{found}.*max_cells=199.*start_s.*resolution.*max_range"):
        tiles.refuse_large(box, grid.lattice, 199)


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
    grid = scans.make_grid(dict.fromkeys(cells, (1, 0)))
    grid.refuse_outgrown(most)
    with pytest.raises(MapError, match="more than `max_cells="):
        grid.refuse_outgrown(most - 1)


def test_the_ends_of_hits_say_how_large_a_map_is_at_least() -> None:
    """Hits in cells (0, 2) and (300, 302): 301 x 301 cells, or some fewer, as hits are rounded."""
    rays = scans.make_rays([[scans.MIDDLE], [(300.5, 300.5)]], (1, 0), 2.0)
    Reach(Lattice(1.0), max_cells=301 * 301 - 1).stretch(rays)
    reach = Reach(Lattice(1.0), max_cells=160 * 160)
    reach.stretch(scans.take(rays, [0]))
    with pytest.raises(MapError, match=r"from \(2, 0\) to \(303, 301\) m: 301 x 301 cells"):
        reach.stretch(scans.take(rays, [1]))


CELLS = st.lists(st.tuples(st.integers(0, 1), st.integers(0, 63), st.integers(0, 63)), max_size=9)
KEYS = st.tuples(st.integers(-1, 1), st.integers(-1, 1), st.integers(-2, 2))
"""Row and column of a tile, and a slice"""
Tables = dict[tuple[int, int, int], NDArray[np.bool_]]
"""By row and column of a tile and slice: (2, 64, 64) hit and seen cells"""


def draw(cells: list[tuple[int, int, int]], full: bool) -> NDArray[np.bool_]:
    """All cells or none of them, but for these."""
    table = np.full((2, TILE, TILE), full)
    for cell in cells:
        table[cell] = not full
    return table


TABLES = st.dictionaries(KEYS, st.builds(draw, CELLS, st.booleans()), max_size=5)


def pack_tables(tables: Tables) -> Slices:
    keys = np.array(list(tables), np.int64).reshape(-1, 3)
    bits = np.packbits(np.array([*tables.values()], np.bool_).reshape(-1, 2, TILE, TILE), axis=-1)
    return tiles.pack_bits(keys[:, :2], keys[:, 2], bits)


def read_tables(slices: Slices) -> Tables:
    bits = np.unpackbits(tiles.unpack_bits(slices), axis=-1).view(np.bool_)
    keys = np.column_stack([slices.tiles, slices.numbers]).tolist()
    return {(row, col, number): bits[k] for k, (row, col, number) in enumerate(keys)}


def assert_equal(found: Tables, expected: Tables) -> None:
    assert found.keys() == expected.keys()
    for key, table in expected.items():
        assert np.array_equal(found[key], table), key


@scans.FEW
@given(tables=TABLES)
def test_what_is_packed_comes_out_again(tables: Tables) -> None:
    slices = pack_tables(tables)
    assert_equal(read_tables(slices), tables)
    every_other = np.arange(len(tables))[::-2]
    some = dict(list(tables.items())[::-2])
    assert_equal(read_tables(tiles.take_tiles(slices, every_other)), some)
    assert list(read_tables(tiles.take_tiles(slices, every_other))) == list(some)


def test_rows_like_the_one_before_cost_nothing() -> None:
    """One byte of the first row differs from nothing, and one of row 9 from those before it."""
    table = np.zeros((2, TILE, TILE), np.bool_)
    table[1, :9, 8:16] = True
    slices = pack_tables({(0, 0, 7): table})
    assert slices.parts.tolist() == [0b0100_0000] * 2
    assert slices.changes.tolist() == [0xFF] * 2
    assert np.flatnonzero(np.unpackbits(slices.rows)).tolist() == [TILE, TILE + 9]


@pytest.mark.parametrize("block", [1, 2, 4096])
@scans.FEW
@given(one=TABLES, other=TABLES, third=TABLES)
def test_a_union_has_what_any_part_has_in_order(
    block: int, one: Tables, other: Tables, third: Tables
) -> None:
    expected: Tables = {}
    for tables in (one, other, third):
        for key, table in tables.items():
            expected[key] = expected.get(key, np.zeros_like(table)) | table
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "BLOCK", block)
        united = tiles.unite(map(pack_tables, (one, other, third)))
        again = tiles.unite([pack_tables(third), tiles.unite(map(pack_tables, (other, one)))])
    assert_equal(read_tables(united), expected)
    assert list(read_tables(united)) == sorted(expected)
    scans.assert_same_slices(united, again)


@scans.FEW
@given(tables=TABLES)
def test_tiles_are_split(tables: Tables) -> None:
    found: Tables = {}
    for tile, slices in tiles.split_tiles(tiles.unite([pack_tables(tables)])):
        assert set(map(tuple, slices.tiles.tolist())) == {tile}
        found |= read_tables(slices)
    assert_equal(found, tables)


def test_what_is_not_observed_any_more_is_forgotten() -> None:
    cells = [(-64, 0), (-1, 5), (128, 130)]
    tables: Tables = {}
    for number, (row, col) in enumerate(cells):
        table = tables.setdefault((row // TILE, col // TILE, number), draw([], full=False))
        table[:, row % TILE, col % TILE] = True
    grid = scans.make_grid({(-1, 5): (0, 1)})
    rest = tiles.restrict(pack_tables(tables), grid)
    assert_equal(read_tables(rest), {(-1, 0, 1): tables[-1, 0, 1]})
    assert len(tiles.restrict(Slices.join([]), grid).tiles) == 0
