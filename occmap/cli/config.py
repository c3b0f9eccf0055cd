"""A file of options, beside the logs or named by --config: what a team would type each time."""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from glob import has_magic
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import click

from occmap.cli import COMMANDS
from occmap.cli.console import spell
from occmap.errors import UsageError
from occmap.plugins import suggest

NAME = "occmap.toml"
SOURCES = ("words", "logs")
"""The arguments whose folders are looked at."""
OTHER_COMMANDS = ("build", "compare")
"""Between them they have the options that a file beside logs may hold."""


class Config(NamedTuple):
    """The options of one command that a file states."""

    path: Path
    values: dict[str, Any]
    """By the names that click has for the options"""
    note: str
    """Says what is taken from it"""


def find_config(command: click.Command, typed: Mapping[str, Any]) -> Config | None:
    """Find and read the file of options that goes with a command line, if there is one.

    Raises
    ------
    UsageError
        It cannot be read, an option is unknown, or there is one in each of several folders.
    """
    if isinstance(named := typed.get("config"), str):
        return read_config(Path(named), command, typed)
    words = (typed.get(source) for source in SOURCES)  # no tuple where there are none
    sources = [Path(word) for some in words if isinstance(some, tuple) for word in some]
    there = dict.fromkeys(beside for source in sources for beside in list_beside(source))
    if len(there) > 1:
        found = f"the logs have several files of options: {', '.join(map(str, there))}"
        raise UsageError(found, fix="name one with --config")
    return next((read_config(path, command, typed) for path in there), None)


def place_error(config: Config, command: click.Command, error: UsageError) -> UsageError:
    """Say that an error lies in a file of options, where it is about one that is taken from there.

    It names the option, or the place that the file gives for it, such as an output.
    """
    text = spell(str(error))
    taken = [param for param in command.params if param.name in config.values]
    names_one = any(re.search(rf"{flag}(?![\w-])", text) for param in taken for flag in param.opts)
    values: list[Any] = []
    for value in config.values.values():
        values += value if isinstance(value, list) else [value]
    if not names_one and error.where not in map(str, values):
        return error
    where = f"{config.path}: {error.where}" if error.where else config.path
    return UsageError(error.found, where=where, fix=error.fix)


def list_beside(log: Path) -> list[Path]:
    """List the file of options in a folder of logs, or else beside a log."""
    if not (log.exists() or has_magic(str(log))):
        return []
    return [path for path in (log / NAME, log.parent / NAME) if path.is_file()][:1]


def read_config(path: Path, command: click.Command, typed: Mapping[str, Any]) -> Config:
    """Read the options of a command from a file, but for those that are typed.

    Those of other commands are passed over.

    Raises
    ------
    UsageError
        It cannot be read, or no command has such an option.
    """
    tables = read_tables(path)
    own = list_options(command)
    refuse_unknown(path, [name for table in tables.values() for name in table], own)
    stated = tables[""] | tables.get(command.name or "", {})
    known = {name: value for name, value in stated.items() if name in own}
    taken = {name: value for name, value in known.items() if own[name].name not in typed}
    nothing = "all of it is typed, too" if known else "no option of this command"
    told = ", ".join(f"{name} = {json.dumps(value, default=str)}" for name, value in taken.items())
    if "\\u0000" in told:  # no command line can hold one, so that nothing behind it expects one
        raise UsageError("a value holds a null character", where=path, fix="take it out")
    by_option = {
        str(own[name].name): convert(path, own[name], value) for name, value in taken.items()
    }
    return Config(path, by_option, f"{path}: {told or nothing}")


def read_tables(path: Path) -> dict[str, dict[str, Any]]:
    """Read the options in a file: those of each command by its name, those of all commands by "".

    Raises
    ------
    UsageError
        It cannot be read, is not TOML, or has a table for what is no command.
    """
    try:
        with path.open("rb") as file:
            values = tomllib.load(file)
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


def list_options(command: click.Command) -> dict[str, click.Option]:
    """List the options of a command by their long names, without the dashes."""
    options = [each for each in command.params if isinstance(each, click.Option)]
    return {name[2:]: each for each in options for name in each.opts if name.startswith("--")}


def refuse_unknown(path: Path, values: Iterable[str], own: Mapping[str, click.Option]) -> None:
    """Refuse a name that no command has for an option.

    Raises
    ------
    UsageError
        Naming the first, and what it was probably meant to be.
    """
    others = (import_module(f"occmap.cli.commands.{name}").command for name in OTHER_COMMANDS)
    known = {*own, *(name for command in others for name in list_options(command))} - {"config"}
    for name in values:
        if name not in known:
            close = get_close_matches(name.replace("_", "-"), known, n=1)
            fix = f"did you mean {close[0]!r}?" if close else "see `occmap build --help`"
            raise UsageError(f"no option is called {name!r}", where=path, fix=fix)


def convert(path: Path, option: click.Option, value: Any) -> Any:
    """Turn a value of a file of options into what is typed.

    Raises
    ------
    UsageError
        A flag is neither true nor false.
    """
    if option.is_flag and not isinstance(value, bool):
        found = f"{option.opts[-1]} is {value!r}"
        raise UsageError(found, where=path, fix="write true or false")
    if option.is_bool_flag:
        return value
    if option.is_flag:
        return option.flag_value if value else None
    if not option.multiple:
        return write(value)
    several = value if isinstance(value, list) else [value]
    if several and all(isinstance(each, int | float) for each in several):  # one sector, not many
        return [write(several)]
    return [write(each) for each in several]


def write(value: Any) -> str:
    """Write a value as it is typed, a list with commas."""
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
