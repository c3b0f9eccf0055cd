"""What messages of all kinds state in the same way: when, and in which frame."""

from typing import Any


def read_stamp(header: Any) -> int:
    """Read a header's stamp, in ns."""
    stamp_ns: int = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    return stamp_ns


def read_frame(name: str) -> str:
    """Read a frame's name; old logs write `/laser` in one place and `laser` in another."""
    return name.lstrip("/")
