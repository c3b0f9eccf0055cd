"""How a 3D sensor is mounted on a robot that drives upright, by the floor that its clouds show.

Clouds of many places, laid over each other in the sensor's own frame, have one plane in common with
hardly a point beneath it: the floor, the wall of a corridor, or a ceiling. Which one it is, and how
far the sensor is turned about the vertical, shows in the map, where only the right mount lays all
clouds over each other.

How the floor of single clouds leans over the ground of all of them tells mounts, and poses, that
are off by a little.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occmap.cells import Ground
from occmap.posing.tracks import to_quaternions
from occmap.types import Bool, Float64, Pose, PosedScans

POINTS = 1500
"""How many points of each cloud are looked at, about"""
NEAREST_M, FARTHEST_M = 0.3, 8.0
"""Points are looked at that are as far from the sensor"""
THICK_M = 0.05
"""The floor lies within this distance from its plane"""
HIGHEST_M = 3.0
"""No sensor sits higher above the floor"""
TRIALS = 400
"""Planes through three points each that are tried for each direction"""
LEANING = math.cos(math.radians(40))
"""No sensor is tilted by more from one of the usual ways to mount it"""
LEAST_SHARE = 0.08
"""A plane that holds a smaller share of the points is no floor"""
CELL_M = 0.2
CLEAR_WIN = 0.95
"""By the right mount clouds fill fewer cells than this share of what they fill by another one"""
STEEP, AS_FEW = math.cos(math.radians(45)), 1.02
"""Where the floor leans by less from that of a mount as given, or level, so many cells are enough.
A wall or a ceiling leans by more. Taken for the floor, it makes clouds fill 1.05 times the cells,
or as many where a robot never turns."""
LEVEL = np.eye(3)
UPRIGHT, OPTICAL, UPSIDE_DOWN = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
FORWARD = {UPRIGHT: (1.0, 0.0, 0.0), OPTICAL: (0.0, 0.0, 1.0), UPSIDE_DOWN: (1.0, 0.0, 0.0)}
"""The axes that point up, in the usual ways to mount a sensor, and those that then look ahead"""


class Floor(NamedTuple):
    """A plane in the frame of the sensor."""

    up: Float64
    """(3,) its normal"""
    below: float
    """How far it lies below the sensor (m)"""
    score: float
    """The share of the points that lie in it, less three times the share that lies beneath"""


class Seat(NamedTuple):
    """How a sensor sits, as far as its clouds tell."""

    mount: Pose
    """At the body's origin"""
    height: float
    """How high it is above the floor (m)"""
    has_yaw: bool
    """Whether the walls in the clouds told its yaw"""


def find_seat(parts: Sequence[PosedScans], given: Float64 = LEVEL) -> Seat | None:
    """Find how a sensor is turned on its body.

    Parameters
    ----------
    parts
        Scans with clouds, posed as if the sensor were the body.
    given
        (3, 3) how it is turned as far as anybody said.

    Returns
    -------
    Seat or None
        None where its clouds show no floor, or a steep one by which they fit each other no better.
    """
    points = [some for part in parts for some in list_points(part)]
    pooled = np.concatenate([near for near, _, _ in points] or [np.zeros((0, 3))])
    if len(pooled) < POINTS:
        return None
    usual = [(other[2], count_cells(points, other)) for other in (given, LEVEL)]
    seats: dict[int, Seat] = {}
    for axis, way in FORWARD.items():
        floor = find_floor(pooled, np.array(axis))
        if floor.score < LEAST_SHARE or floor.below < NEAREST_M / 2:
            continue
        ahead, aside = np.array(way), np.cross(floor.up, way)
        turns = [stand_upright(floor.up, to) for to in (ahead, -aside, -ahead, aside)]
        filled = [count_cells(points, turn) for turn in turns]
        best, second = np.argsort(filled, kind="stable")[:2].tolist()
        has_yaw = filled[best] < CLEAR_WIN * filled[second]
        rotation = turns[best if has_yaw else 0]
        mount = Pose(0.0, 0.0, 0.0, *to_quaternions(rotation[None])[0].tolist())
        most = min(it * (AS_FEW if floor.up @ up > STEEP else CLEAR_WIN) for up, it in usual)
        if filled[best] <= most:
            seats[filled[best]] = Seat(mount, floor.below, has_yaw)
    return seats[min(seats)] if seats else None


