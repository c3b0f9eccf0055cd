"""The records of an MCAP file that a map needs: channels, chunks and the summary."""

import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from occmap.readers.ros_source import Channel

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""What every record starts with: opcode and length of the body."""
MESSAGE_DATA = 31
"""Where a message's own bytes start in its record."""

# What the mcap library raises on records that are not well formed.
RECORD_ERRORS = (McapError, struct.error, ArithmeticError, LookupError, MemoryError, ValueError)

_FOOTER_BODY = 20
_FOOTER_LENGTH = RECORD.size + _FOOTER_BODY
_LONGEST_DATA_END = 255
"""Four bytes, and what a writer may leave behind them."""
_SHORTEST: Mapping[int, int] = {
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.DATA_END: 4,
}
"""Bytes of records whose texts and lists are empty."""
LAST_OPCODE = 15
CHUNK_HEAD = struct.Struct("<QQQII")
"""Of a chunk: its first and last time, its size and checksum when it is decompressed, and the
length of the name of its compression, which follows; then come the length of its data, and these"""
LENGTH = struct.Struct("<Q")
_CHUNK = re.compile(
    rb".{28}(\x00{4}|\x03\x00{3}lz4|\x04\x00{3}(none|zstd))(?P<length>.{5}\x00{3})", re.DOTALL
)
"""How the body of a chunk starts."""
CHUNK_START = 44
"""Bytes of it that say how long the chunk is."""
_HEAD = re.compile(rb"(?=[\x03-\x0f].{4}\x00{4})", re.DOTALL)
"""How a record starts, if it is not longer than 2**32 - 1 bytes."""
_INDEX_HEAD = struct.Struct("<HI")
"""A channel, and the bytes of the entries that follow."""
_INDEX_ENTRY = 16
"""Bytes of an entry: a time, and where in the chunk the message lies."""
_MOST_INDEX = 1 << 24
"""Bytes of an index that are read at most: a million messages."""
_WINDOW = 1 << 20
_MOST_SUMMARY = 1 << 30


@dataclass(frozen=True)
class Summary:
    """What the end of a file says that the file holds."""

    channels: dict[int, Channel] = field(default_factory=dict)
    chunk_channels: dict[int, frozenset[int]] = field(default_factory=dict)
    """Which channels have messages in the chunk at a file position; none if the index is silent."""
    statistics: Statistics | None = None
    is_checked: bool = False
    """Whether it has a checksum, and may be relied on to pass over chunks."""

    @property
    def is_complete(self) -> bool:
        """Whether it names every channel with its type, and counts every message."""
        if self.statistics is None or len(self.channels) != self.statistics.channel_count:
            return False
        counts = self.statistics.channel_message_counts
        return sum(counts.values()) == self.statistics.message_count and all(
            key in self.channels and self.channels[key].type for key in counts
        )


class ChannelTable:
    """Schemas and channels as they turn up in a file."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, McapChannel] = {}

    def add(self, opcode: int, body: bytes) -> None:
        """Take in a record if it is a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(body)))
            self._schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = McapChannel.read(ReadDataStream(BytesIO(body)))
            self._channels.setdefault(channel.id, channel)

    def build(self) -> Iterator[tuple[int, Channel]]:
        """Combine channels and their schemas; where a log is damaged, a schema may come later."""
        for key, channel in self._channels.items():
            schema = self._schemas.get(channel.schema_id, Schema(0, b"", "", ""))
            is_text = schema.encoding in {"ros1msg", "ros2msg"}
            yield (
                key,
                Channel(
                    topic=channel.topic,
                    type=schema.name,
                    encoding=channel.message_encoding,
                    definition=schema.data.decode(errors="replace") if is_text else "",
                    descriptors=schema.data if schema.encoding == "protobuf" else b"",
                ),
            )


