"""The sample drive with something wrong: scans in one file, and the robot's poses in another."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from occmap.types import Float64
from tests.csv_logs import write_poses, write_scans
from tests.samples import SAMPLE_LOGS, Planar, import_generator

drive = import_generator("drive")
NOWHERE: Planar = (0.0, 0.0, 0.0)
NAMES = ("angle_min", "angle_increment", "range_max")
SHAPE: dict[str, float] = {name: getattr(drive.SENSOR, name) for name in NAMES}
"""Of all scans"""


def read_drive() -> Float64:
    """(S, 4 + B): of each scan its stamp (s), x, y and yaw of the laser, and ranges (m)."""
    return np.loadtxt(SAMPLE_LOGS / "drive.csv", delimiter=",", skiprows=5)


def write_drive(
    folder: Path, delay: Callable[[int], float] = lambda _: 0.0, mount: Planar = NOWHERE
) -> tuple[Path, Path]:
    """Write scans without poses, each stamped too late by a delay (s), and a file of poses.

    These are of the robot, whose laser sits at a mount on it.
    """
    rows = read_drive()
    stamps, back = rows[:, 0] - 1.7e9, drive.invert(drive.Planar(*mount))
    robot = [drive.compose(drive.Planar(*laser), back) for laser in rows[:, 1:4]]
    late = stamps + [delay(number) for number in range(len(rows))]
    scans = write_scans(folder / "scans.csv", late, rows[:, 4:], **SHAPE)
    return scans, write_poses(folder / "poses.csv", stamps, robot)


def write_parts(folder: Path, turns_deg: Sequence[float], scans: int) -> list[Path]:
    """Write parts of the drive, each in a frame of its own, with its laser turned by so much.

    The frame of the first is turned by a right angle, and the others lie beside it.
    """
    parts = []
    for part, rows in enumerate(np.array_split(read_drive(), len(turns_deg))):
        stamps, x, y, yaw = rows[:scans, :4].T
        ahead = yaw + math.pi / 2 - math.radians(turns_deg[part])
        poses, ranges = np.column_stack([20 * part - y, x, ahead]), rows[:scans, 4:]
        log = folder / f"part{part}.csv"
        parts.append(write_scans(log, stamps, ranges, poses, **SHAPE))
    return parts
