"""Scans of many messages at once, where these are laid out alike.

Of the scans of one laser only times and ranges differ, so these lie in the same place in each
message, and what is left to do is to compare and to copy bytes.
"""

import numpy as np

from occmap.readers.ros_columns import (
    LITTLE_ENDIAN,
    align,
    count_at,
    find_alike,
    read_columns,
    read_stamps,
)
from occmap.readers.ros_source import Channel, RawMessages
from occmap.types import Scan, ScanRun

MOST_BYTES = 1 << 20
"""A run that has reached this size (bytes) is long enough."""
_STAMP = 4
"""Behind four bytes: of a CDR message its encapsulation, of a ROS 1 header its sequence number."""
_FRAME = 16
"""Where the letters of the frame begin, behind their number."""
_ANGLE_MAX, _TIME_INCREMENT, _RANGE_MIN, _RANGES = 4, 12, 20, 32
"""Behind the first of the seven floats. Nobody uses the largest angle and the time of a scan."""


class RawRun:
    """Messages of one channel and length that follow one another in a file, not yet read."""

    def __init__(self, channel: Channel, length: int) -> None:
        self.channel = channel
        self._length = length
        self._bytes = bytearray()
        self._record_ns: list[int] = []

    def takes(self, some: RawMessages) -> bool:
        """Whether messages of one length belong to the run, and there is room."""
        is_alike = some.channel is self.channel and len(some.data[0]) == self._length
        return is_alike and len(self._bytes) < MOST_BYTES

    def add(self, some: RawMessages) -> None:
        """Copy messages: they are valid only until the next ones."""
        self._bytes += b"".join(some.data)
        self._record_ns += some.record_ns

    def split(self) -> RawMessages:
        """Give the messages one by one."""
        view, length = memoryview(self._bytes), self._length
        data = [view[i * length : (i + 1) * length] for i in range(len(self._record_ns))]
        return RawMessages(self.channel, self._record_ns, data)

    def read(self, first: Scan) -> ScanRun | None:
        """Read all messages, given the scan of the first; None where they are not all alike.

        That the first could be decoded says that its parts lie within the message.
        """
        is_cdr = self.channel.encoding == "cdr"
        if is_cdr and not self._bytes.startswith(LITTLE_ENDIAN):
            return None
        raw = np.frombuffer(self._bytes, np.uint8).reshape(-1, self._length)
        frame_end = _FRAME + count_at(memoryview(self._bytes), _FRAME - 4)
        floats = align(frame_end, 4) if is_cdr else frame_end
        ranges = floats + _RANGES
        intensities = ranges + 4 * len(first.ranges)
        free = (
            (_STAMP if is_cdr else 0, _STAMP + 8),
            (floats + _ANGLE_MAX, floats + _ANGLE_MAX + 4),
            (floats + _TIME_INCREMENT, floats + _RANGE_MIN),
            (ranges, intensities),
            (intensities + 4, self._length),
        )
        if not find_alike(raw, free).all():
            return None
        return ScanRun(
            first,
            read_stamps(raw, _STAMP),
            np.array(self._record_ns, np.int64),
            read_columns(raw, ranges, "<f4", len(first.ranges)),
            read_columns(raw, floats + _TIME_INCREMENT, "<f4")[:, 0].astype(np.float64),
        )