def list_points(part: PosedScans) -> list[tuple[Float64, Float64, Float64]]:
    """List, cloud by cloud, some points (N, 3) near the sensor, its rotation and its position."""
    found = []
    position, rotation = part.at_first_beam
    for cloud, place, turned in zip(part.batch.clouds or (), position, rotation, strict=True):
        with np.errstate(invalid="ignore"):  # where a log is damaged they are of any bits
            some = cloud.points[:: max(len(cloud.points) // POINTS, 1)].astype(np.float64)
            distance = np.linalg.norm(some, axis=1)
            near = (distance > NEAREST_M) & (distance < FARTHEST_M)
        found.append((some[near], turned, place))
    return found


def find_floor(points: Float64, axis: Float64) -> Floor:
    """Find the plane below the sensor that most points (N, 3) lie in, with the fewest beneath it.

    Its normal lies near an axis of the sensor. Planes through three points each are tried, and the
    best is fitted to all points in it.
    """
    rng = np.random.default_rng(0)
    some = points[rng.integers(0, len(points), 4 * POINTS)]
    one, two, three = points[rng.integers(0, len(points), (3, 4 * TRIALS))]
    normals = np.cross(two - one, three - one)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    normals *= np.sign(normals @ axis)[:, None]
    below = -np.einsum("ni,ni->n", normals, one)
    likely = (normals @ axis > LEANING) & (below > 0) & (below < HIGHEST_M)
    best = Floor(axis, 0.0, -math.inf)
    for up, height in zip(normals[likely][:TRIALS], below[likely][:TRIALS].tolist(), strict=True):
        best = max(best, judge(some, up, height), key=lambda each: each.score)
    for _ in range(3 if best.score > 0 else 0):
        inside = points[np.abs(points @ best.up + best.below) < THICK_M]
        middle = inside.mean(axis=0)
        up = np.linalg.svd(inside - middle, full_matrices=False)[2][2]
        up *= np.sign(up @ best.up)
        best = judge(points, up, float(-up @ middle))
    return best


def judge(points: Float64, up: Float64, below: float) -> Floor:
    """Measure how much a plane is like a floor."""
    height = points @ up + below
    inside, beneath = np.abs(height) < THICK_M, height < -2 * THICK_M
    return Floor(up, below, float(inside.mean() - 3 * beneath.mean()))


def stand_upright(up: Float64, ahead: Float64) -> Float64:
    """Give the rotation (3, 3) to the body of a sensor in whose frame `up` points up."""
    forward = ahead - (ahead @ up) * up
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(up, forward), up])


def count_cells(points: Sequence[tuple[Float64, Float64, Float64]], rotation: Float64) -> int:
    """Count the cubes that points fill in the map.

    Parameters
    ----------
    points
        By cloud, with its rotation and its position.
    rotation
        (3, 3) how the sensor is mounted.
    """
    in_map = [near @ (turned @ rotation).T + place for near, turned, place in points]
    # Rounded to the nearest: a floor at zero would else lie between two of them.
    cells = np.rint(np.concatenate(in_map) / CELL_M).astype(np.int64)
    return len(np.unique(cells @ [1 << 42, 1 << 21, 1]))


FLOOR_FROM_M = 1.0
"""Tilts are measured from this distance on, and up to the same: farther away, poses that are off
move the floor more."""
FLOOR_M, LIFTED_M = 0.25, 1.0
"""No floor lies farther from the ground that was found, and none that a wrong mount lifts"""
BESIDE_M = 1.0
"""The ground is shifted to where the robot stood at most so far away"""
STEADY_M = 0.06
"""Where a sensor's height differs by more, a hand carries it, and the ground is not shifted (m)"""
LOOKED_AT = 2000
"""Points of a cloud that tilts are measured by, about"""
TILT_ROUNDS = 6
SHOWS_TILT, FEWEST_ALONE = 100, 10
"""Points of the floor that show how their cloud is tilted, and clouds that show how all sway"""


class Tilts(NamedTuple):
    """How points of the floor lie over the ground, by small rotations that would lay them flat."""

    sensor: Float64
    """(3,) in the frame of the points (rad): if a mount is wrong"""
    upright: Float64
    """(3,) in the map (rad): if the poses' own up is wrong"""
    is_mount: bool
    """Whether the first explains them better"""
    sway: float
    """By what half of the clouds are tilted or more, each in its own way (rad)"""


