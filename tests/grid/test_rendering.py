"""From tiles to one map: what it covers, hits that speak for cells around, and what it says."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.cells import Box, CellBox, OccupancyMap
from occmap.errors import MapError, UsageError
from occmap.evidence import render
from occmap.grid import Lattice
from occmap.grid.engine import GridEngine
from occmap.grid.rendering import Framing, SpreadHits, count_agreeing, find_bounds
from occmap.grid.tiles import PART, TILE, EvidenceKind, GridSpec, TileGrid, find_unit
from occmap.sensor.models import CountingModel, QuadraticModel, SensorModel, SimpleModel
from occmap.store.painting import RenderOptions, open_map
from occmap.types import BEAM_UPDATES, Float64, Kind, Rays, Update
from occmap.writers import WriteOptions
from tests.evidence.saving import hold
from tests.grid.scans import FEW, MANY, MIDDLE, Drive, aim, drives, make_grid, make_rays, make_scan

Cell = tuple[int, int]
Numbers = dict[Cell, tuple[int, int]]
"""Hits and misses of each observed cell"""

EDGES = [0, 1, TILE - 2, TILE - 1, TILE, -1, -2, -TILE, -TILE - 1, 7, PART - 1, PART, -PART]
PLACES = st.tuples(st.sampled_from(EDGES), st.sampled_from(EDGES))
OBSERVED = st.dictionaries(
    PLACES, st.tuples(st.integers(0, 9), st.integers(0, 9)).filter(any), min_size=1, max_size=12
)


def spread_slowly(numbers: Numbers, share: float, unit: int) -> dict[Cell, tuple[float, float]]:
    """Each hit gives a share to the cells beside its own, and the share's square at corners."""
    hits: defaultdict[Cell, float] = defaultdict(float)
    for (row, col), (count, _) in numbers.items():
        for up in (-1, 0, 1):
            for right in (-1, 0, 1):
                hits[row + up, col + right] += count / unit * share ** (abs(up) + abs(right))
    reached = {cell for cell in hits if hits[cell]} | numbers.keys()
    return {cell: (hits[cell], numbers.get(cell, (0, 0))[1] / unit) for cell in reached}


@MANY
@given(numbers=OBSERVED, share=st.sampled_from([0.08, 0.1, 0.5, 1.0]), unit=st.sampled_from([1, 8]))
def test_spread_hits_are_those_of_single_cells(numbers: Numbers, share: float, unit: int) -> None:
    """On the edges and corners of tiles, and beyond, where there is no tile."""
    expected = spread_slowly(numbers, share, unit)
    tiles = SpreadHits(make_grid(numbers, unit=unit), share)
    rows, cols = zip(*expected, strict=True)
    box = find_bounds(tiles)
    assert box == CellBox(min(rows), min(cols), max(rows) + 1, max(cols) + 1)
    hits, misses = tiles.read(box)
    places = np.argwhere(tiles.observed(hits, misses)).tolist()
    assert {(row + box.row, col + box.col) for row, col in places} == expected.keys()
    for row, col in places:
        pair = hits[row, col], misses[row, col]
        assert pair == pytest.approx(expected[row + box.row, col + box.col])


def test_nothing_observed_has_no_bounds_whatever_is_spread() -> None:
    for nothing in (make_grid(), SpreadHits(make_grid(), 0.1)):
        with pytest.raises(MapError, match="no observation is left"):
            find_bounds(nothing)


@FEW
@given(numbers=OBSERVED, share=st.sampled_from([0.0, 0.08, 1.0]))
def test_a_map_is_what_its_model_says_of_each_cell(numbers: Numbers, share: float) -> None:
    model = SimpleModel(p_hit=0.75, p_miss=0.25, spread=share)
    grid = render(make_grid(numbers), model, 10**6)
    col, row = round(grid.origin[0]), round(grid.origin[1])
    log_odds, observed = np.zeros(grid.shape), np.zeros(grid.shape, np.bool_)
    for (at_row, at_col), (hits, misses) in spread_slowly(numbers, share, 1).items():
        observed[at_row - row, at_col - col] = True
        log_odds[at_row - row, at_col - col] = (hits - misses) * math.log(3)
    assert np.array_equal(grid.observed, observed)
    np.testing.assert_allclose(grid.log_odds, log_odds, rtol=1e-5, atol=1e-5)


SIX_HITS: Numbers = {(0, 0): (3, 0), (0, TILE): (2, 1), (0, 5): (1, 4), (9, 9): (0, 7)}
"""By shares of hits: 1, 2/3, 1/5 and 0"""


@pytest.mark.parametrize(("cut", "agreement"), [(0.1, 6 / 6), (0.32, 5 / 6), (0.7, 3 / 6)])
def test_agreement_is_the_share_of_hits_in_occupied_cells(cut: float, agreement: float) -> None:
    model = CountingModel(strength=1e-6, cut=cut, spread=0.0)
    assert render(make_grid(SIX_HITS), model, 10**6).agreement == pytest.approx(agreement)


