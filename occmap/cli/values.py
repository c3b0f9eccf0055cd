"""How the text of an option becomes a value: lists of numbers, and names from an enum."""

import math
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any

import click

from occmap.cli.console import Console, Verbosity
from occmap.errors import UsageError
from occmap.keywords import refuse_degrees
from occmap.types import Box, Pose, PoseSample
from occmap.wording import count

PATH = click.Path(path_type=Path, readable=False)
"""Where click would look whether it can be read, occmap's own error says more."""
FROM_SCANS = "auto"
"""The --align that the scans are to tell."""
SIZES = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
POSE_FORM = "write x,y,yaw or x,y,yaw,roll,pitch in metres and radians, such as 0.1,0,3.14159"
TRANSFORM_FORM = "write parent,child,x,y,z,roll,pitch,yaw in metres and radians"


def parse_sensor_pose(text: str) -> Pose:
    """Read where a laser is mounted.

    Raises
    ------
    UsageError
        The text is not of the form x,y,yaw[,roll,pitch].
    """
    where = f"--sensor-pose {text}"
    words = text.split(",")
    if len(words) not in (3, 5):
        found = f"{count(len(words), 'value')} where 3 or 5 belong"
        raise UsageError(found, where=where, fix=POSE_FORM)
    x, y, yaw, roll, pitch, *_ = [*read_numbers(words, where, POSE_FORM), 0.0, 0.0]
    refuse_degrees((yaw, roll, pitch), where)
    return Pose.from_xyzrpy((x, y, 0.0), (roll, pitch, yaw))


def parse_static(text: str) -> PoseSample:
    """Read a fixed transform.

    Raises
    ------
    UsageError
        The text is not of the form parent,child,x,y,z,roll,pitch,yaw.
    """
    where = f"--static-tf {text}"
    words = [word.strip() for word in text.split(",")]
    if len(words) != 8 or not all(words[:2]):
        raise UsageError("not two frames and six numbers", where=where, fix=TRANSFORM_FORM)
    x, y, z, roll, pitch, yaw = read_numbers(words[2:], where, TRANSFORM_FORM)
    refuse_degrees((roll, pitch, yaw), where)
    pose = Pose.from_xyzrpy((x, y, z), (roll, pitch, yaw))
    return PoseSample(0, words[0], words[1], pose, static=True)


def parse_size(text: str) -> int:
    """Read a number of bytes such as 256MB; raises UsageError where it is none of at least 1 kB."""
    where, form = f"--slice {text}", "write a size such as 256MB or 1GB"
    number = text.upper().rstrip("KMGTB")
    unit = text.upper().removeprefix(number).removesuffix("B")
    (size,) = read_numbers([number], where, form)
    if unit not in SIZES or not size * SIZES[unit] >= 1000:
        raise UsageError("is no size of a part of a log", where=where, fix=form)
    return round(size * SIZES[unit])


def parse_sector(text: str) -> tuple[float, float]:
    """Read two bearings; raises UsageError where there are not two numbers, or they are degrees."""
    form = "write FROM,TO in radians, counter-clockwise, such as 2.5,-2.5"
    where = f"--ignore-sector {text}"
    start, end = read_list(text, 2, where, form)
    refuse_degrees((start, end), where)
    return start, end


def parse_box(text: str) -> Box:
    """Read the lowest and the highest x and y; raises UsageError where that is no box."""
    form = "write x_min,y_min,x_max,y_max in metres, such as -0.4,-0.3,0.2,0.3"
    x_min, y_min, x_max, y_max = read_list(text, 4, f"--footprint {text}", form)
    return x_min, y_min, x_max, y_max


def parse_extent(text: str) -> Box:
    """Read what a map covers; raises UsageError where there are not four numbers."""
    form = "write x_min,y_min,x_max,y_max in metres, such as 0,0,5,4"
    x_min, y_min, x_max, y_max = read_list(text, 4, f"--extent {text}", form)
    return x_min, y_min, x_max, y_max


def parse_transform(text: str) -> Pose:
    """Read where a log's map frame lies in the map; raises UsageError where that is no pose."""
    form = "write x,y,yaw in metres and radians, such as 12.5,-3,1.5708"
    x, y, yaw = read_list(text, 3, f"--transform {text}", form)
    refuse_degrees((yaw,), f"--transform {text}")
    return Pose.planar(x, y, yaw)


def parse_align(text: str) -> float | None:
    """Read an angle in degrees, or the word that leaves it to the scans.

    Raises
    ------
    UsageError
        It is neither.
    """
    form = f"write degrees such as 12.5, or {FROM_SCANS}"
    return None if text == FROM_SCANS else read_numbers([text], f"--align {text}", form)[0]


def read_list(text: str, size: int, where: str, form: str) -> list[float]:
    """Read so many numbers with commas between.

    Raises
    ------
    UsageError
        There are more or fewer, or one is none.
    """
    words = text.split(",")
    if len(words) != size:
        found = f"{count(len(words), 'value')} where {size} belong"
        raise UsageError(found, where=where, fix=form)
    return read_numbers(words, where, form)


def read_numbers(words: list[str], where: str, form: str) -> list[float]:
    """Read finite decimal numbers.

    Raises
    ------
    UsageError
        Naming the first word that is none, and the form that is expected.
    """
    numbers = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise UsageError(f"{word.strip()!r} is not a number", where=where, fix=form)
        numbers.append(number)
    return numbers


def read_by(parse: Callable[[str], Any]) -> dict[str, Any]:
    """Return the settings of an option, given once or often, whose text a function reads."""

    def convert(_ctx: click.Context, _param: click.Parameter, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(parse(text) for text in value)
        return None if value is None else parse(value)

    return {"callback": convert}


def take_one(_ctx: click.Context, param: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Take what an option was given once, or None; raises UsageError where it was given twice."""
    if len(values) > 1:
        given = ", ".join(map(str, values))
        raise UsageError(
            f"{param.opts[-1]} takes one file, and is given {len(values)}: {given}",
            fix="run the command once for each",
        )
    return next(iter(values), None)


def one_of(kind: type[StrEnum]) -> dict[str, Any]:
    """Return the settings of an option whose values are the members of an enum."""
    return {
        "type": click.Choice([member.value for member in kind]),
        "callback": lambda _ctx, _param, value: kind(value),
    }


def set_verbosity(level: Verbosity) -> Any:
    """Return the callback of a flag that says how much to tell."""

    def choose(ctx: click.Context, _param: click.Parameter, given: bool) -> None:
        if given:
            ctx.ensure_object(Console).verbosity = level

    return choose
