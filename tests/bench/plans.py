"""Floor plans of the generated workloads, ways that clear them, and what a laser measures there."""

import numpy as np

from occmap.jit import kernel
from occmap.types import Float64

Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 (m) of something solid."""

WIDTH, HEIGHT, WALL = 44.0, 30.0, 0.1
ROOMS = (5.5, 16.5, 27.5, 38.5)
"""x of the middle of the rooms, each 11 m wide, on both sides of the corridor (m)."""
SOUTH, NORTH = 13.2, 16.8
"""y of the corridor's walls (m)."""


def office() -> list[Box]:
    """Eight rooms with a door each along a corridor, with some furniture; 44 x 30 m."""
    boxes: list[Box] = [(0, 0, WIDTH, WALL), (0, HEIGHT - WALL, WIDTH, HEIGHT)]
    boxes += [(0, 0, WALL, HEIGHT), (WIDTH - WALL, 0, WIDTH, HEIGHT)]
    for wall in (SOUTH - WALL, NORTH):
        doors = [0.0, *(x + side for x in ROOMS for side in (-0.7, 0.7)), WIDTH]
        pairs = zip(doors[::2], doors[1::2], strict=True)
        boxes += [(start, wall, end, wall + WALL) for start, end in pairs]
    for x in (11.0, 22.0, 33.0):
        boxes += [(x, 0, x + WALL, SOUTH), (x, NORTH, x + WALL, HEIGHT)]
    for x in ROOMS:
        boxes += [(x - 5, 1, x - 4.2, 4), (x + 3.2, 7, x + 4.8, 7.8)]
        boxes += [(x - 4.6, 24.5, x - 3, 25.3), (x + 4, 19, x + 4.8, 22)]
    return boxes


def office_way() -> Float64:
    """Corners (N, 2) of a drive along the corridor, into each room, round it and out again."""
    way = [(1.5, 15.0)]
    for x in ROOMS:
        way += [(x, 15), (x, 10), (x - 2.6, 6), (x - 2, 2.5), (x + 3, 2.2), (x + 2, 6), (x, 10)]
        way += [(x, 15), (x, 20), (x - 2.6, 23), (x, 27), (x + 3, 25), (x, 20), (x, 15)]
    return np.array([*way, (42.5, 15.0)])


YARD: list[Box] = [
    (0, 0, 170, 0.3),
    (0, 129.7, 170, 130),
    (0, 0, 0.3, 130),
    (169.7, 0, 170, 130),
    (40, 35, 60, 50),
    (100, 40, 125, 50),
    (60, 82, 100, 92),
    (140, 75, 150, 100),
    *((x, 20.0, x + 0.4, 20.4) for x in range(20, 160, 35)),
    *((x, 112.0, x + 2.5, 117.0) for x in range(45, 130, 20)),
]
YARD_WAY = np.array(
    [
        *[(15, 12), (155, 12), (155, 66), (80, 66), (80, 26), (15, 26)],
        *[(15, 70), (40, 70), (40, 103), (135, 103), (135, 124), (15, 122)],
    ],
    np.float64,
)


def corridor(length: float, width: float) -> list[Box]:
    """Two walls along the x axis, open at both ends."""
    inner, outer = width / 2, width / 2 + 0.1
    return [(-50, -outer, length + 50, -inner), (-50, inner, length + 50, outer)]


def cast_scans(poses: Float64, bearings: Float64, boxes: Float64) -> Float64:
    """Return the distance (S, B) to the nearest box, inf where there is none.

    It is compiled, for the workloads are large.

    Parameters
    ----------
    poses, bearings, boxes
        (S, 3) x, y, yaw; (B,) rad; (N, 4) x0, y0, x1, y1 (m). No pose lies inside a box.
    """
    ranges = np.empty((len(poses), len(bearings)))
    _cast_scans(poses, bearings, boxes, ranges)
    return ranges


@kernel
def _cast_scans(poses: Float64, bearings: Float64, boxes: Float64, ranges: Float64) -> None:
    for s in range(poses.shape[0]):
        for b in range(bearings.size):
            bearing = poses[s, 2] + bearings[b]
            # A beam along an axis would divide by zero; so little aside changes no range.
            step_x, step_y = 1 / (np.cos(bearing) + 1e-12), 1 / (np.sin(bearing) + 1e-12)
            nearest = np.inf
            for i in range(boxes.shape[0]):
                ax, bx = (boxes[i, 0] - poses[s, 0]) * step_x, (boxes[i, 2] - poses[s, 0]) * step_x
                ay, by = (boxes[i, 1] - poses[s, 1]) * step_y, (boxes[i, 3] - poses[s, 1]) * step_y
                enter = max(min(ax, bx), min(ay, by))
                if 0 < enter < nearest and enter <= min(max(ax, bx), max(ay, by)):
                    nearest = enter
            ranges[s, b] = nearest
