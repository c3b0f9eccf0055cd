"""Trajectory files: TUM, CSV with a header, EuRoC, KITTI and g2o.

TUM: `stamp x y z qx qy qz qw` (s). CSV: a header `stamp,x,y,yaw` or more columns (s), or what
`rostopic echo -p` writes of poses (ns). EuRoC: lines `stamp,x,y,z,qw,qx,qy,qz`, which may go on
(ns). KITTI: the first three rows of a matrix of 4 x 4 in each line, or all four, and the time of
each (s) in times.txt beside it; MulRan has it (ns) before the three rows. g2o: a pose graph, where
vertices of VILENS have times (s and ns) behind their poses.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from occmap import values
from occmap.choices import format_mount, mark_options
from occmap.errors import LogError, refuse_unreadable
from occmap.posing import Concern
from occmap.posing.tracks import rotate_by, to_quaternions
from occmap.report import count
from occmap.types import Float64, Moments, Pose, PoseBatch

Parsed = TypeVar("Parsed")
NumberedLine: TypeAlias = tuple[int, str]

TRAJECTORY_FRAME = "map"
"""The frame that the poses of a file are taken to be in: no format names one"""
QUATERNION = ("qx", "qy", "qz", "qw")
ANGLES = ("roll", "pitch", "yaw")
CELLS = tuple(f"cell {at}" for at in range(12))
MATRICES = {12: CELLS, 13: ("stamp", *CELLS), 16: (*CELLS, "", "", "", "")}
"""By the numbers in a line of KITTI, also with a time in front, or with the fourth row"""
SHAPES = (
    "expected lines `stamp x y z qx qy qz qw`, the header stamp,x,y,yaw and such lines, or those "
    "of EuRoC or KITTI"
)
TIMES, CALIBRATION = "times.txt", "calib.txt"
LIDAR = re.compile(r"Tr:((?:\s+[-+.\de]+){12})", re.IGNORECASE)
"""The line of KITTI's calibration that leads from the lidar to the camera"""

