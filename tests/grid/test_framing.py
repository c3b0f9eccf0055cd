"""What a map covers: a box or a margin, to whole cells; beyond what was observed it is unknown."""

import math

import numpy as np
import pytest

from occmap.cells import Box, OccupancyMap
from occmap.errors import MapError, UsageError
from occmap.evidence import render_lasting
from occmap.grid.rendering import Framing
from occmap.sensor.models import SimpleModel
from occmap.store.painting import RenderOptions
from occmap.writers import WriteOptions
from tests.grid.scans import make_grid

LOG_ODDS = np.arange(12).reshape(3, 4)
"""Of columns 1 to 4 and rows -1 to 1 of the lattice; each hit adds 1, and nothing was missed"""


def show(framing: Framing, prior: float = 0.5, max_cells: int = 100) -> OccupancyMap:
    model = SimpleModel(1 / (1 + math.exp(-1)), 0.1, prior=prior, spread=0)
    numbers = {(row - 1, col + 1): (int(n), 0) for (row, col), n in np.ndenumerate(LOG_ODDS)}
    options = RenderOptions(None, WriteOptions(), max_cells, framing)
    shown, _ = render_lasting(make_grid(numbers, 0.05), (), model, options)
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


def test_an_extent_beside_the_map_is_refused() -> None:
    with pytest.raises(MapError, match=r"in `extent`; the map's own box is 0.05, -0.05, 0.25, 0.1"):
        show(Framing(extent=(1.0, 0.0, 2.0, 1.0)))


def test_a_frame_of_too_many_cells_is_refused() -> None:
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
