"""A workload as a log of every format, written by what writes the sample logs."""

from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

from rosbags.rosbag2 import StoragePlugin

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.types import Update
from tests.bench.measuring import ROUNDS
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


WHOLE = "whole"
READING = ("open", "poses", "read")
"""Which of these a format reads its file in is its own affair."""

Stages = Mapping[str, float]
"""Seconds by stage."""


def measure_stages(workload: Workload, folder: Path) -> dict[str, Stages]:
    """Build from every format with one thread, the polygon update, and a PGM and a PNG."""
    logs = {name: write(workload, folder) for name, write in FORMATS.items()}
    found: dict[str, list[Stages]] = {name: [] for name in logs}
    for _ in range(ROUNDS):
        for name, log in logs.items():
            found[name].append(time_build(log, folder))
    return {name: take_shortest(builds) for name, builds in found.items()}


def time_build(log: Path, folder: Path) -> Stages:
    """Build once."""
    options = BuildOptions(update=Update.POLYGON, jobs=1)
    start = perf_counter()
    report = build([log], options, [folder / "map.pgm", folder / "map.png"]).report
    whole = perf_counter() - start
    reading = sum(report.seconds.get(stage, 0.0) for stage in READING)
    others = {stage: s for stage, s in report.seconds.items() if stage not in READING}
    return {"read": reading, **others, WHOLE: whole}


def take_shortest(builds: list[Stages]) -> Stages:
    """Each stage where it went best: no ratio is made of these."""
    return {stage: min(build[stage] for build in builds) for stage in builds[0]}
