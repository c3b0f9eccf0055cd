"""The rules by which other projects decide what a cell is, each with that project's defaults.

Only the rule is compared: all of them are given occmap's poses, ranges and lattice, and all scans
in one grid. Projects that map while they localise may also leave scans out or keep submaps.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occmap.cells import CellBox, Decision, OccupancyMap, to_log_odds
from occmap.grid import Lattice
from occmap.grid.engine import GridEngine
from occmap.grid.rendering import find_bounds, measure_bounds
from occmap.grid.tiles import GridSpec, TileGrid
from occmap.types import Bool, Float32, Rays, Update


class Verdict(NamedTuple):
    """What a rule says of cells, all (H, W)."""

    log_odds: Float32
    known: Bool
    cut: float = 0.5
    """A cell is occupied where its probability is above this"""


def share_hits(hits: Float32, misses: Float32) -> Verdict:
    """Gmapping: occupied where hits / visits is above `occ_thresh`, 0.25 (slam_gmapping)."""
    return Verdict(divide_odds(hits, misses), hits + misses > 0, 0.25)


def pass_through(hits: Float32, misses: Float32) -> Verdict:
    """Karto: occupied where hits / passes is above OccupancyThreshold, 0.1 (OpenKarto).

    Known only where passes are more than MinPassThrough, 2. The end of a beam counts as a pass
    twice: once as the last cell of the line, and once more as a hit.
    """
    passes = misses + 2 * hits
    return Verdict(divide_odds(hits, passes - hits), passes > 2, 0.1)


def add_log_odds(hits: Float32, misses: Float32) -> Verdict:
    """Plain Bayes: 0.7 for a hit and 0.4 for a miss, by beam (Thrun, Burgard, Fox 2005, ch. 9)."""
    log_odds = hits * np.float32(to_log_odds(0.7)) + misses * np.float32(to_log_odds(0.4))
    return Verdict(log_odds, hits + misses > 0)


def divide_odds(part: Float32, rest: Float32) -> Float32:
    """ln(part / rest); infinite where there is none of one."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(part) - np.log(rest)


COUNT_RULES: Mapping[str, Callable[[Float32, Float32], Verdict]] = {
    "gmapping": share_hits,
    "karto": pass_through,
    "plain Bayes": add_log_odds,
}
"""Of how often beams ended in a cell, and how often they crossed it."""


class ScanRule(NamedTuple):
    """Log-odds that a scan adds to a cell once: `hit` where any beam ended, else `miss`.

    A cell is occupied above even odds. Bounds hold after each scan, so the order of scans matters.
    """

    hit: float
    miss: float
    low: float = -math.inf
    high: float = math.inf


SCAN_RULES: Mapping[str, ScanRule] = {
    # setProbHit, setProbMiss, setClampingThresMin and -Max of AbstractOccupancyOcTree
    "OctoMap": ScanRule(
        to_log_odds(0.7), to_log_odds(0.4), to_log_odds(0.1192), to_log_odds(0.971)
    ),
    # update_factor_occupied, update_factor_free; a cell above 50 takes no more hits
    "hector": ScanRule(to_log_odds(0.9), to_log_odds(0.4), high=50.0),
    # hit_probability, miss_probability; kMinProbability and kMaxProbability
    "Cartographer": ScanRule(
        to_log_odds(0.55), to_log_odds(0.49), to_log_odds(0.1), to_log_odds(0.9)
    ),
}

CLASSES_ONLY = ("karto",)
"""Of these the share of hits is not meant as a probability."""


def map_peers(scans: Sequence[Rays], by_beam: TileGrid) -> dict[str, OccupancyMap]:
    """Make the map of every peer.

    Parameters
    ----------
    by_beam
        What occmap's plain beam update counts in these scans.
    """
    lattice, box = by_beam.lattice, find_bounds(by_beam)
    hits, misses = by_beam.gather(box, np.float32)
    verdicts = {name: rule(hits, misses) for name, rule in COUNT_RULES.items()}
    log_odds = observe_by_scan(scans, list(SCAN_RULES.values()), lattice, box)
    known = hits + misses > 0
    verdicts |= {name: Verdict(log_odds[i], known) for i, name in enumerate(SCAN_RULES)}
    corner = lattice.to_metres(box.col), lattice.to_metres(box.row)
    return {
        name: OccupancyMap(*found[:2], lattice.resolution, corner, Decision(found.cut, found.cut))
        for name, found in verdicts.items()
    }


def observe_by_scan(
    scans: Sequence[Rays], rules: Sequence[ScanRule], lattice: Lattice, box: CellBox
) -> Float32:
    """(R, H, W) log-odds of the cells of a box, in which rules observe one scan after the other."""
    log_odds = np.zeros((len(rules), *box.shape), np.float32)
    hit, miss, low, high = np.array(rules, np.float32).T[:, :, None, None]
    for rays in scans:
        for number in range(len(rays.kind)):
            engine = GridEngine(GridSpec(Update.BEAM, lattice))
            engine.add(rays.take(slice(number, number + 1)))
            seen = engine.finish()
            if touched := measure_bounds(seen):
                hits, misses = seen.gather(touched)
                change = np.where(hits > 0, hit, np.where(misses > 0, miss, 0))
                part = log_odds[:, *touched.within(box)]
                np.clip(part + change, low, high, out=part)
    return log_odds
