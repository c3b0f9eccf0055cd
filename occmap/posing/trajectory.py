"""Trajectory files: TUM, CSV with a header, EuRoC and KITTI.

TUM: `stamp x y z qx qy qz qw` (s). CSV: a header `stamp,x,y,yaw` or more columns (s). EuRoC: lines
`stamp,x,y,z,qw,qx,qy,qz`, which may go on (ns). KITTI: the first three rows of a matrix of 4 x 4 in
each line, and the time of each (s) in times.txt beside it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np

from occmap.errors import LogError, refuse_unreadable
from occmap.posing.rotations import to_quaternions
from occmap.types import Pose, PoseSample
from occmap.values import parse_nanoseconds, parse_seconds

TRAJECTORY_FRAME = "map"
TUM_COLUMNS = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
QUATERNION = ("qx", "qy", "qz", "qw")
ANGLES = ("roll", "pitch", "yaw")
SHAPES = (
    "expected lines `stamp x y z qx qy qz qw`, the header stamp,x,y,yaw and such lines, or those "
    "of EuRoC or KITTI"
)
EUROC_COLUMNS = ("stamp", "x", "y", "z", "qw", "qx", "qy", "qz")
MATRIX = 12
"""Numbers in a line of KITTI"""
TIMES = "times.txt"

FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Turns the axes of a camera (right, down, ahead) to those of a robot (ahead, left, up)"""
TO_CAMERA = np.block([[FROM_CAMERA.T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])

BINARY_WITHIN = 64
"""A log or a picture has a zero byte within these first bytes; a text may have some later, where
a crash cut it."""

MAX_LINE = 4096
"""The longest line: longer ones are not poses, and a file without line ends may not fill memory."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which column holds what."""

    columns: Mapping[str, int]
    separator: str | None
    """None: any white space."""
    read_stamp: Callable[[str], int]
    """Reads a time as nanoseconds; raises ValueError"""
    has_more: bool = False
    """Further columns may follow"""


@dataclass(frozen=True, slots=True)
class _Line:
    """A line of a file, and where it stands."""

    path: Path
    number: int
    text: str

    def fail(self, found: str, fix: str = SHAPES) -> NoReturn:
        raise LogError(found, where=f"{self.path}:{self.number}", fix=fix)

    def quote(self) -> str:
        return repr(self.text[:60])


def read_trajectory(path: Path, notes: list[str] | None = None) -> Iterator[PoseSample]:
    """Read the poses of a body in the map, in file order.

    The samples' `child` is "", for such files do not name the body. Empty lines and lines that
    start with # are passed over. A pose with a nan or inf in it is yielded as it is: trackers
    write them where they were lost.

    Parameters
    ----------
    notes
        Grows by how the axes of KITTI poses were understood, since the file does not say it.

    Raises
    ------
    LogError
        The file cannot be read or holds no poses, or a line is not a pose.
    """
    lines = _read_lines(path)
    first = next(lines, None)
    if first is None:
        raise LogError("the trajectory holds no poses", where=path, fix=SHAPES)
    if len(first.text.split()) == MATRIX:
        poses = _read_matrices(path, chain([first], lines), [] if notes is None else notes)
    else:
        layout, is_header = _find_layout(first)
        rest = lines if is_header else chain([first], lines)
        poses = (_parse(line, layout) for line in rest)
    found = False
    for stamp_ns, pose in poses:
        yield PoseSample(stamp_ns, TRAJECTORY_FRAME, "", pose, record_ns=stamp_ns)
        found = True
    if not found:
        raise LogError("the trajectory holds no poses", where=path, fix=SHAPES)


def _find_layout(first: _Line) -> tuple[_Layout, bool]:
    """Tell the layout of a file by its first line, and whether that is a header."""
    if "," not in first.text:
        return _number(TUM_COLUMNS, None, parse_seconds), False
    if first.text.partition(",")[0].strip().lstrip("-").isdecimal():
        return replace(_number(EUROC_COLUMNS, ",", parse_nanoseconds), has_more=True), False
    return _read_header(first), True


def _number(
    names: Sequence[str], separator: str | None, read_stamp: Callable[[str], int]
) -> _Layout:
    return _Layout({name: i for i, name in enumerate(names)}, separator, read_stamp)


def _read_matrices(
    path: Path, lines: Iterable[_Line], notes: list[str]
) -> Iterator[tuple[int, Pose]]:
    """Read KITTI's poses, each with its time.

    Those of a camera, whose z is ahead and whose y is down, are turned to the axes of a robot. They
    are told by where they lead: a robot that stays on the ground moves along z only in such axes.
    """
    texts = list(lines)
    rows = np.array([_read_row(line) for line in texts]).reshape(-1, 3, 4)
    times = list(_read_times(path.parent / TIMES, path))
    if len(times) != len(rows):
        found = f"it holds {len(rows):,} poses, and {TIMES} beside it {len(times):,} times"
        raise LogError(found, where=path, fix="there must be one for each pose")
    finite = rows[np.isfinite(rows).all(axis=(1, 2))]
    y, z = (np.ptp(finite[:, axis, 3]) if len(finite) else 0.0 for axis in (1, 2))
    notes.append(
        f"{path}: its poses go {y:.3g} m along y and {z:.3g} m along z, so they are taken as those "
        + ("of a camera (z is ahead, y down)" if z > y else "of a robot (x is ahead, z up)")
    )
    if z > y:
        rows = np.einsum("ij,njk,kl->nil", FROM_CAMERA, rows, TO_CAMERA)
    rows[~np.isfinite(rows).all(axis=(1, 2))] = np.nan
    poses = np.column_stack([rows[:, :, 3], to_quaternions(rows[:, :, :3])]).tolist()
    yield from ((stamp_ns, Pose(*pose)) for stamp_ns, pose in zip(times, poses, strict=True))


def _read_row(line: _Line) -> list[float]:
    words = line.text.split()
    if len(words) != MATRIX:
        line.fail(f"{len(words)} values where {MATRIX} belong: {line.quote()}")
    try:
        return list(map(_to_float, words))
    except ValueError as error:
        line.fail(f"{error}: {line.quote()}")


def _read_times(path: Path, poses: Path) -> Iterator[int]:
    """Read the times (ns) of KITTI's poses."""
    if not path.is_file():
        raise LogError("poses without times", where=poses, fix=f"put KITTI's {TIMES} beside it")
    for line in _read_lines(path):
        try:
            yield parse_seconds(line.text)
        except ValueError as error:
            line.fail(str(error), "a time in seconds stands in each line")


def _read_lines(path: Path) -> Iterator[_Line]:
    """Read the lines that are neither empty nor comments."""
    with refuse_unreadable(path):
        with path.open("rb") as file:
            if b"\0" in file.read(BINARY_WITHIN):
                raise LogError("not text, so not a trajectory", where=path, fix=SHAPES)
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            for number, text in enumerate(iter(partial(file.readline, MAX_LINE), ""), start=1):
                line = _Line(path, number, text.strip())
                if line.text and not line.text.startswith("#"):
                    yield line


def _read_header(line: _Line) -> _Layout:
    """Read the column names of a CSV; columns that do not belong to a pose are passed over."""
    names = [name.strip().lower() for name in line.text.split(",")]
    layout = _number(names, ",", parse_seconds)
    has_quaternion = any(name in layout.columns for name in QUATERNION)
    missing = {"stamp", "x", "y", *(QUATERNION if has_quaternion else ("yaw",))}.difference(names)
    if missing:
        line.fail(f"the header {line.quote()} has no column {', '.join(sorted(missing))}")
    return layout


def _parse(line: _Line, layout: _Layout) -> tuple[int, Pose]:
    """Read one pose; optional columns that are absent are 0."""
    fields = line.text.split(layout.separator)
    more = len(fields) - len(layout.columns)
    if more < 0 or (more and not layout.has_more):
        line.fail(f"{len(fields)} values where {len(layout.columns)} belong: {line.quote()}")
    texts = {name: fields[i] for name, i in layout.columns.items()}
    try:
        stamp_ns = layout.read_stamp(texts["stamp"])
        x, y, z = (_to_float(texts.get(name, "0")) for name in "xyz")
        if "qw" in texts:
            qx, qy, qz, qw = (_to_float(texts[name]) for name in QUATERNION)
            return stamp_ns, Pose(x, y, z, qx, qy, qz, qw)
        roll, pitch, yaw = (_to_float(texts.get(name, "0")) for name in ANGLES)
    except ValueError as error:
        line.fail(f"{error}: {line.quote()}")
    return stamp_ns, _turn((x, y, z), (roll, pitch, yaw))


def _to_float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number") from None


def _turn(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Pose:
    """Make a pose from angles; an infinite angle, which has no sine, makes it not finite."""
    try:
        return Pose.from_xyzrpy(xyz, rpy)
    except ValueError:
        return Pose(*xyz, *(float("nan"),) * 4)
