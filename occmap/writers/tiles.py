"""Folders of PNG tiles, for maps that no single image holds: z/x/y, as web maps have them.

At the top level a pixel is a cell, and a tile has a map_server YAML beside it. One level below, a
pixel stands for 2 x 2 of them: occupied where any is, else free where any is; and so on down to
level 0, a single tile. x counts to the right and y down. Tiles in which nothing was observed are
left out.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image

from occmap.cells import CellClass, keep_largest
from occmap.types import UInt8
from occmap.writers import OneFile, Windows, WriteOptions
from occmap.writers.atomic import make_folder
from occmap.writers.pgm import GREYS, describe_map, write_yaml

TILE_PIXELS = 1024
"""Along the side of a tile, which begins at a multiple of as many cells"""
TRINARY = WriteOptions()
"""For the thresholds of the YAML: the greys are classes"""


class TilesWriter(OneFile):
    """A folder of PNG tiles."""

    description = "folder of PNG tiles (z/x/y), those at full resolution with a YAML each"
    in_windows = True

    def owns(self, path: Path) -> bool:
        """Whether a folder is one that this writer made."""
        return all(each.name.isdigit() for each in path.iterdir())

    def write(self, path: Path, grid: Windows, options: WriteOptions) -> tuple[Path, ...]:
        """Write all tiles; return the folder.

        Raises
        ------
        OutputError
            One cannot be written; then nothing is left behind.
        """
        with make_folder(path) as folder:
            folder.mkdir()
            TileTree(folder, grid, options).write(level=0, x=0, y=0)
        return (path,)


class TileTree:
    """Tiles of a map, each made of the four below it."""

    def __init__(self, folder: Path, grid: Windows, options: WriteOptions) -> None:
        self.folder, self.grid, self.options = folder, grid, options
        ends = grid.place + grid.shape
        self.low = grid.place // TILE_PIXELS
        """Row and column of the lowest tiles"""
        self.size = -(-ends // TILE_PIXELS) - self.low
        """How many rows and columns of tiles there are"""
        self.top = int(self.size.max() - 1).bit_length()
        """The level at which a pixel is a cell"""

    def write(self, level: int, x: int, y: int) -> UInt8 | None:
        """Write a tile and all above it; return its classes, or None where there is nothing."""
        if level == self.top:
            classes = self.paint(x, y)
        else:
            quarters = product((2 * y, 2 * y + 1), (2 * x, 2 * x + 1))
            classes = self.shrink([self.write(level + 1, right, down) for down, right in quarters])
        if classes is not None:
            file = self.folder / f"{level}" / f"{x}" / f"{y}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(GREYS[classes][::-1]).save(file)
        return classes

    def shrink(self, quarters: list[UInt8 | None]) -> UInt8 | None:
        """Make one tile of four: the two upper ones first; row 0 is the lowest y."""
        if all(each is None for each in quarters):
            return None
        blank = np.full((TILE_PIXELS,) * 2, CellClass.NEITHER, np.uint8)
        one, two, three, four = (blank if each is None else each for each in quarters)
        return keep_largest(np.block([[three, four], [one, two]]), 2)

    def paint(self, x: int, y: int) -> UInt8 | None:
        """Paint the cells of a tile at the top level, and say where it lies."""
        row, col = self.low + np.array([self.size[0] - 1 - y, x])
        start = np.array([row, col]) * TILE_PIXELS - self.grid.place
        first = np.maximum(start, 0)
        last = np.minimum(start + TILE_PIXELS, self.grid.shape)
        if (first >= last).any():
            return None
        part = self.grid.take(*map(slice, first.tolist(), last.tolist()))
        if not part.observed.any():
            return None
        decision = self.options.decide(part.decision)
        classes = np.full((TILE_PIXELS,) * 2, CellClass.NEITHER, np.uint8)
        inner = map(slice, (first - start).tolist(), (last - start).tolist())
        classes[*inner] = replace(part, decision=decision).classes
        file = self.folder / f"{self.top}" / f"{x}" / f"{y}.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        corner = np.array([col, row]) * TILE_PIXELS * self.grid.resolution
        lying = replace(part, origin=(round(corner[0], 12), round(corner[1], 12)))
        with file.open("wb") as opened:
            write_yaml(opened, describe_map(f"{y}.png", lying, TRINARY))
        return classes
