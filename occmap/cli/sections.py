"""Options under headings: what makes the --help of a command with many options readable."""

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any, TypeVar

import click

from occmap.cli import COMMANDS
from occmap.cli.console import Console
from occmap.errors import UsageError
from occmap.report.printed import Printed

SHORT_EQUALS = re.compile("-[a-z]=")
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
            if word in self.opts and following != self.bare and not is_number(following):
                filled.append(self.bare)
        return filled


class ConfigOption(SectionOption):
    """The option that names a file of options; what the file states are the defaults of others."""

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """Find and read the file, named or not; from then on errors name it.

        Raises
        ------
        UsageError
            The file is wrong.
        """
        from occmap.cli.config import find_config, place_error  # noqa: PLC0415  late: for few commands

        config = None if ctx.resilient_parsing else find_config(ctx.command, opts)
        if config:
            ctx.default_map = config.values
            console = ctx.ensure_object(Console)
            console.place = partial(place_error, config, ctx.command)
            console.announced.append(config.note)
        return super().handle_parse_result(ctx, opts, args)


class SectionCommand(click.Command):
    """A command whose --help lists its options by section, in the order of their declaration."""

    last = "Run"
    """Where --help itself is listed."""
    printed: type[Printed]
    """What it prints with --json"""

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
            title = param.section if isinstance(param, SectionOption) else self.last
            if record is not None and isinstance(param, click.Option):
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


def is_number(word: str) -> bool:
    """Whether a word of a command line is a decimal number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def join(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Make one decorator of several, which are then listed in this order."""

    def decorate(command: Command) -> Command:
        for each in reversed(options):
            command = each(command)
        return command

    return decorate
