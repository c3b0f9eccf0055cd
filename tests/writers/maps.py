"""Small maps for the tests of the writers."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from occmap.cells import Evidence, OccupancyMap


def map_of(probability: ArrayLike, origin: tuple[float, float] = (0.0, 0.0)) -> OccupancyMap:
    """Build a map, row 0 lowest; NaN is a cell that nothing observed."""
    p = np.asarray(probability, np.float64)
    observed = ~np.isnan(p)
    known = np.where(observed, p, 0.5)
    log_odds = np.log(known / (1 - known)).astype(np.float32)
    return OccupancyMap(log_odds, observed, 0.05, origin)


def map_of_art(art: str) -> OccupancyMap:
    """Build a map from a drawing, top line = highest y: # occupied, . free, ? unknown, - even."""
    letters = {"#": 0.97, ".": 0.03, "?": np.nan, "-": 0.5}
    rows = [[letters[letter] for letter in line.strip()] for line in art.split()]
    return map_of(rows[::-1])


def map_of_places(
    shape: tuple[int, int], origin: tuple[float, float], *drawn: tuple[Any, float]
) -> OccupancyMap:
    """Build a map of cells of 0.1 m by its log-odds at some places; nothing saw the others."""
    values, observed = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    for place, value in drawn:
        values[place], observed[place] = value, True
    return OccupancyMap(values, observed, 0.1, origin)


def nothing_kept() -> Evidence:
    """Evidence that nobody may ask for."""
    raise AssertionError("nobody asked for evidence")
