"""Models that look at distances: the engine against the rule, written the slow way."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.grid import Lattice
from occmap.grid.kernels import TABLE_STEPS
from occmap.grid.tiles import LOG_ODDS_UNIT, WINDOW_CELLS, GridSpec, tabulate
from occmap.sensor import ReturnOptions, interpret
from occmap.sensor.models import QuadraticModel
from occmap.types import BEAM_UPDATES, Rays, Update
from tests.bench.workloads import Sensor, make_office
from tests.grid import scans
from tests.grid.radial_reference import Observed, Quadratic, trace_radial
from tests.grid.reference import Cell


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


def make_spec(update: Update, resolution: float, model: Quadratic) -> GridSpec:
    quadratic = QuadraticModel(epsilon=model.depth, p_min=model.p_min)
    tables = tabulate(quadratic.free, quadratic.hit, quadratic.depth(resolution))
    return GridSpec(update, Lattice(resolution), radial=tables)


def check(evidence: scans.Evidence, expected: Observed, model: Quadratic) -> None:
    """The same observations of every cell that is not doubtful, and log-odds within tolerance."""
    counts = {cell: len(seen) for cell, seen in expected.probabilities.items()}
    sums, observations = evidence
    for cell in (counts.keys() | observations.keys()) - expected.doubtful:
        count = counts.get(cell, 0)
        assert observations[cell] == count, cell
        error = sums[cell] * LOG_ODDS_UNIT - expected.log_odds(cell) if count else 0.0
        assert abs(error) <= count * tolerance(model), cell


@pytest.mark.parametrize("update", BEAM_UPDATES)
@pytest.mark.parametrize("scene", [scans.drives, scans.upright_drives])
@scans.FEW
@given(
    data=st.data(),
    cells_deep=st.sampled_from([0.5, 1.0, 3.3]),
    p_min=st.sampled_from([0.1, 0.4]),
    window_cells=st.sampled_from([400, WINDOW_CELLS]),
)
def test_every_update_follows_its_rule(
    update: Update,
    scene: Callable[[], st.SearchStrategy[scans.Drive]],
    data: st.DataObject,
    cells_deep: float,
    p_min: float,
    window_cells: int,
) -> None:
    """Also with beams straight up and down."""
    rays, resolution = data.draw(scene())
    model = Quadratic(cells_deep * resolution, p_min)
    evidence = scans.observe(make_spec(update, resolution, model), [rays], window_cells)
    check(evidence, trace_radial(update, rays, resolution, model), model)


def look_around(distance: list[float], degrees: float) -> Rays:
    """One scan from the middle of cell (0, 0) of cells of a metre, its first beam along x."""
    beams = len(distance)
    directions = scans.aim(0.0, math.radians(degrees), beams)
    return scans.make_rays(scans.MIDDLE, directions, distance, full_circle=beams * degrees >= 360)


@pytest.mark.parametrize(
    ("update", "beams"),
    [(Update.BEAM, 1), (Update.SURFACE, 1), (Update.POLYGON, 1), (Update.POLYGON, 36)],
)
def test_the_cells_of_one_beam_worked_out_by_hand(update: Update, beams: int) -> None:
    """Range 4, depth 1: free before 3 with p = (d / 3)^2 / 2, the hit from 3 to 5."""
    model = Quadratic(depth=1.0, p_min=0.1)
    evidence = scans.observe(make_spec(update, 1.0, model), [look_around([4.0] * beams, 10.0)])
    ahead = [(0, col) for col in range(6)]
    weight = 2 if update is Update.SURFACE else 1
    assert [evidence.second[cell] for cell in ahead] == [weight] * 6
    assert beams > 1 or evidence.second.keys() == set(ahead)
    p = np.array([0.1, 0.1, 2 / 9, 0.5, 0.9, 0.5])
    log_odds = np.array([evidence.first[cell] for cell in ahead]) * LOG_ODDS_UNIT / weight
    np.testing.assert_allclose(log_odds, np.log(p / (1 - p)), atol=tolerance(model))


def count_by_polygon(rays: Rays) -> Counter[Cell]:
    """How many scans observed each cell."""
    return scans.observe(make_spec(Update.POLYGON, 1.0, Quadratic(0.5, 0.1)), [rays]).second


def test_a_full_circle_leaves_no_cell_out_where_it_closes() -> None:
    """A cell half-way between the last beam and the first belongs to one of them."""
    rng = np.random.default_rng(7)
    turns, beams, near = 2000, 48, 30
    noise = math.pi / beams + rng.normal(0, 1e-4, turns)
    headings = rng.integers(0, 4, turns) * math.pi / 2 + noise
    directions = np.stack([scans.aim(heading, math.tau / beams, beams) for heading in headings])
    reach = rng.uniform(near + 1, near + 4, (turns, beams))
    rays = scans.make_rays(scans.MIDDLE, directions, reach, full_circle=True)
    observed = count_by_polygon(rays)
    disc = [(row, col) for row in range(-near, near) for col in range(-near, near)]
    assert {observed[cell] for cell in disc if math.hypot(*cell) < near} == {turns}


def test_no_model_is_so_sure_that_its_sums_overflow() -> None:
    """logit(2^-53) is -36.7; half a million such observations of one cell add up to as many."""
    model = QuadraticModel(epsilon=1.0, p_min=1e-9)
    spec = GridSpec(Update.BEAM, Lattice(1.0), radial=tabulate(model.free, model.hit, 1.0))
    beams = 1 << 19
    rays = look_around([30.0] * beams, 0.0)
    evidence = scans.observe(spec, [rays])
    assert evidence.second[0, 0] == beams
    # The sensor's own cell is looked up in the middle of the first of the table's steps.
    p = 1 / (4 * TABLE_STEPS)
    assert evidence.first[0, 0] * LOG_ODDS_UNIT / beams == pytest.approx(math.log(p / (1 - p)))
    tables = tabulate(lambda u: 0 * u, lambda w: 1 + 0 * w, 1.0)
    assert tables.largest * LOG_ODDS_UNIT == pytest.approx(53 * math.log(2), rel=1e-5)


@pytest.mark.parametrize(
    ("p", "bits"),
    [
        (2.0**-53, 20),  # 53 ln 2 x 65536 has 22 bits: with twice 20, 62 of 63
        (0.1, 22),  # ln 9 x 65536 = 143996 has 18 bits: with twice 22, 62
        (0.9, 22),
        (0.4, 24),  # ln 1.5 x 65536 = 26573 has 15 bits: with twice 24, 63
        (0.5, 31),  # 0 has none
    ],
)
def test_a_cell_has_room_for_more_observations_of_a_model_that_is_less_sure(
    p: float, bits: int
) -> None:
    tables = tabulate(lambda u: p + 0 * u, lambda w: p + 0 * w, 1.0)
    assert tables.bits == bits
    most = (1 << bits) - 1
    assert abs(int(tables.entries[0]) * most) < 2**63


def test_windows_change_nothing_in_an_office_of_many_doors() -> None:
    """A span may bridge a gap between two others: its cells are observed once all the same."""
    office = make_office("office", Sensor.spanning(360, 360, 30.0), 200)
    rays = [interpret(posed, ReturnOptions())[0] for posed in office.pose_scans()]
    pair = [rays[0].take(slice(3, 4)), rays[0].take(slice(19, 20))]
    spec = make_spec(Update.POLYGON, 0.05, Quadratic(0.025, 0.4))
    spec = replace(spec, hit_offset=0.5)
    whole = scans.observe(spec, pair)
    assert scans.observe(spec, pair, window_cells=4096) == whole
    assert max(whole.second.values()) <= len(pair)
