"""`occmap schema`: what programs may rely on in the JSON of a command."""

import json
from importlib import import_module
from typing import Any

import click

from occmap.cli import COMMANDS, options
from occmap.cli.console import RESULT_VERSION, put_line, spell_all
from occmap.cli.listing import KINDS, Listed
from occmap.cli.schemas import make_schema
from occmap.gates import Failed
from occmap.plugins import Broken

SCHEMAS = {
    "build": "occmap.report:Report",
    "check": "occmap.inspection.findings:Inspection",
    "compare": "occmap.scoring.compare:VariantComparison",
    "diff": "occmap.difference:MapDifference",
    "explain": "occmap.explanation:Explanation",
    "merge": "occmap.report:Report",
    "models": "occmap.cli.listing:Listing",
    "readers": "occmap.cli.listing:Listing",
    "render": "occmap.report:Report",
    "tune": "occmap.tuning.result:Tuning",
    "writers": "occmap.cli.listing:Listing",
    "error": "occmap.cli.console:PrintedError",
}
"""The type of what a command prints; `error` is what any of them prints where it fails."""

WITHOUT_LIMITS = ("explain", "models", "readers", "writers", "error")

FAILED = (
    "The limits of `limits` that the result does not keep to; any of them makes the exit code 3"
)

HELP = f"""{COMMANDS["schema"]}

It is of JSON Schema draft 2020-12; every field has a description with its unit. The field "schema"
of a result names the command and the version of its schema. A command that fails before it has a
result prints an `error`.

\b
  occmap schema build
  occmap schema error
"""


@click.command("schema", help=HELP, short_help=COMMANDS["schema"])
@click.argument("name", type=click.Choice(list(SCHEMAS)), metavar="COMMAND")
@options.verbosity
def command(name: str) -> None:
    """Print the schema of what a command prints."""
    schema = json.dumps(spell_all(describe_printed(name)), indent=2)
    put_line(schema)


def describe_printed(name: str) -> dict[str, Any]:
    """Make the schema of what a command prints."""
    module, _, kind = SCHEMAS[name].partition(":")
    version = {
        "description": "What this is, and the version of its schema",
        "const": f"occmap/{name}/{RESULT_VERSION}",
    }
    more: dict[str, Any] = {}
    if name not in WITHOUT_LIMITS:
        more["failed"] = list[Failed], FAILED
    if name in KINDS:
        more[name] = list[Listed], KINDS[name][1]
        more["broken"] = list[Broken], "Plugins that do not load"
    printed = getattr(import_module(module), kind)
    schema = make_schema(f"occmap {name} --json", printed, {"schema": version}, more)
    if name in KINDS:
        schema["description"] = f"{KINDS[name][1]}: what occmap {name} prints."
    return schema
