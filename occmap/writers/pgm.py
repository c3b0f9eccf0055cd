"""PGM images with a YAML beside them: the maps that ROS 1 map_server and nav2 load.

The two loaders disagree at the thresholds: map_server compares strictly, nav2 inclusively and lets
free win. So no pixel written here lies on a threshold, and every class survives both.
"""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from occmap.cells import EVEN_ODDS, About, Decision, OccupancyMap, list_captions
from occmap.errors import UsageError
from occmap.types import UInt8
from occmap.writers import MapMode, WriteOptions, Writer, bands_from_top
from occmap.writers.atomic import open_atomic
from occmap.writers.edits import Change, cover

UNKNOWN, FREE, OCCUPIED = 205, 254, 0
GREYS = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)
"""Of each CellClass"""
SCALE_UNKNOWN = 127
"""nav2's grey for unknown in scale mode. PGM has no transparency to tell it from a measured 0.5."""
RAW_UNKNOWN = 255
PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_-]*|[A-Za-z0-9_][A-Za-z0-9_.-]*\.pgm")
"""Text that YAML takes for text without quotes; words such as `no` do not occur among modes."""
THRESHOLD_MARGIN = 1e-3
"""In grey levels; loaders compare in single precision."""


class PgmWriter(Writer):
    """8-bit binary PGM, first row = largest y, with the map_server YAML of the same stem."""

    description = "PGM image and YAML for ROS 1 map_server and nav2"
    in_parts = True

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the image and the YAML."""
        return path, path.with_suffix(".yaml")

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> None:
        """Write the image and the YAML.

        Raises
        ------
        OutputError
            One of them cannot be written; then neither is left behind.
        """
        image_path, yaml_path = self.targets(path)
        painters = {MapMode.SCALE: _scale, MapMode.RAW: to_raw}
        to_pixels = painters.get(options.mode, lambda band: GREYS[band.classes])
        # The image is renamed first: a YAML never names an image that is not there.
        with open_atomic(image_path, yaml_path) as (image, yaml):
            rows, cols = grid.shape
            image.write(f"P5\n{cols} {rows}\n255\n".encode("ascii"))
            decision = options.decide(grid.decision)
            for band in bands_from_top(grid):
                image.write(to_pixels(replace(band, decision=decision))[::-1].tobytes())
            fields = describe_image(image_path.name, grid.resolution, grid.origin, options)
            write_yaml(yaml, fields, grid.about)


class KeepoutWriter(PgmWriter):
    """The cells that edits forbid, as the mask that nav2's keepout filter loads."""

    description = "keepout mask for nav2: what edits forbid, as a PGM and its YAML"
    in_parts = False

    def check(self, path: Path, options: WriteOptions) -> None:
        """Refuse a mask where no edits are given; raises UsageError."""
        if options.edits is None:
            fix = "add `edits` with shapes that are forbidden"
            raise UsageError("a keepout mask is of edits, and none are given", where=path, fix=fix)

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> None:
        """Write the mask and its YAML.

        Raises
        ------
        OutputError
            One of them cannot be written; then neither is left behind.
        """
        shapes = (shape for shape in options.shapes if shape.change is Change.FORBIDDEN)
        kept_out = cover(shapes, grid.box, grid.resolution)
        log_odds = np.where(kept_out, np.float32(1), np.float32(-1))
        mask = replace(grid, log_odds=log_odds, observed=np.ones_like(kept_out), decision=EVEN_ODDS)
        super().write(path, mask, WriteOptions())


def describe_image(
    image_name: str, resolution: float, origin: tuple[float, float], options: WriteOptions
) -> dict[str, object]:
    """Return the fields of the map_server YAML, in its order."""
    occupied_thresh, free_thresh = written_thresholds(options)
    return {
        "image": image_name,
        "mode": options.mode.value,
        "resolution": float(resolution),
        "origin": [*map(float, origin), 0.0],
        "negate": 0,
        "occupied_thresh": occupied_thresh,
        "free_thresh": free_thresh,
    }


def written_thresholds(options: WriteOptions) -> tuple[float, float]:
    """Return the occupied and free thresholds under which a loader finds the classes again.

    In trinary mode the cells are classified already, and the thresholds only tell the three greys
    apart: occupied is 1.0, unknown 0.196078 and free 0.003922 to a loader. A user's threshold that
    would mix them up (free 0.25 makes every unknown cell free) is brought back between them.
    """
    free, occupied = options.thresholds
    if options.mode is not MapMode.TRINARY:
        return occupied, free
    return min(max(occupied, 0.2), 0.99), min(max(free, 0.01), 0.196)


def _scale(grid: OccupancyMap) -> UInt8:
    """Shade as nav2 does, by whole per cents, but never across a threshold by rounding."""
    # (100 - per cent) / 100 of 255 with halves rounded down, as GraphicsMagick does for nav2.
    grey = (51 * (100 - _percent(grid).astype(np.int16)) + 9) // 20
    shade = np.where(grid.observed, grey, SCALE_UNKNOWN)
    darkest_free, lightest_occupied, between = _grey_limits(grid.decision)
    lowest = np.select([grid.free, grid.occupied], [darkest_free, 0], between[0])
    highest = np.select([grid.free, grid.occupied], [255, lightest_occupied], between[1])
    return np.asarray(np.clip(shade, lowest, highest).astype(np.uint8))


def _grey_limits(thresholds: Decision) -> tuple[int, int, tuple[int, int]]:
    """Return the darkest grey that is free, the lightest that is occupied, and those between."""
    at_free = 255 * (1 - thresholds.free_below)
    at_occupied = 255 * (1 - thresholds.occupied_above)
    # nav2 spreads these over 0 to 100 and rounds: the outer half per cent would become a class.
    inset = (at_free - at_occupied) / 200 + THRESHOLD_MARGIN
    between = math.floor(at_occupied + inset) + 1, math.ceil(at_free - inset) - 1
    darkest_free = math.floor(at_free + THRESHOLD_MARGIN) + 1
    lightest_occupied = math.ceil(at_occupied - THRESHOLD_MARGIN) - 1
    return min(darkest_free, 255), max(lightest_occupied, 0), between


def to_raw(grid: OccupancyMap) -> UInt8:
    """(H, W) per cent of being occupied, 255 where nothing was observed; row 0 is the lowest y."""
    return np.asarray(np.where(grid.observed, _percent(grid), RAW_UNKNOWN).astype(np.uint8))


def _percent(grid: OccupancyMap) -> UInt8:
    """Return the occupancy as ROS's OccupancyGrid holds it: 0 to 100."""
    return np.asarray(np.rint(100 * grid.probability).astype(np.uint8))


def write_yaml(file: BinaryIO, fields: dict[str, object], about: About | None) -> None:
    """Write plain lines, and comments on what the map is of.

    Importing a YAML library takes longer than writing the image.
    """
    lines = [f"{name}: {_to_yaml(value)}\n" for name, value in fields.items()]
    lines += [f"# {name}: {text}\n" for name, text in list_captions(about).items()]
    file.write("".join(lines).encode("utf-8", "surrogateescape"))  # the image's name as it is


def _to_yaml(value: object) -> str:
    """Write a value as YAML 1.1 and 1.2 both read it; every JSON string is a YAML string."""
    if isinstance(value, list):
        return f"[{', '.join(_to_yaml(each) for each in value)}]"
    if isinstance(value, str):
        return value if PLAIN.fullmatch(value) else json.dumps(value, ensure_ascii=False)
    number = repr(value)
    # YAML 1.1 takes 1e-05, without a dot, for text.
    return number.replace("e", ".0e") if "e" in number and "." not in number else number
