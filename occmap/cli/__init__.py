"""The command line: the list of commands, and the one place where an error becomes an exit code.

Importing this brings in click and nothing else, so that `occmap --help` answers at once; a command
is imported when it is run. A signal ends a command as Ctrl-C does, with an exit code of its own.
"""

import gc
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from time import monotonic
from types import FrameType
from typing import Any

import click

from occmap.cli.console import Console, discard
from occmap.errors import OccmapError, UsageError, refuse_failures

COMMANDS = {
    "build": ("build", "Build one map from one or more logs."),
    "check": ("logs", "Say what is in logs, and what will go wrong with them."),
    "demo": ("build", "Map a simulated drive, to see what occmap does."),
    "diff": ("maps", "Say what changed between two maps, and fail above a limit."),
    "compare": ("logs", "Say which update and sensor model suits logs best."),
    "explain": ("maps", "Say what was seen at a point of saved evidence, and by which scans."),
    "merge": ("maps", "Add saved evidence, or take some of it away, exactly."),
    "models": ("lists", "List the sensor models that are installed."),
    "readers": ("lists", "List the log formats that can be read."),
    "render": ("maps", "Make a map of saved evidence, without reading the log."),
    "score": ("maps", "Say how good a map is, by recordings or by the truth."),
    "schema": ("lists", "Print the JSON Schema of what a command prints with --json."),
    "tune": ("logs", "Find the time offset and the mount that suit logs best."),
    "writers": ("lists", "List the map formats that can be written."),
}
"""The module of each, and the text of --help"""

NEW_OBJECTS = 100_000
"""Allocations between two garbage collections; at Python's 700 an import sets off many."""


