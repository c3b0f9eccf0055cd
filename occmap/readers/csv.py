"""Reads occmap's own CSV: one scan a row, beams as r0, r1, ..., constants in comments.

The header row names the columns, and comments state what holds for every row.

Beside occmap's own names a header may have those of other programs, such as `timestamp` and
`ranges[0]`, or of `rostopic echo -p` for a LaserScan: `%time`, `field.header.stamp` and so on, with
times in nanoseconds. Where semicolons or tabs stand between cells, a comma in a number is a dot.
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from occmap import values
from occmap.errors import LogError
from occmap.readers import Probe, Role, Stream, decimals
from occmap.readers.decimals import unquote
from occmap.readers.text_log import POSE_NAMES, Block, Line, Pattern, TextLog, read_blocks
from occmap.types import IDENTITY, Scan

TOPIC = "scan"
REQUIRED = ("stamp", "angle_min", "angle_increment")
DEFAULTS = {"range_min": 0.0, "range_max": math.inf, "time_increment": 0.0, "frame": "laser"}
FINITE_NAMES = ("angle_min", "angle_increment", "time_increment")
LIMITS = ("range_min", "range_max")
MEASURED = {
    **dict.fromkeys((*POSE_NAMES, "time_increment"), decimals.NUMBER),
    "stamp_nsec": decimals.TIME + values.NANOSECONDS,
}
"""What differs between the scans of one laser, as ranges do, beside the stamp, whose unit varies"""
NAMES = frozenset((*REQUIRED, *DEFAULTS, *MEASURED))
"""What may stand as a column or in a comment; beams are columns only."""
_BEAM = re.compile(r"^r(?:anges?)?_?\[?0*(\d+)\]?$")
"""What a beam may be called"""
_CONSTANT = re.compile(r"[#\s]*([^\W\d]\w*)\s*:\s*[-+]?[\d.]+(?:[eE][-+]?\d+)?\s*$")
"""A comment that gives a number to a name"""
_TABLES = {each: bytes.maketrans(f",{each}".encode(), b".,") for each in ";\t"}
"""By what stands between cells: makes commas of these, and dots of commas within numbers"""


@lru_cache(maxsize=32)
def split_names(text: str) -> tuple[Sequence[str], int]:
    """Split a header row, which may stand behind a #, as `split_header` does.

    Cached, since a header of many beams is looked at several times.
    """
    names, unit = values.split_header(text.lstrip("# "), values.find_separator(text) or ",")
    return tuple(_BEAM.sub(r"r\1", name) for name in names), unit


def is_header(text: str, stated: Collection[str]) -> bool:
    """Whether a row names columns of scans, to which comments may add some."""
    names = [re.split(r"\s*[\[(]", name)[0] for name in split_names(text)[0]]  # in any unit
    known = list(filter(is_known, {*names, *stated}))
    of_scans = any(name.startswith(("r", "angle")) for name in known)
    return of_scans and len(known) >= 3 and not {"stamp", "r0"}.isdisjoint(names)


def split_comment(text: str) -> tuple[str, str]:
    """Split a comment `# name: value` into both; "" where it has no colon."""
    name, colon, value = text.lstrip("# \t").partition(":")
    return (name.strip(), value.strip()) if colon else ("", "")


def is_known(name: str) -> bool:
    """Whether a column of this name means something to occmap."""
    return name in NAMES or _is_beam(name)


def _is_beam(name: str) -> bool:
    return name[:1] == "r" and name[1:].isdecimal()


def read_value(name: str, text: str) -> Any:
    """Read a value that is the same in many rows; raises ValueError, naming the column."""
    if name == "frame":
        return text.lstrip("/")
    if name == "stamp":
        return values.parse_time(text)
    try:
        value = values.parse_number(text)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if name in FINITE_NAMES and not math.isfinite(value):
        raise ValueError(f"{name} is {value}, which is not an angle or a time")
    if name in LIMITS and math.isnan(value):
        raise ValueError(f"{name} is nan, which is not a limit")
    # Limits are rounded as the ranges are, so that a range at the limit compares as equal.
    return float(values.as_float32(value)) if name in LIMITS else value


def _find_fault(names: Sequence[str], given: set[str]) -> tuple[str, str] | None:
    """Find what is wrong with the columns and constants given: the fault, and what to do."""
    repeated = (name for name, count in Counter(names).items() if name and count > 1)
    if (twice := next(repeated, None)) is not None:
        return f"column {twice} stands twice", "rename or remove one of them"
    posed = POSE_NAMES if given.intersection(POSE_NAMES) else ()
    for name in (*REQUIRED, *posed):
        if name not in given:
            fix = f"add it, or a comment `# {name}: VALUE` for all rows"
            return values.tell_missing([name], names), fix
    beams = sum(map(_is_beam, names))
    for name in (f"r{beam}" for beam in range(max(beams, 1))):
        if name not in given:
            hint = "" if beams else "; a file of poses alone is given with `poses`"
            fix = f"the beams are r0, r1, ... without a gap{hint}"
            return values.tell_missing([name], names), fix
    return None


MAX_NAMES = 5
"""Names in one note."""


class CsvLog(TextLog):
    """An opened CSV log; its scans are the stream `scan`.

    Raises
    ------
    LogError
        A column is missing or stands twice, a constant is not a number, or all rows are malformed.
    """

    fix = "correct the header or these rows"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        header, comments, sample = self._find_header()
        self._header_line = header.number
        separator = values.find_separator(header.text) or ","
        self.table = _TABLES.get(separator)
        stated, unit = split_names(header.text)
        rows = [line.text.split(separator) for line in sample if line.number > header.number]
        self._names, unit, note = values.settle_times(stated, unit, rows)
        if note:
            self.notes.add(note)
        if fault := _find_fault(self._names, {*self._names, *comments}):
            raise LogError(fault[0], where=f"{path}:{header.number}", fix=fault[1])
        self._stated = {*self._names, *comments}
        self._constants: dict[str, Any] = DEFAULTS | {
            name: _read_constant(path, name, line)
            for name, line in comments.items()
            if name not in self._names
        }
        """The value of each of `NAMES` that has one for all rows"""
        self._columns = {name: at for at, name in enumerate(self._names) if name in NAMES}
        """The cell of each of `NAMES` that is a column"""
        kinds = MEASURED | {"stamp": decimals.TIME + unit}
        self._kinds = np.array([_find_kind(name, kinds) for name in self._names])
        self._places = [f"{name}: " for name in self._names]
        if unused := [name for name in self._names if name and not is_known(name)]:
            self.notes.add(f"columns that are not used: {', '.join(unused[:MAX_NAMES])}")
        scans = sum(some.scans for some in self._survey(self.pick_scans))
        self.streams = [Stream(TOPIC, "csv", scans, Role.SCAN)]

    def _find_header(self) -> tuple[Line, dict[str, Line], list[Line]]:
        """Find the header, the comments near it that state constants, and the first rows."""
        headings: list[Line] = []
        for block in read_blocks(self.path, self.notes):
            rows, more = _sort_lines(block)
            headings += more
            if rows:
                named = [(split_comment(line.text)[0], line) for line in headings]
                stated = filter(None, (_CONSTANT.match(line.text) for line in headings))
                if unused := [each[1] for each in stated if each[1] not in NAMES]:
                    names = ", ".join(dict.fromkeys(unused[:MAX_NAMES]))
                    self.notes.add(f"comments that are not used: {names}")
                # Of two comments about one name the first counts.
                constants = {name: line for name, line in reversed(named) if name in NAMES}
                first = block.get_line(rows[0])
                maybe = (first, *headings)  # numpy comments the header out
                known = (it for it in maybe if is_header(it.text, constants))
                sample = map(block.get_line, rows[: values.SAMPLED_ROWS])
                return next(known, first), constants, list(sample)
        found = "; ".join(["no header row", *(note.text for note in self.notes)])
        raise LogError(found, where=self.path, fix="a header is stamp,...,r0,r1,...")

    def pick_scans(self, block: Block) -> Mapping[str, Sequence[int]]:
        """Find the rows behind the header; refuse a constant that comes too late for those before.

        Raises
        ------
        LogError
            A comment states what neither a column nor a comment at the top of the file states.
        """
        rows, comments = _sort_lines(block)
        for line in comments:
            name, _ = split_comment(line.text)
            if name in NAMES and name not in self._stated:
                found = f"the comment states {name} for all rows, too far behind the header"
                fix = "move it to the top of the file"
                raise LogError(found, where=f"{self.path}:{line.number}", fix=fix)
        rows = [row for row in rows if row > self._header_line - block.number]
        return {TOPIC: rows} if rows else {}

    def find_pattern(self, line: Line) -> Pattern:
        """Say what rows like one have in common: all but times, ranges and poses."""
        cells = line.raw.split(b",")
        if len(cells) != len(self._names):
            raise ValueError(f"{len(cells)} cells where the header has {len(self._names)}")
        stated = self._constants.copy()
        for name, at in self._columns.items():
            if self._kinds[at] == decimals.SAME:
                stated[name] = read_value(name, unquote(cells[at]))
        shape = {name: stated[name] for name in ("frame", "angle_min", "angle_increment", *LIMITS)}
        stamp_ns, ranges = int(stated.get("stamp", 0)), np.zeros(0, np.float32)
        pose = IDENTITY if "x" in self._stated else None
        scan = Scan(stamp_ns, ranges=ranges, pose=pose, topic=TOPIC, **shape)
        return Pattern(b",", self._kinds, self._places, self._columns, stated, scan)


class CsvReader:
    """occmap's CSV."""

    name = "csv"
    description = "CSV of one scan a row (stamp, x, y, yaw, angles, r0, ... or rostopic's), or gzip"
    open = CsvLog

    def recognises(self, probe: Probe) -> bool:
        """Whether the header, or before it a constant, is of this dialect.

        A header that lacks a column is recognised, so that the error can name the column.
        """
        lines = [line.strip() for line in probe.lines if line.strip()]
        rows = [line for line in lines if not line.startswith("#")]
        comments = [line for line in lines if line.startswith("#")]
        stated = {split_comment(line)[0] for line in comments} & NAMES
        if not rows:
            return bool(stated)
        return any(is_header(line, stated) for line in (rows[0], *comments))


