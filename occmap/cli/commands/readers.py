"""`occmap readers`: the log formats that can be read."""

from typing import Any

import click

from occmap.cli import COMMANDS, options
from occmap.cli.console import Console
from occmap.cli.listing import list_group, show


@click.command("readers", help=COMMANDS["readers"])
@options.as_json
@options.verbosity
@click.pass_obj
def command(console: Console, /, **values: Any) -> None:
    """List what is installed."""
    show(console, list_group("readers", "occmap.readers"), values)
