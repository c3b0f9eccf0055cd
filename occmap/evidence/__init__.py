"""Evidence: which model reads it, the map that this makes, what of it lasts, whether two fit."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from occmap.cells import CellBox, Evidence, Key, Manifest, OccupancyMap, Slices, Tile, to_log_odds
from occmap.choices import format_place
from occmap.errors import MapError, OccmapError, UsageError, require
from occmap.evidence.manifest import describe_profile
from occmap.grid import Lattice, tiles
from occmap.grid.rendering import SpreadHits, count_agreeing, find_bounds
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind, TileGrid
from occmap.sensor import models
from occmap.sensor.models import SensorModel
from occmap.types import Float64, Int32, Pose, Update


def render(grid: TileGrid, model: SensorModel, max_cells: int) -> OccupancyMap:
    """Let a model say what the evidence means.

    Raises
    ------
    MapError
        Nothing was observed, or the map would be too large.
    """
    box = find_bounds(choose_tiles(grid, model))
    tiles.refuse_large(box, grid.lattice, max_cells)
    made = paint_box(grid, model, box)
    agreeing, hits = count_agreeing(grid, made.occupied, box)
    return replace(made, agreement=agreeing / hits if hits else None)


def paint_box(grid: TileGrid, model: SensorModel, box: CellBox) -> OccupancyMap:
    """Let a model say what the evidence means in a box of cells; the map knows no agreement."""
    chosen, lattice = choose_tiles(grid, model), grid.lattice
    log_odds = np.full(box.shape, to_log_odds(model.prior), np.float32)
    observed = np.zeros(box.shape, np.bool_)
    for part in chosen.list_parts(box):
        first, second = chosen.read(part)
        seen, inside = chosen.observed(first, second), part.within(box)
        observed[inside] = seen
        log_odds[inside][seen] = weigh(model, first[seen], second[seen])
    x, y, _, _ = lattice.measure(box)
    decision = models.find_decision(model)
    return OccupancyMap(log_odds, observed, lattice.resolution, (x, y), decision)


def choose_tiles(grid: TileGrid, model: SensorModel) -> TileGrid:
    """Choose what a model reads: the grid as it is, or with its hits spread."""
    spread = models.get_parameter(model, "spread")
    return SpreadHits(grid, spread) if spread > 0 else grid


def weigh(model: SensorModel, first: Float64, second: Float64) -> Float64:
    """Turn hits and misses of cells (N,), or log-odds and observations, into log-odds."""
    if isinstance(model, models.RadialModel):
        start = to_log_odds(model.prior)
        log_odds = start + first * LOG_ODDS_UNIT - second * start
    else:
        log_odds = ask(model, first, second)
    least, most = (models.get_parameter(model, name) for name in models.NO_CLAMP)
    low = to_log_odds(least) if least > 0 else -math.inf
    high = to_log_odds(most) if most < 1 else math.inf
    return np.clip(log_odds, low, high)


def ask(model: models.CountModel, hits: Float64, misses: Float64) -> Float64:
    """Ask a model for log-odds (N,); raises UsageError if a plugin's gives none for some cells."""
    said = model.log_odds(hits, misses)
    if np.shape(said) != hits.shape or np.isnan(said).any():
        found = f"the model {model.name} gives no log-odds for some cells"
        raise UsageError(found, fix="this is a fault in its plugin: choose another `model`")
    return said


class Described(Protocol):
    """Whatever has the manifest of evidence."""

    @property
    def manifest(self) -> Manifest:
        """The description of the evidence."""

    @property
    def where(self) -> str:
        """What it was read from."""


def choose_model_for(
    evidence: Described, model: SensorModel | None, min_passes: int | None
) -> SensorModel:
    """Choose the model that evidence is read by: the one that is wanted, or else its own.

    Raises
    ------
    OccmapError
        The model cannot be made, or cannot read the evidence, or knows no visits.
    """
    chosen = model or read_model(evidence)
    refuse_other_profile(evidence, chosen)
    check_passes(min_passes, chosen)
    return chosen


