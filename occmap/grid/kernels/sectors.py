"""Which beam covers which bearing, and the outline of all that the beams of a scan reach."""

import numpy as np

from occmap.grid.kernels.arrays import Int32
from occmap.grid.kernels.jit import kernel
from occmap.grid.kernels.project import round_to_units
from occmap.types import Bool, Float64, Int64, UInt8

BEARINGS = 1 << 14
"""Steps of a full turn to which the bearing of a cell is known."""
COS_60, SIN_60 = 0.5, 0.75**0.5


@kernel
def find_sectors(
    direction: Float64, kinds: UInt8, full_circle: bool, sectors: Float64, covers: Bool
) -> float:
    """Find what each beam covers: from half-way to one neighbour to half-way to the other.

    `sectors` (B, 2, 2) is written: unit vectors at the side of the beam before and at that of the
    beam after, at most 60 degrees away. `covers` (B,) too: False where a beam is SKIP, and where
    its sides lie the wrong way round. That happens where a scan is not seen from where it was
    taken and a nearer thing shifts across a farther one; its neighbours' sectors then overlap.

    Returns
    -------
    1 where the scan turns counter-clockwise, -1 where clockwise.
    """
    beams = kinds.size
    turn = 0.0
    for b in range(1, beams):
        turn += _cross(direction, b - 1, direction, b)
    sign: float = 1.0 if turn >= 0 else -1.0
    for b in range(beams):
        _halve(direction, b - 1 if b > 0 else beams - 1, b, sectors[b, 0])
        _halve(direction, b, b + 1 if b < beams - 1 else 0, sectors[b, 1])
    if not full_circle:
        # The first beam and the last cover as much beyond themselves as to their neighbour.
        _mirror(sectors[0, 1], direction[0], sectors[0, 0])
        _mirror(sectors[beams - 1, 0], direction[beams - 1], sectors[beams - 1, 1])
    for b in range(beams):
        _limit(direction[b], sectors[b, 0], -sign)
        _limit(direction[b], sectors[b, 1], sign)
        covers[b] = kinds[b] != 0 and sign * _cross(sectors[b], 0, sectors[b], 1) > 0
    return sign


@kernel
def _cross(a: Float64, i: int, b: Float64, j: int) -> float:
    """Sine of the angle from one unit vector to another."""
    return float(a[i, 0] * b[j, 1] - a[i, 1] * b[j, 0])


@kernel
def _halve(direction: Float64, a: int, b: int, side: Float64) -> None:
    """Write the unit vector half-way between two beams; zero where they are opposite."""
    x, y = direction[a, 0] + direction[b, 0], direction[a, 1] + direction[b, 1]
    length = max(np.sqrt(x * x + y * y), 1e-300)
    side[0], side[1] = x / length, y / length


@kernel
def _mirror(vector: Float64, axis: Float64, side: Float64) -> None:
    """Write a unit vector mirrored about a beam."""
    along = vector[0] * axis[0] + vector[1] * axis[1]
    side[0], side[1] = 2 * along * axis[0] - vector[0], 2 * along * axis[1] - vector[1]


@kernel
def _limit(beam: Float64, side: Float64, sign: float) -> None:
    """Bring the side of a sector to 60 degrees from its beam if it is farther."""
    if side[0] * beam[0] + side[1] * beam[1] < COS_60:
        side[0] = COS_60 * beam[0] - sign * SIN_60 * beam[1]
        side[1] = COS_60 * beam[1] + sign * SIN_60 * beam[0]


@kernel
def bearing_of(x: float, y: float) -> np.int64:
    """Which of the steps of a turn a vector points to, counter-clockwise from +x.

    Steps of x / (|x| + |y|) and not of the angle: they grow and shrink together, and this needs
    no arc tangent.
    """
    part = x / max(abs(x) + abs(y), 1e-300)
    turned = 1.0 - part if y >= 0 else 3.0 + part
    return np.int64(turned * (BEARINGS / 4))


@kernel
def cover_bearings(sectors: Float64, covers: Bool, sign: float, covering: Int32) -> None:
    """Write for each step of a turn the beam that covers it, the later of two; -1 where none."""
    covering[:] = -1
    right, left = (0, 1) if sign > 0 else (1, 0)
    for b in range(covers.size):
        first = bearing_of(sectors[b, right, 0], sectors[b, right, 1])
        last = bearing_of(sectors[b, left, 0], sectors[b, left, 1])
        if not covers[b] or first == last:
            continue
        if last < first:
            covering[first:] = b
            covering[:last] = b
        else:
            covering[first:last] = b


@kernel
def outline_sectors(
    origin: Float64,
    direction: Float64,
    ranges: Float64,
    kinds: UInt8,
    units_per_metre: float,
    depth: float,
    corner: Int64,
    sectors: Float64,
    covers: Bool,
    x: Int64,
    y: Int64,
    begins: Bool,
) -> int:
    """Write corners around all that the beams may say something about; returns their number.

    A beam's sector ends at the tangent to the outermost circle of its influence, so nothing is
    left out. A run of beams that cover something is closed at the sensor.
    """
    beams = kinds.size
    at_x = round_to_units(origin[0], units_per_metre) - corner[0]
    at_y = round_to_units(origin[1], units_per_metre) - corner[1]
    corners = 0
    for b in range(beams):
        if not covers[b]:
            continue
        if b == 0 or not covers[b - 1]:
            x[corners], y[corners], begins[corners] = at_x, at_y, True
            corners += 1
        reach = ranges[b] + (depth if kinds[b] == 2 else 0.0) + 4 / units_per_metre
        for side in sectors[b]:
            length = reach / (side[0] * direction[b, 0] + side[1] * direction[b, 1])
            end_x, end_y = origin[0] + length * side[0], origin[1] + length * side[1]
            x[corners] = round_to_units(end_x, units_per_metre) - corner[0]
            y[corners] = round_to_units(end_y, units_per_metre) - corner[1]
            begins[corners] = False
            corners += 1
        if b == beams - 1 or not covers[b + 1]:
            x[corners], y[corners], begins[corners] = at_x, at_y, False
            corners += 1
    return corners