OF_CAMERA = "those of a camera (z is ahead, y down)"
FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Turns the axes of a camera (right, down, ahead) to those of a robot (ahead, left, up)"""

LEAST_WAY_M = 1.0
"""A lidar that tilts on an arm goes less far"""

MAX_LINE = 4096
"""The longest line: longer ones are not poses, and a file without line ends may not fill memory."""


Row: TypeAlias = tuple[int | None, list[float]]
"""A time (ns), the place, and the quaternion, or roll, pitch and yaw; or what a matrix holds"""


class Table(NamedTuple):
    """How the lines of a file hold poses."""

    columns: Sequence[str]
    """Their names"""
    separator: str | None
    """Any white space, if it is None"""
    unit: int = values.SECONDS
    """Of times, as `values.UNITS` has it"""
    goes_on: bool = False
    """Others may follow"""
    shape: str = SHAPES
    """What to say of a line that is another"""

    @property
    def is_of_matrices(self) -> bool:
        """Whether a line is the first three rows of a matrix, or all four."""
        return CELLS[0] in self.columns

    def split(self, text: str) -> list[str]:
        """Split a line into its values. Between ; and tabs, a comma in a number is a dot."""
        if self.is_of_matrices:
            return text.replace(",", " ").split()
        if self.separator in {";", "\t"}:
            text = text.replace(",", ".")
        return text.split(self.separator)

    def parse(self, text: str) -> Row:
        """Parse a line. Optional columns that are absent are 0.

        Raises
        ------
        ValueError
            There are fewer or more values, or one is no number.
        """
        fields, expected = self.split(text), len(self.columns)
        if len(fields) < expected or (len(fields) > expected and not self.goes_on):
            raise ValueError(f"{len(fields)} values where {expected} belong")
        texts = dict(zip(self.columns, fields, strict=False))
        if "stamp_nsec" in texts:
            texts["stamp"] = f"{texts['stamp']}.{texts['stamp_nsec'].strip():0>9}"
        rotation = QUATERNION if "qw" in texts else ANGLES
        names = CELLS if self.is_of_matrices else ("x", "y", "z", *rotation)
        numbers = [values.parse_number(texts.get(name, "0")) for name in names]
        return values.parse_time(texts["stamp"], self.unit) if "stamp" in texts else None, numbers


GRAPH = re.compile(r"VERTEX|EDGE|PARAMS_|FIX|PLATFORM_ID")
NODE = re.compile(r"VERTEX_SE3:QUAT(?:_TIME)?\s+(\d+)\s+(.+)")
"""How lines of a pose graph begin, and one that holds a pose, behind its number"""
NODES = ("x", "y", "z", *QUATERNION, "stamp", "stamp_nsec")
NODE_SHAPE = "expected `VERTEX_SE3:QUAT n x y z qx qy qz qw`, and behind that `s ns` of `_TIME`"
TUM = Table(("stamp", "x", "y", "z", *QUATERNION), None)
EUROC = Table(("stamp", "x", "y", "z", "qw", "qx", "qy", "qz"), ",", values.NANOSECONDS, True)
COUNTERS = re.compile(r"\d+\s+\d+\s+\d+")
"""What stands above a matrix, which is four lines, in a .log of Open3D"""
AGAIN = re.compile(rf",(?=\d+,\d{{1,9}},{values.FRAME_NAME},)")
"""Stands between the transforms of a message, which `ros2 topic echo` writes as one line of CSV"""
NUMBER = re.compile(r"[-+.\d]|nan|inf")
"""How a line begins that is no header"""
PLACE = re.compile(r"^(?:.*\b(?:position|translation)[./]|p_(?:\w+_)?|t)([xyz])(?:_m)?$")
TURN = re.compile(r"^(?:.*\b(?:orientation|rotation)[./]|q_(?:\w+_)?)([wxyz])$")
"""What ROS, EuRoC, TUM and Argoverse call the columns of a place and of a quaternion"""


def read_trajectory(
    path: Path, notes: list[str], moments: Moments | None = None
) -> tuple[PoseBatch, bool]:
    """Read the poses of a body in the map, in file order, and tell if they were a camera's.

    Those are turned to the axes of a robot. Their `child` is "", for such files do not name the
    body. Empty lines and lines that start with # are passed over, unless the one above the first
    pose names columns. A pose with a nan or inf in it stays as it is: trackers write them where
    they were lost.

    Parameters
    ----------
    notes
        Grows by notes on the axes of the poses, which the file does not state, and on what is odd.
    moments
        The times of the scans of a log, which poses without times of their own are for one by one,
        and all poses where those of the scans are not known.

    Raises
    ------
    LogError
        The file cannot be read or holds no poses, or a line is not a pose.
    """
    times, poses, is_of_camera = _read_poses(path, notes)
    if is_of_camera:
        # The place, and the vector of the quaternion.
        poses[:, :6] = (poses[:, :6].reshape(-1, 2, 3) @ FROM_CAMERA.T).reshape(-1, 6)
    if moments is None:
        times = _read_times(path) if times is None else times
    elif times is None or not moments.is_timed:  # where only the order of the scans is known
        times = moments.stamp_ns
    if len(times) != len(poses):
        counted, each = (TIMES, "time") if moments is None else ("the log", "cloud")
        found = f"it holds {len(poses):,} poses, and {counted} {count(len(times), each)}"
        raise LogError(found, where=path, fix="there must be one for each, in the same order")
    stamp_ns = np.array(times, np.int64)
    batch = PoseBatch(stamp_ns, stamp_ns, poses, TRAJECTORY_FRAME, "", static=False, topic="")
    return batch, is_of_camera


def _read_poses(path: Path, notes: list[str]) -> tuple[Sequence[int] | None, Float64, bool]:
    """Read the times (ns), where there are any, and poses (N, 7), and tell if they are a camera's.

    A first line tells the format.
    """
    lines, headings = _read_rows(path)
    if len(lines) > 4 and COUNTERS.fullmatch(lines[0][1]):
        fives = [lines[at : at + 5] for at in range(0, len(lines), 5)]
        lines = [(each[0][0], " ".join(text for _, text in each[1:])) for each in fives]
    if nodes := _list_nodes(lines):
        form = Table(NODES[: len(nodes[0][1].split())], None, shape=NODE_SHAPE)
        return *_read_table(path, nodes, form, notes), False
    begin = lines[0][1] if lines else ""
    has_header = not NUMBER.match(begin)
    form = next(_parse_lines(path, lines[:1], partial(_find_format, headings)), TUM)
    times, poses = _read_table(path, lines[has_header:], form, notes)
    if form.is_of_matrices:
        return times, *_make_poses(path, poses.reshape(-1, 3, 4), notes)
    usable = np.isfinite(poses).all(axis=1) & poses[:, 3:].any(axis=1)
    if usable.any() and (form is TUM or form is EUROC):
        _refuse_no_rotation(path, poses[usable, 3:])
        if order := _find_order(form, poses[usable, 3:]):
            poses[:, 3:] = poses[:, order]
            place = "first" if form is TUM else "last"
            odd = "the poses turn as no robot does with quaternions in the usual order"
            notes.append(f"{path}: {odd}, so their w is taken to be {place}")
    is_of_camera = bool(usable.any()) and _are_of_camera(poses[usable])
    if is_of_camera:
        notes.append(f"{path}: its poses turn about y, so they are taken as {OF_CAMERA}")
    return times, poses, is_of_camera


def _list_nodes(lines: Sequence[NumberedLine]) -> list[NumberedLine]:
    """List the poses of a pose graph of g2o, by the numbers of its vertices; none of another file.

    A fixed one behind the first is what hdl_graph_slam ties that to, and no pose.
    """
    found = [(number, each) for number, text in lines if (each := NODE.match(text))]
    fixed = {word for _, text in lines if text.startswith("FIX ") for word in text.split()}
    found = sorted(found, key=lambda node: int(node[1][1]))
    nodes = found[:1] + [(number, each) for number, each in found[1:] if each[1] not in fixed]
    return [(number, each[2]) for number, each in nodes]


def _read_table(
    path: Path, lines: Sequence[NumberedLine], form: Table, notes: list[str]
) -> tuple[list[int] | None, Float64]:
    """Read the times (ns) where there are any, and poses (N, 7) or matrices (N, 12)."""
    if form.goes_on and "frame" in form.columns:
        lines = [(number, each) for number, text in lines for each in AGAIN.split(text)]
        if len({tuple(re.findall(f",({values.FRAME_NAME})", text)) for _, text in lines}) > 1:
            fix = "keep those of one body, or record a bag"
            raise LogError("transforms between several frames", where=path, fix=fix)
    sample = (form.split(text) for _, text in lines[: values.SAMPLED_ROWS])
    columns, unit, note = values.settle_times(form.columns, form.unit, sample)
    form = form._replace(columns=columns, unit=unit)
    if not (rows := list(_parse_lines(path, lines, form.parse, form.shape))):
        raise LogError("the trajectory holds no poses", where=path, fix=SHAPES)
    times = [stamp_ns for stamp_ns, _ in rows if stamp_ns is not None]
    poses, doubt = np.array([numbers for _, numbers in rows]), ""
    if poses.shape[1] < 7:
        doubt = values.suspect_degrees(poses[:, 5], (max(times) - min(times)) / 1e9)
        poses[~np.isfinite(poses)] = np.nan  # an infinite angle has no sine
        turned = [Pose.from_xyzrpy(row[:3], row[3:]) for row in map(tuple, poses.tolist())]
        poses = np.array(turned)
    notes += [f"{path}: {text}" for text in (note, doubt) if text]
    return times or None, poses


def _refuse_no_rotation(path: Path, quaternions: Float64) -> None:
    """Refuse quaternions (N, 4) that are no rotations; others may have any length, but one."""
    lengths = np.linalg.norm(quaternions, axis=1)
    if np.median(np.abs(lengths / np.median(lengths) - 1)) > 0.05:
        fix = f"a header must say what the columns are; {SHAPES}"
        raise LogError("no quaternion stands behind x, y and z", where=path, fix=fix)


def _find_order(form: Table, quaternions: Float64) -> tuple[int, ...]:
    """Find which columns of poses are the quaternion, if (N, 4) turn as no robot does; () if not.

    If TUM takes their w for x, they turn about x alone, and if EuRoC takes z and w for y and z, by
    half a turn.
    """
    x, y, z, w = np.abs(quaternions).max(axis=0)
    if form is TUM:
        is_w = np.ptp(quaternions[:, 0]) > 0.1 and np.median(np.abs(quaternions[:, 0])) > 0.5**0.5
        return (4, 5, 6, 3) if is_w and max(y, z) < 0.01 else ()
    return (6, 3, 4, 5) if min(y, z) > 0.1 and max(x, w) < 0.01 else ()


def _are_of_camera(poses: Float64) -> bool:
    """Whether finite poses (N, 7) go and turn as only a camera's do in its axes.

    They lead further along z than along y, turn far about y, which stays where it is, and go where
    their own z points.
    """
    turns, (_, y, z) = rotate_by(poses[:, 3:]), np.ptp(poses[:, :3], axis=0)
    upright, turned = turns[:, [1, 2], [1, 2]].min(axis=0)
    steps = np.einsum("nij,ni->nj", turns[:-1], np.diff(poses[:, :3], axis=0))
    aside, _, ahead = np.abs(steps).sum(axis=0)
    goes_ahead = z > max(y, LEAST_WAY_M) and ahead > 2 * aside
    return bool(goes_ahead and upright > 0.8 and turned < 0.5)


def _make_poses(path: Path, rows: Float64, notes: list[str]) -> tuple[Float64, bool]:
    """Make poses (N, 7) of the upper rows (N, 3, 4) of matrices, and tell if they are a camera's.

    Those are told by where they lead: on the ground only such poses go far along z.
    """
    is_finite = np.isfinite(rows).all(axis=(1, 2))
    y, z = (np.ptp(rows[is_finite, axis, 3]) if is_finite.any() else 0.0 for axis in (1, 2))
    notes.append(
        f"{path}: its poses go {y:.3g} m along y and {z:.3g} m along z, so they are taken as "
        + (OF_CAMERA if z > y else "those of a robot (x is ahead, z up)")
    )
    rows[~is_finite] = np.nan
    return np.column_stack([rows[:, :, 3], to_quaternions(rows[:, :, :3])]), bool(z > y)


def find_lidar(path: Path) -> Concern | None:
    """Say where KITTI's calibration has the lidar, if it lies beside the poses of a camera."""
    beside = path.parent / CALIBRATION
    with suppress(LogError, ValueError):  # poses do without
        for found in filter(None, (LIDAR.fullmatch(text) for _, text in _read_rows(beside)[0])):
            with np.errstate(invalid="ignore", over="ignore"):
                lidar = FROM_CAMERA @ np.array(found[1].split(), np.float64).reshape(3, 4)
                if not _is_rotation(lidar[:, :3]):
                    continue
            mount = Pose(*lidar[:, 3].tolist(), *to_quaternions(lidar[None, :, :3])[0].tolist())
            remedy = {"sensor_pose": format_mount(mount)}
            text = f"{beside} has the lidar at {mark_options(remedy)} of that camera"
            return Concern(text, remedy)
    return None


