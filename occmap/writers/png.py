"""PNG images of the probability itself: grey for observed cells, transparent where unknown."""

from pathlib import Path

import numpy as np
from PIL import Image

from occmap.types import OccupancyMap, UInt8
from occmap.writers import Shade, WriteOptions, bands_from_top
from occmap.writers.atomic import open_atomic

HIDDEN_GREY = 127
"""Under transparent pixels, for viewers that show no transparency."""


class PngWriter:
    """8-bit grey with alpha, first row = largest y; dark or light is occupied."""

    description = "PNG image of the probability, unknown transparent"

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the image."""
        return (path,)

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> tuple[Path, ...]:
        """Write the image; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        with open_atomic(path) as (file,):
            Image.fromarray(_paint(grid, options.shade)).save(file, format="PNG")
        return (path,)


def _paint(grid: OccupancyMap, shade: Shade) -> UInt8:
    """Return grey and alpha, (H, W, 2), top row first."""
    pixels = np.zeros((*grid.shape, 2), np.uint8)
    top = 0
    for band in bands_from_top(grid):
        light = band.probability if shade is Shade.LIGHT_OCCUPIED else 1 - band.probability
        grey = np.where(band.observed, np.rint(255 * light), HIDDEN_GREY)
        rows = slice(top, top + band.shape[0])
        pixels[rows, :, 0] = grey[::-1]
        pixels[rows, :, 1] = np.where(band.observed, 255, 0)[::-1]
        top = rows.stop
    return pixels
