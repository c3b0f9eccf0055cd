"""Reads occmap's own CSV: one scan a row, beams as r0, r1, ..., constants in comments."""

import math
from codecs import BOM_UTF8
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from occmap.errors import LogError
from occmap.readers import Note, NoteList, Probe, Role, Span, Stream, make_part
from occmap.readers.csv_layout import (
    POSE_NAMES,
    Layout,
    is_known,
    name_unused,
    read_layout,
    read_number,
    split_cells,
    split_constant,
    split_names,
)
from occmap.readers.kernels import ANY, NANOSECONDS, NUMBER, SECONDS
from occmap.readers.text import (
    ALL,
    Block,
    Line,
    LineTally,
    add_note,
    make_planar,
    note_cut_line,
    parse_nanoseconds,
    parse_stamp,
    parse_table,
    probe_lines,
    read_blocks,
    round_limit,
    split_lines,
    stack_planar,
)
from occmap.types import Bool, Float32, Float64, Int64, Pose, PoseSample, Scan, ScanRun, as_float32

TOPIC = "scan"
VARIABLE = frozenset(("stamp", "time_increment", *POSE_NAMES))
"""What differs between the scans of one laser, beside their ranges."""
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
        lines = [line.strip() for line in probe_lines(probe)]
        header = next((line for line in lines if line and not line.startswith("#")), None)
        constants = (split_constant(line) for line in lines if line.startswith("#"))
        stated = {constant[0] for constant in constants if constant}
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
            A column is missing, or a constant is no number.
        """
        return CsvLog(path)


class CsvLog:
    """An opened CSV log; its scans are the stream `scan`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = NoteList()
        self._rows = 0
        self._last: Line | None = None
        self._whole: LineTally | None = None
        """Of all rows of the log, once one is malformed"""
        self._span = ALL
        self._layout = self._survey()
        self._check_last()
        if self._layout.unused:
            text = f"columns that are not used: {', '.join(self._layout.unused[:MAX_NAMES])}"
            add_note(self.notes, Note(text))

    @property
    def streams(self) -> Sequence[Stream]:
        """The one stream of scans."""
        return [Stream(TOPIC, "csv", self._rows, Role.SCAN)]

    def poses(self) -> Iterator[PoseSample]:
        """None: where the log has poses, each scan holds its own."""
        return iter(())

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans, a row at a time.

        Raises
        ------
        LogError
            The first row, or so many that this is no damage, has a word for a number or too few or
            many cells.
        """
        tally = LineTally()
        for block, rows in self._walk(self._span) if TOPIC in topics else ():
            yield from self._parse_each(block, rows, tally)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The same, with many rows at once where only stamps, ranges and poses differ."""
        tally = LineTally()
        for block, rows in self._walk(self._span) if TOPIC in topics else ():
            yield from self._parse_block(block, rows, tally)

    def split(self, size: int) -> Sequence["CsvLog"]:
        """Cut the log into parts of about so many bytes, as `occmap.readers.Splittable` has it."""
        damaged = any(note.damage for note in self.notes)
        spans = [ALL] if damaged else split_lines(self.path, size, _is_heading)
        return [make_part(self, _span=span) for span in spans]

    def _walk(self, span: Span) -> Iterator[tuple[Block, Int64]]:
        """Yield blocks, and which of their lines are rows (S,), without the header."""
        header = 1 if span.start == 0 else 0
        for block in read_blocks(self.path, self.notes, span):
            rows = np.flatnonzero(_find_rows(block))
            if rows[header:].size:
                yield block, rows[header:]
            header = 0 if rows.size else header

    def _survey(self) -> Layout:
        """Find the header, and the constants wherever they stand, and count the rows."""
        header: Line | None = None
        constants: dict[str, Line] = {}
        unused: dict[str, None] = {}
        for block in read_blocks(self.path, self.notes):
            is_row = _find_rows(block)
            for line in block.pick_lines(np.flatnonzero(~is_row)):
                _keep_comment(line, constants, unused)
            rows = np.flatnonzero(is_row)
            if header is None and rows.size:
                header, rows = block.get_line(int(rows[0])), rows[1:]
            if rows.size:
                self._rows += rows.size
                self._last = block.get_line(int(rows[-1]))
        if header is None:
            found = "; ".join(["no header row", *(note.text for note in self.notes)])
            raise LogError(found, where=self.path, fix="a header is stamp,...,r0,r1,...")
        if unused:
            add_note(self.notes, Note(f"comments that are not used: {', '.join(unused)}"))
        return read_layout(self.path, header, constants)

    def _check_last(self) -> None:
        """Where the file has no last line end, see whether its last row is whole."""
        if self._last is None or self._last.ended:
            return
        if self._parse(self._last, LineTally()) is None:
            self._rows -= 1
        else:
            text = f"line {self._last.number}, the last, has no line end; it is taken as whole"
            add_note(self.notes, Note(text))

    def _parse_block(self, block: Block, rows: Int64, tally: LineTally) -> Iterable[Scan | ScanRun]:
        """Parse rows together or, where that cannot be, one by one."""
        try:
            run = _parse_rows(self._layout, block, rows)
        except ValueError:  # damage or another geometry: reading row by row shows which
            return self._parse_each(block, rows, tally)
        tally.total += run.scans
        return (run,)

    def _parse_each(self, block: Block, rows: Int64, tally: LineTally) -> Iterator[Scan]:
        return filter(None, (self._parse(line, tally) for line in block.pick_lines(rows)))

    def _parse(self, line: Line, tally: LineTally) -> Scan | None:
        """Parse a row and count it; one that is cut or damaged gives None."""
        try:
            scan = _parse_row(self._layout, line.text)
        except ValueError as error:
            if not line.ended:
                note_cut_line(self.notes, line)
                return None
            tally.add(line, str(error))
            if tally is not self._whole:
                self._judge()
            return None
        tally.add(line)
        return scan

    def _judge(self) -> None:
        """Tell damage from a file that is no log, by all rows even where this is a part of it."""
        if self._whole is None:
            self._whole = LineTally()
            for block, rows in self._walk(ALL):
                deque(self._parse_block(block, rows, self._whole), maxlen=0)
            self._rows -= self._whole.malformed
        self._whole.judge(self.path, self.notes, "correct or delete this row")


