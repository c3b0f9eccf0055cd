"""The beam update of a radial sensor model: what each beam says about the cells along it.

Clipped at p_min, such a model says the same about all cells from the sensor up to some share of the
range. These are noted as runs and steps, as in `beam`; only the cells beyond are visited.
"""

from typing import NamedTuple

import numpy as np

from occmap.grid.kernels.beam import Changes, add_line
from occmap.grid.kernels.units import BETWEEN, CELL_SHIFT, HALF_CELL, HIT, SKIP, UNITS_PER_CELL
from occmap.jit import kernel
from occmap.types import Float32, Float64, Int32, Int64, UInt8

FARTHEST_CENTRE = 1.25
"""Cells by which a cell's centre may be farther from the sensor than its place on the line: half a
diagonal at the sensor, and half a cell beside the line."""


class Profile(NamedTuple):
    """A radial sensor model, tabulated."""

    depth: float
    """How far about the range a hit reaches (lattice units)"""
    free: Int64
    """(T + 1,) over (d / (r - depth))^2; the first `constant` entries are equal"""
    hit: Int64
    """(T + 1,) over |d - r| / depth"""
    constant: int


@kernel
def trace_radial_beams(
    origins: Int64,
    ends_x: Int32,
    ends_y: Int32,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    kinds: UInt8,
    weights: UInt8,
    between: UInt8,
    corner: Int64,
    units_per_metre: float,
    profile: Profile,
    cells: Int64,
    changes: Changes,
) -> None:
    """Add what every beam says about the cells along it, up to the end of its influence.

    Parameters
    ----------
    origins, ends_x, ends_y
        (S, K, 2) and (S, B) in lattice units from an anchor; a HIT beam ends at its range + depth.
    turn, bearing, distance, kinds
        (S, K, 2, 2), (2, B), (S, B), (S, B) as in `Rays`.
    weights, between
        (S, B) as in `Projected`.
    corner
        (2,) x and y of the window's corner in lattice units from the anchor.
    cells
        (H, W) sums of the entries of the cells that were visited.
    changes
        For the cells that get the first entry of `free`.
    """
    scans, beams = kinds.shape
    viewpoints, turns = origins.shape[1], turn.shape[1]
    rows, cols = cells.shape
    free, hit, depth = profile.free, profile.hit, profile.depth
    row_runs, row_steps = changes.row_runs, changes.row_steps
    col_runs, col_steps = changes.col_runs, changes.col_steps
    table_steps = free.size - 1
    plain = np.sqrt(profile.constant / table_steps)
    for s in range(scans):
        for b in range(beams):
            if kinds[s, b] == SKIP:
                continue
            k, t = min(b, viewpoints - 1), min(b, turns - 1)
            along_x = turn[s, t, 0, 0] * bearing[0, b] + turn[s, t, 0, 1] * bearing[1, b]
            along_y = turn[s, t, 1, 0] * bearing[0, b] + turn[s, t, 1, 1] * bearing[1, b]
            length = np.sqrt(along_x * along_x + along_y * along_y)
            r = distance[s, b] * length * units_per_metre
            at_x, at_y = origins[s, k, 0] - corner[0], origins[s, k, 1] - corner[1]
            from_x, from_y = at_x, at_y
            to_x, to_y = ends_x[s, b] - corner[0], ends_y[s, b] - corner[1]
            weight, parts = np.int64(weights[s, b]), np.int32(between[s, b]) + 1
            step_x = step_y = 0
            for part in range(1, parts + 1):  # the beam itself, then those between it and the next
                # u is the line's major axis, v the other.
                across = abs((to_x >> CELL_SHIFT) - (from_x >> CELL_SHIFT))
                steep = abs((to_y >> CELL_SHIFT) - (from_y >> CELL_SHIFT)) > across
                u, v, u_end, v_end = from_x, from_y, to_x, to_y
                sensor_u, sensor_v = at_x, at_y
                if steep:
                    u, v, u_end, v_end = from_y, from_x, to_y, to_x
                    sensor_u, sensor_v = at_y, at_x
                u, v = u >> CELL_SHIFT, v >> CELL_SHIFT
                u_end, v_end = u_end >> CELL_SHIFT, v_end >> CELL_SHIFT
                width, height = (rows, cols) if steep else (cols, rows)
                u_sign, v_sign = (1 if u_end > u else -1), (1 if v_end > v else -1)
                n, m = abs(u_end - u), abs(v_end - v)
                inside = (
                    min(u, u_end) >= 0
                    and max(u, u_end) < width
                    and min(v, v_end) >= 0
                    and max(v, v_end) < height
                )
                before = max(r - depth, 0.0)
                done = 0
                if inside and n > 0 and part == 1:
                    near = plain * before / UNITS_PER_CELL - FARTHEST_CENTRE
                    done = min(max(int(near * n / np.sqrt(float(n * n + m * m))), 0), n)
                if done > 0 and steep:
                    add_line(col_runs, col_steps, rows + 1, u, v, u_end, v_end, done, int(weight))
                elif done > 0:
                    add_line(row_runs, row_steps, cols + 1, u, v, u_end, v_end, done, int(weight))
                error = n + 2 * done * m
                if done > 0:
                    u += u_sign * done
                    v += v_sign * (error // (2 * n))
                    error %= 2 * n
                until = before * before
                scale = table_steps / max(until, 1.0)
                is_hit = kinds[s, b] == HIT
                from_u = (u << CELL_SHIFT) + HALF_CELL - sensor_u
                from_v = (v << CELL_SHIFT) + HALF_CELL - sensor_v
                for _ in range(done, n + 1):
                    if inside or (0 <= u < width and 0 <= v < height):
                        squared = float(from_u * from_u + from_v * from_v)
                        row, col = (
                            (np.uint64(u), np.uint64(v)) if steep else (np.uint64(v), np.uint64(u))
                        )
                        if squared < until:
                            cells[row, col] += weight * free[np.uint64(squared * scale)]
                        elif is_hit:
                            off = abs(np.sqrt(squared) - r)
                            if off <= depth:
                                cells[row, col] += (
                                    weight * hit[np.uint64(off / depth * table_steps)]
                                )
                    u += u_sign
                    from_u += u_sign << CELL_SHIFT
                    error += 2 * m
                    if error >= 2 * n:
                        error -= 2 * n
                        v += v_sign
                        from_v += v_sign << CELL_SHIFT
                if part < parts:
                    if part == 1:
                        c = b + 1 if b + 1 < beams else 0
                        step_x = (ends_x[s, c] - ends_x[s, b]) // parts
                        step_y = (ends_y[s, c] - ends_y[s, b]) // parts
                    to_x, to_y = to_x + step_x, to_y + step_y
                    from_x, from_y = (3 * at_x + 5 * to_x) >> 3, (3 * at_y + 5 * to_y) >> 3
                    r = max(np.hypot(float(to_x - at_x), float(to_y - at_y)) - depth, 0.0)
                    weight = np.int64(BETWEEN)
