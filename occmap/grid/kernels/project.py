"""Beam ends from metres to lattice units, rounded as `occmap.grid.lattice` does."""

import numpy as np

from occmap.arrays import Float32, Float64, Int32, UInt8
from occmap.grid.kernels.units import HIT, NO_LENGTH
from occmap.jit import kernel


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
    anchor: Float64,
    ends_x: Int32,
    ends_y: Int32,
) -> tuple[int, int, int, int]:
    """Compute where beams end; return the lowest x and y of all ends, and the highest x and y.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, K, 2), (S, K, 2, 2), (2, B), (S, B), (S, B) as in `Rays`.
    depth
        How far beyond its range a HIT beam is followed (m).
    anchor
        (2,) x and y of a corner of a cell near the beams (lattice units).
    ends_x, ends_y
        (S, B) lattice units from the anchor, written here.
    """
    scans, beams = distance.shape
    viewpoints, turns = origin.shape[1], turn.shape[1]
    left = bottom = np.int32(2**31 - 1)
    right = top = np.int32(-(2**31))
    for s in range(scans):
        if turns == 1:  # nearly always: without a branch or an index by beam it is vectorised
            at_x, at_y = origin[s, 0, 0], origin[s, 0, 1]
            xx, xy, yx, yy = turn[s, 0, 0, 0], turn[s, 0, 0, 1], turn[s, 0, 1, 0], turn[s, 0, 1, 1]
            for b in range(beams):
                along_x = xx * bearing[0, b] + xy * bearing[1, b]
                along_y = yx * bearing[0, b] + yy * bearing[1, b]
                reach = _reach(distance[s, b], kinds[s, b], depth, along_x, along_y)
                x, y = at_x + reach * along_x, at_y + reach * along_y
                ends_x[s, b] = np.int32(np.rint(x * units_per_metre) - anchor[0])
                ends_y[s, b] = np.int32(np.rint(y * units_per_metre) - anchor[1])
        else:
            for b in range(beams):
                k = min(b, viewpoints - 1)
                along_x = turn[s, b, 0, 0] * bearing[0, b] + turn[s, b, 0, 1] * bearing[1, b]
                along_y = turn[s, b, 1, 0] * bearing[0, b] + turn[s, b, 1, 1] * bearing[1, b]
                reach = _reach(distance[s, b], kinds[s, b], depth, along_x, along_y)
                x, y = origin[s, k, 0] + reach * along_x, origin[s, k, 1] + reach * along_y
                ends_x[s, b] = np.int32(np.rint(x * units_per_metre) - anchor[0])
                ends_y[s, b] = np.int32(np.rint(y * units_per_metre) - anchor[1])
        for b in range(beams):  # a loop of its own: many ends are compared at a time
            left, right = min(left, ends_x[s, b]), max(right, ends_x[s, b])
            bottom, top = min(bottom, ends_y[s, b]), max(top, ends_y[s, b])
    return int(left), int(bottom), int(right), int(top)


@kernel
def _reach(distance: float, kind: int, depth: float, along_x: float, along_y: float) -> float:
    """How far to follow a beam: if it is a HIT, by `depth` more on the map.

    A beam straight up or down has no direction on the map, and ends where it begins.
    """
    beyond = depth / max(np.sqrt(along_x * along_x + along_y * along_y), NO_LENGTH)
    return np.float64(distance) + (beyond if kind == HIT else 0.0)


@kernel
def measure_ranges(
    turn: Float64, bearing: Float64, distance: Float32, units_per_metre: float, ranges: Float64
) -> None:
    """Write how far each beam reached on the map (lattice units); `ranges` may have no scan."""
    turns = turn.shape[1]
    for s in range(ranges.shape[0]):
        xx, xy, yx, yy = turn[s, 0, 0, 0], turn[s, 0, 0, 1], turn[s, 0, 1, 0], turn[s, 0, 1, 1]
        for b in range(ranges.shape[1]):
            if turns > 1:  # asked once for the whole loop, so that it is vectorised
                xx, xy = turn[s, b, 0, 0], turn[s, b, 0, 1]
                yx, yy = turn[s, b, 1, 0], turn[s, b, 1, 1]
            along_x = xx * bearing[0, b] + xy * bearing[1, b]
            along_y = yx * bearing[0, b] + yy * bearing[1, b]
            length = np.sqrt(along_x * along_x + along_y * along_y)
            ranges[s, b] = distance[s, b] * length * units_per_metre
