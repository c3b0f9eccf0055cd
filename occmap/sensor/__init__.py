"""What a range value means: hit, free up to a known distance, or nothing.

Drivers disagree on what they write when nothing came back (REP 117 says +inf; others write the
maximum, a value beyond it, or zero), so all of that is decided here, in one place, and counted.
Numbers that stand for "no return" without being the limit are the business of `bands`.

The robot is in its own scans: it blocks sectors, and fills a box. Both are given in the sensor's
frame, where a person reads them off a plot of one scan, and where they hold however the sensor is
mounted. What an observation says about a cell is the business of `models`.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.cells import Box
from occmap.choices import ABOVE_ZERO, SECTOR, check_bounds, make_box_form, option
from occmap.errors import require
from occmap.types import (
    Bool,
    Float32,
    Float64,
    Int32,
    Kind,
    PosedScans,
    Rays,
    Scan,
    ScanBatch,
    UInt8,
)
from occmap.values import as_float32

Sector: TypeAlias = tuple[float, float]
"""From one bearing counter-clockwise to another (rad)."""
Places: TypeAlias = NDArray[np.floating[Any]]

Sensor: TypeAlias = tuple[str, str, str]
"""A log, a topic and a frame, which is "" where clouds are in the map already"""
Voxels: TypeAlias = tuple[int, ...]
"""Numbers of cubes around a sensor"""
AROUND_M, SIDE, OUTSIDE = 2.5, 50, -(10**6)
"""These fill a ball around it, in a cube with so many of them along an edge"""

EDGE_RAD = 1e-6
"""A beam on the edge of a sector is inside, whatever its bearing was rounded to."""


class NoReturn(StrEnum):
    """What to make of a beam from which nothing came back."""

    CLEAR = "clear"
    """Space is free up to the range limit."""
    IGNORE = "ignore"
    """Nothing is known: glass, black paint and open space look alike."""


@dataclass(frozen=True)
class ReturnOptions:
    """How range values are read.

    Raises
    ------
    UsageError
        The limits leave no range to use, or a sector or the box is empty.
    """

    min_range: float = option(0.0, "Ignore nearer ranges.", unit="m")
    max_range: float = option(
        math.inf,
        "Use beams only up to here; a longer one clears the space up to here. No limit by default.",
        unit="m",
    )
    range_max: float | None = option(
        None,
        "Ranges at or beyond this count as no return; by default the limit that the log states.",
        unit="m",
        bounds=(ABOVE_ZERO, math.inf),
    )
    no_return: NoReturn = option(
        NoReturn.IGNORE, "A beam without return clears the space up to the limit, or says nothing."
    )
    ignore_sectors: tuple[Sector, ...] = option(
        (),
        "Leave out the beams from one bearing counter-clockwise to another (rad, as the sensor "
        "sees it): the robot blocks them.",
        metavar="FROM,TO",
        flag="ignore-sector",
        form=SECTOR,
    )
    footprint: Box | None = option(
        None,
        "Leave out what is measured in this box around the sensor (m, as the sensor sees it): it "
        "is the robot.",
        metavar="X_MIN,Y_MIN,X_MAX,Y_MAX",
        form=make_box_form("-0.4,-0.3,0.2,0.3"),
    )

    def __post_init__(self) -> None:
        for start, end in self.ignore_sectors:
            is_sector = math.isfinite(start) and math.isfinite(end) and start != end
            fix = "give two bearings, counter-clockwise, such as `ignore_sectors=2.5,-2.5`"
            require(is_sector, f"from {start} to {end} rad is not a sector", fix)
        if self.footprint is not None:
            x_min, y_min, x_max, y_max = self.footprint
            has_inside = all(map(math.isfinite, self.footprint)) and x_min < x_max and y_min < y_max
            fix = "give x_min,y_min,x_max,y_max around the sensor in metres"
            require(has_inside, f"{self.footprint} is not a footprint", fix)
        found = f"`min_range={self.min_range}` and `max_range={self.max_range}` leave no range"
        fix = "they must satisfy 0 <= min < max"
        require(0 <= self.min_range < self.max_range, found, fix)
        check_bounds(self)


class ReturnCounts(NamedTuple):
    """How many beams were read as what."""

    hit: int = 0
    """Beams that measured a range"""
    beyond_max_range: int = 0
    """Beams with a range beyond `max_range`: free up to there"""
    no_return: int = 0
    """Beams that nothing came back to: +inf, or at or beyond the sensor's limit"""
    too_close: int = 0
    """Beams with a range of zero, below zero, or below the nearest that counts"""
    nan: int = 0
    """Beams that were not measured"""
    own_robot: int = 0
    """Beams in one of the `ignore_sectors`, or with a hit in the `footprint`"""

    @property
    def by_name(self) -> dict[str, int]:
        """The counts by what people call them."""
        return {name.replace("_", " "): number for name, number in self._asdict().items()}

    def __add__(self, other: tuple[int, ...]) -> Self:  # type: ignore[override]  # a sum
        return type(self)(*(mine + its for mine, its in zip(self, other, strict=True)))


