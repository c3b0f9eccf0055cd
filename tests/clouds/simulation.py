"""A room of boxes on a floor that may rise, seen by a lidar that drives through it; no noise."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.cells import CellBox, Ground
from occmap.clouds import CloudOptions
from occmap.clouds.counting import count_clouds
from occmap.clouds.engine import CloudEngine, make_band
from occmap.clouds.ground import derive_ground
from occmap.grid import Lattice
from occmap.options import BuildOptions, choose_model
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.posing.tracks import rotate_by, to_quaternions
from occmap.sensor import ReturnOptions
from occmap.types import Bool, Cloud, Float32, Float64, PosedScans, ScanBatch, Update
from tests.samples import SAMPLE_LOGS, import_generator

hall = import_generator("hall")
Solid: TypeAlias = tuple[float, float, float, float, float, float]
"""x, y and z from and to"""
WALLS: list[Solid] = [
    (-0.32, -0.02, -0.3, 6.3, 0, 2.5),
    (10.02, 10.32, -0.3, 6.3, 0, 2.5),
    (-0.3, 10.3, -0.32, -0.02, 0, 2.5),
    (-0.3, 10.3, 6.02, 6.32, 0, 2.5),
]
"""Around a room of 10 x 6 m"""
SENSOR_M = 0.6
LATTICE = Lattice(0.05)
ROOM = CellBox(-10, -10, 130, 210)
"""Its cells, and half a metre around"""


@dataclass
class Room:
    """What stands in it, and where its floor rises."""

    solids: list[Solid] = field(default_factory=list)
    slope: float = 0.0
    """How much the floor rises from x = 4 to x = 8, for each metre"""
    pit: Solid | None = None
    """A hole in the floor"""

    def floor(self, x: Float64) -> Float64:
        """How high the floor is."""
        return np.asarray(np.clip(x - 4, 0, 4) * self.slope)

    def cast(self, origin: Float64, rays: Float64) -> Float64:
        """Where rays (N, 3) from one place end: (N, 3), NaN where they meet nothing."""
        with np.errstate(divide="ignore", invalid="ignore"):
            top = self.slope * (8 - 4)
            solids = [*WALLS, *self.solids, (8, 99, -99, 99, -1, top)]
            met = [hall._meet_block(origin, rays, np.reshape(each, (3, 2)).T) for each in solids]
            ramp = (self.slope * (origin[0] - 4) - origin[2]) / (
                rays[:, 2] - self.slope * rays[:, 0]
            )
            x, floor = origin[0] + ramp * rays[:, 0], -origin[2] / rays[:, 2]
            if self.pit:
                low, high = np.reshape(self.pit, (3, 2)).T
                leaves = np.max([(low - origin) / rays, (high - origin) / rays], axis=0).min(axis=1)
                x_y = (origin + floor[:, None] * rays)[:, :2]
                floor = np.where(((x_y > low[:2]) & (x_y < high[:2])).all(axis=1), leaves, floor)
            met += [floor, np.where((x >= 4) & (x <= 8), ramp, np.inf)]
            nearest = np.min([np.where(each > 0, each, np.inf) for each in met], axis=0)
        nearest[~np.isfinite(nearest)] = np.nan
        return np.asarray(origin + nearest[:, None] * rays)


def turn(roll: float, pitch: float, yaw: float) -> Float64:
    """The rotation by angles about fixed axes (degrees), from the sensor to the map."""
    made = np.eye(3)
    for axis, angle in enumerate((roll, pitch, yaw)):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        one, other = (axis + 1) % 3, (axis + 2) % 3
        step = np.eye(3)
        step[one, one], step[one, other], step[other, one], step[other, other] = c, -s, s, c
        made = step @ made
    return made


def list_rays(rings: int = 40, azimuths: int = 240) -> Float64:
    """Unit vectors of a lidar that looks 40 degrees up and down (N, 3)."""
    up, around = np.meshgrid(
        np.radians(np.linspace(-40, 40, rings)), np.arange(azimuths) * 2 * np.pi / azimuths
    )
    flat = np.cos(up)
    return np.stack([flat * np.cos(around), flat * np.sin(around), np.sin(up)], -1).reshape(-1, 3)


def drive(
    room: Room,
    mounts: Sequence[Float64] = (np.eye(3),),
    clouds: int = 30,
    sensor_m: float = SENSOR_M,
    rays: Float64 | None = None,
) -> list[PosedScans]:
    """Drive through the middle of a room, with a sensor so high above its floor.

    Parameters
    ----------
    mounts
        How the sensor sits at each of as many moments of a cloud; the points are those of a level
        one, so that only their frame differs.
    rays
        Where it looks in the map (N, 3), if these are not those of `list_rays`.
    """
    made, rays = [], list_rays() if rays is None else rays
    for number, x in enumerate(np.linspace(0.8, 9.2, clouds)):
        origin = np.array([x, 3.03, sensor_m + float(room.floor(np.array(x)))])
        ends = room.cast(origin, rays)
        which = np.arange(len(ends)) * len(mounts) // len(ends)
        points = np.einsum("nji,nj->ni", np.array(mounts)[which], ends - origin)
        offset_ns = which * 1_000_000 if len(mounts) > 1 else None
        cloud = Cloud(number, "lidar", points.astype(np.float32), offset_ns)
        made.append(place(cloud, origin, np.array(mounts)))
    return made


def place(cloud: Cloud, origin: Float64, rotation: Float64) -> PosedScans:
    """Pose a cloud, by one or several rotations (M, 3, 3) at one place."""
    moments = len(rotation)
    ranges = np.zeros((1, moments), np.float32)
    stamp_ns = np.array([cloud.stamp_ns * 10**9])
    shape = ("lidar", 0.0, 1.0, 0.0, np.inf, stamp_ns, stamp_ns, ranges, np.zeros(1))
    batch = ScanBatch(*shape, clouds=(cloud,))
    position = np.broadcast_to(origin, (1, moments, 3))
    if moments == 1:
        return PosedScans(batch, position[:, 0], rotation)
    return PosedScans(batch, position, rotation[None])


def read_points(posed: PosedScans) -> Float32:
    """The points of a cloud (N, 3)."""
    (cloud,) = posed.batch.clouds or ()
    return cloud.points


def change_points(posed: PosedScans, points: NDArray[np.floating[Any]]) -> PosedScans:
    """The same cloud with other points (N, 3)."""
    (cloud,) = posed.batch.clouds or ()
    changed = cloud._replace(points=points.astype(np.float32))
    return replace(posed, batch=replace(posed.batch, clouds=(changed,)))


LEVEL = np.eye(3)


def drive_turning(
    mount: Float64 = LEVEL, posed_by: Float64 = LEVEL, up: Float64 = LEVEL, degrees: float = 37.0
) -> list[PosedScans]:
    """Drive while the sensor turns by so much with each cloud.

    Parameters
    ----------
    mount
        How it sits on the body.
    posed_by
        How the poses say that it sits.
    up
        By what the poses are turned as a whole.
    """
    made = []
    for number, posed in enumerate(drive(Room())):
        heading = turn(0, 0, degrees * number)
        turned = change_points(posed, read_points(posed) @ heading @ mount)
        made.append(replace(turned, rotation=(up @ heading @ posed_by)[None]))
    return made


def find_ground(drives: Sequence[PosedScans]) -> Ground:
    """Find the ground below a drive, and once more by clouds that are laid on it."""
    first, _ = derive_ground(count_clouds(drives), CloudOptions())
    ground, _ = derive_ground(count_clouds(drives, first), CloudOptions(), before=first)
    return ground


def observe(
    drives: Sequence[PosedScans], ground: Ground, options: CloudOptions | None = None
) -> CloudEngine:
    """Observe all clouds of a drive."""
    engine = CloudEngine(LATTICE, make_band(options or CloudOptions(), ReturnOptions()), ground)
    for posed in drives:
        engine.add(posed)
    return engine


def count(engine: CloudEngine) -> Float32:
    """(2, H, W) hits and misses of the cells of the room."""
    return engine.finish().gather(ROOM)


def classify(
    drives: Sequence[PosedScans], options: CloudOptions | None = None
) -> tuple[Bool, Bool]:
    """(H, W) each: which cells of the room are occupied, and which free."""
    hits, misses = count(observe(drives, find_ground(drives), options)).astype(np.float64)
    model = choose_model(Update.CLOUD)
    with np.errstate(divide="ignore", invalid="ignore"):
        odds = model.log_odds(hits, misses)
    seen, cut = hits + misses > 0, np.log(0.05 / 0.95)
    return seen & (odds > cut), seen & (odds < cut)


def find_cells(x: tuple[float, float], y: tuple[float, float]) -> tuple[slice, slice]:
    """The cells between some x and y (m), in arrays of the room."""
    rows, cols = (slice(round(low / 0.05) + 10, round(high / 0.05) + 10) for low, high in (y, x))
    return rows, cols


HALL = SAMPLE_LOGS / "hall.mcap"


@cache
def follow_hall() -> Float64:
    """The trajectory of the hall's robot: stamp, x, y, z and quaternion (P, 8)."""
    with TemporaryDirectory() as folder:
        build([HALL], BuildOptions(), [way := Path(folder) / "way.tum"])
        return np.loadtxt(way)


