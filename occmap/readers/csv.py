"""Reads occmap's own CSV: one scan a row, beams as r0, r1, ..., constants in comments.

The header row names the columns, and comments state what holds for every row.

Beside occmap's own names a header may have those of `rostopic echo -p` for a LaserScan: `%time`,
`field.header.stamp`, `field.ranges0` and so on, with times in nanoseconds.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occmap.errors import LogError
from occmap.readers import Probe, Role, Stream
from occmap.readers.text_log import (
    ANY,
    NANOSECONDS,
    NUMBER,
    RANGE,
    SAME,
    SECONDS,
    Block,
    Line,
    LineTally,
    Pattern,
    Table,
    TextLog,
    is_heading,
    make_planar,
    read_blocks,
    stack_planar,
)
from occmap.types import Float32, Float64, Int64, PoseSample, Scan, ScanRun
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
    """An opened CSV log; its scans are the stream `scan`."""

    form: Layout

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._rows = 0
        self._is_judged = False
        self.form = self._survey()
        unused = [name for name in self.form.header if name and not is_known(name)]
        if unused:
            text = f"columns that are not used: {', '.join(unused[:MAX_NAMES])}"
            self.notes.add(text)

    @property
    def streams(self) -> Sequence[Stream]:
        """The one stream of scans."""
        return [Stream(TOPIC, "csv", self._rows, Role.SCAN)]

    def poses(self) -> Iterator[PoseSample]:
        """Give none: where the log has poses, each scan holds its own."""
        return iter(())

    def _survey(self) -> Layout:
        """Find the header, and the constants wherever they stand, and count the rows."""
        header: Line | None = None
        last: Line | None = None
        constants: dict[str, Line] = {}
        unused: dict[str, None] = {}
        for block in read_blocks(self.path, self.notes):
            rows, headings = _sort_lines(block)
            for line in headings:
                _keep_comment(line, constants, unused)
            if rows.size and header is None:
                header, rows = block.get_line(int(rows[0])), rows[1:]
            if rows.size:
                self._rows += len(rows)
                last = block.get_line(int(rows[-1]))
        if header is None:
            found = "; ".join(["no header row", *(note.text for note in self.notes)])
            raise LogError(found, where=self.path, fix="a header is stamp,...,r0,r1,...")
        if unused:
            self.notes.add(f"comments that are not used: {', '.join(unused)}")
        layout = read_layout(self.path, header, constants)
        if last is not None and not last.ended:
            self._check_last(last, layout)
        return layout

    def _check_last(self, line: Line, layout: Layout) -> None:
        """See whether a last row is whole that has no line end."""
        if self._parse(line, layout.parse, LineTally()) is None:
            self._rows -= 1
        else:
            text = f"line {line.number}, the last, has no line end; it is taken as whole"
            self.notes.add(text)

    def _read(self) -> Iterator[Scan | ScanRun]:
        tally = LineTally()
        for scans in self._parse_rows(tally):
            if tally.malformed and not self._is_judged:
                self._judge()
            yield from scans

    def _parse_rows(self, tally: LineTally) -> Iterator[Sequence[Scan | ScanRun]]:
        """Parse the rows of the file, a block at a time."""
        header = 1
        for block in read_blocks(self.path, self.notes):
            rows, _ = _sort_lines(block)
            yield self._parse_block(block, {TOPIC: rows[header:]}, tally)
            header = 0 if rows.size else header

    def _judge(self) -> None:
        """Tell damage from a file that is not a log, by all its rows."""
        tally = LineTally()
        for _ in self._parse_rows(tally):
            pass
        self._rows = tally.total - tally.malformed
        fix = "correct or delete this row" if self._rows else "correct the header or these rows"
        tally.judge(self.path, self.notes, fix)
        self._is_judged = True


def _sort_lines(block: Block) -> tuple[Int64, list[Line]]:
    """Tell rows, by their indices, from the lines that are comments or blank."""
    first = np.frombuffer(block.text, np.uint8)[block.starts[:-1]]
    maybe = np.flatnonzero(first <= ord("#"))  # blanks and line ends are below it
    headings = [line for line in block.get_lines(maybe) if is_heading(line.raw)]
    rows = np.delete(np.arange(len(block)), [line.number - block.number for line in headings])
    return rows, headings


def _keep_comment(line: Line, constants: dict[str, Line], unused: dict[str, None]) -> None:
    """Keep the first comment that states a constant, and the names of some that mean nothing."""
    name, value = split_comment(line.text)
    if name in NAMES:
        constants.setdefault(name, line)
    elif name.isidentifier() and len(unused) < MAX_NAMES:
        with suppress(ValueError):
            float(value)
            unused[name] = None
