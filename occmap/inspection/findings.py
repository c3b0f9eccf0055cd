"""What an inspection finds, as frozen values that know their JSON form."""

from dataclasses import dataclass, field

from occmap.cells import Box
from occmap.grid.lattice import CellBox
from occmap.posing.frames import Source
from occmap.posing.options import Concern, Stamps
from occmap.readers import Stream
from occmap.report.printed import HIDDEN, Finite, Printed, Share
from occmap.report.words import Noted
from occmap.scans.tally import count_wanted


@dataclass(frozen=True)
class Shape:
    """Beams and limits that scans share."""

    beams: int
    """Beams of a scan"""
    angle_min: Finite
    """Bearing of the first beam (rad); null where it is none"""
    angle_increment: Finite
    """Angle from one beam to the next (rad); null where it is none"""
    range_min: float
    """Nearest range that the sensor measures (m)"""
    range_max: Finite
    """The sensor's limit (m); null where the log states none"""
    scans: int
    """Scans of this shape"""

    @property
    def field_of_view(self) -> float:
        """Angle from the first beam to the last (rad)."""
        return max(self.beams - 1, 0) * abs(self.angle_increment)


@dataclass(frozen=True)
class Special:
    """Range values of one kind that are not plain measurements."""

    name: str
    """The kind of value"""
    count: int
    """Values of the kind"""
    share: Share
    """Share of all range values"""
    meaning: str
    """What drivers mean by it"""
    no_return: str
    """The `no_return` that suits; empty where the value is skipped anyway"""


@dataclass(frozen=True)
class Repeated:
    """One finite range that occurs far more often than any near it."""

    value: float
    """The range (m)"""
    share: Share
    """Share of the finite ranges, in the part of the log where it stood out"""
    is_no_return: bool
    """It is at or beyond the limit that the scans state, so that it is read as no return"""


@dataclass(frozen=True)
class RangeFindings:
    """What the range values of a topic are."""

    total: int
    """Range values"""
    measured: int
    """Range values that are plain measurements"""
    smallest: Finite
    """Smallest measured range (m); null where there is none"""
    largest: Finite
    """Largest measured range (m); null where there is none"""
    specials: tuple[Special, ...]
    """Values that are not plain measurements, by kind"""
    repeated: tuple[Repeated, ...]
    """Finite ranges that repeat suspiciously often"""
    crossed: Share | None
    """Share of the beams without return whose way leads through a surface that others hit, or
    beyond all that was hit; null where too few are known"""


@dataclass(frozen=True)
class TimeFindings:
    """The stamps of a topic, beside the times at which it was recorded."""

    start_ns: int
    """Earliest stamp (ns)"""
    end_ns: int
    """Latest stamp (ns)"""
    duration_s: float
    """From the earliest to the latest stamp (s)"""
    rate_hz: float
    """Scans a second over the whole duration (1/s); 0 where that is 0"""
    largest_gap_s: float
    """Longest time from one scan to the next (s)"""
    offset_s: float
    """Median of stamp minus record time (s)"""
    drift_s: float
    """Growth of that from the first tenth of the scans to the last (s)"""
    jumps_back: int
    """Stamps earlier than the one before"""
    largest_jump_back_s: float
    """The largest of these jumps (s)"""
    duplicates: int
    """Scans with the stamp of the scan before"""
    time_increment_s: float
    """Median time from one beam to the next (s); 0 where the log states none"""
    all_equal: bool
    """All stamps are equal"""
    all_zero: bool
    """All stamps are 0"""
    simulated: bool
    """The stamps are of a simulation's clock, which keeps its own pace, so the drift is 0"""
    suggested_stamps: Stamps
    """What to give as `stamps`"""


@dataclass(frozen=True)
class MountFindings:
    """How a sensor sits, seen from the map."""

    upside_down: bool
    """The sensor hangs upside down"""
    tilt: float
    """Median angle between the scan plane and the map's (rad)"""
    height: float
    """Median height in the map (m)"""
    better: str
    """The option, with its value, that mounts it so that the scans fit each other better; empty
    where they fit"""


