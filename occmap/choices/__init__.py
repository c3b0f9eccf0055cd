"""Options: each is a field of a frozen dataclass, declared with all that is to be known of it.

`occmap.options.BuildOptions` groups those of a build. The command line, a notebook, files of
options and errors read what an option is called, does and takes from here, and from nowhere else.
"""

import math
import operator
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import EnumType, StrEnum
from functools import reduce
from types import NoneType
from typing import Any, NamedTuple, TypeVar, cast, get_args, get_type_hints

from occmap.choices.values import FORMS, Form, parse_numbers, read_value
from occmap.errors import UsageError
from occmap.plugins import suggest

Options = TypeVar("Options")
ABOVE_ZERO = math.ulp(0.0)
"""The least bound of what has to be more than zero"""


class Declared(NamedTuple):
    """What an option says of itself beside its name, its type and its default."""

    help: str = ""
    """What it does; "" where a command declares it by itself"""
    unit: str = ""
    """Of the value, as a person calls it"""
    metavar: str = ""
    """Stands for the value on the command line; "": its unit"""
    flag: str = ""
    """How it is typed, without dashes; "": like its name"""
    form: Form | None = None
    """What a value looks like, or each of several; None: as usual for the type"""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    """The least and the largest value; nan is never within them"""
    none: tuple[str, str] = ("", "")
    """How None is typed and what it does, where it is a value of the option and not its default"""


@dataclass(frozen=True)
class Option:
    """All that is known of an option."""

    name: str
    kind: Any
    """Its type, without None"""
    takes_none: bool
    default: Any
    """MISSING: it has to be given"""
    declared: Declared

    @property
    def flag(self) -> str:
        """How it is typed: like its name, without the unit."""
        return "--" + (self.declared.flag or self.name.removesuffix("_s").replace("_", "-"))

    @property
    def metavar(self) -> str | None:
        """What stands for the value on the command line; None: whatever it does by itself."""
        return self.declared.metavar or self.declared.unit.upper() or None

    def read(self, value: Any) -> Any:
        """Convert what a caller gave; raises UsageError where it is not of the option's type."""
        if value is None and self.takes_none:
            return None
        try:
            return read_value(self.name, self.kind, value, self.declared.form)
        except UsageError as error:
            none = f", or None, {self.declared.none[1]}" if self.declared.none[1] else ""
            raise UsageError(error.found, where=error.where, fix=f"{error.fix}{none}") from None

    def parse(self, text: str) -> Any:
        """Read several numbers as they are typed; raises UsageError, with what to write."""
        return parse_numbers(self.flag, self.declared.form or FORMS[self.kind], text)

    def describe(self) -> str:
        """Write its name, default, unit or form, and help, as a text for Python has it."""
        if isinstance(self.kind, EnumType):
            members: list[StrEnum] = list(self.kind)
            takes = " or ".join(f'"{member}"' for member in members)
        else:
            takes = self.declared.unit or (self.declared.form or FORMS[self.kind]).text
        default = f'"{self.default}"' if isinstance(self.kind, EnumType) else self.default
        none = f" None: {self.declared.none[1]}." if self.declared.none[1] else ""
        return f"{self.name} = {default} ({takes}): {self.declared.help}{none}"


def option(default: Any, text: str = "", **declared: Any) -> Any:
    """Declare an option as a field of a dataclass; `declared` are fields of `Declared`.

    A default that is a function is called for each set of options.
    """
    metadata = {"option": Declared(text, **declared)}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def list_options(kind: Any) -> dict[str, Option]:
    """List the options of a dataclass by their names, those in groups, too."""
    found: dict[str, Option] = {}
    hints = get_type_hints(kind)
    for each in fields(kind):
        hint = hints[each.name]
        if is_dataclass(hint):
            found |= list_options(hint)
            continue
        default = each.default if each.default_factory is MISSING else each.default_factory()
        takes_none = NoneType in get_args(hint)
        declared = each.metadata.get("option", Declared())
        found[each.name] = Option(each.name, drop_none(hint), takes_none, default, declared)
    return found


def list_values(options: Any) -> dict[str, Any]:
    """List the value of each option by its name, those in groups, too."""
    found: dict[str, Any] = {}
    for each in fields(options):
        value = getattr(options, each.name)
        is_group = is_dataclass(get_type_hints(type(options))[each.name])
        found |= list_values(value) if is_group else {each.name: value}
    return found


def drop_none(hint: Any) -> Any:
    """The type of an option that is given, where it may also be None."""
    kinds = [each for each in get_args(hint) if each is not NoneType]
    return reduce(operator.or_, kinds) if NoneType in get_args(hint) else hint


def take(kind: type[Options], values: Mapping[str, Any]) -> Options:
    """Make options of the values that are named like its fields, or like those of its groups."""
    made = {}
    for name, hint in get_type_hints(kind).items():
        if name in values:
            made[name] = values[name]
        elif is_dataclass(hint):
            made[name] = take(cast(type[Any], hint), values)
    return kind(**made)


def check_bounds(options: Any) -> None:
    """Refuse a value out of the bounds of its option; raises UsageError with what to give."""
    for each in fields(options):
        value = getattr(options, each.name)
        low, high = each.metadata.get("option", Declared()).bounds
        if isinstance(value, int | float) and not low <= value <= high:
            least = "more than 0" if low == ABOVE_ZERO else f"{low:g}"
            most = f" to {high:g}" if math.isfinite(high) else " or more" * (low != ABOVE_ZERO)
            raise UsageError(f"`{each.name}={value}` is not possible", fix=f"give {least}{most}")


def read_options(kind: type[Options], given: Mapping[str, Any], call: str) -> Options:
    """Make options of the values that a caller gave by name.

    None leaves an option at its default, unless None is one of its values.

    Parameters
    ----------
    kind
        A dataclass of options; those in a group, a dataclass in it, are given by name, too.
    call
        The function that was called, for the error.

    Raises
    ------
    UsageError
        No option has such a name, or a value is not what the option takes.
    """
    known = list_options(kind)
    for name in given:
        if name not in known:
            fix = suggest(name, sorted(known), f"help(occmap.{call})")
            raise UsageError(f"{call} has no option {name!r}", fix=fix)
    values = {
        name: known[name].read(value)
        for name, value in given.items()
        if value is not None or known[name].takes_none
    }
    return take(kind, values)


def read_each(name: str, kind: Any, values: Any, form: Form | None = None) -> list[Any]:
    """Convert each value of a list that a caller gave.

    Raises
    ------
    UsageError
        It is no list, or a value is not of that type.
    """
    try:
        listed: Any = None if isinstance(values, str | bytes) else values
        return [read_value(name, kind, value, form) for value in listed]
    except TypeError:
        raise UsageError(f"{name} is {values!r}", fix="give a list") from None


def describe_options(kind: Any) -> Iterator[str]:
    """Write the options of a dataclass as lines of a docstring."""
    for each in list_options(kind).values():
        yield from textwrap.wrap(each.describe(), 90, subsequent_indent="    ")
