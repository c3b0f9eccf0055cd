"""MRPT on the same scans, where it is installed."""

import gzip
import shutil
from pathlib import Path

from tests.bench.processes import time_process

MRPT_PROGRAMS = ("carmen2simplemap", "observations2map")
_MRPT_MAP = """\
[MappingApplication]
occupancyGrid_count = 1
gasGrid_count = 0
landmarksMap_count = 0
beaconMap_count = 0
pointsMap_count = 0
[MappingApplication_occupancyGrid_00_creationOpts]
resolution = 0.05
min_x = -10
max_x = 10
min_y = -10
max_y = 10
[MappingApplication_occupancyGrid_00_insertOpts]
mapAltitude = 0
useMapAltitude = 0
maxDistanceInsertion = 80
considerInvalidRangesAsFreeSpace = 0
wideningBeamsWithDistance = 0
"""


class Mrpt:
    """MRPT's two programs that make a grid map of a CARMEN log."""

    def __init__(self, log: Path, folder: Path) -> None:
        self._folder = folder
        self._log = folder / "mrpt.log"
        # It reads no gzip here; unpacking is not in its time.
        self._log.write_bytes(gzip.decompress(log.read_bytes()))
        (folder / "mrpt.ini").write_text(_MRPT_MAP, encoding="ascii")

    @staticmethod
    def find_missing() -> list[str]:
        """Name the programs that are not there."""
        return [name for name in MRPT_PROGRAMS if shutil.which(name) is None]

    def build(self) -> float:
        """Run both and return their seconds together."""
        poses_and_scans = self._folder / "mrpt.simplemap"
        convert = ("carmen2simplemap", "-q", "-w", "-i", self._log, "-o", poses_and_scans)
        ini = self._folder / "mrpt.ini"
        insert = ("observations2map", ini, poses_and_scans, self._folder / "mrpt")
        return time_process(*convert) + time_process(*insert)
