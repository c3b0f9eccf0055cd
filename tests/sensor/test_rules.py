"""The rules of the quadratic inverse sensor model, with numbers worked out by hand."""

import numpy as np

from occmap.sensor.models import occupancy, probability, visibility


def test_visibility_falls_from_the_sensor_to_where_the_hit_begins() -> None:
    """Range 5, epsilon 1: V = 1 - (d / 4)^2 up to 4, and nothing from there on."""
    d = np.array([0.0, 1.0, 2.0, 3.0, 3.9999, 4.0, 5.0])
    expected = [1, 15 / 16, 3 / 4, 7 / 16, 0, 0, 0]
    np.testing.assert_allclose(visibility(d, 5.0, 1.0), expected, atol=1e-4)


def test_visibility_is_nowhere_where_the_hit_reaches_the_sensor() -> None:
    np.testing.assert_array_equal(visibility(np.array([0.0, 0.1]), 0.5, 1.0), [0, 0])


def test_occupancy_is_highest_at_the_range() -> None:
    """Range 5, epsilon 2: O = 1 - ((d - 5) / 2)^2 from 3 to 7."""
    d = np.array([2.9, 3.0, 4.0, 5.0, 5.5, 7.0, 7.1])
    expected = [0, 0, 3 / 4, 1, 15 / 16, 0, 0]
    np.testing.assert_allclose(occupancy(d, 5.0, 2.0), expected, atol=1e-12)


def test_probability_is_even_where_nothing_is_known() -> None:
    o, v = np.array([0.0, 1.0, 0.0, 0.5]), np.array([0.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(probability(o, v), [0.5, 1, 0, 0.75])