def _sort_lines(block: Block) -> tuple[list[int], list[Line]]:
    """Tell rows, by their indices, from the lines that are comments or blank; give the comments."""
    first = np.frombuffer(block.text, np.uint8)[block.starts[:-1]]
    is_row = first > ord("#")  # blanks and line ends are below it
    comments = []
    for row in np.flatnonzero(~is_row & (first != ord("\n"))).tolist():
        line = block.get_line(row)
        start = line.raw.lstrip()[:1]
        is_row[row] = start not in {b"", b"#"}
        if start == b"#":
            comments.append(line)
    return np.flatnonzero(is_row).tolist(), comments


def _find_kind(name: str, kinds: Mapping[str, int]) -> int:
    """Find what the words of a column are; `kinds` has those that differ between scans."""
    if _is_beam(name):
        return decimals.RANGE + int(name[1:])
    return kinds.get(name, decimals.SAME if name in NAMES else decimals.OTHER)


def _read_constant(path: Path, name: str, line: Line) -> Any:
    """Read the value that a comment gives for all rows; raises LogError where it is no number."""
    try:
        return read_value(name, split_comment(line.text)[1])
    except ValueError as error:
        place, fix = f"{path}:{line.number}", f"write `# {name}: NUMBER`"
        raise LogError(str(error), where=place, fix=fix) from None