def read_limits(scan: Scan | ScanBatch) -> tuple[float, float]:
    """Read the nearest and the farthest range (m) that a scan states; 0 and inf where it has none.

    A limit that leaves no range, or NaN, counts as none: some drivers write zero there.
    """
    if scan.range_min >= scan.range_max > 0:
        return 0.0, math.inf
    low = scan.range_min if scan.range_min >= 0 else 0.0
    return low, scan.range_max if scan.range_max > 0 else math.inf


def interpret(posed: PosedScans, options: ReturnOptions) -> tuple[Rays, ReturnCounts]:
    """Turn posed scans into rays in the map frame, and count what the range values meant.

    A level sensor's beam at bearing a and range r ends at origin + r (cos a, sin a), turned by the
    sensor's rotation (Thrun, Burgard, Fox 2005, ch. 6); a tilted one's beam is projected down.
    """
    batch = posed.batch
    kind, distance, counts = classify(batch, options)
    origin, turn = posed.position[..., :2], posed.rotation[..., :2, :2]
    if origin.ndim == 2:
        origin, turn = origin[:, None], turn[:, None]
    rays = Rays(
        origin=np.ascontiguousarray(origin),
        turn=np.ascontiguousarray(turn),
        bearing=tabulate_bearings(batch.angle_min, batch.angle_increment, batch.ranges.shape[1]),
        distance=distance,
        kind=kind,
        stamp_ns=batch.stamp_ns,
        full_circle=goes_round(batch),
    )
    return rays, counts


def classify(batch: ScanBatch, options: ReturnOptions) -> tuple[UInt8, Float32, ReturnCounts]:
    """Say for every range value what it means and how far the beam reached.

    Returns
    -------
    kind, reach, counts
        (S, B) of Kind; (S, B) m along the beam, 0 where SKIP; and the tally.
    """
    ranges = batch.ranges
    sensor_limit = batch.range_max if options.range_max is None else options.range_max
    nearest = max(batch.range_min, options.min_range, float(np.finfo(np.float32).tiny))
    free_reach = min(sensor_limit, options.max_range)
    limits = nearest, options.max_range, sensor_limit, free_reach
    nearest, farthest, no_return, free_reach = as_float32(limits)  # rounded as ranges are
    hit = (ranges >= nearest) & (ranges < min(no_return, np.nextafter(farthest, np.float32("inf"))))
    if (own := find_own(batch, options)) is not None:
        hit &= ~own
    # Most beams hit: only the few others are looked at more closely.
    others = np.flatnonzero(~hit)
    reach = ranges.copy()
    few = reach.ravel()[others]
    robot = np.zeros(few.size, np.bool_) if own is None else own.ravel()[others]
    close = (few < nearest) & ~robot
    none = (few >= no_return) & ~close & ~robot
    missing = np.isnan(few) & ~robot
    beyond = ~(close | none | robot | missing)
    clears = options.no_return is NoReturn.CLEAR and np.isfinite(free_reach)
    free = beyond | none if clears else beyond
    kind = hit.view(np.uint8) * np.uint8(Kind.HIT)
    kind.ravel()[others] = free * np.uint8(Kind.FREE)
    reach.ravel()[others] = np.where(free, free_reach, np.float32(0))
    counts = map(int, map(np.count_nonzero, (beyond, none, close, missing, robot)))
    return kind, reach, ReturnCounts(hit.size - others.size, *counts)


