"""How well a map foretells scans that it was not made from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from occmap.types import Float64, OccupancyMap, Rays
from occmap.workers import Workers


@dataclass(frozen=True)
class Score:
    """Of one map, by the beams of held-out scans. An unknown cell has probability 0.5."""

    beams: int
    """That measured a range; the first two figures are of these"""
    share: float
    """Whose first occupied cell (probability above 0.5) is within two cells of the range"""
    log_likelihood: float
    """Mean ln of the probability that the beam stops within two cells of the range, mixed with 5%
    of returns from anywhere (nat)"""
    occupied_cost: float
    """Mean cross-entropy of the cells that the beams ended in (nat)"""
    free_cost: float
    """... and of those that they crossed before (nat)"""

    @property
    def cross_entropy(self) -> float:
        """Mean of both: cells found occupied weigh as much as the many found free (nat)."""
        return (self.occupied_cost + self.free_cost) / 2


def score_map(grid: OccupancyMap, held_out: Sequence[Rays], jobs: int) -> Score:
    """Cast held-out beams, of which some must have measured a range, through a map."""
    from occmap.grid.kernels.cast import CERTAIN, cast_beams  # noqa: PLC0415  late: loads numba

    probability = np.where(grid.observed, grid.probability, np.float32(0.5))
    free_cost = -np.log(np.maximum(1 - probability, np.float32(CERTAIN)))
    totals = np.zeros((len(held_out), 6))

    def cast(index: int) -> None:
        rays = held_out[index]
        cast_beams(
            *(rays.origin, rays.turn, rays.bearing, rays.distance, rays.kind),
            *(probability, free_cost, grid.origin, grid.resolution, totals[index]),
        )

    with Workers(cast, jobs) as workers:
        for index in range(len(held_out)):
            workers.give(index)
    return sum_up(totals)


def sum_up(totals: Float64) -> Score:
    """Turn (N, 6) totals of N batches, as `cast_beams` writes them, into means."""
    beams, near, log_likelihood, occupied, cells, free = (math.fsum(each) for each in totals.T)
    return Score(
        int(beams), near / beams, log_likelihood / beams, occupied / beams, free / max(cells, 1)
    )
