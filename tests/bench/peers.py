"""The rules by which other projects decide what a cell is, each with that project's defaults.

Only the rule is compared: all of them are given occmap's poses, ranges and lattice, and all scans
in one grid. Projects that map while they localise may also leave scans out or keep submaps.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occmap.cells import Decision, OccupancyMap, to_log_odds
from occmap.grid import CellBox, Lattice
from occmap.grid.kernels.units import FREE, HIT, SKIP
from occmap.grid.rendering import find_bounds, paint
from occmap.grid.tiles import TileGrid
from occmap.jit import kernel
from occmap.types import Bool, Float32, Float64, Int32, Int64, Rays, UInt8


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
    row, col, row_end, col_end = find_bounds(by_beam)
    box = CellBox(row - 1, col - 1, row_end + 1, col_end + 1)  # as ends are rounded twice
    hits, _ = paint(by_beam, lambda first, _: first, 0.0, box)
    misses, _ = paint(by_beam, lambda _, second: second, 0.0, box)
    verdicts = {name: rule(hits, misses) for name, rule in COUNT_RULES.items()}
    verdicts |= observe_by_scan(scans, SCAN_RULES, by_beam.lattice, box)
    corner = by_beam.lattice.to_metres(box.col), by_beam.lattice.to_metres(box.row)
    return {
        name: OccupancyMap(
            found.log_odds,
            found.known,
            by_beam.lattice.resolution,
            corner,
            Decision(found.cut, found.cut),
        )
        for name, found in verdicts.items()
    }


def observe_by_scan(
    scans: Sequence[Rays], rules: Mapping[str, ScanRule], lattice: Lattice, box: CellBox
) -> dict[str, Verdict]:
    """Let rules observe scans one after the other, in the cells of a box that no beam leaves."""
    log_odds = np.zeros((len(rules), box.rows, box.cols), np.float32)
    seen = np.zeros((box.rows, box.cols), np.int32)
    low = np.array([box.col, box.row])
    done = 0
    for rays in scans:
        starts, ends = (
            np.floor(lattice.to_units(place) / 256).astype(np.int64) - low
            for place in (rays.origin, rays.end)
        )
        observe_scans(starts, ends, rays.kind, np.array(list(rules.values())), done, seen, log_odds)
        done += len(rays.kind)
    return {name: Verdict(log_odds[i], seen != 0) for i, name in enumerate(rules)}


@kernel
def observe_scans(
    starts: Int64,
    ends: Int64,
    kinds: UInt8,
    rules: Float64,
    done: int,
    seen: Int32,
    log_odds: Float32,
) -> None:
    """Add scans to the log-odds of each rule.

    Parameters
    ----------
    starts, ends, kinds
        (S, K, 2), (S, B, 2) columns and rows, (S, B).
    rules
        (R, 4) as `ScanRule`.
    done
        How many scans were added before.
    seen
        (H, W) the number of the last scan that a cell was observed by, from 1.
    log_odds
        (R, H, W) added to.
    """
    scans, beams = kinds.shape
    for s in range(scans):
        number = done + s + 1
        for b in range(beams):
            if kinds[s, b] == HIT:
                _observe(rules[:, 0], rules, ends[s, b, 1], ends[s, b, 0], number, seen, log_odds)
        for b in range(beams):
            if kinds[s, b] == SKIP:
                continue
            k = min(b, starts.shape[1] - 1)
            col, row = starts[s, k]
            end_col, end_row = ends[s, b]
            right, up = (1 if end_col > col else -1), (1 if end_row > row else -1)
            across, rise = abs(end_col - col), abs(end_row - row)
            steps, error = max(across, rise), max(across, rise)
            for _ in range(steps + int(kinds[s, b] == FREE)):
                _observe(rules[:, 1], rules, row, col, number, seen, log_odds)
                error += 2 * min(across, rise)
                aside = error >= 2 * steps
                error -= 2 * steps * int(aside)
                col += right * int(aside or across >= rise)
                row += up * int(aside or across < rise)


@kernel
def _observe(
    change: Float64, rules: Float64, row: int, col: int, number: int, seen: Int32, log_odds: Float32
) -> None:
    """Add to a cell, once a scan."""
    if seen[row, col] == number:
        return
    seen[row, col] = number
    for r in range(len(rules)):
        total = log_odds[r, row, col] + change[r]
        log_odds[r, row, col] = min(max(total, rules[r, 2]), rules[r, 3])
