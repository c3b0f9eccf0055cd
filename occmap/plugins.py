"""How readers, sensor models and writers are found: through entry points, loaded on use."""

import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points, requires
from traceback import walk_tb
from typing import Any, Literal, cast

from occmap.errors import UsageError

Group = Literal["occmap.readers", "occmap.models", "occmap.writers"]
OWN = "occmap."
"""The packages of occmap's own plugins begin so"""
NEEDED: dict[Group, tuple[str, ...]] = {
    "occmap.readers": ("name", "description", "recognises", "open"),
    "occmap.models": ("name", "description", "prior", "log_odds or depth"),
    "occmap.writers": ("description", "write or write_product"),
}
"""What a plugin of each group cannot do without"""


@dataclass(frozen=True)
class Broken:
    """A plugin that cannot be used: it is named and passed over, never fatal."""

    name: str
    """Its name"""
    reason: str
    """Why it cannot be used"""


@cache
def list_plugins(group: Group) -> tuple[EntryPoint, ...]:
    """List what is installed in a group, by name, without importing any of it.

    Of several plugins of one name there is one, occmap's own where it has such a one.
    """
    own_last = sorted(entry_points(group=group), key=lambda it: it.value.startswith(OWN))
    found = {entry.name: entry for entry in own_last}
    return tuple(sorted(found.values(), key=lambda entry: entry.name))


def load_plugins(group: Group) -> tuple[dict[str, Any], list[Broken]]:
    """Import every plugin of a group; those that cannot be used come second, with the reason."""
    loaded: dict[str, Any] = {}
    broken: list[Broken] = []
    listed = list_plugins(group)
    for entry in listed:
        try:
            loaded[entry.name] = load(entry)
        except Exception as error:  # noqa: BLE001  a foreign plugin may raise anything at import
            broken.append(Broken(entry.name, f"{type(error).__name__}: {error}"))
    hidden = (entry for entry in entry_points(group=group) if entry not in listed)
    broken += [Broken(it.name, f"{it.value} has the name of another one") for it in hidden]
    return loaded, broken


def load_plugin(group: Group, name: str) -> Any:
    """Import one plugin; None where no plugin has that name or it cannot be used."""
    for entry in list_plugins(group):
        if entry.name == name:
            with suppress(Exception):  # as above
                return load(entry)
    return None


def load(entry: EntryPoint) -> Any:
    """Import a plugin; raises a TypeError that says what it lacks, or what its import raises."""
    plugin = entry.load()
    if entry.group == "occmap.models" and not is_dataclass(plugin):
        raise TypeError(f"{entry.value} is no dataclass")
    for names in NEEDED[cast(Group, entry.group)]:
        if not any(hasattr(plugin, name) for name in names.split(" or ")):
            raise TypeError(f"{entry.value} has no {names}")
    if entry.group == "occmap.models" and plugin.name != entry.name:
        # Evidence holds the one, and is read by the other.
        raise TypeError(f"{entry.value} calls itself {plugin.name}")
    return plugin


def find_culprit(error: BaseException) -> tuple[str, str]:
    """Say who is at fault, occmap or a plugin that the error came through, and at which line."""
    entries = (entry for group in NEEDED for entry in list_plugins(group))
    packages = {it.module.partition(".")[0] for it in entries if not it.value.startswith(OWN)}
    whose, place = "occmap", "?"
    for frame, line in walk_tb(error.__traceback__):
        file, package = frame.f_code.co_filename, frame.f_globals["__name__"].partition(".")[0]
        if package in packages:
            whose, place = f"the plugin {package}", f"{file}:{line}"
        elif package == whose:
            place = f"occmap{file.rpartition('occmap')[2]}:{line}"
    return whose, place


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
        fix = f"install it: {tell_install(extra)}"
        raise UsageError(f"{use}, which is not installed", where=where, fix=fix) from None


def tell_install(extra: str) -> str:
    """Say how to install what an extra has, wherever occmap was installed from."""
    mark = re.compile(rf"(\S+?)\s*;.*extra == ['\"]{extra}['\"]")
    found = filter(None, map(mark.match, requires("occmap") or ()))
    return f"pip install {shlex.join(each[1] for each in found)}"


def guess(word: str, known: Iterable[str]) -> str:
    """Say what a mistyped name was probably meant to be; "" where it is like none."""
    close = get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}?" if close else ""


def suggest(word: str, known: list[str], command: str) -> str:
    """Say what a mistyped name was probably meant to be, or what there is."""
    return guess(word, known) or f"there are {', '.join(known)}: see `{command}`"
