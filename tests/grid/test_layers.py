"""Layers of times: which cells they know, found, forgotten and summed."""

import numpy as np

from occmap.grid.lattice import Lattice
from occmap.grid.layers import find_cell, restrict, sum_visits, unpack_cells
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid
from occmap.types import Times

CELLS = [(-64, 0), (-64, 63), (-1, 5), (128, 130), (191, 191)]
"""Rows and columns, tile by tile: of the tiles (-1, 0) and (2, 2)."""


def make_layer() -> Times:
    """Cell n was first seen at 10 n and last at 10 n + 1, hit on n visits and seen on n + 1."""
    seen = np.zeros((2, TILE, TILE), np.bool_)
    for row, col in CELLS:
        seen[int(row > 0), row % TILE, col % TILE] = True
    n = np.arange(5)
    bits = np.packbits(seen.reshape(2, -1), axis=1)
    tiles = np.array([[-1, 0], [2, 2]])
    return Times(tiles, bits, 10 * n, 10 * n + 1, n.astype(np.int32), n.astype(np.int32) + 1)


def observe(cells: list[tuple[int, int]]) -> TileGrid:
    grid = TileGrid(Lattice(1.0), EvidenceKind.COUNTS)
    for row, col in cells:
        tile = grid.tiles.setdefault((row // TILE, col // TILE), np.zeros((2, TILE, TILE), int))
        tile[1, row % TILE, col % TILE] = 1
    return grid


def test_cells_are_found_where_their_numbers_are() -> None:
    layer = make_layer()
    assert [find_cell(layer, row, col) for row, col in CELLS] == [0, 1, 2, 3, 4]
    for row, col in ((-64, 1), (-65, 0), (0, 0), (128, 129), (191, 192)):
        assert find_cell(layer, row, col) is None
    assert np.argwhere(unpack_cells(layer)).tolist() == [
        [0, 0, 0], [0, 0, 63], [0, 63, 5], [1, 0, 2], [1, 63, 63],
    ]  # fmt: skip


def test_what_is_not_observed_any_more_is_forgotten() -> None:
    rest = restrict(make_layer(), observe([CELLS[1], CELLS[2], (-60, 3), (0, 0)]))
    assert rest.tiles.tolist() == [[-1, 0]]
    assert [find_cell(rest, row, col) for row, col in CELLS] == [None, 0, 1, None, None]
    numbers = (rest.first_ns, rest.last_ns, rest.hit_visits, rest.seen_visits)
    assert [column.tolist() for column in numbers] == [[10, 20], [11, 21], [1, 2], [2, 3]]


def test_a_layer_of_a_whole_grid_stays_as_it_is() -> None:
    layer, same = make_layer(), restrict(make_layer(), observe(CELLS))
    for name in Times.__dataclass_fields__:
        assert np.array_equal(getattr(layer, name), getattr(same, name)), name


def test_nothing_left_is_an_empty_layer() -> None:
    rest = restrict(make_layer(), observe([]))
    assert (rest.tiles.shape, rest.observed.shape, rest.first_ns.shape) == ((0, 2), (0, 512), (0,))


def test_visits_add_up_over_layers() -> None:
    other = restrict(make_layer(), observe(CELLS[3:]))
    visits = sum_visits([make_layer(), other])
    assert visits.keys() == {(-1, 0), (2, 2)}
    assert visits[-1, 0][:, 63, 5].tolist() == [2, 3]
    assert visits[2, 2][:, 63, 63].tolist() == [8, 10]
    assert visits[2, 2].sum() == 2 * (3 + 4 + 4 + 5)
