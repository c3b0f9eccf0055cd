"""Values as scans and pose samples: what each field of a format means."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from occmap.readers import Role
from occmap.readers.decoding.shapes import Shape
from occmap.readers.options import ReaderOptions
from occmap.types import PoseSample, Scan

ToScan: TypeAlias = Callable[[ReaderOptions, Any, str, int], Scan]
"""From what the user chose, a decoded message, its topic and its record time in ns."""
ToPoses: TypeAlias = Callable[[Any, str, int], list[PoseSample]]


class MessageType(NamedTuple):
    """What messages of a type are for, and what reads them."""

    role: Role
    shape: Shape
    """The fields that are read, for logs that define the type in another way than ROS does"""
    to_scan: ToScan | None = None
    to_poses: ToPoses | None = None


def read_stamp(header: Any) -> int:
    """Read a header's stamp, in ns."""
    stamp_ns: int = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    return stamp_ns


def read_frame(name: str) -> str:
    """Read a frame's name; old logs write `/laser` in one place and `laser` in another."""
    return name.lstrip("/")
