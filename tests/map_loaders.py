"""Loads map files by the rules of ROS 1 map_server and of nav2, written from their sources.

Independent of the writers: its own PGM parser, its own YAML reading, cell by cell in plain Python.
Both return OccupancyGrid values, row 0 lowest: 0 free, 100 occupied, -1 unknown, between in scale.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

Grid: TypeAlias = NDArray[np.int64]
Rule: TypeAlias = Callable[[int, dict[str, Any]], int]


def read_pgm(path: Path) -> NDArray[np.uint8]:
    """Return the pixels (H, W), first row on top."""
    header = re.match(rb"P5\s+(\d+)\s+(\d+)\s+255\s", path.read_bytes())
    assert header is not None, "not an 8-bit binary PGM"
    cols, rows = int(header[1]), int(header[2])
    body = path.read_bytes()[header.end() :]
    assert len(body) == rows * cols
    return np.frombuffer(body, np.uint8).reshape(rows, cols)


def load_ros1(yaml_path: Path) -> Grid:
    """Strict comparisons, occupied first; scale in 1 to 99; raw is the pixel as a signed byte."""
    return _load(yaml_path, _ros1_value)


def load_nav2(yaml_path: Path) -> Grid:
    """Inclusive comparisons, in single precision, and free wins; scale in 0 to 100."""
    return _load(yaml_path, _nav2_value)


def _load(yaml_path: Path, rule: Rule) -> Grid:
    meta = YAML(typ="safe").load(yaml_path)
    assert meta["negate"] == 0
    pixels = read_pgm(yaml_path.parent / meta["image"])
    values = [[rule(int(pixel), meta) for pixel in row] for row in reversed(pixels)]
    return np.array(values)


def _ros1_value(pixel: int, meta: dict[str, Any]) -> int:
    if meta["mode"] == "raw":
        return pixel if pixel < 128 else pixel - 256
    occupancy = (255 - pixel) / 255.0
    if occupancy > meta["occupied_thresh"]:
        return 100
    if occupancy < meta["free_thresh"]:
        return 0
    if meta["mode"] == "trinary":
        return -1
    span = meta["occupied_thresh"] - meta["free_thresh"]
    return int(1 + 98 * (occupancy - meta["free_thresh"]) / span)


def _nav2_value(pixel: int, meta: dict[str, Any]) -> int:
    if meta["mode"] == "raw":
        return pixel if pixel <= 100 else -1
    occupancy = np.float32(255 - pixel) / np.float32(255)
    free, occupied = np.float32(meta["free_thresh"]), np.float32(meta["occupied_thresh"])
    if occupancy <= free:
        return 0
    if occupancy >= occupied:
        return 100
    if meta["mode"] == "trinary":
        return -1
    return int(np.rint((occupancy - free) / (occupied - free) * 100))
