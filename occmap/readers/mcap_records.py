"""The records of an MCAP file that a map needs: channels, chunks and the summary."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from occmap.readers.inflate import Buffer
from occmap.readers.ros_source import Channel, Encoding, Syntax

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""What every record starts with: opcode and length of the body."""

# What the mcap library raises on records that are not well formed.
RECORD_ERRORS = (McapError, struct.error, ArithmeticError, LookupError, MemoryError, ValueError)

_ENCODINGS: Mapping[str, Encoding] = {
    "cdr": "cdr",
    "ros1": "ros1",
    "json": "json",
    "protobuf": "protobuf",
}
_SYNTAXES: Mapping[str, Syntax] = {
    "ros1msg": "msg",
    "ros2msg": "msg",
    "ros2idl": "idl",
    "omgidl": "idl",
}
_FOOTER_LENGTH = RECORD.size + 20
_CHUNK_HEAD = struct.Struct("<QQQII")


class Chunk(NamedTuple):
    """A block of records, mostly compressed."""

    size: int
    """Bytes before compression."""
    crc: int
    """Of the bytes before compression; 0 for none."""
    compression: str
    data: memoryview


@dataclass(frozen=True)
class Summary:
    """What a file holds."""

    channels: dict[int, Channel]
    chunk_channels: dict[int, frozenset[int]] = field(default_factory=dict)
    """The channels with messages in the chunk at each file position, where that is known."""


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

    def build(self, counts: Mapping[int, int]) -> dict[int, Channel]:
        """Combine channels, their schemas and how many messages each has."""
        return {key: self._combine(key, counts.get(key, 0)) for key in self._channels}

    def _combine(self, key: int, count: int) -> Channel:
        channel = self._channels[key]
        schema = self._schemas.get(channel.schema_id, Schema(0, b"", "", ""))
        syntax = _SYNTAXES.get(schema.encoding, "")
        return Channel(
            topic=channel.topic,
            type=schema.name,
            encoding=_ENCODINGS.get(channel.message_encoding, ""),
            definition=schema.data.decode(errors="replace") if syntax else "",
            syntax=syntax,
            count=count,
            descriptors=schema.data if schema.encoding == "protobuf" else b"",
        )


def split_records(block: Buffer) -> Iterator[tuple[int, int, int]]:
    """Give opcode, start and end of the body of each record, as far as they are whole."""
    start = RECORD.size
    while start <= len(block):
        opcode, length = RECORD.unpack_from(block, start - RECORD.size)
        end = start + length
        if end > len(block):
            return
        yield opcode, start, end
        start = end + RECORD.size


def parse_chunk(body: bytes) -> Chunk:
    """Parse a chunk record; where the file is cut within it, the data is what there is.

    Raises
    ------
    struct.error, ValueError
        Not even its head is whole.
    """
    _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    view = memoryview(body)[_CHUNK_HEAD.size :]
    (length,) = struct.unpack_from("<Q", view, name_length)
    start = name_length + 8
    return Chunk(size, crc, str(view[:name_length], "utf-8"), view[start : start + length])


def read_summary(file: BinaryIO, size: int) -> Summary | None:
    """Read the summary at the end of a file; None where it is absent, damaged or not complete."""
    try:
        return _parse_summary(_read_summary_section(file, size))
    except RECORD_ERRORS:
        return None


def _read_summary_section(file: BinaryIO, size: int) -> bytes:
    """Read the bytes between the data and the footer; none where they are damaged."""
    end = max(size - _FOOTER_LENGTH - len(MAGIC), 0)
    file.seek(end)
    tail = file.read()
    if tail[0] != Opcode.FOOTER or not tail.endswith(MAGIC):
        return b""
    footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD.size :])))
    file.seek(min(footer.summary_start, end) if footer.summary_start else end)
    section = file.read(end - file.tell())
    # The checksum covers the footer, too, up to the checksum itself.
    crc = zlib.crc32(tail[: _FOOTER_LENGTH - 4], zlib.crc32(section))
    return section if footer.summary_crc in {0, crc} else b""


def _parse_summary(section: bytes) -> Summary | None:
    """Collect channels, message counts and the channels of each chunk."""
    table = ChannelTable()
    statistics: Statistics | None = None
    chunk_channels = {}
    for opcode, start, end in split_records(section):
        body = section[start:end]
        table.add(opcode, body)
        if opcode == Opcode.STATISTICS:
            statistics = Statistics.read(ReadDataStream(BytesIO(body)))
        elif opcode == Opcode.CHUNK_INDEX:
            index = ChunkIndex.read(ReadDataStream(BytesIO(body)))
            if index.message_index_offsets:
                chunk_channels[index.chunk_start_offset] = frozenset(index.message_index_offsets)
    if statistics is None:
        return None
    channels = table.build(statistics.channel_message_counts)
    return Summary(channels, chunk_channels) if _is_complete(channels, statistics) else None


def _is_complete(channels: Mapping[int, Channel], statistics: Statistics) -> bool:
    """Say whether a summary names every channel with its type and counts every message."""
    counts = statistics.channel_message_counts
    return (
        len(channels) == statistics.channel_count
        and sum(counts.values()) == statistics.message_count
        and all(key in channels and channels[key].type for key in counts)
    )
