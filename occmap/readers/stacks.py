"""Scans and transforms of many messages at once, where these are laid out alike.

A log holds tens of thousands of both, and in those of one laser, or of one pair of frames, only
times, ranges and poses differ. Stacked as rows, a field of all messages is one slice of an array.
Decoded one by one instead, scans make a whole build of 20,000 take 37% longer, transforms 28%. Only
messages that are defined as ROS defines them are stacked, and only once one could be decoded,
which shows that all its parts lie within it.
"""

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.readers.messages import FromBytes
from occmap.types import Bool, Int64, PoseBatch, PoseSample, Scan, ScanRun, UInt8

Stacked: TypeAlias = tuple[bytes, int]
"""A message of one channel and length, and its record time (ns)."""

SHORTEST_RUN = 64
"""Fewer scans are read one by one, to be stacked with others of their kind."""
MOST_GROUPS = 16
"""Messages of one length are grouped by the frames that they name, but not into more groups."""
_LITTLE_ENDIAN = b"\0\1"
"""What a CDR message begins with that can be read so."""
_STAMP = 4
"""Where a stamp begins: after the encapsulation of CDR, or the sequence number of ROS 1."""
_FRAME = 16
"""Where the letters of a scan's frame begin, after their number."""
_ANGLE_MAX, _TIME_INCREMENT, _RANGE_MIN, _RANGES = 4, 12, 20, 32
"""Bytes from the first of the seven floats on. The largest angle and the scan time are not used."""
_POSE = 56
"""Bytes of a translation and a rotation."""


def read_scan_run(
    messages: Sequence[Stacked], encoding: str, read: FromBytes[list[Scan]]
) -> tuple[list[ScanRun], Sequence[Stacked]]:
    """Read scans of one length that follow one another.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in all of them.

    Returns
    -------
    runs, others
        One run, or all messages where they are few, not little-endian, or not alike but for times
        and ranges.

    Raises
    ------
    DamageError
        The first message is damaged.
    """
    if len(messages) < SHORTEST_RUN or not _is_stackable(messages[0][0], encoding):
        return [], messages
    # Decoded first: that it could be says that all its parts lie within the message.
    (first,) = read(memoryview(messages[0][0]), messages[0][1])
    raw = _stack(messages)
    floats = _align(_FRAME + _count_at(messages[0][0], _FRAME - 4), 4, encoding)
    ranges = floats + _RANGES
    intensities = ranges + 4 * len(first.ranges)
    free = (
        _span_stamp(_STAMP, encoding),
        (floats + _ANGLE_MAX, floats + _ANGLE_MAX + 4),
        (floats + _TIME_INCREMENT, floats + _RANGE_MIN),
        (ranges, intensities),
        (intensities + 4, raw.shape[1]),
    )
    if not _find_alike(raw, free).all():
        return [], messages
    run = ScanRun(
        first,
        _read_stamps(raw, _STAMP),
        np.array([record_ns for _, record_ns in messages], np.int64),
        _read_columns(raw, ranges, "<f4", len(first.ranges)),
        _read_columns(raw, floats + _TIME_INCREMENT, "<f4")[:, 0].astype(np.float64),
    )
    return [run], []


def read_transforms(
    messages: Sequence[Stacked], encoding: str, read: FromBytes[list[PoseSample]]
) -> tuple[list[PoseBatch], Sequence[Stacked]]:
    """Read messages of transforms of one length.

    Parameters
    ----------
    read
        Reads a single message: it tells what is the same in those that are like it.

    Returns
    -------
    batches, others
        The samples of each transform, and the messages of groups beyond `MOST_GROUPS`, or all where
        the first is not little-endian.

    Raises
    ------
    DamageError
        The first message of its group is damaged.
    """
    raw = _stack(messages)
    record_ns = np.array([record_ns for _, record_ns in messages], np.int64)
    batches: list[PoseBatch] = []
    left = np.arange(len(messages))
    for _ in range(MOST_GROUPS):
        if not len(left) or not _is_stackable(first := messages[int(left[0])][0], encoding):
            break
        # Decoded first: that it could be says that all its parts lie within the message.
        samples = read(memoryview(first), 0)
        places = _locate(first, encoding)
        stamps = [_span_stamp(stamp, encoding) for stamp, _ in places]
        alike = _find_alike(raw[left], stamps + [(pose, pose + _POSE) for _, pose in places])
        rows = left[alike]
        own, own_ns = raw[rows], record_ns[rows]  # once: a message may hold very many transforms
        for (stamp, pose), sample in zip(places, samples, strict=True):
            times, poses = _read_stamps(own, stamp), _read_columns(own, pose, "<f8", 7)
            frames = sample.parent, sample.child, sample.static, sample.topic
            batches.append(PoseBatch(times, own_ns, poses, *frames))
        left = left[~alike]
    return batches, [messages[i] for i in left.tolist()]


