"""What is fuzzed: each reader by itself, on small logs of its format."""

import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin

from occmap.errors import OccmapError
from occmap.readers import Reader, probe_path
from occmap.readers.carmen import CarmenReader
from occmap.readers.csv import CsvReader
from occmap.readers.mcap import McapReader
from occmap.readers.rosbag import RosbagReader
from tests.readers.foxglove_logs import WRITERS, place, scan
from tests.readers.foxglove_logs import drive as foxglove_drive
from tests.readers.ros import ROS1, ROS2, Bag2, drive, write_bag1, write_mcap

SAMPLES = Path(__file__).parents[2] / "sample_logs"
SCANS = 3


@dataclass(frozen=True)
class Target:
    """A reader, and files that it can read."""

    name: str
    reader: Callable[[], Reader]
    seeds: Callable[[Path], list[bytes]]
    """Remarks in a folder that is thrown away."""

    def read(self, data: bytes) -> None:
        """Read all of an input; anything but an OccmapError escapes."""
        with tempfile.TemporaryDirectory(prefix="occmap-fuzz-") as folder:
            path = Path(folder) / f"input.{self.name}"
            path.write_bytes(data)
            with suppress(OccmapError):
                read_all(self.reader(), path)


def read_all(reader: Reader, path: Path) -> None:
    """Do with a file all that occmap does before it looks at a scan."""
    reader.recognises(probe_path(path))
    log = reader.open(path)
    for _ in log.poses():
        pass
    for _ in log.scans({stream.topic for stream in log.streams}):
        pass


def make_csv(_folder: Path) -> list[bytes]:
    """The first scans of the sample, and a log with all kinds of columns."""
    rows = (SAMPLES / "drive.csv").read_bytes().splitlines(keepends=True)
    small = b'# range_max: 5\nstamp,frame,angle_min,angle_increment,r0,r1\n1,"a",0,.1,1,inf\n'
    return [b"".join(rows[:8]), small + b"2,b,0,.1,,nan\n"]


def make_carmen(_folder: Path) -> list[bytes]:
    """The first scans of the sample, and one line of each other kind."""
    rows = (SAMPLES / "drive.log").read_bytes().splitlines(keepends=True)
    small = (
        b"PARAM robot_frontlaser_offset 0.1 1 h 1\nODOM 1 2 .5 0 0 0 1 h 1\n"
        b"FLASER 3 1 2 81.9 0 0 0 0 0 0 2 h 2\nRLASER 1 1 0 0 0 0 0 0 2 h 2\n"
        b"RAWLASER1 0 -1.5 3 1.5 50 .01 0 2 1 2 1 7 3 h 3\n"
    )
    return [b"".join(rows[:4]), small]


def make_bag(folder: Path) -> list[bytes]:
    """A bag of each compression."""
    paths = [
        write_bag1(folder / f"{name}.bag", drive(ROS1, SCANS), name)
        for name in ("none", "bz2", "lz4")
    ]
    return [path.read_bytes() for path in paths]


def make_sqlite(folder: Path) -> list[bytes]:
    """The storage file of a ROS 2 bag."""
    bag = Bag2(StoragePlugin.SQLITE3).write(folder / "drive", drive(ROS2, SCANS))
    return [(bag / "drive.db3").read_bytes()]


def make_foxglove(folder: Path) -> list[bytes]:
    """Foxglove's schemas in both encodings, with scans that state their origin."""
    posed = [scan(index, place(0.5 * index, 0.1)) for index in range(SCANS)]
    paths = [
        write(folder / f"{name}-{index}.mcap", log)
        for name, write in WRITERS.items()
        for index, log in enumerate((foxglove_drive(), posed))
    ]
    return [path.read_bytes() for path in paths]


def make_mcap(folder: Path) -> list[bytes]:
    """ROS 1 and ROS 2 messages, in chunks and without."""
    options: list[dict[str, Any]] = [
        {"compression": CompressionType.NONE, "chunk_size": 500},
        {"compression": CompressionType.ZSTD},
        {"use_chunking": False},
    ]
    paths = [
        write_mcap(folder / f"{index}.mcap", drive(store, SCANS), store, option)
        for index, (store, option) in enumerate((s, o) for s in (ROS1, ROS2) for o in options)
    ]
    return [path.read_bytes() for path in paths]


TARGETS = {
    target.name: target
    for target in (
        Target("csv", CsvReader, make_csv),
        Target("carmen", CarmenReader, make_carmen),
        Target("bag", RosbagReader, make_bag),
        Target("db3", RosbagReader, make_sqlite),
        Target("mcap", McapReader, make_mcap),
        Target("foxglove", McapReader, make_foxglove),
    )
}
