"""How a cloud is laid on known ground: by the plane of its floor."""

import math
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.clouds.kernels.growth import STEP_MM, Blocks, find_near, find_under, index_blocks
from occmap.clouds.kernels.heights import Cloud, place_point
from occmap.jit import kernel, step
from occmap.types import COLUMN_MM, NO_GROUND, Bool, Int32

LAID_POINTS, LAID_M, SHORTEST_M = 10_000, 40.0, 0.05
"""About so many points of a cloud, so far from the sensor, lay it on the ground"""
GATES_MM = (150, 80, 40)
"""So far from its plane points are its floor, round by round: kerbs and feet of walls are none"""
PRIOR, PRIOR_CM = 100, 500
"""As many points lie on the ground, so far around the sensor: a cloud without floor stays"""
MOST_LIFT_MM, STEEPEST = 50, 0.175
"""A cloud is laid on the ground by so much at most (mm, and mm a cm: a degree)"""


class Columns(NamedTuple):
    """The ground that clouds are laid on, and traced over."""

    blocks: Blocks
    height: Int32
    """(C,) of each column (mm), or `NO_GROUND`"""
    measured: Bool
    """(C,) whether points showed it"""


def lay_columns(ground: Ground) -> Columns:
    """Lay out the ground as kernels take it."""
    blocks = index_blocks(ground.blocks)
    return Columns(blocks, ground.height_mm.ravel(), ground.measured.ravel())


@step
def ground_at(columns: Columns, own: int, x: float, y: float) -> int:
    """The height of the ground at a point (mm): bilinear where it is flat, else of its own column.

    Where that column lies is as of `find_under`.
    """
    blocks, height, _ = columns
    if own < 0 or height[own] == NO_GROUND:
        return NO_GROUND
    across, along = x * 1000 / COLUMN_MM, y * 1000 / COLUMN_MM
    col, row = int(np.floor(across - 0.5)), int(np.floor(along - 0.5))
    right, up = across - 0.5 - col, along - 0.5 - row
    first_col, first_row = col - int(np.floor(across)), row - int(np.floor(along))
    level: int = height[own]
    low, high, total = level, level, 0.0
    for i in range(2):
        for j in range(2):
            at = find_near(blocks, own, first_row + i, first_col + j)
            if at < 0 or height[at] == NO_GROUND:
                return level
            low, high = min(low, height[at]), max(high, height[at])
            total += height[at] * (up if i else 1 - up) * (right if j else 1 - right)
    if high - low > STEP_MM:
        return level
    return int(np.rint(total))


def lay_cloud(cloud: Cloud, floor: Columns) -> Cloud:
    """Lay a cloud on the ground: its heights lose what the plane of its floor lies above that."""
    listed = np.empty((3, len(cloud.points) // 3), np.int32)
    many = list_floor(cloud, cloud.points.view(np.int32), floor, listed)
    lift, right, up = measure_lean(listed, many)
    steep = max(math.hypot(right, up) / STEEPEST, 1.0)
    lean = np.array([right, up, 0.0]) / 10 / steep
    lift_m = float(np.clip(lift, -MOST_LIFT_MM, MOST_LIFT_MM)) / 1000
    poses = cloud.poses.copy()
    poses[:, 2] -= lean @ cloud.poses
    poses[:, 2, 3] += lean @ cloud.origin - lift_m
    return cloud._replace(poses=poses, origin=cloud.origin - [0, 0, lift_m])


@kernel
def list_floor(cloud: Cloud, bits: Int32, columns: Columns, listed: Int32) -> int:
    """List where some points near measured ground are; return how many.

    Which ones is drawn by the bits of their x and y, so that their order does not count.

    Parameters
    ----------
    listed
        (3, N) filled: how far right and up of the sensor (cm), and how far above the ground (mm).
    """
    origin, many, part = cloud.origin, 0, 0
    while bits.size // 3 >> part > LAID_POINTS:
        part += 1
    for i in range(bits.size // 3):
        mixed = (bits[3 * i] * 31 + bits[3 * i + 1]) * -7046029254386353131
        if (mixed >> 40) & ((1 << part) - 1):
            continue
        x, y, z = place_point(cloud, i)
        right, up = x - origin[0], y - origin[1]
        if not SHORTEST_M * SHORTEST_M < right * right + up * up < LAID_M * LAID_M:
            continue
        at = find_under(columns.blocks, x, y)
        if at < 0 or not columns.measured[at]:
            continue
        above = np.rint(z * 1000 - ground_at(columns, at, x, y))
        if abs(above) < 2 * GATES_MM[0]:
            listed[0, many], listed[1, many] = np.rint(right * 100), np.rint(up * 100)
            listed[2, many] = above
            many += 1
    return many


@kernel
def measure_lean(listed: Int32, many: int) -> tuple[float, float, float]:
    """Measure the plane of a cloud's floor, by least squares; `listed` is as of `list_floor`.

    Only what is near the plane of the round before counts, and some points that lie on the ground
    around the sensor.

    Returns
    -------
    How high it is above the ground at the sensor (mm), and how it rises right and up (mm a cm).
    """
    lift, right, up = 0.0, 0.0, 0.0
    for gate in GATES_MM:
        n, u, r, h, uh, rh = PRIOR, 0, 0, 0, 0, 0
        uu, ur, rr = PRIOR * PRIOR_CM * PRIOR_CM, 0, PRIOR * PRIOR_CM * PRIOR_CM
        for i in range(many):
            x, y, above = int(listed[0, i]), int(listed[1, i]), int(listed[2, i])
            if abs(above - lift - right * x - up * y) <= gate:
                n, u, r, h = n + 1, u + y, r + x, h + above
                uu, ur, rr = uu + y * y, ur + y * x, rr + x * x
                uh, rh = uh + y * above, rh + x * above
        # Seen from the middle of the points it is a problem of two unknowns.
        uu, ur, rr = n * uu - u * u, n * ur - u * r, n * rr - r * r
        uh, rh = n * uh - u * h, n * rh - r * h
        size = float(uu) * rr - float(ur) * ur
        up = (float(uh) * rr - float(rh) * ur) / size
        right = (float(rh) * uu - float(uh) * ur) / size
        lift = (h - right * r - up * u) / n
    return lift, right, up
