"""Whether logs that are added up see the same building in the same place."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from occmap.cells import to_log_odds
from occmap.evidence import choose_tiles, weigh
from occmap.grid.lattice import CellBox
from occmap.grid.tiles import TILE, EvidenceKind, Key, Tile, TileGrid
from occmap.sensor.models import SensorModel, find_decision

MOST_TILES = 16
"""At most so many of the tiles that both saw are looked at, evenly spread."""
FEWEST_HITS = 200.0
"""With fewer hits, less than a scan has, no note is given."""
MUCH_LESS = 0.15
"""Parts of one log lose 0.00 to 0.05 where their poses are corrected, and up to 0.12 on the raw
odometry of a floor; different buildings, and one building 3 m away, lose 0.21 to 0.41."""


class Fit(NamedTuple):
    """Of the hits in cells that both saw, the share in cells called occupied: the mean of both."""

    alone: float
    """Where each is mapped by itself"""
    together: float


def list_misfit(
    grid: TileGrid, others: Mapping[Key, Tile], model: SensorModel, whom: str
) -> Iterator[str]:
    """Say that the tiles of a log contradict those that it is added to, called `whom`."""
    fit = measure_fit(grid, others, model)
    if fit is not None and fit.together < fit.alone - MUCH_LESS:
        yield (
            f"does not fit {whom}: in cells that both saw, {fit.alone:.0%} of the hits lie in "
            f"occupied cells where each is mapped alone, and {fit.together:.0%} together; where "
            "their frames differ, build each with a `transform` of its own and merge them"
        )


def measure_fit(grid: TileGrid, others: Mapping[Key, Tile], model: SensorModel) -> Fit | None:
    """Measure how well two parts of a map agree; None where they share too little, or keep no hits.

    Only cells that both saw count, and each part as much as the other: it does not matter which
    is longer, or how much each saw elsewhere.
    """
    if grid.kind is not EvidenceKind.COUNTS:
        return None
    shared = sorted(grid.tiles.keys() & others.keys())
    sample = shared[:: max(-(-len(shared) // MOST_TILES), 1)]
    parts = [{key: tiles[key] for key in sample} for tiles in (grid.tiles, others)]
    both: dict[Key, Tile] = {
        key: np.sum([part[key] for part in parts], axis=0, dtype=np.int64) for key in sample
    }
    sources = [choose_tiles(grid.like(tiles), model) for tiles in [*parts, both]]
    log_odds, cut = weigh(model), to_log_odds(find_decision(model).occupied_above)
    sums = np.zeros((2, 3))  # of each part: hits, those that agree alone, and those together
    for key in sample:
        met = np.all([part[key].any(axis=0) for part in parts], axis=0)
        *each, together = (source.read(CellBox.at(*key).scale(TILE)) for source in sources)
        for row, (part, alone) in enumerate(zip(parts, each, strict=True)):
            where = met & (part[key][0] > 0)
            hits = part[key][0][where]
            sums[row, 0] += hits.sum()
            for column, (first, second) in enumerate((alone, together), start=1):
                occupied = log_odds(first[where], second[where]) > cut
                sums[row, column] += hits[occupied].sum()
    if sums[:, 0].min() < FEWEST_HITS * grid.unit:
        return None
    shares = (sums[:, 1:] / sums[:, :1]).mean(axis=0)
    return Fit(*shares.tolist())
