"""Inverse sensor models against their formulas, with numbers worked out by hand."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from occmap.cells import OccupancyMap
from occmap.choices import list_options
from occmap.errors import UsageError
from occmap.sensor import models
from occmap.sensor.models import CountingModel, CountModel, QuadraticModel, SimpleModel, parse_model
from occmap.types import Float64

LN2 = math.log(2)

SHARES = partial(CountingModel, ceiling=1.0, doubt=0.0)


def counts(*values: float) -> Float64:
    return np.array(values, np.float64)


def calibrate(share: float) -> float:
    """The ceiling is 0.8, and the doubt 0.02."""
    return 0.8 * share * 1.02 * share / (share + 0.02)


CHANCES: dict[str, tuple[CountModel, list[int], list[int], list[float]]] = {
    # Odds of 3 to 1 for each hit, and 1 to 3 for each miss
    "simple weighs each": (
        SimpleModel(0.75, 0.25), [0, 1, 0, 2, 3], [0, 0, 1, 5, 3], [0.5, 0.75, 0.25, 1 / 28, 0.5]
    ),
    # l = l0 + sum(logit(p) - l0): from 1 to 9, a hit that says 3 to 1 is a factor of 27
    "simple counts from the prior": (
        SimpleModel(0.75, 0.05, prior=0.1), [0, 1, 2, 0], [0, 0, 0, 1], [0.1, 0.75, 81 / 82, 0.05]
    ),
    # One observation says what it says, whatever the prior
    "low prior": (SimpleModel(0.9, 0.3, prior=0.3), [1, 0], [0, 1], [0.9, 0.3]),
    "high prior": (SimpleModel(0.9, 0.3, prior=0.7), [1, 0], [0, 1], [0.9, 0.3]),
    # Beta(1, 1): (hits + 1) / (hits + misses + 2)
    "counting imagines two": (
        SHARES(strength=2), [0, 1, 0, 3, 1], [0, 0, 1, 1, 7], [1 / 2, 2 / 3, 1 / 3, 4 / 6, 2 / 10]
    ),
    # Beta(0.4, 1.6): nothing seen is 0.2
    "as the prior says": (SHARES(prior=0.2, strength=2), [0, 1], [0, 0], [0.2, 1.4 / 3]),
    # Beta(0.01, 0.01) takes observations at their word.
    "with little prior": (
        SHARES(), [1, 0, 1], [0, 1, 2], [1.01 / 1.02, 0.01 / 1.02, 1.01 / 3.02]
    ),
    # With weight 2.5, two hits and five misses are one to one; the prior weighs as before.
    "a hit weighs more": (
        SHARES(strength=2, hit_weight=2.5), [2, 0, 4], [5, 3, 0], [1 / 2, 1 / 5, 11 / 12]
    ),
    # Beta(0.8, 3.2) with hits of weight 3: (3 * 2 + 0.8) / (1 + 3.2)
    "with another prior": (SHARES(prior=0.2, strength=4, hit_weight=3), [2], [1], [6.8 / 11]),
    # A share of hits is too sure of the next beam: one alone, one among three, a miss alone
    "calibrated": (
        CountingModel(), [1, 1, 0], [0, 2, 1],
        [calibrate(1.01 / 1.02), calibrate(1.01 / 3.02), calibrate(0.01 / 1.02)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CHANCES)
def test_counts_of_hits_and_misses_give_the_chances_of_the_formula(case: str) -> None:
    model, hits, misses, chances = CHANCES[case]
    log_odds = model.log_odds(counts(*hits), counts(*misses))
    np.testing.assert_allclose(1 / (1 + np.exp(-log_odds)), chances, rtol=1e-12)


@pytest.mark.parametrize(("ceiling", "doubt"), [(0.8, 0.02), (1.0, 0.5), (0.2, 0.0)])
def test_calibration_changes_no_class(ceiling: float, doubt: float) -> None:
    """Not even at the cut: 8 of 25 are 0.32, and with what the prior weighs just above it."""
    hits, misses = (each.ravel() for each in np.indices((80, 80)).astype(float))
    classes = []
    for model in (SHARES(), CountingModel(ceiling=ceiling, doubt=doubt)):
        cut = models.find_decision(model).occupied_above
        bound = np.float32(math.log(cut / (1 - cut)))
        classes.append(np.sign(np.float32(model.log_odds(hits, misses)) - bound))
    assert {*classes[0].tolist()} == {-1, 1}
    np.testing.assert_array_equal(*classes)


def test_a_calibrated_chance_stays_below_one() -> None:
    model = CountingModel(ceiling=1.0, doubt=1e-3)
    log_odds = model.log_odds(counts(1e15), counts(0))
    assert 30 < log_odds[0] < 40


def test_quadratic_falls_off_before_the_hit() -> None:
    """p = (1 - V) / 2 with V = 1 - u: half of u, but never surer than p_min."""
    free = QuadraticModel(p_min=0.1).free(np.array([0.0, 0.1, 0.2, 0.5, 0.9]))
    np.testing.assert_allclose(free, [0.1, 0.1, 0.1, 0.25, 0.45], rtol=1e-12)


def test_quadratic_falls_off_about_the_range() -> None:
    """p = (1 + O) / 2 with O = 1 - w^2, but never surer than 1 - p_min."""
    hit = QuadraticModel(p_min=0.1).hit(np.array([0.0, 0.4, 0.5, 0.8, 1.0]))
    np.testing.assert_allclose(hit, [0.9, 0.9, 0.875, 0.68, 0.5], rtol=1e-12)


def test_a_hit_is_as_deep_as_was_asked_or_as_the_cells_allow() -> None:
    assert QuadraticModel(epsilon=0.3).depth(0.05) == 0.3
    assert 0 < QuadraticModel().depth(0.05) <= 0.05


@pytest.mark.parametrize(
    ("name", "kind"),
    [("simple", CountModel), ("counting", CountModel), ("quadratic", models.RadialModel)],
)
def test_models_are_found_by_name_and_described_as_they_are_written(name: str, kind: type) -> None:
    model = models.make_model(name, {"prior": 0.4})
    assert isinstance(model, kind)
    assert model.prior == 0.4
    assert models.describe_model(model).startswith(f"{name}:")
    assert parse_model(models.describe_model(model)) == model


def test_bounds_are_described_where_they_bound_anything() -> None:
    usual = "counting:prior=0.5,strength=0.02,hit_weight=1.0,cut=0.32,spread=0.08"
    usual += ",ceiling=0.8,doubt=0.02"
    assert models.describe_model(CountingModel()) == usual
    usual = "simple:p_hit=0.7,p_miss=0.4,prior=0.5,cut=0.5,spread=0.08"
    assert models.describe_model(SimpleModel()) == usual
    model = QuadraticModel(clamp_max=0.97)
    assert (
        models.describe_model(model)
        == "quadratic:epsilon=0.0,p_min=0.4,prior=0.5,cut=0.5,clamp_max=0.97"
    )
    assert parse_model(models.describe_model(model)) == model


def test_people_are_told_only_the_parameters_that_are_not_usual() -> None:
    assert models.shorten_model(CountingModel()) == "counting"
    model = SimpleModel(p_hit=0.8, clamp_max=0.97)
    assert models.shorten_model(model) == "simple:p_hit=0.8,clamp_max=0.97"


def test_parameters_are_read_from_text() -> None:
    assert parse_model("simple") == SimpleModel()
    assert parse_model("simple:") == SimpleModel()
    assert parse_model(" simple : p_hit = 0.8 , p_miss=0.3") == SimpleModel(0.8, 0.3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("simpel", ["'simpel'", "did you mean 'simple'?"]),
        ("elephant", ["'elephant'", "counting", "quadratic", "simple", "occmap models"]),
        ("", ["no model is called ''"]),
        ("simple:p_hit=often", ["'p_hit=often'", "NAME:KEY=NUMBER"]),
        ("simple:p_hit", ["'p_hit'", "NAME:KEY=NUMBER"]),
        ("simple:epsilon=1", ["simple has no parameter 'epsilon'", "p_hit, p_miss, prior"]),
        ("simple:name=1", ["no parameter 'name'"]),
        ("simple:p_hit=1", ["`p_hit=1.0` is not possible; give 1e-09 to 0.999999"]),
        ("simple:prior=0.39", ["prior 0.39 does not lie between p_miss 0.4 and p_hit 0.7"]),
        ("simple:prior=0.71", ["prior 0.71 does not lie between p_miss 0.4 and p_hit 0.7"]),
        ("quadratic:prior=0.3", ["prior 0.3 does not lie between p_min 0.4 and 1 - p_min 0.6"]),
        ("simple:p_hit=0.4,p_miss=0.4", ["p_miss 0.4 is not below p_hit 0.4"]),
        ("counting:strength=0", ["`strength=0.0` is not possible"]),
        ("simple:spread=-0.01", ["`spread=-0.01` is not possible; give 0 to 1"]),
        ("quadratic:spread=0.1", ["quadratic has no parameter 'spread'"]),
        ("counting:clamp_min=0.5", ["`clamp_min=0.5` is not possible; give 0 to 0.499"]),
        ("simple:clamp_max=0.5", ["`clamp_max=0.5` is not possible; give 0.501 to 1"]),
        ("quadratic:p_min=0.5", ["`p_min=0.5` is not possible; give 1e-09 to 0.499"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line(text: str, words: list[str]) -> None:
    with pytest.raises(UsageError) as caught:
        parse_model(text)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("kind", [SimpleModel, CountingModel, QuadraticModel])
def test_no_parameter_is_beyond_its_bounds(kind: Any) -> None:
    for name, known in list_options(kind).items():
        for value in (*np.nextafter(known.bounds, (-math.inf, math.inf)), math.inf, math.nan):
            with pytest.raises(UsageError, match=f"`{name}=.*` is not possible; give "):
                parse_model(f"{kind.name}:{name}={value}")


def test_an_installed_model_that_does_not_load_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("occmap.sensor.models.load_plugin", lambda *_: None)
    with pytest.raises(UsageError, match="the model simple does not load; `occmap models` says"):
        models.make_model("simple", {})


def test_the_probability_of_extreme_log_odds_is_certain_and_warns_of_nothing() -> None:
    log_odds = np.array([[-3e38, -1000, -LN2, 0, LN2, 1000, 3e38]], np.float32)
    grid = OccupancyMap(log_odds, np.ones((1, 7), np.bool_), 1.0, (0.0, 0.0))
    np.testing.assert_allclose(grid.probability[0], [0, 0, 1 / 3, 0.5, 2 / 3, 1, 1], rtol=1e-6)
    assert grid.probability.dtype == np.float32


def test_a_robot_that_stands_still_for_hours_makes_no_model_overflow() -> None:
    """Ten hours of 40 scans a second, 1081 beams each, all through one cell."""
    beams = 10 * 3600 * 40 * 1081
    for model in (SimpleModel(), SHARES(), SHARES(strength=1e-6, hit_weight=1e6)):
        hit, missed = (
            float(model.log_odds(counts(a), counts(b))[0]) for a, b in ((beams, 0), (0, beams))
        )
        assert missed < -15 < 15 < hit
        assert abs(hit) < np.finfo(np.float32).max
