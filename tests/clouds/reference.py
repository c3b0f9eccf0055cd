"""What a cloud observes, slowly and plainly: each point and each cell by itself, in Python."""

import math
from collections import defaultdict
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.clouds import CloudOptions
from occmap.types import Float64, PosedScans
from tests.grid.reference import Cell, bresenham

NONE = -(1 << 30)
METRE = 5120
"""Lattice units, 256 to a cell of 5 cm"""
COLUMN, STEP = 0.15 * METRE, 0.075 * METRE


def find_height(ground: dict[Cell, int], x: float, y: float) -> int | None:
    """The height of the ground (mm) at a point (m); None where there is none."""
    own = ground.get((math.floor(y / 0.15), math.floor(x / 0.15)))
    if own is None:
        return None
    along, across = y / 0.15 - 0.5, x / 0.15 - 0.5
    row, col = math.floor(along), math.floor(across)
    around = [ground.get((row + i, col + j)) for i in (0, 1) for j in (0, 1)]
    if None in around or max(around) - min(around) > 80:  # type: ignore[type-var, operator]
        return own
    up, right = along - row, across - col
    shares = (1 - up) * (1 - right), (1 - up) * right, up * (1 - right), up * right
    return round(sum(share * each for share, each in zip(shares, around, strict=True)))  # type: ignore[operator, misc]


def find_sector(x: int, y: int) -> int:
    """Which of 720 bearings a direction has, of equal widths in x / (|x| + |y|)."""
    if not (x or y):
        return 0
    part = x * 180 // (abs(x) + abs(y))
    return (180 - part if y >= 0 else 540 + part) % 720


class Seen(NamedTuple):
    """A point as it is seen from the sensor."""

    cell: Cell
    sector: int
    apart: float
    """The square of its distance (lattice units)"""
    slope: float
    """How steeply its line of sight rises; of floor, to the ground of its cell"""


def group(points: list[Seen]) -> defaultdict[int, list[Seen]]:
    """The points of each bearing."""
    found: defaultdict[int, list[Seen]] = defaultdict(list)
    for each in points:
        found[each.sector].append(each)
    return found


def is_beneath(floor: Seen, hits: list[Seen]) -> bool:
    """Whether floor lies behind the nearest hit of its bearing, and is seen beneath that."""
    nearest, lowered = min([(each.apart, -each.slope) for each in hits] or [(math.inf, 0.0)])
    return floor.apart > nearest and floor.slope < -lowered


def weigh(cell: Cell, start: Cell) -> int:
    """What a cloud weighs in a cell: four times as much up to 8 m from its sensor's cell."""
    return 4 if math.dist(cell, start) * 0.05 < 8 else 1


def fit_plane(places: Float64, above: Float64) -> Float64:
    """How high the floor of a cloud is (mm), and how it rises (mm a cm), at places (N, 2; cm)."""
    plane: Float64 = np.zeros(3)
    terms = np.insert(places, 0, 1, axis=1)
    for gate in (150, 80, 40):
        near = np.abs(above - terms @ plane) <= gate
        sums = terms[near].T @ terms[near] + np.diag([100, 100 * 500**2, 100 * 500**2])
        plane = np.asarray(np.linalg.solve(sums, terms[near].T @ above[near]))
    return plane


