"""What a command is: options under headings, notes, a result as text or JSON, and limits.

What a team would type each time it may write into a file of options, which lies beside the logs or
is named by --config.
"""

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from glob import has_magic
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import click

from occmap import choices
from occmap.cli import COMMANDS
from occmap.cli.console import Console
from occmap.errors import OccmapError, UsageError, refuse_unreadable
from occmap.options import FLAGS, OPTIONS, RUN
from occmap.plugins import guess, suggest
from occmap.posing import PosingOptions
from occmap.report import Printed
from occmap.report.limits import Failed, Limit, Measures, parse_bound, parse_limit
from occmap.types import Update

LIMIT_BROKEN = 3
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|nan)")
ALL = "occmap.all_options"
"""Set in the context where help lists all options"""


class Value(click.ParamType):  # type: ignore[type-arg]  # in older versions it takes none
    """A value that is read as in a notebook."""

    name = "value"

    def __init__(self, known: choices.Option) -> None:
        self.known = known

    @classmethod
    def of(cls, kind: Any, name: str = "", form: choices.Form | None = None) -> "Value":
        """Make one of a type; without a name, errors have that of the parameter."""
        return cls(choices.Option.of(name, kind, form))

    def convert(self, value: Any, param: click.Parameter | None, _: click.Context | None) -> Any:
        """Read what was typed, or what a file of options states; raises UsageError."""
        if isinstance(value, str) and NUMBER.fullmatch(value[1:]):  # see `Command.parse_args`
            value = value.removeprefix(" ")
        if self.known.name or param is None:
            return self.known.read_one(value)
        label = param.opts[-1] if isinstance(param, click.Option) else param.human_readable_name
        return replace(self.known, name=label.strip("[].")).read_one(value)


PATH, TEXT = Value.of(Path), Value.of(str)


class CliOption(click.Option):
    """An option that stands under a heading of --help."""

    def __init__(self, section: str, *names: str, **settings: Any) -> None:
        super().__init__(names, **settings)
        self.section = section


class Command(click.Command):
    """A command whose --help lists its options by section, as they are declared; "Run" is last."""

    printed: Sequence[type[Printed]]
    """What it prints with --json: the fields of these types, one after the other"""
    usual: frozenset[str] = frozenset()
    """The options that --help lists, where it leaves the others to --help-all; none: all"""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Fill in the number that --align may lack.

        click has options without a value, too, but they take a log that follows for the number, and
        refuse a negative one. A negative number gets a space before it: no option begins with one.
        """
        flag, bare, words = OPTIONS["align"].flag, OPTIONS["align"].none[0], list[str]()
        for word, following in zip_longest(args, args[1:], fillvalue=""):
            if word == "--":  # what follows is no option
                return super().parse_args(ctx, words + args[args.index("--") :])
            is_negative = word.startswith("-") and NUMBER.fullmatch(word)
            words.append(f" {word}" if is_negative else word)
            if word == flag and following != bare and not NUMBER.fullmatch(following):
                words.append(bare)
        return super().parse_args(ctx, words)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one list for each section; click's own --help is among those of the run."""
        sections: dict[str, list[tuple[str, str]]] = {}
        is_short = self.usual and ALL not in ctx.meta
        for param in self.get_params(ctx):
            section = param.section if isinstance(param, CliOption) else RUN
            is_left_out = is_short and isinstance(param, CliOption) and param.name not in self.usual
            record = param.get_help_record(ctx)
            if record and isinstance(param, click.Option) and not is_left_out:
                sections.setdefault(section, []).append(record)
        sections[RUN] = sections.pop(RUN)
        for title, records in sections.items():
            with formatter.section(title):
                formatter.write_dl(records)


