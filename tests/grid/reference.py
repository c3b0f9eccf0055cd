"""The grid rules written the slow, obvious way: one cell at a time, in Python integers.

Every kernel must equal these cell by cell. Nothing here is shared with the kernels but the
rounding of a coordinate to 1/256 of a cell, which is part of the rule.
"""

import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from occmap.grid.kernels.projection import join_viewpoints
from occmap.grid.tiles import GridSpec
from occmap.types import Kind, Rays, Update

Cell = tuple[int, int]
Point = tuple[int, int]


def to_units(metres: float, resolution: float) -> int:
    """Round half to even, as Python's round does."""
    return round(metres * (256 / resolution))


def point(rays: Rays, s: int, b: int, distance: float, resolution: float) -> Point:
    """x and y of the point on a beam at a distance, in lattice units."""
    x, y = rays.origin[s, b if rays.origin.shape[1] > 1 else 0]
    along_x, along_y = rays.direction[s, b]
    return (
        to_units(float(x) + distance * float(along_x), resolution),
        to_units(float(y) + distance * float(along_y), resolution),
    )


def reach(rays: Rays, s: int, b: int, depth: float) -> float:
    """How far to follow a beam: a hit to `depth` (m on the map) behind its range.

    One straight up or down has no direction on the map, and no depth.
    """
    slant = math.hypot(*rays.direction[s, b])
    is_followed = rays.kind[s, b] == Kind.HIT and slant > 0
    return float(rays.distance[s, b]) + (depth / slant if is_followed else 0.0)


def cell_of(spot: Point) -> Cell:
    return spot[1] // 256, spot[0] // 256


def bresenham(start: Cell, end: Cell) -> list[Cell]:
    """All cells of a line; a tie goes to the cell nearer the end's row or column."""
    n = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    if n == 0:
        return [start]

    def at(i: int, a: int, b: int) -> int:
        moved = math.floor(abs(b - a) * i / n + 0.5)
        return a + moved if b > a else a - moved

    return [(at(i, start[0], end[0]), at(i, start[1], end[1])) for i in range(n + 1)]


class Beam(NamedTuple):
    """A beam as the surface update draws it."""

    sensor: Point
    start: Point
    """Five eighths of the way to its end, where it lies between two measured beams"""
    end: Point
    range: float
    """m"""
    kind: Kind
    weight: int


def trace(spec: GridSpec, rays: Rays) -> tuple[Counter[Cell], Counter[Cell]]:
    """Hits and misses of an update that counts."""
    resolution = spec.lattice.resolution
    if spec.update is Update.POLYGON:
        return trace_polygons(join_viewpoints(rays), resolution, spec.jump, spec.border_gap)
    hits: Counter[Cell] = Counter()
    misses: Counter[Cell] = Counter()
    for beam in list_beams(spec.update, rays, resolution, spec.jump):
        *crossed, end = bresenham(cell_of(beam.start), cell_of(beam.end))
        for cell in crossed:
            misses[cell] += beam.weight
        (hits if beam.kind == Kind.HIT else misses)[end] += beam.weight
    return hits, misses


def list_beams(
    update: Update, rays: Rays, resolution: float, jump: float = 0.1, depth: float = 0.0
) -> Iterator[Beam]:
    """What the beam or the surface update draws; a hit is followed to `depth` (m) behind it."""
    for s in range(rays.kind.shape[0]):
        if update is Update.SURFACE:
            yield from list_surface_beams(rays, s, resolution, jump, depth)
        else:
            yield from list_measured_beams(rays, s, resolution, depth).values()


def list_measured_beams(rays: Rays, s: int, resolution: float, depth: float) -> dict[int, Beam]:
    """The beams of a scan that are not SKIP, each by itself."""
    beams = {}
    for b, kind in enumerate(map(Kind, rays.kind[s].tolist())):
        if kind != Kind.SKIP:
            sensor = point(rays, s, b, 0.0, resolution)
            end = point(rays, s, b, reach(rays, s, b, depth), resolution)
            beams[b] = Beam(sensor, sensor, end, range_on_map(rays, s, b), kind, 1)
    return beams


def range_on_map(rays: Rays, s: int, b: int) -> float:
    """How far away a beam's end lies on the map (m): nothing for one straight up."""
    return float(rays.distance[s, b]) * math.hypot(*rays.direction[s, b])


