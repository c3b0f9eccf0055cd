"""What lasts: hits that came on several visits stay, people who walked through once do not."""

from collections.abc import Iterator, Sequence

import numpy as np

from occmap.errors import MapError, UsageError
from occmap.grid.layers import sum_visits
from occmap.grid.stacks import drop_empty
from occmap.grid.tiles import TILE, Tile, TileGrid
from occmap.sensor.models import RadialModel, SensorModel
from occmap.types import Int64, Times
from occmap.wording import count

SHORTEST_GAP_S, LONGEST_GAP_S = 1e-3, 1e9
NEARLY_ALL = 0.9
"""Of the cells that were hit, half were hit on one visit only in real logs of many visits (43 to
51%), but 92 to 99% where the robot never came back."""


def keep_lasting(grid: TileGrid, layers: Sequence[Times], min_passes: int | None) -> TileGrid:
    """Weigh hits by the visits that they came on; `grid` stays as it is.

    A cell that was hit on fewer than `min_passes` visits loses its hits. Of one that was hit on so
    many, and on at least half of those that saw it, misses are forgotten: at a thin wall they come
    from beams that graze it.

    Parameters
    ----------
    grid
        Of hits and misses.
    layers
        When the cells were observed, build by build.
    min_passes
        None: all stays as it is.

    Raises
    ------
    MapError
        Nothing is left.
    """
    if min_passes is None:
        return grid
    visits = sum_visits(layers)
    nothing = np.zeros((2, TILE, TILE), np.int64)
    lasting = TileGrid(grid.lattice, grid.kind)
    for key, tile in grid.tiles.items():
        lasting.tiles[key] = weigh_visits(tile, visits.get(key, nothing), min_passes)
    drop_empty(lasting)
    if grid.tiles and not lasting.tiles:
        raise MapError(
            f"no cell was hit on {min_passes} visits, and none was seen free: there is no map",
            fix="give a smaller --min-passes",
        )
    return lasting


def weigh_visits(numbers: Tile, visits: Int64, min_passes: int) -> Int64:
    """Forget hits or misses (2, ...) of cells by the visits (2, ...) that hit and that saw them."""
    (hits, misses), (hit, seen) = numbers, visits
    often = hit >= min_passes
    mostly = often & (2 * hit >= seen)
    return np.stack([np.where(often, hits, 0), np.where(mostly, 0, misses)])


def list_forgotten(layers: Sequence[Times], min_passes: int | None) -> Iterator[str]:
    """Say where nearly all cells lose their hits: then there was hardly more than one visit."""
    if min_passes is None:
        return
    visits = [hit for hit, _ in sum_visits(layers).values()]
    were_hit = sum(int(np.count_nonzero(hit)) for hit in visits)
    lost = sum(int(np.count_nonzero((hit > 0) & (hit < min_passes))) for hit in visits)
    if lost > NEARLY_ALL * were_hit:
        yield (
            f"--min-passes {min_passes} forgets the hits of {lost:,} of {count(were_hit, 'cell')}, "
            "walls among them: they were hit on fewer visits; leave it out, or build with a "
            "smaller --pass-gap"
        )


def check_passes(min_passes: int | None, model: SensorModel) -> None:
    """Refuse a number of visits that no model can be asked for, or not this one.

    Raises
    ------
    UsageError
        It is below 1, or the model does not count hits.
    """
    if min_passes is None:
        return
    if min_passes < 1:
        raise UsageError(f"--min-passes {min_passes} is not possible", fix="give 1 or more")
    if isinstance(model, RadialModel):
        raise UsageError(
            f"--min-passes counts the visits that hit a cell, while {model.name} sums up log-odds "
            "and knows no hits",
            fix="leave it out, or build with --model simple or --model counting",
        )


def check_gap(pass_gap_s: float) -> None:
    """Refuse slices of time that tell no visits apart.

    Raises
    ------
    UsageError
        They are too short or too long.
    """
    if not SHORTEST_GAP_S <= pass_gap_s <= LONGEST_GAP_S:
        raise UsageError(
            f"--pass-gap {pass_gap_s:g} is not possible",
            fix=f"give {SHORTEST_GAP_S:g} to {LONGEST_GAP_S:g} seconds",
        )
