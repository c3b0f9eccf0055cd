"""Trajectory files: TUM (`stamp x y z qx qy qz qw`) and CSV (`stamp,x,y,yaw` and more)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import NoReturn

from occmap.errors import LogError
from occmap.types import Pose, PoseSample

TRAJECTORY_FRAME = "map"
TUM_COLUMNS = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
QUATERNION = ("qx", "qy", "qz", "qw")
ANGLES = ("roll", "pitch", "yaw")
SHAPES = "expected lines `stamp x y z qx qy qz qw`, or the header stamp,x,y,yaw and such lines"

MAX_STAMP_S = 4 * 10**9
"""The year 2096. Nanoseconds that are mistaken for seconds lie far beyond it."""

BINARY_WITHIN = 64
"""A log or a picture has a zero byte so early; a text may have some where a crash cut it."""

MAX_LINE = 4096
"""Longer lines are no poses, and a file without line ends must not fill the memory."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Which column holds what."""

    columns: Mapping[str, int]
    separator: str | None
    """None: any white space."""


@dataclass(frozen=True, slots=True)
class _Line:
    """One line of numbers, that knows where it stands."""

    path: Path
    number: int
    text: str

    def fail(self, found: str, fix: str = SHAPES) -> NoReturn:
        raise LogError(found, where=f"{self.path}:{self.number}", fix=fix)

    def quote(self) -> str:
        return repr(self.text[:60])


def read_trajectory(path: Path) -> Iterator[PoseSample]:
    """Read the poses of a body in the map, in file order.

    The samples' `child` is "", for such files do not name the body. Empty lines and lines that
    start with # are passed over. A pose with a nan or inf in it is yielded as it is: trackers
    write them where they were lost.

    Raises
    ------
    LogError
        The file cannot be read or holds no poses, or a line (which is named) is no pose.
    """
    layout: _Layout | None = None
    found = False
    for line in _read_lines(path):
        if layout is None and "," in line.text:
            layout = _read_header(line)
            continue
        layout = layout or _Layout({name: i for i, name in enumerate(TUM_COLUMNS)}, None)
        stamp_ns, pose = _parse(line, layout)
        yield PoseSample(stamp_ns, TRAJECTORY_FRAME, "", pose, record_ns=stamp_ns)
        found = True
    if not found:
        raise LogError("the trajectory holds no poses", where=path, fix=SHAPES)


def parse_stamp_ns(text: str) -> int:
    """Turn decimal seconds into nanoseconds, exactly; half nanoseconds go to the even one.

    Raises
    ------
    ValueError
        Not a number, or too large for a time in seconds.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"{text!r} is not a number") from None
    if not (seconds.is_finite() and -MAX_STAMP_S < seconds < MAX_STAMP_S):
        raise ValueError(f"{text!r} is not a time in seconds")
    return round(seconds * 10**9)


def _read_lines(path: Path) -> Iterator[_Line]:
    """Read the lines that are neither empty nor comments."""
    try:
        with path.open("rb") as file:
            if b"\0" in file.read(BINARY_WITHIN):
                raise LogError("no text, so no trajectory", where=path, fix=SHAPES)
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            for number, text in enumerate(iter(partial(file.readline, MAX_LINE), ""), start=1):
                line = _Line(path, number, text.strip())
                if line.text and not line.text.startswith("#"):
                    yield line
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None


def _read_header(line: _Line) -> _Layout:
    """Read the column names of a CSV; columns that are no part of a pose are passed over."""
    names = [name.strip().lower() for name in line.text.split(",")]
    layout = _Layout({name: i for i, name in enumerate(names)}, ",")
    required = {"stamp", "x", "y", *_list_angles(layout)}
    missing = sorted(required - set(names))
    if missing:
        line.fail(f"the header {line.quote()} has no column {', '.join(missing)}")
    return layout


def _list_angles(layout: _Layout) -> Sequence[str]:
    """List the columns of the rotation: a quaternion where any of it is there, else the yaw."""
    return QUATERNION if any(name in layout.columns for name in QUATERNION) else ("yaw",)


def _parse(line: _Line, layout: _Layout) -> tuple[int, Pose]:
    """Read one pose; optional columns that are absent are 0."""
    fields = line.text.split(layout.separator)
    if len(fields) != len(layout.columns):
        line.fail(f"{len(fields)} values where {len(layout.columns)} belong: {line.quote()}")
    texts = {name: fields[i] for name, i in layout.columns.items()}
    try:
        stamp_ns = parse_stamp_ns(texts["stamp"])
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
