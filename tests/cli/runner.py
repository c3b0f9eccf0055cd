"""Runs a command line, in this process or in one of its own, and catches what it prints."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, NamedTuple

import click

from occmap.cli import cli, run


class Result(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What was printed with --json."""
        return json.loads(self.out)


def find_command(name: str) -> click.Command:
    """Import a command, as its first word does."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return command


def occmap(*words: Any) -> Result:
    """Run a command line, which is given whole or word by word."""
    line = str(words[0]).split() if len(words) == 1 else [str(word) for word in words]
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(line)
    return Result(code, out.getvalue(), err.getvalue())


def ask(*words: Any) -> Any:
    """Return what a command that succeeds prints with --json."""
    result = occmap(*words, "--json") if len(words) > 1 else occmap(f"{words[0]} --json")
    assert result.code == 0, result.err
    return result.json


def spawn(*words: Any, **settings: Any) -> subprocess.CompletedProcess[Any]:
    """Run a command line in a process of its own; settings are those of `subprocess.run`."""
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "timeout": 120}
    line = [sys.executable, "-m", "occmap", *map(str, words)]
    return subprocess.run(line, check=False, **usual | settings)


def read_error(result: Result, code: int) -> str:
    """Return the error: one line on stderr, and nothing else anywhere."""
    assert (result.code, result.out) == (code, "")
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