class SlowEngine:
    """Counts hits and misses of cells of 5 cm."""

    def __init__(self, ground: Ground, options: CloudOptions) -> None:
        self.ground: dict[Cell, int] = {}
        self.measured: set[Cell] = set()
        layers = ground.blocks.tolist(), ground.height_mm.tolist(), ground.measured.tolist()
        for (row, col), block, measured in zip(*layers, strict=True):
            for at, height in enumerate(block):
                column = row * 64 + at // 64, col * 64 + at % 64
                if height != NONE:
                    self.ground[column] = height
                if measured[at]:
                    self.measured.add(column)
        self.options = options
        self.cells: dict[Cell, int | None] = {}
        self.hits: defaultdict[Cell, int] = defaultdict(int)
        self.misses: defaultdict[Cell, int] = defaultdict(int)

    def find_ground(self, cell: Cell) -> int | None:
        """The height of the ground of a cell (mm)."""
        if cell not in self.cells:
            x, y = (cell[1] + 0.5) * 0.05, (cell[0] + 0.5) * 0.05
            self.cells[cell] = find_height(self.ground, x, y)
        return self.cells[cell]

    def is_face(self, x: float, y: float, level: int, low: float) -> bool:
        """Whether a point (m, mm) stands on ground up to three columns away."""
        row, col = math.floor(y / 0.15), math.floor(x / 0.15)
        near = {(row + i, col + j) for i in range(-3, 4) for j in range(-3, 4)} & self.measured
        high = 1000 * self.options.max_height
        return any(1000 * low <= level - self.ground[each] < high for each in near)

    def find_drop(
        self, start: tuple[int, int], away: tuple[int, int], floor: int, share: float, rise: float
    ) -> list[Seen]:
        """The hit where measured floor ends before a point that lies below it, if there is one.

        The ray goes through the floor's height at a share of its way.
        """
        reach = math.hypot(*away)
        through = share * reach
        beyond = min(12, max(0, math.floor((reach - through) / STEP) - 3))
        ray = []
        for at in (through - number * STEP for number in range(-beyond, 21)):
            x, y = (a + at / reach * b for a, b in zip(start, away, strict=True))
            ray.append((at, (math.floor(y / COLUMN), math.floor(x / COLUMN))))
        measured = [(at, on) for at, on in ray if at >= 0.15 * METRE and on in self.measured]
        if not measured or measured[0][0] >= through:
            return []
        at, column = measured[0]
        if abs(self.ground[column] - floor) > 80:
            return []
        right, up = (math.floor((at - 0.1 * METRE) / reach * each) for each in away)
        cell, apart = ((start[1] + up) // 256, (start[0] + right) // 256), right**2 + up**2
        if self.find_ground(cell) is None:
            return []
        return [Seen(cell, find_sector(*away), apart, rise / math.sqrt(apart))]

    def look(self, posed: PosedScans) -> tuple[list[Seen], list[Seen]]:
        """The points of a cloud that are obstacles, and those that are floor."""
        assert posed.batch.clouds
        points = posed.batch.clouds[0].points.astype(np.float64)
        points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
        origin: Float64 = posed.position[0]
        start = round(origin[0] * 5120), round(origin[1] * 5120)
        hits, floor = [], []
        for x, y, z in (points @ posed.rotation[0].T + origin).tolist():
            cell = round(y * 5120) // 256, round(x * 5120) // 256
            distance, ground = math.hypot(x - origin[0], y - origin[1]), self.find_ground(cell)
            has_ground = ground is not None
            ground = ground if has_ground else self.find_ground((start[1] // 256, start[0] // 256))
            if distance < 0.05 or ground is None:
                continue
            above = (round(z * 1000) - ground) / 1000
            right, up = round(x * 5120) - start[0], round(y * 5120) - start[1]
            apart, low = right**2 + up**2, self.options.min_height
            level = ground if abs(above) < low else round(z * 1000)
            slope = (level - origin[2] * 1000) / math.sqrt(apart)
            seen = Seen(cell, find_sector(right, up), apart, slope)
            margin = max(self.options.range_margin * distance - 0.096, 0)
            if round(z * 1000) - ground <= -1500 * (low + margin):
                rise = ground - origin[2] * 1000
                share = rise / (rise + above * 1000)
                hits += self.find_drop(start, (right, up), ground, share, rise)
            is_face = above <= -low and self.is_face(x, y, round(z * 1000), low + margin)
            if has_ground and abs(above) < low:
                floor.append(seen)
            elif has_ground and (is_face or low + margin <= above < self.options.max_height):
                hits.append(seen)
        return hits, floor

    def lay(self, posed: PosedScans) -> PosedScans:
        """Lay a cloud of at most 10,000 points on the ground."""
        assert posed.batch.clouds
        origin = posed.position[0]
        points = posed.batch.clouds[0].points @ posed.rotation[0].T.astype(np.float64)
        near = points[(np.hypot(*points.T[:2]) < 40) & (np.hypot(*points.T[:2]) > 0.05)] + origin
        seen = []
        for x, y, z in near.tolist():
            column = math.floor(y / 0.15), math.floor(x / 0.15)
            height = find_height(self.ground, x, y) if column in self.measured else None
            if height is not None and abs(round(z * 1000 - height)) < 300:
                away = round((x - origin[0]) * 100), round((y - origin[1]) * 100)
                seen.append((*away, round(z * 1000 - height)))
        floor = np.array(seen).reshape(-1, 3).astype(np.float64)
        lift, right, up = fit_plane(floor[:, :2], floor[:, 2]).tolist()
        least = -0.1 / max(math.hypot(right, up) / 0.175, 1.0)
        shear = np.array([[1, 0, 0], [0, 1, 0], [least * right, least * up, 1]])
        position = posed.position - [0, 0, np.clip(lift, -50, 50) / 1000]
        return replace(posed, position=position, rotation=shear @ posed.rotation)

    def pass_over(self, cell: Cell, height: float, away: float, seen: list[Seen]) -> float:
        """How high above the ground of a cell, so far away, the lowest beam of a bearing is (mm).

        Of its points those count that lie in the same ring of a metre or farther away.
        """
        ring, ground = min(away // METRE, 63), self.find_ground(cell)
        reach = [each.slope for each in seen if each.apart**0.5 // METRE >= ring]
        beam = height * 1000 + min(reach, default=math.inf) * away
        return math.inf if ground is None else beam - ground

    def add(self, posed: PosedScans) -> None:
        """Observe one cloud whose points share a pose."""
        posed = self.lay(posed)
        hits, floor = self.look(posed)
        near, far = group(hits), group(floor)
        free = {each.cell for each in floor if not is_beneath(each, near[each.sector])}
        start = tuple(round(each * 5120) // 256 for each in posed.position[0, 1::-1].tolist())
        low, high, robot = set[Cell](), set[Cell](), self.options.max_height * 1000
        for sector in near.keys() | far.keys():
            seen = near[sector] + far[sector]
            ends = [(each.apart, each.cell) for each in near[sector]]
            _, end = min(ends or [(-each.apart, each.cell) for each in far[sector]])
            line = bresenham((start[0], start[1]), end)[:-1]
            looks = [(each.cell, math.sqrt(each.apart)) for each in near[sector]]
            away = math.dist(start, end) / max(len(line), 1) * 256
            looks += [(cell, number * away) for number, cell in enumerate(line)]
            for cell, apart in looks:
                above = self.pass_over(cell, posed.position[0, 2], apart, seen)
                if above < robot:
                    (low if above < robot * 5 / 8 else high).add(cell)
        hit = {each.cell for each in hits}
        for cell in hit:
            self.hits[cell] += weigh(cell, (start[0], start[1])) if cell in low else 1
        for cell in (low | free) - hit:
            self.misses[cell] += weigh(cell, (start[0], start[1]))
        for cell in high - low - free - hit:
            self.misses[cell] += 1
