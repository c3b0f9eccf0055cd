"""Reads ROS bags: .bag files of ROS 1, folders and .db3 files of ROS 2."""

from contextlib import suppress
from pathlib import Path

from occmap.readers.containers import bag2
from occmap.readers.containers.bag1 import Bag1Source
from occmap.readers.containers.source import Source
from occmap.readers.containers.sqlite import SqliteSource
from occmap.readers.probing import Probe
from occmap.readers.ros_log import RosReader


class RosbagReader(RosReader):
    """Reads ROS 1 bags, and ROS 2 bags with SQLite or MCAP storage."""

    name = "rosbag"
    description = "ROS 1 .bag (none, bz2, lz4); ROS 2 folder or .db3 (SQLite, MCAP, zstd)"

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as bags do, or a folder holds storage files."""
        if probe.path.is_dir():
            with suppress(PermissionError):
                return (probe.path / bag2.METADATA).exists() or bool(bag2.list_storage(probe.path))
            return False
        return probe.raw.startswith((Bag1Source.magic, SqliteSource.magic, *bag2.OLD_MAGICS))

    def open_source(self, path: Path) -> Source:
        """Open a folder or a file."""
        return bag2.Bag2Source(path) if path.is_dir() else bag2.open_file(path)
