"""Random scans that hold the corner cases, and the evidence of an engine as plain numbers."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from occmap.cells import Key, Slices, Tile
from occmap.grid import Lattice
from occmap.grid.engine import GridEngine
from occmap.grid.tiles import INT32_LIMIT, TILE, WINDOW_CELLS, EvidenceKind, GridSpec, TileGrid
from occmap.types import Float64, Kind, Rays, UInt8
from tests.grid.reference import Cell

MIXED = [(0.1, 0.1, 0.8), (0.3, 0.3, 0.4), (0.02, 0.08, 0.9)]
"""Shares of SKIP, FREE and HIT."""

STAMPS = st.integers(-20, 30)
"""Some scans then are of one time, or of one second before zero and after it."""

FEW = settings(max_examples=40, derandomize=True, database=None)
MANY = settings(FEW, max_examples=100)


class Evidence(NamedTuple):
    """The two numbers of every cell in which one is not zero."""

    first: Counter[Cell]
    second: Counter[Cell]


def observe(spec: GridSpec, batches: Iterable[Rays], window_cells: int = WINDOW_CELLS) -> Evidence:
    engine = GridEngine(spec, window_cells)
    for rays in batches:
        engine.add(rays)
    return read_cells(engine.finish())


def read_cells(grid: TileGrid) -> Evidence:
    evidence = Evidence(Counter(), Counter())
    for (tile_row, tile_col), tile in grid.tiles.items():
        for layer, sums in zip(tile, evidence, strict=True):
            rows, cols = np.nonzero(layer)
            places = np.stack([tile_row * TILE + rows, tile_col * TILE + cols], axis=1).tolist()
            cells = zip(map(tuple, places), layer[rows, cols].tolist(), strict=True)
            dict.update(sums, cells)  # a Counter's own would count pairs
    return evidence


def are_equal(tiles: Mapping[Key, Tile], others: Mapping[Key, Tile]) -> bool:
    """Whether there are the same tiles at the same places, however wide their numbers are."""
    both_there = tiles.keys() == others.keys()
    return both_there and all(np.array_equal(tile, others[key]) for key, tile in tiles.items())


def add_cell(grid: TileGrid, row: int, col: int, first: int, second: int) -> None:
    """One cell, in a tile as narrow as its numbers allow."""
    bound = max(abs(first), abs(second))
    tile = np.zeros((2, TILE, TILE), np.int32 if bound <= INT32_LIMIT else np.int64)
    tile[:, row % TILE, col % TILE] = first, second
    grid.add({(row // TILE, col // TILE): tile}, bound)


def make_grid(
    numbers: Mapping[Cell, tuple[int, int]] | None = None,
    resolution: float = 1.0,
    kind: EvidenceKind = EvidenceKind.COUNTS,
    unit: int = 1,
) -> TileGrid:
    """Evidence that has these two numbers in these cells."""
    grid = TileGrid(Lattice(resolution), kind, unit)
    for (row, col), (first, second) in (numbers or {}).items():
        add_cell(grid, row, col, first, second)
    return grid


def aim(angle_min: float, angle_increment: float, beams: int) -> Float64:
    """(B, 2) unit vectors."""
    bearings = angle_min + angle_increment * np.arange(beams)
    return np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)


MIDDLE = (0.5, 0.5)
"""Of cell (0, 0), in cells of a metre"""


def make_rays(
    origin: ArrayLike,
    direction: ArrayLike,
    distance: ArrayLike,
    kind: ArrayLike = Kind.HIT,
    stamp_ns: ArrayLike = 0,
    *,
    full_circle: bool = False,
) -> Rays:
    """Scans of S x B beams; what is given once holds for all of them.

    Parameters
    ----------
    origin, direction
        (2,) or (S, K, 2); (2,), (B, 2) or (S, B, 2).
    distance, kind, stamp_ns
        A number, (B,) or (S, B); the same; a number or (S,).
    """
    places, ways = np.asarray(origin, float), np.asarray(direction, float)
    places = places if places.ndim == 3 else places[None, None]
    shape = np.broadcast_shapes(
        (len(places), 1), ways.shape[:-1], np.shape(distance), np.shape(kind)
    )
    # Contiguous, or kernels would be compiled once more, for arrays that no sensor gives.
    return Rays.along(
        np.array(np.broadcast_to(places, (shape[0], *places.shape[1:])), order="C"),
        np.array(np.broadcast_to(ways, (*shape, 2)), order="C"),
        np.array(np.broadcast_to(np.asarray(distance, np.float32), shape), order="C"),
        np.array(np.broadcast_to(np.asarray(kind, np.uint8), shape), order="C"),
        np.array(np.broadcast_to(np.asarray(stamp_ns, np.int64), shape[:1]), order="C"),
        full_circle=full_circle,
    )


def make_scan(*beams: tuple[float, Kind]) -> Rays:
    """Beams along the middle of a row of cells of 1 m, from the middle of the first."""
    reach, kinds = zip(*beams, strict=True)
    return make_rays(MIDDLE, (1, 0), reach, kinds)


def draw_scans(rng: np.random.Generator, scans: int, increment: float, beams: int) -> Rays:
    """Scans of beams of every kind, all around from a few metres about zero."""
    return make_rays(
        rng.uniform(-2, 2, (scans, 1, 2)),
        aim(-1.0, increment, beams),
        rng.uniform(0.5, 8, (scans, beams)),
        rng.choice(np.array(Kind, np.uint8), (scans, beams)),
    )


def take(rays: Rays, scans: list[int]) -> Rays:
    """Some of the scans, in the order given."""
    return rays.take(np.array(scans))  # numbers serve as a mask does


class Drive(NamedTuple):
    """Rays and the lattice that they are meant for."""

    rays: Rays
    resolution: float


def draw_random(draw: st.DrawFn) -> np.random.Generator:
    """What is drawn in bulk; only its seed shrinks."""
    return np.random.default_rng(draw(st.integers(0, 2**32)))


@st.composite
def kinds(draw: st.DrawFn, shape: tuple[int, int]) -> UInt8:
    """(S, B) of Kind: of one sort only, or mixed."""
    shares = draw(st.sampled_from([*MIXED, (0, 0, 1), (0, 1, 0), (1, 0, 0), *MIXED, *MIXED]))
    return draw_random(draw).choice(np.array(Kind, np.uint8), shape, p=shares)


@st.composite
def distances(draw: st.DrawFn, shape: tuple[int, int]) -> Float64:
    """(S, B) in cells: walls with steps, now and then no length at all."""
    rng = draw_random(draw)
    far = draw(st.sampled_from([14.0, 8.0, 4.0, 0.3, 0.0, 14.0, 18.0]))
    wall = np.repeat(rng.uniform(0, far, (shape[0], -(-shape[1] // 6))), 6, axis=1)[:, : shape[1]]
    rough = wall + rng.normal(0, draw(st.sampled_from([0.1, 0.0, 2.0])), shape)
    return np.where(rng.random(shape) < 0.05, 0.0, np.clip(rough, 0, 20))


@st.composite
def origins(draw: st.DrawFn, scans: int, viewpoints: int) -> Float64:
    """(S, K, 2) in cells, beside the world's zero: a drive, and some way within each scan."""
    rng, apart = draw_random(draw), draw(st.sampled_from([0.0, 0.5, 8.0]))
    inside = draw(st.sampled_from([0.05, 1.0]))
    start = rng.uniform(-apart, apart, (scans, 1, 2))
    return np.asarray(start + rng.normal(0, inside, (scans, viewpoints, 2)))


