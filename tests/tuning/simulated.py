"""The sample drive with something wrong: scans in one file, and the robot's poses in another."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from occmap.choices import to_rpy
from occmap.readers import open_log
from occmap.types import Scan
from tests.csv_logs import write_poses, write_scans
from tests.samples import SAMPLE_LOGS, Planar

NOWHERE: Planar = (0.0, 0.0, 0.0)


def read_drive() -> list[Scan]:
    """The scans of the drive, each with the pose that it was simulated from."""
    log = open_log(SAMPLE_LOGS / "drive.csv")
    return list(log.scans([log.streams[0].topic]))


def find_body(laser: Planar, mount: Planar) -> Planar:
    """Where the robot is whose laser sits at a mount on it."""
    (x, y, yaw), (forward, left, turn) = laser, mount
    ahead = yaw - turn
    return (
        x - math.cos(ahead) * forward + math.sin(ahead) * left,
        y - math.sin(ahead) * forward - math.cos(ahead) * left,
        ahead,
    )


def write_drive(
    folder: Path, delay: Callable[[int], float] = lambda _: 0.0, mount: Planar = NOWHERE
) -> tuple[Path, Path]:
    """Write scans without poses, each stamped too late by a delay (s), and a file of poses."""
    drive = read_drive()
    seconds = np.array([scan.stamp_ns for scan in drive]) / 1e9 - 1.7e9
    late = seconds + [delay(number) for number in range(len(drive))]
    lasers = [scan.pose for scan in drive if scan.pose]
    places = [find_body((pose.x, pose.y, to_rpy(pose)[2]), mount) for pose in lasers]
    shape = {"angle_min": drive[0].angle_min, "angle_increment": drive[0].angle_increment}
    ranges = np.array([scan.ranges for scan in drive])
    scans = write_scans(folder / "scans.csv", late, ranges, **shape, range_max=8)
    return scans, write_poses(folder / "poses.csv", seconds, places)


def write_parts(folder: Path, turns_deg: Sequence[float], scans: int) -> list[Path]:
    """Write parts of the drive, each in a frame of its own, with its laser turned by so much.

    The frame of the first is turned by a right angle, and the others lie beside it.
    """
    lines = (SAMPLE_LOGS / "drive.csv").read_text().splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line[0].isdigit())
    parts = []
    for part, turn in enumerate(turns_deg):
        rows, begin = [], first + part * (len(lines) - first) // len(turns_deg)
        for line in lines[begin : begin + scans]:
            stamp, x, y, yaw, *ranges = line.split(",")
            away, ahead = 20.0 * part - float(y), float(yaw) + math.pi / 2 - math.radians(turn)
            rows.append(",".join([stamp, f"{away!r}", x, f"{ahead!r}", *ranges]))
        parts.append(folder / f"part{part}.csv")
        parts[-1].write_text("".join([*lines[:first], *rows]))
    return parts
