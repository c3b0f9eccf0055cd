"""The quadratic inverse sensor model, with numbers worked out by hand: p = (1 + O - V) / 2."""

import numpy as np

from occmap.sensor.models import QuadraticModel

MODEL = QuadraticModel(p_min=1e-9)


def test_a_cell_is_free_most_surely_at_the_sensor_and_not_at_all_where_the_hit_begins() -> None:
    """At d of (r - epsilon) = 4: V = 1 - (d / 4)^2."""
    d = np.array([1.0, 2.0, 3.0, 4.0])
    v = np.array([15 / 16, 3 / 4, 7 / 16, 0])
    np.testing.assert_allclose(MODEL.free((d / 4) ** 2), (1 - v) / 2)


def test_a_cell_is_occupied_most_surely_at_the_range() -> None:
    """Range 5, epsilon 2: O = 1 - ((d - 5) / 2)^2 from 3 to 7."""
    d = np.array([3.0, 4.0, 5.5, 7.0])
    o = np.array([0, 3 / 4, 15 / 16, 0])
    np.testing.assert_allclose(MODEL.hit(np.abs(d - 5) / 2), (1 + o) / 2)
