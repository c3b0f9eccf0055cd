"""Scans of many messages at once, where these are laid out alike.

Of the scans of one laser only times and ranges differ, so these lie in the same place in each
message, and what is left to do is to compare and to copy bytes.
"""

from typing import NamedTuple

import numpy as np

from occmap.readers.ros_columns import LITTLE_ENDIAN, align, count_at, read_columns, read_stamps
from occmap.readers.ros_source import Channel, Encoding
from occmap.types import Bool, Scan, ScanRun, UInt8

MOST_BYTES = 1 << 20
"""A run of so many bytes is long enough."""
_STAMP = 4
"""Behind four bytes: of a CDR message its encapsulation, of a ROS 1 header its sequence number."""
_FRAME = 16
"""Where the letters of the frame begin, behind their number."""
_ANGLE_MAX, _TIME_INCREMENT, _SCAN_TIME, _BEAMS = 4, 12, 16, 28
"""Behind the first of the seven floats. Nobody uses the largest angle and the time of a scan."""


class _Layout(NamedTuple):
    """Where the parts of a sensor_msgs/LaserScan begin."""

    floats: int
    ranges: int
    intensities: int
    """Their number; the values follow."""


class RawRun:
    """Messages of one channel and length that follow one another in a file, not yet read."""

    def __init__(self, channel: Channel, length: int) -> None:
        self.channel = channel
        self._length = length
        self._bytes = bytearray()
        self._record_ns: list[int] = []

    def takes(self, channel: Channel, data: memoryview) -> bool:
        """Whether a message belongs to the run, and there is room for it."""
        return (
            channel is self.channel and len(data) == self._length and len(self._bytes) < MOST_BYTES
        )

    def add(self, data: memoryview, record_ns: int) -> None:
        """Copy a message: it is valid only until the next one."""
        self._bytes += data
        self._record_ns.append(record_ns)

    def split(self) -> list[tuple[memoryview, int]]:
        """The messages and when they were recorded (ns)."""
        view, length = memoryview(self._bytes), self._length
        return [
            (view[i * length : (i + 1) * length], record_ns)
            for i, record_ns in enumerate(self._record_ns)
        ]

    def read(self, first: Scan) -> ScanRun | None:
        """Read all messages, given the scan of the first; None where they are not all alike.

        That the first could be decoded says that its parts lie within the message.
        """
        encoding = self.channel.encoding
        raw = np.frombuffer(self._bytes, np.uint8).reshape(-1, self._length)
        if encoding == "cdr" and not self._bytes.startswith(LITTLE_ENDIAN):
            return None
        layout = _locate(memoryview(self._bytes), encoding)
        fixed = _mark_fixed(layout, encoding)
        head, count = raw[:, : layout.ranges], raw[:, layout.intensities : layout.intensities + 4]
        if not (_is_same(head[:, fixed]) and _is_same(count)):
            return None
        return ScanRun(
            first,
            read_stamps(raw, _STAMP),
            np.array(self._record_ns, np.int64),
            read_columns(raw, layout.ranges, "<f4", len(first.ranges)),
            read_columns(raw, layout.floats + _TIME_INCREMENT, "<f4")[:, 0].astype(np.float64),
        )


def _locate(message: memoryview, encoding: Encoding) -> _Layout:
    """Find the parts of a message."""
    floats = _FRAME + count_at(message, _FRAME - 4)
    if encoding == "cdr":
        floats = align(floats, 4)
    ranges = floats + _BEAMS + 4
    return _Layout(floats, ranges, ranges + 4 * count_at(message, floats + _BEAMS))


def _mark_fixed(layout: _Layout, encoding: Encoding) -> Bool:
    """(L,): which bytes before the ranges must be the same in all messages."""
    fixed = np.ones(layout.ranges, np.bool_)
    fixed[_STAMP : _STAMP + 8] = False
    if encoding == "ros1":
        fixed[:_STAMP] = False
    for at in (_ANGLE_MAX, _TIME_INCREMENT, _SCAN_TIME):
        fixed[layout.floats + at : layout.floats + at + 4] = False
    return fixed


def _is_same(rows: UInt8) -> bool:
    """Whether all rows are as the first."""
    return bool((rows == rows[0]).all())
