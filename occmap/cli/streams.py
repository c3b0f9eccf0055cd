"""Where a command reads and writes: folders, patterns, stdin and stdout beside plain paths."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from occmap.cli.console import Console
from occmap.errors import UsageError
from occmap.options import BuildOptions, name_map
from occmap.report.results import Report
from occmap.scans.logs import find_inputs, keep_stdin
from occmap.writers import FolderWriter
from occmap.writers.outputs import find_writer

STDOUT = "-"
SCRATCH = "occmap-stdout-"


def gather_logs(
    console: Console, paths: Sequence[Path], options: BuildOptions, outputs: Sequence[Path] = ()
) -> list[Path]:
    """Find the recordings that the user means, and say what a folder holds of them.

    Raises
    ------
    LogError
        Nothing comes on stdin.
    """
    given = click.get_current_context().with_resource(keep_stdin(paths))
    others = [*outputs, Path(options.posing.poses or "")]
    found = find_inputs(given, options.reading, others)
    console.announce(*found.notes)
    return found.logs


def place_outputs(console: Console, outputs: Sequence[Path], first: Path) -> tuple[Path, ...]:
    """Name the maps that are to lie in a folder; what is meant for stdout goes to a file first.

    Parameters
    ----------
    first
        The first input, after which a map in a folder is called.
    """
    placed = tuple(
        path / f"{name_map(str(first))}.pgm" if os.path.isdir(path) and not path.suffix else path  # noqa: PTH112  a name may be too long
        for path in outputs
    )
    if all(path.stem != STDOUT for path in placed):
        return placed
    return click.get_current_context().with_resource(send_to_stdout(console, placed))


def hide_sent(report: Report) -> Report:
    """Leave out of a report the file that is sent to stdout."""
    files = [file for file in report.files if not Path(file).parent.name.startswith(SCRATCH)]
    return replace(report, files=tuple(files))


@contextmanager
def send_to_stdout(console: Console, outputs: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Write an output to a file while the command runs, and then to stdout.

    Raises
    ------
    UsageError
        More is meant for stdout than one file, or a format that is a folder.
    """
    name, *others = (path for path in outputs if path.stem == STDOUT)
    if others or console.as_json:
        raise UsageError("stdout takes one map and nothing else", fix="give another name to -o")
    file_name = name.with_suffix(name.suffix or ".pgm")
    if isinstance(find_writer(file_name), FolderWriter):
        found = f"a {name.suffix} is a folder, which stdout cannot take"
        raise UsageError(found, where=name, fix=f"name the folder, such as -o map{name.suffix}")
    console.stdout_is_taken = True
    with tempfile.TemporaryDirectory(prefix=SCRATCH) as folder:
        saved = Path(folder) / f"stdout{file_name.suffix}"
        yield tuple(saved if path == name else path for path in outputs)
        if saved.exists():
            with saved.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()
