"""By what heights of poses drift: where a drive comes by again, its sensor is as high as before.

SLAM of 3D lidars is off in z by 0.1 to 1 m over a drive, and would lay the floor twice.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from occmap.posing import Drift
from occmap.types import Float64, Int64

SQUARES_M = 0.25, 3.5
"""Sides of the squares in which a drive comes by again: where it was, and in a lane beside it"""
AGAIN_S = 10.0
"""It left, and came by again, if that took longer."""
STOREY_M = 1.5
"""What lies higher is another floor."""
FEWEST_PASSES, LEAST_DRIFT_M = 10, 0.03
"""Where a drive comes by less often, or heights differ by less, nothing drifts."""
MOST_PARTS, MOST_STEPS = 500, 100_000
"""Drift is linear in so many parts of a drive, which is followed in so many steps, at most."""
JUMP_M, STEEP, FREE = 0.1, 0.25, 1e-4
"""A part that is higher at its end, and as steep, is where poses jump, and may change as freely"""


def list_drifts(way: Int64) -> Iterator[Drift]:
    """List by what the heights of a sensor may drift, as it is as high where it comes by again.

    Parameters
    ----------
    way
        (N, 4) x, y and z (mm), and their stamps (ns), in any order.
    """
    way = way[np.lexsort(way.T)]
    way = way[np.unique(way[:, 3], return_index=True)[1]]
    timed = (way - way[0]) / [1e3, 1e3, 1e3, 1e9]
    knots, passes = slice(None, None, -(-len(way) // MOST_PARTS)), np.zeros((0, 3))
    for side in SQUARES_M:
        passes = np.concatenate([passes, list_passes(timed, side)])
        if len(passes) < FEWEST_PASSES:
            continue
        if np.median(np.abs(passes[:, 2])) < LEAST_DRIFT_M:
            return
        added = np.rint(1000 * fit_drift(timed[knots], passes)).astype(np.int64)
        yield tuple(way[knots, 3].tolist()), tuple(added.tolist())


def list_passes(way: Float64, side: float) -> Float64:
    """List where a way (N, 4; m and s) comes by again: both times, and how much higher it is then.

    It goes straight from place to place, and comes by in the squares of its steps and those around.
    """
    length = np.cumsum(np.hypot(*np.diff(way[:, :2], axis=0, prepend=way[:1, :2]).T))
    steps = np.linspace(0, length[-1], min(int(length[-1] / side * 2) + 2, MOST_STEPS))
    x, y, z, time = (np.interp(steps, length, each) for each in way.T)
    row, col = (np.floor(each / side).astype(np.int64) for each in (y, x))
    squares = [((row + up) << 32) + col + right for up, right in product((-1, 0, 1), repeat=2)]
    square, time, z = np.concatenate(squares), np.tile(time, 9), np.tile(z, 9)
    order = np.lexsort((time, square))
    square, time, z = square[order], time[order], z[order]
    begins = (np.diff(square, prepend=square[0] - 1) != 0) | (np.diff(time, prepend=0) > AGAIN_S)
    which = np.cumsum(begins) - 1
    time, z = (np.bincount(which, each) / np.bincount(which) for each in (time, z))
    is_again = (np.diff(square[begins]) == 0) & (np.abs(np.diff(z)) < STOREY_M)
    return np.asarray(np.stack([time[:-1], time[1:], np.diff(z)], axis=1)[is_again])


def fit_drift(way: Float64, passes: Float64) -> Float64:
    """Fit what is added to the heights of a way (N, 4; m and s), so that they are equal at passes.

    It is linear from place to place, changes as little as may be, and is 0 where the way begins.
    That is a problem of least squares, of which this makes the normal equations: each pass adds the
    products of its four weights, of the places beside its two times, and each step adds the square
    of its change.
    """
    seconds, steps, n = way[:, 3], np.abs(np.diff(way, axis=0)), len(way)
    before = np.clip(np.searchsorted(seconds, passes[:, :2], side="right") - 1, 0, n - 2)
    share = np.clip((passes[:, :2] - seconds[before]) / steps[before, 3], 0, 1)
    place = np.concatenate([before, before + 1], axis=1).T
    # Of the drift at the second time less that at the first.
    weight = np.concatenate([1 - share, share], axis=1).T * [[-1], [1], [-1], [1]]
    pairs, products = place[:, None] * n + place, weight[:, None] * weight
    of_passes = np.bincount(pairs.ravel(), products.ravel(), n * n).reshape(n, n)
    is_jump = steps[:, 2] > np.maximum(JUMP_M, STEEP * np.hypot(steps[:, 0], steps[:, 1]))
    change = np.diff(np.eye(n), axis=0)
    of_changes = change.T * (np.where(is_jump, FREE, 1) / steps[:, 3]) @ change
    wanted = np.bincount(place.ravel(), (weight * -passes[:, 2]).ravel(), n)
    return np.append(0.0, np.linalg.solve((of_passes + of_changes)[1:, 1:], wanted[1:]))
