"""The robot itself, where it stands in its own clouds."""

from collections.abc import Sequence
from itertools import product
from typing import TypeAlias

import numpy as np

from occmap.clouds.kernels import heights
from occmap.clouds.kernels.heights import Cloud, Histogram
from occmap.sensor import AROUND_M, OUTSIDE, SIDE, Voxels, number_voxels, place_voxels
from occmap.types import COLUMN_MM, Bool, Float64, Int32, Int64

FEWEST_PLACES, BODY_PLACES, BODY_MM = 8, 32, 500
"""The robot shows in clouds of so many places of its way at least, so many are enough, and such
squares are a place"""
FILLED_SHARE = 0.6
"""It fills a voxel around its sensor in such a share of them"""
KNOWN_SHARE, MET_SHARE = 0.5, 0.1
"""In so many of them or more the column there is seen from afar, and in at most so many of these
anything stands there then"""
MET_BINS = -5, 20
"""So far below a voxel and above it (bins)"""
WAY_MM, MOST_APART = 100, 3
"""Some of it goes through squares so wide that the sensor goes through, or those beside them, where
no wall can be; other parts are so near to that, or to one another (voxels)"""
MOST_STEPS = 100_000
"""A way is followed in so many steps at most."""
PACKED = np.array([1 << 32, 1])
"""Makes one number of the two of a square"""

Place: TypeAlias = tuple[Int32, Float64]
"""(V,) the voxels around a sensor that a cloud fills, and (3, 4) its pose"""


def list_filled(cloud: Cloud) -> Int32:
    """List the voxels around its sensor that a cloud fills (V,)."""
    voxel = number_voxels(cloud.points.reshape(-1, 3))
    return np.unique(voxel[voxel != OUTSIDE])


def find_body(far: Histogram, way: Int64, places: Sequence[Place]) -> Voxels:
    """Find where the robot is around a sensor.

    It is there wherever the sensor goes, and from afar nothing is seen to stand there. What stays
    beside a straight way may be a shelf: so some of the robot goes where the sensor goes itself.

    Parameters
    ----------
    far
        What is counted of points that are not around the sensor.
    way
        (W, 4) where that was (mm), and when (ns), in any order.
    """
    if len(places) < FEWEST_PLACES or not far.used[0]:
        return ()
    every, many = np.unique(np.concatenate([filled for filled, _ in places]), return_counts=True)
    voxels, poses = every[many >= FILLED_SHARE * len(places)], np.stack([it for _, it in places])
    there = np.einsum("pij,vj->vpi", poses[:, :, :3], place_voxels(voxels)) + poses[:, :, 3]
    # Higher up no points are counted that are not far away.
    low = (there[..., 2] - poses[:, 2, 3] <= heights.RISE * AROUND_M).all(axis=1)
    voxels, there = voxels[low], there[low]
    clear = find_clear(far, there)
    return join_parts(voxels[clear], find_on_way(there[clear], way))


def find_clear(far: Histogram, there: Float64) -> Bool:
    """Find which voxels are clear from afar (V,), where they come by (V, P, 3; m)."""
    clear, most = np.ones(len(there), np.bool_), MET_SHARE * there.shape[1]
    if not len(there):  # as around most cars: a large table is not sorted for that
        return clear
    order = np.argsort(far.keys[: int(far.used[0])])
    # A few places are enough for most of the floor.
    clear[clear] = look_up(far, order, there[:, :FEWEST_PLACES])[1].sum(axis=1) <= most
    known, met = (each.sum(axis=1) for each in look_up(far, order, there[clear]))
    clear[clear] = (known >= KNOWN_SHARE * there.shape[1]) & (met <= MET_SHARE * known)
    return clear


def find_on_way(there: Float64, way: Int64) -> Bool:
    """Find which voxels (V, P, 3; m) come by where the sensor goes (W, 4; mm and ns) (V,)."""
    way = way[np.lexsort(way.T)]  # straight between clouds: a car is metres on by the next
    along = np.cumsum(np.hypot(*np.diff(way[:, :2], axis=0, prepend=way[:1, :2]).T))
    steps = np.linspace(0.0, along[-1], min(int(along[-1]) // WAY_MM, MOST_STEPS) + 2)
    places = np.stack([np.interp(steps, along, axis) for axis in way.T[:2]], axis=1)
    squares = np.floor(places / WAY_MM).astype(np.int64)
    around = squares[:, None] + np.array([*product((-1, 0, 1), repeat=2)])
    squares = np.rint(there[..., :2] * 1000).astype(np.int64) // WAY_MM
    is_there = np.isin(squares @ PACKED, around @ PACKED)
    return np.asarray(is_there.mean(axis=1) >= FILLED_SHARE)


def join_parts(voxels: Int32, is_body: Bool) -> Voxels:
    """Take those of the body, those next to them, and so on."""
    at, before = np.stack(np.unravel_index(voxels, (SIDE, SIDE, SIDE)), axis=1), 0
    while (parts := int(is_body.sum())) > before:
        before = parts
        is_body = (np.abs(at[:, None] - at[is_body]).max(axis=-1) <= MOST_APART).any(axis=1)
    return tuple(voxels[is_body].tolist())


def look_up(table: Histogram, order: Int64, places: Float64) -> tuple[Bool, Bool]:
    """Say of which places (..., 3; m) the column holds points that are no higher, or some there.

    Parameters
    ----------
    order
        Of the keys of the table (K,), by which they ascend.
    """
    keys = table.keys[: len(order)]
    x, y, z = np.moveaxis(np.rint(places * 1000).astype(np.int64), -1, 0)
    row, col = (axis // COLUMN_MM & heights.WIDE - 1 for axis in (y, x))
    column = (row << 21 | col) << heights.PIECE_BITS
    lowest, highest = (z // heights.BIN_MM + bins for bins in MET_BINS)
    top = column + highest // heights.BINS + heights.HALF
    before = np.searchsorted(keys, column, sorter=order)
    up_to = np.searchsorted(keys, top, side="right", sorter=order)
    is_met = np.zeros(column.shape, np.bool_)
    for up in range(3):  # no more hold so many bins
        piece = lowest // heights.BINS + up
        key = column + piece + heights.HALF
        at = order[np.minimum(np.searchsorted(keys, key, sorter=order), len(order) - 1)]
        bins = piece[..., None] * heights.BINS + np.arange(heights.BINS)
        is_about = (bins >= lowest[..., None]) & (bins <= highest[..., None])
        is_met |= (keys[at] == key) & (is_about & (table.counts[at] > 0)).any(axis=-1)
    return before < up_to, is_met
