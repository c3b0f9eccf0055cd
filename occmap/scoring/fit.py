"""The small transform by which walls lie on the walls of a map best."""

import math
from typing import NamedTuple

import numpy as np

from occmap.choices import to_rpy
from occmap.types import Bool, Float32, Float64, Pose

REACH_M, REACH_RAD = 2.0, math.radians(20)
"""No larger transform is looked for"""
STEP_M, STEP_RAD = 0.2, math.radians(2)
"""Of the first look; then both are halved again and again"""
HALVINGS = 6
MOST_POINTS = 4000
MOST_STEPS = 200
"""Of distances (cells): in a map of millimetres they end nearer by than elsewhere"""


class Transform(NamedTuple):
    """What moves points: a turn about the origin, and then a shift."""

    x: float
    """Shift along x (m)"""
    y: float
    """Shift along y (m)"""
    yaw: float
    """Turn, counter-clockwise (rad)"""

    def move(self, points: Float64) -> Float64:
        """Move points (N, 2)."""
        moved: Float64 = points @ self.matrix.T + np.array([self.x, self.y])
        return moved

    def move_back(self, points: Float64) -> Float64:
        """Find which points (N, 2) are moved to given ones."""
        back: Float64 = (points - np.array([self.x, self.y])) @ self.matrix
        return back

    def after(self, first: Pose) -> "Transform":
        """Make one of a planar move and, after it, this one."""
        x, y = self.move(np.array([first.x, first.y])).tolist()
        yaw = math.remainder(to_rpy(first)[2] + self.yaw, math.tau)
        return Transform(round(x, 5), round(y, 5), round(yaw, 6))

    def is_far(self, points: Float64) -> bool:
        """Whether it moves points (N, 2) as far as `fit` looks, so that the best may be beyond."""
        middle = points.mean(axis=0)
        shift = float(np.abs(self.move(middle) - middle).max())
        return shift > REACH_M - STEP_M / 2 or abs(self.yaw) > REACH_RAD - STEP_RAD / 2

    @property
    def matrix(self) -> Float64:
        """The turn (2, 2)."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[cos, -sin], [sin, cos]])


STAY = Transform(0.0, 0.0, 0.0)


class Walls(NamedTuple):
    """How far it is from each cell to the nearest wall."""

    away: Float32
    """(H, W) m, up to a limit"""
    corner: Float64
    """(2,) x and y of the lower-left corner (m)"""
    resolution: float
    """Side of a cell (m)"""
    limit: float
    """What is farther away counts as this far (m)"""

    @classmethod
    def of(cls, occupied: Bool, corner: Float64, resolution: float, limit: float) -> "Walls":
        """Measure it between the middles of cells, in a map (H, W) and within `limit` around it.

        Squares of distances are smallest over columns first and over rows then, which is exact
        (Felzenszwalb and Huttenlocher 2012), here for whole rows of cells at once.
        """
        side = min(math.ceil(limit / resolution), MOST_STEPS)
        limit = min(limit, side * resolution)
        mask = np.pad(occupied, side)
        squares = np.where(mask, 0, np.float32((side + 1) ** 2)).astype(np.float32)
        for _ in range(2):
            lowest = squares.copy()
            for step in range(1, side + 1):
                farther = squares + np.float32(step * step)
                np.minimum(lowest[step:], farther[:-step], out=lowest[step:])
                np.minimum(lowest[:-step], farther[step:], out=lowest[:-step])
            squares = np.ascontiguousarray(lowest.T)
        away = np.minimum(np.sqrt(squares) * np.float32(resolution), np.float32(limit))
        return cls(away, corner - side * resolution, resolution, limit)

    def measure(self, points: Float64) -> Float32:
        """How far it is from the cells of points (N, 2) to the nearest wall (m)."""
        cols, rows = np.floor((points - self.corner) / self.resolution).astype(np.int64).T
        height, width = self.away.shape
        inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        found = np.full(len(points), self.limit, np.float32)
        found[inside] = self.away[rows[inside], cols[inside]]
        return found


def fit(points: Float64, walls: Walls) -> Transform:
    """Find by which transform points (N, 2) lie nearest to walls.

    All transforms on a coarse grid are tried, and then those beside the best of it, in steps half
    as long again and again. A point tells less and less the farther it is from a wall, so that what
    has no wall in the other map, as people have none, does not pull.
    """
    points = points[:: max(len(points) // MOST_POINTS, 1)]
    middle = points.mean(axis=0)
    centred = points - middle

    def judge(place: tuple[float, float, float], width: float) -> float:
        x, y, yaw = place
        there = Transform(x, y, yaw).move(centred) + middle
        return float(np.exp(-0.5 * (walls.measure(there) / width) ** 2).sum())

    shifts = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M).tolist()
    turns = np.arange(-REACH_RAD, REACH_RAD + STEP_RAD / 2, STEP_RAD).tolist()
    sparse, dense = centred[:: max(len(centred) // 500, 1)], centred
    centred = sparse
    tried = [(x, y, yaw) for yaw in turns for x in shifts for y in shifts]
    best = max(tried, key=lambda place: judge(place, STEP_M))
    centred = dense
    step_m, step_rad = STEP_M, STEP_RAD
    for _ in range(HALVINGS):
        step_m, step_rad = step_m / 2, step_rad / 2
        width = max(step_m, walls.resolution)
        around = [
            (best[0] + x * step_m, best[1] + y * step_m, best[2] + yaw * step_rad)
            for yaw in (-2, -1, 0, 1, 2)
            for x in (-2, -1, 0, 1, 2)
            for y in (-2, -1, 0, 1, 2)
        ]
        best = max(around, key=lambda place: judge(place, width))
    x, y, yaw = best
    shift = middle - Transform(0.0, 0.0, yaw).move(middle[None])[0]
    return Transform(round(x + float(shift[0]), 5), round(y + float(shift[1]), 5), round(yaw, 6))
