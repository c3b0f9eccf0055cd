"""PNG images of the probability itself: grey for observed cells, transparent where unknown."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from occmap.cells import Decision, OccupancyMap, list_captions
from occmap.types import UInt8
from occmap.writers import Shade, WriteOptions, Writer, bands_from_top
from occmap.writers.atomic import check_target, open_atomic
from occmap.writers.geotiff import lay_out

HIDDEN_GREY = 127
"""Under transparent pixels, for viewers that show no transparency."""
GREY_ALPHA = bytes([8, 4, 0, 0, 0])
"""How the header of a PNG says 8 bits a sample, grey with alpha, and not interlaced"""
ZLIB_LEVEL = 4
"""With 1, a large map is written in two thirds of the time, and files are up to a fourth larger"""


class PngWriter(Writer):
    """8-bit grey with alpha, first row = largest y; dark or light is occupied."""

    description = "PNG image of the probability, unknown transparent"
    in_parts = True

    def check(self, path: Path, options: WriteOptions) -> None:
        """Refuse a name beside which no world file can be written; raises OutputError."""
        for beside in name_beside(path) if options.georeference else ():
            check_target(beside)

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> tuple[Path, ...]:
        """Write the image, and where it lies on the globe if that is given; return the paths.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        rows, cols = grid.shape
        free, occupied = options.decide(grid.decision)
        negate = int(options.shade is Shade.LIGHT_OCCUPIED)
        # Named as in a map's YAML, they say how the pixels are decided.
        texts: dict[str, Any] = {"occupied_thresh": occupied, "free_thresh": free, "negate": negate}
        texts |= list_captions(grid.about)
        # Not by pillow: it tries five filters on each row, which takes twice as long, and large
        # maps, which are runs of one grey, get smaller with none of them.
        packer = zlib.compressobj(ZLIB_LEVEL)
        packed = [packer.compress(lines.data) for lines in paint_bands(grid, options)]
        chunks = [(b"IHDR", struct.pack(">II", cols, rows) + GREY_ALPHA)]
        for name, text in texts.items():
            chunks.append((b"tEXt", f"{name}\0{text}".encode("ascii")))
        chunks += [(b"IDAT", b"".join([*packed, packer.flush()])), (b"IEND", b"")]
        beside = name_beside(path) if options.georeference else ()
        with open_atomic(path, *beside) as (file, *others):
            if others:
                where = lay_out(grid.box, grid.resolution, options.georeference, grid.about)
                for other, told in zip(others, write_place(where), strict=True):
                    other.write(told.encode())
            file.write(b"\x89PNG\r\n\x1a\n")
            for kind, data in chunks:
                checksum = zlib.crc32(kind + data)
                file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum))
        return path, *beside


def name_beside(path: Path) -> tuple[Path, Path]:
    """Name the files that say where an image lies on the globe: the place, and its frame."""
    return path.with_suffix(".pgw"), path.with_name(f"{path.name}.aux.xml")


def write_place(layout: dict[str, Any]) -> tuple[str, str]:
    """Write a world file, and what GDAL and QGIS read the frame of its coordinates from."""
    a, b, c, d, e, f = layout["transform"]
    numbers = a, d, b, e, c + (a + b) / 2, f + (d + e) / 2  # of the middle of the first pixel
    frame = f"<PAMDataset><SRS>{layout['crs']}</SRS></PAMDataset>\n"
    return "".join(f"{number!r}\n" for number in numbers), frame


def paint_bands(grid: OccupancyMap, options: WriteOptions) -> Iterator[UInt8]:
    """Paint a band of rows after the other, the top row first, as the lines (N, 1 + 2 W) of a PNG.

    A line is a 0, as it is not filtered, and grey and alpha by turns.
    """
    decision = options.decide(grid.decision)
    levels = limit_levels(decision)
    light = levels if options.shade is Shade.LIGHT_OCCUPIED else 255 - levels
    shades = (light + 0xFF00).astype("<u2")  # alpha is the higher of the two bytes
    for band in (replace(each, decision=decision) for each in bands_from_top(grid)):
        level = 255 - np.rint(255 * (1 - band.probability))
        pixels = shades.take(256 * band.classes.astype(np.uint16) + level.astype(np.uint8))
        pixels[~band.observed] = HIDDEN_GREY
        yield np.pad(pixels[::-1].copy().view(np.uint8), [(0, 0), (1, 0)])


def limit_levels(decision: Decision) -> UInt8:
    """(3, 256) how occupied each CellClass is painted, of 255, for each level that it may have.

    Where rounding would carry a cell over a threshold, it gets the last level before it.
    """
    shares, levels = np.arange(256) / 255, np.arange(256)
    last_free = np.count_nonzero(shares < decision.free_below) - 1
    first_occupied = 256 - np.count_nonzero(shares > decision.occupied_above)
    undecided = levels.clip(None, first_occupied - 1).clip(last_free + 1)
    free, occupied = levels.clip(None, last_free), levels.clip(first_occupied)
    return np.asarray([undecided, free, occupied])