def show_all(ctx: click.Context, _param: click.Parameter, is_wanted: bool) -> None:
    """Print the help with all options, and end the command."""
    if is_wanted:
        ctx.meta[ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def tell_console(ctx: click.Context, param: click.Parameter, is_wanted: bool) -> None:
    """Let the console know how it is to talk."""
    setattr(ctx.ensure_object(Console), str(param.name), is_wanted)


def flag(section: str, *names: str, text: str, **settings: Any) -> CliOption:
    """Declare an option that takes no value."""
    return CliOption(section, *names, is_flag=True, help=text, **settings)


TOLD: dict[str, Any] = {"expose_value": False, "callback": tell_console}
QUIET = flag(RUN, "-q", "--quiet", text="Print errors only, and what --json asks for.", **TOLD)
VERBOSE = flag(RUN, "-v", "--verbose", text="Print the traceback of a fault in occmap.", **TOLD)
JSON = flag(RUN, "--json", "as_json", text="Print the result as JSON.", **TOLD)
WHOLE: dict[str, Any] = {"expose_value": False, "callback": show_all, "is_eager": True}
HELP_ALL = flag(RUN, "--help-all", text="Show all options and exit.", **WHOLE)


class Answer(NamedTuple):
    """What a command found."""

    result: Printed
    """What --json prints"""
    lines: Iterable[str]
    """The same for people"""
    failure: Exception | None = None
    """What ends the command with an exit code of its own, once all is printed"""


@dataclass(frozen=True)
class Limited(Printed):
    """What a command adds to its result that takes limits."""

    failed: list[Failed]
    """The limits of `limits` that the result does not keep to; any of them makes the exit code 3"""


def fail_if(measures: Measures, example: str, *others: str) -> CliOption:
    """Declare the option that sets limits on what a command measures.

    Parameters
    ----------
    others
        Flags that are followed by the number alone, above which the first measure fails.
    """

    def read(text: str) -> Limit:
        if others and not re.search("[<>=]", text):
            bound = parse_bound(text.strip(), measures[0], f"{others[0]} {text}")
            return Limit(measures[0], ">", bound, others[0])
        return parse_limit(text, measures)

    text = f'Exit with 3 if this is true, such as "{example}"; < <= >= == != work, too. May repeat.'
    text += "".join(f" {each} SHARE is short for {measures[0].name} > SHARE." for each in others)
    form = choices.Form(read, f'a limit such as "{example}"')
    return CliOption(
        "Limits",
        *("--fail-if", *others, "limits"),
        type=Value.of(Limit, "limits", form),
        multiple=True,
        metavar='"NAME > NUMBER"',
        help=f"{text} Names: {', '.join(measure.name for measure in measures)}.",
    )


def command(
    name: str, printed: type[Printed], *params: click.Parameter, usual: Iterable[str] = ()
) -> Callable[[Callable[..., Answer]], Command]:
    """Declare a command by a function that takes the console and the options, and answers.

    Its --help begins with the docstring of the function. Its notes are told, then its result is
    printed, and then a line for each limit that it does not keep to, which makes the exit code 3
    where nothing weighs more.

    Parameters
    ----------
    printed
        The type of the result.
    params
        Its arguments and options, but for those of all commands: how much is told, and --json.
    usual
        The options that --help lists, where these are not all.
    """

    def decorate(function: Callable[..., Answer]) -> Command:
        @click.pass_obj
        def run(console: Console, /, **values: Any) -> None:
            console.note(*console.announced)  # what the file of options states
            limits = values.pop("limits", None)  # None: the command takes no limits
            tell(console, name, function(console, **values), limits)

        text = describe(function) or COMMANDS[name][1]
        own = [*params, JSON, QUIET, VERBOSE, *([HELP_ALL] if usual else [])]
        made = Command(name, params=own, callback=run, help=text)
        has_limits = any(param.name == "limits" for param in params)
        made.printed = [printed, Limited] if has_limits else [printed]
        made.usual = frozenset([*usual, "help_all"] if usual else ())
        return made

    return decorate


def tell(console: Console, name: str, answer: Answer, limits: Sequence[Limit] | None) -> None:
    """Tell notes, print the result, and say which limits it does not keep to."""
    console.clear()
    result: Any = answer.result
    failed = [it for limit in limits or () if (it := limit.find_failure(result))]
    if hasattr(result, "notes"):
        console.note(*(each for each in result.notes if each not in console.announced))
        result = replace(result, notes=tuple(dict.fromkeys([*console.announced, *result.notes])))
    if console.as_json:
        added = {} if limits is None else Limited(failed).to_json()
        console.put_json(name, result.to_json() | added)
    else:
        console.put(answer.lines)
    for each in failed:
        console.fail(OccmapError(each.sentence), LIMIT_BROKEN)
    if answer.failure:
        raise answer.failure
    if failed:
        raise click.exceptions.Exit(LIMIT_BROKEN)


def describe(function: Callable[..., Any]) -> str:
    """Take the help of a command from a docstring, of which indented lines stay as they are."""
    return inspect.cleandoc(function.__doc__ or "").replace("\n\n  ", "\n\n\b\n  ")


NAME = "occmap.toml"
BESIDE = frozenset({"edits", "ground", "poses"})
"""Options that may name a file beside the file of options: it is looked for there first"""


class ConfigOption(CliOption):
    """The option that names a file of options; what the file states are the defaults of others."""

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """Read the file of options that goes with the command line, if there is one.

        Those that are typed go before it, and those of other commands are passed over.

        Raises
        ------
        UsageError
            It cannot be read, no command has such an option, or it does not take such a value.
        """
        path = None if ctx.resilient_parsing else find_config(opts)
        if path is not None:
            options = [each for each in ctx.command.params if isinstance(each, click.Option)]
            flags = {flag: each for each in options if each.expose_value for flag in each.opts}
            own = {flag[2:]: each for flag, each in flags.items() if flag.startswith("--")}
            known = read_config(path, ctx.command.name or "", own)
            taken = {it: known[it] for it in known if it in own and own[it].name not in opts}
            for name in BESIDE.intersection(taken):
                beside = str(path.parent / str(taken[name]))
                # A topic in it may follow, as of poses.
                if taken[name] and PosingOptions(poses=beside).files:
                    taken[name] = beside
            ctx.default_map = {
                str(own[name].name): convert(path, own[name], value, ctx)
                for name, value in taken.items()
            }
            write = json.JSONEncoder(ensure_ascii=False, default=str).encode
            told = [f"{name} = {write(value)}" for name, value in taken.items()]
            told = told or ["nothing in it is for this command, or all is typed, too"]
            ctx.ensure_object(Console).announced.append(f"{path}: {', '.join(told)}")
        return super().handle_parse_result(ctx, opts, args)


CONFIG = ConfigOption(
    RUN,
    "--config",
    is_eager=True,  # before the options that it sets
    type=PATH,
    metavar="FILE",
    expose_value=False,
    help="Read options from this TOML file, by their long names; typed ones win. Without it: "
    "occmap.toml beside the logs.",
)


def find_config(typed: Mapping[str, Any]) -> Path | None:
    """Find the file that --config names, or the one in a folder of logs, or else beside a log.

    Raises
    ------
    UsageError
        There is one in each of several folders, or one beside some of the logs only.
    """
    if isinstance(named := typed.get("config"), str):
        return Path(named)
    # The logs of arguments come as a tuple, those of an option as a list.
    several = (tuple, list)
    given = [each for name in ("words", "logs") if isinstance(each := typed.get(name), several)]
    words = [word for word in chain(*given) if word not in list(Update)]  # it may be a folder, too
    logs = [log for log in map(Path, words) if log.exists() or has_magic(str(log))]
    beside = [[path for path in (log / NAME, log.parent / NAME) if path.is_file()] for log in logs]
    found = list(dict.fromkeys(next(iter(paths), None) for paths in beside))
    if len(found) > 1:
        files = ", ".join(str(path or "none") for path in found)
        differ = f"the logs do not have one file of options beside them all: {files}"
        raise UsageError(differ, fix="name the one that is for all of them with --config")
    return next(iter(found), None)


def read_config(path: Path, command: str, own: Iterable[str]) -> dict[str, Any]:
    """Read the options of its own table, and of none, in a file; some may be of other commands.

    Raises
    ------
    UsageError
        It cannot be read, is not TOML, or names what is no command or no option of any.
    """
    try:
        with refuse_unreadable(path, UsageError, "check the path of --config"):
            values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"is not TOML ({error})", where=path) from None
    tables = {name: value for name, value in values.items() if isinstance(value, dict)}
    for name in tables.keys() - COMMANDS.keys():
        fix = suggest(name, list(COMMANDS), "occmap --help")
        raise UsageError(f"no command is called {name!r}", where=f"{path}: [{name}]", fix=fix)
    common = {name: value for name, value in values.items() if name not in tables}
    known = {*own, *(flag[2:] for flag in FLAGS.values())}
    for name in chain(common, *tables.values()):
        if name not in known:
            fix = guess(name.replace("_", "-"), known) or "see `occmap build --help`"
            raise UsageError(f"no option is called {name!r}", where=path, fix=fix)
    return common | tables.get(command, {})


def convert(path: Path, option: click.Option, value: Any, ctx: click.Context) -> Any:
    """Check a value of a file of options, and give it as the option takes it; raises UsageError."""
    if option.is_flag:
        if not isinstance(value, bool):
            place = f"{path}: {option.opts[-1]}"
            raise UsageError(f"is {value!r}", where=place, fix="write true or false")
        return option.flag_value if value else option.get_default(ctx)
    # Several numbers are one sector, not many.
    is_list = isinstance(value, list) and not isinstance(next(iter(value), None), int | float)
    given = [value] if option.multiple and not is_list else value
    try:
        option.type_cast_value(ctx, given)
    except UsageError as error:
        where = f"{path}: {error.where}".removesuffix(": ")
        raise UsageError(error.found, where=where, fix=error.fix) from None
    return given
