"""A file of options, beside the logs or named by --config: what a team would type each time."""

import json
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from glob import has_magic
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import click

from occmap.cli import COMMANDS, cli
from occmap.errors import UsageError
from occmap.plugins import suggest

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
