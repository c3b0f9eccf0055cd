"""The commands that list what is installed of one kind of plugin."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import click

from occmap.cli import options
from occmap.cli.answers import Answer, answering
from occmap.cli.console import Console
from occmap.plugins import Broken, Group, load_plugins
from occmap.report.printed import Printed


@dataclass(frozen=True)
class Listed:
    """One plugin that works."""

    name: str
    """Its name"""
    description: str
    """What it does"""
    parameters: dict[str, float | str | None]
    """Those of a sensor model with their defaults; empty for readers and writers"""


@dataclass(frozen=True)
class Models(Printed):
    """Sensor models: what occmap models prints."""

    models: list[Listed]
    """Sensor models"""
    broken: list[Broken]
    """Plugins that do not load"""


@dataclass(frozen=True)
class Readers(Printed):
    """Log formats: what occmap readers prints."""

    readers: list[Listed]
    """Log formats"""
    broken: list[Broken]
    """Plugins that do not load"""


@dataclass(frozen=True)
class Writers(Printed):
    """Map formats: what occmap writers prints."""

    writers: list[Listed]
    """Map formats"""
    broken: list[Broken]
    """Plugins that do not load"""


KINDS: dict[str, tuple[Group, type[Models | Readers | Writers]]] = {
    "models": ("occmap.models", Models),
    "readers": ("occmap.readers", Readers),
    "writers": ("occmap.writers", Writers),
}
"""Which plugins each of these commands lists, and what it prints"""


def make_command(kind: str) -> click.Command:
    """Make the command that lists the plugins of a kind."""
    group, printed = KINDS[kind]

    @answering(kind, printed)
    @options.printing
    def command(_console: Console, /) -> Answer:
        loaded, broken = load_plugins(group)
        working = []
        for name, plugin in loaded.items():
            parameters: Any = fields(plugin) if kind == "models" else ()
            defaults = {each.name: each.default for each in parameters}
            working.append(Listed(name, plugin.description, defaults))
        return Answer(printed(working, broken), format_plugins(working, broken))

    return command


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
