"""When cells were observed, by the polygon update: every scan's region is filled.

What is kept of a window is as in `time_beams`.
"""

import numpy as np

from occmap.grid.kernels.fill import fill_outline, find_rows
from occmap.grid.kernels.jit import kernel
from occmap.grid.kernels.outline import Beams, Surfaces, link_beams, list_border, outline_scan
from occmap.grid.kernels.project import round_to_units
from occmap.grid.kernels.radial_polygon import (
    FAR,
    NEAR,
    aim,
    limit_ranges,
    reach_out,
    stay_within,
)
from occmap.grid.kernels.sectors import (
    BEARINGS,
    bearing_of,
    cover_bearings,
    find_sectors,
    outline_sectors,
)
from occmap.grid.kernels.time_beams import mark_cell, set_bit
from occmap.grid.kernels.units import CELL_SHIFT, HALF_CELL
from occmap.types import Float32, Float64, Int32, Int64, UInt8, UInt64


@kernel
def mark_span(
    times: UInt64, seen: UInt64, row: int, col: int, end: int, early: int, late: int
) -> None:
    """Note that the cells of a row from one column up to another were seen."""
    r = np.uint64(row)
    for c in range(col, end):
        times[r, np.uint64(c), 0] = max(times[r, np.uint64(c), 0], early)
        times[r, np.uint64(c), 1] = max(times[r, np.uint64(c), 1], late)
        seen[r, np.uint64(c >> 6)] |= np.uint64(1) << np.uint64(c & 63)


@kernel
def time_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    stamps: UInt64,
    surfaces: Surfaces,
    times: UInt64,
    hit: UInt64,
    seen: UInt64,
) -> None:
    """Note when every scan had a cell inside its regions or on its border.

    Parameters
    ----------
    origin, turn, bearing, distance, ends_x, ends_y, kinds, surfaces
        As for `trace_polygons`.
    stamps, times, hit, seen
        As for `time_beams`.
    """
    scans, beams = kinds.shape
    rows, cols = times.shape[0], times.shape[1]
    x, y = np.empty(3 * beams + 4, np.int64), np.empty(3 * beams + 4, np.int64)
    begins = np.empty(3 * beams + 4, np.bool_)
    links, room = np.empty(beams, np.uint8), np.empty(beams, np.int32)
    cells = np.empty((beams * max(surfaces.border_gap, 1) + 1, 2), np.int32)
    starts, counts = np.empty(rows, np.int32), np.empty(rows, np.int32)
    found, spans = np.empty((2, 4 * rows), np.int32), np.empty(4 * rows, np.int32)
    for s in range(scans):
        early, late = stamps[s, 0], stamps[s, 1]
        scan = Beams(origin[s, 0], turn[s], bearing, distance[s], kinds[s], ends_x[s], ends_y[s])
        listed = link_beams(scan, surfaces, links, room)
        corners, touched = outline_scan(scan, surfaces, links, listed, x, y, begins, rows)
        found, spans = fill_outline(
            x, y, begins, corners, touched, cols, starts, counts, found, spans
        )
        _time_spans(touched, starts, counts, spans, early, late, times, seen)
        size = list_border(scan, links, listed, surfaces, rows, cols, cells)
        for i in range(size):
            set_bit(hit, cells[i, 0], cells[i, 1])
            mark_cell(times, seen, cells[i, 0], cells[i, 1], early, late)


@kernel
def _time_spans(
    touched: tuple[int, int],
    starts: Int32,
    counts: Int32,
    spans: Int32,
    early: int,
    late: int,
    times: UInt64,
    seen: UInt64,
) -> None:
    """Note that the cells of one scan's spans were seen."""
    for row in range(touched[0], touched[1]):
        for i in range(starts[row], starts[row] + counts[row], 2):
            mark_span(times, seen, row, spans[i], spans[i + 1], early, late)


@kernel
def time_radial_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    full_circle: bool,
    stamps: UInt64,
    corner: Int64,
    units_per_metre: float,
    depth: float,
    steps: int,
    constant: int,
    times: UInt64,
    seen: UInt64,
) -> None:
    """Note when every scan said something about the cells that it covers.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds, full_circle, corner, units_per_metre, depth
        As for `trace_radial_polygons`.
    steps, constant
        Steps of the model's tables, and at how many of them the first, free one stays the same.
    stamps, times, seen
        As for `time_beams`.
    """
    scans, beams = kinds.shape
    rows, cols = times.shape[0], times.shape[1]
    plain = np.sqrt(constant / steps)
    direction, ranges = np.empty((beams, 2), np.float64), np.empty(beams, np.float64)
    sides, covers = np.empty((beams, 4), np.float64), np.empty(beams, np.bool_)
    lengths, covering = np.empty((beams, 2), np.float64), np.empty(BEARINGS + 1, np.int32)
    limits = np.empty((beams + 1, 4), np.float64)
    x, y = np.empty(4 * beams + 4, np.int64), np.empty(4 * beams + 4, np.int64)
    begins = np.empty(4 * beams + 4, np.bool_)
    starts, counts = np.empty(rows, np.int32), np.empty(rows, np.int32)
    found, spans = np.empty((2, 4 * rows), np.int32), np.empty(4 * rows, np.int32)
    for s in range(scans):
        early, late = stamps[s, 0], stamps[s, 1]
        at_x = round_to_units(origin[s, 0, 0], units_per_metre) - corner[0]
        at_y = round_to_units(origin[s, 0, 1], units_per_metre) - corner[1]
        aim(turn[s], bearing, distance[s], units_per_metre, direction, ranges)
        sign = find_sectors(direction, kinds[s], full_circle, sides, covers)
        side_by_side = cover_bearings(sides, kinds[s], covers, sign, covering)
        reach_out(direction, ranges, kinds[s], depth, sides, lengths)
        limit_ranges(ranges, kinds[s], depth, steps, limits)
        corners = outline_sectors(at_x, at_y, sides, lengths, covers, x, y, begins)
        touched = find_rows(y, corners, rows)
        found, spans = fill_outline(
            x, y, begins, corners, touched, cols, starts, counts, found, spans
        )
        _time_sectors(
            at_x, at_y, touched, starts, counts, spans, covering, limits, early, late, times, seen
        )
        if side_by_side:
            # What lies well within the ranges is observed whatever the bearing's rounding says.
            stay_within(ranges, covers, full_circle, depth, plain, lengths)
            corners = outline_sectors(at_x, at_y, sides, lengths, covers, x, y, begins)
            found, spans = fill_outline(
                x, y, begins, corners, touched, cols, starts, counts, found, spans
            )
            _time_spans(touched, starts, counts, spans, early, late, times, seen)


@kernel
def _time_sectors(
    at_x: int,
    at_y: int,
    touched: tuple[int, int],
    starts: Int32,
    counts: Int32,
    spans: Int32,
    covering: Int32,
    limits: Float64,
    early: int,
    late: int,
    times: UInt64,
    seen: UInt64,
) -> None:
    """Note the cells of one scan's spans of which the beam that covers their bearing speaks."""
    for row in range(touched[0], touched[1]):
        from_y = float((row << CELL_SHIFT) + HALF_CELL - at_y)
        for i in range(starts[row], starts[row] + counts[row], 2):
            for col in range(spans[i], spans[i + 1]):
                from_x = float((col << CELL_SHIFT) + HALF_CELL - at_x)
                b = covering[bearing_of(from_x, from_y)]
                squared = from_x * from_x + from_y * from_y
                if squared < limits[b, NEAR] or squared <= limits[b, FAR]:
                    mark_cell(times, seen, row, col, early, late)
