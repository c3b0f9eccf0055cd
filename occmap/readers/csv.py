"""Reads occmap's own CSV: one scan a row, beams as r0, r1, ..., constants in comments.

The header row names the columns, and comments state what holds for every row.

Beside occmap's own names a header may have those of `rostopic echo -p` for a LaserScan: `%time`,
`field.header.stamp`, `field.ranges0` and so on, with times in nanoseconds.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from occmap.errors import LogError
from occmap.readers import Probe, Role, Stream
from occmap.readers.text_log import (
    Block,
    Line,
    Pattern,
    TextLog,
    make_planar,
    read_blocks,
    stack_planar,
)
from occmap.types import Float32, Float64, Int64, PoseSample, Scan, ScanRun
from occmap.values import as_float32, parse_nanoseconds, parse_seconds, shorten

if TYPE_CHECKING:
    from occmap.readers.decimals import Words

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


def _is_unknown(name: str, value: str) -> bool:
    """Whether a comment gives a number to a name that means nothing."""
    with suppress(ValueError):
        float(value)
        return name.isidentifier() and name not in NAMES
    return False


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


MAX_NAMES = 5
"""Names in one note."""


class CsvReader:
    """occmap's CSV."""

    name = "csv"
    description = "CSV of one scan a row (stamp, x, y, yaw, angles, r0, ... or rostopic's), or gzip"

    def recognises(self, probe: Probe) -> bool:
        """Whether the header, or before it a constant, is of this dialect.

        A header that lacks a column is recognised, so that the error can name the column.
        """
        lines = [line.strip() for line in probe.lines]
        header = next((line for line in lines if line and not line.startswith("#")), None)
        stated = {split_comment(line)[0] for line in lines if line.startswith("#")} & NAMES
        if header is None:
            return bool(stated)
        try:
            names = set(split_names(header))
        except ValueError:
            return False
        return bool(names & {"stamp", "r0"}) and sum(map(is_known, names | stated)) >= 3

    def open(self, path: Path) -> "CsvLog":
        """Open a log: read its header and count its rows.

        Raises
        ------
        LogError
            A column is missing, or a constant is not a number.
        """
        return CsvLog(path)