def write_leaning(path: Path, tilt: Float64) -> Path:
    """Write the trajectory of the hall's robot in a map that is turned as a whole."""
    rows = follow_hall().copy()
    rows[:, 1:4] = rows[:, 1:4] @ tilt.T
    rows[:, 4:] = to_quaternions(tilt @ rotate_by(rows[:, 4:]))
    np.savetxt(path, rows, fmt="%.9f")
    return path


def write_tour(folder: Path, drift_m: float, lift_m: float = 0.0) -> BuildOptions:
    """Write clouds of a robot that goes to and fro through a room with a ramp, and their poses.

    Parameters
    ----------
    drift_m
        By how much poses are too high in the end.
    lift_m
        By how much the sensor is lifted with each of the four ways.
    """
    room = Room([(3, 3.6, 1, 1.6, 0, 0.18), (5, 6, 4.5, 5, 0, 1)], slope=0.1)
    ways = [drive(room, clouds=10, sensor_m=SENSOR_M + lift_m * number) for number in range(4)]
    seen = [posed for way, back in zip(ways, (1, -1, 1, -1), strict=True) for posed in way[::back]]
    folder.mkdir()
    places = np.concatenate([posed.position for posed in seen])
    places[:, 2] += np.linspace(0, drift_m, len(seen))
    for number, posed in enumerate(seen):
        np.save(folder / f"{2 * number:03}.npy", read_points(posed))
    lines = [f"{2 * number} {x} {y} {z} 0 0 0 1\n" for number, (x, y, z) in enumerate(places)]
    poses = folder.with_suffix(".tum")
    poses.write_text("".join(lines))
    return BuildOptions(posing=PosingOptions(poses=str(poses)), jobs=1)
