"""Evidence as text that a person can read, and scans of scenes made of straight walls."""

import math

import numpy as np

from occmap.types import Kind, Rays
from tests.grid.scans import Evidence, aim

Wall = tuple[tuple[float, float], tuple[float, float]]
"""x and y of both ends (m)."""


def draw(evidence: Evidence) -> str:
    """Largest y first: # was hit, . was seen free, % both, blank is unknown."""
    cells = evidence.first.keys() | evidence.second.keys()
    rows, cols = [row for row, _ in cells], [col for _, col in cells]

    def mark(cell: tuple[int, int]) -> str:
        return " #.%"[(cell in evidence.first) + 2 * (cell in evidence.second)]

    lines = [
        "".join(mark((row, col)) for col in range(min(cols), max(cols) + 1)).rstrip()
        for row in range(max(rows), min(rows) - 1, -1)
    ]
    return "\n".join(lines)


def look(
    place: tuple[float, float],
    degrees: tuple[float, float, float],
    walls: list[Wall],
    kind_of_nothing: Kind = Kind.SKIP,
    limit: float = 0.0,
) -> Rays:
    """Scan walls from a place: first bearing, last and step (degrees); where no wall is, a beam
    sees `kind_of_nothing`, up to `limit`.
    """
    first, last, step = degrees
    beams = round((last - first) / step) + 1
    direction = aim(math.radians(first), math.radians(step), beams)
    reached = [measure(place, (x, y), walls) for x, y in direction.tolist()]
    found = [distance is not None for distance in reached]
    return Rays.along(
        np.array([[place]], float),
        direction[None],
        np.array([[limit if d is None else d for d in reached]], np.float32),
        np.where(found, np.uint8(Kind.HIT), np.uint8(kind_of_nothing))[None],
        np.zeros(1, np.int64),
        full_circle=(beams + 0.5) * step >= 360,
    )


def measure(
    place: tuple[float, float], along: tuple[float, float], walls: list[Wall]
) -> float | None:
    """Distance to the nearest wall on a beam."""
    met = [cross(place, along, wall) for wall in walls]
    return min((d for d in met if d is not None), default=None)


def cross(place: tuple[float, float], along: tuple[float, float], wall: Wall) -> float | None:
    """Distance from a place to a wall: place + d along = end0 + t (end1 - end0), 0 <= t <= 1."""
    (x0, y0), (x1, y1) = wall
    wide, high = x1 - x0, y1 - y0
    to_x, to_y = x0 - place[0], y0 - place[1]
    sine = along[0] * high - along[1] * wide
    if abs(sine) < 1e-12:
        return None
    d, t = (to_x * high - to_y * wide) / sine, (to_x * along[1] - to_y * along[0]) / sine
    return d if d > 0 and -1e-9 <= t <= 1 + 1e-9 else None


def box(x: float, y: float, x_end: float, y_end: float) -> list[Wall]:
    """The four walls of a room."""
    corners = [(x, y), (x_end, y), (x_end, y_end), (x, y_end)]
    return list(zip(corners, corners[1:] + corners[:1], strict=True))
