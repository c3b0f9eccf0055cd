"""Limits as options, and what becomes of them: one line on stderr each, and exit code 3."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

from occmap.cli.console import Console
from occmap.cli.sections import Command, option
from occmap.errors import OccmapError
from occmap.gates import Failed, Measures, judge, parse_limit
from occmap.plain import Printed

LIMITS = "Limits"
LIMIT_BROKEN = 3


@dataclass(frozen=True)
class Limited(Printed):
    """What a command adds to its result that takes limits."""

    failed: list[Failed]
    """The limits of `limits` that the result does not keep to; any of them makes the exit code 3"""


def fail_if(measures: Measures, example: str) -> Callable[[Command], Command]:
    """Declare the option that sets limits on what a command measures."""
    names = ", ".join(measure.name for measure in measures)
    return option(
        LIMITS,
        "--fail-if",
        "limits",
        type=lambda text: parse_limit(text, measures),
        multiple=True,
        metavar='"NAME > NUMBER"',
        help=f'Exit with 3 if this is true, such as "{example}"; < <= >= == != work, too. '
        f"May repeat. Names: {names}.",
    )


def answer(
    console: Console, result: Printed, lines: Iterable[str], values: Mapping[str, Any]
) -> list[Failed]:
    """Print a result as JSON or as text, and a line for each limit that it does not keep to."""
    failed = judge(values["limits"], result)
    if values["as_json"]:
        command = str(click.get_current_context().info_name)
        console.put_json(command, result.to_json() | Limited(failed).to_json())
    else:
        console.put(lines)
    for each in failed:
        console.fail(OccmapError(each.sentence), LIMIT_BROKEN)
    return failed


def leave(failed: Sequence[Failed]) -> None:
    """End the command where a limit is not kept; its result is printed and its files written."""
    if failed:
        raise click.exceptions.Exit(LIMIT_BROKEN)
