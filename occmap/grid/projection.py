"""Rays on the lattice: where they begin and end, and the box of cells that they may touch."""

import math

import numpy as np

from occmap.errors import MapError
from occmap.grid.kernels.projection import Beams, link_neighbours, project_ends
from occmap.grid.kernels.units import CELL_SHIFT, NO_LENGTH, TILE
from occmap.grid.lattice import FARTHEST_UNIT, CellBox, refuse_long
from occmap.grid.spec import GridSpec
from occmap.grid.windows import choose_windows
from occmap.types import Bool, Int64, Kind, Rays, Update


def prepare(rays: Rays, spec: GridSpec) -> Rays:
    """Move hits behind the measured surfaces; for a polygon, see each scan from one point.

    Raises
    ------
    MapError
        A sensor is too far away to be counted in lattice units, or not finite, or a beam has more
        cells than a kernel's integers can hold.
    """
    resolution, farthest = spec.lattice.resolution, float(np.abs(rays.origin).max(initial=0.0))
    if not farthest * spec.lattice.units_per_metre < FARTHEST_UNIT:
        raise MapError(
            f"a sensor {farthest:.6g} m from the map's zero is too far away for cells of "
            f"{resolution} m",
            fix="if a pose is wrong, leave it out with `start_s` and `end_s`; else use a coarser "
            "`resolution`",
        )
    if spec.hit_offset:
        offset = np.float32(spec.hit_offset * resolution)
        rays = rays._replace(distance=rays.distance + (rays.kind == Kind.HIT) * offset)
    if spec.update is Update.POLYGON:
        rays = join_viewpoints(rays)
    refuse_long(float(rays.distance.max(initial=0.0)), resolution)
    return rays


def join_viewpoints(rays: Rays) -> Rays:
    """See each scan from one point, where every beam has a viewpoint of its own.

    A scan's region is closed through the sensor, which is taken to be where the middle beam has it.
    The ends of the beams stay where they are, to the rounding of a float32.
    """
    if rays.origin.shape[1] == 1:
        return rays
    middle = rays.origin[:, rays.origin.shape[1] // 2, None]
    offset = rays.end - middle
    distance = np.hypot(offset[..., 0], offset[..., 1]) * (rays.kind > 0)
    seen = (distance > 0)[..., None]
    direction = np.where(seen, offset / np.maximum(distance, NO_LENGTH)[..., None], rays.direction)
    circle = rays.full_circle
    return Rays.along(middle, direction, distance, rays.kind, rays.stamp_ns, full_circle=circle)


def project(rays: Rays, spec: GridSpec) -> Beams:
    """Round rays, as `prepare` gives them, to the lattice, once."""
    shape = rays.kind.shape
    origins = spec.lattice.to_units(rays.origin)
    anchor = origins[0, 0] >> CELL_SHIFT << CELL_SHIFT
    weights = between = np.zeros((0, 0), np.uint8)
    if spec.update is not Update.POLYGON or shape[1] == 1:  # a single beam is a line
        weights, between = np.ones(shape, np.uint8), np.zeros(shape, np.uint8)
    drawing = spec.update is Update.SURFACE
    beams = Beams(
        rays,
        spec.lattice.units_per_metre,
        anchor,
        origins - anchor,
        ends_x=np.empty(shape, np.int32),
        ends_y=np.empty(shape, np.int32),
        ranges=np.empty(shape if spec.radial else (0, 0)),
        weights=weights,
        between=between,
        steps=np.empty((*shape, 2) if drawing else (0, 0, 2), np.int16),
        box=CellBox(0, 0, 0, 0),  # known once it is known where they end
    )
    left, bottom, right, top = project_ends(beams, spec.tables.depth)
    if drawing:
        link_neighbours(beams, spec.jump)
    lowest = np.minimum(beams.origins.min(axis=(0, 1)), (left, bottom))
    highest = np.maximum(beams.origins.max(axis=(0, 1)), (right, top))
    edges = np.stack([lowest, highest]) + anchor
    (col, row), (col_end, row_end) = (edges >> CELL_SHIFT).tolist()
    box = CellBox(row, col, row_end + 1, col_end + 1).grow(1 + _reach_beside(rays, spec))
    return beams._replace(box=box)


def _reach_beside(rays: Rays, spec: GridSpec) -> int:
    """How far beside their ends beams affect cells (cells): half-way to their neighbours."""
    if spec.radial is None or spec.update is not Update.POLYGON or rays.kind.shape[1] < 2:
        return 0
    # A turn keeps or shortens the difference of two bearings: neither x nor y more than doubles.
    single = rays.turn.shape[1] == 1
    directions = rays.bearing.T if single else rays.direction
    spread = float(np.abs(np.diff(directions, axis=-2)).max())
    reach = float(rays.distance.max()) + spec.radial.depth
    return int(reach * min(2 * spread, 1.0) / spec.lattice.resolution) + 2


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
