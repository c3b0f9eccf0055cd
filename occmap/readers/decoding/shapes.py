"""The fields that a converter reads, taken out of whatever was decoded, each with its type.

JSON holds anything anywhere, and a log's own definitions may give any field any type. So what is
decoded by them is brought into shape before a converter sees it; a message that does not fit is
damaged, and every other error in a converter is a fault of occmap's.
"""

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np

from occmap.errors import DamageError
from occmap.types import Float64, UInt8
from occmap.values import as_number, as_stamp, as_text, shorten

Shape: TypeAlias = "Mapping[str, Shape] | list[Shape] | Callable[[Any], Any]"
"""The fields of a message, a list of messages, or what brings a value to its type."""

VECTOR: Shape = {"x": as_number, "y": as_number, "z": as_number}
QUATERNION: Shape = {"x": as_number, "y": as_number, "z": as_number, "w": as_number}
POSE: Shape = {"position": VECTOR, "orientation": QUATERNION}
HEADER: Shape = {"stamp": {"sec": as_stamp, "nanosec": as_stamp}, "frame_id": as_text}


def take(value: Any, shape: Shape) -> Any:
    """Take what a shape names out of a decoded message.

    Returns
    -------
    message
        An object with the shape's fields as attributes, and with no others.

    Raises
    ------
    DamageError
        A field is absent, or its value is of another type.
    """
    if isinstance(shape, Mapping):
        fields = {name: take(get_field(value, name), part) for name, part in shape.items()}
        return SimpleNamespace(**fields)
    if isinstance(shape, list):
        if not isinstance(value, Sequence) or isinstance(value, str | bytes):
            raise DamageError(f"holds {type(value).__name__} where a list of messages belongs")
        return [take(item, shape[0]) for item in value]
    return shape(value)


def get_field(message: Any, name: str) -> Any:
    """Get a field of a JSON object or of a decoded message; None where it is absent."""
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def as_row(values: Any) -> Float64:
    """Bring a list to an array of numbers (B,).

    JSON has no infinity: writers leave a null or a name, which NumPy reads as nan or infinity.
    """
    try:
        with np.errstate(invalid="ignore"):  # a flipped bit makes a signalling NaN of infinity
            row = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        row = np.empty(())
    if row.ndim != 1:
        raise DamageError("holds something else where a row of numbers belongs")
    return row


def as_flag(value: Any) -> bool:
    """Take a yes or no."""
    if not isinstance(value, int):
        raise DamageError(f"holds {shorten(value)} where a yes or no belongs")
    return bool(value)


def as_bytes(values: Any) -> UInt8:
    """Take bytes (N,) as rosbags gives them."""
    if not isinstance(values, np.ndarray) or values.dtype.itemsize != 1:
        raise DamageError("holds something else where bytes belong")
    return values.view(np.uint8)
