"""Rays on the lattice: where they begin and end, and the box of cells that they may touch."""

from dataclasses import dataclass

import numpy as np

from occmap.grid.kernels.project import project_ends
from occmap.grid.kernels.units import CELL_SHIFT
from occmap.grid.lattice import CellBox
from occmap.grid.spec import GridSpec
from occmap.types import Int32, Int64, Rays, Update


@dataclass(frozen=True)
class Projected:
    """Rays and where on the lattice they begin and end."""

    rays: Rays
    anchor: Int64
    """(2,) x and y of a corner of a cell near them (lattice units)"""
    origins: Int64
    """(S, K, 2) x and y (lattice units from the anchor)"""
    ends_x: Int32
    """(S, B) (lattice units from the anchor)"""
    ends_y: Int32
    """(S, B) (lattice units from the anchor)"""
    box: CellBox
    """Around all cells that these rays may touch"""


def project(rays: Rays, spec: GridSpec) -> Projected:
    """Round rays to the lattice, once."""
    depth = 0.0 if spec.radial is None else spec.radial.depth
    origins = spec.lattice.to_units(rays.origin)
    anchor = origins[0, 0] >> CELL_SHIFT << CELL_SHIFT
    origins -= anchor
    ends_x, ends_y = np.empty(rays.kind.shape, np.int32), np.empty(rays.kind.shape, np.int32)
    lowest_x, lowest_y, highest_x, highest_y = project_ends(
        rays.origin,
        rays.turn,
        rays.bearing,
        rays.distance,
        rays.kind,
        depth,
        spec.lattice.units_per_metre,
        anchor.astype(np.float64),
        ends_x,
        ends_y,
    )
    lowest, highest = origins.min(axis=(0, 1)).tolist(), origins.max(axis=(0, 1)).tolist()
    left, bottom = min(lowest_x, lowest[0]), min(lowest_y, lowest[1])
    right, top = max(highest_x, highest[0]), max(highest_y, highest[1])
    left, bottom, right, top = (edge >> CELL_SHIFT for edge in (left, bottom, right, top))
    to_col, to_row = (int(corner) >> CELL_SHIFT for corner in anchor)
    margin = 1 + _reach_beside(rays, spec)
    box = CellBox(
        to_row + bottom - margin,
        to_col + left - margin,
        to_row + top + 1 + margin,
        to_col + right + 1 + margin,
    )
    return Projected(rays, anchor, origins, ends_x, ends_y, box)


def _reach_beside(rays: Rays, spec: GridSpec) -> int:
    """How many cells beside their ends beams have a say in: half-way to their neighbours."""
    if spec.radial is None or spec.update is Update.BEAM or rays.kind.shape[1] < 2:
        return 0
    # A turn makes no difference of two bearings longer, and at most doubles its larger part.
    single = rays.turn.shape[1] == 1
    directions = rays.bearing.T if single else rays.direction
    spread = float(np.abs(np.diff(directions, axis=-2)).max())
    reach = float(rays.distance.max()) + spec.radial.depth
    return int(reach * min(2 * spread, 1.0) / spec.lattice.resolution) + 2
