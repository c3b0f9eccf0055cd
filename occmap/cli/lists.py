"""What programs and people may look up: what is installed, and the schemas of JSON results."""

import inspect
import json
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from enum import EnumType
from functools import reduce
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import click

from occmap.cli import COMMANDS, cli
from occmap.cli.console import RESULT_VERSION, Console, PrintedError, put_on_stdout, spell
from occmap.cli.declaring import QUIET, VERBOSE, Answer, Command, command, describe
from occmap.plugins import Broken, Group, load_plugins
from occmap.report import Printed, list_printed, printed_as, read_texts


@dataclass(frozen=True)
class Listed:
    """One plugin that works."""

    name: str
    """Its name"""
    description: str
    """What it does"""
    parameters: dict[str, float | str | None]
    """Those of a sensor model with their defaults; empty for readers and writers"""


def make_command(kind: str, group: Group) -> click.Command:
    """Make the command that lists the plugins of a kind."""

    @dataclass(frozen=True)
    class Plugins(Printed):
        """What is installed."""

        working: list[Listed] = field(metadata=printed_as(kind))
        """Plugins that can be used, those of occmap itself, too"""
        broken: list[Broken]
        """Plugins that do not load"""

    @command(kind, Plugins)
    def list_plugins(_console: Console, /) -> Answer:
        loaded, broken = load_plugins(group)
        working = []
        for name, plugin in loaded.items():
            parameters: Any = fields(plugin) if kind == "models" else ()
            defaults = {each.name: each.default for each in parameters}
            working.append(Listed(name, plugin.description, defaults))
        return Answer(Plugins(working, broken), format_plugins(working, broken))

    return list_plugins


models_command = make_command("models", "occmap.models")
readers_command = make_command("readers", "occmap.readers")
writers_command = make_command("writers", "occmap.writers")


def format_plugins(working: Sequence[Listed], broken: Sequence[Broken]) -> Iterator[str]:
    """Write one line for each plugin, with its parameters below; last what does not load."""
    width = max((len(plugin.name) for plugin in working), default=0) + 2
    for plugin in working:
        yield f"{plugin.name:<{width}}{plugin.description}"
        if plugin.parameters:
            pairs = (f"{key}={value}" for key, value in plugin.parameters.items())
            yield f"{'':<{width}}{', '.join(pairs)}"
    for fault in broken:
        yield f"{fault.name} is installed but does not load: {' '.join(fault.reason.split())}"


Schema = dict[str, Any]

TYPES = {str: "string", bool: "boolean", int: "integer", float: "number", NoneType: "null"}
PLAIN: dict[Any, Schema] = {Any: {}} | {kind: {"type": name} for kind, name in TYPES.items()}

NAMES = [*(name for name in COMMANDS if name != "schema"), "error"]
"""Commands that print JSON; `error` is what any of them prints where it fails."""


def print_schema(name: str) -> None:
    """Print the JSON Schema of what a command prints with --json.

    It is of JSON Schema draft 2020-12; every field has a description with its unit. The field
    "schema" of a result names the command and the version of its schema. A command that fails
    before it has a result prints an `error`.

      occmap schema build
      occmap schema error
    """
    made: Any = cli.get_command(click.get_current_context(), name)
    kinds = made.printed if made else [PrintedError]
    put_on_stdout(spell(json.dumps(make_schema(name, *kinds), indent=2)))


NAME = click.Argument(["name"], type=click.Choice(NAMES), metavar="COMMAND")
schema_command = Command(
    "schema", params=[NAME, QUIET, VERBOSE], callback=print_schema, help=describe(print_schema)
)


def make_schema(name: str, *kinds: Any) -> Schema:
    """Make the schema of what a command prints.

    Parameters
    ----------
    kinds
        Dataclasses or NamedTuples, whose fields follow each other; the first says what
        the result is.
    """
    version = {
        "description": "What this is, and the version of its schema",
        "const": f"occmap/{name}/{RESULT_VERSION}",
    }
    wholes = [describe_fields(kind) for kind in kinds]
    properties = reduce(operator.or_, (each["properties"] for each in wholes), {"schema": version})
    draft = "https://json-schema.org/draft/2020-12/schema"
    schema = {"$schema": draft, "title": f"occmap {name} --json", **wholes[0]}
    return schema | {"properties": properties, "required": list(properties)}


def make_part(hint: Any) -> Schema:
    """Make the schema of a type."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return make_part(parts[0]) | dict(parts[1:])
    if origin is Literal or isinstance(hint, EnumType):
        return {"enum": list(parts) or [member.name.lower() for member in hint]}
    if origin in (UnionType, Union):
        return {"anyOf": [make_part(part) for part in parts]}
    if origin is dict:
        return {"type": "object", "additionalProperties": make_part(parts[1])}
    if origin in (list, tuple):
        items = {"type": "array", "items": make_part(parts[0])}
        is_sized = len(parts) > 1 and parts[1] is not Ellipsis  # so many items of one type
        return items | ({"minItems": len(parts), "maxItems": len(parts)} if is_sized else {})
    return PLAIN[hint] if hint in PLAIN else describe_fields(hint)


def describe_fields(kind: Any) -> Schema:
    """Make the schema of a type with fields; all are there, and no others."""
    texts, hints = read_texts(kind), get_type_hints(kind, include_extras=True)
    names = list_printed(kind) if is_dataclass(kind) else {name: name for name in hints}
    properties: Schema = {}
    for name, printed in names.items():
        if printed == "*":
            properties |= describe_fields(hints[name])["properties"]
        else:
            properties[printed] = make_part(hints[name]) | {"description": texts.get(name, "")}
    return {
        "type": "object",
        "description": (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " "),
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
