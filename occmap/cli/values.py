"""How the text of an option becomes a value: lists of numbers, and names from an enum."""

import math
import re
from enum import StrEnum
from pathlib import Path
from typing import Any

import click

from occmap.command import spell_flag
from occmap.errors import UsageError
from occmap.keywords import drop_none, find_form, list_options
from occmap.options import BuildOptions
from occmap.wording import count

HINTS = list_options(BuildOptions)
PATH = click.Path(path_type=Path, readable=False)
"""Where click would look whether it can be read, occmap's own error says more."""
FROM_SCANS = "auto"
"""The value of --align that leaves the angle to the scans."""
FORM = re.compile(r"\((.*?)\)")
"""A tuple, as it is written in Python"""
SIZES = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}


def parse_numbers(name: str, text: str) -> Any:
    """Read an option of several numbers with commas between.

    Raises
    ------
    UsageError
        There are too many or too few numbers, one is not a number, or an angle is in degrees.
    """
    read, form = find_form(drop_none(HINTS[name]))
    typed = FORM.sub(lambda found: found[1].replace(" ", ""), form)
    where, fix = f"{spell_flag(name)} {text}", f"write {typed}"
    values = [value.strip() for value in text.split(",")]
    frames = 2 if name == "static_transforms" else 0
    try:
        return read([*values[:frames], *read_numbers(values[frames:], where, fix)])
    except UsageError as error:
        raise UsageError(error.found, where=where, fix=error.fix or fix) from None
    except ValueError:
        belong = [str(each.count(",") + 1) for each in FORM.findall(form.partition(" in ")[0])]
        found = f"{count(len(values), 'value')} where {' or '.join(belong)} belong"
        raise UsageError(found, where=where, fix=fix) from None


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
