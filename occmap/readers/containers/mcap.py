"""MCAP files with ROS 2, ROS 1 or Foxglove messages: whole, without index or summary, or cut.

The records, as https://mcap.dev/spec has them, come first, then the file that is made of them.
"""

import re
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from occmap.readers.containers import chunked
from occmap.readers.containers.chunked import Descriptions, Inner, Record, RecordBlock
from occmap.readers.containers.inflate import inflate
from occmap.readers.containers.source import Channel
from occmap.wording import count

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
"""What every record starts with: opcode and length of the body."""
_MESSAGE_DATA = 31
"""Where a message's own bytes start in its record."""

# What the mcap library raises on records that are not well formed.
_RECORD_ERRORS = (McapError, struct.error, ArithmeticError, LookupError, MemoryError, ValueError)

_FOOTER_BODY = 20
_FOOTER_LENGTH = _RECORD.size + _FOOTER_BODY
_LONGEST_DATA_END = 255
"""Four bytes, and what a writer may add to them."""
_LAST_OPCODE = 15
_CHUNK = re.compile(
    rb".{28}(\x00{4}|\x03\x00{3}lz4|\x04\x00{3}(none|zstd))(?P<length>.{5}\x00{3})", re.DOTALL
)
"""How the body of a chunk starts."""
_CHUNK_START = 44
"""Bytes of it that say how long the chunk is."""
_INDEX_ENTRY = 16
"""Bytes of an entry: a time, and where in the chunk the message lies."""
_MOST_INDEX = 1 << 24
"""Bytes of an index that are read at most: a million messages."""
_MOST_SUMMARY = 1 << 30
_MESSAGE_HEAD = struct.Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_LONGEST_PADDING = 64
"""Bytes that a writer may add after the fields of a chunk."""
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
_DESCRIPTIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})


def _make_channels(
    channels: Iterable[McapChannel], schemas: Mapping[int, Schema]
) -> Iterator[tuple[int, Channel]]:
    """Combine channels and their schemas; give them with their numbers."""
    for channel in channels:
        schema = schemas.get(channel.schema_id, Schema(0, b"", "", ""))
        is_text = schema.encoding in {"ros1msg", "ros2msg"}
        yield (
            channel.id,
            Channel(
                topic=channel.topic,
                type=schema.name,
                encoding=channel.message_encoding,
                definition=schema.data.decode(errors="replace") if is_text else "",
                descriptors=schema.data if schema.encoding == "protobuf" else b"",
            ),
        )


def _measure_chunk(body: bytes) -> int:
    """Find how long the body of a chunk is by its first bytes; -1 where it is none of a chunk."""
    match = _CHUNK.match(body)
    return match.end() + int.from_bytes(match["length"], "little") if match else -1


def _leads_on(file: BinaryIO, position: int, size: int) -> bool:
    """Say whether records follow one another from a position on."""
    for _ in range(2):
        if position > size - _RECORD.size:
            return position == size
        file.seek(position)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        if not _is_plausible(opcode, length, size - position - _RECORD.size):
            return False
        if opcode == Opcode.FOOTER:
            return True
        position += _RECORD.size + length
    return True


def _is_plausible(opcode: int, length: int, left: int) -> bool:
    """Say whether a record can be of a kind and length, where `left` bytes of the file follow."""
    if opcode == Opcode.DATA_END and length > _LONGEST_DATA_END:
        return False
    if opcode == Opcode.FOOTER:
        return length == _FOOTER_BODY and left == _FOOTER_BODY + len(MAGIC)
    return 0 < opcode <= _LAST_OPCODE and length <= left


def _count_indexed(file: BinaryIO) -> int:
    """Count the messages that are named by the indexes from the file's position on."""
    messages = 0
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        if opcode != Opcode.MESSAGE_INDEX:
            break
        body = file.read(min(length, _MOST_INDEX))
        size = int.from_bytes(body[2:6], "little")  # of the entries, behind the channel's number
        messages += size // _INDEX_ENTRY
    return messages


