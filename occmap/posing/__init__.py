"""From recorded poses to the pose of each scan.

Here is what a user may choose about poses, why a scan is left out, and what spoils a map.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

from occmap.choices import ABOVE_ZERO, FOUND, MOUNT, PLACE, TILT, TRANSFORM, check_bounds, option
from occmap.errors import require
from occmap.types import Pose, PoseSample, Recorded

Time = TypeVar("Time")
Drift: TypeAlias = tuple[tuple[int, ...], tuple[int, ...]]
"""Moments (ns), and what is added to the heights of poses then, and in between (mm)"""
NO_DRIFT: Mapping[str, Drift] = {}
"""Heights of poses stay as they are, and no drift of theirs is looked for"""
MAX_OFFSET_S = 4e9
"""The largest offset: from a clock that begins at 0 to any date; two of them fit an int64 of ns."""

MAX_PLACE_M = 1e8
"""The farthest place (m), twice around the Earth: a bound refuses nan and inf, too."""


def measure_drift(drift: Drift) -> float:
    """Measure how far heights drift in all (m)."""
    return (max(drift[1]) - min(drift[1])) / 1000


class Deskew(StrEnum):
    """Whether every beam of a scan gets a pose of its own."""

    AUTO = "auto"
    """Where the log states the time between beams and the poses are dense enough."""
    ON = "on"
    """Wherever the log states the time between beams."""
    OFF = "off"
    """Never: one pose a scan, at its stamp."""


class Stamps(StrEnum):
    """Which of the two times of a message counts."""

    HEADER = "header"
    """The time that its driver wrote into it."""
    RECORD = "record"
    """The time at which the recorder stored it."""

    def choose(self, stamp_ns: Time, record_ns: Time) -> Time:
        """Choose between the two times of one message, or of many."""
        return record_ns if self is Stamps.RECORD else stamp_ns


POSED = 0
"""Stands in arrays for a scan that has a pose, where others have the code of a reason"""


class DropReason(StrEnum):
    """Why a scan has no pose; of several reasons the last one of these counts."""

    BEFORE = "before the first pose"
    AFTER = "after the last pose"
    GAP = "in a pose gap longer than `max_pose_gap_s`"
    TURN = "in a turn between poses more than 0.3 s apart"
    UNUSABLE = "pose not finite or beyond 1e12 m or without a rotation"
    LEAP = "further from their neighbours than `max_speed` allows"
    NO_TRANSFORM = "no transform to the scan's frame"

    @property
    def code(self) -> int:
        """What stands for it in arrays."""
        return list(DropReason).index(self) + 1


class Concern(NamedTuple):
    """Something that its user should know before the map is used."""

    text: str
    remedy: Mapping[str, str] = {}
    """Options that mend it, with their values; none: the map is of use all the same"""
    command: str = "build"
    """What to type with these: `tune`, where it may find the reason; "" where no known option makes
    the map of use"""


Doubt: TypeAlias = tuple[str, Concern]
"""A topic, and what spoils its map"""


@dataclass(frozen=True, slots=True)
class PosingOptions:
    """The choices; each default lets the log decide.

    Raises
    ------
    UsageError
        A value is out of its range.
    """

    poses: str | None = option(
        None,
        "Take the poses from a file (TUM, EuRoC, KITTI or CSV: stamp,x,y,yaw), from this topic, or "
        "from another recording, as in slam.bag or slam.bag:/path.",
        unit="path or topic",
        metavar="FILE|TOPIC",
    )
    sensor_pose: Pose | None = option(
        None,
        "Where the laser sits on the robot (metres, radians).",
        metavar="X,Y,YAW[,ROLL,PITCH]",
        form=MOUNT,
    )
    # Each goes before what the log says of its child.
    static_transforms: tuple[PoseSample, ...] = option(
        (),
        "A fixed transform that the log lacks (m, rad).",
        metavar="PARENT,CHILD,X,Y,Z,ROLL,PITCH,YAW",
        flag="static-tf",
        form=TRANSFORM,
    )
    map_frame: str | None = option(
        None,
        "Map in this frame; by default map, else odom, else the root of the laser's tree.",
        unit="frame",
    )
    transform: Pose | None = option(
        None,
        "Pose of the logs' map frame in the new map (m, rad), to join sessions that have a frame "
        "each.",
        metavar="X,Y,YAW[,Z]",
        form=PLACE,
    )
    base_frame: str | None = option(
        None,
        "The moving body that `sensor_pose` is on, and whose poses a file of `poses` holds.",
        unit="frame",
    )
    # None: across any gap. Logs that are whole have gaps of one second, and a robot that is not
    # watched for longer than two can have been anywhere.
    max_pose_gap_s: float | None = option(
        2.0,
        "Leave out scans in a longer gap between poses.",
        unit="s",
        bounds=(ABOVE_ZERO, math.inf),
        none=("inf", "to interpolate across any gap"),
    )
    # The fastest step of nine logs of robots, with rounded stamps, is 8; cars reach 50.
    max_speed: float = option(
        50.0,
        "Leave out scans whose poses leap away faster than this, and back.",
        unit="m/s",
        bounds=(ABOVE_ZERO, math.inf),
    )
    time_offset_s: float = option(
        0.0, "Add this to the stamps of scans.", unit="s", bounds=(-MAX_OFFSET_S, MAX_OFFSET_S)
    )
    stamps: Stamps = option(
        Stamps.HEADER, "Use the times that the driver wrote, or the recorder's."
    )
    # Off unless asked: drivers disagree on which beam the stamp belongs to and on the order of the
    # beams. Of two real logs that state a time between beams both were blurred by believing it.
    deskew: Deskew = option(Deskew.OFF, "Give every beam of a scan a pose of its own.")
    align: float | None = option(
        0.0,
        "Turn the map by this many degrees counter-clockwise; without a number, by the smallest "
        "angle that brings its walls along the axes.",
        unit="degrees",
        section="Map",
        bounds=(-360, 360),
        none=("auto", "so that walls run along the axes"),
    )

    # None: SLAM without gravity has its map in the frame of the first cloud, however that was held.
    level: tuple[float, float] | None = option(
        None,
        "Turn the logs' map by these angles (degrees), so that its floor is level; by default "
        "clouds show whether it is not. 0,0: never.",
        metavar="ROLL,PITCH",
        form=TILT,
    )
    # None: found in each log. Else by log: stamps (ns), and what is added to heights then (mm).
    height_drift: Mapping[str, Drift] | None = option(
        None,
        "Clouds: where poses drift in z, so that the floor lies elsewhere where a drive comes by "
        "again, correct their heights (on), or leave them (off).",
        metavar="on|off",
        none=("on", "to correct them"),
        form=FOUND,
    )

    def __post_init__(self) -> None:
        for name in ("map_frame", "base_frame", "poses"):
            found = f"`{name}` is empty"
            require(getattr(self, name) != "", found, "give a name, or leave it out")
        check_bounds(self)
        is_turn = all(abs(angle) <= 180 for angle in self.level or ())
        require(is_turn, f"no floor is tilted by {self.level}", "give degrees within -180 and 180")
        fixed = (each.pose for each in self.static_transforms)
        for pose in filter(None, (*fixed, self.transform, self.sensor_pose)):
            is_place = all(abs(value) <= MAX_PLACE_M for value in pose) and any(pose[3:])
            require(is_place, f"nothing can be at {pose[:3]}", "give metres and radians")

    def takes_stated(self, *scans: Recorded) -> bool:
        """Whether the poses beside scans count: each has one, and `poses` names no others."""
        return self.poses is None and all(each.pose is not None for each in scans)

    @property
    def recording(self) -> tuple[Path, str] | None:
        """The other recording that `poses` names, and the topic in it; "" where it names none."""
        poses = self.poses or ""
        path, _, topic = poses.rpartition(":")
        named = ((Path(path), name) for path, name in ((poses, ""), (path, topic)) if path)
        return next((each for each in named if _is_recording(each[0])), None)

    @property
    def files(self) -> list[Path]:
        """The trajectory or recording that `poses` names; none where it is a topic."""
        if self.recording:
            return [self.recording[0]]
        path = Path(self.poses or "")
        return [path] if path.is_file() else []


def _is_recording(path: Path) -> bool:
    """Whether a path is a file named like a recording, or a folder with one of ROS 2."""
    if path.is_file():
        return path.suffix.lower() in {".bag", ".mcap", ".db3"}
    return any(any(path.glob(name)) for name in ("metadata.yaml", "*.db3*", "*.mcap*"))
