"""Options: each is a field of a frozen dataclass, declared with all that is to be known of it.

`occmap.options.BuildOptions` groups those of a build. The command line, a notebook, files of
options and errors read what an option is called, does and takes from here, and from nowhere else.
One reader takes values as a notebook gives them, as a file of options has them, and as they are
typed; they are written as they are typed.
"""

import math
import operator
import os
import re
import textwrap
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from datetime import UTC, datetime
from enum import EnumType
from functools import cache
from numbers import Real
from pathlib import Path
from types import NoneType
from typing import Any, NamedTuple, Self, TypeVar, cast, get_args, get_type_hints

from occmap.errors import UsageError
from occmap.plugins import guess
from occmap.report import count
from occmap.types import Pose, PoseSample

LARGEST_ANGLE = 7.0
"""A little more than a full turn (rad), since people round."""
LEVEL_RAD = 5e-6
"""A smaller angle is written as 0."""


class Form(NamedTuple):
    """What the values of an option look like."""

    read: Callable[[Any], Any]
    """Makes a value of what was given or typed; raises TypeError, ValueError or UsageError"""
    text: str
    """What to type; Python may have it as text, too, or as a tuple of what stands between commas"""
    write: Callable[[Any], str] = lambda value: (
        f"{value:.12g}" if isinstance(value, float) else str(value)
    )
    """Writes a value as it is typed"""


def format_mount(pose: Pose) -> str:
    """Write a pose as `sensor_pose` takes it: x,y,yaw, and roll,pitch where it is not level."""
    roll, pitch, yaw = to_rpy(pose)
    level = abs(roll) < LEVEL_RAD and abs(pitch) < LEVEL_RAD
    return _join([pose.x, pose.y, yaw] if level else [pose.x, pose.y, yaw, roll, pitch])


def format_place(pose: Pose) -> str:
    """Write a pose as `transform` takes it: x,y,yaw, and z where it is not 0."""
    return _join([pose.x, pose.y, to_rpy(pose)[2], *[pose.z] * bool(pose.z)])


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


def mark_options(values: Mapping[str, str]) -> str:
    """Write options with their values into a sentence: in Python, what has commas is a tuple."""
    written = {name: f"({text})" if "," in text else text for name, text in values.items()}
    return " and ".join(f"`{name}={text}`" for name, text in written.items())


def _join(numbers: Sequence[float]) -> str:
    """Join numbers, to hundredths of a millimetre and without a negative zero."""
    return ",".join(f"{round(number, 5) + 0.0:.12g}" for number in numbers)


def _read_number(value: Any) -> float:
    if not isinstance(value, Real | str) or isinstance(value, bool):
        raise TypeError
    return float(value)


def _read_whole_number(value: Any) -> int:
    if isinstance(value, bool):
        raise TypeError
    return int(value) if isinstance(value, str) else operator.index(value)


def _read_finite(value: Any) -> float:
    with suppress(ValueError):
        if math.isfinite(number := _read_number(value)):
            return number
    raise UsageError(f"{value!r} is not a number")


def _read_numbers(value: Iterable[Any], *sizes: int, angles: slice = slice(0)) -> tuple[float, ...]:
    """Make finite numbers of several, some of which may be angles in radians.

    Raises
    ------
    UsageError
        There are not so many, one is not a number, or an angle is more than a turn: in degrees.
    """
    parts = _part(value)
    if len(parts) not in sizes:
        belong = " or ".join(map(str, sizes))
        raise UsageError(f"{count(len(parts), 'value')} where {belong} belong")
    numbers = tuple(map(_read_finite, parts))
    for angle in numbers[angles]:
        if abs(angle) > LARGEST_ANGLE:
            found = f"an angle of {angle:g} rad is more than a turn"
            fix = f"write radians: {angle:g} degrees are {math.radians(angle):.6g}"
            raise UsageError(found, fix=fix)
    return numbers


def _part(value: Iterable[Any]) -> tuple[Any, ...]:
    """Part values that are typed with commas between; others are apart."""
    if isinstance(value, str):
        return tuple(word.strip() for word in value.split(","))
    return tuple(value)


def _read_text(value: Any) -> str:
    """Make text of text or a path; refuse what can be no name of a file, topic or frame."""
    text = os.fspath(value)
    if not isinstance(text, str) or b"\0" in os.fsencode(text):
        raise TypeError
    return text


