"""The picture of a comparison, pixel by pixel on tiny maps."""

import numpy as np

from occmap.cells import OccupancyMap
from occmap.page import BLUE, RED, paint_disagreement, paint_map

KNOWN = {"#": 3.0, ".": -3.0, "?": 0.0, " ": 0.0}


def draw(picture: str, origin: tuple[float, float] = (0.0, 0.0)) -> OccupancyMap:
    """Read a map as it is seen, the highest row first; "?" is observed and undecided."""
    cells = [list(row) for row in picture.split("/")][::-1]
    log_odds = np.array([[KNOWN[cell] for cell in row] for row in cells], np.float32)
    observed = np.array([[cell != " " for cell in row] for row in cells])
    return OccupancyMap(log_odds, observed, 0.05, origin)


def test_maps_are_aligned_by_their_lattice_and_the_highest_row_is_on_top() -> None:
    first, second = draw("#./.."), draw("#", (0.1, -0.05))
    box = first.box.join(second.box)
    assert box.shape == (3, 3)
    grey = paint_map(first, box)[60::120, 60::120, 0]
    assert grey.tolist() == [[12, 243, 205], [243, 243, 205], [205, 205, 205]]
    assert paint_map(second, box)[60::120, 60::120, 0][2].tolist() == [205, 205, 12]


def test_red_is_contradiction_and_blue_is_what_not_all_know() -> None:
    maps = [draw("#.#?# "), draw("#...  "), draw("#.#.# ")]
    legend, pixels = paint_disagreement(maps, maps[0].box)
    row = [tuple(pixel) for pixel in pixels[30, 30::60].tolist()]
    assert row == [(0, 0, 0), (255, 255, 255), RED, BLUE, BLUE, (205, 205, 205)]
    assert legend == "red: free or occupied (20.0%), blue: known or not (40.0%)"


def test_a_large_map_is_shrunk_and_loses_no_wall() -> None:
    grid = draw("/".join(["." * 1300 + "#" + "." * 1200] * 30))
    pixels = paint_map(grid, grid.box)
    assert pixels.shape == (10, 834, 3)
    assert (pixels[:, 1300 // 3, 0] == 12).all()
    assert (np.delete(pixels[..., 0], 1300 // 3, axis=1) == 243).all()