def _read_times(path: Path) -> list[int]:
    """Read the times of KITTI's poses from the file beside them."""
    beside = path.parent / TIMES
    if not beside.is_file():
        raise LogError(
            "poses without times", where=path, fix=f"put {TIMES} beside it, or write TUM"
        )
    fix, lines = "a time in seconds stands in each line", _read_rows(beside)[0]
    unit = values.guess_unit([text for _, text in lines[: values.SAMPLED_ROWS]])
    return list(_parse_lines(beside, lines, partial(values.parse_time, unit=unit), fix))


def _read_rows(path: Path) -> tuple[list[NumberedLine], list[str]]:
    """Read the lines that are neither empty nor comments, and the comments above them."""
    rows, headings = list[NumberedLine](), list[str]()
    with refuse_unreadable(path):
        with path.open("rb") as file:
            begin = file.read(values.BINARY_WITHIN)
        found, fix = values.name_other(path, begin)
        if found or values.NO_TEXT.search(begin):
            found = found or "not text, so not a trajectory"
            raise LogError(found, where=path, fix=fix or SHAPES)
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = map(str.strip, iter(partial(file.readline, MAX_LINE), ""))
            for number, text in enumerate(lines, start=1):
                if text and not text.startswith("#"):
                    rows.append((number, text))
                elif text and not rows:
                    headings.append(text.lstrip("# "))
    return rows, headings


