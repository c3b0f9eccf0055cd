"""PNG images of the probability itself: grey for observed cells, transparent where unknown."""

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from occmap.arrays import UInt8
from occmap.cells import OccupancyMap
from occmap.writers import OneFile, Shade, WriteOptions, bands_from_top
from occmap.writers.atomic import open_atomic

HIDDEN_GREY = 127
"""Under transparent pixels, for viewers that show no transparency."""


class PngWriter(OneFile):
    """8-bit grey with alpha, first row = largest y; dark or light is occupied."""

    description = "PNG image of the probability, unknown transparent"

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> tuple[Path, ...]:
        """Write the image; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        info = PngInfo()
        for name, value in describe(grid, options).items():
            info.add_text(name, value)
        with open_atomic(path) as (file,):
            image = Image.fromarray(_paint(grid, options))
            # A map is made of runs of one grey: looking for these alone takes half the time.
            image.save(file, format="PNG", pnginfo=info, compress_type=zlib.Z_RLE)
        return (path,)


def describe(grid: OccupancyMap, options: WriteOptions) -> dict[str, str]:
    """Say in texts of the image, named as in a map's YAML, how its pixels are decided."""
    free, occupied = options.decide(grid.decision)
    negate = int(options.shade is Shade.LIGHT_OCCUPIED)
    return {"occupied_thresh": str(occupied), "free_thresh": str(free), "negate": str(negate)}


def _paint(grid: OccupancyMap, options: WriteOptions) -> UInt8:
    """Return grey and alpha, (H, W, 2), top row first.

    Where rounding would carry a cell over a threshold, it gets the last shade before it.
    """
    decision = options.decide(grid.decision)
    shares = np.arange(256) / 255
    last_free = np.count_nonzero(shares < decision.free_below) - 1
    first_occupied = 256 - np.count_nonzero(shares > decision.occupied_above)
    pixels = np.full(grid.shape, HIDDEN_GREY, "<u2")  # alpha is the higher of the two bytes
    top = 0
    for band in bands_from_top(grid):
        where = band.observed  # in a large map few cells are, and only these take work
        seen = replace(
            band, log_odds=band.log_odds[where], observed=where[where], decision=decision
        )
        occupied, free = seen.occupied, seen.free
        level = 255 - np.rint(255 * (1 - seen.probability))
        level = np.where(occupied, level.clip(first_occupied), level.clip(None, first_occupied - 1))
        level = np.where(free, level.clip(None, last_free), level)
        level = np.where(free | occupied, level, level.clip(last_free + 1))
        light = level if options.shade is Shade.LIGHT_OCCUPIED else 255 - level
        rows = slice(top, top + band.shape[0])
        pixels[rows][::-1][where] = light + 0xFF00
        top = rows.stop
    return pixels.view(np.uint8).reshape(*grid.shape, 2)
