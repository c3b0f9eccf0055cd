"""Reads MCAP files with ROS 2, ROS 1 or Foxglove messages."""

from occmap.readers.containers.mcap import McapSource
from occmap.readers.probing import Probe
from occmap.readers.ros_log import RosReader


class McapReader(RosReader):
    """Reads MCAP files, as https://mcap.dev/spec has them."""

    name = "mcap"
    description = "MCAP with ROS 2, ROS 1 or Foxglove messages (uncompressed, lz4, zstd)"
    open_source = McapSource

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as MCAP files do."""
        return probe.raw.startswith(McapSource.magic)