def _locate(message: bytes, encoding: str) -> list[tuple[int, int]]:
    """Find where the stamp and the pose of each transform of a message lie."""
    at = 4 if encoding == "cdr" else 0
    count, at = _count_at(message, at), at + 4
    places = []
    for _ in range(count):
        stamp = _align(at, 4, encoding) + (0 if encoding == "cdr" else 4)
        child = _pass_name(message, stamp + 8, encoding)
        pose = _align(_pass_name(message, child, encoding), 8, encoding)
        places.append((stamp, pose))
        at = pose + _POSE
    return places


def _pass_name(message: bytes, at: int, encoding: str) -> int:
    """Find where a name ends that begins, with its length, at an offset or, in CDR, behind it."""
    start = _align(at, 4, encoding)
    return start + 4 + _count_at(message, start)


def _count_at(message: bytes, at: int) -> int:
    """Read the count of what follows, as a sequence and a string begin with one."""
    return int.from_bytes(message[at : at + 4], "little")


def _align(at: int, size: int, encoding: str) -> int:
    """Round an offset up, as CDR does from behind its four encapsulation bytes; ROS 1 does not."""
    return at + (4 - at) % size if encoding == "cdr" else at


def _span_stamp(at: int, encoding: str) -> tuple[int, int]:
    """Find the bytes of a stamp, and of the number that counts messages before it in ROS 1."""
    return at if encoding == "cdr" else at - 4, at + 8


def _is_stackable(message: bytes, encoding: str) -> bool:
    """Whether the numbers of a message lie as NumPy reads them here: little-endian."""
    return encoding == "ros1" or message.startswith(_LITTLE_ENDIAN)


def _stack(messages: Sequence[Stacked]) -> UInt8:
    """Stack messages of one length as rows (M, L)."""
    raw = np.frombuffer(b"".join(data for data, _ in messages), np.uint8)
    return raw.reshape(len(messages), -1)


def _find_alike(raw: UInt8, free: Iterable[tuple[int, int]]) -> Bool:
    """Say which of M messages (M, L) are as the first but for some bytes.

    Parameters
    ----------
    free
        Where spans of bytes that may differ begin and end; the end is outside.

    Returns
    -------
    alike
        (M,)
    """
    fixed = np.ones(raw.shape[1], np.bool_)
    for start, end in free:
        fixed[start:end] = False
    alike: Bool = (raw[:, fixed] == raw[0, fixed]).all(axis=1)
    return alike


def _read_columns(raw: UInt8, at: int, kind: str, count: int = 1) -> NDArray[Any]:
    """Read `count` numbers of a NumPy type that begin at an offset in each of M messages (M, L).

    Returns
    -------
    numbers
        (M, count)
    """
    size = count * np.dtype(kind).itemsize
    return np.ascontiguousarray(raw[:, at : at + size]).view(kind)


def _read_stamps(raw: UInt8, at: int) -> Int64:
    """Read the stamps (M,) in ns of messages (M, L): seconds, then nanoseconds."""
    seconds = _read_columns(raw, at, "<i4")[:, 0].astype(np.int64)
    stamp_ns: Int64 = seconds * 1_000_000_000 + _read_columns(raw, at + 4, "<u4")[:, 0]
    return stamp_ns
