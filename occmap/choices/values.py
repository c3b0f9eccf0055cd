"""Values of options: read as a notebook gives them or as they are typed, and written as typed."""

import math
import operator
import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from enum import EnumType, StrEnum
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple, get_args

from occmap.errors import UsageError
from occmap.plugins import suggest
from occmap.report.words import count
from occmap.types import Pose, PoseSample

LARGEST_ANGLE = 7.0
"""A little more than a full turn (rad), since people round."""
LEVEL_RAD = 5e-6
"""A smaller angle is written as 0."""
TUPLE = re.compile(r"\((.*?)\)")
"""A tuple, as it is written in Python"""


class Form(NamedTuple):
    """What the values of an option look like."""

    read: Callable[[Any], Any]
    """Makes a value of what was given; raises TypeError, ValueError or UsageError"""
    text: str
    """What to give; a tuple is typed without its parentheses"""


def read_choice(name: str, kind: type[StrEnum], value: Any) -> StrEnum:
    """Find the member of an enum whose value a caller gave; raises UsageError if there is none."""
    known = [member.value for member in kind]
    if not isinstance(value, str) or value not in known:
        fix = suggest(str(value), known, "help(occmap.build_map)")
        raise UsageError(f"{name} is {value!r}", fix=fix)
    return kind(value)


def read_value(name: str, kind: Any, value: Any, form: Form | None = None) -> Any:
    """Convert what a caller gave to the type of an option.

    Parameters
    ----------
    form
        What one value looks like, of which a tuple holds several; None: as usual for the type.

    Raises
    ------
    UsageError
        The value is not of that type.
    """
    if isinstance(kind, EnumType):
        return read_choice(name, kind, value)  # type: ignore[arg-type]  # all enums are of text
    (read, text), has_several = form or FORMS[kind], holds_several(kind)
    try:
        return tuple(map(read, value)) if has_several else read(value)
    except UsageError as error:
        raise error.placed(f"{name} = {value!r}") from None
    except (TypeError, ValueError, OverflowError):
        if has_several:
            text = "a list of " + re.sub("such as (.*)", r"such as [\1]", text)
        raise UsageError(f"{name} is {value!r}", fix=f"give {text}") from None


def holds_several(kind: Any) -> bool:
    """Whether an option takes any number of values that each have a form."""
    return get_args(kind)[1:] == (Ellipsis,) and kind not in FORMS


def parse_numbers(flag: str, form: Form, text: str) -> Any:
    """Read an option of several numbers, after names of frames if any, with commas between.

    Raises
    ------
    UsageError
        There are too many or too few numbers, one is not a number, or an angle is in degrees.
    """
    typed = TUPLE.sub(lambda found: found[1].replace(" ", ""), form.text)
    where, fix = f"{flag} {text}", f"write {typed}"
    values = [value.strip() for value in text.split(",")]
    frames = 2 if form is TRANSFORM else 0
    try:
        numbers = [parse_number(value, where, fix) for value in values[frames:]]
        return form.read([*values[:frames], *numbers])
    except UsageError as error:
        raise UsageError(error.found, where=where, fix=error.fix or fix) from None
    except ValueError:
        shapes = TUPLE.findall(form.text.partition(" in ")[0])
        belong = " or ".join(str(each.count(",") + 1) for each in shapes)
        found = f"{count(len(values), 'value')} where {belong} belong"
        raise UsageError(found, where=where, fix=fix) from None


def parse_number(word: str, where: str, fix: str) -> float:
    """Read a finite decimal number; raises UsageError, with what to write."""
    with suppress(ValueError):
        if math.isfinite(number := float(word)):
            return number
    raise UsageError(f"{word.strip()!r} is not a number", where=where, fix=fix)


def write_values(value: Any) -> list[str]:
    """Write the value of an option as it is typed; some options are typed once for each item."""
    one = not isinstance(value, tuple) or isinstance(value, Pose) or isinstance(value[0], float)
    return [write_value(item) for item in ([value] if one else value)]


def write_value(value: Any) -> str:
    """Write a value, or one item of several, as it is typed."""
    if isinstance(value, Pose):
        return format_mount(value)
    if isinstance(value, PoseSample):
        return format_static(value.parent, value.child, value.pose)
    if isinstance(value, tuple):
        return _join(value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def format_mount(pose: Pose) -> str:
    """Write a pose as `sensor_pose` takes it: x,y,yaw, and roll,pitch where it is not level."""
    roll, pitch, yaw = to_rpy(pose)
    level = abs(roll) < LEVEL_RAD and abs(pitch) < LEVEL_RAD
    return _join([pose.x, pose.y, yaw] if level else [pose.x, pose.y, yaw, roll, pitch])


def format_static(parent: str, child: str, pose: Pose) -> str:
    """Write a transform as it is typed: parent,child,x,y,z,roll,pitch,yaw."""
    return f"{parent},{child},{_join([pose.x, pose.y, pose.z, *to_rpy(pose)])}"


def to_rpy(pose: Pose) -> tuple[float, float, float]:
    """Roll, pitch and yaw about fixed axes (rad) of a pose's rotation (REP 103)."""
    _, _, _, x, y, z, w = pose
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def _join(numbers: Sequence[float]) -> str:
    """Join numbers, to hundredths of a millimetre and without a negative zero."""
    return ",".join(f"{round(number, 5) + 0.0:.12g}" for number in numbers)


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


def _read_topics(value: Any) -> tuple[str, ...]:
    return tuple(map(_read_text, [value] if isinstance(value, str) else value))


def make_box_form(example: str) -> Form:
    """Make the form of a box of four numbers."""
    text = f"(x_min, y_min, x_max, y_max) in metres, such as {example}"
    return Form(lambda value: _read_numbers(value, 4), text)


FORMS: dict[Any, Form] = {
    float: Form(_read_number, "a number"),
    int: Form(operator.index, "a whole number"),
    str: Form(_read_text, "text"),
    Path: Form(lambda value: Path(_read_text(value)), "a path"),
    tuple[str, ...]: Form(_read_topics, "a topic or a list of topics"),
}
"""How values look by their type, where an option does not say it. Enums are not in it."""
MOUNT = Form(
    _read_pose,
    "(x, y, yaw) or (x, y, yaw, roll, pitch) in metres and radians, such as (0.1, 0, 3.14159)",
)
PLANAR = Form(_read_planar, "(x, y, yaw) in metres and radians, such as (12.5, -3, 1.5708)")
TRANSFORM = Form(
    _read_transform, "(parent, child, x, y, z, roll, pitch, yaw) in metres and radians"
)
SECTOR = Form(_read_sector, "(from, to) in radians, counter-clockwise, such as (2.5, -2.5)")
