"""What changed between two maps, on drawings small enough to count by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from occmap.cells import CellBox, CellClass
from occmap.difference import ChangedBlob, MapDifference, compare_maps, find_largest_blob, paint
from occmap.difference.maps import Place
from occmap.errors import MapError
from occmap.types import Bool
from tests.difference.drawings import draw_map


def list_changes(difference: MapDifference) -> dict[str, int]:
    return {name: count for name, count in difference.changed.items() if count}


def test_a_map_equals_itself() -> None:
    difference = compare_maps(draw_map("#.? ..."), draw_map("#.? ..."))
    assert (list_changes(difference), difference.share, difference.largest) == ({}, 0.0, None)
    assert difference.known == 5


def test_changes_are_counted_by_class() -> None:
    difference = compare_maps(draw_map("##.?? #...?"), draw_map("#.#.? ?...#"))
    assert list_changes(difference) == {
        "occupied to free": 1,
        "free to occupied": 1,
        "neither to free": 1,
        "occupied to neither": 1,
        "neither to occupied": 1,
    }
    assert difference.known == 9
    assert difference.share == pytest.approx(5 / 9)
    # The three in the upper row and the one below their end; the other touches none of them.
    assert difference.largest == ChangedBlob(5, (0.0, 0.0, 2.5, 1.0))


def test_maps_of_different_size_are_compared_where_they_lie() -> None:
    before = draw_map("#. ..", Place(0.5, 0.0, 0.0))
    after = draw_map(".. #.", Place(0.5, -0.5, 0.5))  # one column to the left, one row up
    difference = compare_maps(before, after)
    assert difference.before.shape == difference.after.shape == (3, 3)
    # Below lost: two; above and on the left new: three; the wall is free now.
    assert list_changes(difference) == {
        "free to neither": 3,
        "neither to free": 2,
        "neither to occupied": 1,
        "occupied to free": 1,
    }
    assert difference.place == Place(0.5, -0.5, 0.0)


def test_swapping_the_maps_swaps_the_changes() -> None:
    a, b = draw_map("#.?."), draw_map("..#?", Place(0.5, 1.0, 0.0))
    forth, back = compare_maps(a, b), compare_maps(b, a)
    mirrored = {" to ".join(name.split(" to ")[::-1]): n for name, n in back.changed.items()}
    assert forth.changed == mirrored
    assert (forth.share, forth.largest) == (back.share, back.largest)


def test_an_origin_rounded_to_millimetres_is_on_the_lattice() -> None:
    after = draw_map("#.", Place(0.5, 1e-3, -1e-3))
    assert list_changes(compare_maps(draw_map("#."), after)) == {}


@pytest.mark.parametrize("cells", [0.06, -0.06, 0.94, 3.44])
def test_more_than_a_twentieth_of_a_cell_off_is_no_lattice(cells: float) -> None:
    for nearby in (0.04, 0.96, -3.04):
        assert compare_maps(draw_map("#."), draw_map("#.", Place(0.5, nearby * 0.5, 0.0)))
    for place in (Place(0.5, cells * 0.5, 0.0), Place(0.5, 0.0, cells * 0.5)):
        with pytest.raises(MapError, match="not on one lattice"):
            compare_maps(draw_map("#."), draw_map("#.", place, "b.pgm"))


@pytest.mark.parametrize(
    ("place", "found"),
    [
        (Place(0.25, 0.0, 0.0), "its cells are 0.25 m, those of m.pgm 0.5 m"),
        (Place(0.5, 0.25, 0.0), "lies 0.500 columns and 0.000 rows from m.pgm: not on one lattice"),
        (Place(0.5, 1e6, 1e6), "too many to compare"),
    ],
)
def test_maps_on_other_lattices_are_refused(place: Place, found: str) -> None:
    with pytest.raises(MapError, match=rf"^b.pgm: .*{found}"):
        compare_maps(draw_map("#."), draw_map("#.", place, "b.pgm"))


def test_a_bare_image_is_compared_with_a_map_of_its_size() -> None:
    bare = draw_map("..", None, "b.png")
    assert list_changes(compare_maps(draw_map("#."), bare)) == {"occupied to free": 1}
    with pytest.raises(MapError, match=r"^b.png: a PNG does not say where it lies"):
        compare_maps(draw_map("#.."), bare)


def test_nothing_known_is_nothing_changed() -> None:
    assert compare_maps(draw_map("??"), draw_map("??")).share == 0.0


def test_the_picture_has_the_highest_row_on_top() -> None:
    picture = paint(compare_maps(draw_map("#. .."), draw_map("## ..")))
    assert picture.shape == (2, 2, 3)
    assert picture[0].tolist() == [[0, 0, 0], [213, 94, 0]]
    assert picture[1].tolist() == [[254] * 3, [254] * 3]


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
def test_a_blob_hangs_together_over_corners_too(
    art: str, expected: tuple[int, CellBox] | None
) -> None:
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
def test_the_largest_blob_is_what_a_flood_fill_finds(mask: Bool) -> None:
    blob = find_largest_blob(mask)
    assert (blob[0] if blob else 0) == flood(mask)


def test_a_blob_that_is_a_long_snake_takes_few_rounds() -> None:
    mask = np.zeros((4001, 50), np.bool_)
    mask[::2] = True
    mask[1::4, -1] = mask[3::4, 0] = True
    blob = find_largest_blob(mask)
    assert blob == (2001 * 50 + 2000, CellBox(0, 0, 4001, 50))
