"""The fields of decoded messages, looked up by their dotted names and checked as they are taken.

Messages come decoded from CDR, ROS 1, JSON or protobuf, and a log's own definitions may give any
field any type. Every `get` raises DamageError where a field is absent or of another type.
"""

from base64 import b64decode
from collections.abc import Sequence
from typing import Any

import numpy as np

from occmap.errors import DamageError
from occmap.types import Float64, UInt8
from occmap.values import as_stamp, as_text

_STAMP_NAMES = (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos"))
"""The parts of a time as rosbags, Foxglove's JSON and protobuf name them."""


def look(message: Any, path: str) -> Any:
    """Look for a field of a decoded message by its dotted name; None where it is absent."""
    for name in path.split("."):
        message = message.get(name) if isinstance(message, dict) else getattr(message, name, None)
    return message


def get(message: Any, path: str) -> Any:
    """Get a field likewise."""
    if (value := look(message, path)) is None:
        raise DamageError(f"has no {path}")
    return value


def get_list(message: Any, path: str) -> Sequence[Any]:
    """Get a list of messages."""
    value = get(message, path)
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise DamageError(f"holds {type(value).__name__} where a list of messages belongs")
    return value


def get_whole(message: Any, path: str) -> int:
    """Get a whole number of at most 64 bits."""
    return as_stamp(get(message, path))


def get_stamp(message: Any, path: str) -> int:
    """Get a time in ns."""
    stamp = get(message, path)
    for names in _STAMP_NAMES:
        seconds, nanoseconds = (look(stamp, name) for name in names)
        if nanoseconds is not None:
            return as_stamp(as_stamp(seconds) * 1_000_000_000 + as_stamp(nanoseconds))
    raise DamageError(f"has no {path}")


def get_frame(message: Any, path: str) -> str:
    """Get a frame's name; old logs write `/laser` in one place and `laser` in another."""
    return as_text(get(message, path)).lstrip("/")


def get_header(message: Any) -> tuple[int, str]:
    """Get the time in ns, and the frame, of a ROS message."""
    return get_stamp(message, "header.stamp"), get_frame(message, "header.frame_id")


def get_row(message: Any, path: str) -> Float64:
    """Get a list of numbers (B,).

    JSON has no infinity: writers leave a null or a name, which NumPy reads as nan or infinity.
    """
    try:
        with np.errstate(invalid="ignore"):  # a flipped bit makes a signalling NaN of infinity
            row = np.array(get(message, path), np.float64)
    except (TypeError, ValueError, OverflowError):
        row = np.empty(())
    if row.ndim != 1:
        raise DamageError("holds something else where a row of numbers belongs")
    return row


def get_bytes(message: Any, path: str) -> UInt8:
    """Get bytes (N,): rosbags gives an array, protobuf bytes, and JSON has them as base64."""
    value = get(message, path)
    try:
        if isinstance(value, str):
            value = b64decode(value, validate=True)
        data = np.frombuffer(value, np.uint8)
    except (TypeError, ValueError):
        raise DamageError("holds something else where bytes belong") from None
    return data
