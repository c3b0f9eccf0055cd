"""Transforms of many messages at a stroke, where these are laid out alike.

A log holds tens of thousands, and the frames that they name, so where each number lies, hardly
ever change.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.readers.messages import is_static_topic
from occmap.readers.ros_cdr import align, count_at, read_transforms
from occmap.types import Bool, Int64, PoseBatch, UInt8

RawTransforms: TypeAlias = tuple[bytes, int]
"""A tf2_msgs/TFMessage in CDR, its encapsulation header included, and its record time (ns)."""
LITTLE_ENDIAN = b"\0\1"
MOST_KINDS = 16
"""Messages of one length that name other frames are told apart, but not without end."""


class _Fields(NamedTuple):
    """Where the numbers of one transform lie in its message."""

    stamp: int
    pose: int
    parent: str
    child: str


def read_alike(
    messages: list[RawTransforms], topic: str
) -> tuple[list[PoseBatch], list[RawTransforms]]:
    """Read messages of one length.

    Returns
    -------
    batches, others
        The samples of each transform, and the messages of kinds beyond `MOST_KINDS`.

    Raises
    ------
    ValueError, struct.error, OverflowError
        The first message of its kind, or a record time, is damaged.
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
        fields = _locate(first, topic)
        fixed = _mark_fixed(length, fields)
        alike = (raw[left][:, fixed] == raw[left[0], fixed]).all(axis=1)
        rows = left[alike]
        batches += (_stack(raw[rows], record_ns[rows], each, topic) for each in fields)
        left = left[~alike]
    return batches, [messages[i] for i in left]


def _locate(message: bytes, topic: str) -> list[_Fields]:
    """Find the numbers of a message.

    Raises
    ------
    ValueError, struct.error
        The message is damaged, or big-endian.
    """
    if message[:2] != LITTLE_ENDIAN:
        raise ValueError("the message is not little-endian")
    data, at = memoryview(message), 8
    fields = []
    for sample in read_transforms(data, topic, 0):
        stamp = align(at, 4)
        child = align(stamp + 12 + count_at(data, stamp + 8), 4)
        pose = align(child + 4 + count_at(data, child), 8)
        fields.append(_Fields(stamp, pose, sample.parent, sample.child))
        at = pose + 56
    return fields


def _mark_fixed(length: int, fields: list[_Fields]) -> Bool:
    """(L,): which bytes must be the same in messages that have their numbers in these places."""
    fixed = np.ones(length, np.bool_)
    for each in fields:
        fixed[each.stamp : each.stamp + 8] = False
        fixed[each.pose : each.pose + 56] = False
    return fixed


def _stack(raw: UInt8, record_ns: Int64, fields: _Fields, topic: str) -> PoseBatch:
    """Read one transform of every message (M, L)."""
    seconds = _view(raw, fields.stamp, "<i4", 1)[:, 0].astype(np.int64)
    nanoseconds = _view(raw, fields.stamp + 4, "<u4", 1)[:, 0]
    return PoseBatch(
        seconds * 1_000_000_000 + nanoseconds,
        record_ns,
        _view(raw, fields.pose, "<f8", 7).astype(np.float64),
        fields.parent,
        fields.child,
        is_static_topic(topic),
        topic,
    )


def _view(raw: UInt8, at: int, kind: str, count: int) -> NDArray[Any]:
    """(M, count) numbers from a place in every message."""
    size = count * np.dtype(kind).itemsize
    return np.ascontiguousarray(raw[:, at : at + size]).view(kind)
