"""What stands where in a CSV of scans, and how a row becomes a scan.

The header row names the columns, and comments state what holds for every row.

Beside occmap's own names a header may have those of `rostopic echo -p` for a LaserScan: `%time`,
`field.header.stamp`, `field.ranges0` and so on, with times in nanoseconds.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occmap.errors import LogError
from occmap.readers.kernels import ANY, NANOSECONDS, NUMBER, RANGE, SAME, SECONDS
from occmap.readers.text import Line, Pattern, Table, make_planar, round_limit, stack_planar
from occmap.types import (
    Float32,
    Float64,
    Pose,
    Scan,
    ScanRun,
    as_float32,
    parse_nanoseconds,
    parse_seconds,
    shorten,
)

TOPIC = "scan"
POSE_NAMES = ("x", "y", "yaw")
REQUIRED = ("stamp", "angle_min", "angle_increment")
DEFAULTS = {"range_min": "0", "range_max": "inf", "time_increment": "0", "frame": "laser"}
MEASURED = frozenset(("time_increment", *POSE_NAMES))
"""Numbers that differ between the scans of one laser, as stamps and ranges do."""
NAMES = frozenset((*REQUIRED, *DEFAULTS, *POSE_NAMES))
"""What may stand as a column or in a comment; beams are columns only."""
ALIASES = {"stamp": ("time", "timestamp", "t"), "yaw": ("theta", "heading")}
"""What other programs call a column; none is read as it, for its unit may be another."""
ROSTOPIC = "%time"
"""How the header of `rostopic echo -p` starts."""
_ROSTOPIC_BEAM = re.compile(r"field\.ranges(\d+)")
_ROSTOPIC_NAMES = {
    "field.header.stamp": "stamp",
    "field.header.frame_id": "frame",
    **{
        f"field.{name}": name
        for name in ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")
    },
}


@dataclass(frozen=True)
class Layout:
    """Where the values of a scan stand."""

    header: tuple[str, ...]
    """The name of each cell of a row."""
    columns: Mapping[str, int]
    """The cell of each of `NAMES` that is a column."""
    beams: tuple[int, ...]
    """The cell of each beam, from r0 on."""
    constants: Mapping[str, str]
    """The text of each of `NAMES` that is no column and has a value."""
    stamp_unit: str = "s"
    """"s" or "ns"."""

    @property
    def has_pose(self) -> bool:
        """Whether the log states poses."""
        return "x" in self.columns or "x" in self.constants

    @property
    def unused(self) -> list[str]:
        """Columns that occmap does not know."""
        return [name for name in self.header if name and not is_known(name)]

    def pick(self, name: str, cells: list[str]) -> str:
        """Pick the text of one of `NAMES` from a row or, where it is no column, its constant."""
        return cells[self.columns[name]] if name in self.columns else self.constants[name]


def read_layout(path: Path, header: Line, comments: Mapping[str, Line]) -> Layout:
    """Make a layout of the header row and the comments that state constants, by name.

    Raises
    ------
    LogError
        A column is missing or stands twice, or a constant is no number.
    """
    try:
        names = split_names(header.text)
    except ValueError as error:
        raise _fail(path, header, f"malformed header: {error}", "correct it") from None
    fault = _find_fault(names, {*names, *comments})
    if fault is not None:
        raise _fail(path, header, *fault)
    places = {name: at for at, name in enumerate(names)}
    beams = sum(map(_is_beam, names))
    stated = {name: line for name, line in comments.items() if name not in names}
    return Layout(
        header=tuple(names),
        columns={name: at for name, at in places.items() if name in NAMES},
        beams=tuple(places[f"r{beam}"] for beam in range(beams)),
        constants=DEFAULTS | {name: _read_constant(path, line) for name, line in stated.items()},
        stamp_unit="ns" if header.text.startswith(ROSTOPIC) else "s",
    )


def split_cells(text: str) -> list[str]:
    """Split a row; quotes are rare, so they are looked for first.

    Raises
    ------
    ValueError
        A cell is larger than the csv module reads.
    """
    if '"' not in text:
        return text.split(",")
    try:
        return next(csv.reader([text]))
    except csv.Error as error:
        raise ValueError(str(error)) from None


def split_names(text: str) -> list[str]:
    """Split a header row, in occmap's own names; raises ValueError as `split_cells` does."""
    names = [cell.strip() for cell in split_cells(text)]
    return [_translate(name) for name in names] if text.startswith(ROSTOPIC) else names


def _translate(name: str) -> str:
    """Bring a name of rostopic's to occmap's; others stay as they are."""
    return _ROSTOPIC_NAMES.get(name) or _ROSTOPIC_BEAM.sub(r"r\1", name)


def split_constant(text: str) -> tuple[str, str] | None:
    """Split a comment `# name: value`; None where it is any other comment."""
    name, value = _split_comment(text)
    return (name, value) if name in NAMES else None


def name_unused(text: str) -> str | None:
    """Name what a comment `# name: number` states that means nothing here; None of any other."""
    name, value = _split_comment(text)
    with suppress(ValueError):
        float(value)
        return name if name.isidentifier() and name not in NAMES else None
    return None


def _split_comment(text: str) -> tuple[str, str]:
    """Split a comment into what stands before its colon and behind it; "" where it has none."""
    name, colon, value = text.lstrip("# \t").partition(":")
    return (name.strip(), value.strip()) if colon else ("", "")


def is_known(name: str) -> bool:
    """Whether a column of this name means something to occmap."""
    return name in NAMES or _is_beam(name)