def measure_tilts(clouds: Sequence[PosedScans], ground: Ground) -> Tilts | None:
    """Measure by which rotation the floor in clouds lies flat; None where too little is seen.

    A rotation by a small vector d lifts a point that lies at p from the sensor by d . (p x up). In
    the sensor's frame d is constant where its mount is wrong, in the map's where the poses are.
    What the ground is made of is turned likewise, and hides the error: so it is shifted to where
    the robot stood when it came by, which is as far below the sensor anywhere.
    """
    from occmap.clouds.kernels import heights  # noqa: PLC0415  late: it brings LLVM

    seen = [
        (*heights.pose_points(cloud, LOOKED_AT), cloud.origin)
        for posed in clouds
        for cloud in heights.list_clouds(posed)
    ]
    stood = np.array([origin for _, _, origin in seen]).reshape(-1, 3)
    stood[:, 2] -= ground.find_heights(stood)
    stood = stood[np.isfinite(stood[:, 2])]
    if not len(stood):
        return None
    stood[:, 2] -= np.median(stood[:, 2])
    if stood[:, 2].std() > STEADY_M:
        stood[:, 2] = 0
    rows = [find_levers(*each, ground, stood) for each in seen]
    above, in_sensor, in_map = (np.concatenate(each) for each in zip(*rows, strict=True))
    if np.count_nonzero(np.abs(above) < FLOOR_M) < LOOKED_AT:
        return None
    fits = [fit_robustly(levers, above) for levers in (in_sensor, in_map)]
    (sensor, left), (upright, left_by_map) = fits
    alone = [
        fit_robustly(levers, above)[0] - upright
        for above, _, levers in rows
        if np.count_nonzero(np.abs(above) < FLOOR_M) >= SHOWS_TILT
    ]
    sway = float(np.median(np.linalg.norm(alone, axis=1))) if len(alone) >= FEWEST_ALONE else 0.0
    return Tilts(-sensor, -upright, left <= left_by_map, sway)


def find_levers(
    some: Float64, pose: Float64, origin: Float64, ground: Ground, stood: Float64
) -> tuple[Float64, Float64, Float64]:
    """Find how high points of a cloud lie over the ground, and what they would be lifted.

    Parameters
    ----------
    some, pose, origin
        (N, 3) the points, (N, 3, 4) the pose of each, and (3,) where the sensor was.
    stood
        (P, 3) where the robot stood, and how far below it the ground was found too low (m).
    """
    turned = np.einsum("nij,nj->ni", pose[:, :, :3], some)
    place = turned + pose[:, :, 3]
    distance = np.linalg.norm((place - origin)[:, :2], axis=1)
    with np.errstate(invalid="ignore"):
        near = (distance > FLOOR_FROM_M) & (distance < FARTHEST_M)
    some, turned, place, up_there = (each[near] for each in (some, turned, place, pose[:, 2, :3]))
    apart = np.linalg.norm(place[:, None, :2] - stood[:, :2], axis=2)
    above = place[:, 2] - ground.find_heights(place) - stood[apart.argmin(axis=1), 2]
    floor: Bool = (apart.min(axis=1) < BESIDE_M) & (np.abs(above) < LIFTED_M)
    up = np.array([0.0, 0.0, 1.0])
    return above[floor], np.cross(some[floor], up_there[floor]), np.cross(turned[floor], up)


def fit_robustly(levers: Float64, above: Float64) -> tuple[Float64, float]:
    """Fit a small rotation (3,) to heights (N,); return it, and the median of what is left."""
    used = np.abs(above) < FLOOR_M
    for _ in range(TILT_ROUNDS):
        middle, height = levers[used].mean(axis=0), float(above[used].mean())
        # A turn about the vertical lifts nothing: it has no lever to speak of.
        found = np.linalg.lstsq(levers[used] - middle, above[used] - height, rcond=0.1)[0]
        left = np.abs(above - height - (levers - middle) @ found)
        used = left < 3 * max(float(np.median(left[left < FLOOR_M])), 0.005)
    return found, float(np.median(left[left < FLOOR_M]))
