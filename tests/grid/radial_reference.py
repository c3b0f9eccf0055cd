"""The updates for models that look at distances, the slow way: one cell at a time, in floats.

O, V and p are as in docs/architecture.md, of a cell whose centre is at distance d from the sensor
on a beam of range r. Where neither O nor V speaks of a cell, nothing is observed. p is clipped to
[p_min, 1 - p_min].
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field

from occmap.grid.kernels.projection import join_viewpoints
from occmap.types import Kind, Rays, Update
from tests.grid.reference import Cell, Point, bresenham, cell_of, list_beams, point, range_on_map

MILLIONTH = 1e-6
"""A distance this near to a limit, as a share of it, may fall on either side."""
BEARING_TOLERANCE = 2 * math.pi / 4000
"""A bearing this near (rad) to where one beam takes over from another may fall on either side."""
WIDEST = math.radians(60)
"""No beam speaks for bearings farther from its own."""


@dataclass(frozen=True)
class Quadratic:
    """The parameters of the model."""

    depth: float
    p_min: float

    def observe(self, d: float, r: float, kind: Kind) -> float | None:
        """The probability of a cell, None where the beam says nothing about it."""
        about, before = kind == Kind.HIT and abs(d - r) <= self.depth, d < r - self.depth
        o = 1 - ((d - r) / self.depth) ** 2 if about else 0.0
        v = 1 - (d / (r - self.depth)) ** 2 if before else 0.0
        return self.clip((1 + o - v) / 2) if about or before else None

    def clip(self, p: float) -> float:
        return min(max(p, self.p_min), 1 - self.p_min)

    def is_on_limit(self, d: float, r: float) -> bool:
        """Whether rounding decides what is said about the cell."""
        limits = (abs(r - self.depth), r + self.depth)
        return any(abs(d - limit) <= MILLIONTH * (limit + d) for limit in limits)


@dataclass
class Observed:
    """What the cells were told; `doubtful` ones are decided by rounding."""

    probabilities: dict[Cell, list[float]] = field(default_factory=lambda: defaultdict(list))
    doubtful: set[Cell] = field(default_factory=set)

    def log_odds(self, cell: Cell) -> float:
        return sum(math.log(p / (1 - p)) for p in self.probabilities[cell])

    def note(self, cell: Cell, p: float | None) -> None:
        if p is not None:
            self.probabilities[cell].append(p)


def centre_from(sensor: Point, cell: Cell, resolution: float) -> tuple[float, float]:
    """x and y (m) of a cell's centre as seen from the sensor's place on the lattice."""
    x, y = cell[1] * 256 + 128 - sensor[0], cell[0] * 256 + 128 - sensor[1]
    return x * resolution / 256, y * resolution / 256


def trace_radial(update: Update, rays: Rays, resolution: float, model: Quadratic) -> Observed:
    """What an update observes.

    A cell is observed once a scan by polygon; else along each beam that is drawn, to its range, or
    where it hit something to its range + depth, as often as it weighs. A scan of a single beam has
    no neighbour that would say how wide it is: it is a line.
    """
    if update is Update.POLYGON:
        rays = join_viewpoints(rays)
        if rays.kind.shape[1] > 1:
            return trace_radial_polygons(rays, resolution, model)
    observed = Observed()
    for beam in list_beams(update, rays, resolution, depth=model.depth):
        for cell in bresenham(cell_of(beam.start), cell_of(beam.end)):
            d = math.hypot(*centre_from(beam.sensor, cell, resolution))
            for _ in range(beam.weight):
                observed.note(cell, model.observe(d, beam.range, beam.kind))
            if model.is_on_limit(d, beam.range):
                observed.doubtful.add(cell)
    return observed


@dataclass(frozen=True)
class Sector:
    """The bearings that a beam covers: from `start`, counter-clockwise by `width` (rad)."""

    start: float
    width: float

    def turn_to(self, bearing: float) -> float:
        return (bearing - self.start) % (2 * math.pi)

    def contains(self, bearing: float) -> bool:
        return self.turn_to(bearing) < self.width

    def is_beside(self, bearing: float) -> bool:
        """Whether a bearing lies on a side of the sector, as far as rounding goes."""
        turn = self.turn_to(bearing)
        apart = min(turn, 2 * math.pi - turn, abs(turn - self.width))
        return apart <= BEARING_TOLERANCE


def trace_radial_polygons(rays: Rays, resolution: float, model: Quadratic) -> Observed:
    """Each cell once a scan, with the range of the beam that covers its bearing.

    Where a scan goes more than once round, the later beam counts.
    """
    observed = Observed()
    for s in range(rays.kind.shape[0]):
        sectors = find_sectors(rays, s)
        sensor = point(rays, s, 0, 0.0, resolution)
        for cell in cells_within(sensor, float(rays.distance[s].max()) + model.depth, resolution):
            x, y = centre_from(sensor, cell, resolution)
            bearing = math.atan2(y, x)
            covering = [b for b, sector in sectors.items() if sector.contains(bearing)]
            if (x, y) == (0, 0) or any(v.is_beside(bearing) for v in sectors.values()):
                observed.doubtful.add(cell)
            if covering:
                b = covering[-1]
                d, r = math.hypot(x, y), range_on_map(rays, s, b)
                observed.note(cell, model.observe(d, r, Kind(int(rays.kind[s, b]))))
                if model.is_on_limit(d, r):
                    observed.doubtful.add(cell)
    return observed


def find_sectors(rays: Rays, s: int) -> dict[int, Sector]:
    """What each beam covers: half-way to its neighbours, and as much beyond the first and last.

    A beam covers nothing where it is SKIP or its sides lie the wrong way round. One straight up
    has no bearing: it covers nothing, and a neighbour's sector ends at the neighbour's own bearing.
    """
    directions = rays.direction[s].tolist()
    bearings = [math.atan2(y, x) for x, y in directions]
    beams = len(bearings)
    turns = [
        turn_between(bearings[b], bearings[(b + 1) % beams])
        if any(directions[b]) and any(directions[(b + 1) % beams])
        else 0.0
        for b in range(beams)
    ]
    sense = 1 if sum(math.sin(turn) for turn in turns[:-1]) >= -MILLIONTH else -1
    # A neighbour on the far side counts as one ahead, whichever way round to it is shorter.
    halves = [WIDEST if abs(turn) > 2 * WIDEST else sense * turn / 2 for turn in turns]
    sectors = {}
    for b in range(beams):
        before, after = halves[b - 1], halves[b]
        if not rays.full_circle and b == 0:
            before = after
        elif not rays.full_circle and b == beams - 1:
            after = before
        width = before + after
        if width > MILLIONTH and any(directions[b]) and rays.kind[s, b] != Kind.SKIP:
            sectors[b] = Sector(bearings[b] - (before if sense > 0 else after), width)
    return sectors


def turn_between(a: float, b: float) -> float:
    """From one bearing to another, the short way, in (-pi, pi]."""
    turn = (b - a) % (2 * math.pi)
    return turn - 2 * math.pi if turn > math.pi else turn


def cells_within(sensor: Point, far: float, resolution: float) -> list[Cell]:
    """All cells whose centres may be so far (m) from the sensor."""
    row, col = cell_of(sensor)
    n = math.ceil(far / resolution) + 1
    return [(r, c) for r in range(row - n, row + n + 1) for c in range(col - n, col + n + 1)]
