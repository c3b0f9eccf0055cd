"""Evidence as text that a person can read, and scans of scenes made of straight walls."""

import math

import numpy as np

from occmap.types import Kind, Rays
from tests.bench.plans import Box
from tests.bench.raycast import cast_scans
from tests.grid.scans import Evidence, aim, make_rays


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
    walls: list[Box],
    kind_of_nothing: Kind = Kind.SKIP,
    limit: float = 0.0,
) -> Rays:
    """Scan walls from a place: first bearing, last and step (degrees); where no wall is, a beam
    sees `kind_of_nothing`, up to `limit`.
    """
    first, last, step = (math.radians(each) for each in degrees)
    bearings = first + step * np.arange(round((last - first) / step) + 1, dtype=np.float64)
    reached = cast_scans(np.array([(*place, 0.0)]), bearings, np.array(walls, np.float64))
    found, closed = np.isfinite(reached), (len(bearings) + 0.5) * step >= math.tau
    ends, kinds = np.where(found, reached, limit), np.where(found, Kind.HIT, kind_of_nothing)
    return make_rays(place, aim(first, step, len(bearings)), ends, kinds, full_circle=closed)


def box(x: float, y: float, x_end: float, y_end: float) -> list[Box]:
    """The four walls of a room, of no thickness."""
    across = [(x, each, x_end, each) for each in (y, y_end)]
    return across + [(each, y, each, y_end) for each in (x, x_end)]
