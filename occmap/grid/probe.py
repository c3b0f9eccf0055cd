"""What each single scan does to one cell: the engine's own windows, one cell large."""

import math

import numpy as np

from occmap.arrays import Bool, Int64
from occmap.grid.engine import refuse_far_sensors, refuse_long_beams
from occmap.grid.kernels.units import TILE
from occmap.grid.lattice import CellBox
from occmap.grid.projection import offset_hits, project
from occmap.grid.spec import GridSpec
from occmap.grid.windows import choose_window
from occmap.types import Rays


class CellProbe:
    """Looks at one cell through the windows that a `GridEngine` of the same kind would use."""

    def __init__(self, spec: GridSpec, row: int, col: int) -> None:
        self.spec = spec
        self.box = CellBox.at(row, col)

    def look(self, rays: Rays) -> Int64:
        """(S, 2) the two numbers that each scan adds to the cell.

        Raises
        ------
        MapError
            As `GridEngine.add`.
        """
        seen = np.zeros((len(rays.kind), 2), np.int64)
        if not rays.kind.size:
            return seen
        refuse_far_sensors(rays, self.spec.lattice)
        refuse_long_beams(rays, self.spec.lattice.resolution)
        row, col = self.box.row % TILE, self.box.col % TILE
        for scan in np.flatnonzero(self.find_near(rays)):
            projected = project(offset_hits(rays.take(slice(scan, scan + 1)), self.spec), self.spec)
            window = choose_window(self.spec, projected)(self.spec, self.box)
            window.observe(projected)
            for tile in window.read().values():  # the window is a single tile
                seen[scan] = tile[:, row, col]
        return seen

    def find_near(self, rays: Rays) -> Bool:
        """(S,): the scans that may touch the cell; all others do not.

        All that a scan touches lies in a circle about its first viewpoint: the ends of its beams,
        the lines between these, and, to a cell's diagonal, the cells that they are in.
        """
        resolution, radial = self.spec.lattice.resolution, self.spec.radial
        start = rays.origin[:, 0]
        away = np.hypot(*(start - (np.array([self.box.col, self.box.row]) + 0.5) * resolution).T)
        spread = np.hypot(*np.moveaxis(rays.origin - start[:, None], -1, 0)).max(axis=1)
        # A polygon's viewpoint lies up to `spread` from the first, and its beams are that much
        # longer; a beam's other viewpoints are nearer.
        reach = rays.distance.max(axis=1) + 3 * spread + (0.0 if radial is None else radial.depth)
        reach += self.spec.hit_offset * resolution
        return np.asarray(away <= reach + 2 * math.sqrt(2) * resolution)
