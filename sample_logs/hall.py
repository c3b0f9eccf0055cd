"""A drive through a hall with a 3D lidar of 16 rings, as clouds of points.

What a robot of 1.5 m must not run into stands beside what it need not mind: a table and a box of
18 cm, and a cable duct of 6 cm, a lamp at 2 m and a ramp to a platform at 0.3 m.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LENGTH, WIDTH, HEIGHT, WALL = 10.0, 6.0, 2.8, 0.1
"""The hall begins at x = 0, y = 0 (m)."""
RAMP_FROM, RAMP_TO, PLATFORM = 6.0, 8.5, 0.3
"""Where along x the ramp begins and ends, and how high it leads (m)"""
RINGS: Floats = np.radians(np.arange(-15.0, 16.0, 2.0))
BEARINGS: Floats = np.radians(np.arange(0.0, 360.0, 3.0))
SENSOR_HEIGHT = 0.6
NOISE_SIGMA = 0.01
SPACING, START_NS, CLOUD_INTERVAL_NS = 0.35, 1_700_000_000_000_000_000, 100_000_000
WAY: Floats = np.array([[1.0, 1.0], [1.2, 4.6], [4.4, 4.8], [5.0, 2.2], [9.2, 2.6]])


class Block(NamedTuple):
    """A solid with sides along the axes: its lowest and its highest x, y and z (m)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


BLOCKS = [
    Block((-WALL, -WALL, 0.0), (LENGTH + WALL, 0.0, HEIGHT)),
    Block((-WALL, WIDTH, 0.0), (LENGTH + WALL, WIDTH + WALL, HEIGHT)),
    Block((-WALL, 0.0, 0.0), (0.0, WIDTH, HEIGHT)),
    Block((LENGTH, 0.0, 0.0), (LENGTH + WALL, WIDTH, HEIGHT)),
    Block((0.0, 0.0, HEIGHT), (LENGTH, WIDTH, HEIGHT + WALL)),
    Block((2.4, 2.4, 0.7), (3.8, 3.2, 0.75)),  # the table, on four legs
    *(Block((x, y, 0.0), (x + 0.05, y + 0.05, 0.7)) for x in (2.4, 3.75) for y in (2.4, 3.15)),
    Block((0.5, 2.5, 0.0), (0.9, 2.9, 0.18)),  # the box
    Block((2.0, 0.0, 0.0), (2.06, 1.6, 0.06)),  # the cable duct
    Block((4.5, 3.3, 2.0), (5.1, 3.9, 2.2)),  # the lamp
    Block((RAMP_TO, 0.0, 0.0), (LENGTH, WIDTH, PLATFORM)),
]


@dataclass(frozen=True)
class CloudDrive:
    """What the robot recorded."""

    stamp_ns: list[int]
    place: Floats
    """(S, 3) of the robot on the floor (m)"""
    turn: Floats
    """(S, 3, 3) from the robot to the map"""
    points: list[Floats]
    """(N, 3) of each cloud, whole millimetres in the frame of the lidar"""


def floor_at(x: Floats) -> Floats:
    """Height of the floor, the ramp and the platform (m)."""
    return np.asarray(np.clip((x - RAMP_FROM) / (RAMP_TO - RAMP_FROM), 0, 1) * PLATFORM)


def simulate_cloud_drive() -> CloudDrive:
    """Drive along the way, up the ramp, and look round every quarter of a metre."""
    rng = np.random.default_rng(1989)
    corner_at = np.append(0.0, np.hypot(*np.diff(WAY, axis=0).T).cumsum())
    along = np.arange(0.0, corner_at[-1], SPACING)
    x, y = (np.interp(along, corner_at, WAY[:, axis]).round(3) for axis in (0, 1))
    place = np.column_stack([x, y, floor_at(x).round(3)])
    turn = np.array([_face(*step) for step in np.gradient(place, axis=0)])
    points = [_look(*pose, rng) for pose in zip(place, turn, strict=True)]
    stamps = [START_NS + i * CLOUD_INTERVAL_NS for i in range(len(along))]
    return CloudDrive(stamps, place, turn, points)


def _face(x: float, y: float, z: float) -> Floats:
    """Turn a robot along a step."""
    yaw, pitch = math.atan2(y, x), -math.atan2(z, math.hypot(x, y))
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])


def _look(place: Floats, turn: Floats, rng: np.random.Generator) -> Floats:
    """Measure one cloud, (N, 3) in the frame of the lidar."""
    ring, bearing = (each.ravel() for each in np.meshgrid(RINGS, BEARINGS, indexing="ij"))
    level = np.cos(ring)
    rays = np.column_stack([level * np.cos(bearing), level * np.sin(bearing), np.sin(ring)])
    sensor = place + SENSOR_HEIGHT * turn[:, 2]
    # Near enough to a normal distribution, and the same numbers in every version of NumPy.
    noise = NOISE_SIGMA * (rng.random((12, len(rays))).sum(axis=0) - 6)
    ranges = cast_rays(sensor, rays @ turn.T) + noise
    return np.asarray((rays * ranges[:, None]).round(3))


def cast_rays(start: Floats, rays: Floats) -> Floats:
    """Measure how far rays (N, 3) of length 1 reach, up to a block, the floor or the ramp (m)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = [_meet_block(start, rays, block) for block in BLOCKS]
        reach.append(-start[2] / rays[:, 2])
        slope = PLATFORM / (RAMP_TO - RAMP_FROM)
        above = start[2] - slope * (start[0] - RAMP_FROM)
        ramp = above / (slope * rays[:, 0] - rays[:, 2])
        x = start[0] + ramp * rays[:, 0]
        reach.append(np.where((x >= RAMP_FROM) & (x <= RAMP_TO), ramp, np.inf))
    met = np.array(reach)
    return np.asarray(np.where(met > 0, met, np.inf).min(axis=0))


def _meet_block(start: Floats, rays: Floats, block: Block) -> Floats:
    """Where rays from outside enter a block (Kay and Kajiya 1986); inf where they miss it."""
    ways = [(np.array(side) - start) / rays for side in block]
    enter, leave = np.minimum(*ways).max(axis=1), np.maximum(*ways).min(axis=1)
    return np.asarray(np.where(enter <= leave, enter, np.inf))