@dataclass(frozen=True)
class PoseFindings:
    """How the scans of a topic get their poses."""

    stated: bool
    """The log holds a pose beside each scan"""
    chain: tuple[str, ...]
    """Frames from the map to the sensor; empty where poses are stated or missing"""
    posed: int
    """Scans with a pose"""
    dropped: dict[str, int]
    """Scans without a pose, by reason"""
    problem: str
    """Why there are none, and what to do; empty where there are"""
    assumed: str
    """The `sensor_pose` that was found to fit, and is assumed; empty where none is needed"""
    is_guess: bool
    """The assumed mount is a place holder: the scans do not tell it"""


@dataclass(frozen=True)
class ScanFindings:
    """All about one topic of scans."""

    topic: str
    """Name of the topic"""
    type: str
    """Message type"""
    frames: tuple[str, ...]
    """Frames that the scans are in"""
    is_of_clouds: bool
    """They are clouds of points, which have no beams, ranges or shape"""
    scans: int
    """Scans of the topic"""
    left_out: dict[str, int]
    """Scans that are left out whatever their poses, by reason"""
    shapes: tuple[Shape, ...]
    """The most frequent shapes, with the most frequent first"""
    shape_count: int
    """How many shapes there are, listed or not"""
    ranges: RangeFindings
    """What the range values are"""
    times: TimeFindings
    """How the stamps run"""
    poses: PoseFindings
    """Where the poses come from"""
    mount: MountFindings | None
    """How the sensor sits; null where no scan has a pose"""
    agreement: Share | None
    """Share of the hits of a sample of scans that lie in cells which their map calls occupied;
    null where they make no map"""

    @property
    def wanted(self) -> int:
        """Scans that the user asked for."""
        return count_wanted(self.scans, self.left_out)

    @property
    def kept(self) -> int:
        """Scans that are not left out before anybody asks for their poses."""
        return self.scans - sum(self.left_out.values())


@dataclass(frozen=True)
class MapFindings:
    """The map that the logs would make."""

    resolution: float
    """Side of a cell (m)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    columns: int
    """Cells from left to right (along x)"""
    rows: int
    """Cells from bottom to top (along y)"""
    file_bytes: int
    """Size of the map as PGM (bytes)"""
    memory_bytes: int
    """Memory that the map and its evidence take at most (bytes)"""


@dataclass(frozen=True)
class Coverage:
    """One edge of the transform tree, or one topic of poses."""

    parent: str
    """Frame that the poses are in"""
    child: str
    """Frame whose poses these are; empty where the log does not say"""
    source: Source
    """Kind of source"""
    topic: str
    """Topic, or name of the trajectory file"""
    samples: int
    """Poses"""
    static: bool
    """It holds for all times"""
    moves: bool
    """The poses differ"""
    start_ns: int
    """Earliest stamp (ns)"""
    end_ns: int
    """Latest stamp (ns)"""
    largest_gap_s: float
    """Longest time from one pose to the next (s)"""
    largest_step_m: float
    """Longest way from one pose to the next (m)"""
    largest_step_rad: float
    """Largest turn from one pose to the next (rad)"""


@dataclass(frozen=True)
class LogFindings(Noted):
    """All about one log."""

    path: str
    """The log, as it was given"""
    streams: tuple[Stream, ...] = ()
    """Topics of the log, also those that no map needs"""
    scans: tuple[ScanFindings, ...] = ()
    """Topics with scans"""
    coverage: tuple[Coverage, ...] = ()
    """Sources of poses"""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = field(init=False)
    """Those of the notes that tell of damage to a log"""
    concerns: tuple[Concern, ...] = field(default=(), metadata=HIDDEN)
    """What will spoil a map, or surprise its maker"""
    problem: str = ""
    """Why the log gives no scans for a map; empty where it does"""
    box: CellBox | None = field(default=None, metadata=HIDDEN)
    """The cells that its scans observe; None: they observe none"""
    longest: float = field(default=0.0, metadata=HIDDEN)
    """The longest beam (m)"""


@dataclass(frozen=True)
class Inspection(Printed):
    """What a build of these logs would meet."""

    logs: tuple[LogFindings, ...]
    """The logs, one by one"""
    map: MapFindings | None
    """The map that they would make; null where no scan has a pose"""
    problems: tuple[str, ...]
    """Why occmap build with the options given would fail; any of them makes the exit code 1"""
    warnings: tuple[str, ...]
    """What will spoil the map, or surprise its maker"""
    command: tuple[str, ...]
    """The recommended command line, word by word; empty where nothing helps"""
    buildable: bool
    """Whether occmap build with the options given makes a map"""
