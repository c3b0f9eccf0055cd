"""How well a map predicts scans that it was not made from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from occmap.cells import OccupancyMap
from occmap.report.printed import Count, Finite, Share
from occmap.types import Float64, Rays
from occmap.workers import Workers

NOISE = 2.0
"""Standard errors: a difference that is not larger may be chance."""
SMALL = 0.005
"""A smaller difference of shares does not show in a map, however certain it is: as all maps are
asked about the same scans, a difference of a thousandth may well be certain."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Cells of nearly equal probability, each as often as a held-out beam looked at it.

    A reliability diagram (DeGroot and Fienberg 1983) shows `observed` over `predicted`: equal where
    probabilities mean what they say.
    """

    looks: int
    """How often a beam crossed or ended in such a cell"""
    predicted: float
    """Mean probability of being occupied, a share from 0 to 1"""
    observed: float
    """Share of the looks that found the cell occupied: the beam ended in it"""


@dataclass(frozen=True)
class Score:
    """How well a map predicts the beams of held-out scans. An unknown cell has probability 0.5."""

    beams: Count
    """Held-out beams that measured a range"""
    share: Share
    """Share of these whose first occupied cell is within two cells of the range"""
    share_error: Finite
    """Standard error of the share, the held-out scans taken as independent draws; null where
    one scan is all there is"""
    log_likelihood: float
    """Mean log-likelihood of the measured ranges: that the beam stops within two cells of its
    range, mixed with 5% of returns from anywhere (nat)"""
    occupied_cost: float
    """Mean cross-entropy of the cells that beams ended in (nat)"""
    free_cost: float
    """Mean cross-entropy of the cells that beams crossed before (nat)"""
    cross_entropy: float
    """Mean of both, so that the cells found occupied weigh as much as the many found free (nat)"""
    reliability: tuple[ReliabilityBin, ...] = ()
    """What the map says of cells beside what beams found in them: a bin for each tenth of
    probability, without those that nothing was in; unknown cells do not count"""


class Trial(NamedTuple):
    """How a map fared."""

    score: Score
    predicted: Float64
    """(N, 2) of each held-out scan: beams that measured a range, and those of them it predicted"""


class Gain(NamedTuple):
    """How much larger the share of one map is than that of another, by the same scans."""

    share: float = 0.0
    error: float = 0.0
    """Standard error, from the differences scan by scan; it is smaller than those of the shares,
    since both maps are asked about the same scans"""

    @property
    def certain(self) -> bool:
        """Whether it is more than noise, and so much that it shows in a map."""
        return self.share > max(NOISE * self.error, SMALL)

    def __neg__(self) -> "Gain":
        """How much smaller the share is."""
        return Gain(-self.share, self.error)

    @classmethod
    def measure(cls, before: Float64, after: Float64) -> "Gain":
        """Measure it by how two maps fared with some scans (N, 2), as `Trial.predicted` has it."""
        beams, now = after.T
        more = now - before[:, 1]
        return cls(math.fsum(more) / max(math.fsum(beams), 1), estimate_error(more, beams))


def score_map(grid: OccupancyMap, held_out: Sequence[Rays], jobs: int) -> Trial:
    """Cast held-out beams, of which some must have measured a range, through a map."""
    from occmap.grid.kernels.cast import BINS, CERTAIN, Chart, cast_beams  # noqa: PLC0415  late: loads numba

    probability = np.where(grid.observed, grid.probability, np.float32(0.5))
    free_cost = -np.log(np.maximum(1 - probability, np.float32(CERTAIN)))
    tenths = np.minimum(probability * BINS, BINS - 1)
    bins = np.where(grid.observed, tenths, BINS).astype(np.uint8)
    chart = Chart(grid.occupied, probability, free_cost, bins, grid.origin, grid.resolution)
    totals = [np.zeros((len(rays.kind), 6)) for rays in held_out]
    tallies = [np.zeros((BINS + 1, 3)) for _ in held_out]

    def cast(index: int) -> None:
        cast_beams(held_out[index], chart, totals[index], tallies[index])

    with Workers(cast, jobs) as workers:
        for index in range(len(held_out)):
            workers.give(index)
    by_scan = np.concatenate(totals)
    reliability = tuple(
        ReliabilityBin(int(looks), predicted / looks, ended / looks)
        for looks, predicted, ended in np.sum(tallies, axis=0)[:BINS].tolist()
        if looks
    )
    return Trial(replace(sum_up(by_scan), reliability=reliability), by_scan[:, :2])


def sum_up(totals: Float64) -> Score:
    """Turn (N, 6) totals of N scans, as `cast_beams` writes them, into means."""
    beams, near, log_likelihood, occupied, cells, free = (math.fsum(each) for each in totals.T)
    occupied_cost, free_cost = occupied / beams, free / max(cells, 1)
    return Score(
        beams=int(beams),
        share=near / beams,
        share_error=estimate_error(totals[:, 1], totals[:, 0]),
        log_likelihood=log_likelihood / beams,
        occupied_cost=occupied_cost,
        free_cost=free_cost,
        cross_entropy=(occupied_cost + free_cost) / 2,
    )


def estimate_error(part: Float64, whole: Float64) -> float:
    """Estimate the standard error of sum(part) / sum(whole) over scans (N,).

    A scan, not a beam, is an independent draw: its beams see the same wall by the same pose. So
    this is the error of a ratio of sums over clusters (Cochran 1977, ch. 6); inf for one scan.
    """
    scans, total = int(np.count_nonzero(whole)), math.fsum(whole)
    if scans < 2:
        return math.inf
    rest = part - math.fsum(part) / total * whole
    return math.sqrt(scans / (scans - 1) * math.fsum(rest**2)) / total
