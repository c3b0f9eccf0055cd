"""Where the messages of an MCAP chunk lie, by the indexes that stand behind the chunk.

A walk over the records of a chunk takes a microsecond for each. The indexes name all messages at
once, and NumPy sees whether they are right.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from struct import Struct
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from occmap.readers.inflate import Buffer
from occmap.readers.mcap_records import MESSAGE_DATA, RECORD
from occmap.readers.ros_source import Channel, RawMessages
from occmap.types import Int64

_INDEX_HEAD = Struct("<HI")
"""A channel, and the bytes of the entries that follow."""
MOST_INDEX = 1 << 24
"""Bytes of the indexes of one chunk that are looked at: a million messages."""
LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
_ENTRY = np.dtype([("record_ns", "<u8"), ("start", "<u8")])
_HEAD = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")),
        *(("sequence", "<u4"), ("record_ns", "<u8"), ("publish_ns", "<u8")),
    ]
)
"""What the record of a message begins with"""


class Places(NamedTuple):
    """The M messages of a chunk, in the order in which they lie there."""

    channel: Int64
    """(M,) the number of its channel"""
    record_ns: Int64
    """(M,)"""
    start: Int64
    """(M,) where the bytes of the message itself begin"""
    end: Int64
    """(M,) where they end"""


class Indexes:
    """The message indexes behind a chunk."""

    def __init__(self) -> None:
        self.messages = 0
        """How many they name"""
        self._size = 0
        self._channels: list[int] = []
        self._entries: list[bytes] = []
        """Of each channel"""

    def add(self, body: bytes) -> None:
        """Take in the body of a record; one that is damaged or very large only counts."""
        channel, size = _INDEX_HEAD.unpack(body[: _INDEX_HEAD.size].ljust(_INDEX_HEAD.size, b"\0"))
        self.messages += size // _ENTRY.itemsize
        self._size += size
        entries = body[_INDEX_HEAD.size :][:size]
        if len(entries) == size and not size % _ENTRY.itemsize and self._size <= MOST_INDEX:
            self._channels.append(channel)
            self._entries.append(entries)

    def find(self, records: Buffer, first_ns: int, last_ns: int) -> Places | None:
        """Find the messages of the chunk.

        Returns
        -------
        places
            None where the indexes are damaged, or anything is in the chunk but the messages that
            they name, recorded at the times that they and the chunk state.
        """
        counts = [len(each) // _ENTRY.itemsize for each in self._entries]
        if not self.messages or self.messages != sum(counts):
            return None
        entries = np.frombuffer(b"".join(self._entries), _ENTRY)
        order = np.argsort(entries["start"])
        entries, channel = entries[order], np.repeat(self._channels, counts)[order]
        if entries["start"][-1] + MESSAGE_DATA > len(records):
            return None
        start = entries["start"].astype(np.int64)
        heads = np.ndarray(len(records) - MESSAGE_DATA + 1, _HEAD, records, strides=(1,))[start]
        end = start + RECORD.size + heads["length"].astype(np.int64)
        is_right = (
            (heads["opcode"] == Opcode.MESSAGE)
            & (heads["channel"] == channel)
            & (heads["record_ns"] == entries["record_ns"])
            & (heads["record_ns"] >= first_ns)
            & (heads["record_ns"] <= min(last_ns, LATEST_NS))
            & (end >= start + MESSAGE_DATA)
            & (end == np.append(start[1:], len(records)))
        )
        if start[0] or not is_right.all():
            return None
        return Places(channel, heads["record_ns"].astype(np.int64), start + MESSAGE_DATA, end)


def read_indexes(file: BinaryIO) -> Indexes:
    """Read the message indexes that follow in a file."""
    indexes = Indexes()
    while len(head := file.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        if opcode != Opcode.MESSAGE_INDEX:
            break
        indexes.add(file.read(min(length, MOST_INDEX)))
    return indexes


def pick_messages(
    records: Buffer, places: Places, channels: Mapping[int, Channel]
) -> Iterator[RawMessages]:
    """Give the messages of some channels."""
    wanted = np.flatnonzero(np.isin(places.channel, list(channels)))
    channel, record_ns, start, end = (column[wanted] for column in places)
    view = memoryview(records)
    times = record_ns.tolist()
    data = [view[at:to] for at, to in zip(start.tolist(), end.tolist(), strict=True)]
    changes = np.flatnonzero(channel[1:] != channel[:-1]) + 1
    for at, to in pairwise([0, *changes.tolist(), len(data)]):
        if at < to:
            yield RawMessages(channels[int(channel[at])], times[at:to], data[at:to])
