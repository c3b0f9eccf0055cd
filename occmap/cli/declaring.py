"""What a command is: options under headings, notes, a result as text or JSON, and limits."""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import zip_longest
from typing import Any, NamedTuple, TypeVar

import click

from occmap.cli import COMMANDS
from occmap.cli.console import Console
from occmap.errors import OccmapError, UsageError
from occmap.report.limits import Failed, Limit, Measures, judge, parse_limit
from occmap.report.printed import Printed

SHORT_EQUALS = re.compile("-[a-z]=")
LIMITS = "Limits"
LIMIT_BROKEN = 3
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|nan)")
AnyCommand = TypeVar("AnyCommand", bound=click.Command)
Command = TypeVar("Command", bound=Callable[..., Any])


class SectionOption(click.Option):
    """An option that knows its heading."""

    def __init__(self, *args: Any, section: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.section = section


class BareOption(SectionOption):
    """An option whose number may be left out, as in `--align`; the word `bare` then stands for it.

    click has such options, too, but they take a log that follows for the number, and refuse a
    negative one.
    """

    def __init__(self, *args: Any, bare: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.bare = bare

    def fill_in(self, words: Sequence[str]) -> list[str]:
        """Put the word where neither a number nor the word itself follows."""
        filled = []
        for word, following in zip_longest(words, words[1:], fillvalue=""):
            filled.append(word)
            if word in self.opts and following != self.bare and not NUMBER.fullmatch(following):
                filled.append(self.bare)
        return filled


class ConfigOption(SectionOption):
    """The option that names a file of options; what the file states are the defaults of others."""

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """Find and read the file, named or not.

        Raises
        ------
        UsageError
            The file is wrong.
        """
        from occmap.cli.config import find_config  # noqa: PLC0415  late: for few commands

        config = None if ctx.resilient_parsing else find_config(ctx, opts)
        if config:
            ctx.default_map = config.values
            ctx.ensure_object(Console).announced.append(config.note)
        return super().handle_parse_result(ctx, opts, args)


ALL = "occmap.all_options"
"""Set in the context where help lists all options"""


def show_all(ctx: click.Context, _param: click.Parameter, is_wanted: bool) -> None:
    """Print the help with all options, and end the command."""
    if is_wanted:
        ctx.meta[ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


class SectionCommand(click.Command):
    """A command whose --help lists its options by section, in the order of their declaration."""

    last = "Run"
    """Where --help itself is listed."""
    printed: type[Printed]
    """What it prints with --json"""
    usual: frozenset[str] = frozenset()
    """The options that --help lists, where it leaves the others to --help-all; none: all"""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Add --help-all where --help does not list all options."""
        params = super().get_params(ctx)
        if self.usual:
            settings: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False}
            text = "Show all options and exit."
            params.append(click.Option(["--help-all"], callback=show_all, help=text, **settings))
        return params

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Fill in what may be left out; raises UsageError for `-o=map.pgm`."""
        for word in args:
            if SHORT_EQUALS.match(word):  # it would be a file called `=map.pgm`
                fix = f"write {word[:2]} {word[3:]}"
                raise UsageError("a short option takes no =", where=word, fix=fix)
        for param in self.get_params(ctx):
            if isinstance(param, BareOption):
                args = param.fill_in(args)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one list for each section."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            is_known = isinstance(param, SectionOption)
            title = param.section if isinstance(param, SectionOption) else self.last
            is_left_out = self.usual and is_known and param.name not in self.usual
            if record is not None and isinstance(param, click.Option):
                if is_left_out and ALL not in ctx.meta:
                    continue
                sections.setdefault(title, []).append(record)
        for title, records in sections.items():
            with formatter.section(title):
                formatter.write_dl(records)


def as_command(name: str, cls: type[AnyCommand]) -> Callable[[Callable[..., None]], AnyCommand]:
    """Declare a command whose --help begins with its docstring; indented lines stay as they are."""

    def decorate(function: Callable[..., None]) -> AnyCommand:
        text = inspect.cleandoc(function.__doc__ or COMMANDS[name]).replace("\n\n  ", "\n\n\b\n  ")
        return click.command(name, cls=cls, help=text, short_help=COMMANDS[name])(function)

    return decorate


def option(section: str, *names: str, **settings: Any) -> Callable[[Command], Command]:
    """Declare an option under a heading."""
    return click.option(*names, **{"cls": SectionOption} | settings, section=section)


def join(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Make one decorator of several, which are then listed in this order."""

    def decorate(command: Command) -> Command:
        for each in reversed(options):
            command = each(command)
        return command

    return decorate


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
    name: str,
    printed: type[Printed],
    cls: type[SectionCommand] = SectionCommand,
    usual: Iterable[str] = (),
) -> Callable[[Callable[..., Answer]], SectionCommand]:
    """Declare a command by a function that takes the console and the options, and answers.

    Its notes are told, then its result is printed, and then a line for each limit that it does not
    keep to, which makes the exit code 3 where nothing weighs more.

    Parameters
    ----------
    printed
        The type of the result.
    usual
        The options that --help lists, where these are not all.
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
        made.printed, made.usual = printed, frozenset(usual)
        return made

    return decorate
