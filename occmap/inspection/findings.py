"""What an inspection finds, as frozen values that know their JSON form."""

import math
from dataclasses import asdict, dataclass, is_dataclass
from enum import Enum
from typing import Any

from occmap.batching import count_wanted
from occmap.posing.coverage import Coverage
from occmap.posing.options import Stamps
from occmap.readers import Stream
from occmap.types import Box


@dataclass(frozen=True)
class Shape:
    """Beams and limits that scans share."""

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    """inf where the log states none"""
    scans: int

    @property
    def field_of_view(self) -> float:
        """Angle from the first beam to the last (rad)."""
        return max(self.beams - 1, 0) * abs(self.angle_increment)


@dataclass(frozen=True)
class Special:
    """Range values of one kind that are no plain measurement."""

    name: str
    count: int
    share: float
    """Of all range values"""
    meaning: str
    no_return: str
    """"clear" or "ignore" where `no_return` decides about it; "" where it is skipped anyway"""


@dataclass(frozen=True)
class Repeated:
    """One finite range that occurs far more often than any near it."""

    value: float
    share: float
    """Of all finite ranges of the topic"""
    is_no_return: bool
    """At or beyond the limit that the scans state, so that it is read as no return"""


@dataclass(frozen=True)
class RangeFindings:
    """What the range values of a topic are."""

    total: int
    measured: int
    smallest: float
    """Of the measured ones (m); nan where there is none"""
    largest: float
    specials: tuple[Special, ...]
    repeated: tuple[Repeated, ...]
    crossed: float | None
    """Share of the beams without return whose way, were it called free, leads through what
    others hit; None where too few are known"""


@dataclass(frozen=True)
class TimeFindings:
    """The stamps of a topic, beside the times at which it was recorded."""

    start_ns: int
    end_ns: int
    duration_s: float
    rate_hz: float
    """Scans a second over the whole duration; 0 where that is 0"""
    largest_gap_s: float
    offset_s: float
    """Median of stamp - record time"""
    drift_s: float
    """How much the offset grew from the first tenth of the scans to the last"""
    jumps_back: int
    largest_jump_back_s: float
    duplicates: int
    """Scans with the stamp of the scan before"""
    time_increment_s: float
    """Median time from one beam to the next; 0 where the log states none"""
    all_equal: bool
    all_zero: bool
    suggested_stamps: Stamps
    """What to give as `stamps`"""


@dataclass(frozen=True)
class MountFindings:
    """How a sensor sits, seen from the map."""

    upside_down: bool
    tilt: float
    """Median angle between the scan plane and the map's (rad)"""
    height: float
    """Median z in the map (m)"""
    better: str
    """The option, with its value, that mounts it so that the scans fit each other clearly better;
    "" where they fit"""


@dataclass(frozen=True)
class PoseFindings:
    """How the scans of a topic get their poses."""

    stated: bool
    """The log holds a pose beside each scan"""
    chain: tuple[str, ...]
    """Frames from the map to the sensor; empty where poses are stated or missing"""
    posed: int
    dropped: dict[str, int]
    problem: str
    """Why there are none, and what to do; "" where there are"""
    assumed: str
    """The `sensor_pose` that was found to fit and is used below; "" where none is needed"""
    is_guess: bool
    """The assumed mount is no more than a place holder: the scans do not tell it"""


@dataclass(frozen=True)
class ScanFindings:
    """All about one topic of scans."""

    topic: str
    type: str
    frames: tuple[str, ...]
    scans: int
    left_out: dict[str, int]
    shapes: tuple[Shape, ...]
    """The most frequent first"""
    shape_count: int
    ranges: RangeFindings
    times: TimeFindings
    poses: PoseFindings
    mount: MountFindings | None
    agreement: float | None
    """Share of the hits of a sample of scans that lie in cells which their map calls occupied"""

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
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    columns: int
    rows: int
    file_bytes: int
    """Of the PGM"""
    memory_bytes: int
    """Of the whole map in memory: log-odds, observed, and the evidence behind them"""


@dataclass(frozen=True)
class LogFindings:
    """All about one log."""

    path: str
    streams: tuple[Stream, ...]
    scans: tuple[ScanFindings, ...]
    coverage: tuple[Coverage, ...]
    notes: tuple[str, ...]
    damage: tuple[str, ...]
    """Those of the notes that tell of damage to a log"""
    problem: str
    """Why the log gives no scans for a map; "" where it does"""


@dataclass(frozen=True)
class Inspection:
    """What a build of these logs would meet."""

    logs: tuple[LogFindings, ...]
    map: MapFindings | None
    problems: tuple[str, ...]
    """Why `occmap build` with the options given would fail; empty where it would not"""
    warnings: tuple[str, ...]
    command: tuple[str, ...]
    """The recommended command line; empty where nothing helps"""

    @property
    def buildable(self) -> bool:
        """Whether `occmap build`, with the options given, makes a map."""
        return not self.problems

    def to_json(self) -> dict[str, Any]:
        """The findings as values that JSON has; what is not finite becomes null."""
        plain: dict[str, Any] = _make_plain(asdict(self))
        return plain | {"buildable": self.buildable}


def _make_plain(value: Any) -> Any:
    """Turn nested values into what JSON has."""
    if isinstance(value, dict):
        return {str(key): _make_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
