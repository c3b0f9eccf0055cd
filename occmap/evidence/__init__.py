"""Evidence: the map that a model makes of it, and a grid made of what was saved of it."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeAlias

import numpy as np

from occmap.cells import Evidence, Manifest, OccupancyMap, to_log_odds
from occmap.errors import MapError, OccmapError
from occmap.evidence.manifest import describe_profile
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.rendering import SpreadHits, count_agreeing, find_bounds, paint
from occmap.grid.tiles import (
    LOG_ODDS_UNIT,
    EvidenceKind,
    TileGrid,
    add_stack,
    find_unit,
    refuse_large,
)
from occmap.sensor import models
from occmap.sensor.models import SensorModel, find_decision, parse_model
from occmap.types import Float64

Weigh: TypeAlias = Callable[[Float64, Float64], Float64]
"""Takes hits and misses, or log-odds and observations; gives log-odds"""


def render(grid: TileGrid, model: SensorModel, max_cells: int) -> OccupancyMap:
    """Let a model say what the evidence means.

    Raises
    ------
    MapError
        Nothing was observed, or the map would be too large.
    """
    box = find_bounds(choose_tiles(grid, model))
    refuse_large(box, grid.lattice, max_cells)
    made = paint_box(grid, model, box)
    agreeing, hits = count_agreeing(grid, made.occupied, box)
    return replace(made, agreement=agreeing / hits if hits else None)


def paint_box(grid: TileGrid, model: SensorModel, box: CellBox) -> OccupancyMap:
    """Let a model say what the evidence means in a box of cells; the map knows no agreement."""
    painted = paint(choose_tiles(grid, model), weigh(model), to_log_odds(model.prior), box)
    x, y, _, _ = grid.lattice.measure(box)
    return OccupancyMap(*painted, grid.lattice.resolution, (x, y), find_decision(model))


def choose_tiles(grid: TileGrid, model: SensorModel) -> TileGrid:
    """Choose what a model reads: the grid as it is, or with its hits spread."""
    if isinstance(model, models.Spreading) and model.spread > 0:
        return SpreadHits(grid, model.spread)
    return grid


def weigh(model: SensorModel) -> Weigh:
    """Make the function that turns the two numbers of observed cells (N,) into log-odds."""
    start = to_log_odds(model.prior)

    def add_radial(log_odds: Float64, observations: Float64) -> Float64:
        return start + log_odds * LOG_ODDS_UNIT - observations * start

    add_up = add_radial if isinstance(model, models.RadialModel) else model.log_odds
    if not isinstance(model, models.Clamped):
        return add_up
    low = to_log_odds(model.clamp_min) if model.clamp_min > 0 else -math.inf
    high = to_log_odds(model.clamp_max) if model.clamp_max < 1 else math.inf
    return lambda first, second: np.clip(add_up(first, second), low, high)


class Described(Protocol):
    """Whatever has the manifest of evidence."""

    @property
    def manifest(self) -> Manifest:
        """The description of the evidence."""

    @property
    def where(self) -> str:
        """What it was read from."""


def read_model(evidence: Described) -> SensorModel:
    """Make the model that evidence was built with.

    Raises
    ------
    MapError
        It is not installed, or another version of it is.
    """
    try:
        return parse_model(evidence.manifest.model)
    except OccmapError as error:
        found = f"its model {evidence.manifest.model!r} cannot be made ({error.found})"
        fix = "give another with `model`, or install what has it"
        raise MapError(found, where=evidence.where, fix=fix) from None


def to_grid(evidence: Evidence) -> TileGrid:
    """Make a grid of evidence, which more may be added to."""
    grid = make_empty(evidence.manifest)
    add_stack(grid, evidence.tiles, evidence.cells)
    return grid


def make_empty(manifest: Manifest) -> TileGrid:
    """Make a grid for such evidence, with no observations yet."""
    unit = find_unit(manifest.update)
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
        raise MapError(
            f"holds hits and misses, which {model.name} cannot read",
            where=evidence.where,
            fix=f"build it with `model={model.name}`",
        )