def _read_summary(file: BinaryIO, size: int) -> tuple[Summary, bool, str]:
    """Read the summary at the end of a file, which may be absent.

    Returns
    -------
    summary, is_checked, problem
        Whether it has a checksum, and may be relied on to pass over chunks; and what is wrong.
    """
    end = size - _FOOTER_LENGTH - len(MAGIC)
    file.seek(max(end, 0))
    tail = file.read()
    if end < 0 or not tail.endswith(MAGIC):
        return Summary(), False, "the file is cut before its end"
    if tail[0] != Opcode.FOOTER:
        return Summary(), False, "the footer is damaged"
    footer = Footer.read(ReadDataStream(BytesIO(tail[_RECORD.size :])))
    start = footer.summary_start or end
    file.seek(min(start, end))
    section = file.read(min(end - file.tell(), _MOST_SUMMARY))
    # The checksum covers the footer, too, up to the checksum itself.
    crc = zlib.crc32(tail[: _FOOTER_LENGTH - 4], zlib.crc32(section))
    if start > end or footer.summary_crc not in {0, crc}:
        return Summary(), False, "the summary at its end is damaged"
    try:
        return _parse_summary(section + tail), footer.summary_crc != 0, ""
    except _RECORD_ERRORS:
        return Summary(), False, "the summary at its end cannot be read"


def _parse_summary(end: bytes) -> Summary:
    """Parse the end of a file. The library does so, too, but unpacks what it takes for chunks.

    Raises
    ------
    McapError, struct.error, LookupError, ValueError
        A record is not well formed, or the last is cut.
    """
    summary = Summary()
    for record in StreamReader(BytesIO(end), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, McapChannel):
            summary.channels[record.id] = record
        elif isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, ChunkIndex):
            summary.chunk_indexes.append(record)
    return summary


