"""What is printed where: results on stdout, notes, errors and progress on stderr."""

import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import click

from occmap.errors import OccmapError, OutputError
from occmap.report import Printed, name_stdin

ORDER = re.compile(r"^(\s*):(?=:)|#(?=#\w*\[)")
"""The start of what a runner of pipelines takes for a command in its log, such as `::error::`"""
RESULT_VERSION = 1
"""The version of what --json prints: it grows when a field changes its meaning or goes"""


@dataclass(frozen=True)
class ErrorParts:
    """What went wrong; the same is on stderr, in one line."""

    exit_code: int
    """Exit code: 1 the log or the data failed, 2 wrong usage, from 128 on interrupted"""
    where: str
    """The file with line or byte, the option or the topic; empty where the command line as a whole
    is wrong"""
    found: str
    """What is wrong"""
    fix: str
    """What to do or type next; empty where nobody knows"""


@dataclass(frozen=True)
class PrintedError(Printed):
    """Why there is no result: what a command prints with --json that fails before it has one."""

    error: ErrorParts
    """What went wrong"""


@dataclass
class Console:
    """The two streams, and how much goes to them."""

    quiet: bool = False
    """Only errors are told, and results that were asked for as JSON"""
    verbose: bool = False
    """What helps to find a fault in occmap itself is told, too"""
    as_json: bool = False
    """A program reads stdout: it gets one JSON object, whatever happens"""
    answered: bool = False
    """That object is printed"""
    stdout_is_taken: bool = False
    """A map goes there: all else goes to stderr"""
    announced: list[str] = field(default_factory=list)
    """What was said of the command line itself: the first notes of a result"""
    _bar: Any = None

    def put(self, lines: Iterable[str]) -> None:
        """Print a result, unless the user wants quiet."""
        if self.quiet:
            return
        if self.stdout_is_taken:
            for line in lines:
                self.tell(line)
        else:
            put_on_stdout("\n".join(clean(spell(line)) for line in lines))

    def tell(self, text: str) -> None:
        """Print a line to stderr; where that is closed there is nobody to tell."""
        try:
            click.echo(clean(spell(text)), err=True)
        except OSError:
            discard(sys.stderr)

    def put_json(self, kind: str, value: dict[str, Any]) -> None:
        """Print a result as one JSON object that names its schema."""
        import json  # noqa: PLC0415  late: most runs print none

        self.answered = True
        named = {"schema": f"occmap/{kind}/{RESULT_VERSION}", **value}
        text = spell(json.dumps(named, indent=2, allow_nan=False))
        put_on_stdout(text.replace("##", r"\u0023#"))  # equal JSON, but no command to a CI runner

    def note(self, *texts: str) -> None:
        """Print what is worth knowing, unless the user wants quiet."""
        if not self.quiet:
            for text in texts:
                self.tell(f"note: {text}")

    def announce(self, *notes: str) -> None:
        """Print what is worth knowing of the command line, and keep it for the result."""
        self.announced += notes
        self.note(*notes)

    def advance(self, scans: int, total: int) -> None:
        """Show on a terminal that so many more scans were read, of `total` in all."""
        if (bar := self._show_bar()) is not None:
            bar.total = max(total, bar.n + scans)  # an index may count too few
            bar.update(scans)

    def describe(self, phase: str) -> None:
        """Show on a terminal which phase of the work goes on."""
        if (bar := self._show_bar()) is not None:
            bar.set_postfix_str(phase)

    def _show_bar(self) -> Any:
        """Show how far the work is; None where nobody would see it."""
        is_seen = not self.quiet and sys.stderr and sys.stderr.isatty()
        if self._bar is None and is_seen:
            from tqdm import tqdm  # noqa: PLC0415  late: only who sees a bar waits for it

            self._bar = tqdm(unit=" scans", leave=False, dynamic_ncols=True)
        return self._bar

    def clear(self) -> None:
        """Take the bar away, before anything is printed where it stands."""
        if self._bar is not None:
            self._bar.close()

    def fail(self, error: OccmapError, code: int) -> int:
        """Print an error, as JSON as well where a program waits for it; return the exit code."""
        self.clear()
        self.tell(f"error: {error}")
        if self.as_json and not self.answered:
            parts = ErrorParts(code, error.where, " ".join(error.found.split()), error.fix)
            with suppress(OutputError):
                self.put_json("error", PrintedError(parts).to_json())
        return code

    def fail_unexpectedly(self, error: BaseException) -> int:
        """Print a fault of occmap, or of a plugin: one line, and the traceback where wanted."""
        import traceback  # noqa: PLC0415  late: rarely needed

        from occmap.plugins import find_culprit  # noqa: PLC0415  likewise

        self.clear()
        if self.verbose:
            for text in "".join(traceback.format_exception(error)).splitlines():
                self.tell(text)
        whose, place = find_culprit(error)
        found = f"{type(error).__name__}: {error} (at {place})"
        advice = f"this is a fault in {whose}: please report it, with what the same command prints"
        return self.fail(OccmapError(found, fix=f"{advice} with -v"), 1)


def write_rows(rows: Iterable[tuple[str, str]], width: int = 9) -> Iterator[str]:
    """Write texts under each other beside their labels; a row without one goes on with the last."""
    for label, text in rows:
        yield f"{label:<{width}}{text}".rstrip()


def align(rows: Iterable[Sequence[str]], sides: str = "") -> Iterator[str]:
    """Write rows with their columns under each other; those without a side (< or >) flush right."""
    table = list(rows)
    sides += ">" * max(map(len, table), default=0)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        cells = zip(row, sides, widths, strict=False)
        yield "  ".join(f"{text:{side}{width}}" for text, side, width in cells).rstrip()


def put_on_stdout(text: str | bytes, nl: bool = True) -> None:
    """Print to stdout; where its reader is gone, the work goes on and its exit code counts.

    Raises
    ------
    OutputError
        Stdout cannot be written for any other reason.
    """
    try:
        click.echo(text, nl=nl)
    except BrokenPipeError:
        discard(sys.stdout)
    except OSError as error:
        discard(sys.stdout)
        raise OutputError(f"cannot be written ({error.strerror})", where="stdout") from None


def spell(text: str) -> str:
    """Spell the options that a text names as flags, and a log on stdin as `-`."""
    text = name_stdin(text)
    if "`" not in text:
        return text
    from occmap.options import spell_flags  # noqa: PLC0415  late: it brings NumPy

    return spell_flags(text)


def clean(line: str) -> str:
    """Escape what moves the cursor, or is an order to a runner of pipelines."""
    if not line.isprintable():
        line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
    return ORDER.sub(lambda found: f"{found[1] or ''}\\x{ord(found[0][-1]):x}", line)


def discard(stream: Any) -> None:
    """Let what is still in the buffer of a stream vanish, or Python would complain at its exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
