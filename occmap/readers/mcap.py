"""MCAP files with ROS 2 or ROS 1 messages: whole, without index or summary, or cut short.

The file is walked from its start, in the order in which it was written, so that one that ends
early is no special case. The loop over the messages of a chunk is the one that must be fast.
"""

import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from struct import Struct
from typing import BinaryIO

from mcap.opcode import Opcode

from occmap.errors import LogError
from occmap.readers import DEFAULT_OPTIONS, Note, Probe
from occmap.readers.inflate import Buffer, inflate
from occmap.readers.mcap_records import (
    MAGIC,
    RECORD,
    RECORD_ERRORS,
    ChannelTable,
    Summary,
    parse_chunk,
    read_summary,
    split_records,
)
from occmap.readers.options import ReaderOptions
from occmap.readers.ros_log import RosLog
from occmap.readers.ros_source import Channel, RawMessage, add_note

_MESSAGE_HEAD = Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_MESSAGE_DATA = 31
"""Where a message's own bytes start in its record."""
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage, and is brought into 64 bits with a sign."""
_CHANNEL_ID = Struct("<H")

_PLAIN_RECORDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
_LAST_RECORDS = frozenset({Opcode.DATA_END, Opcode.FOOTER})
_NO_RECORD = 0


class McapReader:
    """Reads MCAP files, as https://mcap.dev/spec has them."""

    name = "mcap"
    description = "MCAP with ROS 2, ROS 1 or Foxglove messages (uncompressed, lz4, zstd)"

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as MCAP files do."""
        return probe.raw.startswith(MAGIC)

    def open(self, path: Path) -> RosLog:
        """Open a log.

        Raises
        ------
        LogError
            Nothing in the file can be read.
        """
        return self.open_tuned(path, DEFAULT_OPTIONS)

    def open_tuned(self, path: Path, options: ReaderOptions) -> RosLog:
        """Open a log; echoes and clouds become scans as the user chose. Raises what `open` does."""
        return RosLog(McapSource(path), options)


class McapSource:
    """The channels and raw messages of an MCAP file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = []
        self._verified: set[int] = set()
        self._summary = Summary({})
        try:
            with path.open("rb") as file:
                self._size = file.seek(0, 2)
                self._summary = read_summary(file, self._size) or self._survey(file)
        except OSError as error:
            raise LogError(f"cannot be read ({error.strerror})", where=path) from None
        if self.notes and not self.channels:
            found = "; ".join(note.text for note in self.notes[:3])
            raise LogError(f"nothing in it can be read: {found}", where=path)

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel of the file."""
        return list(self._summary.channels.values())

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""
        channels = {key: item for key, item in self._summary.channels.items() if item in wanted}
        with self.path.open("rb") as file:
            for position, block in self._iterate_blocks(file, channels):
                yield from self._iterate_messages(position, block, channels)

    def _survey(self, file: BinaryIO) -> Summary:
        """Find the channels and count their messages by reading the whole file."""
        table = ChannelTable()
        counts: Counter[int] = Counter()
        for position, block in self._iterate_blocks(file, {}):
            for opcode, start, end in split_records(block):
                if opcode == Opcode.MESSAGE and end - start >= _CHANNEL_ID.size:
                    counts[_CHANNEL_ID.unpack_from(block, start)[0]] += 1
                    continue
                try:
                    table.add(opcode, bytes(block[start:end]))
                except RECORD_ERRORS:
                    self._note(position, "holds a channel that cannot be read")
        return Summary(table.build(counts))

    def _iterate_blocks(
        self, file: BinaryIO, wanted: Mapping[int, Channel]
    ) -> Iterator[tuple[int, Buffer]]:
        """Give the records of a file in blocks: a chunk's, or one that stands by itself."""
        position = file.seek(len(MAGIC))
        while len(head := file.read(RECORD.size)) == RECORD.size:
            opcode, length = RECORD.unpack(head)
            if opcode in _LAST_RECORDS:
                return
            end = position + RECORD.size + length
            if opcode == Opcode.CHUNK and self._may_hold(position, wanted):
                yield position, self._inflate_chunk(position, file.read(min(length, self._size)))
            elif opcode in _PLAIN_RECORDS and end <= self._size:
                yield position, head + file.read(length)
            if opcode == _NO_RECORD or end > self._size:
                break
            position = file.seek(end)
        lost = self._size - position
        rest = f"{lost} bytes before its end" if lost else "where more belongs"
        add_note(self.notes, f"the file breaks off at byte {position}, {rest}")

    def _may_hold(self, position: int, wanted: Mapping[int, Channel]) -> bool:
        """Say whether a chunk can hold messages of these channels, as the index has it."""
        held = self._summary.chunk_channels.get(position)
        return held is None or not held.isdisjoint(wanted)

    def _inflate_chunk(self, position: int, body: bytes) -> Buffer:
        """Decompress a chunk and verify its checksum when it is first read."""
        try:
            chunk = parse_chunk(body)
        except RECORD_ERRORS:
            self._note(position, "has no head that can be read")
            return b""
        block, problem = inflate(chunk.data, chunk.compression, chunk.size)
        if chunk.crc and not problem and position not in self._verified:
            self._verified.add(position)
            if zlib.crc32(block) != chunk.crc:
                problem = "has a wrong checksum, and is used as far as it can be read"
        if problem:
            self._note(position, problem)
        return block

    def _iterate_messages(
        self, position: int, block: Buffer, wanted: Mapping[int, Channel]
    ) -> Iterator[RawMessage]:
        """Give the messages of a block, looking at nothing else in it."""
        view = memoryview(block)
        unpack, size = _MESSAGE_HEAD.unpack_from, len(block)
        start = 0
        while start <= size - _MESSAGE_DATA:
            opcode, length, channel_id, _, record_ns = unpack(block, start)
            end = start + RECORD.size + length
            if end > size:
                self._note(position, f"breaks off {size - start} bytes before its end")
                return
            if opcode == Opcode.MESSAGE and (channel := wanted.get(channel_id)) is not None:
                yield channel, min(record_ns, _LATEST_NS), view[start + _MESSAGE_DATA : end]
            start = end

    def _note(self, position: int, problem: str) -> None:
        add_note(self.notes, f"the chunk at byte {position} {problem}")
