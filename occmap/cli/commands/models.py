"""`occmap models`: the sensor models that are installed, with their parameters."""

from dataclasses import fields
from typing import Any

import click

from occmap.cli import COMMANDS, options
from occmap.cli.console import Console
from occmap.cli.listing import Listed, Listing, show
from occmap.plugins import load_plugins


@click.command("models", help=COMMANDS["models"])
@options.as_json
@options.verbosity
@click.pass_obj
def command(console: Console, /, **values: Any) -> None:
    """List what is installed."""
    show(console, list_models(), values)


def list_models() -> Listing:
    """List the models and the parameters that `--model NAME:KEY=NUMBER` takes."""
    loaded, broken = load_plugins("occmap.models")
    return Listing("models", [describe(name, model) for name, model in loaded.items()], broken)


def describe(name: str, model: Any) -> Listed:
    """Describe one model."""
    parameters: dict[str, Any] = {each.name: each.default for each in fields(model)}
    return Listed(name, model.description, parameters)
