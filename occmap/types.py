"""The values that flow from a log to the grid, in the order in which they appear.

    path --reader--> Scan, PoseSample --posing--> PosedScans --sensor--> Rays --grid--> evidence
         --model--> OccupancyMap --writer--> files

Evidence and maps are in `occmap.cells`. All are frozen. Lengths are metres, angles radians, times
integer nanoseconds unless a name says otherwise. Frames follow REP 103 and REP 105: x forward, y
left, z up, yaw counter-clockwise.
"""

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self, TypeAlias, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from occmap.errors import DamageError
from occmap.values import as_number, as_ranges, as_stamp, as_text, shorten

Float32: TypeAlias = NDArray[np.float32]
Float64: TypeAlias = NDArray[np.float64]
Int16: TypeAlias = NDArray[np.int16]
Int32: TypeAlias = NDArray[np.int32]
Int64: TypeAlias = NDArray[np.int64]
UInt8: TypeAlias = NDArray[np.uint8]
UInt16: TypeAlias = NDArray[np.uint16]
Bool: TypeAlias = NDArray[np.bool_]
"""Arrays, by the type of their numbers"""
Paths: TypeAlias = Sequence[Path]
"""Files and folders, as a user names them"""


class Pose(NamedTuple):
    """A rigid transform: position in metres, rotation as a unit quaternion."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float

    @classmethod
    def from_xyzrpy(cls, xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Self:
        """Build from a position and roll, pitch, yaw about fixed axes (REP 103), in radians."""
        (sr, sp, sy) = (math.sin(angle / 2) for angle in rpy)
        (cr, cp, cy) = (math.cos(angle / 2) for angle in rpy)
        qx, qy = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
        qz, qw = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
        return cls(*xyz, qx, qy, qz, qw)

    @classmethod
    def planar(cls, x: float, y: float, yaw: float) -> Self:
        """Build from a pose in the plane (m, m, rad); the heading may be unwrapped."""
        return cls(x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


IDENTITY = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def as_pose(pose: Any) -> Pose:
    """Convert the seven numbers of a pose to floats; raises DamageError."""
    if not isinstance(pose, Pose):
        raise DamageError(f"holds {shorten(pose)} where a Pose belongs")
    is_plain = {*map(type, pose)} == {float}
    return pose if is_plain else Pose._make(map(as_number, pose))


def as_stated_pose(pose: Any) -> Pose | None:
    """Convert a pose as `as_pose` does, where a log states one."""
    return None if pose is None else as_pose(pose)


Stamp: TypeAlias = Annotated[int, as_stamp]
Text: TypeAlias = Annotated[str, as_text]
Number: TypeAlias = Annotated[float, as_number]
"""What the fields of a recorded value are, with what checks and converts them"""
UNSTATED: Any = None
"""The time of a record in a format that holds one time only: the stamp stands for it"""
Made = TypeVar("Made", bound=NamedTuple)


def checked(kind: type[Made]) -> type[Made]:
    """Let a recorded value check its fields as it is made, by what stands beside their types.

    A NamedTuple may not say itself how it is made, so that is put in its place here; `_replace`
    takes fields as they are. The first one is the stamp, and the last one is when it was recorded.
    """
    checks = [hint.__metadata__[0] for hint in get_type_hints(kind, include_extras=True).values()]
    make = kind.__new__

    @wraps(make)
    def make_checked(cls: Any, *values: Any, **named: Any) -> Any:
        made = make(cls, *values, **named)
        fields = made if made[-1] is not UNSTATED else (*made[:-1], made[0])
        return tuple.__new__(cls, map(operator.call, checks, fields))

    kind.__new__ = make_checked  # type: ignore[method-assign]
    return kind


@checked
class Scan(NamedTuple):
    """One turn of a laser as it was recorded: no value is interpreted yet.

    It is a NamedTuple, since a log has tens of thousands.

    Raises
    ------
    DamageError
        A value is not of its type: a number, text, a time that fits 64 bits, or ranges in one row.
    """

    stamp_ns: Stamp
    frame: Text
    angle_min: Number
    """Bearing of the first beam in `frame` (rad)."""
    angle_increment: Number
    """From one beam to the next (rad); negative for a clockwise or upside-down driver."""
    ranges: Annotated[Float32, as_ranges]
    """(B,) m, with whatever the driver wrote where nothing came back; they are copied."""
    range_min: Number
    range_max: Number
    """Limits of the sensor (m); 0 and inf where the log states none."""
    time_increment: Number = 0.0
    """Between beams (s)."""
    pose: Annotated[Pose | None, as_stated_pose] = None
    """The sensor in the map frame; None: the log does not state poses beside its scans."""
    topic: Text = ""
    """The stream in its log that the scan came from."""
    record_ns: Stamp = UNSTATED
    """When the recorder stored it; equal to `stamp_ns` in formats that hold one time only."""

    @property
    def scans(self) -> int:
        """How many there are: one."""
        return 1


COLUMN_MM = 150
"""Side of a column of the ground below clouds"""
BLOCK_BITS = 6
"""A block of the ground has 64 x 64 columns."""
NO_GROUND = -(1 << 30)
"""The height of a column without ground"""


class Cloud(NamedTuple):
    """Points of a 3D lidar or a depth camera as they were recorded."""

    stamp_ns: int
    frame: str
    """In which the points are"""
    points: Float32
    """(N, 3) x, y, z (m); where nothing came back NaN or zero, as the driver wrote it"""
    offset_ns: Int64 | None = None
    """(N,) when each point was measured, after the stamp; None: all at the stamp"""
    pose: Pose | None = None
    """The frame in the map frame; None: the log does not state poses beside its clouds"""
    topic: str = ""
    record_ns: int = 0
    times: str = ""
    """How the times of points were read; empty where they have none"""
    may_be_image: bool = False
    """Whether they may be pixels of a depth camera that are still to be cleaned"""

    @property
    def time_increment(self) -> float:
        """Its points come in no order that a time between them could tell (s)."""
        return 0.0

    @property
    def scans(self) -> int:
        """How many there are: one."""
        return 1


class Moments(NamedTuple):
    """The times of the scans of a log that holds nothing else, in their order."""

    stamp_ns: list[int]
    is_timed: bool
    """False: they only count the scans, whose times are not known"""


@checked
class PoseSample(NamedTuple):
    """Where frame `child` was in frame `parent` at one moment, from any kind of source.

    Raises
    ------
    DamageError
        A value is not of its type: a number, text, or a time that fits 64 bits.
    """

    stamp_ns: Stamp
    parent: Text
    child: Text
    """"" where the source does not name what moved (PoseStamped, Path, a TUM file)."""
    pose: Annotated[Pose, as_pose]
    static: Annotated[bool, bool] = False
    """True: it holds at all times, and the stamp means nothing."""
    topic: Text = ""
    record_ns: Stamp = UNSTATED
    """When the recorder stored it; equal to `stamp_ns` in formats that hold one time only."""


class PoseBatch(NamedTuple):
    """Samples of one frame in another from one source, stacked so that NumPy sees many at once."""

    stamp_ns: Int64
    """(N,)"""
    record_ns: Int64
    """(N,)"""
    pose: Float64
    """(N, 7) x y z qx qy qz qw"""
    parent: str
    child: str
    static: bool
    topic: str

    def split(self) -> list[PoseSample]:
        """The single samples."""
        frames, last = (self.parent, self.child), (self.static, self.topic)
        poses = map(Pose._make, self.pose.tolist())
        rows = zip(self.stamp_ns.tolist(), self.record_ns.tolist(), poses, strict=True)
        return [PoseSample(stamp, *frames, pose, *last, record) for stamp, record, pose in rows]


@dataclass(frozen=True, slots=True)
class ScanBatch:
    """Scans of one sensor with equal geometry, stacked so that NumPy sees many at once.

    Those of a reader follow one another in its log, with stamps and limits as it states them.
    """

    frame: str
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    stamp_ns: Int64
    """(S,)"""
    record_ns: Int64
    """(S,)"""
    ranges: Float32
    """(S, B) m"""
    time_increment: Float64
    """(S,) s between beams; some lasers measure their speed, so it differs from scan to scan."""
    pose: Float64 | None = None
    """(S, 7) x y z qx qy qz qw of the sensor, where the log states it beside the scans."""
    topic: str = ""
    """The stream in its log that the scans came from."""
    clouds: tuple[Cloud, ...] | None = None
    """S clouds of points; then a beam stands for a moment of a cloud, and its range is 0"""

    @classmethod
    def like(cls, scan: Scan, **stacked: Any) -> Self:
        """Make a batch of scans that differ from one only in times, ranges and poses."""
        shared = "frame", "angle_min", "angle_increment", "range_min", "range_max", "topic"
        return cls(**{name: getattr(scan, name) for name in shared}, **stacked)

    @property
    def scans(self) -> int:
        """How many there are."""
        return len(self.stamp_ns)

    def split(self) -> list[Scan]:
        """The single scans."""
        shape, limits = (self.angle_min, self.angle_increment), (self.range_min, self.range_max)
        first = Scan(0, self.frame, *shape, np.empty(0, np.float32), *limits, topic=self.topic)
        poses = [None] * self.scans if self.pose is None else map(Pose._make, self.pose.tolist())
        times = self.stamp_ns.tolist(), self.record_ns.tolist()
        rows = zip(*times, self.ranges.copy(), self.time_increment.tolist(), poses, strict=True)
        names = "stamp_ns", "record_ns", "ranges", "time_increment", "pose"
        return [first._replace(**dict(zip(names, row, strict=True))) for row in rows]

    def take(self, scans: Bool | Int64) -> Self:
        """Select scans by a mask (S,) or by their indices; nothing is copied for a mask of all."""
        if scans.dtype == np.bool_ and scans.all():
            return self
        by_scan = "stamp_ns", "record_ns", "ranges", "time_increment"
        changes: dict[str, Any] = {name: getattr(self, name)[scans] for name in by_scan}
        if self.pose is not None:
            changes["pose"] = self.pose[scans]
        if self.clouds is not None:
            changes["clouds"] = tuple(self.clouds[at] for at in np.arange(self.scans)[scans])
        return replace(self, **changes)


Recorded: TypeAlias = Scan | ScanBatch | Cloud
"""What a log holds of its sensors"""


@dataclass(frozen=True, slots=True)
class PosedScans:
    """A batch and where its sensor was. 3D inside, so that tilted and inverted lidars are right."""

    batch: ScanBatch
    position: Float64
    """(S, 3) m in the map frame, or (S, B, 3) with a pose for each beam (de-skewed)."""
    rotation: Float64
    """(S, 3, 3) from the sensor to the map frame, or (S, B, 3, 3)."""
    origin: Float64 | None = None
    """(S, 3) m, where the sensor was, if its clouds are in another frame than its own"""

    @property
    def stamp_ns(self) -> Int64:
        """(S,) of its scans."""
        return self.batch.stamp_ns

    def take(self, scans: Bool | Int64) -> Self:
        """Select scans by a mask (S,) or by their indices."""
        origin = None if self.origin is None else self.origin[scans]
        place = self.position[scans], self.rotation[scans]
        return type(self)(self.batch.take(scans), *place, origin)

    @property
    def at_first_beam(self) -> tuple[Float64, Float64]:
        """(S, 3) and (S, 3, 3): the sensor's one pose at each scan, or that at its first beam."""
        if self.position.ndim == 2:
            return self.position if self.origin is None else self.origin, self.rotation
        return self.position[:, 0], self.rotation[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Where one laser of one log was at the scans that went into a map, as they were recorded."""

    log: str
    topic: str
    parent: str
    """The frame of the map"""
    frame: str
    """The frame of the laser"""
    stamp_ns: Int64
    """(N,)"""
    pose: Float64
    """(N, 7) x y z qx qy qz qw of the laser in the map; of a de-skewed scan, at its first beam"""
    dropped: tuple[tuple[int, str], ...] = ()
    """Stamp of each scan that has no usable pose (ns), and why"""


class ScanHits(NamedTuple):
    """Where the beams of one scan ended in the map."""

    stamp_ns: int
    origin: tuple[float, float]
    """Where the laser was (m)"""
    x: Float32
    y: Float32
    """(P,) m, of the beams that hit something"""


@dataclass(frozen=True, slots=True, eq=False)
class Journey:
    """How a map was recorded: what is drawn over it, and what other tools want beside it."""

    trajectories: tuple[Trajectory, ...]
    scans: tuple[ScanHits, ...]
    """A sample of the scans, spread evenly over all of them"""


class Kind(IntEnum):
    """What a range value means for the map."""

    SKIP = 0
    """Nothing: not measured, or not to be trusted."""
    FREE = 1
    """The beam saw nothing up to its end."""
    HIT = 2
    """The beam ended on something."""


class Update(StrEnum):
    """How the beams of a scan become observations of cells."""

    BEAM = "beam"
    """Each beam by itself, along a Bresenham line."""
    POLYGON = "polygon"
    """A whole scan at once: measured cells are the border, the interior is filled."""
    SURFACE = "surface"
    """Each beam, and between neighbours on one surface the beams that a denser laser sends."""
    CLOUD = "cloud"
    """A cloud of points at once: what stands on the ground, and what was seen free before it."""


BEAM_UPDATES = (Update.BEAM, Update.POLYGON, Update.SURFACE)
"""Those for scans"""


class Rays(NamedTuple):
    """Beams of S scans in the map frame; what each range value means is decided.

    A beam ends at `origin + distance * direction`. Directions are kept as one table of bearings for
    all scans and a turn for each, so that a batch stays in a core's cache. `origin` and `turn` have
    K = 1 where a scan has one viewpoint, or K = B where every beam has its own.
    """

    origin: Float64
    """(S, K, 2) m"""
    turn: Float64
    """(S, K, 2, 2): takes a bearing in the sensor's plane to the map plane"""
    bearing: Float64
    """(2, B) x and y of unit vectors in the sensor's plane"""
    distance: Float32
    """(S, B) m along the beam; 0 where SKIP"""
    kind: UInt8
    """(S, B) of Kind"""
    stamp_ns: Int64
    """(S,) when each scan was taken, by the clock that the log's stamps are of"""
    full_circle: bool
    """The last beam and the first are neighbours: the scans go all the way round"""

    @classmethod
    def along(  # noqa: PLR0913  the fields, but for the two that a direction stands for
        cls,
        origin: Float64,
        direction: Float64,
        distance: Float32,
        kind: UInt8,
        stamp_ns: Int64,
        *,
        full_circle: bool,
    ) -> Self:
        """Build from a direction for every beam, (S, B, 2)."""
        turn = np.stack([direction, np.zeros_like(direction)], axis=-1)
        bearing = np.repeat([[1.0], [0.0]], direction.shape[1], axis=1)
        reach = distance.astype(np.float32)
        return cls(origin, turn, bearing, reach, kind, stamp_ns, full_circle)

    def take(self, scans: slice | Bool | Int64) -> Self:
        """Select scans by a slice, by a mask (S,) or by their indices."""
        by_scan = "origin", "turn", "distance", "kind", "stamp_ns"
        return self._replace(**{name: getattr(self, name)[scans] for name in by_scan})

    def thin(self, every: int) -> Self:
        """Select every n-th beam of each scan."""
        by_beam = "origin", "turn", "bearing", "distance", "kind"
        return self._replace(**{name: getattr(self, name)[:, ::every] for name in by_beam})

    @property
    def direction(self) -> Float64:
        """(S, B, 2): of length 1, or less where a tilted beam is projected down."""
        x, y = self.bearing
        along = [self.turn[..., axis, 0] * x + self.turn[..., axis, 1] * y for axis in (0, 1)]
        return np.moveaxis(np.stack(along), 0, -1)  # loops over beams are longer than over x and y

    @property
    def end(self) -> Float64:
        """(S, B, 2) m, where each beam ended."""
        return self.origin + self.distance[..., None] * self.direction
