"""A workload as a log of every format, written by what writes the sample logs."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin

from tests.bench.workloads import SCAN_INTERVAL_NS, Workload
from tests.samples import import_generator

drive, formats = import_generator("drive"), import_generator("formats")


def to_drive(workload: Workload) -> Any:
    """What the writers take."""
    poses = [drive.Planar(*pose) for pose in workload.poses.tolist()]
    sensor = drive.Sensor(**vars(workload.sensor), interval_ns=SCAN_INTERVAL_NS)
    return drive.Drive(workload.stamp_ns, poses, workload.ranges, sensor)


def write_mcap(workload: Workload, folder: Path) -> Path:
    """Write an MCAP file, with the folder around it that ROS 2 makes."""
    bag = folder / f"drive_mcap_{workload.scans}"
    formats.write_ros2(to_drive(workload), bag, StoragePlugin.MCAP)
    return bag / f"{bag.name}.mcap"


def write_as(name: str, write: Callable[[Any, Path], None]) -> Callable[[Workload, Path], Path]:
    """Make a function that writes a workload into a folder, and says where it is."""

    def write_workload(workload: Workload, folder: Path) -> Path:
        write(to_drive(workload), folder / name)
        return folder / name

    return write_workload


FORMATS: Mapping[str, Callable[[Workload, Path], Path]] = {
    "CSV": write_as("drive.csv", formats.write_csv),
    "CARMEN": write_as("drive.log", formats.write_carmen),
    "MCAP": write_mcap,
    "ROS 1 bag": write_as("drive.bag", formats.write_ros1),
    "ROS 2 sqlite3": write_as("drive_ros2", formats.write_ros2),
}