class CsvLog(TextLog):
    """An opened CSV log; its scans are the stream `scan`.

    Raises
    ------
    LogError
        A column is missing or stands twice, a constant is not a number, or the first row is
        malformed, or so many are that it is not damage.
    """

    fix = "correct or delete this row"
    fix_all = "correct the header or these rows"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        header, comments = self._find_header()
        self._header_line = header.number
        try:
            self._names = split_names(header.text)
        except ValueError as error:
            found = f"malformed header: {error}"
            raise LogError(found, where=f"{path}:{header.number}", fix="correct it") from None
        if fault := _find_fault(self._names, {*self._names, *comments}):
            raise LogError(fault[0], where=f"{path}:{header.number}", fix=fault[1])
        places = {name: at for at, name in enumerate(self._names)}
        self._columns = {name: at for name, at in places.items() if name in NAMES}
        """The cell of each of `NAMES` that is a column"""
        self._beams = [places[f"r{beam}"] for beam in range(sum(map(_is_beam, self._names)))]
        """The cell of each beam, from r0 on"""
        self._stated = {*self._names, *comments}
        stated = {name: line for name, line in comments.items() if name not in self._names}
        constants = {name: _read_constant(path, name, line) for name, line in stated.items()}
        self._constants = {**DEFAULTS, **constants}
        """The text of each of `NAMES` that has a value for all rows and no column"""
        self._is_in_ns = header.text.startswith(ROSTOPIC)
        if unused := [name for name in self._names if name and not is_known(name)]:
            self.notes.add(f"columns that are not used: {', '.join(unused[:MAX_NAMES])}")
        self._rows = sum(some.scans for some in self._survey())

    @property
    def streams(self) -> Sequence[Stream]:
        """The one stream of scans."""
        return [Stream(TOPIC, "csv", self._rows, Role.SCAN)]

    def poses(self) -> Iterator[PoseSample]:
        """Give none: where the log has poses, each scan holds its own."""
        return iter(())

    def _find_header(self) -> tuple[Line, dict[str, Line]]:
        """Find the header, and the comments near it that state constants."""
        headings: list[Line] = []
        for block in read_blocks(self.path, self.notes):
            rows, more = _sort_lines(block)
            headings += more
            if rows.size:
                named = [(*split_comment(line.text), line) for line in headings]
                unused = [name for name, value, _ in named if _is_unknown(name, value)]
                if unused:
                    names = ", ".join(dict.fromkeys(unused[:MAX_NAMES]))
                    self.notes.add(f"comments that are not used: {names}")
                # Of two comments about one name the first counts.
                constants = {name: line for name, _, line in reversed(named) if name in NAMES}
                return block.get_line(int(rows[0])), constants
        found = "; ".join(["no header row", *(note.text for note in self.notes)])
        raise LogError(found, where=self.path, fix="a header is stamp,...,r0,r1,...")

    def pick_scans(self, block: Block) -> Mapping[str, Int64]:
        """Find the rows behind the header; refuse a constant that comes too late for those before.

        Raises
        ------
        LogError
            A comment states what neither a column nor a comment at the top of the file states.
        """
        rows, headings = _sort_lines(block)
        for line in headings:
            name, _ = split_comment(line.text)
            if name in NAMES and name not in self._stated:
                found = f"the comment states {name} for all rows, too far behind the header"
                fix = "move it to the top of the file"
                raise LogError(found, where=f"{self.path}:{line.number}", fix=fix)
        rows = rows[rows > self._header_line - block.number]
        return {TOPIC: rows} if rows.size else {}

    def parse_scan(self, text: str) -> Scan:
        """Parse a row; raises ValueError, naming the column."""
        cells = split_cells(text)
        if len(cells) != len(self._names):
            raise ValueError(f"{len(cells)} cells where the header has {len(self._names)}")
        texts = {**self._constants, **{name: cells[at] for name, at in self._columns.items()}}
        try:
            parse = parse_nanoseconds if self._is_in_ns else parse_seconds
            stamp_ns = parse(texts["stamp"])
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
            ranges=_read_beams([cells[at] for at in self._beams]),
            # Rounded as the ranges are, so that a range at the limit compares as equal.
            range_min=float(as_float32(number["range_min"])),
            range_max=float(as_float32(number["range_max"])),
            time_increment=number["time_increment"],
            pose=pose,
            topic=TOPIC,
            record_ns=stamp_ns,
        )

    def find_pattern(self, _line: Line) -> Pattern:
        """Say what rows have in common: all but times, ranges and poses."""
        from occmap.readers.decimals import NUMBER, OTHER, RANGE  # noqa: PLC0415  it brings numba

        kinds = np.full(len(self._names), OTHER, np.uint8)
        kinds[self._beams] = RANGE
        kinds[[at for name, at in self._columns.items() if name in MEASURED]] = NUMBER
        varying = MEASURED | {"stamp"}
        return Pattern(b",", kinds, [at for n, at in self._columns.items() if n not in varying])

    def make_run(self, first: Scan, words: "Words") -> ScanRun:
        """Make scans of rows like the first; raises ValueError where one is malformed."""
        scans = len(words.ranges)

        def take(name: str, constant: float) -> Float64:
            at = self._columns.get(name)
            return np.full(scans, constant) if at is None else words.numbers[at].copy()

        increments = take("time_increment", first.time_increment)
        if not np.isfinite(increments[words.is_sound]).all():
            raise ValueError("time_increment is not a time")
        stamp_ns = np.full(scans, first.stamp_ns)
        if "stamp" in self._columns:
            stamp_ns = words.read_times(self._columns["stamp"], 0 if self._is_in_ns else 9)
        poses = None
        if first.pose is not None:
            poses = stack_planar(
                *(take(n, float(self._constants.get(n, "nan"))) for n in POSE_NAMES)
            )
        ranges, in_order = words.ranges, sorted(self._beams)
        if self._beams != in_order:  # columns may stand in any order
            ranges = ranges[:, np.searchsorted(in_order, self._beams)]
        return ScanRun(first, stamp_ns, stamp_ns, ranges, increments, poses)


def _sort_lines(block: Block) -> tuple[Int64, list[Line]]:
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
    return np.flatnonzero(is_row), comments


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
