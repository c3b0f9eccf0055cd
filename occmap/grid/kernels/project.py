"""Beam ends from metres to lattice units: the one rounding of a coordinate."""

import numpy as np

from occmap.grid.kernels.jit import kernel
from occmap.types import Float32, Float64, Int64, UInt8


@kernel
def round_to_units(metres: float, units_per_metre: float) -> int:
    """Round a coordinate to lattice units, as `Lattice.to_units` does."""
    return int(np.rint(metres * units_per_metre))


@kernel
def project_ends(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    depth: float,
    units_per_metre: float,
    ends: Int64,
) -> tuple[int, int, int, int]:
    """Compute where beams end, in lattice units.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, K, 2), (S, K, 2, 2), (B, 2), (S, B), (S, B) as in `Rays`.
    depth
        How far beyond its range a HIT beam is followed (m).
    ends
        (S, B, 2) x and y, written here.

    Returns
    -------
    Lowest x, lowest y, highest x, highest y of all ends.
    """
    scans, beams = distance.shape
    viewpoints, turns = origin.shape[1], turn.shape[1]
    low_x = low_y = 2**62
    high_x = high_y = -(2**62)
    for s in range(scans):
        for b in range(beams):
            k, t = min(b, viewpoints - 1), min(b, turns - 1)
            along_x = turn[s, t, 0, 0] * bearing[b, 0] + turn[s, t, 0, 1] * bearing[b, 1]
            along_y = turn[s, t, 1, 0] * bearing[b, 0] + turn[s, t, 1, 1] * bearing[b, 1]
            reach = float(distance[s, b])
            if depth > 0 and kinds[s, b] == 2:
                reach += depth / np.sqrt(along_x * along_x + along_y * along_y)
            x = round_to_units(origin[s, k, 0] + reach * along_x, units_per_metre)
            y = round_to_units(origin[s, k, 1] + reach * along_y, units_per_metre)
            ends[s, b, 0], ends[s, b, 1] = x, y
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    return low_x, low_y, high_x, high_y
