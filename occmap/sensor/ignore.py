"""The robot in its own scans: sectors that it blocks, and a box that it fills.

Both are given in the sensor's frame, where a person reads them off a plot of one scan, and where
they hold however the sensor is mounted.
"""

import math
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from occmap.arrays import Bool, Float32, Float64
from occmap.cells import Box
from occmap.errors import require
from occmap.values import as_float32

Sector: TypeAlias = tuple[float, float]
"""From one bearing counter-clockwise to another (rad)."""

FULL_TURN = 2 * math.pi
EDGE_RAD = 1e-6
"""A beam on the edge of a sector is inside, whatever its bearing was rounded to."""


def check_sector(sector: Sector) -> None:
    """Raise UsageError unless a sector has two ends that differ."""
    start, end = sector
    is_sector = math.isfinite(start) and math.isfinite(end) and start != end
    fix = "give two bearings, counter-clockwise, such as `ignore_sectors=2.5,-2.5`"
    require(is_sector, f"from {start} to {end} rad is not a sector", fix)


def check_box(box: Box) -> None:
    """Raise UsageError unless a box has an inside."""
    x_min, y_min, x_max, y_max = box
    is_box = all(map(math.isfinite, box)) and x_min < x_max and y_min < y_max
    fix = "give x_min,y_min,x_max,y_max around the sensor in metres"
    require(is_box, f"{box} is not a footprint", fix)


@lru_cache(maxsize=64)
def mask_sectors(
    angle_min: float, angle_increment: float, beams: int, sectors: tuple[Sector, ...]
) -> Bool:
    """(B,): which beams point into one of the sectors."""
    bearings = angle_min + angle_increment * np.arange(beams)
    inside = np.zeros(beams, np.bool_)
    for start, end in sectors:
        width = (end - start) % FULL_TURN or FULL_TURN
        inside |= (bearings - start + EDGE_RAD) % FULL_TURN <= width + 2 * EDGE_RAD
    return inside


def mask_box(ranges: Float32, bearing: Float64, box: Box) -> Bool:
    """(S, B): which ranges, along bearings (2, B), end in the box."""
    # Slab by slab: a ray that misses the box enters it behind where it leaves it.
    tiny = float(np.finfo(np.float32).tiny)
    along = np.where(np.abs(bearing) < tiny, tiny, bearing)
    corners = np.array(box).reshape(2, 2, 1)
    low, high = corners / along
    near = np.maximum(np.minimum(low, high).max(axis=0), 0)
    far = np.maximum(low, high).min(axis=0)
    return np.asarray((ranges >= as_float32(near)) & (ranges <= as_float32(far)))
