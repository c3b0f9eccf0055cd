"""The sample drive with something wrong: scans in one file, and the robot's poses in another."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path

import numpy as np

from occmap.types import Float64
from tests.bench.plans import cast_scans
from tests.csv_logs import write_poses, write_scans
from tests.readers.ros import ROS1, SECOND, Written, scan, write_bag1
from tests.samples import SAMPLE_LOGS, Planar, import_generator

drive = import_generator("drive")
NOWHERE: Planar = (0.0, 0.0, 0.0)
SPARSE = slice(4, None, 3)
"""Columns of the ranges that are written: every third beam shows as much, in half of the time"""
NAMES = ("angle_min", "angle_increment", "range_max")
SHAPE: dict[str, float] = {name: getattr(drive.SENSOR, name) for name in NAMES}
"""Of all scans"""
SHAPE["angle_increment"] *= SPARSE.step


@cache
def read_drive() -> Float64:
    """(S, 4 + B): of each scan its stamp (s), x, y and yaw of the laser, and ranges (m)."""
    return np.loadtxt(SAMPLE_LOGS / "drive.csv", delimiter=",", skiprows=5)


def write_drive(
    folder: Path, delay: Callable[[int], float] = lambda _: 0.0, mount: Planar = NOWHERE
) -> tuple[Path, Path]:
    """Write every second scan without its pose, stamped too late by a delay (s), and all poses.

    These are of the robot, whose laser sits at a mount on it.
    """
    rows = read_drive()
    stamps, back = rows[:, 0] - 1.7e9, drive.invert(drive.Planar(*mount))
    robot = [drive.compose(drive.Planar(*laser), back) for laser in rows[:, 1:4]]
    late = stamps + [delay(number) for number in range(len(rows))]
    scans = write_scans(folder / "scans.csv", late[::2], rows[::2, SPARSE], **SHAPE)
    return scans, write_poses(folder / "poses.csv", stamps, robot)


def write_parts(folder: Path, turns_deg: Sequence[float], scans: int) -> list[Path]:
    """Write parts of the drive, each in a frame of its own, with its laser turned by so much.

    The frame of the first is turned by a right angle, and the others lie beside it.
    """
    parts = []
    for part, rows in enumerate(np.array_split(read_drive(), len(turns_deg))):
        stamps, x, y, yaw = rows[:scans, :4].T
        ahead = yaw + math.pi / 2 - math.radians(turns_deg[part])
        poses, ranges = np.column_stack([20 * part - y, x, ahead]), rows[:scans, SPARSE]
        log = folder / f"part{part}.csv"
        parts.append(write_scans(log, stamps, ranges, poses, **SHAPE))
    return parts


ROOM = np.array([(-6, -4, 0, -4), (-6, 0, 0, 0), (-6, -4, -6, 0), (0, -4, 0, 0.0)])
"""Four walls of no thickness"""
SEATS = {"/front": (0.3, 0.0, 0.0), "/rear": (-0.3, 0.0, math.pi)}
"""Topics of two lasers, and where they sit on the robot; their frames are called likewise"""


def write_two_lasers(folder: Path, delay_s: float) -> tuple[Path, Path]:
    """Write a bag of scans that two lasers take in turn as they go round, and a file of poses."""
    turn = np.linspace(0, 2 * math.tau, 400)
    way = np.stack([1.8 * np.cos(turn) - 3, 0.9 * np.sin(turn) - 2, turn + math.pi / 2], axis=1)
    way[:, 2] += np.arctan(np.sin(2 * turn) / (3 - np.cos(2 * turn)))  # it looks ahead
    stamps = 100 + np.arange(400) / 5
    log, bearings = [], np.linspace(-2, 2, 81)
    for stamp, robot, topic in zip(stamps[20:-20], way[20:-20], cycle(SEATS), strict=False):
        laser = drive.compose(drive.Planar(*robot), drive.Planar(*SEATS[topic]))
        ranges = cast_scans(np.array([laser]), bearings, ROOM)[0].astype(np.float32)
        stamp_ns = round((stamp + delay_s) * SECOND)
        made = scan(ROS1, stamp_ns, topic[1:], ranges)
        shape = {"angle_min": -2.0, "angle_increment": 0.05, "time_increment": 0.0}
        log.append(Written(topic, stamp_ns, replace(made, **shape)))
    bag = write_bag1(folder / "two.bag", log)
    return bag, write_poses(folder / "poses.csv", stamps, way)
