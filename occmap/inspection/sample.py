"""Whether beams without return lead through walls, as a sample of posed scans shows it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from occmap.arrays import Bool, Float64
from occmap.sampling import encode_cells
from occmap.sensor.returns import NoReturn, ReturnOptions, interpret
from occmap.types import Kind, PosedScans
from occmap.values import as_float32

HIT_CELL_M = 0.1
ASIDE_M = 0.15
"""How far to the left and right of a beam hits are looked for (m): a surface that it leads through
has hits on both sides, a corner or a wall that it grazes on one side only."""
STEPS_AROUND = 2
"""Steps before and behind that are looked at, too: a surface may be crossed at an angle"""
SHORT_OF_END_M = 0.2
MAX_REACH_M = 30.0
MAX_CROSSING_BEAMS = 250
MIN_CROSSING_BEAMS = 50
SIDES = np.arange(8) * math.pi / 4
"""Directions in which the sides of the octagon around all hits face (rad)"""


def measure_crossing(parts: Sequence[PosedScans], options: ReturnOptions) -> float | None:
    """Measure how many beams without return would clear space that they should not.

    Such a beam leads through a surface that other beams hit, or out of everything that was hit: a
    front of glass gives no hits, but what stands around it does.

    Returns
    -------
    float or None
        Their share; None where there are too few such beams, or no distance up to which they would
        call space free.
    """
    options = replace(options, no_return=NoReturn.CLEAR)
    hits, origins, directions, reaches = [], [], [], []
    for part in parts:
        rays, _ = interpret(part, options)
        limit = part.batch.range_max if options.range_max is None else options.range_max
        lost = (rays.kind == Kind.FREE) & (part.batch.ranges >= as_float32(limit))
        hits.append(rays.end[rays.kind == Kind.HIT])
        origins.append(np.broadcast_to(rays.origin, rays.direction.shape)[lost])
        directions.append(rays.direction[lost])
        reaches.append(rays.distance[lost])
    reach = np.concatenate(reaches or [np.zeros(0)])
    if len(reach) < MIN_CROSSING_BEAMS:
        return None
    some = np.linspace(0, len(reach) - 1, min(len(reach), MAX_CROSSING_BEAMS)).astype(np.int64)
    origin, direction = np.concatenate(origins)[some], np.concatenate(directions)[some]
    reach, hit = np.minimum(reach[some], MAX_REACH_M), np.concatenate(hits)
    leaves = find_outside(origin + reach[:, None] * direction, hit)
    return float((leaves | find_crossing(origin, direction, reach, hit)).mean())


def find_outside(points: Float64, hit: Float64) -> Bool:
    """(N,) whether points (N, 2) lie outside the octagon around all hits (H, 2)."""
    sides = np.stack([np.cos(SIDES), np.sin(SIDES)])
    far = (hit @ sides).max(axis=0) if len(hit) else np.inf  # no hit, no building
    outside: Bool = (points @ sides > far).any(axis=1)
    return outside


def find_crossing(origin: Float64, direction: Float64, reach: Float64, hit: Float64) -> Bool:
    """(N,) whether beams (N,) lead through a surface of which there are hits (H, 2)."""
    walls = np.unique(encode_cells(hit, HIT_CELL_M))
    far = reach[:, None] - SHORT_OF_END_M
    steps = np.minimum(np.arange(HIT_CELL_M, MAX_REACH_M, HIT_CELL_M), far)
    ways = origin[:, None] + steps[..., None] * direction[:, None]
    aside = ASIDE_M * np.stack([-direction[:, 1], direction[:, 0]], axis=1)[:, None]
    there, left, right = (
        np.isin(encode_cells(each, HIT_CELL_M), walls)
        for each in (ways, ways + aside, ways - aside)
    )
    crossing: Bool = (there & look_around(left) & look_around(right)).max(axis=1)
    return crossing


def look_around(steps: Bool) -> Bool:
    """(N, K) whether any of the steps (N, K) of a beam around each is true."""
    ends = np.pad(steps, ((0, 0), (STEPS_AROUND, STEPS_AROUND)))
    around: Bool = sliding_window_view(ends, 2 * STEPS_AROUND + 1, axis=1).max(axis=2)
    return around