def test_agreement_counts_hits_where_they_are_and_not_what_they_say_of_others() -> None:
    """Ten hits beside fifty misses make no wall, though they reach the cell of one hit."""
    numbers: Numbers = {(0, 0): (10, 50), (0, 1): (1, 3)}
    plain = CountingModel(strength=1e-6, spread=0.0)
    assert render(make_grid(numbers), plain, 100).agreement == 0
    # With a tenth of the ten, 2 of 5 observations of the other are hits; the first has 10.1 of 60.1
    spread = replace(plain, spread=0.1)
    assert render(make_grid(numbers), spread, 100).agreement == pytest.approx(1 / 11)


def test_agreement_is_not_known_without_hits() -> None:
    assert render(make_grid({(0, 0): (0, 4)}), SimpleModel(), 100).agreement is None
    grid = make_grid({(0, 0): (9, 1)}, kind=EvidenceKind.LOG_ODDS)
    assert render(grid, QuadraticModel(), 100).agreement is None
    box = CellBox(0, 0, 1, 1)
    assert count_agreeing(grid, np.ones((1, 1), np.bool_), box) == (0, 0)


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_where_two_scans_tell_of_walls_that_cross_agreement_is_low(update: Update) -> None:
    """Three scans agree on a wall at 3 m; a fourth, turned by a wrong pose, is alone."""
    model = CountingModel(spread=0.0)
    engine = GridEngine(GridSpec(update, Lattice(1.0)))
    for _ in range(3):
        engine.add(make_scan((3.5, Kind.HIT)))
    assert render(engine.finish(), model, 100).agreement == 1
    engine.add(make_scan((1.5, Kind.HIT)))
    expected = 3 / 4 if update is not Update.POLYGON else 1.0
    assert render(engine.finish(), model, 100).agreement == expected


def trace_surfaces(rays: Rays, resolution: float = 1.0) -> TileGrid:
    engine = GridEngine(GridSpec(Update.SURFACE, Lattice(resolution)))
    engine.add(rays)
    return engine.finish()


def test_a_lone_beam_of_the_surface_update_counts_a_quarter_of_one_among_others() -> None:
    """Its weight is 2 of 8: as observations 0.25, beside which the prior weighs 0.02."""
    lone = trace_surfaces(make_scan((3.0, Kind.HIT)))
    grid = render(lone, CountingModel(spread=0.0, ceiling=1.0, doubt=0.0), 1000)
    hit, missed = (0.25 + 0.01) / (0.25 + 0.02), 0.01 / (0.25 + 0.02)
    np.testing.assert_allclose(grid.probability, [[missed] * 3 + [hit]], rtol=1e-5)
    simple, third = render(lone, SimpleModel(0.75, 0.25, spread=0.0), 1000), math.log(3) / 4
    np.testing.assert_allclose(simple.log_odds, [[-third] * 3 + [third]], rtol=1e-5)


@pytest.mark.parametrize("model", [CountingModel(), SimpleModel(), CountingModel(spread=0.0)])
@FEW
@given(drive=drives(), factor=st.sampled_from([2, 3, 16]))
def test_a_map_does_not_depend_on_the_unit_of_weights(
    model: SensorModel, drive: Drive, factor: int
) -> None:
    rays, resolution = drive
    evidence = trace_surfaces(rays, resolution)
    assert evidence.unit == find_unit(Update.SURFACE) == 8
    finer = TileGrid(evidence.lattice, evidence.kind, evidence.unit * factor)
    finer.tiles = {key: tile * factor for key, tile in evidence.tiles.items()}
    if not evidence.tiles:
        return
    one, other = (render(each, model, 10**7) for each in (evidence, finer))
    np.testing.assert_allclose(other.log_odds, one.log_odds, rtol=1e-5, atol=1e-6)
    assert np.array_equal(other.observed, one.observed)
    assert other.agreement == one.agreement


def test_the_ratio_of_hits_is_that_of_beams_among_their_neighbours() -> None:
    """On a wall seen by many beams each pair of neighbours weighs the same: 8 a beam inside."""
    rays = make_rays(MIDDLE, aim(-0.01, 0.001, 21), 3.0)
    (tile,) = trace_surfaces(rays).tiles.values()
    layers: list[Float64] = [layer / 8 for layer in tile]
    # 19 beams weigh 2 + 3 + 3, and those at both ends 2 + 3.
    assert layers[0][0, 3] == pytest.approx(19 + 2 * 5 / 8)
    assert layers[1][0, :3].tolist() == pytest.approx([19 + 2 * 5 / 8] * 3)


LOG_ODDS = np.arange(12).reshape(3, 4)
"""Of columns 1 to 4 and rows -1 to 1 of the lattice; each hit adds 1, and nothing was missed"""


