"""Scoring: how well a map predicts scans that it was not made of.

`compare` asks it of several ways to make a map, `maps` of a map that is written, and
`occmap.tuning` of corrections of the poses.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occmap.cells import OccupancyMap
from occmap.report import Count, Finite, Share
from occmap.scans import Sample
from occmap.scans.tracing import TakesRays
from occmap.threads import Threads
from occmap.types import Float64, Kind, Rays

NOISE = 2.0
"""Standard errors: a difference that is not larger may be chance."""
SMALL = 0.005
"""A smaller difference of shares does not show in a map, however certain it is: as all maps are
asked about the same scans, a difference of a thousandth may well be certain."""
MOST_SCANS = 4000
"""Of all logs together: more tell little more, and all that are asked are held in memory."""
EVERY = 5
"""Every n-th scan is held out"""
FIRST = 2
"""The first scan that is held out, counted from 0"""


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
    """How a map fared with the scans that are held out from it, or how several maps did."""

    totals: Float64
    """(N, 6) of each held-out scan, as `cast_beams` writes them"""
    looks: Float64
    """(BINS + 1, 3) of the cells in each bin of probability, likewise"""
    agreement: float | None
    """Share of the other scans' hits in cells that the map calls occupied; None without any"""
    parts: tuple["Trial", ...] = ()
    """Those of single maps, where this is all of them together"""

    @classmethod
    def join(cls, parts: Iterable["Trial"]) -> "Trial":
        """Take several maps together; their agreement counts by their held-out beams."""
        parts = tuple(parts)
        totals = np.concatenate([each.totals for each in parts])
        known = [(it.agreement, it.totals[:, 0].sum()) for it in parts if it.agreement is not None]
        beams = sum(beams for _, beams in known)
        agreement = sum(agreement * beams for agreement, beams in known) / beams if known else None
        looks = sum((each.looks for each in parts), np.zeros((1, 3)))
        return cls(totals, looks, agreement, parts)

    @property
    def predicted(self) -> Float64:
        """(N, 2) of each held-out scan: beams that measured a range, and those it predicted."""
        return self.totals[:, :2]

    @property
    def score(self) -> Score:
        """Means over all beams."""
        beams, near, likelihood, occupied, cells, free = map(math.fsum, self.totals.T)
        occupied_cost, free_cost = occupied / max(beams, 1), free / max(cells, 1)
        return Score(
            beams=int(beams),
            share=near / max(beams, 1),
            share_error=estimate_error(self.totals[:, 1], self.totals[:, 0]),
            log_likelihood=likelihood / max(beams, 1),
            occupied_cost=occupied_cost,
            free_cost=free_cost,
            cross_entropy=(occupied_cost + free_cost) / 2,
            reliability=tuple(
                ReliabilityBin(int(looks), predicted / looks, ended / looks)
                for looks, predicted, ended in self.looks[:-1].tolist()
                if looks
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Gain:
    """How much larger the share of one map is than that of another, by the same scans."""

    gain: float = 0.0
    """How much larger the share is"""
    gain_error: Finite = 0.0
    """Standard error of the gain, from the differences scan by scan; null where one scan is all
    there is"""

    @classmethod
    def measure(cls, before: Float64, after: Float64) -> "Gain":
        """Measure it by how two maps fared with some scans (N, 2), as `Trial.predicted` has it.

        The error is smaller than those of the shares, as both maps are asked about the same scans.
        """
        beams, now = after.T
        more = now - before[:, 1]
        gain = math.fsum(more) / max(math.fsum(beams), 1)
        return Gain(gain=gain, gain_error=estimate_error(more, beams))

    def __str__(self) -> str:
        error = f" +- {self.gain_error:.4f}" if math.isfinite(self.gain_error) else ""
        return f"{self.gain:.4f}{error}"

    @property
    def certain(self) -> bool:
        """Whether it is more than noise, and so much that it shows in a map."""
        return self.gain > max(NOISE * self.gain_error, SMALL)

    @property
    def loses(self) -> bool:
        """Whether the share is certainly smaller."""
        return -self.gain > max(NOISE * self.gain_error, SMALL)


def score_map(grid: OccupancyMap, held_out: Sequence[Rays], jobs: int) -> Trial:
    """Cast held-out beams through a map."""
    from occmap.grid.kernels.cast import BINS, CERTAIN, Chart, cast_beams  # noqa: PLC0415  late: loads numba

    probability = np.where(grid.observed, grid.probability, np.float32(0.5))
    free_cost = -np.log(np.maximum(1 - probability, np.float32(CERTAIN)))
    tenths = np.minimum(probability * BINS, BINS - 1)
    bins = np.where(grid.observed, tenths, BINS).astype(np.uint8)
    chart = Chart(grid.occupied, probability, free_cost, bins, grid.origin, grid.resolution)
    totals = [np.zeros((len(rays.kind), 6)) for rays in held_out]
    looks = [np.zeros((BINS + 1, 3)) for _ in held_out]

    def cast(index: int) -> None:
        cast_beams(held_out[index], chart, totals[index], looks[index])

    with Threads(cast, jobs) as threads:
        for index in range(len(held_out)):
            threads.give(index)
    return Trial(np.concatenate(totals), np.sum(looks, axis=0), grid.agreement)


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


def hold_out(seen: Iterable[Rays], engines: Sequence[TakesRays], jobs: int) -> Sample[Rays]:
    """Keep every fifth scan, to score maps on, and give all others to each of some engines."""
    held_out, before = Sample[Rays](MOST_SCANS), 0
    with Threads[tuple[TakesRays, Rays]](lambda it: it[0].add(it[1]), jobs) as threads:
        for rays in seen:
            kept = (before + np.arange(len(rays.kind))) % EVERY == FIRST
            before += len(rays.kind)
            held_out.add(rays.take(kept))
            others = rays.take(~kept)
            for engine in engines if len(others.kind) else ():
                threads.give((engine, others))
    return held_out


def has_hits(scans: Sample[Rays]) -> bool:
    """Whether any beam of scans measured a range, so that maps can be scored on them."""
    return any((rays.kind == Kind.HIT).any() for rays in scans.parts)