class CommandTable(click.Group):
    """A group that knows its commands' names without importing them."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  click's signature
        """Every command, in the order of --help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import one command."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"occmap.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of the first word; a mistyped one is answered with what was meant."""
        word = args[0]
        if word not in COMMANDS and not word.startswith("-"):
            from occmap.plugins import suggest  # noqa: PLC0415  late: --help needs no plugins

            fix = suggest(word, list(COMMANDS), "occmap --help")
            if os.path.exists(word):  # noqa: PTH110  pathlib takes as long to import as all else here
                fix = f"to map a log: occmap build {word} -o map.pgm"
            raise UsageError(f"no command is called {word!r}", fix=fix)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands from the table."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=CommandTable,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done, 1 the log or the data failed, 2 wrong usage, 3 a limit not met.",
)
@click.version_option(package_name="occmap", message="%(prog)s %(version)s")
def cli() -> None:
    """2D occupancy grid maps from recorded laser scans with known poses.

    In one line: occmap build LOG -o map.pgm
    """


def run(args: Sequence[str], signals: "Signals | None" = None) -> int:
    """Run a command line and return its exit code; no error leaves this function."""
    signals = signals or Signals()
    console = Console(as_json="--json" in args)  # so that any error is JSON as well
    try:
        with (
            refuse_failures(),
            cli.make_context("occmap", list(args) or ["--help"], obj=console) as context,
        ):
            cli.invoke(context)
    except click.exceptions.Exit as done:
        return done.exit_code
    except BaseException as error:  # noqa: BLE001  whatever it is, the user gets one line
        # A library that a signal comes upon may raise an error of its own.
        if signals.number or isinstance(error, KeyboardInterrupt | click.Abort):
            interrupted = OccmapError("interrupted: nothing more is written")
            return console.fail(interrupted, signals.exit_code)
        if isinstance(error, BrokenPipeError):  # who reads the output has seen enough
            discard(sys.stdout)
            return 0
        known = describe_misuse(error) if isinstance(error, click.ClickException) else error
        if isinstance(known, OccmapError):
            return console.fail(known, known.exit_code)
        return console.fail_unexpectedly(error)
    return 0


def describe_misuse(error: click.ClickException) -> UsageError:
    """Say what click found, and where to read on."""
    found = " ".join(error.format_message().split()).removesuffix(".")
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is None:
        return UsageError(found)
    if isinstance(error, click.NoSuchOption):
        for name in COMMANDS:  # rather than what is spelled like it
            other = cli.get_command(context, name)
            if other and any(error.option_name in param.opts for param in other.params):
                here = f"`{context.command_path}` has no {error.option_name}"
                found = f"{here}, which is an option of `occmap {name}`"
                break
    help_lines = map(str.strip, (context.command.help or "").splitlines())
    examples = [line for line in help_lines if line.startswith(context.command_path)]
    if examples and isinstance(error, click.MissingParameter):
        return UsageError(found, fix=f"write, for example, {examples[0]}")
    return UsageError(found, fix=f"see `{context.command_path} --help`")


def main() -> None:
    """Run the command line of this process."""
    gc.set_threshold(NEW_OBJECTS)
    # Before NumPy is loaded, and unless the user says otherwise: starting threads for products of
    # matrices takes longer than all the small ones that there are.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a file name may hold what no encoding knows
            stream.reconfigure(errors="backslashreplace")
    if "_OCCMAP_COMPLETE" in os.environ:  # a shell asks for what a word may be completed to
        cli.main(prog_name="occmap")
    signals = Signals()
    signals.listen()
    code = None
    try:
        code = run(sys.argv[1:], signals)
        signals.ignore()
    except Interrupted:  # just when run had answered
        code = signals.exit_code if code is None else code
        signals.ignore()
    gc.freeze()  # or Python would look through all that is loaded once more before it ends
    sys.exit(code)


ENDING = [getattr(signal, it) for it in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, it)]
"""Windows has no SIGHUP."""
GRACE_S = 1.0
"""A terminal that closes may send two signals; the second must not break off the clearing up. As
often it is looked whether the first was heard."""


class Interrupted(KeyboardInterrupt):
    """A signal came.

    Not KeyboardInterrupt itself: once that has passed through exec(), Python ends the process by
    SIGINT, whatever its exit code was to be.
    """


class Signals:
    """Listens to signals, and remembers the first that came."""

    number: int | None = None
    """The first signal that came"""
    _raised_at = 0.0

    @property
    def exit_code(self) -> int:
        """128 plus the number of the signal, as in shells."""
        return 128 + (self.number or signal.SIGINT)

    def listen(self) -> None:
        """Raise Interrupted at each signal, unless the parent has it ignored (nohup)."""
        for number in ENDING:
            if signal.getsignal(number) in {signal.SIG_DFL, signal.default_int_handler}:
                signal.signal(number, self.receive)
        sys.unraisablehook = self.report_dropped

    def ignore(self) -> None:
        """Let no signal disturb the end of a process whose work is done."""
        self.insist_every(0)
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """Interrupt the main thread, once."""
        if self.number is None or monotonic() > self._raised_at + GRACE_S:
            self.number = self.number or number
            self._raised_at = monotonic()
            self.insist_every(GRACE_S)
            raise Interrupted

    def insist_every(self, seconds: float) -> None:
        """Insist again and again, until so many seconds are 0; Windows has no such timer."""
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, self.insist)
            signal.setitimer(signal.ITIMER_REAL, seconds, seconds)

    def insist(self, _number: int, _frame: FrameType | None) -> None:
        """Interrupt the main thread once more, unless it clears up already.

        What is raised in a destructor is dropped by Python, and by NumPy while it looks for an
        attribute: an enum in a comparison with an array is asked for some.
        """
        error = sys.exception()
        while error is not None and not isinstance(error, Interrupted):
            error = error.__context__
        if error is None:
            raise Interrupted

    def report_dropped(self, dropped: Any) -> None:
        """Report an error that Python drops, but for what comes of a signal."""
        if self.number is None:
            sys.__unraisablehook__(dropped)
