"""Beam ends from metres to lattice units: the one rounding of a coordinate."""

import numpy as np

from occmap.grid.kernels.jit import kernel
from occmap.grid.lattice import SUBCELLS
from occmap.types import Float64, Int64


@kernel
def round_to_units(metres: float, resolution: float) -> int:
    """Round a coordinate to lattice units, as `Lattice.to_units` does."""
    return int(np.rint(metres / resolution * SUBCELLS))


@kernel
def project_ends(
    origin: Float64, direction: Float64, distance: Float64, resolution: float, ends: Int64
) -> tuple[int, int, int, int]:
    """Compute where beams end, in lattice units.

    Parameters
    ----------
    origin, direction, distance
        (S, K, 2) m, (S, B, 2), (S, B) m, as in `Rays`.
    ends
        (S, B, 2) x and y, written here.

    Returns
    -------
    Lowest x, lowest y, highest x, highest y of all ends.
    """
    scans, beams = distance.shape
    viewpoints = origin.shape[1]
    low_x = low_y = 2**62
    high_x = high_y = -(2**62)
    for s in range(scans):
        for b in range(beams):
            k = b if viewpoints > 1 else 0
            x = round_to_units(origin[s, k, 0] + distance[s, b] * direction[s, b, 0], resolution)
            y = round_to_units(origin[s, k, 1] + distance[s, b] * direction[s, b, 1], resolution)
            ends[s, b, 0], ends[s, b, 1] = x, y
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
    return low_x, low_y, high_x, high_y
