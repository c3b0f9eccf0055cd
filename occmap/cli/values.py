"""How the text of an option becomes a value: lists of numbers, and names from an enum."""

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import click

from occmap.command import spell_flag
from occmap.errors import UsageError
from occmap.keywords import read_pose, read_sector, read_transform
from occmap.wording import count

PATH = click.Path(path_type=Path, readable=False)
"""Where click would look whether it can be read, occmap's own error says more."""
FROM_SCANS = "auto"
"""The value of --align that leaves the angle to the scans."""
SIZES = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


class Form(NamedTuple):
    """How an option of several numbers is written, and what it makes of them."""

    sizes: tuple[int, ...]
    """How many numbers there may be"""
    read: Callable[[Sequence[Any]], Any]
    fix: str
    words: int = 0
    """How many words go before the numbers"""


NUMBERS = {
    "sensor_pose": Form(
        (3, 5),
        read_pose,
        "write x,y,yaw or x,y,yaw,roll,pitch in metres and radians, such as 0.1,0,3.14159",
    ),
    "transform": Form(
        (3,), read_pose, "write x,y,yaw in metres and radians, such as 12.5,-3,1.5708"
    ),
    "static_transforms": Form(
        (6,),
        read_transform,
        "write parent,child,x,y,z,roll,pitch,yaw in metres and radians",
        words=2,
    ),
    "ignore_sectors": Form(
        (2,), read_sector, "write FROM,TO in radians, counter-clockwise, such as 2.5,-2.5"
    ),
    "footprint": Form(
        (4,), tuple, "write x_min,y_min,x_max,y_max in metres, such as -0.4,-0.3,0.2,0.3"
    ),
    "extent": Form((4,), tuple, "write x_min,y_min,x_max,y_max in metres, such as 0,0,5,4"),
}
"""By the names of the options"""


def parse_numbers(name: str, text: str) -> Any:
    """Read an option of several numbers with commas between.

    Raises
    ------
    UsageError
        There are too many or too few numbers, one is not a number, or an angle is in degrees.
    """
    form, where = NUMBERS[name], f"{spell_flag(name)} {text}"
    values = [value.strip() for value in text.split(",")]
    words, numbers = values[: form.words], values[form.words :]
    if len(numbers) not in form.sizes or not all(words):
        sizes = " or ".join(str(form.words + size) for size in form.sizes)
        raise UsageError(
            f"{count(len(values), 'value')} where {sizes} belong", where=where, fix=form.fix
        )
    try:
        return form.read([*words, *read_numbers(numbers, where, form.fix)])
    except UsageError as error:
        raise error.placed(where) from None


def parse_size(text: str) -> int:
    """Read a number of bytes such as 256MB; raises UsageError where it is not 1 kB or more."""
    where, form = f"--slice {text}", "write a size such as 256MB or 1GB"
    number = text.upper().rstrip("KMGTB")
    unit = text.upper().removeprefix(number).removesuffix("B")
    (size,) = read_numbers([number], where, form)
    if unit not in SIZES or not size * SIZES[unit] >= 1000:
        raise UsageError("is not a size of 1 kB or more", where=where, fix=form)
    return round(size * SIZES[unit])


def parse_align(text: str) -> float | None:
    """Read an angle in degrees, or the word that leaves it to the scans.

    Raises
    ------
    UsageError
        It is neither.
    """
    form = f"write degrees such as 12.5, or {FROM_SCANS}"
    return None if text == FROM_SCANS else read_numbers([text], f"--align {text}", form)[0]


def read_numbers(words: list[str], where: str, form: str) -> list[float]:
    """Read finite decimal numbers.

    Raises
    ------
    UsageError
        Naming the first word that is not a number, and the form that is expected.
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


def take_one(_ctx: click.Context, param: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Take the only value of an option, None if there is none; raises UsageError for several."""
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
