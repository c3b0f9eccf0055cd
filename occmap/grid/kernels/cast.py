"""Casts measured beams through a finished map, to ask how well the map predicted them.

A beam visits exactly the cells that it crosses, from the sensor's true position (Amanatides and Woo
1987). The place of a cell on a beam is the middle of the beam's way through it.
"""

import math
from typing import NamedTuple

import numpy as np

from occmap.grid.kernels import HIT, SKIP
from occmap.jit import kernel
from occmap.types import Bool, Float32, Float64, Rays, UInt8

NEAR = 2.0
"""What lies within this many cells of the measured range is what the beam met."""
UNIFORM = 0.05
"""Share of returns from just anywhere: people, glass, wrong poses (Thrun, Burgard, Fox 2005, ch.
6). The same share of those comes from near the measured range by chance."""
UNKNOWN = 0.5
CERTAIN = 0.001
"""No cell costs more than if the map had given what was found there this probability, so that one
cell in thousands does not decide."""
BINS = 10
"""Bins of probabilities, equally wide, that compare what a map says with what beams find."""
FOLLOWED = 64
"""This many unknown cells stop a beam with certainty; there is no likelihood left after them."""


class Chart(NamedTuple):
    """A finished map, and what each of its cells costs a beam."""

    occupied: Bool
    """(H, W) what the map calls so"""
    probability: Float32
    """(H, W) of being occupied, 0.5 where unknown"""
    free_cost: Float32
    """(H, W) -ln(1 - probability), bounded by CERTAIN"""
    bins: UInt8
    """(H, W) which bin of probabilities each cell is in; BINS where unknown"""
    corner: tuple[float, float]
    """x and y of the lower-left corner (m)"""
    resolution: float
    """Side of a cell (m)"""


@kernel
def cast_beams(rays: Rays, chart: Chart, totals: Float64, tally: Float64) -> None:
    """Score a map by beams that it was not made from.

    Parameters
    ----------
    totals
        (S, 6) added to, scan by scan: HIT beams; those whose first occupied cell is near the
        measured range; the log-likelihoods of their ranges; the costs of the cells that they ended
        in; cells that any beam found free; the costs of those.
    tally
        (BINS + 1, 3) added to, bin by bin, whenever a beam looks at a cell: 1; the cell's
        probability; 1 if the beam measured a range that ends there.
    """
    origin, turn, bearing, kinds = rays.origin, rays.turn, rays.bearing, rays.kind
    (left, bottom), resolution = chart.corner, chart.resolution
    for s in range(kinds.shape[0]):
        for b in range(kinds.shape[1]):
            k, t = min(b, origin.shape[1] - 1), min(b, turn.shape[1] - 1)
            along_x = turn[s, t, 0, 0] * bearing[0, b] + turn[s, t, 0, 1] * bearing[1, b]
            along_y = turn[s, t, 1, 0] * bearing[0, b] + turn[s, t, 1, 1] * bearing[1, b]
            length = np.sqrt(along_x * along_x + along_y * along_y)
            if kinds[s, b] == SKIP or length == 0:  # nothing measured, or straight up
                continue
            x, y = (origin[s, k, 0] - left) / resolution, (origin[s, k, 1] - bottom) / resolution
            along, reach = (along_x / length, along_y / length), rays.distance[s, b] * length
            stops = kinds[s, b] == HIT
            found, stopped, free, cost, end = cast_beam(
                chart, (x, y), along, reach / resolution, stops, tally
            )
            if stops:
                totals[s, 0] += 1
                totals[s, 1] += found
                totals[s, 2] += math.log((1 - UNIFORM) * stopped + UNIFORM * UNIFORM)
                totals[s, 3] -= math.log(max(end, CERTAIN))
            else:
                free += 1
                cost -= math.log(max(1 - end, CERTAIN))
            totals[s, 4] += free
            totals[s, 5] += cost


@kernel
def cast_beam(
    chart: Chart,
    start: tuple[float, float],
    along: tuple[float, float],
    reach: float,
    stops: bool,
    tally: Float64,
) -> tuple[int, float, int, float, float]:
    """Follow one beam; lengths are in cells from the map's corner.

    It `stops` at its end, or measured no range; `tally` is as for `cast_beams`.

    Returns
    -------
    1 if the first occupied cell is near the measured range; the probability that the beam stops
    near it; the cells before its end, and their cost; the probability of its last cell.
    """
    occupied, probability, free_cost = chart.occupied, chart.probability, chart.free_cost
    bins, (x, y), (along_x, along_y) = chart.bins, start, along
    rows, cols = probability.shape
    col, row = int(np.floor(x)), int(np.floor(y))
    last_col, last_row = int(np.floor(x + reach * along_x)), int(np.floor(y + reach * along_y))
    right, up = int(along_x > 0), int(along_y > 0)
    first = -1.0
    entry = stopped = cost = 0.0
    survived, end, free = 1.0, UNKNOWN, 0
    while entry <= reach + NEAR:
        leave_x = (col + right - x) / along_x if along_x != 0 else np.inf
        leave_y = (row + up - y) / along_y if along_y != 0 else np.inf
        leave = min(leave_x, leave_y)
        if leave > entry:  # not only a corner of the cell
            p, price, is_occupied, look = UNKNOWN, math.log(2.0), False, BINS
            if 0 <= col < cols and 0 <= row < rows:
                p, price = float(probability[row, col]), float(free_cost[row, col])
                is_occupied, look = occupied[row, col], int(bins[row, col])
            middle = (entry + leave) / 2
            if is_occupied and first < 0:
                first = middle
            if abs(middle - reach) <= NEAR:
                stopped += survived * p
            survived *= 1 - p
            if entry <= reach:
                tally[look, 0] += 1
                tally[look, 1] += p
            if leave <= reach:
                free += 1
                cost += price
            elif entry <= reach:
                end = p
                tally[look, 2] += stops
            entry = leave
        if leave_x < leave_y:
            col += 2 * right - 1
        else:
            row += 2 * up - 1
        gone_x = (col >= cols and along_x >= 0) or (col < 0 and along_x <= 0)
        gone_y = (row >= rows and along_y >= 0) or (row < 0 and along_y <= 0)
        if gone_x or gone_y:
            left = abs(last_col - col) + abs(last_row - row)
            if entry < reach and left > FOLLOWED:  # nothing but unknown cells to come
                return 0, 0.0, free + left, cost + left * math.log(2.0), UNKNOWN
    return int(first >= 0 and abs(first - reach) <= NEAR), stopped, free, cost, end
