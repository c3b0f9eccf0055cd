"""Reads occmap's own CSV: one scan a row, beams as r0, r1, ..., constants in comments."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from occmap.errors import LogError
from occmap.readers import Role, Stream, csv_rows
from occmap.readers.probing import Probe
from occmap.readers.text import Block, Line, is_heading, read_blocks
from occmap.readers.text_log import LineTally, TextLog
from occmap.types import Int64, PoseSample, Scan, ScanRun

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
        stated = {
            csv_rows.split_comment(line)[0] for line in lines if line.startswith("#")
        } & csv_rows.NAMES
        if header is None:
            return bool(stated)
        try:
            names = set(csv_rows.split_names(header))
        except ValueError:
            return False
        return bool(names & {"stamp", "r0"}) and sum(map(csv_rows.is_known, names | stated)) >= 3

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

    form: csv_rows.Layout

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._rows = 0
        self._is_judged = False
        self.form = self._survey()
        unused = [name for name in self.form.header if name and not csv_rows.is_known(name)]
        if unused:
            text = f"columns that are not used: {', '.join(unused[:MAX_NAMES])}"
            self.notes.add(text)

    @property
    def streams(self) -> Sequence[Stream]:
        """The one stream of scans."""
        return [Stream(csv_rows.TOPIC, "csv", self._rows, Role.SCAN)]

    def poses(self) -> Iterator[PoseSample]:
        """Give none: where the log has poses, each scan holds its own."""
        return iter(())

    def _survey(self) -> csv_rows.Layout:
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
        layout = csv_rows.read_layout(self.path, header, constants)
        if last is not None and not last.ended:
            self._check_last(last, layout)
        return layout

    def _check_last(self, line: Line, layout: csv_rows.Layout) -> None:
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
            yield self._parse_block(block, {csv_rows.TOPIC: rows[header:]}, tally)
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
    name, value = csv_rows.split_comment(line.text)
    if name in csv_rows.NAMES:
        constants.setdefault(name, line)
    elif name.isidentifier() and len(unused) < MAX_NAMES:
        with suppress(ValueError):
            float(value)
            unused[name] = None
