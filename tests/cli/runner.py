"""Runs a command line in this process and catches what it prints."""

import io
from contextlib import redirect_stderr, redirect_stdout
from typing import Any, NamedTuple

import click

from occmap.cli import cli, run


class Result(NamedTuple):
    code: int
    out: str
    err: str


def find_command(name: str) -> click.Command:
    """Import a command, as its first word does."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return command


def occmap(*words: Any) -> Result:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run([str(word) for word in words])
    return Result(code, out.getvalue(), err.getvalue())


def read_error(result: Result, code: int) -> str:
    """Return the error: one line on stderr, and nothing else anywhere."""
    assert (result.code, result.out) == (code, "")
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