def find_own(batch: ScanBatch, options: ReturnOptions) -> Bool | None:
    """(S, B): which ranges are the robot's own or blocked by it; None: the user names none."""
    if not options.ignore_sectors and options.footprint is None:
        return None
    beams = batch.ranges.shape[1]
    bearings = batch.angle_min + batch.angle_increment * np.arange(beams, dtype=np.float64)
    own = np.broadcast_to(find_inside(bearings, options.ignore_sectors), batch.ranges.shape)
    if options.footprint is None:
        return own
    with np.errstate(invalid="ignore"):  # infinity times 0
        x, y = tabulate_bearings(batch.angle_min, batch.angle_increment, beams)
        return own | find_within(batch.ranges * x, batch.ranges * y, options.footprint)


def find_inside(bearings: Float64, sectors: tuple[Sector, ...]) -> Bool:
    """(N,): which bearings lie in one of the sectors."""
    inside = np.zeros(len(bearings), np.bool_)
    for start, end in sectors:
        width = (end - start) % math.tau or math.tau
        inside |= (bearings - start + EDGE_RAD) % math.tau <= width + 2 * EDGE_RAD
    return inside


def find_within(x: Places, y: Places, box: Box) -> Bool:
    """Which places, of any shape, lie in a box or on its edge."""
    x_min, y_min, x_max, y_max = as_float32(box)  # rounded as ranges are, and so are places
    x, y = as_float32(x), as_float32(y)
    return np.asarray((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max))


def number_voxels(points: Float32) -> Int32:
    """Number the voxels in which points (N, 3; m, as the sensor sees them) lie, or `OUTSIDE`."""
    x, y, z = np.ascontiguousarray(points.T)
    with np.errstate(over="ignore"):  # where a log is damaged they are of any bits
        square = x * x + y * y + z * z
    near = (square > 0) & (square < AROUND_M * AROUND_M)  # 0 is no return
    voxel = np.full(len(points), OUTSIDE, np.int32)
    x, y, z = (((it[near] + AROUND_M) * (SIDE / 2 / AROUND_M)).astype(np.int32) for it in (x, y, z))
    voxel[near] = (z * SIDE + y) * SIDE + x
    return voxel


def place_voxels(voxels: Int32) -> Float64:
    """(V, 3) the middles of voxels (m)."""
    z, y, x = np.unravel_index(voxels, (SIDE, SIDE, SIDE))
    return np.asarray((np.stack([x, y, z], axis=1) + 0.5) * (2 * AROUND_M / SIDE) - AROUND_M)


def drop_own_points(posed: PosedScans, options: ReturnOptions, body: Voxels = ()) -> PosedScans:
    """Make no returns of the points of clouds that are the robot's own or blocked by it.

    Nothing is known of how the sensor saw points that are in the map's frame already: they stay.

    Parameters
    ----------
    body
        Where the robot is; points in voxels beside these are its own, too.
    """
    if not (options.footprint or options.ignore_sectors or body) or posed.origin is not None:
        return posed
    steps = np.array([*product((-1, 0, 1), repeat=3)]) @ [SIDE * SIDE, SIDE, 1]
    of_body = np.add.outer(np.array(body, np.int64), steps)
    clouds = []
    for cloud in posed.batch.clouds or ():
        points = cloud.points.copy()
        x, y = points[:, :2].T.astype(np.float64)
        own = np.zeros(len(points), np.bool_)
        if body:
            own |= np.isin(number_voxels(points[:, :3]), of_body)
        if options.ignore_sectors:
            own |= find_inside(np.arctan2(y, x), options.ignore_sectors)
        if options.footprint is not None:
            own |= find_within(x, y, options.footprint)
        points[own] = 0
        clouds.append(cloud._replace(points=points))
    return replace(posed, batch=replace(posed.batch, clouds=tuple(clouds)))


def goes_round(batch: ScanBatch) -> bool:
    """Whether the beams go all the way round, to half an increment."""
    return bool((batch.ranges.shape[1] + 0.5) * abs(batch.angle_increment) >= math.tau)


@lru_cache(maxsize=64)
def tabulate_bearings(angle_min: float, angle_increment: float, beams: int) -> Float64:
    """(2, B) unit vectors of every bearing: a log repeats its geometry thousands of times."""
    bearings = angle_min + angle_increment * np.arange(beams)
    return np.stack([np.cos(bearings), np.sin(bearings)])
