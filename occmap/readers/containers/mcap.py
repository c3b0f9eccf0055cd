"""MCAP files with ROS 2, ROS 1 or Foxglove messages: whole, without index or summary, or cut."""

import re
import zlib
from collections import Counter
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import Schema

from occmap.readers.containers import mcap_records as records
from occmap.readers.containers.chunked import ChunkedSource
from occmap.readers.containers.inflate import inflate
from occmap.readers.containers.records import NEVER_NS, Descriptions, Record, RecordBlock
from occmap.readers.containers.source import Channel
from occmap.report.words import count

_LONGEST_PADDING = 64
"""Bytes that a writer may add after the fields of a chunk."""


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


class McapSource(ChunkedSource):
    """The channels and raw messages of an MCAP file."""

    magic = records.MAGIC
    chunk = Opcode.CHUNK
    plain = records.DESCRIPTIONS | {Opcode.MESSAGE}
    last = frozenset({Opcode.DATA_END, Opcode.FOOTER})
    head = re.compile(rb"(?=[\x03-\x0f].{4}\x00{4})", re.DOTALL)
    """For records that are not longer than 2**32 - 1 bytes"""
    _parse_records = staticmethod(records.parse_records)

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
        summary, self._is_checked, problem = records.read_summary(file, self._size)
        statistics = summary.statistics
        self._held = {
            index.chunk_start_offset: index.message_index_offsets for index in summary.chunk_indexes
        }
        channels = dict(_make_channels(summary.channels.values(), summary.schemas))
        counts = Counter(statistics.channel_message_counts if statistics else {})
        is_complete = (
            statistics is not None
            and len(channels) == statistics.channel_count
            and counts.total() == statistics.message_count
            and all(key in channels and channels[key].type for key in counts)
        )
        if not is_complete:
            found, held = self._survey(file)
            channels |= found
            counts = Counter({**held, **{key: counts[key] for key in counts.keys() & channels}})
            if statistics and statistics.message_count != held.total():
                text = f"{held.total()} messages are in it, its statistics have"
                self.notes.add_damage(f"{text} {statistics.message_count}")
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
        if lost := self._held.keys() - chunks:
            text = f"{len(lost)} chunks of its index are not there, the first at byte {min(lost)}"
            self.notes.add_damage(text)

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        """Read the head of a record; that of a chunk is mended by what its body says."""
        file.seek(position)
        opcode, length = records.read_head(file)
        start = position + records.HEAD.size
        # A message may begin like the body of a chunk by chance.
        is_message = opcode == Opcode.MESSAGE
        measured = -1 if is_message else records.measure_chunk(file.read(records.CHUNK_START))
        if opcode != Opcode.CHUNK:
            is_damaged = length == measured
        elif measured in {-1, length}:
            is_damaged = False
        else:
            is_damaged = not records.leads_on(file, start + length, self._size)
        if is_damaged:
            self._note(position, "has a damaged head")
            opcode, length = Opcode.CHUNK, measured
        if not records.is_record(file, position, opcode, length, self._size):
            return None
        head = records.HEAD.pack(opcode, length)
        return Record(opcode, position, head, length, is_sure=length == measured)

    def _may_hold(self, position: int, wanted: Container[int]) -> bool:
        held = self._held.get(position)
        return not (held and self._is_checked) or any(key in wanted for key in held)

    def _open_chunk(self, record: Record, body: bytes, file: BinaryIO) -> RecordBlock:
        """Decompress a chunk, and verify its checksum when it is first read."""
        position = record.position
        indexed = records.count_indexed(file)
        stream = ReadDataStream(BytesIO(body))
        try:  # not by Chunk.read, which gives nothing of a chunk that is cut
            first_ns, last_ns, size = stream.read8(), stream.read8(), stream.read8()
            crc, compression, length = stream.read4(), stream.read_prefixed_string(), stream.read8()
        except records.RECORD_ERRORS:
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
        return RecordBlock(position, block, first_ns, last_ns or NEVER_NS, indexed)

    def _peek(self, file: BinaryIO, position: int, size: int) -> int:
        """Say which kind of record is at a position. Two heads in a row are not there by chance."""
        if not records.leads_on(file, position, size):
            return 0
        file.seek(position)
        return file.read(1)[0]

    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        schemas: dict[int, Schema] = {}
        channels: list[McapChannel] = []
        for record, position in descriptions.items():
            body = ReadDataStream(BytesIO(record[records.HEAD.size :]))
            try:
                if record[0] == Opcode.CHANNEL:
                    channels.append(McapChannel.read(body))
                    continue
                schema = Schema.read(body)
                schemas.setdefault(schema.id, schema)
            except records.RECORD_ERRORS:
                self._note(position, "holds a channel that cannot be read")
        # Only now, as a schema may come after its channel where a log is damaged.
        return _make_channels(channels, schemas)
