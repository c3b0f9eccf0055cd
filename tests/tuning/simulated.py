"""The sample drive with something wrong: scans in one file, and the robot's poses in another."""

import math
from collections.abc import Callable
from pathlib import Path

from occmap.choices import to_rpy
from occmap.readers import open_log
from occmap.types import Scan
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
    scans, poses = folder / "scans.csv", folder / "poses.csv"
    drive = read_drive()
    first = drive[0]
    shape = {"angle_min": first.angle_min, "angle_increment": first.angle_increment}
    head = "".join(f"# {name}: {value!r}\n" for name, value in shape.items()) + "# range_max: 8\n"
    beams = range(len(first.ranges))
    rows, places = [], []
    for number, scan in enumerate(drive):
        assert scan.pose is not None
        seconds = scan.stamp_ns / 1e9 - 1.7e9
        ranges = ",".join(f"{value:.3f}" for value in scan.ranges)
        rows.append(f"{seconds + delay(number):.6f},{ranges}\n")
        x, y, yaw = find_body((scan.pose.x, scan.pose.y, to_rpy(scan.pose)[2]), mount)
        places.append(f"{seconds:.6f},{x!r},{y!r},{yaw!r}\n")
    scans.write_text(
        head + "stamp," + ",".join(f"r{beam}" for beam in beams) + "\n" + "".join(rows)
    )
    poses.write_text("stamp,x,y,yaw\n" + "".join(places))
    return scans, poses
