"""Options by their names and as plain values, as a notebook gives them: no groups, no classes."""

import math
import operator
import os
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import is_dataclass
from enum import EnumType, StrEnum
from functools import reduce
from numbers import Real
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, cast, get_args, get_type_hints

from occmap.cells import Box
from occmap.errors import UsageError
from occmap.plugins import suggest
from occmap.sensor.models import SensorModel, parse_model
from occmap.sensor.returns import Sector
from occmap.types import Pose, PoseSample

Options = TypeVar("Options")

NONE = {
    "align": ("auto", "so that walls run along the axes"),
    "max_pose_gap_s": ("inf", "to interpolate across any gap"),
}
"""How None is typed and what it does, where it is a value of an option and not its default"""
LARGEST_ANGLE = 7.0
"""A little more than a full turn (rad), since people round."""


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
    hints = list_options(kind)
    for name in given:
        if name not in hints:
            fix = suggest(name, sorted(hints), f"help(occmap.{call})")
            raise UsageError(f"{call} has no option {name!r}", fix=fix)
    values = {
        name: read_option(name, hints[name], value)
        for name, value in given.items()
        if value is not None or NoneType in get_args(hints[name])
    }
    return take(kind, values)


def list_options(kind: Any, *, include_extras: bool = False) -> dict[str, Any]:
    """List the type of each option by its name, those in groups, too; as `get_type_hints`."""
    found: dict[str, Any] = {}
    for name, hint in get_type_hints(kind, include_extras=include_extras).items():
        is_group = is_dataclass(hint)
        found |= list_options(hint, include_extras=include_extras) if is_group else {name: hint}
    return found


def list_values(options: Any) -> dict[str, Any]:
    """List the value of each option by its name, those in groups, too."""
    found: dict[str, Any] = {}
    for name, hint in get_type_hints(type(options)).items():
        value = getattr(options, name)
        found |= list_values(value) if is_dataclass(hint) else {name: value}
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


def read_option(name: str, hint: Any, value: Any) -> Any:
    """Convert what a caller gave to the type of an option.

    Raises
    ------
    UsageError
        The value is not of that type.
    """
    if value is None and NoneType in get_args(hint):
        return None
    hint = drop_none(hint)
    if isinstance(hint, EnumType):
        return read_choice(name, cast(type[StrEnum], hint), value)
    read, form = find_form(name, hint)
    has_several = hint not in FORMS  # a tuple of values that each have a form
    try:
        return tuple(map(read, value)) if has_several else read(value)
    except UsageError as error:
        raise error.placed(f"{name} = {value!r}") from None
    except (TypeError, ValueError, OverflowError):
        if has_several:
            form = "a list of " + re.sub("such as (.*)", r"such as [\1]", form)
        none = f", or None, {NONE[name][1]}" if name in NONE else ""
        raise UsageError(f"{name} is {value!r}", fix=f"give {form}{none}") from None


def read_choice(name: str, kind: type[StrEnum], value: Any) -> StrEnum:
    """Find the member of an enum whose value a caller gave; raises UsageError if there is none."""
    known = [member.value for member in kind]
    if not isinstance(value, str) or value not in known:
        fix = suggest(str(value), known, "help(occmap.build_map)")
        raise UsageError(f"{name} is {value!r}", fix=fix)
    return kind(value)


def read_each(name: str, hint: Any, values: Any) -> list[Any]:
    """Convert each value of a list that a caller gave.

    Raises
    ------
    UsageError
        It is no list, or a value is not of that type.
    """
    try:
        listed: Any = None if isinstance(values, str | bytes) else values
        return [read_option(name, hint, value) for value in listed]
    except TypeError:
        raise UsageError(f"{name} is {values!r}", fix="give a list") from None


def find_form(name: str, hint: Any) -> tuple[Callable[[Any], Any], str]:
    """Find how the value of an option, or each of several, is read, and what to give."""
    return FORMS.get(name) or FORMS[hint if hint in FORMS else get_args(hint)[0]]


