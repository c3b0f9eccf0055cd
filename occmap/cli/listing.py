"""What is installed of one kind of plugin, for the commands that list it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

from occmap.cli.console import Console
from occmap.plain import to_plain
from occmap.plugins import Broken, Group, load_plugins


@dataclass(frozen=True)
class Listed:
    """One plugin that works."""

    name: str
    """Its name"""
    description: str
    """What it does"""
    parameters: dict[str, float | str | None] = field(default_factory=dict)
    """Those of a sensor model with their defaults; empty for readers and writers"""


@dataclass(frozen=True)
class Listing:
    """All plugins of a group."""

    kind: str
    """In the plural."""
    working: Sequence[Listed]
    broken: Sequence[Broken]

    def list_lines(self) -> Iterator[str]:
        """One line a plugin, aligned; parameters and faults below."""
        width = max((len(plugin.name) for plugin in self.working), default=0) + 2
        for plugin in self.working:
            yield f"{plugin.name:<{width}}{plugin.description}"
            if plugin.parameters:
                pairs = (f"{key}={value}" for key, value in plugin.parameters.items())
                yield f"{'':<{width}}{', '.join(pairs)}"
        for fault in self.broken:
            yield f"{fault.name} is installed but does not load: {' '.join(fault.reason.split())}"


class PrintedReaders(TypedDict):
    """Log formats: what occmap readers prints."""

    readers: list[Listed]
    """Log formats"""
    broken: list[Broken]
    """Plugins that do not load"""


class PrintedModels(TypedDict):
    """Sensor models: what occmap models prints."""

    models: list[Listed]
    """Sensor models"""
    broken: list[Broken]
    """Plugins that do not load"""


class PrintedWriters(TypedDict):
    """Map formats: what occmap writers prints."""

    writers: list[Listed]
    """Map formats"""
    broken: list[Broken]
    """Plugins that do not load"""


def list_group(kind: str, group: Group) -> Listing:
    """List a group whose plugins have only a description."""
    loaded, broken = load_plugins(group)
    working = [Listed(name, plugin.description) for name, plugin in loaded.items()]
    return Listing(kind, working, broken)


def show(console: Console, listing: Listing, values: dict[str, Any]) -> None:
    """Print a listing in the form that was asked for."""
    if values["as_json"]:
        found = {listing.kind: listing.working, "broken": listing.broken}
        console.put_json(listing.kind, to_plain(found))
    else:
        console.put(listing.list_lines())
