"""Whole processes: how long they take, and how much memory at most."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from occmap.types import Update

LAUNCHER = Path(__file__).with_name("launcher.py")
OCCMAP = Path(sys.executable).with_name("occmap")
NO_BYTE_CODE = "PYTHONDONTWRITEBYTECODE"


Command = Sequence[str | Path]


class ProcessError(Exception):
    """A measured command failed."""


class Usage(NamedTuple):
    """What a process needed."""

    seconds: float
    processor_seconds: float
    """Of all its threads"""
    peak_bytes: int
    output: str


def run(command: Command) -> Usage:
    """Run a command to its end.

    Raises
    ------
    ProcessError
        It failed; with the end of what it said.
    """
    launch = [sys.executable, "-I", "-S", str(LAUNCHER), *map(str, command)]
    # What is installed has its byte code: a checkout must be allowed to keep it from run to run.
    settings = {name: os.environ[name] for name in os.environ if name != NO_BYTE_CODE}
    done = subprocess.run(launch, capture_output=True, text=True, check=False, env=settings)
    head, _, output = done.stdout.partition("\n")
    usage: dict[str, Any] = json.loads(head) if head else {"code": done.returncode}
    if usage["code"] != 0:
        raise ProcessError(f"{' '.join(map(str, command))}: {(done.stderr or output)[-500:]}")
    return Usage(usage["seconds"], usage["processor_seconds"], usage["peak_bytes"], output)


def build_command(update: Update, log: Path, output: Path, *options: str) -> Command:
    """The occmap command that builds a map, with its report as JSON."""
    return [OCCMAP, "build", update.value, log, "-o", output, "--json", *options]


def measure_size(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