def _is_beam(name: str) -> bool:
    return name[:1] == "r" and name[1:].isdecimal()


def read_number(name: str, text: str) -> float:
    """Read a number of a cell or constant; raises ValueError, naming the column."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{name} is {shorten(text)} where a number belongs") from None


def _find_fault(names: list[str], given: set[str]) -> tuple[str, str] | None:
    """Find what is wrong with the columns and constants given: the fault, and what to do."""
    repeated = (name for name, count in Counter(names).items() if name and count > 1)
    if (twice := next(repeated, None)) is not None:
        return f"column {twice} stands twice", "rename or remove one of them"
    posed = POSE_NAMES if given.intersection(POSE_NAMES) else ()
    for name in (*REQUIRED, *posed):
        if name not in given:
            other = next((other for other in ALIASES.get(name, ()) if other in names), None)
            add = f"add it, or a comment `# {name}: VALUE` for all rows"
            return f"no column {name}", f"rename the column {other} to it" if other else add
    beams = sum(map(_is_beam, names))
    for name in (f"r{beam}" for beam in range(max(beams, 1))):
        if name not in given:
            hint = "" if beams else "; a file of poses alone is given with `poses`"
            return f"no column {name}", f"the beams are r0, r1, ... without a gap{hint}"
    return None


def _read_constant(path: Path, line: Line) -> str:
    """Return the text of a constant after a check that it can be read."""
    name, text = split_constant(line.text) or ("", "")
    try:
        if name == "stamp":
            parse_seconds(text)
        elif name != "frame":
            read_number(name, text)
    except ValueError as error:
        raise _fail(path, line, str(error), f"write `# {name}: NUMBER`") from None
    return text


def _fail(path: Path, line: Line, found: str, fix: str) -> LogError:
    return LogError(found, where=f"{path}:{line.number}", fix=fix)


def parse_row(layout: Layout, text: str) -> Scan:
    """Parse a row; raises ValueError, naming the column."""
    cells = split_cells(text)
    if len(cells) != len(layout.header):
        raise ValueError(f"{len(cells)} cells where the header has {len(layout.header)}")

    def read_finite(name: str) -> float:
        value = read_number(name, layout.pick(name, cells))
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value}, which is no angle or time")
        return value

    def read_limit(name: str) -> float:
        value = read_number(name, layout.pick(name, cells))
        if math.isnan(value):
            raise ValueError(f"{name} is nan, which is no limit")
        return round_limit(value)

    stamp_ns = _read_stamp(layout, cells)
    return Scan(
        stamp_ns=stamp_ns,
        frame=layout.pick("frame", cells).strip().lstrip("/"),
        angle_min=read_finite("angle_min"),
        angle_increment=read_finite("angle_increment"),
        ranges=_read_beams([cells[at] for at in layout.beams]),
        range_min=read_limit("range_min"),
        range_max=read_limit("range_max"),
        time_increment=read_finite("time_increment"),
        pose=_read_pose(layout, cells) if layout.has_pose else None,
        topic=TOPIC,
        record_ns=stamp_ns,
    )


def find_pattern(layout: Layout, line: Line) -> Pattern:
    """Say what rows like one that is sound have in common: all but what differs between scans."""
    kinds, beams = (
        np.full(len(layout.header), ANY, np.uint8),
        np.zeros(len(layout.header), np.int64),
    )
    for name, at in layout.columns.items():
        kinds[at] = NUMBER if name in MEASURED else SAME
    if "stamp" in layout.columns:
        kinds[layout.columns["stamp"]] = NANOSECONDS if layout.stamp_unit == "ns" else SECONDS
    kinds[list(layout.beams)], beams[list(layout.beams)] = RANGE, np.arange(len(layout.beams))
    return Pattern.of(line.raw.split(b","), b",", kinds, beams)


def make_run(layout: Layout, first: Scan, table: Table) -> ScanRun:
    """Make scans of rows like the first; raises ValueError where one is malformed."""

    def take(name: str, constant: float) -> Float64:
        at = layout.columns.get(name)
        return np.full(len(table.rows), constant) if at is None else table.values[at].copy()

    increments = take("time_increment", first.time_increment)
    if not np.isfinite(increments).all():
        raise ValueError("time_increment is no time")
    at = layout.columns.get("stamp")
    stamp_ns = np.full(len(table.rows), first.stamp_ns) if at is None else table.times[at].copy()
    pose = [take(name, float(layout.constants.get(name, "nan"))) for name in POSE_NAMES]
    poses = stack_planar(*pose) if layout.has_pose else None
    return ScanRun(first, stamp_ns, stamp_ns, table.ranges, increments, poses)


def _read_stamp(layout: Layout, cells: list[str]) -> int:
    try:
        text = layout.pick("stamp", cells)
        return parse_nanoseconds(text) if layout.stamp_unit == "ns" else parse_seconds(text)
    except ValueError as error:
        raise ValueError(f"stamp: {error}") from None


def _read_pose(layout: Layout, cells: list[str]) -> Pose:
    """Read x, y and yaw; all nan where one is empty or not finite, as nobody knew it."""
    texts = [layout.pick(name, cells).strip() or "nan" for name in POSE_NAMES]
    return make_planar(*map(read_number, POSE_NAMES, texts))


def _read_beams(texts: list[str]) -> Float32:
    try:
        return as_float32([float(text or "nan") for text in texts])
    except ValueError:
        names = (f"column r{beam}" for beam in range(len(texts)))
        checked = [text.strip() or "nan" for text in texts]
        return as_float32(list(map(read_number, names, checked)))
