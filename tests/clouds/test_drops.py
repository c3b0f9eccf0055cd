"""Where the floor ends before a point that lies below it: single rays, worked out by hand.

The sensor stands at x = 1 m, and is seen from four sides. P is where its ray meets the floor's
height; from 0.9 m beyond, or less where the point is near, the ray is followed back in steps of
75 mm. The rim is 0.1 m before the first place on measured floor.
"""

import numpy as np
import pytest

from occmap.cells import CellBox, Ground
from occmap.types import Cloud
from tests.clouds.simulation import observe, place, turn

Stretch = tuple[float, float, int | None]
"""Floor from one x to another (m), and its height (mm) where it was measured"""
BOX = CellBox(-200, -200, 200, 200)
NARROW: list[Stretch] = [(0, 3, 0), (3, 3.45, None), (3.45, 6, 0)]
NO_GROUND = -(1 << 30)


def lay_floor(stretches: list[Stretch], quarters: int) -> Ground:
    """Lay stretches of floor along x, and turn them by quarters around the world's zero."""
    height, measured = np.full((128, 128), NO_GROUND), np.zeros((128, 128), bool)
    for start, end, level in stretches:
        columns = slice(round(start / 0.15) + 64, round(end / 0.15) + 64)
        height[:, columns], measured[:, columns] = level or 0, level is not None
    blocks = np.array([(row, col) for row in (-1, 0) for col in (-1, 0)])
    height_mm, was_measured = (
        np.array([turned[r : r + 64, c : c + 64].ravel() for r in (0, 64) for c in (0, 64)])
        for turned in (np.rot90(each, -quarters) for each in (height, measured))
    )
    return Ground(blocks, height_mm.astype(np.int32), was_measured)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(
    ("floor", "p", "point", "rim"),
    [
        # From 4.1 on back; 2.975 is the first place before the edge at 3 m.
        pytest.param([(0, 3, 0), (3, 4.5, None)], 3.2, 7.6, 2.875, id="the edge of a dock"),
        pytest.param([(0, 3, 0), (3, 4.5, None)], 3.01, 7.6, 2.835, id="a ray that skims it"),
        pytest.param([(0, 3, 0), (3, 4.5, None)], 2.9, 7.6, None, id="a ray through the floor"),
        pytest.param([(0, 3, 0), (3, 4.5, None)], 2.9, 3.1, None, id="the same up to its point"),
        pytest.param([(0, 3, 0), (3, 3.9, None)], 3.2, 7.6, 2.875, id="no ground beyond P"),
        pytest.param([(0, 6, 0)], 3.2, 7.6, None, id="floor that mirrors"),
        pytest.param([(0, 3, 0), (3, 3.6, None), (3.6, 6, 0)], 3.2, 7.6, None, id="a wet spot"),
        pytest.param([(0, 2.4, 0), (2.4, 3, 80), (3, 4.5, None)], 3.2, 7.6, 2.875, id="8 cm up"),
        pytest.param([(0, 2.4, 0), (2.4, 3, -81), (3, 4.5, None)], 3.2, 7.6, None, id="8.1 down"),
        # The wall on the other side is met 0.32 or 0.62 m behind P: from 1 or 5 steps beyond P on.
        pytest.param(NARROW, 3.2, 3.52, 2.875, id="a narrow pit"),
        pytest.param(NARROW, 3.2, 3.82, None, id="floor behind a pit"),
        # 20 steps before P lies 1.7: 1.775 counts, and 1.625 is too far back.
        pytest.param([(0, 1.8, 0), (1.8, 4.5, None)], 3.2, 7.6, 1.675, id="an edge far before P"),
        pytest.param([(0, 1.65, 0), (1.65, 4.5, None)], 3.2, 7.6, None, id="an edge too far"),
        # Of the steps 1.175 and 1.1 one is 0.15 m from the sensor.
        pytest.param([(0, 1.2, 0), (1.2, 4.5, None)], 1.4, 2.6, 1.075, id="an edge near by"),
        pytest.param([(0, 1.05, 0), (1.05, 4.5, None)], 1.4, 2.6, None, id="an edge too near"),
    ],
)
def test_the_rim_before_a_point_below_the_floor(
    floor: list[Stretch], p: float, point: float, rim: float | None, quarters: int
) -> None:
    turned = turn(0, 0, 90 * quarters)
    height = 0.6 if point > 4 else 3.0
    sensor = np.array([1.0, 1.03, height])
    away = np.array([point - 1.0, 0.0, -height * (point - 1) / (p - 1)])
    cloud = Cloud(0, "lidar", away[None].astype(np.float32))
    engine = observe([place(cloud, turned @ sensor, turned[None])], lay_floor(floor, quarters))
    hits = engine.finish().gather(BOX)[0]
    found = [(row - 200, col - 200) for row, col in np.argwhere(hits).tolist()]
    expected = [] if rim is None else [tuple(np.floor((turned @ [rim, 1.03, 0])[1::-1] / 0.05))]
    assert found == expected


@pytest.mark.parametrize(
    ("end", "height", "is_hit"),
    # The clearance is 0.1 m, and from 2.7 m it is three columns to the face.
    [(3, 0.3, True), (3, 0.11, True), (3, 0.09, False), (2.7, 0.3, True), (2.55, 0.3, False)],
)
def test_the_face_of_a_step_is_seen_from_below(end: float, height: float, is_hit: bool) -> None:
    ground = lay_floor([(0, end, 0), (end, 3, None), (3, 6, 500)], 0)
    seen = Cloud(0, "lidar", np.array([[2.07, 0.0, height - 1.0]], np.float32))
    engine = observe([place(seen, np.array([1.0, 1.03, 1.0]), np.eye(3)[None])], ground)
    hits = engine.finish().gather(BOX)[0]
    assert [tuple(each) for each in np.argwhere(hits)] == [(220, 261)] * is_hit
