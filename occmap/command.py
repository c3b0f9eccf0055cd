"""The `occmap build` line that makes a map: options as the flags that a user would type."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

from occmap.batching import Selection
from occmap.pipeline import BuildOptions
from occmap.posing.options import PosingOptions
from occmap.readers.options import ReaderOptions
from occmap.sensor.returns import ReturnOptions
from occmap.types import Pose

Group = TypeVar("Group", BuildOptions, PosingOptions, ReaderOptions, ReturnOptions, Selection)

LATTICE_FLAGS = {"resolution": "--resolution"}
GRID_FLAGS = {
    "jump": "--jump",
    "hit_offset": "--hit-offset",
    "border_gap": "--border-gap",
    "max_cells": "--max-cells",
}
SELECTION_FLAGS = {"start_s": "--start", "end_s": "--end", "stride": "--stride"}
POSING_FLAGS = {
    "map_frame": "--map-frame",
    "base_frame": "--base-frame",
    "poses": "--poses",
    "max_pose_gap_s": "--max-pose-gap",
    "max_speed": "--max-speed",
    "time_offset_s": "--time-offset",
    "deskew": "--deskew",
    "stamps": "--stamps",
}
READER_FLAGS = {
    "echo": "--echo",
    "min_height": "--min-height",
    "max_height": "--max-height",
}
RETURN_FLAGS = {
    "min_range": "--min-range",
    "max_range": "--max-range",
    "range_max": "--range-max",
    "no_return": "--no-return",
}


def compose_build(
    logs: Sequence[str], options: BuildOptions, flags: Mapping[str, str], update: str = ""
) -> tuple[str, ...]:
    """Compose the words of an `occmap build`.

    Parameters
    ----------
    options
        Those that differ from their defaults are written; not so update, model and outputs.
    flags
        More, which override those of the options.
    """
    words = [word for pair in {**list_given(options), **flags}.items() for word in pair]
    words += list_repeatable(options)
    start = ("occmap", "build", update) if update else ("occmap", "build")
    return (*start, *logs, *words, "-o", f"{name_map(logs[0])}.pgm")


def name_map(path: str) -> str:
    """Name a map after its log: the base name without what it is packed and written in."""
    name = Path(path).resolve().name.removesuffix(".gz")
    return Path(name).stem or "map"


def list_given(options: BuildOptions) -> dict[str, str]:
    """List the options that differ from their defaults and may be given once, as flags."""
    flags = _list_changed(options, BuildOptions(), LATTICE_FLAGS)
    flags |= _list_changed(options.reading, ReaderOptions(), READER_FLAGS)
    flags |= _list_changed(options.posing, PosingOptions(), POSING_FLAGS)
    flags |= _list_changed(options.returns, ReturnOptions(), RETURN_FLAGS)
    flags |= _list_changed(options.selection, Selection(), SELECTION_FLAGS)
    flags |= _list_changed(options, BuildOptions(), GRID_FLAGS)
    if options.posing.sensor_pose is not None:
        flags["--sensor-pose"] = format_mount(options.posing.sensor_pose)
    if options.posing.transform is not None:
        flags["--transform"] = format_mount(options.posing.transform)
    if options.returns.footprint is not None:
        flags["--footprint"] = _join(options.returns.footprint)
    return flags


def list_repeatable(options: BuildOptions) -> list[str]:
    """List the words of the options that may be given more than once."""
    words = []
    for sample in options.posing.static_transforms:
        words += ["--static-tf", format_static(sample.parent, sample.child, sample.pose)]
    for sector in options.returns.ignore_sectors:
        words += ["--ignore-sector", _join(sector)]
    for topic in options.selection.topics:
        words += ["--scan-topic", topic]
    return words


def format_mount(pose: Pose) -> str:
    """Write a pose as --sensor-pose takes it: x,y,yaw, and roll,pitch where it is not level."""
    roll, pitch, yaw = to_rpy(pose)
    level = abs(roll) < 1e-6 and abs(pitch) < 1e-6
    return _join([pose.x, pose.y, yaw] if level else [pose.x, pose.y, yaw, roll, pitch])


def format_static(parent: str, child: str, pose: Pose) -> str:
    """Write a transform as --static-tf takes it: parent,child,x,y,z,roll,pitch,yaw."""
    return f"{parent},{child},{_join([pose.x, pose.y, pose.z, *to_rpy(pose)])}"


def to_rpy(pose: Pose) -> tuple[float, float, float]:
    """Roll, pitch and yaw about fixed axes (rad) of a pose's rotation (REP 103)."""
    _, _, _, x, y, z, w = pose
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def _join(numbers: Sequence[float]) -> str:
    """Join numbers, to hundredths of a millimetre and without a negative zero."""
    return ",".join(f"{round(number, 5) + 0.0:.12g}" for number in numbers)


def _list_changed(
    given: Group,
    default: Group,
    flags: dict[str, str],
) -> dict[str, str]:
    changed = {}
    for name in (item.name for item in fields(given) if item.name in flags):
        value = getattr(given, name)
        if value != getattr(default, name):
            changed[flags[name]] = f"{value:.12g}" if isinstance(value, float) else str(value)
    return changed