def read_model(evidence: Described) -> SensorModel:
    """Make the model that evidence was built with.

    Raises
    ------
    MapError
        It is not installed, or another version of it is.
    """
    try:
        return models.parse_model(evidence.manifest.model)
    except OccmapError as error:
        found = f"its model {evidence.manifest.model!r} cannot be made ({error.found})"
        fix = "give another with `model`, or install what has it"
        raise MapError(found, where=evidence.where, fix=fix) from None


def to_grid(evidence: Evidence) -> TileGrid:
    """Make a grid of evidence, whose tiles it shares."""
    return make_empty(evidence.manifest).like(evidence.tiles)


def make_empty(manifest: Manifest) -> TileGrid:
    """Make a grid for such evidence, with no observations yet."""
    unit = tiles.find_unit(manifest.update)
    return TileGrid(Lattice(manifest.resolution), EvidenceKind(manifest.kind), unit)


def refuse_other_profile(evidence: Described, model: SensorModel) -> None:
    """Refuse a model that cannot read this evidence.

    Raises
    ------
    MapError
        Naming the model that can: other evidence may well be for this one.
    """
    made_for, wanted = evidence.manifest.profile, describe_profile(model)
    if made_for and made_for != wanted:
        found = f"was summed up for the model {made_for}; no other can read it"
        raise MapError(found, where=evidence.where, fix="leave out `model`, or change `prior`")
    if wanted and not made_for:
        found = f"holds hits and misses, which {model.name} cannot read"
        is_of_clouds = evidence.manifest.update == Update.CLOUD  # which no build gives others
        fix = "choose another `model`" if is_of_clouds else f"build it with `model={model.name}`"
        raise MapError(found, where=evidence.where, fix=fix)


MOST_TILES = 16
"""At most so many of the tiles that both saw are looked at, evenly spread."""
FEWEST_HITS = 200.0
"""With fewer hits, less than a scan has, no note is given."""
MOST_CONFLICT = 0.35
"""Parts of a log contradict each other by at most 0.02 (clouds, a simulated office) and 0.29 (real
scans, also of raw odometry). Laid half a metre off, real scans do by 0.51 to 0.74, and clouds and
the office, where most walls run that way, by 0.12 to 0.31; a metre and 11 degrees off, all do by
0.44 and more."""
NEAR_M = 0.1
"""Walls of two sessions lie so far apart where poses are as good as a map needs."""


def list_misfit(
    grid: TileGrid, others: Mapping[Key, Tile], model: SensorModel, whom: str
) -> Iterator[str]:
    """Say that the tiles of a log contradict those that it is added to, called `whom`."""
    if (share := measure_conflict(grid, others, model)) > MOST_CONFLICT:
        yield (
            f"does not fit {whom}: of the hits in cells that both saw, {share:.0%} lie where the "
            "other saw free space; where nothing was moved, their frames differ: `fit` lays one on "
            "the other as they are merged, or with `resume`"
        )


