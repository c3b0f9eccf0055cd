"""Models that look at distances: the engine against the rule, written the slow way."""

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.grid.engine import WINDOW_CELLS, join_viewpoints
from occmap.grid.lattice import Lattice
from occmap.grid.tiles import LOG_ODDS_UNIT
from occmap.grid.windows import TABLE_STEPS, Observation, tabulate
from occmap.sensor.models import QuadraticModel
from occmap.types import Rays, Update
from tests.grid import radial_reference
from tests.grid.radial_reference import Observed, Quadratic
from tests.grid.scans import FEW, Drive, Evidence, drives, observe

Trace = Callable[[Rays, float, Quadratic], Observed]

TRACES: dict[Update, Trace] = {
    Update.BEAM: radial_reference.trace_radial_beams,
    Update.POLYGON: radial_reference.trace_radial_polygons,
}


def tolerance(model: Quadratic) -> float:
    """How far one observation's log-odds may be off.

    A table entry is the value at the middle of its step, so its argument is off by up to half a
    step, and it is rounded to half a unit. The log-odds change fastest where p leaves its limit or,
    for a hit, where O ends: d/du log(p / (1 - p)) is 1 / (2 p (1 - p)) of p = u / 2, and
    d/dw is w / (p (1 - p)) of p = 1 - w^2 / 2.
    """
    p_min = model.p_min
    free = 1 / (2 * p_min * (1 - p_min))
    hit = max(math.sqrt(2 * p_min) / (p_min * (1 - p_min)), 4.0)
    return max(free, hit) / (2 * TABLE_STEPS) + LOG_ODDS_UNIT / 2 + 1e-9


def make_observation(update: Update, resolution: float, model: Quadratic) -> Observation:
    quadratic = QuadraticModel(epsilon=model.depth, p_min=model.p_min)
    tables = tabulate(quadratic.free, quadratic.hit, quadratic.depth(resolution))
    return Observation(update, Lattice(resolution), radial=tables)


def check(evidence: Evidence, expected: Observed, model: Quadratic) -> None:
    """The same observations of every cell that is not doubtful, and log-odds within tolerance."""
    counts = {cell: len(seen) for cell, seen in expected.probabilities.items()}
    sums, observations = evidence
    for cell in (counts.keys() | observations.keys()) - expected.doubtful:
        count = counts.get(cell, 0)
        assert observations[cell] == count, cell
        error = sums[cell] * LOG_ODDS_UNIT - expected.log_odds(cell) if count else 0.0
        assert abs(error) <= count * tolerance(model), cell


@pytest.mark.parametrize("update", list(Update))
@FEW
@given(
    drive=drives(),
    cells_deep=st.sampled_from([0.5, 1.0, 3.3]),
    p_min=st.sampled_from([0.1, 0.4]),
    window_cells=st.sampled_from([400, WINDOW_CELLS]),
)
def test_random_scans_follow_the_rule(
    update: Update, drive: Drive, cells_deep: float, p_min: float, window_cells: int
) -> None:
    rays, resolution = drive
    model = Quadratic(cells_deep * resolution, p_min)
    seen = join_viewpoints(rays) if update is Update.POLYGON else rays
    expected = TRACES[update](seen, resolution, model)
    what = make_observation(update, resolution, model)
    check(observe(what, [rays], window_cells), expected, model)
