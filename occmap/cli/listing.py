"""What is installed of one kind of plugin, for the commands that list it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from occmap.cli.console import Console
from occmap.plugins import Broken, Group, load_plugins


@dataclass(frozen=True)
class Listed:
    """One plugin that works."""

    name: str
    description: str
    parameters: dict[str, Any] = field(default_factory=dict)
    """With their defaults"""


@dataclass(frozen=True)
class Listing:
    """All plugins of a group."""

    kind: str
    """In the plural."""
    working: Sequence[Listed]
    broken: Sequence[Broken]

    def to_json(self) -> dict[str, Any]:
        """The listing as values that JSON has."""
        return {
            self.kind: [vars(plugin) for plugin in self.working],
            "broken": [vars(plugin) for plugin in self.broken],
        }

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


def list_group(kind: str, group: Group) -> Listing:
    """List a group whose plugins have only a description."""
    loaded, broken = load_plugins(group)
    working = [Listed(name, plugin.description) for name, plugin in loaded.items()]
    return Listing(kind, working, broken)


def show(console: Console, listing: Listing, values: dict[str, Any]) -> None:
    """Print a listing in the form that was asked for."""
    if values["as_json"]:
        console.put_json(listing.kind, listing.to_json())
    else:
        console.put(listing.list_lines())
