"""What recorded values must be: numbers, times, text and ranges are checked as they come in."""

from contextlib import suppress
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from occmap.errors import DamageError


def as_float32(values: ArrayLike) -> NDArray[np.float32]:
    """Convert to float32, as ranges are kept; too large a number becomes infinite."""
    with np.errstate(over="ignore"):
        return np.asarray(values).astype(np.float32)


def as_number(value: Any) -> float:
    """Convert a number, which may be infinite or NaN, to a float; raises DamageError."""
    if type(value) is float:
        return value
    if not isinstance(value, Real) or isinstance(value, bool):
        raise DamageError(f"holds {shorten(value)} where a number belongs")
    try:
        return float(value)
    except OverflowError:
        raise DamageError("holds a number that no float can hold") from None


def as_stamp(value: Any) -> int:
    """Convert a time in whole nanoseconds to an int of 64 bits; raises DamageError."""
    if not isinstance(value, (int, np.integer)) or not -(2**63) <= value < 2**63:
        raise DamageError(f"holds {shorten(value)} where a time of 64 bits belongs")
    return int(value)


def parse_seconds(text: str) -> int:
    """Convert seconds, as text, to nanoseconds exactly; a float would round to 0.2 us.

    Raises
    ------
    ValueError
        The text is not a number, or its nanoseconds do not fit 64 bits.
    """
    with suppress(ArithmeticError):  # what decimal raises for words and for NaN
        nanoseconds = Decimal(text).scaleb(9)
        if abs(nanoseconds) < 2**63:
            return round(nanoseconds)
    raise ValueError(f"{shorten(text)} is not a time in seconds")


def parse_nanoseconds(text: str) -> int:
    """Convert whole nanoseconds, as text; raises ValueError where they do not fit 64 bits."""
    with suppress(ValueError):
        if abs(nanoseconds := int(text)) < 2**63:
            return nanoseconds
    raise ValueError(f"{shorten(text)} is not a time in nanoseconds")


BEYOND_A_TURN = 7.0
JUMP_SHARE = 0.01
"""Headings that are radians stay within a turn, or count on without a jump of half a turn"""


def suspect_degrees(yaw: ArrayLike) -> str:
    """Say if headings, one after the other, can hardly be radians; "" if they can."""
    known = np.asarray(yaw, np.float64)
    known = known[np.isfinite(known)]
    jumps = np.abs(np.diff(known)) > np.pi
    if len(jumps) and np.median(np.abs(known)) > BEYOND_A_TURN and jumps.mean() > JUMP_SHARE:
        return (
            "the yaws of the poses jump far beyond a turn: angles are radians; are these degrees?"
        )
    return ""


def as_text(value: Any) -> str:
    """Check that text can be written as UTF-8; raises DamageError."""
    if not isinstance(value, str):
        raise DamageError(f"holds {shorten(value)} where text belongs")
    try:
        if not value.isascii():
            value.encode()
    except UnicodeEncodeError:
        raise DamageError("holds text that is not Unicode") from None
    return value


def as_ranges(values: ArrayLike) -> NDArray[np.float32]:
    """Copy one row of numbers as float32, (B,); raises DamageError."""
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError):  # rows that differ in length, and the like
        raise DamageError("holds ranges that are not numbers in one row") from None
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        raise DamageError(f"holds {array.ndim}-dimensional ranges of {array.dtype}")
    return array.copy() if array.dtype == np.float32 else as_float32(array)


def shorten(value: object) -> str:
    """Quote a value in at most 40 characters; a huge number is only called one."""
    if isinstance(value, int) and abs(value) >= 2**63:
        return "a number beyond 64 bits"
    text = repr(value) if isinstance(value, str | int | float | None) else type(value).__name__
    return text if len(text) <= 40 else f"{text[:37]}..."
