"""Logs of a robot in a rectangular room, written by formula for the tests of `occmap check`."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from occmap.choices import read_options
from occmap.options import FLAGS, BuildOptions
from occmap.types import Float32, Float64
from tests.csv_logs import write_scans
from tests.readers.ros import ROS1, SECOND, Written, scan, transforms, write_bag1

BEAMS = 90
STEP = 2 * math.pi / BEAMS
HALF_WIDTH, HALF_HEIGHT = 5.0, 3.0
SCANS = 40


def measure_room(x: float | Float64, y: float | Float64, heading: Float64) -> Float64:
    """Ranges (B,) from (x, y) to the walls of the room, which is 10 m by 6 m around the origin."""
    cosine, sine = np.cos(heading), np.sin(heading)
    with np.errstate(divide="ignore"):
        to_side = (np.copysign(HALF_WIDTH, cosine) - x) / cosine
        to_end = (np.copysign(HALF_HEIGHT, sine) - y) / sine
    nearest: Float64 = np.minimum(to_side, to_end)
    return nearest


@dataclass(frozen=True)
class Drive:
    """A robot that turns while it crosses the room, with a laser turned on it by `mount`."""

    mount: float = 0.0
    drift: float = 0.0
    """How much farther each scan is than odometry says (m)"""
    increment: float = 0.0
    """From one beam to the next (s)"""
    spoil: Callable[[Float64], Float64] = lambda ranges: ranges
    bearings: Float64 = field(default_factory=lambda: np.linspace(0, 2 * np.pi, BEAMS + 1)[:-1])

    def pose(self, index: float) -> tuple[float, float, float]:
        """x, y, yaw of the robot."""
        return -3 + 0.1 * index, 0.05 * index - 1, 0.11 * index

    def odometry(self, index: int) -> tuple[float, float, float]:
        """x, y, yaw as the wheels say."""
        x, y, yaw = self.pose(index)
        return x - self.drift * index, y, yaw

    def ranges(self, index: int) -> Float32:
        """(B,) what the laser reads."""
        x, y, yaw = np.array([self.pose(index + self.increment * i) for i in range(BEAMS)]).T
        measured = measure_room(x, y, yaw + self.mount + self.bearings)
        return self.spoil(measured).astype(np.float32)


def write_csv(
    path: Path,
    drive: Drive,
    limit: float = 30.0,
    poses: Sequence[tuple[float, float, float]] = (),
    first: int = 0,
) -> Path:
    """Write the drive, or its scans from one on, as CSV; the laser's own pose stands beside each.

    Poses may be given, in another frame.
    """
    at = np.array(poses or list(map(drive.pose, range(SCANS))))
    at[:, 2] += drive.mount
    numbers = range(first, first + len(at))
    seen = [drive.ranges(number) for number in numbers]
    shape = {"angle_min": 0, "angle_increment": STEP, "range_min": 0.2, "range_max": limit}
    return write_scans(path, np.array(numbers) + 100, seen, at, **shape)


def write_bag(
    path: Path,
    drive: Drive,
    mount: Sequence[tuple[float, float]] = (),
    scan_stamp: Callable[[int], int] = lambda stamp: stamp,
    topics: Sequence[str] = ("/scan",),
    correct: Callable[[int], tuple[float, float, float]] | None = None,
    frames: Sequence[str] = ("laser",),
    others: Mapping[str, float] = MappingProxyType({}),
    truth: str = "",
    more: Sequence[Written] = (),
) -> Path:
    """Write the drive as a ROS 1 bag: odometry on /tf, perhaps the mount (roll, yaw), /scan.

    The scans are on the topics in turn, and in the frames, which all sit at the mount; a correction
    says where `odom` is in `map` at each scan. Other frames, with their yaw, are on the robot, too.
    The topic of the truth, if any, says where the robot is in `world`.
    """
    mounts = [(frame, *turn) for turn in mount for frame in frames]
    mounts += [(frame, 0.0, yaw) for frame, yaw in others.items()]
    log = [
        Written("/tf_static", 0, _transform(0, "base_link", frame, (0.0, 0.0, yaw), roll))
        for frame, roll, yaw in mounts
    ]
    for index in range(SCANS):
        stamp = (100 + index) * SECOND
        moved = _transform(stamp, "odom", "base_link", drive.odometry(index))
        log.append(Written("/tf", stamp, moved))
        if truth:
            known = _transform(stamp, "world", "base_link", drive.pose(index))
            log.append(Written(truth, stamp, known if truth == "/tf" else known.transforms[0]))
        if correct is not None:
            log.append(Written("/tf", stamp, _transform(stamp, "map", "odom", correct(index))))
        topic = topics[index % len(topics)]
        frame = frames[index % len(frames)]
        seen = _scan(scan_stamp(stamp), frame, drive.ranges(index), drive.increment)
        log.append(Written(topic, stamp, seen))
    return write_bag1(path, [*log, *more])


def _scan(stamp_ns: int, frame: str, ranges: Float32, increment: float) -> Any:
    return replace(
        scan(ROS1, stamp_ns, frame, ranges),
        angle_min=0.0,
        angle_max=STEP * (BEAMS - 1),
        angle_increment=STEP,
        time_increment=increment,
        range_min=0.2,
    )


def _transform(
    stamp_ns: int, parent: str, child: str, at: tuple[float, float, float], roll: float = 0.0
) -> Any:
    x, y, yaw = at
    message = transforms(ROS1, stamp_ns, [(parent, child, x)])
    placed = message.transforms[0].transform
    placed.translation.y, placed.translation.z = y, 0.0
    (sr, sy), (cr, cy) = (
        [function(angle / 2) for angle in (roll, yaw)] for function in (math.sin, math.cos)
    )
    placed.rotation = type(placed.rotation)(sr * cy, sr * sy, cr * sy, cr * cy)
    return message


def read_line(command: Sequence[str]) -> BuildOptions:
    """The options of a line that check recommends."""
    names, words = {flag: name for name, flag in FLAGS.items()}, command[3:-2]
    given = defaultdict[str, list[str]](list)
    for flag, value in zip(words[::2], words[1::2], strict=True):
        given[names[flag]].append(value)
    typed = {name: each if len(each) > 1 else each[0] for name, each in given.items()}
    return read_options(BuildOptions, typed, "build_map")
