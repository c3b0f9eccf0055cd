"""ROS bags: .bag files of ROS 1, folders and .db3 files of ROS 2."""

from contextlib import suppress
from pathlib import Path

from occmap.errors import LogError
from occmap.readers import Probe, probe_path
from occmap.readers.ros_log import RosReader
from occmap.readers.ros_source import Source
from occmap.readers.ros_sqlite import MAGIC as SQLITE_MAGIC
from occmap.readers.ros_sqlite import SqliteSource
from occmap.readers.rosbag1 import MAGIC as BAG_MAGIC
from occmap.readers.rosbag1 import Bag1Source
from occmap.readers.rosbag2 import METADATA, Bag2Source, list_storage

_OLD_MAGICS = (b"#ROSRECORD V", b"#ROSBAG V1")


def _open_source(path: Path) -> Source:
    """Choose by content."""
    if path.is_dir():
        return Bag2Source(path)
    start = probe_path(path).raw
    if start.startswith(SQLITE_MAGIC):
        return SqliteSource(path)
    if start.startswith(_OLD_MAGICS):
        raise LogError(
            f"a bag of the old format {start[:15].decode('ascii', 'replace')!r}",
            where=path,
            fix="convert it with ROS 1's `rosbag fix old.bag new.bag` (or `rosbag migrate`)",
        )
    return Bag1Source(path)


class RosbagReader(RosReader):
    """Reads ROS 1 bags, and ROS 2 bags with SQLite or MCAP storage."""

    name = "rosbag"
    description = "ROS 1 .bag (none, bz2, lz4); ROS 2 folder or .db3 (SQLite, MCAP, zstd)"
    open_source = staticmethod(_open_source)

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as bags do, or a folder holds storage files."""
        if probe.path.is_dir():
            with suppress(PermissionError):
                return (probe.path / METADATA).exists() or bool(list_storage(probe.path))
            return False
        return probe.raw.startswith((BAG_MAGIC, SQLITE_MAGIC, *_OLD_MAGICS))
