"""MCAP files with ROS 2, ROS 1 or Foxglove messages: whole, without index or summary, or cut.

https://mcap.dev/spec says what their records are.
"""

import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Footer, McapRecord, Schema, Statistics
from mcap.stream_reader import StreamReader

from occmap.readers import Probe, records
from occmap.readers.containers import Buffer, Channel, inflate
from occmap.readers.records import Bytes, Descriptions, FileBytes, Record, RecordSource, Summary
from occmap.readers.ros_log import RosReader
from occmap.report import count

_HEAD = struct.Struct("<BQ")
"""What every record starts with: opcode and length of the body."""
_MESSAGE_HEAD = struct.Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_SHORT, _LONG, _unpack_message_head = _HEAD.size, _MESSAGE_HEAD.size, _MESSAGE_HEAD.unpack_from
"""By names of their own, since a log has tens of thousands of messages"""
_MESSAGE_DATA = 31
"""Where a message's own bytes start in its record."""
_FOOTER_BODY = 20
_LONGEST_PADDING = 64
"""Bytes that a writer may add after the fields of a record."""
_MOST_HEAD = 1 << 10
"""The fields of a chunk before its records are shorter, with the name of its compression."""
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
_PASSED = Opcode.MESSAGE_INDEX, Opcode.SUMMARY_OFFSET, Opcode.DATA_END
_OPAQUE = frozenset({Opcode.ATTACHMENT, Opcode.METADATA, *range(128, 256)})
_KINDS = {Opcode.CHUNK: records.CHUNK} | dict.fromkeys((*_PASSED, *_OPAQUE), records.OTHER)
"""All others but messages are read where channels are looked for, not only schemas and channels: a
chunk under another opcode would else be passed over without a word. Attachments may be large, and
what anybody may use is known to nobody else: of these, what looks like a chunk is read as one."""
_MESSAGE, _MESSAGE_INDEX = int(Opcode.MESSAGE), int(Opcode.MESSAGE_INDEX)
_OTHER_OPCODES = frozenset({*range(1, 16), *range(128, 256)}) - {_MESSAGE, Opcode.FOOTER}
"""Of the other records that may be anywhere, with those that anybody may use."""
_LONGEST = {Opcode.SUMMARY_OFFSET: 17 + _LONGEST_PADDING, Opcode.DATA_END: 4 + _LONGEST_PADDING}
"""Of bodies that only their length tells from those of other records"""
_CHUNK_BODY = re.compile(rb".{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd)(.{8})", re.DOTALL)
"""How the body of a chunk begins: times, size, checksum, compression, and the length of the rest"""


