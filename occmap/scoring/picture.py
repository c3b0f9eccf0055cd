"""The picture of a comparison: every variant's map on one scale, and where they disagree."""

from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import numpy as np

from occmap.cells import OccupancyMap, keep_largest
from occmap.grid import CellBox
from occmap.scoring.compare import ScoredVariant
from occmap.types import UInt8
from occmap.writers.images import Panel, write_panels

LARGEST_PX, SMALLEST_PX = 1000, 360
"""The longer side of a panel."""
UNKNOWN = 50
"""How dark an unknown cell is"""
RED, BLUE = (214, 39, 40), (110, 160, 230)


class Frame:
    """The cells that any of several maps covers, and how large they are drawn."""

    def __init__(self, maps: Sequence[OccupancyMap]) -> None:
        self._box = reduce(CellBox.join, map(CellBox.of, maps))
        self.shape = self._box.shape
        longest = max(self.shape)
        self._step = -(-longest // LARGEST_PX)
        self._times = -(-SMALLEST_PX // longest)

    def locate(self, grid: OccupancyMap) -> tuple[slice, slice]:
        """Rows and columns of a map's cells."""
        return CellBox.of(grid).within(self._box)

    def draw(self, cells: UInt8) -> UInt8:
        """Draw (H, W) cells: the largest of those that share a pixel, highest y on top."""
        small = keep_largest(cells, self._step)[::-1]
        drawn: UInt8 = small.repeat(self._times, axis=0).repeat(self._times, axis=1)
        return drawn


def write_picture(path: Path, results: Sequence[ScoredVariant]) -> None:
    """Draw the maps, the best first, and where they disagree.

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    frame = Frame([result.map for result in results])
    panels = []
    for result in results:
        score = result.score
        numbers = f"share {score.share:.3f}, log-likelihood {score.log_likelihood:.3f}"
        panels.append(Panel((result.name, numbers), paint_map(result.map, frame)))
    if len(results) > 1:
        panels.append(paint_disagreement([result.map for result in results], frame))
    write_panels(path, panels)


def paint_map(grid: OccupancyMap, frame: Frame) -> UInt8:
    """Paint probability as grey, dark is occupied; (h, w, 3)."""
    darkness = np.full(frame.shape, UNKNOWN, np.uint8)
    level = 255 - np.rint(255 * (1 - grid.probability)).astype(np.uint8)
    darkness[frame.locate(grid)] = np.where(grid.observed, level, UNKNOWN)
    return np.repeat(255 - frame.draw(darkness)[..., None], 3, axis=2)


def paint_disagreement(maps: Sequence[OccupancyMap], frame: Frame) -> Panel:
    """Paint what all maps say of a cell, red where they contradict each other."""
    free, occupied = np.zeros((2, *frame.shape), np.bool_)
    decided = np.zeros(frame.shape, np.int64)
    for grid in maps:
        box = frame.locate(grid)
        free[box] |= grid.free
        occupied[box] |= grid.occupied
        decided[box] += grid.free | grid.occupied
    contradicted = free & occupied
    partly = (decided > 0) & (decided < len(maps)) & ~contradicted
    darkness = np.where(decided > 0, np.where(occupied, 255, 0), UNKNOWN).astype(np.uint8)
    pixels = np.repeat(255 - frame.draw(darkness)[..., None], 3, axis=2)
    for cells, colour in ((partly, BLUE), (contradicted, RED)):
        pixels[frame.draw(cells.astype(np.uint8)) > 0] = colour
    known = max(int(np.count_nonzero(decided)), 1)
    red, blue = (np.count_nonzero(mask) / known for mask in (contradicted, partly))
    legend = f"red: free or occupied ({red:.1%}), blue: known or not ({blue:.1%})"
    return Panel(("where they disagree", legend), pixels)