def _parse_lines(
    path: Path, lines: Iterable[NumberedLine], parse: Callable[[str], Parsed], fix: str = SHAPES
) -> Iterator[Parsed]:
    """Parse lines; raises LogError for the first one of which `parse` raises ValueError."""
    for number, text in lines:
        try:
            yield parse(text)
        except ValueError as error:
            whole = "" if values.shorten(text) in str(error) else f": {text[:60]!r}"
            raise LogError(f"{error}{whole}", where=f"{path}:{number}", fix=fix) from None


def _find_format(headings: Sequence[str], text: str) -> Table:
    """Tell by its first line how the lines of a file hold poses; raises ValueError.

    Parameters
    ----------
    headings
        The comments above it, one of which may name the columns.
    """
    if GRAPH.match(text):
        raise ValueError("a pose graph, whose poses have no times")
    if not NUMBER.match(text):
        return _read_header(text)
    if any("IMAGE_ID" in each for each in headings):
        raise ValueError("poses of COLMAP, which have no scale and no times")
    for heading in headings:
        with suppress(ValueError):
            form = _read_header(heading)
            form.parse(text)  # raises: it names other columns
            return form
    return _guess_format(text)


def _guess_format(text: str) -> Table:
    """Tell by a line how those hold poses whose columns nothing names; raises ValueError."""
    if echoed := values.ECHOED.match(text):
        frames = ("frame", "child") if echoed[1] else ("frame",)
        return Table(("stamp", "stamp_nsec", *frames, *TUM.columns[1:]), ",", goes_on=True)
    if columns := MATRICES.get(len(text.replace(",", " ").split())):
        form = Table(columns, None)
        if _is_matrix(form, text):
            return form
    if re.match(r"-?\d+\s*,", text) and text.count(",") >= len(EUROC.columns) - 1:
        return EUROC
    if set(text).intersection(",;"):
        raise ValueError("no header says what the columns are")
    return TUM


def _read_header(text: str) -> Table:
    """Tell by a header how the lines below hold poses; raises ValueError.

    Columns that do not belong to a pose are passed over.
    """
    separator = values.find_separator(text)
    columns, unit = values.split_header(text, separator)
    names = [TURN.sub(r"q\1", PLACE.sub(r"\1", name)) for name in columns]
    angles = QUATERNION if set(QUATERNION).intersection(names) else ("yaw",)
    if missing := {"stamp", "x", "y", *angles}.difference(names):
        raise ValueError(f"the header has {values.tell_missing(sorted(missing), columns)}")
    if len(set(names)) < len(names):
        raise ValueError("the header names a column twice")
    return Table(names, separator, unit)


def _is_matrix(form: Table, text: str) -> bool:
    """Whether a line holds a matrix, by what turns in it where that is known."""
    with suppress(ValueError):
        turn = np.reshape(form.parse(text)[1], (3, 4))[:, :3]
        return not np.isfinite(turn).all() or _is_rotation(turn)
    return True


def _is_rotation(turn: Float64) -> bool:
    """Whether a matrix turns, as one that was written with few digits does."""
    return np.allclose(turn @ turn.T, np.eye(3), atol=0.05)
