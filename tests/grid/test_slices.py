"""Slices of time: packed and unpacked, laid together, and cut down to what a grid observed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from occmap.cells import Slices
from occmap.grid import tiles as module
from occmap.grid.tiles import TILE, pack, restrict, split_tiles, take, unite, unpack
from tests.grid.scans import FEW, assert_same_slices, make_grid

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
    bits = np.packbits(
        np.array(list(tables.values()), np.bool_).reshape(-1, 2, TILE, TILE), axis=-1
    )
    return pack(keys[:, :2], keys[:, 2], bits)


def read_tables(slices: Slices) -> Tables:
    bits = np.unpackbits(unpack(slices), axis=-1).view(np.bool_)
    keys = np.column_stack([slices.tiles, slices.numbers]).tolist()
    return {(row, col, number): bits[k] for k, (row, col, number) in enumerate(keys)}


def assert_equal(found: Tables, expected: Tables) -> None:
    assert found.keys() == expected.keys()
    for key, table in expected.items():
        assert np.array_equal(found[key], table), key


@FEW
@given(tables=TABLES)
def test_what_is_packed_comes_out_again(tables: Tables) -> None:
    slices = pack_tables(tables)
    assert_equal(read_tables(slices), tables)
    every_other = np.arange(len(tables))[::-2]
    some = dict(list(tables.items())[::-2])
    assert_equal(read_tables(take(slices, every_other)), some)
    assert list(read_tables(take(slices, every_other))) == list(some)


def test_rows_like_the_one_before_cost_nothing() -> None:
    """One byte of the first row differs from nothing, and one of row 9 from those before it."""
    table = np.zeros((2, TILE, TILE), np.bool_)
    table[1, :9, 8:16] = True
    slices = pack_tables({(0, 0, 7): table})
    assert slices.parts.tolist() == [0b0100_0000] * 2
    assert slices.changes.tolist() == [0xFF] * 2
    assert np.flatnonzero(np.unpackbits(slices.rows)).tolist() == [TILE, TILE + 9]


@pytest.mark.parametrize("block", [1, 2, 4096])
@FEW
@given(one=TABLES, other=TABLES, third=TABLES)
def test_a_union_has_what_any_part_has_in_order(
    block: int, one: Tables, other: Tables, third: Tables
) -> None:
    expected: Tables = {}
    for tables in (one, other, third):
        for key, table in tables.items():
            expected[key] = expected.get(key, np.zeros_like(table)) | table
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "BLOCK", block)
        united = unite(map(pack_tables, (one, other, third)))
        again = unite([pack_tables(third), unite(map(pack_tables, (other, one)))])
    assert_equal(read_tables(united), expected)
    assert list(read_tables(united)) == sorted(expected)
    assert_same_slices(united, again)


@FEW
@given(tables=TABLES)
def test_tiles_are_split(tables: Tables) -> None:
    found: Tables = {}
    for tile, slices in split_tiles(unite([pack_tables(tables)])):
        assert set(map(tuple, slices.tiles.tolist())) == {tile}
        found |= read_tables(slices)
    assert_equal(found, tables)


def test_what_is_not_observed_any_more_is_forgotten() -> None:
    cells = [(-64, 0), (-1, 5), (128, 130)]
    tables: Tables = {}
    for number, (row, col) in enumerate(cells):
        table = tables.setdefault((row // TILE, col // TILE, number), draw([], full=False))
        table[:, row % TILE, col % TILE] = True
    grid = make_grid({(-1, 5): (0, 1)})
    rest = restrict(pack_tables(tables), grid)
    assert_equal(read_tables(rest), {(-1, 0, 1): tables[-1, 0, 1]})
    assert len(restrict(Slices.join([]), grid).tiles) == 0
