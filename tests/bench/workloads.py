"""The scans that are measured on: the same in every run, ray-cast through simple floor plans."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from occmap.posing import Stamps
from occmap.readers import Role, open_log
from occmap.scans.stream import BATCH_BEAMS, stack
from occmap.sensor import ReturnOptions
from occmap.sensor.bands import RangeLimits
from occmap.types import Float32, Float64, PosedScans, ScanBatch
from tests.bench.plans import YARD, YARD_WAY, Box, cast_scans, corridor, office, office_way

NOISE_SIGMA = 0.01
LOOK_AHEAD = 0.8
"""Metres along the way to the point that the robot faces."""
SCAN_INTERVAL_NS = 25_000_000
START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Sensor:
    """A level laser."""

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float

    @classmethod
    def spanning(cls, beams: int, degrees: float, range_max: float) -> Self:
        """A sensor that looks ahead; its angles are float32 values, as logs hold them."""
        gaps = beams if degrees == 360 else beams - 1
        angle_min, increment = -math.radians(degrees) / 2, math.radians(degrees) / gaps
        return cls(
            beams, float(np.float32(angle_min)), float(np.float32(increment)), 0.05, range_max
        )

    @property
    def bearings(self) -> Float64:
        """(B,) rad"""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)


@dataclass(frozen=True)
class Workload:
    """Scans with known poses: where occmap's stages and the yardstick begin."""

    name: str
    resolution: float
    sensor: Sensor
    poses: Float64
    """(S, 3) x, y, yaw of the sensor in the map frame (m, m, rad)"""
    ranges: Float32
    """(S, B) m; inf where nothing came back"""

    @property
    def scans(self) -> int:
        """How many scans."""
        return len(self.poses)

    @property
    def mean_range(self) -> float:
        """Of the beams that came back (m)."""
        return float(self.ranges[self.ranges < self.sensor.range_max].mean())

    @property
    def stamp_ns(self) -> list[int]:
        """When the scans were made, 40 a second."""
        return [START_NS + i * SCAN_INTERVAL_NS for i in range(self.scans)]

    def thin(self, stride: int) -> Self:
        """Every n-th scan."""
        return replace(self, poses=self.poses[::stride], ranges=self.ranges[::stride])

    def pose_scans(self) -> Iterator[PosedScans]:
        """Batches as occmap's sensor stage takes them, of the size that its pipeline makes."""
        size = max(BATCH_BEAMS // self.sensor.beams, 1)
        for start in range(0, self.scans, size):
            yield self._pose_batch(slice(start, start + size))

    def _pose_batch(self, scans: slice) -> PosedScans:
        poses, sensor = self.poses[scans], self.sensor
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        rotation = np.zeros((len(poses), 3, 3))
        rotation[:, 0, 0], rotation[:, 0, 1] = cosine, -sine
        rotation[:, 1, 0], rotation[:, 1, 1] = sine, cosine
        rotation[:, 2, 2] = 1
        batch = ScanBatch(
            frame="laser",
            angle_min=sensor.angle_min,
            angle_increment=sensor.angle_increment,
            range_min=sensor.range_min,
            range_max=sensor.range_max,
            stamp_ns=np.arange(len(poses)),
            record_ns=np.arange(len(poses)),
            ranges=self.ranges[scans],
            time_increment=np.zeros(len(poses)),
        )
        position = np.column_stack([poses[:, :2], np.zeros(len(poses))])
        return PosedScans(batch, position, rotation)


def make_office(name: str, sensor: Sensor, scans: int) -> Workload:
    """Drive through an office of eight rooms along a corridor, 44 x 30 m, at 5 cm."""
    poses = follow(office_way(), scans)
    return Workload(name, 0.05, sensor, poses, measure(poses, sensor, office()))


def make_yard(name: str, sensor: Sensor, scans: int, resolution: float = 0.1) -> Workload:
    """Drive round a factory yard, 170 x 130 m."""
    poses = follow(YARD_WAY, scans)
    return Workload(name, resolution, sensor, poses, measure(poses, sensor, YARD))


def make_corridor(sensor: Sensor, length: float, spacing: float, width: float = 3.0) -> Workload:
    """Drive straight on between two walls, at 5 cm; a scan every `spacing` metres."""
    x = np.arange(0, length, spacing)
    poses = np.stack([x, np.full_like(x, 0.01), np.zeros_like(x)], axis=1)
    ranges = measure(poses, sensor, corridor(length, width))
    return Workload(f"corridor of {length / 1000:g} km", 0.05, sensor, poses, ranges)


def read_workload(path: Path, resolution: float) -> Workload:
    """Read a log that states a pose beside each scan, all of one geometry."""
    log = open_log(path)
    topics = [stream.topic for stream in log.streams if stream.role is Role.SCAN]
    limits = RangeLimits(ReturnOptions())
    for scan in log.scans(topics):
        limits.see(scan)
    limits.settle()
    batches = list(map(limits.apply, stack(log.scans(topics), Stamps.HEADER)))
    one, beams = batches[0], batches[0].ranges.shape[1]
    sensor = Sensor(beams, one.angle_min, one.angle_increment, one.range_min, one.range_max)
    pose = np.concatenate([batch.pose for batch in batches if batch.pose is not None])
    poses = np.stack([pose[:, 0], pose[:, 1], 2 * np.arctan2(pose[:, 5], pose[:, 6])], axis=1)
    ranges = np.concatenate([batch.ranges for batch in batches])
    return Workload(path.name.split(".")[0], resolution, sensor, poses, ranges)


def follow(way: Float64, scans: int) -> Float64:
    """Spread scans evenly along a way (N, 2): (S, 3) poses that face where it goes."""
    corner_at = np.append(0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
    at = np.linspace(0, corner_at[-1] - LOOK_AHEAD, scans)
    x, y = (np.interp(at, corner_at, axis) for axis in way.T)
    to_x, to_y = (np.interp(at + LOOK_AHEAD, corner_at, axis) for axis in way.T)
    return np.round(np.stack([x, y, np.arctan2(to_y - y, to_x - x)], axis=1), 4)


def measure(poses: Float64, sensor: Sensor, boxes: list[Box]) -> Float32:
    """Scan at every pose: whole millimetres with 1 cm noise, inf where nothing came back."""
    ranges = cast_scans(poses, sensor.bearings, np.array(boxes, np.float64))
    noise = np.random.default_rng(1985).standard_normal(ranges.shape, np.float32)
    noisy = np.maximum(np.round(ranges + NOISE_SIGMA * noise, 3), 0.1)
    return np.where(noisy < sensor.range_max, noisy, np.inf).astype(np.float32)
