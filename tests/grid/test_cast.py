"""Casting beams through a map: small scenes by hand, and random ones against all crossings."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.grid.kernels.cast import BINS, CERTAIN, FOLLOWED, UNIFORM, Chart, cast_beam, cast_beams
from occmap.types import Float32, Float64, Kind, Rays
from tests.grid.scans import FEW, make_rays

UNKNOWN_COST = math.log(2)


def draw(probability: Float32, resolution: float = 1.0, cut: float = 0.5) -> Chart:
    cost = np.asarray(-np.log(np.maximum(1 - probability, CERTAIN)), np.float32)
    bins, occupied = np.zeros(probability.shape, np.uint8), probability > np.float32(cut)
    return Chart(occupied, probability, cost, bins, (-1.0, -1.0), resolution)


class Cast(NamedTuple):
    found: int
    stopped: float
    free: int
    cost: float
    end: float


def cast(
    probability: Float32, x: float, y: float, angle: float, reach: float, cut: float = 0.5
) -> Cast:
    """Of a beam through a map that calls cells occupied above a cut."""
    along, tally = (math.cos(angle), math.sin(angle)), np.zeros((BINS + 1, 3))
    chart = draw(probability, cut=cut)
    return Cast(*cast_beam(chart, (x, y), along, reach, True, tally))


def cast_slowly(probability: Float32, x: float, y: float, angle: float, reach: float) -> Cast:
    """Cut the beam at every lattice line that it can meet; each piece lies in one cell."""
    along_x, along_y = math.cos(angle), math.sin(angle)
    far = reach + 4
    span = range(-200, 201)
    cuts = [(line - start) / along for start, along in ((x, along_x), (y, along_y))
            if along for line in span]  # fmt: skip
    cuts = sorted({0.0, far, *(cut for cut in cuts if 0 < cut < far)})
    first = None
    stopped, survived, free, cost, end = 0.0, 1.0, 0, 0.0, 0.5
    for entry, leave in pairwise(cuts):
        middle = (entry + leave) / 2
        col, row = math.floor(x + middle * along_x), math.floor(y + middle * along_y)
        inside = 0 <= row < probability.shape[0] and 0 <= col < probability.shape[1]
        p = float(probability[row, col]) if inside else 0.5
        if p > 0.5 and first is None:
            first = middle
        if abs(middle - reach) <= 2:
            stopped += survived * p
        survived *= 1 - p
        if leave <= reach:
            free += 1
            cost -= math.log(max(1 - p, CERTAIN))
        elif entry <= reach:
            end = p
    return Cast(int(first is not None and abs(first - reach) <= 2), stopped, free, cost, end)


@FEW
@given(
    seed=st.integers(0, 2**32),
    spot=st.tuples(st.integers(-90, 300), st.integers(-90, 200)),
    angle=st.floats(-7, 7),
    reach=st.floats(0.001, 40),
)
def test_a_cast_is_what_all_crossings_say(
    seed: int, spot: tuple[int, int], angle: float, reach: float
) -> None:
    x, y = (tenths / 10 + 0.037 for tenths in spot)  # never on a line, where rounding decides
    rng = np.random.default_rng(seed)
    probability = (rng.random((13, 21)) ** 6).astype(np.float32)
    mine, slow = (each(probability, x, y, angle, reach) for each in (cast, cast_slowly))
    assert mine == pytest.approx(slow, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("reach", "found"), [(3.4, 0), (3.6, 1), (5.5, 1), (7.4, 1), (7.6, 0), (9.0, 0)]
)
@pytest.mark.parametrize("angle", [0, math.pi / 2, math.pi, -math.pi / 2])
def test_the_first_occupied_cell_is_found_to_two_cells(
    reach: float, found: int, angle: float
) -> None:
    probability = np.full((21, 21), 0.01, np.float32)
    probability[10, (4, 16)] = 0.9  # from 5.5 to 6.5 away ...
    probability[(4, 16), 10] = 0.9
    probability[8, 10] = probability[10, 8] = 0.5  # ... and what is undecided stops nothing
    assert cast(probability, 10.5, 10.5, angle, reach + 0.5).found == found


@pytest.mark.parametrize(("cut", "found"), [(0.5, 0), (0.32, 1)])
def test_what_the_map_calls_occupied_is_found_however_probable(cut: float, found: int) -> None:
    """A wall at 0.4, from 7 to 8."""
    probability = np.array([[0.0, 0, 0, 0, 0, 0, 0, 0.4, 0, 0]], np.float32)
    beam = cast(probability, 0.0, 0.5, 0.0, 7.5, cut)
    assert beam.found == found
    assert beam.stopped == pytest.approx(0.4)  # the likelihood asks only how probable


@pytest.mark.parametrize("cells", [FOLLOWED - 9, FOLLOWED + 1, 10**9])
def test_beyond_the_map_all_is_unknown_and_costs_no_time(cells: int) -> None:
    probability = np.full((1, 4), 0.01, np.float32)
    beam = cast(probability, 0.5, 0.5, 0.0, cells + 3.75)
    assert (beam.found, beam.free, beam.end) == (0, cells + 4, 0.5)
    assert beam.cost == pytest.approx(cells * UNKNOWN_COST - 4 * math.log(0.99), rel=1e-6)
    assert beam.stopped < 1e-12


def total(rays: Rays, probability: Float32, resolution: float = 1.0) -> Float64:
    totals = np.zeros((len(rays.kind), 6))
    cast_beams(rays, draw(probability, resolution), totals, np.zeros((BINS + 1, 3)))
    by_kind: Float64 = totals.sum(axis=0)
    return by_kind


def look_along_x(kinds: list[Kind], tilt: float = 1.0) -> Rays:
    """All from (0, 0.25); where tilted, that much longer than what they cross."""
    return make_rays((0, 0.25), (1 / tilt, 0), 1.8 * tilt, kinds)


@pytest.mark.parametrize("tilt", [1.0, 1.25])
def test_totals_are_sums_over_beams_in_metres_and_in_the_plane(tilt: float) -> None:
    probability = np.full((8, 12), 0.01, np.float32)
    probability[:, 5] = 0.8  # x from 1.5 to 2.0
    rays = look_along_x([Kind.HIT, Kind.SKIP, Kind.FREE, Kind.HIT], tilt)
    beams, near, likelihood, occupied, free, cost = total(rays, probability, 0.5)
    stopped = 0.99**2 * (0.01 + 0.99 * (0.8 + 0.2 * (0.01 + 0.99 * 0.01)))
    assert (beams, near, free) == (2, 2, 3 * 3 + 1)
    assert likelihood == pytest.approx(2 * math.log(0.95 * stopped + UNIFORM**2), rel=1e-4)
    assert occupied == pytest.approx(-2 * math.log(0.8), rel=1e-5)
    assert cost == pytest.approx(-9 * math.log(0.99) - math.log(0.2), rel=1e-4)


def test_a_beam_straight_up_scores_nothing() -> None:
    rays = look_along_x([Kind.HIT])
    rays.turn[...] = 0
    assert not total(rays, np.full((4, 4), 0.9, np.float32)).any()


def test_no_cell_costs_more_than_certain() -> None:
    probability = np.zeros((8, 12), np.float32)
    totals = total(look_along_x([Kind.HIT, Kind.FREE]), probability)
    assert totals[3] == pytest.approx(-math.log(CERTAIN))
    assert totals[2] == pytest.approx(math.log(UNIFORM**2))