def measure_conflict(grid: TileGrid, others: Mapping[Key, Tile], model: SensorModel) -> float:
    """Measure how much two parts of a map contradict each other.

    Agreement hardly falls where as many hits as misses lie on the walls of both. So hits of each
    part are held against the map of the other, and each part counts as much as the other.

    Returns
    -------
    share
        Of the hits of a part in cells that the other calls free or occupied, those in free cells
        with nothing occupied within `NEAR_M`: the mean of the parts that have hits enough there.
        0 where they share too little, or keep no hits.
    """
    if grid.kind is not EvidenceKind.COUNTS:
        return 0.0
    shared = sorted(grid.tiles.keys() & others.keys())
    reach = max(round(NEAR_M / grid.lattice.resolution), 1)
    inner, parts = np.s_[reach:-reach, reach:-reach], (grid, grid.like(others))
    sums = np.zeros((2, 2))  # of each part: hits, and those that the other contradicts
    for key in shared[:: max(-(-len(shared) // MOST_TILES), 1)]:
        box = CellBox.at(*key).scale(TILE).grow(reach)
        for row, (part, other) in enumerate(zip(parts, parts[::-1], strict=True)):
            seen = paint_box(other, model, box)
            known, free = (seen.free | seen.occupied)[inner], seen.free[inner]
            near: Any = seen.occupied
            for axis in (0, 1):
                near = sliding_window_view(near, 2 * reach + 1, axis).any(axis=-1)
            hits = part.tiles[key][0]
            sums[row] += hits[known].sum(), hits[free & ~near].sum()
    hits, against = sums[sums[:, 0] >= FEWEST_HITS * grid.unit].T
    return float((against / hits).mean()) if len(hits) else 0.0


LEAST_STEADY = 0.4
"""On good drives of clouds 42% (over rough ground) to 96% of the hits lie in cells that mostly were
hit, and 7% to 40% where axes, rotations or the order of the poses are wrong. Poses that are late by
0.15 to 1 s (38% to 49%) cannot be told from rough ground, a drone that lands has 31%, and an
orchard, where beams go through the leaves, 23%."""
LEAST_GROUND, OF_CORRIDOR = 0.05, 0.8
"""Of the points that are ground or obstacles; where a sensor looks along a floor it is a quarter,
and 1% in corridors, where 83% of the hits and more are steady; by wrong mounts at most 76% are."""
MOST_BELOW = 0.025
"""Below the ground, beside those on it: at most 0.8% on good drives, 3% and more where a mount is
off by 2 degrees. Beside drops and over floors that mirror it may be all of it, with steady hits."""


def count_steady(tiles: Mapping[Key, Tile]) -> tuple[int, int]:
    """Count the hits of clouds in cells that mostly were hit, and all hits.

    Agreement hardly falls for clouds: a cell is called occupied from a twentieth of its looks on.
    """
    hits = steady = 0
    for hit, missed in tiles.values():
        hits, steady = hits + int(hit.sum()), steady + int(hit[hit > missed].sum())
    return steady, hits


def list_contradictions(hits: tuple[int, int], points: Mapping[str, int]) -> Iterator[str]:
    """Say that clouds contradict each other, or show too little ground for what they are.

    Parameters
    ----------
    hits
        As `count_steady` counts them.
    points
        How many of their points lie where, as far as these were counted.
    """
    steady = hits[0] / hits[1] if hits[1] else 1.0
    if steady < LEAST_STEADY:
        yield (
            f"clouds contradict each other: only {steady:.0%} of their hits lie in cells that "
            "mostly were hit, as among leaves, or where poses, stamps, the mount, or the unit of a "
            "depth image are wrong: try another `poses=FILE` or `sensor_pose`; a clock that is off "
            "is found by `occmap tune`"
        )
    ground, obstacle, below = (points.get(each, 0) for each in ("ground", "obstacle", "below"))
    is_odd = ground < LEAST_GROUND * (ground + obstacle) or below > MOST_BELOW * ground
    if steady < OF_CORRIDOR and is_odd:
        yield (
            f"the points hardly fit a floor: {ground:,} lie on it, {obstacle:,} on obstacles and "
            f"{below:,} below it; `occmap check` says if a mount is wrong, and in grass a larger "
            "`min_height` may be right"
        )


def find_lasting(
    part: Evidence, min_passes: int | None, since: float | None = None, until: float | None = None
) -> tuple[TileGrid, TileGrid]:
    """Find what was observed of cells that were seen in a span of time, and what of that lasts.

    Slices of time tell both; one that several builds share is one. The evidence stays as it is.

    Parameters
    ----------
    min_passes
        On so many visits a cell has to be hit for its hits to last; None: all lasts.
    since, until
        Stamps (s) in the first and in the last slice of the span; None: from, or to, any.
    """
    seen, is_cut = to_grid(part), (since, until) != (None, None)
    if min_passes is None and not is_cut:
        return seen, seen
    slices = tiles.unite(cut_slices(part, since, until) if is_cut else part.slices)
    known = {key: of_tile for key, of_tile in tiles.split_tiles(slices) if key in part.tiles}
    if is_cut:
        kept = {key: part.tiles[key] * tiles.find_seen(of_tile) for key, of_tile in known.items()}
        seen = seen.like(tiles.drop_empty(kept))
    if min_passes is None:
        return seen, seen
    lasting = {
        key: weigh_visits(seen.tiles[key], of_tile, min_passes)
        for key, of_tile in known.items()
        if key in seen.tiles
    }
    return seen, seen.like(tiles.drop_empty(lasting))


def cut_slices(part: Evidence, since: float | None, until: float | None) -> Iterator[Slices]:
    """Take the slices of each build that lie in a span of time, as `find_lasting` has it."""
    gap_ns = round(part.manifest.pass_gap_s * 1e9)  # as slices were cut
    first = -math.inf if since is None else round(since * 1e9) // gap_ns
    last = math.inf if until is None else round(until * 1e9) // gap_ns
    for each in part.slices:
        inside = (first <= each.numbers) & (each.numbers <= last)
        yield tiles.take_tiles(each, np.flatnonzero(inside))


def weigh_visits(tile: Tile, slices: Slices, min_passes: int) -> Tile:
    """Weigh the hits of a tile by the visits that they came on.

    A cell that was hit on fewer than `min_passes` visits loses its hits. Of one that was hit on so
    many, and on at least half of those that saw it, misses are forgotten: at a thin wall they come
    from beams that graze it.
    """
    (hits, misses), (hit, seen) = tile, tiles.count_visits(slices)
    often = hit >= min_passes
    mostly = often & (2 * hit >= seen)
    return np.stack([np.where(often, hits, 0), np.where(mostly, 0, misses)])


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
    if isinstance(model, models.RadialModel):
        raise UsageError(
            f"`min_passes` counts the visits that hit a cell, while {model.name} sums up log-odds "
            "and knows no hits",
            fix="leave it out, or build with `model=simple` or `model=counting`",
        )


UNEVEN_MM, UNEVEN_SHARE = 50, 0.05
"""Columns whose ground differs by more were not traced alike. Noise of poses makes some of them;
more than this share is a different ground"""


def refuse_other(rise: Int32, share: float, placed: Pose | None, otherwise: str) -> None:
    """Refuse ground that does not lie on that which is known.

    Parameters
    ----------
    rise
        (N,) how much higher it is where both were measured (mm).
    share
        So many of the columns that both measured may differ.
    placed
        The `transform` of its logs; None: nobody may move it.
    otherwise
        What to do where another z does not lay it there, or not all of it.

    Raises
    ------
    MapError
        Saying how far apart they are, and what to do.
    """
    if not len(rise):
        return
    middle, differs = int(np.median(rise)), np.abs(rise) > UNEVEN_MM
    spread = np.median(np.abs(rise - middle))
    is_moved = abs(middle) > UNEVEN_MM and spread <= max(UNEVEN_MM, abs(middle) / 4)
    if not is_moved and np.count_nonzero(differs) <= share * len(rise):
        return
    told = f"{differs.mean():.0%} of what both measured differs by more than {UNEVEN_MM / 1000:g} m"
    if not is_moved or placed is None:
        raise MapError(f"lies over other ground: {told}", fix=otherwise)
    found = f"its ground lies {abs(middle) / 1000:.2f} m {'higher' if middle > 0 else 'lower'}"
    moved = format_place(placed._replace(z=placed.z - middle / 1000))
    left = np.mean(np.abs(rise - middle) > UNEVEN_MM)
    also = f"; {left:.0%} would differ still, so {otherwise}, too" * bool(left > share)
    raise MapError(
        f"{found} than the known one (the median): {told}",
        fix=f"if it is the same floor, build it with `transform=({moved})`, which moves its z, or "
        f"let `fit` find where it lies{also}; another storey is a map of its own",
    )