def _read_path(value: Any) -> Path:
    """Make a path; an empty one, as of a variable that is not set, is no folder."""
    if text := _read_text(value):
        return Path(text)
    raise ValueError


def _read_mount(value: Any) -> Pose:
    """Make a pose of (x, y, yaw), or of (x, y, yaw, roll, pitch), in metres and radians."""
    x, y, yaw, roll, pitch, *_ = *_read_numbers(value, 3, 5, angles=slice(2, None)), 0.0, 0.0
    return Pose.from_xyzrpy((x, y, 0.0), (roll, pitch, yaw))


def _read_place(value: Any) -> Pose:
    """Make a pose of (x, y, yaw), or of (x, y, yaw, z), in metres and radians."""
    x, y, yaw, *up = _read_numbers(value, 3, 4, angles=slice(2, 3))
    return Pose.planar(x, y, yaw)._replace(z=sum(up))


def _read_transform(value: Any) -> PoseSample:
    """Make a fixed transform of (parent, child, x, y, z, roll, pitch, yaw)."""
    parts = _part(value)
    x, y, z, roll, pitch, yaw = _read_numbers(parts[2:], 6, angles=slice(3, None))
    parent, child = map(_read_text, parts[:2])
    if not (parent and child):
        raise UsageError("a frame has no name")
    pose = Pose.from_xyzrpy((x, y, z), (roll, pitch, yaw))
    return PoseSample(0, parent, child, pose, static=True)