def _keep_comment(line: Line, constants: dict[str, Line], unused: dict[str, None]) -> None:
    """Keep the first comment that states a constant, and the names of some that mean nothing."""
    constant = split_constant(line.text)
    if constant is not None:
        constants.setdefault(constant[0], line)
    elif (name := name_unused(line.text)) and len(unused) < MAX_NAMES:
        unused[name] = None


def _is_heading(raw: bytes) -> bool:
    """Whether a line is a comment or blank, as lines before the header are."""
    return raw.removeprefix(BOM_UTF8).lstrip()[:1] in {b"", b"#"}


def _find_rows(block: Block) -> Bool:
    """Say which lines are neither comments nor blank, (S,)."""
    first = np.frombuffer(block.text, np.uint8)[block.starts[:-1]]
    is_row: Bool = first > ord("#")  # so are all blanks and line ends not
    for at in np.flatnonzero(~is_row).tolist():
        is_row[at] = not _is_heading(block.get_line(at).raw)
    return is_row


def _parse_rows(layout: Layout, block: Block, rows: Int64) -> ScanRun:
    """Parse rows together; raises ValueError where one is malformed or unlike the first."""
    if b'"' in block.text:
        raise ValueError("there are quotes in it")
    places = dict(layout.columns)
    beams = list(layout.beams)
    stamp, frame = places.pop("stamp", None), places.pop("frame", None)
    kinds = np.full(len(layout.header), ANY, np.uint8)
    kinds[[*places.values(), *beams]] = NUMBER
    if stamp is not None:
        kinds[stamp] = NANOSECONDS if layout.stamp_unit == "ns" else SECONDS
    values, times = parse_table(block, rows, b",", kinds)
    fixed = values[:, [at for name, at in places.items() if name not in VARIABLE]]
    frames: set[bytes] = set()
    if frame is not None:
        frames = {line.raw.split(b",", frame + 1)[frame] for line in block.pick_lines(rows)}
    if (fixed != fixed[0]).any() or len(frames) > 1:
        raise ValueError("the rows differ in more than what is measured")
    side_by_side = beams == list(range(beams[0], beams[-1] + 1))  # a slice takes no copy
    ranges = as_float32(values[:, beams[0] : beams[-1] + 1] if side_by_side else values[:, beams])
    first = _parse_row(layout, block.get_line(int(rows[0])).text)

    def take(name: str, constant: float) -> Float64:
        return values[:, places[name]].copy() if name in places else np.full(len(rows), constant)

    increments = take("time_increment", first.time_increment)
    if not np.isfinite(increments).all():
        raise ValueError("time_increment is no time")
    pose = [take(name, float(layout.constants.get(name, "nan"))) for name in POSE_NAMES]
    stamp_ns = np.full(len(rows), first.stamp_ns) if stamp is None else times[:, stamp].copy()
    poses = stack_planar(*pose) if layout.has_pose else None
    return ScanRun(first, stamp_ns, stamp_ns, ranges, increments, poses)


