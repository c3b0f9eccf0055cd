"""Other people's tools on the same scans, where they are installed; absent ones are said to be."""

import gzip
import importlib.util
import shutil
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from occmap.types import Float64
from tests.bench.measuring import time_once
from tests.bench.processes import time_process
from tests.bench.workloads import Workload

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


def has_pyoctomap() -> bool:
    """Whether pyoctomap is installed."""
    return importlib.util.find_spec("pyoctomap") is not None


def time_pyoctomap(workload: Workload) -> float:
    """Insert every scan into an octree of one layer: seconds a scan.

    Its insertPointCloud counts a cell once a scan, however many beams cross it. Making the points
    is not timed.
    """
    pyoctomap: Any = importlib.import_module("pyoctomap")
    tree = pyoctomap.OcTree(workload.resolution)
    clouds = [make_cloud(workload, scan) for scan in range(workload.scans)]

    def insert() -> None:
        for origin, cloud in clouds:
            tree.insertPointCloud(cloud, origin, lazy_eval=True)
        tree.updateInnerOccupancy()

    return time_once(insert, process_time) / workload.scans


def make_cloud(workload: Workload, scan: int) -> tuple[Float64, Float64]:
    """The sensor (3,) and where beams ended (N, 3), in the map frame."""
    x, y, yaw = workload.poses[scan]
    ranges = workload.ranges[scan].astype(np.float64)
    hit = ranges < workload.sensor.range_max
    bearings, ranges = workload.sensor.bearings[hit] + yaw, ranges[hit]
    flat = np.zeros_like(ranges)
    ends = np.stack([x + ranges * np.cos(bearings), y + ranges * np.sin(bearings), flat], axis=1)
    return np.array([x, y, 0.0]), ends