@st.composite
def drives(
    draw: st.DrawFn,
    resolutions: tuple[float, ...] = (0.01, 0.05, 0.25, 1.0),
    places: tuple[float, ...] = (0.0, 1e5, -1e5),
) -> Drive:
    """Up to three scans, somewhere, with a viewpoint a scan or one a beam.

    They are a narrow fan, a wide one, a circle, or more than a circle, either way round.
    """
    scans, beams = draw(st.integers(1, 3)), draw(st.sampled_from([40, 1, 2, 3, 7, 25, 32, 39, 48]))
    turn = math.tau / beams
    width = draw(st.sampled_from([0.03, 0.1, turn * 0.6, turn, turn * 1.1, turn * 1.4]))
    increment, first = width * draw(st.sampled_from([1, -1])), draw(st.floats(-4, 4))
    headings = draw(st.lists(st.floats(-3, 3), min_size=scans, max_size=scans))
    resolution = draw(st.sampled_from(resolutions))
    place = np.array([draw(st.sampled_from(places)), draw(st.sampled_from(places))])
    viewpoints = draw(origins(scans, draw(st.sampled_from([1, 1, beams]))))
    kind = draw(kinds((scans, beams)))
    rays = make_rays(
        place + viewpoints * resolution,
        np.stack([aim(first + heading, increment, beams) for heading in headings]),
        draw(distances((scans, beams))) * resolution * (kind > 0),
        kind,
        draw(st.lists(STAMPS, min_size=scans, max_size=scans)),
        full_circle=(beams + 0.5) * width >= math.tau,
    )
    return Drive(rays, resolution)


@st.composite
def upright_drives(draw: st.DrawFn) -> Drive:
    """Scans of an upright lidar, some of whose beams point exactly straight up or down.

    In some all others point one of two ways on the map, as its beams lie in one plane.
    """
    rays, resolution = draw(drives())
    share = draw(st.sampled_from([0.05, 0.5, 1.0, 0.0]))
    vertical = draw_random(draw).random(rays.kind.shape) < share
    direction = np.where(vertical[..., None], 0.0, rays.direction)
    if draw(st.booleans()):
        plane = draw(st.sampled_from([0.0, 1.0, math.pi / 2, -2.5, math.pi]))
        direction = direction[..., :1] * np.array([math.cos(plane), math.sin(plane)])
    turned = make_rays(rays.origin, direction, rays.distance, rays.kind, rays.stamp_ns)
    return Drive(turned._replace(full_circle=rays.full_circle), resolution)


TWELVE = [
    (5, 0), (4, 3), (3, 4), (0, 5), (-3, 4), (-4, 3), (-5, 0), (-4, -3), (-3, -4), (0, -5),
    (3, -4), (4, -3),
]  # fmt: skip
"""Of length 5, all the way round: five cells along any of them ends on the lattice again."""


@st.composite
def aligned_drives(draw: st.DrawFn) -> Drive:
    """One scan of a full circle or less in which all lies on centres and borders of cells."""
    resolution, beams = draw(st.sampled_from([0.25, 1.0])), draw(st.integers(1, 12))
    rng, sense = draw_random(draw), draw(st.sampled_from([1, -1]))
    distance = rng.integers(0, 7, (1, beams)) * draw(st.sampled_from([1.0, 2.5]))
    kind = draw(kinds((1, beams)))
    rays = make_rays(
        rng.integers(-4, 5, (1, 1, 2)) * resolution / 2,
        np.array(TWELVE[::sense][:beams]) / 5,
        distance * resolution * (kind > 0),
        kind,
        full_circle=beams == 12,
    )
    return Drive(rays, resolution)


def assert_same_slices(one: Slices, other: Slices) -> None:
    """They are equal to a byte."""
    for name in Slices.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def shift(rays: Rays, metres: tuple[float, float]) -> Rays:
    return rays._replace(origin=rays.origin + np.array(metres))