def _parse_row(layout: Layout, text: str) -> Scan:
    """Parse a row; raises ValueError, naming the column."""
    cells = split_cells(text)
    if len(cells) != len(layout.header):
        raise ValueError(f"{len(cells)} cells where the header has {len(layout.header)}")
    stamp_ns = _read_stamp(layout, cells)
    return Scan(
        stamp_ns=stamp_ns,
        frame=layout.pick("frame", cells).strip().lstrip("/"),
        angle_min=_read_finite(layout, cells, "angle_min"),
        angle_increment=_read_finite(layout, cells, "angle_increment"),
        ranges=_read_beams(layout, cells),
        range_min=_read_limit(layout, cells, "range_min"),
        range_max=_read_limit(layout, cells, "range_max"),
        time_increment=_read_finite(layout, cells, "time_increment"),
        pose=_read_pose(layout, cells) if layout.has_pose else None,
        topic=TOPIC,
        record_ns=stamp_ns,
    )


def _read_stamp(layout: Layout, cells: list[str]) -> int:
    try:
        text = layout.pick("stamp", cells)
        return parse_nanoseconds(text) if layout.stamp_unit == "ns" else parse_stamp(text)
    except ValueError as error:
        raise ValueError(f"stamp: {error}") from None


def _read_finite(layout: Layout, cells: list[str], name: str) -> float:
    value = read_number(name, layout.pick(name, cells))
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}, which is no angle or time")
    return value


def _read_limit(layout: Layout, cells: list[str], name: str) -> float:
    value = read_number(name, layout.pick(name, cells))
    if math.isnan(value):
        raise ValueError(f"{name} is nan, which is no limit")
    return round_limit(value)


def _read_pose(layout: Layout, cells: list[str]) -> Pose:
    """Read x, y and yaw; all nan where one is empty or not finite, as nobody knew it."""
    texts = [layout.pick(name, cells).strip() or "nan" for name in POSE_NAMES]
    return make_planar(*map(read_number, POSE_NAMES, texts))


def _read_beams(layout: Layout, cells: list[str]) -> Float32:
    texts = [cells[at] for at in layout.beams]
    try:
        return as_float32([float(text or "nan") for text in texts])
    except ValueError:
        names = (f"column r{beam}" for beam in range(len(texts)))
        checked = [text.strip() or "nan" for text in texts]
        return as_float32(list(map(read_number, names, checked)))
