"""Where logs are for tests: the sample logs, real ones, and small ones written by hand."""

import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any
from unittest import SkipTest

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import ArrayLike

from occmap.options import BuildOptions
from occmap.sensor.models import SimpleModel
from occmap.types import ScanBatch, Update
from tests.csv_logs import write_scans

PLAIN = BuildOptions(update=Update.BEAM, model=SimpleModel(spread=0.0), hit_offset=0.0, jobs=1)
"""Each beam by itself, ends where they were measured: what a hand can work out"""
PLAIN_WORDS = ("beam", "--model", "simple:spread=0", "--hit-offset", "0")
"""The same on the command line, after `occmap build`"""

ROOT = Path(__file__).parent.parent
SAMPLE_LOGS = ROOT / "sample_logs"
DRIVES = [
    SAMPLE_LOGS / name
    for name in ("drive.csv", "drive.log", "drive.bag", "drive_ros2", "drive.mcap")
]
"""The same drive in every format."""


def import_generator(name: str) -> Any:
    """Import a module of what made the sample logs, which is a script and no package."""
    sys.path.insert(0, str(SAMPLE_LOGS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(SAMPLE_LOGS))


REAL_LOGS = Path(os.environ.get("OCCMAP_REAL_LOGS", ROOT.parent / "shared" / "logs"))


def find_real(name: str) -> Path:
    """A real recording; a test that asks for one that is not there is skipped."""
    if not (REAL_LOGS / name).exists():
        raise SkipTest(f"no {name} in {REAL_LOGS}: set OCCMAP_REAL_LOGS")
    return REAL_LOGS / name


def make_batch(ranges: ArrayLike, **fields: Any) -> ScanBatch:
    """Scans of equal length at one time, of a laser that measures 0.1 to 10 m."""
    values = np.array(ranges, np.float32)
    stamps, increments = np.zeros(len(values), np.int64), np.zeros(len(values))
    batch = ScanBatch("laser", 0.0, 0.1, 0.1, 10.0, stamps, stamps, values, increments)
    return replace(batch, **fields)


Planar = tuple[float, float, float]
"""x, y (m) and yaw (rad) of a sensor"""


def write_csv(
    path: Path,
    poses: Sequence[Planar],
    ranges: Sequence[float],
    step: float = 0.0,
    start: int = 0,
    every: int = 1,
) -> Path:
    """Write a log of a scan every second, all with the same ranges, beams `step` radians apart."""
    stamps = start + every * np.arange(len(poses))
    shape = {"angle_min": 0, "angle_increment": step, "range_max": 1e6}
    return write_scans(path, stamps, [ranges] * len(poses), poses, **shape)


def write_late(path: Path, scans: int, marked_from: int) -> Path:
    """A log whose laser writes 30 m where nothing came back, though not before some scan."""
    number, beam = np.arange(scans)[:, None], np.arange(60)
    ranges = np.round(2 + 0.05 * beam + 0.01 * (number % 7), 2)
    ranges[marked_from:, ::5] = 30.0
    poses = number * (0, 0.01, 0)
    return write_scans(path, range(scans), ranges, poses, angle_min=0, angle_increment=0.02)


def copy_mcap(source: IO[bytes], target: IO[bytes], leave_out: str = "", **settings: Any) -> None:
    """Write the messages of an MCAP file again, without those of a topic; settings are mcap's."""
    writer = Writer(target, **settings)
    writer.start(profile="ros2")
    channels: dict[int, int] = {}
    for schema, channel, message in make_reader(source).iter_messages():
        assert schema is not None
        if channel.topic == leave_out:
            continue
        if channel.id not in channels:
            kind = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, "cdr", kind)
        number = channels[channel.id]
        writer.add_message(number, message.log_time, message.data, message.publish_time)
    writer.finish()  # type: ignore[no-untyped-call]  # the library's gap
