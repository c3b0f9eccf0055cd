"""`occmap schema`: what programs may rely on in the JSON of a command."""

from importlib.resources import files

import click

from occmap.cli import COMMANDS, options
from occmap.cli.console import put_line

SCHEMAS = {
    "build": "build",
    "check": "check",
    "compare": "compare",
    "diff": "diff",
    "explain": "explain",
    "merge": "build",
    "models": "models",
    "readers": "readers",
    "render": "build",
    "tune": "tune",
    "writers": "writers",
    "error": "error",
}
"""The file in occmap/schemas that describes what a command prints; `error` is what any of them
prints where it fails."""

HELP = f"""{COMMANDS["schema"]}

It is of JSON Schema draft 2020-12; every field has a description with its unit. The field "schema"
of a result names the command and the version of its schema. `error` is what a command prints that
fails before it has a result.

\b
  occmap schema build
  occmap schema error
"""


@click.command("schema", help=HELP, short_help=COMMANDS["schema"])
@click.argument("name", type=click.Choice(list(SCHEMAS)), metavar="COMMAND")
@options.verbosity
def command(name: str) -> None:
    """Print a schema as it is installed."""
    put_line(read_schema(name).rstrip())


def read_schema(name: str) -> str:
    """Read the schema of what a command prints."""
    file = files("occmap") / "schemas" / f"{SCHEMAS[name]}.json"
    return file.read_text(encoding="utf-8")
