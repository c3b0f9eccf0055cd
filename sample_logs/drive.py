"""The drive through the office: where the robot went and what its laser measured."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from typing import NamedTuple

import numpy as np
from office import PILLAR, RESOLUTION, WAY, Floats, cast_rays, office_faces

BEAMS = 271
ANGLE_MIN = float(np.float32(math.radians(-135)))
ANGLE_INCREMENT = float(np.float32(math.radians(1)))
BEARINGS: Floats = ANGLE_MIN + ANGLE_INCREMENT * np.arange(BEAMS, dtype=np.float64)
RANGE_MIN, RANGE_MAX = 0.0625, 8.0
NOISE_SIGMA = 0.01
SCAN_SPACING, LOOK_AHEAD = 0.2, 0.6
"""Metres along the way: between scans, and to the point that the robot faces."""
START_NS, SCAN_INTERVAL_NS = 1_700_000_000_000_000_000, 200_000_000


class Planar(NamedTuple):
    """A pose in the plane (m, m, rad)."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True)
class Sensor:
    """A level laser."""

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    interval_ns: int
    """From scan to scan"""


SENSOR = Sensor(BEAMS, ANGLE_MIN, ANGLE_INCREMENT, RANGE_MIN, RANGE_MAX, SCAN_INTERVAL_NS)
MAP_TO_ODOM = Planar(0.75, -0.5, 0.125)
LASER_MOUNT = Planar(0.25, 0.0, 0.0)


@dataclass(frozen=True)
class Drive:
    """What the robot recorded."""

    stamp_ns: list[int]
    laser: list[Planar]
    """In the map frame."""
    ranges: Floats
    """(S, B) m, whole millimetres; inf where nothing came back"""
    sensor: Sensor = SENSOR


def simulate_drive() -> Drive:
    """Drive along the way and scan."""
    rng = np.random.default_rng(1985)
    faces = office_faces()
    scans = [_scan(place, faces, rng) for place in _places_along(WAY)]
    stamps = [START_NS + i * SCAN_INTERVAL_NS for i in range(len(scans))]
    return Drive(stamps, [pose for pose, _ in scans], np.array([ranges for _, ranges in scans]))


def _places_along(way: Floats) -> Iterator[Planar]:
    """Yield where the laser is at each scan."""
    steps = [math.dist(start, end) for start, end in pairwise(way)]
    corner_at = np.concatenate([[0], np.cumsum(steps)])
    for at in np.arange(0, corner_at[-1] - LOOK_AHEAD, SCAN_SPACING):
        x, y = (float(np.interp(at, corner_at, way[:, axis])) for axis in (0, 1))
        to_x, to_y = (np.interp(at + LOOK_AHEAD, corner_at, way[:, axis]) for axis in (0, 1))
        yield Planar(x, y, math.atan2(to_y - y, to_x - x))


def _scan(place: Planar, faces: Floats, rng: np.random.Generator) -> tuple[Planar, Floats]:
    """Scan at a place, or less than a few millimetres beside it."""
    # Near enough to a normal distribution, and the same numbers in every version of NumPy.
    noise = NOISE_SIGMA * (rng.random((12, BEAMS)).sum(axis=0) - 6)
    for attempt in count():
        pose = Planar(
            round(place.x + 3e-4 * attempt, 4),
            round(place.y + 2e-4 * attempt, 4),
            round(place.yaw, 4),
        )
        truth = cast_rays((pose.x, pose.y), pose.yaw + BEARINGS, faces, PILLAR)
        ranges = np.round(truth + noise, 3)
        ranges[ranges >= RANGE_MAX] = np.inf
        if _ends_are_unambiguous(pose, ranges):
            break
    return pose, ranges


def _ends_are_unambiguous(pose: Planar, ranges: Floats) -> bool:
    """Whether sensor and beam ends are 1e-6 cell clear of every multiple of 1/512 cell.

    So neither rounding nor truncating to 1/256 cell depends on the last bits.
    """
    reach = np.minimum(ranges, RANGE_MAX).astype(np.float32)  # as logs hold them
    x = pose.x + np.append(reach * np.cos(pose.yaw + BEARINGS), 0)
    y = pose.y + np.append(reach * np.sin(pose.yaw + BEARINGS), 0)
    steps = np.concatenate([x, y]) / RESOLUTION * 512
    return bool((np.abs(steps - np.rint(steps)) > 512e-6).all())


def compose(outer: Planar, inner: Planar) -> Planar:
    """Return a pose that is given in the frame `outer` in the frame that `outer` is given in."""
    c, s = math.cos(outer.yaw), math.sin(outer.yaw)
    return Planar(
        round(outer.x + c * inner.x - s * inner.y, 10),
        round(outer.y + s * inner.x + c * inner.y, 10),
        outer.yaw + inner.yaw,
    )


def invert(pose: Planar) -> Planar:
    """Return the inverse transform."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return Planar(-c * pose.x - s * pose.y, s * pose.x - c * pose.y, -pose.yaw)
