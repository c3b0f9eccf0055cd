"""Rays on the lattice: where beams end, and what neighbours together say of a surface.

Ends are rounded as `occmap.grid` does.

In the surface update, a denser laser would have sent more beams between two neighbours that meet
one surface. They are drawn as far as cells lie between the ends, and from five eighths of their way
on: nearer the sensor they run through cells that the two beams cross anyway. The weight of those
that are not drawn goes to the two beams, so that every pair weighs the same however far away the
surface is.
"""

from typing import NamedTuple

import numpy as np

from occmap.cells import CellBox
from occmap.errors import MapError
from occmap.grid import FARTHEST_UNIT, refuse_long
from occmap.grid.kernels import ALONE, CELL_SHIFT, FREE, HIT, MOST_BETWEEN, NO_LENGTH
from occmap.grid.tiles import GridSpec
from occmap.jit import kernel
from occmap.types import Float64, Int16, Int32, Int64, Kind, Rays, Update

WIDEST_GAP = 12
"""Nothing is known of a surface between ends that lie more cells apart."""
SLANT = 0.1
"""The share of the nearer range by which two may differ: far walls are seen at a slant."""


class Beams(NamedTuple):
    """The beams of a batch on the lattice, in units from an anchor."""

    rays: Rays
    """Of which this says where on the lattice they lie"""
    units_per_metre: float
    """Lattice units in a metre"""
    anchor: Int64
    """(2,) x and y of a corner of a cell near the beams (lattice units)"""
    origins: Int64
    """(S, K, 2)"""
    ends_x: Int32
    """(S, B); a HIT beam is followed to its range + the model's depth"""
    ends_y: Int32
    """(S, B)"""
    ranges: Float64
    """(S, B) on the map; (0, 0) where no model asks"""
    links: Int16
    """(4, S, B) what each beam weighs, how many are drawn between it and the next, and x and y from
    the end of one of these to that of the next (units); (4, 0, 0) where the update draws none"""
    box: CellBox
    """Around all cells that the beams may touch"""


@kernel
def project_ends(beams: Beams, depth: float) -> tuple[int, int, int, int]:
    """Compute where beams end, and their ranges where a model asks.

    A beam straight up or down has no direction on the map, and ends where it begins.

    Parameters
    ----------
    depth
        How far beyond its range a HIT beam is followed on the map (m), where a model asks for
        ranges.

    Returns
    -------
    The lowest x and y of all ends, and the highest x and y.
    """
    origin, turn, bearing = beams.rays.origin, beams.rays.turn, beams.rays.bearing
    distance, kinds, ranges = beams.rays.distance, beams.rays.kind, beams.ranges
    ends_x, ends_y, scale = beams.ends_x, beams.ends_y, beams.units_per_metre
    anchor_x, anchor_y = float(beams.anchor[0]), float(beams.anchor[1])
    turns, count = turn.shape[1], kinds.shape[1]
    left = bottom = np.int32(2**31 - 1)
    right = top = np.int32(-(2**31))
    for s in range(kinds.shape[0]):
        for t in range(turns):
            k = t if origin.shape[1] > 1 else 0
            at_x, at_y = origin[s, k, 0], origin[s, k, 1]
            xx, xy, yx, yy = turn[s, t, 0, 0], turn[s, t, 0, 1], turn[s, t, 1, 0], turn[s, t, 1, 1]
            for beam in range(t, t + 1 if turns > 1 else count):
                b = np.uint64(beam)
                along_x = xx * bearing[0, b] + xy * bearing[1, b]
                along_y = yx * bearing[0, b] + yy * bearing[1, b]
                reach = np.float64(distance[s, b])
                if ranges.size:
                    length = np.sqrt(along_x * along_x + along_y * along_y)
                    ranges[s, b] = reach * length * scale
                    reach += depth / (length + NO_LENGTH) if kinds[s, b] == HIT else 0.0
                ends_x[s, b] = np.int32(np.rint((at_x + reach * along_x) * scale) - anchor_x)
                ends_y[s, b] = np.int32(np.rint((at_y + reach * along_y) * scale) - anchor_y)
        for beam in range(count):  # a loop of its own: many ends are compared at a time
            b = np.uint64(beam)
            left, right = min(left, ends_x[s, b]), max(right, ends_x[s, b])
            bottom, top = min(bottom, ends_y[s, b]), max(top, ends_y[s, b])
    return int(left), int(bottom), int(right), int(top)


@kernel
def link_neighbours(rays: Rays, ends_x: Int32, ends_y: Int32, jump: float, links: Int16) -> None:
    """Say how many beams to draw between each beam and the next, and what each beam weighs.

    Neighbours meet one surface where their ranges differ by at most `jump` (m) or by a tenth. There
    are no branches, so that many are compared at a time.

    Parameters
    ----------
    links
        As those of `Beams`, and written here; all are 0.
    """
    scans, count = rays.kind.shape
    last = count - 1
    for s in range(scans):
        around = 1 if rays.full_circle and last else 0  # the first beam comes after the last
        for begin, to_next, size in ((0, 1, last), (last, -last, around)):
            for k in range(begin, begin + size):
                i, j = np.uint64(k), np.uint64(k + to_next)
                across, up = ends_x[s, j] - ends_x[s, i], ends_y[s, j] - ends_y[s, i]
                cells = max(abs(across), abs(up)) >> CELL_SHIFT
                before, after = rays.kind[s, i], rays.kind[s, j]
                range_before, range_after = rays.distance[s, i], rays.distance[s, j]
                apart = abs(range_before - range_after)
                slanted = (apart <= SLANT * range_before) & (apart <= SLANT * range_after)
                both_hit = (before == HIT) & (after == HIT)
                joined = both_hit & (slanted | (apart <= jump)) & (cells <= WIDEST_GAP)
                both_free = (before == FREE) & (after == FREE)
                drawn = min(cells, MOST_BETWEEN) if joined else 0
                # Rounded down: half a unit keeps whole numbers from what rounding does.
                share = 1.0 / (drawn + 1)
                links[0, s, i] = MOST_BETWEEN - drawn if joined | both_free else 0
                links[1, s, i] = drawn
                links[2, s, i] = np.int32(np.floor((across + 0.5) * share))
                links[3, s, i] = np.int32(np.floor((up + 0.5) * share))
        # So far a beam has in place of its weight what the pair of it and the next does not draw.
        rest = links[0, s, last]
        for b in range(count):
            rest_before, rest = rest, links[0, s, b]
            links[0, s, b] = ALONE + rest_before + rest


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
        moved = (rays.kind == Kind.HIT) * offset
        moved += rays.distance
        rays = rays._replace(distance=moved)
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
    # Contiguous, as all other rays are, or kernels would be compiled once more for these.
    middle = np.ascontiguousarray(rays.origin[:, rays.origin.shape[1] // 2, None])
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
    drawing = spec.update is Update.SURFACE
    links = np.zeros((4, *(shape if drawing else (0, 0))), np.int16)
    beams = Beams(
        rays,
        spec.lattice.units_per_metre,
        anchor,
        origins - anchor,
        ends_x=np.empty(shape, np.int32),
        ends_y=np.empty(shape, np.int32),
        ranges=np.empty(shape if spec.radial else (0, 0)),
        links=links,
        box=CellBox(0, 0, 0, 0),  # known once it is known where they end
    )
    left, bottom, right, top = project_ends(beams, spec.tables.depth)
    if drawing:
        link_neighbours(rays, beams.ends_x, beams.ends_y, spec.jump, links)
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
