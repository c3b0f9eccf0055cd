"""What lasts: hits that came on several visits stay, people who walked through once do not."""

from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

import numpy as np

from occmap.cells import OccupancyMap, Slices
from occmap.errors import MapError, UsageError, require
from occmap.evidence import render
from occmap.grid.rendering import frame
from occmap.grid.slices import count_visits, split_tiles, unite
from occmap.grid.tiles import TileGrid, drop_empty
from occmap.sensor.models import RadialModel, SensorModel

MUCH = 0.25
"""A note is given if this share of the occupied cells is lost: people are seldom so many."""


def keep_lasting(grid: TileGrid, slices: Sequence[Slices], min_passes: int | None) -> TileGrid:
    """Weigh hits by the visits that they came on; `grid` stays as it is.

    A cell that was hit on fewer than `min_passes` visits loses its hits. Of one that was hit on so
    many, and on at least half of those that saw it, misses are forgotten: at a thin wall they come
    from beams that graze it.

    Parameters
    ----------
    grid
        Of hits and misses.
    slices
        When the cells were observed, build by build; a slice that several builds share is one.
    min_passes
        None: all stays as it is.
    """
    if min_passes is None:
        return grid
    lasting = grid.like({})
    for key, of_tile in split_tiles(unite(slices)):
        if key in grid.tiles:
            (hits, misses), (hit, seen) = grid.tiles[key], count_visits(of_tile)
            often = hit >= min_passes
            mostly = often & (2 * hit >= seen)
            kept = np.where(often, hits, 0), np.where(mostly, 0, misses)
            lasting.tiles[key] = np.stack(kept)
    drop_empty(lasting)
    return lasting


def refuse_nothing_left(min_passes: int | None) -> NoReturn:
    """Say that no cell was observed, or that none lasts; raises MapError."""
    if min_passes is None:
        raise MapError("no beam of any scan observed a cell, so there is no map")
    found = f"no cell was hit on {min_passes} visits, and none was seen free: there is no map"
    raise MapError(found, fix="give a smaller `min_passes`")


def render_lasting(
    grid: TileGrid, slices: Sequence[Slices], model: SensorModel, options: Any
) -> tuple[OccupancyMap, list[str]]:
    """Make the map of what lasts, as it is to be framed; a note says where much does not last.

    Parameters
    ----------
    options
        Those of a build or of a map of saved evidence: `min_passes`, `max_cells` and `framing`.

    Raises
    ------
    MapError
        Nothing is left, or as `render` and `frame`.
    """
    lasting = keep_lasting(grid, slices, options.min_passes)
    if grid.tiles and not lasting.tiles:
        refuse_nothing_left(options.min_passes)
    made, lost = render(lasting, model, options.max_cells), []
    if lasting is not grid:
        lost = list(list_lost(render(grid, model, options.max_cells), made))
    return frame(made, options.framing, model.prior, options.max_cells), lost


def list_lost(before: OccupancyMap, after: OccupancyMap) -> Iterator[str]:
    """Say so if many cells are no longer occupied after hits and misses were forgotten."""
    start = after.place - before.place
    rows, cols = map(slice, start, start + after.shape)
    were = int(np.count_nonzero(before.occupied))
    lost = were - int(np.count_nonzero(before.occupied[rows, cols] & after.occupied))
    yield from describe_lost(were, lost)


def describe_lost(were: int, lost: int) -> Iterator[str]:
    """Say so if many of the occupied cells are lost."""
    if lost and lost >= MUCH * were:
        yield (
            f"`min_passes` takes away {100 * lost / were:.0f}% of the occupied cells ({lost:,} of "
            f"{were:,}), since they were hit on fewer visits; walls may be among them: leave it "
            "out, or build with a smaller `pass_gap_s`"
        )


def check_passes(min_passes: int | None, model: SensorModel) -> None:
    """Refuse a number of visits below 1, or any number for a model that counts no hits.

    Raises
    ------
    UsageError
        It is below 1, or the model does not count hits.
    """
    if min_passes is None:
        return
    require(min_passes >= 1, f"`min_passes={min_passes}` is not possible", "give 1 or more")
    if isinstance(model, RadialModel):
        raise UsageError(
            f"`min_passes` counts the visits that hit a cell, while {model.name} sums up log-odds "
            "and knows no hits",
            fix="leave it out, or build with `model=simple` or `model=counting`",
        )