class McapSource(RecordSource):
    """The channels and raw messages of an MCAP file."""

    magic = b"\x89MCAP0\r\n"
    errors = (McapError, struct.error, ArithmeticError, LookupError, MemoryError, ValueError)
    head = re.compile(rb"(?=[\x03-\x0f].{4}\x00{4})", re.DOTALL)
    """For records that are not longer than 2**32 - 1 bytes"""

    def __init__(self, path: Path) -> None:
        self._times: dict[int, tuple[int, int] | None] = {}
        """By where chunks begin whose checksums were looked at, as poses and scans lie in the same:
        the first and the last record time that one states, if its checksum is wrong"""
        super().__init__(path)

    def _parse(self, block: Bytes, at: int) -> Record | None:
        head = block[at : at + _LONG]
        if len(head) == _LONG:
            opcode, length, key, size, record_ns = _unpack_message_head(head)
            start, end = at + _MESSAGE_DATA, at + _SHORT + length
            if opcode == _MESSAGE and start <= end:
                return key, record_ns if record_ns < _LATEST_NS else _LATEST_NS, at, start, end
            # An index states in that place how long its entries are.
            if opcode == _MESSAGE_INDEX and not 0 <= length - 6 - size <= _LONGEST_PADDING:
                return None
        if len(head) < _SHORT:
            return None
        opcode, length = _HEAD.unpack_from(head)
        end = at + _SHORT + length
        if opcode == Opcode.FOOTER and end == len(block) - len(self.magic):
            return records.OTHER, 0, at, at, len(block)
        if opcode not in _OTHER_OPCODES or length > _LONGEST.get(opcode, length):
            return None
        kind = _KINDS.get(opcode, records.DESCRIPTION)
        if opcode in _OPAQUE and _is_chunk(block[at + _SHORT : at + _MOST_HEAD], length):
            kind = records.CHUNK
        return kind, 0, at, at, end

    def _list_records(self, position: int, block: memoryview) -> Sequence[Record]:
        """List the records of a chunk; quickly if all are messages, as they are in most.

        Of a chunk with a wrong checksum those are left out that lie beside its time.
        """
        found: list[Record] = []
        at, size = 0, len(block)
        with suppress(struct.error):
            while at < size:
                opcode, length, key, _, record_ns = _unpack_message_head(block, at)
                start, end = at + _MESSAGE_DATA, at + _SHORT + length
                if opcode != _MESSAGE or end < start or record_ns > _LATEST_NS:
                    break
                found.append((key, record_ns, at, start, end))
                at = end
        records = found if at == size else super()._list_records(position, block)
        if times := self._times.get(position):
            return [each for each in records if each[0] < 0 or times[0] <= each[1] <= times[1]]
        return records

    def _open_chunk(self, position: int, record: memoryview) -> Buffer:
        """Decompress a chunk, and verify its checksum when it is first read."""
        if record[0] != Opcode.CHUNK:
            self._note(position, f"is marked as a record of kind {record[0]}, and read as a chunk")
        stream = _open_body(bytes(record[:_MOST_HEAD]))
        try:  # not by Chunk.read, which gives nothing of a chunk that is cut
            times, size = (stream.read8(), stream.read8()), stream.read8()
            crc, compression, length = stream.read4(), stream.read_prefixed_string(), stream.read8()
        except self.errors:
            self._note(position, "has no head that can be read")
            return b""
        data = record[_HEAD.size + stream.count :]
        block, problem = inflate(data[:length], compression, size)
        if not problem and (left := len(data) - length) > _LONGEST_PADDING:
            problem = f"has {count(left, 'byte')} that it does not state"
        if not problem and position not in self._times:
            is_wrong = crc > 0 and crc != zlib.crc32(block)
            self._times[position] = times if is_wrong else None
            problem = "has a wrong checksum, and is used as far as it can be read" * is_wrong
        if problem:
            self._note(position, problem)
        return block

    def _describe(self, descriptions: Descriptions) -> dict[int, Channel]:
        found: list[McapRecord] = []
        for record, position in descriptions.items():
            try:
                found.append(next(_parse_records(record)))
            except (*self.errors, StopIteration):
                self._note(position, "is or holds a record that cannot be read")
        return _make_channels(found)

    def _read_summary(self, file: FileBytes) -> Summary:
        """Read the records at the end of the file, which may have none."""
        end = len(file) - _HEAD.size - _FOOTER_BODY - len(self.magic)
        tail = bytes(file[max(end, 0) : len(file)])
        if end < 0 or not tail.endswith(self.magic):
            raise ValueError("the file is cut before its end")
        if tail[0] != Opcode.FOOTER:
            raise ValueError("the footer is damaged")
        footer = Footer.read(_open_body(tail))
        start = footer.summary_start or end
        section = file[min(start, end) : len(file)]
        # The checksum covers the footer, too, up to the checksum itself.
        crc = zlib.crc32(section[: -4 - len(self.magic)])
        if start > end or footer.summary_crc not in {0, crc}:
            raise ValueError("its checksum is another")
        summary, found = Summary(), list(_parse_records(section))
        summary.channels = _make_channels(found)
        for record in found:
            if isinstance(record, ChunkIndex) and footer.summary_crc:
                summary.chunks[record.chunk_start_offset] = record.message_index_offsets
            elif isinstance(record, Statistics):
                summary.counts.update(record.channel_message_counts)
                if summary.counts.total() != record.message_count:
                    raise ValueError("its statistics contradict each other")
                described = {key for key, channel in summary.channels.items() if channel.type}
                summary.is_whole = summary.counts.keys() <= described
        return summary


def _is_chunk(begin: memoryview, length: int) -> bool:
    """Whether a body of some length, which begins so, is laid out as that of a chunk."""
    head = _CHUNK_BODY.match(begin)
    return head is not None and head.end() + int.from_bytes(head[1], "little") == length


def _parse_records(data: Buffer) -> Iterator[McapRecord]:
    """Parse records up to the footer."""
    return StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records


def _make_channels(records: Sequence[McapRecord]) -> dict[int, Channel]:
    """Make the channels among some records; after damage, a schema may come behind its channel."""
    schemas = {each.id: each for each in reversed(records) if isinstance(each, Schema)}
    found: dict[int, Channel] = {}
    for channel in (each for each in records if isinstance(each, McapChannel)):
        schema = schemas.get(channel.schema_id, Schema(0, b"", "", ""))
        is_text = schema.encoding in {"ros1msg", "ros2msg"}
        described = Channel(
            topic=channel.topic,
            type=schema.name,
            encoding=channel.message_encoding,
            definition=schema.data.decode(errors="replace") if is_text else "",
            descriptors=schema.data if schema.encoding == "protobuf" else b"",
        )
        found.setdefault(channel.id, described)
    return found


def _open_body(record: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(record[_HEAD.size :]))


class McapReader(RosReader):
    """Reads MCAP files, as https://mcap.dev/spec has them."""

    name = "mcap"
    description = "MCAP with ROS 2, ROS 1 or Foxglove messages (uncompressed, lz4, zstd)"
    open_source = McapSource

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as MCAP files do."""
        return probe.raw.startswith(McapSource.magic)
