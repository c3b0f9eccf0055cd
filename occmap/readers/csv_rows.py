"""What stands where in a CSV of scans, and how a row becomes a scan.

The header row names the columns, and comments state what holds for every row.

Beside occmap's own names a header may have those of `rostopic echo -p` for a LaserScan: `%time`,
`field.header.stamp`, `field.ranges0` and so on, with times in nanoseconds.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occmap.errors import LogError
from occmap.readers.text import Line
from occmap.readers.text_log import (
    ANY,
    NANOSECONDS,
    NUMBER,
    RANGE,
    SAME,
    SECONDS,
    Pattern,
    Table,
    make_planar,
    stack_planar,
)
from occmap.types import Float32, Float64, Scan, ScanRun
from occmap.values import as_float32, parse_nanoseconds, parse_seconds, shorten

TOPIC = "scan"
POSE_NAMES = ("x", "y", "yaw")
REQUIRED = ("stamp", "angle_min", "angle_increment")
DEFAULTS = {"range_min": "0", "range_max": "inf", "time_increment": "0", "frame": "laser"}
FINITE = ("angle_min", "angle_increment", "time_increment")
LIMITS = ("range_min", "range_max")
NUMBERS = (*FINITE, *LIMITS)
MEASURED = frozenset(("time_increment", *POSE_NAMES))
"""Numbers that differ between the scans of one laser, as stamps and ranges do."""
NAMES = frozenset((*REQUIRED, *DEFAULTS, *POSE_NAMES))
"""What may stand as a column or in a comment; beams are columns only."""
ALIASES = {"stamp": ("time", "timestamp", "t"), "yaw": ("theta", "heading")}
"""What other programs call a column. An error names it; it is not read, as units may differ."""
ROSTOPIC = "%time"
"""How the header of `rostopic echo -p` starts."""
_ROSTOPIC_BEAM = re.compile(r"field\.ranges(\d+)")
_ROSTOPIC_NAMES = {
    "field.header.stamp": "stamp",
    "field.header.frame_id": "frame",
    **{f"field.{name}": name for name in NUMBERS},
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
    """The text of each of `NAMES` that has a value for all rows and no column."""
    parse_stamp: Callable[[str], int]
    """Parses a time, as nanoseconds; raises ValueError."""

    def parse(self, text: str) -> Scan:
        """Parse a row; raises ValueError, naming the column."""
        cells = split_cells(text)
        if len(cells) != len(self.header):
            raise ValueError(f"{len(cells)} cells where the header has {len(self.header)}")
        texts = {**self.constants, **{name: cells[at] for name, at in self.columns.items()}}
        try:
            stamp_ns = self.parse_stamp(texts["stamp"])
        except ValueError as error:
            raise ValueError(f"stamp: {error}") from None
        number = {name: read_number(name, texts[name]) for name in NUMBERS}
        pose = None
        if "x" in texts:
            place = (read_number(name, texts[name].strip() or "nan") for name in POSE_NAMES)
            pose = make_planar(*place)
        return Scan(
            stamp_ns=stamp_ns,
            frame=texts["frame"].strip().lstrip("/"),
            angle_min=number["angle_min"],
            angle_increment=number["angle_increment"],
            ranges=_read_beams([cells[at] for at in self.beams]),
            # Rounded as the ranges are, so that a range at the limit compares as equal.
            range_min=float(as_float32(number["range_min"])),
            range_max=float(as_float32(number["range_max"])),
            time_increment=number["time_increment"],
            pose=pose,
            topic=TOPIC,
            record_ns=stamp_ns,
        )

    def find_pattern(self, line: Line) -> Pattern:
        """Say what rows like one have in common: all but times, ranges and poses.

        Raises
        ------
        ValueError
            A quoted cell holds commas.
        """
        words = line.raw.split(b",")
        if len(words) != len(self.header):
            raise ValueError("there are commas within cells")
        kinds = np.full(len(self.header), ANY, np.uint8)
        for name, at in self.columns.items():
            kinds[at] = NUMBER if name in MEASURED else SAME
        if "stamp" in self.columns:
            is_seconds = self.parse_stamp is parse_seconds
            kinds[self.columns["stamp"]] = SECONDS if is_seconds else NANOSECONDS
        kinds[list(self.beams)] = RANGE
        return Pattern(words, b",", kinds)

    def make_run(self, first: Scan, table: Table) -> ScanRun:
        """Make scans of rows like the first; raises ValueError where one is malformed."""
        scans = len(table.rows)

        def take(name: str, constant: float) -> Float64:
            at = self.columns.get(name)
            return np.full(scans, constant) if at is None else table.values[at].copy()

        increments = take("time_increment", first.time_increment)
        if not np.isfinite(increments).all():
            raise ValueError("time_increment is not a time")
        stamp_ns = np.full(scans, first.stamp_ns)
        if "stamp" in self.columns:
            stamp_ns = table.times[self.columns["stamp"]].copy()
        poses = None
        if first.pose is not None:
            poses = stack_planar(
                *(take(n, float(self.constants.get(n, "nan"))) for n in POSE_NAMES)
            )
        ranges, in_order = table.ranges, sorted(self.beams)
        if list(self.beams) != in_order:  # columns may stand in any order
            ranges = ranges[:, np.searchsorted(in_order, self.beams)]
        return ScanRun(first, stamp_ns, stamp_ns, ranges, increments, poses)


def read_layout(path: Path, header: Line, comments: Mapping[str, Line]) -> Layout:
    """Make a layout of the header row and the comments that state constants, by name.

    Raises
    ------
    LogError
        A column is missing or stands twice, or a constant is not a number.
    """
    where = f"{path}:{header.number}"
    try:
        names = split_names(header.text)
    except ValueError as error:
        raise LogError(f"malformed header: {error}", where=where, fix="correct it") from None
    if fault := _find_fault(names, {*names, *comments}):
        found, fix = fault
        raise LogError(found, where=where, fix=fix)
    stated = {name: line for name, line in comments.items() if name not in names}
    constants = {name: _read_constant(path, name, line) for name, line in stated.items()}
    places = {name: at for at, name in enumerate(names)}
    return Layout(
        header=tuple(names),
        columns={name: at for name, at in places.items() if name in NAMES},
        beams=tuple(places[f"r{beam}"] for beam in range(sum(map(_is_beam, names)))),
        constants={**DEFAULTS, **constants},
        parse_stamp=parse_nanoseconds if header.text.startswith(ROSTOPIC) else parse_seconds,
    )


def _read_constant(path: Path, name: str, line: Line) -> str:
    """Read the text that a comment gives for all rows; raises LogError where it is no number."""
    _, text = split_comment(line.text)
    try:
        if name == "stamp":
            parse_seconds(text)
        elif name != "frame":
            read_number(name, text)
    except ValueError as error:
        place, fix = f"{path}:{line.number}", f"write `# {name}: NUMBER`"
        raise LogError(str(error), where=place, fix=fix) from None
    return text


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
    if text.startswith(ROSTOPIC):
        return [_ROSTOPIC_NAMES.get(name) or _ROSTOPIC_BEAM.sub(r"r\1", name) for name in names]
    return names


def split_comment(text: str) -> tuple[str, str]:
    """Split a comment `# name: value` into both; "" where it has no colon."""
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
        _refuse_notation(text)
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} is {shorten(text)} where a number belongs") from None
    if name in FINITE and not math.isfinite(value):
        raise ValueError(f"{name} is {value}, which is not an angle or a time")
    if name in LIMITS and math.isnan(value):
        raise ValueError(f"{name} is nan, which is not a limit")
    return value


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


def _refuse_notation(text: str) -> None:
    """Raise ValueError where a number is written as Python alone writes it, such as 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError


def _read_beams(texts: list[str]) -> Float32:
    try:
        _refuse_notation("".join(texts))
        return as_float32([float(text or "nan") for text in texts])
    except ValueError:
        names = (f"column r{beam}" for beam in range(len(texts)))
        checked = [text.strip() or "nan" for text in texts]
        return as_float32(list(map(read_number, names, checked)))
