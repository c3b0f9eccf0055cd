"""How readers, sensor models and writers are found: through entry points, loaded on use."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from occmap.errors import UsageError

Group = Literal["occmap.readers", "occmap.models", "occmap.writers"]


@dataclass(frozen=True)
class Broken:
    """A plugin that cannot be imported: it is named and passed over, never fatal."""

    name: str
    """Its name"""
    reason: str
    """Why it cannot be imported"""


@cache
def list_plugins(group: Group) -> tuple[EntryPoint, ...]:
    """List what is installed in a group, by name, without importing any of it."""
    return tuple(sorted(entry_points(group=group), key=lambda entry: entry.name))


def load_plugins(group: Group) -> tuple[dict[str, Any], list[Broken]]:
    """Import every plugin of a group; those that fail come second, with the reason."""
    loaded: dict[str, Any] = {}
    broken: list[Broken] = []
    for entry in list_plugins(group):
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:  # noqa: BLE001  a foreign plugin may raise anything at import
            broken.append(Broken(entry.name, f"{type(error).__name__}: {error}"))
    return loaded, broken


def load_plugin(group: Group, name: str) -> Any:
    """Import one plugin; None where no plugin has that name or it does not import."""
    for entry in list_plugins(group):
        if entry.name == name:
            with suppress(Exception):  # as above
                return entry.load()
    return None


@contextmanager
def need_extra(extra: str, use: str, where: object = "") -> Iterator[None]:
    """Say how to install what the block imports, where that is missing.

    Parameters
    ----------
    extra
        Which of occmap's extras has it.
    use
        What it is for, such as "a store needs zarr".

    Raises
    ------
    UsageError
        An import of the block fails.
    """
    try:
        yield
    except ImportError:
        fix = f"install it: pip install '.[{extra}]'"
        raise UsageError(f"{use}, which is not installed", where=where, fix=fix) from None


def guess(word: str, known: Iterable[str]) -> str:
    """Say what a mistyped name was probably meant to be; "" where it is like none."""
    close = get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else ""


def suggest(word: str, known: list[str], command: str) -> str:
    """Say what a mistyped name was probably meant to be, or what there is."""
    return guess(word, known) or f"there are {', '.join(known)}: see `{command}`"
