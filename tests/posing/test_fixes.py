"""Satellite positions say where on the globe a map lies; GDAL says where they truly are."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio.warp import transform

import occmap
from tests.readers.ros import ROS2, SECOND, Written, drive, header, transforms, write_mcap

GLOBE = (52.5, 13.4, 30.0)
PLANE = "+proj=aeqd +lat_0=52.5 +lon_0=13.4 +datum=WGS84 +units=m"
SCANS = 60
Wrong = dict[int, tuple[float, float, int]]
"""By how many degrees positions are off, to the east and north, and their status"""


def find_globe(x: float, y: float) -> tuple[float, float]:
    """Latitude and longitude of a place in the map (m)."""
    cos, sin = math.cos(math.radians(GLOBE[2])), math.sin(math.radians(GLOBE[2]))
    (lon,), (lat,) = transform(PLANE, "EPSG:4326", [x * cos - y * sin], [x * sin + y * cos])
    return lat, lon


def fix(stamp_ns: int, latitude: float, longitude: float, status: int, frame: str) -> Written:
    kinds = ROS2.types
    state = kinds["sensor_msgs/msg/NavSatStatus"](status, 1)
    place: Any = (latitude, longitude, 40.0, np.zeros(9), 0)
    made = kinds["sensor_msgs/msg/NavSatFix"](header(ROS2, stamp_ns, frame), state, *place)
    return Written("/fix", stamp_ns, made)


def check(
    path: Path, wrong: Wrong, frame: str = "base", positions: int = SCANS, moves: bool = True
) -> str:
    """What is told of a drive along x; a receiver in a frame that nobody knows is at the laser."""
    log = drive(ROS2, SCANS)
    if not moves:
        log = [each for each in log if each.topic != "/tf"]
        stamps = [(k + 1) * SECOND + 5 for k in range(SCANS)]
        log += [Written("/tf", at, transforms(ROS2, at, [("/odom", "base", 0.0)])) for at in stamps]
    for k in range(positions):
        x, y = (0.5 * k * moves, 2.0) if frame == "base" else (0.5 * k - 0.25, 0.0)
        lat, lon = find_globe(x, y)
        right, up, status = wrong.get(k, (0.0, 0.0, 0))
        log.append(fix((k + 1) * SECOND + 5, lat + up, lon + right, status, frame))
    found = occmap.check(write_mcap(path / "drive.mcap", sorted(log, key=lambda it: it.record_ns)))
    return next((note for note in found.logs[0].notes if "satellite" in note), "")


@pytest.mark.parametrize("frame", ["base", "gps"])
@pytest.mark.parametrize(
    "wrong", [{}, {7: (1e-3, 2e-3, 0), 20: (math.nan, 0.0, 0), 30: (9.0, 9.0, -1)}]
)
def test_a_log_says_where_on_the_globe_its_map_lies(
    tmp_path: Path, wrong: Wrong, frame: str
) -> None:
    told = check(tmp_path, wrong, frame)
    numbers = re.search(r"georeference=\(([\d.]+),([\d.]+),([\d.]+)\)`.* within ([\d.]+) m", told)
    assert numbers is not None, told
    *globe, residual = map(float, numbers.groups())
    assert globe[:2] == pytest.approx(GLOBE[:2], abs=2e-7)  # 2 cm
    assert globe[2] == pytest.approx(GLOBE[2], abs=0.01)
    assert residual < 0.02


def test_positions_that_tell_too_little_are_told(tmp_path: Path) -> None:
    assert not check(tmp_path, {}, positions=0)
    assert check(tmp_path, {}, positions=9).startswith("only 9 satellite positions")
    noisy = {k: (1e-3 * (k % 2), 1e-3 * (k % 3), 0) for k in range(SCANS)}
    assert "m off a way that reaches" in check(tmp_path, noisy)
    assert "m off a way that reaches 0.00 m" in check(tmp_path, {}, moves=False)
