"""What each single scan does to one cell: the engine's own windows, one cell large."""

import math

import numpy as np

from occmap.grid.kernels.units import TILE
from occmap.grid.lattice import CellBox
from occmap.grid.projection import prepare, project
from occmap.grid.spec import GridSpec
from occmap.grid.windows import choose_windows
from occmap.types import Bool, Int64, Rays


def look_at_cell(rays: Rays, spec: GridSpec, row: int, col: int) -> Int64:
    """(S, 2) the two numbers that each scan adds to a cell.

    Raises
    ------
    MapError
        As `prepare`.
    """
    seen, box = np.zeros((len(rays.kind), 2), np.int64), CellBox.at(row, col)
    if not rays.kind.size:
        return seen
    rays = prepare(rays, spec)
    for scan in np.flatnonzero(find_near(rays, spec, box)):
        beams = project(rays.take(slice(scan, scan + 1)), spec)
        window = choose_windows(spec, beams)[0](spec, box)
        window.observe(beams)
        for tile in window.read().values():  # the window is a single tile
            seen[scan] = tile[:, row % TILE, col % TILE]
    return seen


def find_near(rays: Rays, spec: GridSpec, box: CellBox) -> Bool:
    """(S,): the scans that may touch a cell; all others do not.

    All that a scan touches lies in a circle about its first viewpoint: the ends of its beams, the
    lines between these, and, to a cell's diagonal, the cells that they are in.
    """
    resolution, start = spec.lattice.resolution, rays.origin[:, 0]
    away = np.hypot(*(start - (np.array([box.col, box.row]) + 0.5) * resolution).T)
    spread = np.hypot(*np.moveaxis(rays.origin - start[:, None], -1, 0)).max(axis=1)
    reach = rays.distance.max(axis=1) + spread + spec.tables.depth
    return np.asarray(away <= reach + 2 * math.sqrt(2) * resolution)
