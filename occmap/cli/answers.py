"""What commands answer: printed as text or as JSON, and held against the limits that are set."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, NamedTuple

import click

from occmap.cli.console import Console
from occmap.cli.sections import Command, SectionCommand, as_command, option
from occmap.errors import OccmapError
from occmap.report.limits import Failed, Limit, Measures, judge, parse_limit
from occmap.report.printed import Printed

LIMITS = "Limits"
LIMIT_BROKEN = 3


class Answer(NamedTuple):
    """What a command found."""

    result: Printed
    """What --json prints"""
    lines: Iterable[str]
    """The same for people"""
    failure: Exception | None = None
    """What ends the command with an exit code of its own, once all is printed"""
    limits: Sequence[Limit] = ()
    """Those that are set beside --fail-if"""


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


def answering(
    name: str, printed: type[Printed], cls: type[SectionCommand] = SectionCommand
) -> Callable[[Callable[..., Answer]], SectionCommand]:
    """Declare a command by a function that takes the console and the options, and answers.

    Its notes are told, then its result is printed, and then a line for each limit that it does not
    keep to, which makes the exit code 3 where nothing weighs more.

    Parameters
    ----------
    printed
        The type of the result.
    """

    def decorate(function: Callable[..., Answer]) -> SectionCommand:
        @click.pass_obj
        @wraps(function)
        def run(console: Console, /, as_json: bool, **values: Any) -> None:
            console.note(*console.announced)  # what the file of options states
            limits = values.pop("limits", None)  # None: the command takes no limits
            answer = function(console, **values)
            failed = judge([*answer.limits, *(limits or ())], answer.result)
            console.note(*getattr(answer.result, "notes", ()))
            if as_json:
                added = {} if limits is None else Limited(failed).to_json()
                console.put_json(name, answer.result.to_json() | added)
            else:
                console.put(answer.lines)
            for each in failed:
                console.fail(OccmapError(each.sentence), LIMIT_BROKEN)
            if answer.failure:
                raise answer.failure
            if failed:
                raise click.exceptions.Exit(LIMIT_BROKEN)

        made = as_command(name, cls)(run)
        made.printed = printed
        return made

    return decorate
