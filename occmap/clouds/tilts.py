"""Tilts: whether a sensor sits, or its poses stand, otherwise than the floor that it sees says."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.clouds.kernels.growth import BLOCK, NO_GROUND
from occmap.clouds.posed import list_clouds
from occmap.types import COLUMN_MM, Bool, Float64, PosedScans

NEAREST_M, FARTHEST_M = 1.0, 8.0
"""Floor is looked for between these distances: farther away, poses that are off move it more."""
FLOOR_M = 0.25
"""No floor lies farther from the ground that was found."""
POINTS = 2000
"""Points of a cloud that are looked at, about"""
ROUNDS = 6
APART = 8
"""Slopes of the ground are measured over so many columns."""


class Tilts(NamedTuple):
    """How points of the floor lie over the ground, by small rotations that would lay them flat."""

    sensor: Float64
    """(3,) in the frame of the points (rad): if a mount is wrong"""
    upright: Float64
    """(3,) in the map (rad): if the poses' own up is wrong"""
    is_mount: bool
    """Whether the first explains them better"""


def measure_tilts(clouds: Iterable[PosedScans], ground: Ground) -> Tilts | None:
    """Measure by which rotation the floor in clouds lies flat; None where too little is seen.

    A rotation by a small vector d lifts a point that lies at p from the sensor by d . (p x up). In
    the sensor's frame d is constant where its mount is wrong, in the map's where the poses are.
    """
    rows = [row for posed in clouds for row in list_levers(posed, ground)]
    if not rows:
        return None
    above, in_sensor, in_map = (np.concatenate(each) for each in zip(*rows, strict=True))
    if len(above) < POINTS:
        return None
    fits = [fit_robustly(levers, above) for levers in (in_sensor, in_map)]
    (sensor, left), (upright, left_by_map) = fits
    return Tilts(-sensor, -upright, left <= left_by_map)


def list_levers(posed: PosedScans, ground: Ground) -> Iterable[tuple[Float64, Float64, Float64]]:
    """List, cloud by cloud, how high points lie over the ground, and what they would be lifted."""
    for points, which, poses, origin in list_clouds(posed):
        every = max(len(points) // POINTS, 1)
        some = points[::every].astype(np.float64)
        pose = poses[which[::every] if which.size else np.zeros(len(some), np.int64)]
        turned = np.einsum("nij,nj->ni", pose[:, :, :3], some)
        place = turned + pose[:, :, 3]
        distance = np.linalg.norm((place - origin)[:, :2], axis=1)
        with np.errstate(invalid="ignore"):
            near = (distance > NEAREST_M) & (distance < FARTHEST_M)
        above = np.full(len(some), np.inf)
        above[near] = place[near, 2] - ground.find_heights(place[near])
        floor: Bool = np.abs(above) < FLOOR_M
        up = np.array([0.0, 0.0, 1.0])
        up_there = pose[floor, 2, :3]
        yield above[floor], np.cross(some[floor], up_there), np.cross(turned[floor], up)


def fit_robustly(levers: Float64, above: Float64) -> tuple[Float64, float]:
    """Fit a small rotation (3,) to heights (N,); return it, and the median of what is left."""
    used = np.ones(len(above), np.bool_)
    for _ in range(ROUNDS):
        middle, height = levers[used].mean(axis=0), float(above[used].mean())
        # A turn about the vertical lifts nothing: it has no lever to speak of.
        found = np.linalg.lstsq(levers[used] - middle, above[used] - height, rcond=0.1)[0]
        left = np.abs(above - height - (levers - middle) @ found)
        used = left < 3 * max(float(np.median(left)), 0.005)
    return found, float(np.median(left))


def measure_slope(ground: Ground) -> tuple[float, float]:
    """Measure how steep most of the ground is, along x and along y; a ramp among floors is not."""
    slopes = []
    for axis in (1, 0):
        height = ground.height_mm.reshape(-1, BLOCK, BLOCK)
        known = ground.measured.reshape(height.shape) & (height != NO_GROUND)
        height, known = (np.moveaxis(each, axis + 1, 1) for each in (height, known))
        both = known[:, APART:] & known[:, :-APART]
        rise = (height[:, APART:] - height[:, :-APART])[both]
        slopes.append(float(np.median(rise)) / (APART * COLUMN_MM) if rise.size else 0.0)
    return slopes[0], slopes[1]