class McapSource(chunked.ChunkedSource):
    """The channels and raw messages of an MCAP file."""

    magic = MAGIC
    chunk = Opcode.CHUNK
    plain = _DESCRIPTIONS | {Opcode.MESSAGE}
    last = frozenset({Opcode.DATA_END, Opcode.FOOTER})
    head = re.compile(rb"(?=[\x03-\x0f].{4}\x00{4})", re.DOTALL)
    """For records that are not longer than 2**32 - 1 bytes"""

    def __init__(self, path: Path) -> None:
        self._verified: set[int] = set()
        """Where chunks begin whose checksums were looked at: poses and scans lie in the same"""
        self._held: dict[int, Collection[int]] = {}
        """Which channels have messages in the chunk at a position; none if the index is silent"""
        self._is_checked = False
        """Whether a checksum says that this is so"""
        super().__init__(path)

    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Take the channels and their counts from the summary; where it lacks some, survey all."""
        summary, self._is_checked, problem = _read_summary(file, self._size)
        statistics = summary.statistics
        self._held = {
            index.chunk_start_offset: index.message_index_offsets for index in summary.chunk_indexes
        }
        channels = dict(_make_channels(summary.channels.values(), summary.schemas))
        counts = Counter(statistics.channel_message_counts if statistics else {})
        if (
            statistics is not None
            and len(channels) == statistics.channel_count
            and counts.total() == statistics.message_count
            and all(key in channels and channels[key].type for key in counts)
        ):
            self._chunks = sorted(self._held) if self._is_checked else ()
        else:
            self._has_doubles = True
            found, held = self._survey(file)
            stated = statistics.message_count if statistics else held.total()
            if stated != held.total():
                text = f"{held.total()} messages are in it, its statistics have {stated}"
                self.notes.add_damage(text)
            channels |= found
            counts = Counter({**held, **{key: counts[key] for key in counts.keys() & channels}})
        for channel in channels.values():
            if channel.encoding in {"cdr", "ros1"} and not channel.type:
                self.notes.add_damage(f"the type of the messages on {channel.topic} is not stated")
        if problem and not self.notes:
            self.notes.add_damage(f"{problem}: how many messages there should be is not known")
        return channels, counts

    def _walk(self, file: BinaryIO) -> Iterator[Record]:
        """Give the records, and note chunks that the index has and the file has not."""
        chunks = set()
        for record in super()._walk(file):
            if record.opcode == Opcode.CHUNK:
                chunks.add(record.position)
            yield record
        start, end = self._span
        announced = {at for at in self._held if start <= at < end}
        if lost := announced - chunks:
            text = f"{len(lost)} chunks of its index are not there, the first at byte {min(lost)}"
            self.notes.add_damage(text)

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        """Read the head of a record; kind and length of a chunk can be told from its body, too."""
        file.seek(position)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size).ljust(_RECORD.size, b"\0"))
        start = position + _RECORD.size
        measured = -1 if opcode == Opcode.MESSAGE else _measure_chunk(file.read(_CHUNK_START))
        # A head that the body contradicts is damaged if its length leads nowhere, or is right.
        if opcode != Opcode.CHUNK:
            is_damaged = length == measured
        else:
            is_damaged = length != measured >= 0 and not _leads_on(file, start + length, self._size)
        if is_damaged:
            self._note(position, "has a damaged head")
            opcode, length = Opcode.CHUNK, measured
        left = self._size - start
        # The file may be cut within a record of a known kind; one of another kind must lead on.
        if opcode > _LAST_OPCODE:
            is_record = _leads_on(file, start + length, self._size)
        else:
            is_record = (opcode > 0 and left < length) or _is_plausible(opcode, length, left)
        if not is_record:
            return None
        head = _RECORD.pack(opcode, length)
        return Record(opcode, position, head, length, is_sure=length == measured)

    def _may_hold(self, position: int, wanted: Container[int]) -> bool:
        held = self._held.get(position)
        return not (held and self._is_checked) or any(key in wanted for key in held)

    def _open_chunk(self, record: Record, body: bytes, file: BinaryIO) -> RecordBlock:
        """Decompress a chunk, and verify its checksum when it is first read."""
        position = record.position
        indexed = _count_indexed(file)
        stream = ReadDataStream(BytesIO(body))
        try:  # not by Chunk.read, which gives nothing of a chunk that is cut
            first_ns, last_ns, size = stream.read8(), stream.read8(), stream.read8()
            crc, compression, length = stream.read4(), stream.read_prefixed_string(), stream.read8()
        except _RECORD_ERRORS:
            self._note(position, "has no head that can be read")
            return RecordBlock(position, b"")
        data = memoryview(body)[stream.count :]
        block, problem = inflate(data[:length], compression, size)
        if (left := len(data) - length) > _LONGEST_PADDING:
            problem = problem or f"has {count(left, 'byte')} that it does not state"
        if not problem and position not in self._verified:
            self._verified.add(position)
            if crc not in {0, zlib.crc32(block)}:
                problem = "has a wrong checksum, and is used as far as it can be read"
        if problem:
            self._note(position, problem)
        return RecordBlock(position, block, first_ns, last_ns or chunked.NEVER_NS, indexed)

    def _parse_records(self, block: memoryview, at: int) -> Iterator[Inner]:
        message, last = int(Opcode.MESSAGE), len(block) - _MESSAGE_HEAD.size
        while at <= last:
            opcode, length, key, _, record_ns = _MESSAGE_HEAD.unpack_from(block, at)
            start, end = at + _MESSAGE_DATA, at + _RECORD.size + length
            if opcode == message and start <= end:
                yield key, min(record_ns, _LATEST_NS), start, end
            elif opcode in _DESCRIPTIONS:
                yield chunked.DESCRIPTION, 0, at, end
            else:
                return
            at = end

    def _peek(self, file: BinaryIO, position: int, size: int) -> int:
        """Say which kind of record is at a position. Two heads in a row are not there by chance."""
        if not _leads_on(file, position, size):
            return 0
        file.seek(position)
        return file.read(1)[0]

    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        schemas: dict[int, Schema] = {}
        channels: list[McapChannel] = []
        for record, position in descriptions.items():
            body = ReadDataStream(BytesIO(record[_RECORD.size :]))
            try:
                if record[0] == Opcode.CHANNEL:
                    channels.append(McapChannel.read(body))
                    continue
                schema = Schema.read(body)
                schemas.setdefault(schema.id, schema)
            except _RECORD_ERRORS:
                self._note(position, "holds a channel that cannot be read")
        # Only now, as a schema may come after its channel where a log is damaged.
        return _make_channels(channels, schemas)
