"""The largest blob of connected cells, against drawings and a flood fill."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from occmap.cells import CellClass
from occmap.difference import find_largest_blob
from occmap.grid import CellBox
from occmap.types import Bool
from tests.difference.drawings import draw_map


@pytest.mark.parametrize(
    ("art", "expected"),
    [
        ("... ...", None),
        ("..# ...", (1, CellBox(1, 2, 2, 3))),
        ("#.# .#.", (3, CellBox(0, 0, 2, 3))),  # over corners
        ("##..# ....#", (2, CellBox(0, 4, 2, 5))),  # of two alike the lower
        # The end of a row does not touch the next one's start.
        ("..# #..", (1, CellBox(0, 0, 1, 1))),
        ("####. #..#. #.##. #....", (10, CellBox(0, 0, 4, 4))),  # a spiral
    ],
)
def test_drawings(art: str, expected: tuple[int, CellBox] | None) -> None:
    assert find_largest_blob(draw_map(art).classes == CellClass.OCCUPIED) == expected


def flood(mask: Bool) -> int:
    """The size of the largest blob, cell by cell."""
    left = {(int(row), int(col)) for row, col in zip(*np.nonzero(mask), strict=True)}
    sizes = [0]
    while left:
        reached = [left.pop()]
        for row, col in reached:
            around = {(row + r, col + c) for r in (-1, 0, 1) for c in (-1, 0, 1)} & left
            left -= around
            reached.extend(around)
        sizes.append(len(reached))
    return max(sizes)


@settings(max_examples=60)
@given(arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_it_is_what_a_flood_fill_finds(mask: Bool) -> None:
    blob = find_largest_blob(mask)
    assert (blob[0] if blob else 0) == flood(mask)


def test_a_long_snake_takes_few_rounds() -> None:
    mask = np.zeros((4001, 50), np.bool_)
    mask[::2] = True
    mask[1::4, -1] = mask[3::4, 0] = True
    blob = find_largest_blob(mask)
    assert blob == (2001 * 50 + 2000, CellBox(0, 0, 4001, 50))