def _read_switch(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


FORMS: dict[Any, Form] = {
    bool: Form(_read_switch, "True or False"),
    float: Form(_read_number, "a number"),
    int: Form(_read_whole_number, "a whole number"),
    str: Form(_read_text, "text"),
    Path: Form(_read_path, "a path"),
}
"""How values look by their type, where an option does not say it"""
MOUNT = Form(
    _read_mount,
    "x,y,yaw or x,y,yaw,roll,pitch in metres and radians, such as 0.1,0,3.14159",
    format_mount,
)
PLACE = Form(
    _read_place, "x,y,yaw or x,y,yaw,z in metres and radians, such as 12.5,-3,1.5708", format_place
)


LIKE_A_YEAR = re.compile(r"(19|20)\d\d")


def _read_time(value: Any) -> float:
    """Make a stamp (s) of a number, or of a date, which is in UTC unless it says otherwise."""
    if LIKE_A_YEAR.fullmatch(str(value)):
        fix = f"write {value}-01-01 for the date, {value}.0 for seconds"
        raise UsageError("this may be a year, or seconds", fix=fix)
    try:
        return _read_finite(value)
    except UsageError:
        date = datetime.fromisoformat(value)
        return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _read_found(value: Any) -> dict[Any, Any]:
    """Take none of what is found in logs: nobody types that."""
    if value not in ("off", {}):
        raise ValueError(value)
    return {}


def _make_form(size: int, text: str, angles: slice = slice(0)) -> Form:
    """Make the form of so many numbers, some of which may be angles in radians."""
    return Form(lambda value: _read_numbers(value, size, angles=angles), text, _join)


TRANSFORM = Form(
    _read_transform,
    "parent,child,x,y,z,roll,pitch,yaw in metres and radians",
    lambda it: format_static(it.parent, it.child, it.pose),
)
TIME = Form(_read_time, "seconds, or a date such as 2026-11-02T08:00")
FOUND = Form(_read_found, '"off"', lambda _found: "off")
GLOBE = _make_form(3, "latitude,longitude,yaw in degrees, such as 52.5,13.4,30")
TILT = _make_form(2, "roll,pitch in degrees, such as 2.5,-1")
SECTOR = _make_form(2, "from,to in radians, counter-clockwise, such as 2.5,-2.5", slice(None))


def make_box_form(example: str) -> Form:
    """Make the form of a box of four numbers."""
    return _make_form(4, f"x_min,y_min,x_max,y_max in metres, such as {example}")


def find_form(kind: Any) -> Form:
    """Find out how values of a type look: one of the words of an enum, or as `FORMS` says."""
    if isinstance(kind, EnumType):
        return Form(kind, " or ".join(f'"{member}"' for member in list[Any](kind)))
    return FORMS[kind]


Options = TypeVar("Options")
UNBOUNDED = (-math.inf, math.inf)
ABOVE_ZERO = math.ulp(0.0)
"""The least bound of what has to be more than zero"""


@dataclass(frozen=True, kw_only=True)
class Option:
    """All that is known of what is given by name: to a command, or to a function."""

    name: str
    kind: Any
    """The type of its value, or of each of several"""
    is_many: bool
    """It takes several values"""
    takes_none: bool
    form: Form
    """What a value looks like, or each of several"""
    none: tuple[str, str] = ("", "")
    """How None is typed and what it does, where it is a value of an option and not its default"""
    default: Any = None
    """MISSING: it has to be given"""
    help: str = ""
    """What it does; "" where a command declares it by itself"""
    unit: str = ""
    """Of the value, as a person calls it; "" where it has none"""
    metavar: str = ""
    """Stands for the value on the command line"""
    flag: str = ""
    """How it is typed"""
    section: str = ""
    """The heading of the help that it stands under"""
    bounds: tuple[float, float] = UNBOUNDED
    """The least and the largest value; nan is never within them"""

    @classmethod
    def of(cls, name: str, hint: Any, form: Form | None = None, **declared: Any) -> Self:
        """Tell from its type what it takes: values of one kind, several of them, or None.

        A form that is not given is that which is usual for the type.
        """
        takes_none = NoneType in get_args(hint)
        kind = next(it for it in get_args(hint) if it is not NoneType) if takes_none else hint
        is_many = get_args(kind)[1:] == (Ellipsis,)
        kind = get_args(kind)[0] if is_many else kind
        taken: dict[str, Any] = {"kind": kind, "is_many": is_many, "takes_none": takes_none}
        return cls(name=name, **taken, form=form or find_form(kind), **declared)

    def read(self, value: Any) -> Any:
        """Make its value of what was given or typed; raises UsageError."""
        if value is None and self.takes_none:
            return None
        if not self.is_many:
            return self.read_one(value)
        # A tuple of numbers is one of several values, as notes print it, and no list of them.
        is_one = isinstance(value, tuple) and sum(isinstance(each, Real) for each in value) > 1
        if not isinstance(value, str | bytes | os.PathLike) and not is_one:
            with suppress(TypeError):  # it is not several values
                return tuple(map(self.read_one, value))
        return (self.read_one(value),)

    def read_one(self, value: Any) -> Any:
        """Make one value of what was given or typed.

        Raises
        ------
        UsageError
            It is not of the type: there are too many or too few numbers, an angle is in degrees,
            and so on.
        """
        if self.kind in {Pose, PoseSample} and isinstance(value, self.kind):
            return value
        try:
            return self.form.read(value)
        except UsageError as error:
            fix = error.fix or self._tell(value)
            where = error.where or f"`{self.name}={value}`"
            raise UsageError(error.found, where=where, fix=fix) from None
        except (TypeError, ValueError, OverflowError):
            if self.none[0] and str(value) == self.none[0]:
                return None
            raise UsageError(f"`{self.name}` is {value!r}", fix=self._tell(value)) from None

    def _tell(self, value: Any) -> str:
        """Say what to give; what is typed is one of several values, and no list."""
        is_list = self.is_many and not isinstance(value, str)
        none = f", or {self.none[0]}, {self.none[1]}" if self.none[1] else ""
        return f"give {'a list, each item ' * is_list}{self.form.text}{none}"

    def write(self, value: Any) -> list[str]:
        """Write its value as it is typed, once for each of several."""
        several = value if self.is_many else [value]
        return [self.none[0] if each is None else self.form.write(each) for each in several]

    def describe(self) -> str:
        """Write its name, default, unit or form, and help, as a text for Python has it."""
        default = f'"{self.default}"' if isinstance(self.default, str) else self.default
        none = f" None: {self.none[1]}." if self.none[1] else ""
        return f"{self.name} = {default} ({self.unit or self.form.text}): {self.help}{none}"


def option(default: Any, text: str = "", **declared: Any) -> Any:
    """Declare an option as a field of a dataclass, or a group of options that is one.

    A default that is a function is called for each set of options.

    Parameters
    ----------
    declared
        Fields of `Option` that are not as usual; a flag without dashes. Usual are the form of the
        type, the unit as the metavar, the name without its unit as the flag, and the section of the
        group.
    """
    metadata = {"option": {"help": text, **declared}}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


@cache
def find_hints(kind: Any) -> dict[str, Any]:
    """Find the types of the fields of a dataclass, which takes long where it is done often."""
    return get_type_hints(kind)


def list_options(kind: Any, section: str = "") -> dict[str, Option]:
    """List the options of a dataclass by their names, those in groups, too."""
    found: dict[str, Option] = {}
    for each in fields(kind):
        name, hint = each.name, find_hints(kind)[each.name]
        declared = each.metadata.get("option", {})
        if is_dataclass(hint):
            found |= list_options(hint, declared.get("section", section))
            continue
        make, plain = each.default_factory, name.removesuffix("_s").replace("_", "-")
        usual = {"metavar": declared.get("unit", "").upper(), "section": section}
        known = {
            "default": each.default if make is MISSING else make(),
            "flag": f"--{declared.get('flag', plain)}",
        }
        found[name] = Option.of(name, hint, **{**usual, **declared, **known})
    return found


def list_values(options: Any) -> dict[str, Any]:
    """List the value of each option by its name, those in groups, too."""
    found: dict[str, Any] = {}
    for each in fields(options):
        value = getattr(options, each.name)
        is_group = is_dataclass(find_hints(cast(Any, type(options)))[each.name])
        found |= list_values(value) if is_group else {each.name: value}
    return found


def read_value(name: str, hint: Any, value: Any, form: Form | None = None) -> Any:
    """Convert what a caller gave to a type; raises UsageError where it is not of it.

    Parameters
    ----------
    form
        What a value looks like, or each of several; None: as usual for the type.
    """
    return Option.of(name, hint, form).read(value)


def take(kind: type[Options], values: Mapping[str, Any]) -> Options:
    """Make options of the values that are named like its fields, or like those of its groups."""
    made = {}
    for name, hint in find_hints(cast(Any, kind)).items():
        if name in values:
            made[name] = values[name]
        elif is_dataclass(hint):
            made[name] = take(cast(type[Any], hint), values)
    return kind(**made)


def check_bounds(options: Any) -> None:
    """Refuse a value out of the bounds of its option; raises UsageError with what to give."""
    for each in fields(options):
        value = getattr(options, each.name)
        declared = each.metadata.get("option", {})
        is_number = isinstance(value, int | float)
        is_possible = is_number or (value is None and "none" in declared)
        if isinstance(each.default, float) and not is_possible:
            raise UsageError(f"`{each.name}` is {value!r}", fix="give a number")
        low, high = declared.get("bounds", UNBOUNDED)
        if "bounds" in declared and is_number and not low <= value <= high:
            least = "more than 0" if low == ABOVE_ZERO else f"{low:g}"
            most = f" to {high:g}" if math.isfinite(high) else " or more" * (low != ABOVE_ZERO)
            raise UsageError(f"`{each.name}={value}` is not possible", fix=f"give {least}{most}")


def read_options(
    kind: type[Options], given: Mapping[str, Any], call: str, of_a_build: Container[str] = ()
) -> Options:
    """Make options of the values that a caller gave by name.

    None leaves an option at its default, unless None is one of its values.

    Parameters
    ----------
    kind
        A dataclass of options; those in a group, a dataclass in it, are given by name, too.
    call
        The function that was called, for the error.
    of_a_build
        Options that it does not take, but build_map does.

    Raises
    ------
    UsageError
        No option has such a name, or a value is not what the option takes.
    """
    known = {name: it for name, it in list_options(kind).items() if name not in of_a_build}
    for name in given:
        if name not in known:
            fix = guess(name, known) or f"see help(occmap.{call})"
            fix = "build_map takes it" if name in of_a_build else fix
            raise UsageError(f"{call} has no option {name!r}", fix=fix)
    values = {
        name: known[name].read(value)
        for name, value in given.items()
        if value is not None or known[name].takes_none or known[name].default is MISSING
    }
    return take(kind, values)


def describe_options(kind: Any) -> Iterator[str]:
    """Write the options of a dataclass as lines of a docstring."""
    for each in list_options(kind).values():
        yield from textwrap.wrap(each.describe(), 90, subsequent_indent="    ")