def list_surface_beams(
    rays: Rays, s: int, resolution: float, jump: float, depth: float
) -> Iterator[Beam]:
    """A scan's beams, and those that a denser laser would have sent between neighbours."""
    measured = list_measured_beams(rays, s, resolution, depth)
    weights = dict.fromkeys(measured, 2)
    for a, b in neighbours(rays):
        if a not in measured or b not in measured:
            continue
        one, other = measured[a], measured[b]
        (x, y), (to_x, to_y) = one.end, other.end
        apart = max(abs(to_x - x), abs(to_y - y)) // 256
        far_a, far_b = (float(rays.distance[s, each]) for each in (a, b))
        one_surface = abs(far_a - far_b) <= max(jump, min(far_a, far_b) * 0.1) and apart <= 12
        drawn = 0
        if one.kind == other.kind == Kind.HIT and one_surface:
            drawn = min(apart, 3)
            for i in range(1, drawn + 1):
                end = x + i * ((to_x - x) // (drawn + 1)), y + i * ((to_y - y) // (drawn + 1))
                start = (3 * one.sensor[0] + 5 * end[0]) // 8, (3 * one.sensor[1] + 5 * end[1]) // 8
                r = max(math.dist(one.sensor, end) * resolution / 256 - depth, 0.0)
                yield Beam(one.sensor, start, end, r, Kind.HIT, 2)
        elif not one.kind == other.kind == Kind.FREE:
            continue
        weights[a] += 3 - drawn
        weights[b] += 3 - drawn
    for b, beam in measured.items():
        yield beam._replace(weight=weights[b])


def trace_polygons(
    rays: Rays, resolution: float, jump: float = 0.1, border_gap: int = 8
) -> tuple[Counter[Cell], Counter[Cell]]:
    """Hits and misses of the polygon update."""
    hits: Counter[Cell] = Counter()
    misses: Counter[Cell] = Counter()
    for s in range(rays.kind.shape[0]):
        border = find_border(rays, s, resolution, jump, border_gap)
        regions = [outline(rays, s, run, resolution, jump) for run in find_runs(rays, s)]
        hits.update(border)
        misses.update(
            cell
            for cell in cells_around(regions)
            if cell not in border and is_inside(regions, cell)
        )
    return hits, misses


def neighbours(rays: Rays) -> list[tuple[int, int]]:
    """Pairs of beams that lie side by side."""
    beams = rays.kind.shape[1]
    pairs = [(b, b + 1) for b in range(beams - 1)]
    return [*pairs, (beams - 1, 0)] if rays.full_circle and beams > 1 else pairs


def find_border(rays: Rays, s: int, resolution: float, jump: float, border_gap: int) -> set[Cell]:
    ends = {
        b: cell_of(point(rays, s, b, float(rays.distance[s, b]), resolution))
        for b in range(rays.kind.shape[1])
        if rays.kind[s, b] == Kind.HIT
    }
    border = set(ends.values())
    for a, b in neighbours(rays):
        if a not in ends or b not in ends:
            continue
        gap = max(abs(ends[a][0] - ends[b][0]), abs(ends[a][1] - ends[b][1]))
        apart = abs(float(rays.distance[s, a]) - float(rays.distance[s, b]))
        if apart <= jump and gap <= border_gap:
            border.update(bresenham(ends[a], ends[b]))
    return border


def find_runs(rays: Rays, s: int) -> list[tuple[list[int], bool]]:
    """Runs of consecutive beams that are not SKIP, and whether a run closes on itself."""
    used = [b for b in range(rays.kind.shape[1]) if rays.kind[s, b] != Kind.SKIP]
    beside = dict(neighbours(rays))
    if rays.full_circle and len(used) == rays.kind.shape[1]:
        return [(used, True)]
    followers = {beside[b] for b in used if b in beside}
    runs = []
    for start in (b for b in used if b not in followers):
        run = [start]
        while beside.get(run[-1]) in used:
            run.append(beside[run[-1]])
        runs.append((run, False))
    return runs


def outline(
    rays: Rays, s: int, run: tuple[list[int], bool], resolution: float, jump: float
) -> list[Point]:
    """The corners of a region, in order."""
    beams, closed = run
    corners = [] if closed else [point(rays, s, beams[0], 0.0, resolution)]
    for i, b in enumerate(beams):
        if i > 0 or closed:
            a = beams[i - 1]
            far_a, far_b = float(rays.distance[s, a]), float(rays.distance[s, b])
            if far_b - far_a > jump:
                corners.append(point(rays, s, b, far_a, resolution))
            elif far_a - far_b > jump:
                corners.append(point(rays, s, a, far_b, resolution))
        corners.append(point(rays, s, b, float(rays.distance[s, b]), resolution))
    return corners


def cells_around(regions: list[list[Point]]) -> set[Cell]:
    """Every cell of the bounding boxes."""
    cells = set()
    for region in regions:
        xs, ys = [x // 256 for x, _ in region], [y // 256 for _, y in region]
        cells |= {
            (row, col) for row in range(min(ys), max(ys) + 1) for col in range(min(xs), max(xs) + 1)
        }
    return cells


def is_inside(regions: list[list[Point]], cell: Cell) -> bool:
    """Whether the regions together go round the cell's centre.

    They all turn the same way, but for a scan that is not seen from where it was taken: where a
    nearer thing shifts across a farther one a region folds over, and what lies between two regions
    that contradict each other there is not called free.
    """
    return sum(winds_around(region, cell) for region in regions) != 0


def winds_around(region: list[Point], cell: Cell) -> int:
    """How often the region goes round the cell's centre; one on a left or lower edge is in."""
    x, y = cell[1] * 256 + 128, cell[0] * 256 + 128
    winding = 0
    for (x0, y0), (x1, y1) in zip(region, region[1:] + region[:1], strict=True):
        side = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
        if y0 <= y < y1 and side <= 0:  # an edge going up, at or left of the centre
            winding += 1
        if y1 <= y < y0 and side >= 0:
            winding -= 1
    return winding
