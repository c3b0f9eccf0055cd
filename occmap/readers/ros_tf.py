"""Transforms of many messages at once, where these are laid out alike.

A log holds tens of thousands, and the frames that they name, so where each number lies, hardly
ever change.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.readers.ros_columns import (
    LITTLE_ENDIAN,
    align,
    count_at,
    find_alike,
    read_columns,
    read_stamps,
)
from occmap.readers.ros_decode import FromBytes
from occmap.readers.ros_source import Encoding
from occmap.types import Int64, PoseBatch, PoseSample, UInt8

RawTransforms: TypeAlias = tuple[bytes, int]
"""A tf2_msgs/TFMessage as it is in the log, and its record time (ns)."""
MOST_KINDS = 16
"""Messages of one length that name other frames are told apart, but not without end."""


class _Fields(NamedTuple):
    """Where the numbers of one transform lie in its message."""

    header: int
    """A ROS 1 header begins with a number that counts messages, then the stamp follows."""
    stamp: int
    pose: int


def read_alike(
    messages: list[RawTransforms], encoding: Encoding, read: FromBytes[list[PoseSample]]
) -> tuple[list[PoseBatch], list[RawTransforms]]:
    """Read messages of one length.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in those that are like it.

    Returns
    -------
    batches, others
        The samples of each transform, and the messages of kinds beyond `MOST_KINDS`, or all where
        the first is not little-endian.

    Raises
    ------
    DamageError
        The first message of its kind is damaged.
    """
    length = len(messages[0][0])
    raw = np.frombuffer(b"".join(data for data, _ in messages), np.uint8).reshape(-1, length)
    record_ns = np.array([record_ns for _, record_ns in messages], np.int64)
    batches: list[PoseBatch] = []
    left = np.arange(len(messages))
    for _ in range(MOST_KINDS):
        if not len(left):
            break
        first = messages[left[0]][0]
        if encoding == "cdr" and not first.startswith(LITTLE_ENDIAN):
            break
        # Decoded first: that it could be says that all its parts lie within the message.
        samples = read(memoryview(first), 0)
        fields = _locate(first, encoding)
        stamps = [(each.header, each.stamp + 8) for each in fields]
        poses = [(each.pose, each.pose + 56) for each in fields]
        alike = find_alike(raw[left], stamps + poses)
        rows = left[alike]
        own, own_ns = raw[rows], record_ns[rows]  # once: a message may hold very many transforms
        batches += (_stack(own, own_ns, *each) for each in zip(fields, samples, strict=True))
        left = left[~alike]
    return batches, [messages[i] for i in left]


def _locate(message: bytes, encoding: Encoding) -> list[_Fields]:
    """Find the numbers of a message."""
    data = memoryview(message)
    at = 4 if encoding == "cdr" else 0
    count, at = count_at(data, at), at + 4
    fields = []
    for _ in range(count):
        header = align(at, 4) if encoding == "cdr" else at
        stamp = header if encoding == "cdr" else header + 4
        child = _pass_name(data, stamp + 8, encoding)
        end = _pass_name(data, child, encoding)
        pose = align(end, 8) if encoding == "cdr" else end
        fields.append(_Fields(header, stamp, pose))
        at = pose + 56
    return fields


def _pass_name(data: memoryview, at: int, encoding: Encoding) -> int:
    """Find where a name ends that begins, with its length, at an offset or, in CDR, behind it."""
    start = align(at, 4) if encoding == "cdr" else at
    return start + 4 + count_at(data, start)


def _stack(raw: UInt8, record_ns: Int64, fields: _Fields, like: PoseSample) -> PoseBatch:
    """Read one transform of every message (M, L)."""
    return PoseBatch(
        read_stamps(raw, fields.stamp),
        record_ns,
        read_columns(raw, fields.pose, "<f8", 7),
        like.parent,
        like.child,
        like.static,
        like.topic,
    )