def find_record(file: BinaryIO, start: int, size: int, chunk_end: int = 0) -> int | None:
    """Find where records go on behind damage; None where they do not.

    Two heads of records of which one leads to the other do not come about by chance. Before the
    end of a chunk only those are looked for that are no part of it.
    """
    while start < size:
        file.seek(start)
        window = file.read(_WINDOW)
        for match in _HEAD.finditer(window):
            at = start + match.start()
            is_inner = at < chunk_end and window[match.start()] < Opcode.CHUNK
            if not is_inner and leads_on(file, at, size):
                return at
        start += max(len(window) - RECORD.size, RECORD.size)
    return None


def leads_on(file: BinaryIO, position: int, size: int) -> bool:
    """Say whether records follow one another from a position on."""
    for _ in range(2):
        if position > size - RECORD.size:
            return position == size
        file.seek(position)
        opcode, length = RECORD.unpack(file.read(RECORD.size))
        if not is_plausible(opcode, length, size - position - RECORD.size):
            return False
        if opcode == Opcode.FOOTER:
            return True
        position += RECORD.size + length
    return True


def is_plausible(opcode: int, length: int, left: int) -> bool:
    """Say whether a record can be of a kind and length, with so many bytes of the file left."""
    if opcode == Opcode.DATA_END and length > _LONGEST_DATA_END:
        return False
    if opcode == Opcode.FOOTER:
        return length == _FOOTER_BODY and left == _FOOTER_BODY + len(MAGIC)
    return 0 < opcode <= LAST_OPCODE and _SHORTEST.get(opcode, 0) <= length <= left


def count_indexed(file: BinaryIO) -> int:
    """Count the messages that are named by the indexes from the file's position on."""
    messages = 0
    while len(head := file.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        if opcode != Opcode.MESSAGE_INDEX:
            break
        body = file.read(min(length, _MOST_INDEX))
        _, size = _INDEX_HEAD.unpack(body[: _INDEX_HEAD.size].ljust(_INDEX_HEAD.size, b"\0"))
        messages += size // _INDEX_ENTRY
    return messages


def measure_chunk(start: bytes) -> int | None:
    """Find how long the body of a chunk is from its first bytes; None where it is none."""
    match = _CHUNK.match(start)
    return match.end() + int.from_bytes(match["length"], "little") if match else None


def read_summary(file: BinaryIO, size: int) -> tuple[Summary, str]:
    """Read the summary at the end of a file, and say what is wrong with it.

    A summary may be absent: that is not wrong.
    """
    end = size - _FOOTER_LENGTH - len(MAGIC)
    file.seek(max(end, 0))
    tail = file.read()
    if end < 0 or not tail.endswith(MAGIC):
        return Summary(), "the file is cut before its end"
    if tail[0] != Opcode.FOOTER:
        return Summary(), "the footer is damaged"
    footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD.size :])))
    start = footer.summary_start or end
    file.seek(min(start, end))
    section = file.read(min(end - file.tell(), _MOST_SUMMARY))
    # The checksum covers the footer, too, up to the checksum itself.
    crc = zlib.crc32(tail[: _FOOTER_LENGTH - 4], zlib.crc32(section))
    if start > end or footer.summary_crc not in {0, crc}:
        return Summary(), "the summary at its end is damaged"
    try:
        return _parse_summary(section, is_checked=footer.summary_crc != 0), ""
    except RECORD_ERRORS:
        return Summary(), "the summary at its end cannot be read"


def _parse_summary(section: bytes, is_checked: bool) -> Summary:
    """Collect channels, message counts and the channels of each chunk.

    Raises
    ------
    McapError, struct.error, LookupError, ValueError
        A record is not well formed, or the last is cut.
    """
    table = ChannelTable()
    statistics: Statistics | None = None
    chunk_channels = {}
    start = 0
    while start < len(section):
        opcode, length = RECORD.unpack_from(section, start)
        body = section[start + RECORD.size : start + RECORD.size + length]
        if not opcode or len(body) < length:
            raise LookupError("a record is cut")
        table.add(opcode, body)
        if opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(body)))
        elif opcode == Opcode.CHUNK_INDEX:
            index = ChunkIndex.read(ReadDataStream(BytesIO(body)))
            chunk_channels[index.chunk_start_offset] = frozenset(index.message_index_offsets)
        start += RECORD.size + length
    return Summary(dict(table.build()), chunk_channels, statistics, is_checked)
