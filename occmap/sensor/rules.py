"""The definition of the quadratic inverse sensor model: what a beam says about a cell.

p = (1 + O - V) / 2, where V falls from 1 at the sensor to 0 where the hit begins, and O rises to 1
at the measured range r and falls again. The depth of a hit is epsilon to either side of r. Where
both are 0 a beam says nothing. `QuadraticModel` tabulates these functions for the kernels.
"""

import numpy as np

from occmap.types import Float64


def visibility(d: Float64, r: float, epsilon: float) -> Float64:
    """V: how surely a cell at distance d (m) is seen through; 0 from r - epsilon on."""
    before = (d >= 0) & (d < r - epsilon)
    return np.where(before, 1 - (d / np.where(before, r - epsilon, 1.0)) ** 2, 0.0)


def occupancy(d: Float64, r: float, epsilon: float) -> Float64:
    """O: how surely a cell at distance d (m) holds what a HIT beam met; 0 beyond r +- epsilon."""
    return np.where(np.abs(d - r) <= epsilon, 1 - ((d - r) / epsilon) ** 2, 0.0)


def probability(o: Float64 | float, v: Float64 | float) -> Float64:
    """p: the probability that the cell is occupied."""
    return np.asarray((1 + o - v) / 2)