def _refuse_degrees(angles: Iterable[float]) -> None:
    """Refuse angles of more than a turn, which are degrees; raises UsageError with the radians."""
    for angle in angles:
        if abs(angle) > LARGEST_ANGLE:
            found = f"an angle of {angle:g} rad is more than a turn"
            fix = f"write radians: {angle:g} degrees are {math.radians(angle):.6g}"
            raise UsageError(found, fix=fix)


def _read_number(value: Any) -> float:
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError
    return float(value)


def _read_numbers(value: Iterable[Any], *sizes: int) -> tuple[float, ...]:
    numbers = tuple(map(_read_number, value))
    if len(numbers) not in sizes:
        raise ValueError
    return numbers


def _read_text(value: Any) -> str:
    """Make text of text or a path; refuse what can be no name of a file, topic or frame."""
    text = os.fspath(value)
    if not isinstance(text, str) or b"\0" in os.fsencode(text):
        raise TypeError
    return text


def _read_pose(value: Any) -> Pose:
    """Make a pose of (x, y, yaw) or (x, y, yaw, roll, pitch), in metres and radians."""
    if isinstance(value, Pose):
        return value
    x, y, yaw, roll, pitch, *_ = (*_read_numbers(value, 3, 5), 0.0, 0.0)
    _refuse_degrees((yaw, roll, pitch))
    return Pose.from_xyzrpy((x, y, 0.0), (roll, pitch, yaw))


def _read_planar(value: Any) -> Pose:
    """Make a pose of (x, y, yaw), in metres and radians."""
    return value if isinstance(value, Pose) else _read_pose(_read_numbers(value, 3))


def _read_transform(value: Any) -> PoseSample:
    """Make a fixed transform of (parent, child, x, y, z, roll, pitch, yaw)."""
    if isinstance(value, PoseSample):
        return value
    parent, child, *numbers = value
    x, y, z, roll, pitch, yaw = _read_numbers(numbers, 6)
    if not (parent and child):
        raise UsageError("a frame has no name")
    _refuse_degrees((roll, pitch, yaw))
    pose = Pose.from_xyzrpy((x, y, z), (roll, pitch, yaw))
    return PoseSample(0, _read_text(parent), _read_text(child), pose, static=True)


def _read_sector(value: Any) -> tuple[float, ...]:
    """Make a sector of two bearings in radians."""
    sector = _read_numbers(value, 2)
    _refuse_degrees(sector)
    return sector


def _read_box(value: Any) -> tuple[float, ...]:
    return _read_numbers(value, 4)


def _read_topics(value: Any) -> tuple[str, ...]:
    return tuple(map(_read_text, [value] if isinstance(value, str) else value))


def _read_model(value: Any) -> SensorModel:
    if isinstance(value, str):
        return parse_model(value)
    if isinstance(value, type) or not isinstance(value, SensorModel):
        raise TypeError
    return value


FORMS: dict[Any, tuple[Callable[[Any], Any], str]] = {
    float: (_read_number, "a number"),
    int: (operator.index, "a whole number"),
    str: (_read_text, "text"),
    Path: (lambda value: Path(_read_text(value)), "a path"),
    Pose: (
        _read_pose,
        "(x, y, yaw) or (x, y, yaw, roll, pitch) in metres and radians, such as (0.1, 0, 3.14159)",
    ),
    PoseSample: (
        _read_transform,
        "(parent, child, x, y, z, roll, pitch, yaw) in metres and radians",
    ),
    Sector: (_read_sector, "(from, to) in radians, counter-clockwise, such as (2.5, -2.5)"),
    "transform": (_read_planar, "(x, y, yaw) in metres and radians, such as (12.5, -3, 1.5708)"),
    "extent": (_read_box, "(x_min, y_min, x_max, y_max) in metres, such as (0, 0, 5, 4)"),
    Box: (
        _read_box,
        "(x_min, y_min, x_max, y_max) in metres, such as (-0.4, -0.3, 0.2, 0.3)",
    ),
    SensorModel: (_read_model, 'text such as "simple:p_hit=0.8", or a model'),
    tuple[str, ...]: (_read_topics, "a topic or a list of topics"),
}
"""By type, or by the name of an option that differs from others of its type: what reads a value,
and what to give. If an option takes several values, the type of one counts. Enums are not in it."""