def show(framing: Framing, prior: float = 0.5, max_cells: int = 100) -> OccupancyMap:
    model = SimpleModel(1 / (1 + math.exp(-1)), 0.1, prior=prior, spread=0)
    numbers = {(row - 1, col + 1): (int(n), 0) for (row, col), n in np.ndenumerate(LOG_ODDS)}
    options = RenderOptions(None, WriteOptions(), max_cells, framing)
    shown, _ = open_map(hold(make_grid(numbers, 0.05)), model, options).paint_all()
    return shown


@pytest.mark.parametrize(
    ("box", "rows", "cols", "origin"),
    [
        ((0.1, -0.05, 0.25, 0.05), slice(0, 2), slice(1, 4), (0.1, -0.05)),  # edges of cells
        ((0.11, 0.01, 0.12, 0.02), slice(1, 2), slice(1, 2), (0.1, 0.0)),  # within a cell
        ((0.1, 0.0, 0.1 + 1e-9, 1e-9), slice(1, 2), slice(1, 2), (0.1, 0.0)),  # in its corner
        ((0.05, -0.05, 0.25, 0.1), slice(0, 3), slice(0, 4), (0.05, -0.05)),  # all
    ],
)
def test_an_extent_is_the_cells_that_the_box_touches(
    box: Box, rows: slice, cols: slice, origin: tuple[float, float]
) -> None:
    part = show(Framing(extent=box))
    assert part.log_odds == pytest.approx(LOG_ODDS[rows, cols])
    assert np.array_equal(part.observed, LOG_ODDS[rows, cols] > 0)
    assert part.origin == origin


def test_an_extent_is_filled_up_with_unknown_cells() -> None:
    part = show(Framing(extent=(-0.05, 0.0, 0.15, 0.15)), prior=0.2)
    # Columns -1 to 2 of which the map has 1 and 2, rows 0 to 2 of which it has 0 and 1.
    unknown = math.log(0.2 / 0.8)
    hits = np.array([[0, 0, 4, 5], [0, 0, 8, 9], [0] * 4])
    assert part.log_odds == pytest.approx(unknown + hits * (1 - unknown))
    assert part.observed.tolist() == [[False, False, True, True]] * 2 + [[False] * 4]
    assert (part.origin, part.extent) == ((-0.05, 0.0), (-0.05, 0.0, 0.15, 0.15))


@pytest.mark.parametrize(("margin", "cells"), [(0.05, 1), (0.15, 3), (0.11, 3), (0.0, 0)])
def test_a_margin_goes_all_round(margin: float, cells: int) -> None:
    shown = show(Framing(margin=margin))
    assert shown.log_odds == pytest.approx(np.pad(LOG_ODDS, cells))
    assert np.array_equal(shown.observed, np.pad(LOG_ODDS > 0, cells))
    assert shown.origin == pytest.approx((0.05 - 0.05 * cells, -0.05 - 0.05 * cells))


def test_how_well_hits_agree_is_told_of_the_cells_that_are_shown() -> None:
    part, whole, none = (
        show(Framing(extent=extent))
        for extent in ((0.1, -0.05, 0.15, 0.0), None, (0.05, -0.05, 0.1, 0.0))
    )
    assert (part.agreement, whole.agreement) == (1, 1)
    assert none.agreement is None


def test_an_extent_beside_the_map_or_of_too_many_cells_is_refused() -> None:
    with pytest.raises(MapError, match=r"in `extent`; the map's own box is 0.05, -0.05, 0.25, 0.1"):
        show(Framing(extent=(1.0, 0.0, 2.0, 1.0)))
    with pytest.raises(MapError, match="10 x 9 cells, more than `max_cells=89`"):
        show(Framing(margin=0.15), max_cells=89)
    assert show(Framing(margin=0.15), max_cells=90).shape == (9, 10)


@pytest.mark.parametrize(
    ("extent", "margin", "found"),
    [
        ((0, 0, 0, 1), 0.0, "is not a box; write x_min"),
        ((0, 1, 1, 0), 0.0, "is not a box; write x_min"),
        ((0, math.nan, 1, 1), 0.0, "is not a box; write x_min"),
        ((math.nan, 0, 1, 1), 0.0, "is not a box; write x_min"),
        ((0, 0, 1.01e8, 1), 0.0, "too far; give numbers up to"),
        *((None, margin, "give 0 to 1e") for margin in (-0.1, 1.01e8, math.nan, math.inf)),
        ((0, 0, 1, 1), 1.0, "leave out `margin` or `extent`"),
    ],
)
def test_what_frames_no_map_is_refused(extent: Box | None, margin: float, found: str) -> None:
    with pytest.raises(UsageError, match=found):
        Framing(extent=extent, margin=margin)


def test_a_frame_may_go_twice_around_the_earth() -> None:
    Framing(margin=1e8)
    Framing(extent=(-1e8, 0.0, 1.0, 1e8))
