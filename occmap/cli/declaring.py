"""What a command is: options under headings, notes, a result as text or JSON, and limits.

What a team would type each time it may write into a file of options, which lies beside the logs or
is named by --config.
"""

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import wraps
from glob import has_magic
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import click

from occmap.cli import COMMANDS, cli
from occmap.cli.console import Console
from occmap.errors import OccmapError, UsageError
from occmap.plugins import suggest
from occmap.report import Printed
from occmap.report.limits import Failed, Limit, Measures, judge, parse_limit

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


NAME = "occmap.toml"
SOURCES = ("words", "logs")
"""The arguments whose folders are looked at."""
OTHER_COMMANDS = ("build", "compare")
"""Between them they have the options that a file beside logs may hold."""


class Config(NamedTuple):
    """The options of one command that a file states."""

    values: dict[str, Any]
    """By the names that click has for the options"""
    note: str
    """Says what is taken from it"""


def find_config(ctx: click.Context, typed: Mapping[str, Any]) -> Config | None:
    """Find and read the file of options that goes with a command line, if there is one.

    Raises
    ------
    UsageError
        It cannot be read, an option is unknown or its value wrong, or there is one in each of
        several folders.
    """
    if isinstance(named := typed.get("config"), str):
        return read_config(Path(named), ctx, typed)
    given = [each for name in SOURCES if isinstance(each := typed.get(name), tuple)]
    there = {beside: None for word in chain(*given) for beside in list_beside(Path(word))}
    if len(there) > 1:
        found = f"the logs have several files of options: {', '.join(map(str, there))}"
        raise UsageError(found, fix="name one with --config")
    return next((read_config(path, ctx, typed) for path in there), None)


def list_beside(log: Path) -> list[Path]:
    """List the file of options in a folder of logs, or else beside a log."""
    if not (log.exists() or has_magic(str(log))):
        return []
    return [path for path in (log / NAME, log.parent / NAME) if path.is_file()][:1]


def read_config(path: Path, ctx: click.Context, typed: Mapping[str, Any]) -> Config:
    """Read the options of a command from a file, but for those that are typed.

    Those of other commands are passed over.

    Raises
    ------
    UsageError
        It cannot be read, no command has such an option, or it does not take such a value.
    """
    tables = read_tables(path)
    own = list_options(ctx.command)
    refuse_unknown(path, [name for table in tables.values() for name in table], own)
    stated = tables[""] | tables.get(ctx.command.name or "", {})
    known = {name: value for name, value in stated.items() if name in own}
    taken = {name: value for name, value in known.items() if own[name].name not in typed}
    nothing = "all of it is typed, too" if known else "no option of this command"
    told = ", ".join(f"{name} = {json.dumps(value, default=str)}" for name, value in taken.items())
    values = {}
    for name, value in taken.items():
        try:
            values[str(own[name].name)] = convert(own[name], value, ctx)
        except (click.UsageError, UsageError) as error:
            found = error.found if isinstance(error, UsageError) else error.message
            fix = error.fix if isinstance(error, UsageError) else ""
            raise UsageError(found.rstrip("."), where=f"{path}: {name}", fix=fix) from None
    return Config(values, f"{path}: {told or nothing}")


def read_tables(path: Path) -> dict[str, dict[str, Any]]:
    """Read the options in a file: those of each command by its name, those of all commands by "".

    Raises
    ------
    UsageError
        It cannot be read, is not TOML, or has a table for what is no command.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        found = f"cannot be read ({error.strerror})"
        raise UsageError(found, where=path, fix="check the path of --config") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"is not TOML ({error})", where=path) from None
    tables = {name: value for name, value in values.items() if isinstance(value, dict)}
    for name in tables:
        if name not in COMMANDS:
            fix = suggest(name, list(COMMANDS), "occmap --help")
            raise UsageError(f"no command is called {name!r}", where=f"{path}: [{name}]", fix=fix)
    return {"": {name: value for name, value in values.items() if name not in tables}, **tables}


def list_options(command: click.Command | None) -> dict[str, click.Option]:
    """List the options of a command by their long names, without the dashes."""
    options = [each for each in command.params if isinstance(each, click.Option)] if command else []
    return {name[2:]: each for each in options for name in each.opts if name.startswith("--")}


def refuse_unknown(path: Path, names: Iterable[str], own: Iterable[str]) -> None:
    """Refuse a name that no command has for an option; raises UsageError with what was meant."""
    others = (cli.get_command(click.Context(cli), name) for name in OTHER_COMMANDS)
    known = {*own, *(name for command in others for name in list_options(command))} - {"config"}
    for name in names:
        if name not in known:
            close = get_close_matches(name.replace("_", "-"), known, n=1)
            fix = f"did you mean {close[0]!r}?" if close else "see `occmap build --help`"
            raise UsageError(f"no option is called {name!r}", where=path, fix=fix)


def convert(option: click.Option, value: Any, ctx: click.Context) -> Any:
    """Turn a value of a file of options into what is typed, and try whether the option takes it.

    Raises
    ------
    click.UsageError, UsageError
        It does not.
    """
    if option.is_flag:
        if not isinstance(value, bool):
            raise UsageError(f"is {value!r}", fix="write true or false")
        return value if option.is_bool_flag else option.flag_value if value else None
    several = as_list(value)
    if not option.multiple or (several and all(isinstance(each, int | float) for each in several)):
        several = [several]  # one sector, not many
    words = [",".join(map(str, as_list(each))) for each in several]
    if any("\0" in word for word in words):  # as on a command line, which nothing behind it expects
        raise UsageError("holds a null character", fix="take it out")
    typed = words if option.multiple else words[0]
    option.type_cast_value(ctx, typed)
    return typed


def as_list(value: Any) -> Any:
    """A list or tuple as it is, anything else as a list of one."""
    return value if isinstance(value, list | tuple) else [value]
