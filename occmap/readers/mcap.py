"""MCAP files with ROS 2, ROS 1 or Foxglove messages: whole, without index or summary, or cut."""

import zlib
from collections import Counter
from collections.abc import Container, Iterator
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mcap.opcode import Opcode

from occmap.readers import Probe
from occmap.readers.chunked import NEVER_NS, Block, ChunkedSource, Record
from occmap.readers.inflate import inflate
from occmap.readers.mcap_records import (
    CHUNK_HEAD,
    CHUNK_START,
    LAST_OPCODE,
    LENGTH,
    MAGIC,
    MESSAGE_DATA,
    RECORD,
    RECORD_ERRORS,
    ChannelTable,
    Summary,
    count_indexed,
    find_record,
    is_plausible,
    leads_on,
    measure_chunk,
    read_summary,
)
from occmap.readers.ros_log import RosReader
from occmap.readers.ros_source import Channel, add_note
from occmap.wording import count

_MESSAGE_HEAD = Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_NO_HEAD = (0, 0, 0, 0, 0)
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
_LONGEST_PADDING = 64
"""Bytes that a writer may leave behind the fields of a chunk."""
_DESCRIPTIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})


class McapSource(ChunkedSource[ChannelTable]):
    """The channels and raw messages of an MCAP file."""

    magic = MAGIC
    chunk = Opcode.CHUNK
    plain = _DESCRIPTIONS | {Opcode.MESSAGE}
    last = frozenset({Opcode.DATA_END, Opcode.FOOTER})
    table = ChannelTable
    find_record = staticmethod(find_record)

    def __init__(self, path: Path) -> None:
        self._verified: set[int] = set()
        """Where chunks begin whose checksums were looked at: poses and scans lie in the same"""
        self._summary = Summary()
        super().__init__(path)

    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Take the channels and their counts from the summary; where it lacks some, survey all."""
        self._summary, problem = read_summary(file, self._size)
        channels, statistics = self._summary.channels, self._summary.statistics
        counts = Counter(statistics.channel_message_counts if statistics else {})
        if self._summary.is_complete:
            self._chunks = sorted(self._summary.chunk_channels) if self._summary.is_checked else ()
        else:
            self._has_doubles = True
            found, held = self._survey(file)
            if statistics is not None and statistics.message_count != held.total():
                stated = statistics.message_count
                text = f"{held.total()} messages are in it, its statistics have {stated}"
                add_note(self.notes, text)
            channels, counts = channels | found, counts or held
        for channel in channels.values():
            if channel.encoding in {"cdr", "ros1"} and not channel.type:
                add_note(self.notes, f"the type of the messages on {channel.topic} is not stated")
        if problem and not self.notes:
            add_note(self.notes, f"{problem}: how many messages there should be is not known")
        return channels, counts

    def _walk(self, file: BinaryIO) -> Iterator[Record]:
        """Give the records, and note chunks that the index has and the file has not."""
        chunks = set()
        for record in super()._walk(file):
            if record.opcode == Opcode.CHUNK:
                chunks.add(record.position)
            yield record
        start, end = self._span
        announced = {at for at in self._summary.chunk_channels if start <= at < end}
        if lost := announced - chunks:
            text = f"{len(lost)} chunks of its index are not there, the first at byte {min(lost)}"
            add_note(self.notes, text)

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        """Read the head of a record; kind and length of a chunk can be told from its body, too."""
        file.seek(position)
        opcode, length = RECORD.unpack(file.read(RECORD.size).ljust(RECORD.size, b"\0"))
        start = position + RECORD.size
        measured = None if opcode == Opcode.MESSAGE else measure_chunk(file.read(CHUNK_START))
        if measured is not None and (opcode, length) != (Opcode.CHUNK, measured):
            is_odd = opcode == Opcode.CHUNK and not leads_on(file, start + length, self._size)
            if is_odd or length == measured:
                self._note(position, "has a damaged head")
                opcode, length = Opcode.CHUNK, measured
        left = self._size - start
        if (
            is_plausible(opcode, length, left)
            or (0 < opcode <= LAST_OPCODE and left < length)
            or (opcode > LAST_OPCODE and leads_on(file, start + length, self._size))
        ):
            head = RECORD.pack(opcode, length)
            return Record(opcode, position, head, length, is_sure=length == measured)
        return None

    def _may_hold(self, position: int, wanted: Container[int]) -> bool:
        """Rely on an index that has a checksum."""
        held = self._summary.chunk_channels.get(position)
        return not (held and self._summary.is_checked) or any(key in wanted for key in held)

    def _open_chunk(self, record: Record, body: bytes, file: BinaryIO) -> Block:
        """Decompress a chunk, and verify its checksum when it is first read."""
        position = record.position
        indexed = count_indexed(file)
        try:  # not by the library, which gives nothing of a chunk that is cut
            first_ns, last_ns, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
            start = CHUNK_HEAD.size + name_length
            compression = str(body[CHUNK_HEAD.size : start], "utf-8")
            (length,) = LENGTH.unpack_from(body, start)
        except RECORD_ERRORS:
            self._note(position, "has no head that can be read")
            return Block(position, b"")
        data = memoryview(body)[start + LENGTH.size :]
        block, problem = inflate(data[:length], compression, size)
        if (left := len(data) - length) > _LONGEST_PADDING:
            problem = problem or f"has {count(left, 'byte')} that it does not state"
        if not problem and position not in self._verified:
            self._verified.add(position)
            if crc not in {0, zlib.crc32(block)}:
                problem = "has a wrong checksum, and is used as far as it can be read"
        if problem:
            self._note(position, problem)
        return Block(position, block, first_ns, last_ns or NEVER_NS, indexed)

    def _split_block(
        self, block: Block, wanted: Container[int], table: ChannelTable
    ) -> Iterator[tuple[int, int, memoryview]]:
        position, records, first_ns, last_ns, indexed = block
        view, size = memoryview(records), len(records)
        unpack, before, message = _MESSAGE_HEAD.unpack_from, RECORD.size, int(Opcode.MESSAGE)
        start = behind = held = 0
        is_timely = True
        last = size - _MESSAGE_HEAD.size
        while start < size:
            head = unpack(view, start) if start <= last else _NO_HEAD
            opcode, length, channel_id, _, record_ns = head
            end = start + before + length
            data = start + MESSAGE_DATA
            if opcode == message and data <= end <= size:
                held += 1
                if channel_id in wanted:
                    is_timely &= first_ns <= record_ns <= last_ns
                    yield channel_id, min(record_ns, _LATEST_NS), view[data:end]
            elif opcode in _DESCRIPTIONS and end <= size:
                try:
                    table.add(opcode, bytes(view[start + RECORD.size : end]))
                except RECORD_ERRORS:
                    self._note(position, "holds a channel that cannot be read")
            else:
                self._note(position, f"is damaged {size - start} bytes before its end")
                end = find_record(BytesIO(view), behind, size) or size
                start = end
            behind, start = start + before, end
        if not is_timely:
            self._note(position, "holds messages from outside the times that it states")
        if indexed not in {0, held}:
            self._note(position, f"holds {held} messages, its index {indexed}")


class McapReader(RosReader):
    """Reads MCAP files, as https://mcap.dev/spec has them."""

    name = "mcap"
    description = "MCAP with ROS 2, ROS 1 or Foxglove messages (uncompressed, lz4, zstd)"
    open_source = McapSource

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as MCAP files do."""
        return probe.raw.startswith(MAGIC)
