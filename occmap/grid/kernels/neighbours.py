"""The surface update: what two neighbouring beams together say of a surface that both meet.

A denser laser would have sent more beams between the two. They are drawn as far as cells lie
between the ends, and from five eighths of their way on: nearer the sensor they run through cells
that the two beams cross anyway. The weight of those that are not drawn goes to the two beams, so
that every pair weighs the same however far away the surface is.
"""

from occmap.arrays import Float32, Int32, UInt8
from occmap.grid.kernels.units import ALONE, CELL_SHIFT, FREE, HIT, MOST_BETWEEN
from occmap.jit import kernel

WIDEST_GAP = 12
"""Nothing is known of a surface between ends that lie more cells apart."""
SLANT = 0.1
"""The share of the nearer range by which two may differ: far walls are seen at a slant."""


@kernel
def link_neighbours(
    distance: Float32,
    kinds: UInt8,
    ends_x: Int32,
    ends_y: Int32,
    full_circle: bool,
    jump: float,
    weights: UInt8,
    between: UInt8,
) -> None:
    """Say how many beams to draw between each beam and the next, and what each beam weighs.

    Parameters
    ----------
    distance, kinds, ends_x, ends_y
        (S, B) in metres; of Kind; in lattice units.
    full_circle
        The first beam is the neighbour of the last.
    jump
        Neighbours meet one surface where their ranges differ by at most this (m) or by a tenth.
    weights, between
        (S, B), written here.
    """
    scans, beams = kinds.shape
    weights[:] = ALONE
    between[:] = 0
    for s in range(scans):
        for b in range(beams if full_circle and beams > 1 else beams - 1):
            c = b + 1 if b + 1 < beams else 0
            here, there = float(distance[s, b]), float(distance[s, c])
            across, up = abs(ends_x[s, c] - ends_x[s, b]), abs(ends_y[s, c] - ends_y[s, b])
            cells = max(across, up) >> CELL_SHIFT
            both_hit = (kinds[s, b] == HIT) & (kinds[s, c] == HIT)
            one_surface = abs(here - there) <= max(jump, SLANT * min(here, there))
            joined = both_hit & one_surface & (cells <= WIDEST_GAP)
            both_free = (kinds[s, b] == FREE) & (kinds[s, c] == FREE)
            drawn = min(cells, MOST_BETWEEN) if joined else 0
            rest = MOST_BETWEEN - drawn if joined | both_free else 0
            between[s, b] = drawn
            weights[s, b] += rest
            weights[s, c] += rest
