"""MCAP files with ROS 2 or ROS 1 messages: whole, without index or summary, or cut short.

The file is walked from its start, in the order in which it was written, so that one that ends
early is no special case.
"""

import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from struct import Struct
from typing import BinaryIO, NamedTuple, TypeVar

from mcap.opcode import Opcode

from occmap.errors import LogError
from occmap.readers import Note, NoteList, Probe, Role, Span, make_part
from occmap.readers.inflate import Buffer, inflate
from occmap.readers.mcap_records import (
    CHUNK_START,
    LAST_OPCODE,
    MAGIC,
    MESSAGE_DATA,
    RECORD,
    RECORD_ERRORS,
    ChannelTable,
    Summary,
    count_indexed,
    describe_end,
    find_record,
    is_cut_chunk,
    is_plausible,
    leads_on,
    measure_chunk,
    parse_chunk,
    read_summary,
)
from occmap.readers.ros_log import RosReader
from occmap.readers.ros_source import Channel, RawMessage, add_note
from occmap.wording import count

T = TypeVar("T")

_MESSAGE_HEAD = Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_NO_HEAD = (0, 0, 0, 0, 0)
_NEVER_NS = 2**64 - 1
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
_LONGEST_PADDING = 64
"""Bytes that a writer may leave behind the fields of a chunk."""

SCANS = frozenset({Role.SCAN, Role.CLOUD})
_DESCRIPTIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
_PLAIN_RECORDS = _DESCRIPTIONS | {Opcode.MESSAGE}
_LAST_RECORDS = frozenset({Opcode.DATA_END, Opcode.FOOTER})


class _Block(NamedTuple):
    """Records that lie together: those of a chunk, or one that stands by itself."""

    position: int
    """In the file."""
    records: Buffer
    first_ns: int = 0
    last_ns: int = _NEVER_NS
    is_chunk: bool = False
    indexed: int = 0
    """How many messages the indexes behind the chunk name; 0 where there are none."""


class McapSource:
    """The channels and raw messages of an MCAP file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = NoteList()
        self._verified: set[int] = set()
        self._repeated: set[int] = set()
        self._summary = Summary()
        try:
            with path.open("rb") as file:
                self._size = file.seek(0, 2)
                self._span = Span(len(MAGIC), self._size)
                self._summary, problem = read_summary(file, self._size)
                if not self._summary.is_complete:
                    self._summary = replace(self._summary, channels=self._survey(file))
        except OSError as error:
            raise LogError(f"cannot be read ({error.strerror})", where=path) from None
        for channel in self.channels:
            if channel.encoding in {"cdr", "ros1"} and not channel.type:
                add_note(self.notes, f"the type of the messages on {channel.topic} is not stated")
        if problem and not self.notes:
            add_note(self.notes, f"{problem}: how many messages there should be is not known")
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
        table = ChannelTable()
        with self.path.open("rb") as file:
            for block in self._iterate_blocks(file, channels):
                yield from self._iterate_messages(block, channels.get, table)
        for key, other in table.build({}).items():
            known = self._summary.channels.get(key, other)
            if known.type and known.description != other.description:
                add_note(self.notes, f"channel {key} is described in two ways: {known.topic}")

    def split(self, size: int) -> Sequence["McapSource"]:
        """Cut the file between chunks, by its index; those without scans do not count."""
        held = self._summary.chunk_channels
        if self.notes or not (self._summary.is_complete and self._summary.is_checked):
            return [self]
        scans = {key for key, item in self._summary.channels.items() if item.role in SCANS}
        starts = sorted(held)
        cuts, gathered = [self._span.start], 0
        for start, end in pairwise(starts):
            gathered += 0 if held[start].isdisjoint(scans) else end - start
            if gathered >= size:
                cuts.append(end)
                gathered = 0
        return [make_part(self, _span=Span(*ends)) for ends in pairwise([*cuts, self._span.end])]

    def _survey(self, file: BinaryIO) -> dict[int, Channel]:
        """Find the channels and count their messages by reading the whole file."""
        table = ChannelTable()
        held: Counter[int] = Counter()
        seen: set[int] = set()
        for block in self._iterate_blocks(file, None):
            key = hash(block.records)
            if block.is_chunk and key in seen:
                self._repeated.add(block.position)
                self._note(block.position, "is there twice, and is used once")
                continue
            seen.add(key)
            # `int` chooses every channel, by its number.
            held.update(key for key, _, _ in self._iterate_messages(block, int, table))
        statistics = self._summary.statistics
        if statistics is not None and statistics.message_count != held.total():
            stated = statistics.message_count
            add_note(self.notes, f"{held.total()} messages are in it, its statistics have {stated}")
        counts = statistics.channel_message_counts if statistics else {}
        channels = self._summary.channels | table.build(counts or held)
        if lost := sum(count for key, count in held.items() if key not in channels):
            add_note(self.notes, f"the file names no channel for {count(lost, 'message')}")
        return channels

    def _iterate_blocks(
        self, file: BinaryIO, wanted: Mapping[int, Channel] | None
    ) -> Iterator[_Block]:
        """Give the records that matter, without chunks that cannot hold wanted channels."""
        chunks = set()
        for opcode, position, length in self._walk(file):
            if opcode == Opcode.CHUNK:
                chunks.add(position)
                if self._may_hold(position, wanted):
                    yield self._inflate_chunk(position, file.read(length), count_indexed(file))
            elif opcode in _PLAIN_RECORDS:
                yield _Block(position, RECORD.pack(opcode, length) + file.read(length))
        start, end = self._span
        announced = {at for at in self._summary.chunk_channels if start <= at < end}
        if lost := announced - chunks:
            text = f"{len(lost)} chunks of its index are not there, the first at byte {min(lost)}"
            add_note(self.notes, text)

    def _walk(self, file: BinaryIO) -> Iterator[tuple[int, int, int]]:
        """Give kind, position and length of each record, with the file at the record's body.

        Behind damage it goes on with the next records that follow one another.
        """
        position = behind = self._span.start
        chunk_end = 0
        while position < self._span.end:
            opcode, length = self._read_head(file, position)
            start = position + RECORD.size
            if is_plausible(opcode, length, self._size - start) or (
                opcode > LAST_OPCODE and leads_on(file, start + length, self._size)
            ):
                if opcode in _LAST_RECORDS:
                    return
                yield opcode, position, length
                position = start + length
                behind = start  # its length is not sure before what follows it is seen
                chunk_end = position if opcode == Opcode.CHUNK else 0
            elif (
                not is_cut_chunk(file, start, opcode, length, self._size)
                and (found := find_record(file, behind, self._size, chunk_end)) is not None
            ):
                text = f"damaged at byte {position}, read on from byte {found}"
                add_note(self.notes, text)
                position, behind = found, found + RECORD.size
            else:
                add_note(self.notes, describe_end(position, opcode, length, self._size))
                if opcode == Opcode.CHUNK and start < self._size:
                    file.seek(start)
                    yield opcode, position, self._size - start
                return
        if position == self._size:
            add_note(self.notes, f"the file breaks off at byte {position}, where more belongs")

    def _read_head(self, file: BinaryIO, position: int) -> tuple[int, int]:
        """Read kind and length of a record; those of a chunk can be told from its body, too.

        The file is left at the body.
        """
        file.seek(position)
        opcode, length = RECORD.unpack(file.read(RECORD.size).ljust(RECORD.size, b"\0"))
        if opcode == Opcode.MESSAGE:
            return opcode, length
        start = position + RECORD.size
        measured = measure_chunk(file.read(CHUNK_START))
        if measured is not None and (opcode, length) != (Opcode.CHUNK, measured):
            is_odd = opcode == Opcode.CHUNK and not leads_on(file, start + length, self._size)
            if is_odd or length == measured:
                self._note(position, "has a damaged head")
                opcode, length = Opcode.CHUNK, measured
        file.seek(start)
        return opcode, length

    def _may_hold(self, position: int, wanted: Mapping[int, Channel] | None) -> bool:
        """Say whether a chunk can hold messages of these channels, as the index has it."""
        if position in self._repeated:
            return False
        held = self._summary.chunk_channels.get(position)
        if wanted is None or not held or not self._summary.is_checked:
            return True
        return not held.isdisjoint(wanted)

    def _inflate_chunk(self, position: int, body: bytes, indexed: int) -> _Block:
        """Decompress a chunk and verify its checksum when it is first read."""
        try:
            chunk = parse_chunk(body)
        except RECORD_ERRORS:
            self._note(position, "has no head that can be read")
            return _Block(position, b"")
        block, problem = inflate(chunk.data, chunk.compression, chunk.size)
        if chunk.left > _LONGEST_PADDING:
            problem = problem or f"has {count(chunk.left, 'byte')} that it does not state"
        if chunk.crc and not problem and position not in self._verified:
            self._verified.add(position)
            if zlib.crc32(block) != chunk.crc:
                problem = "has a wrong checksum, and is used as far as it can be read"
        if problem:
            self._note(position, problem)
        last_ns = chunk.last_ns or _NEVER_NS
        return _Block(position, block, chunk.first_ns, last_ns, True, indexed)

    def _iterate_messages(
        self, block: _Block, choose: Callable[[int], T | None], table: ChannelTable
    ) -> Iterator[tuple[T, int, memoryview]]:
        """Give the messages of a block, by what is chosen for their channels; None for nothing.

        Schemas and channels go to the table.
        """
        position, records, first_ns, last_ns, _, indexed = block
        view, size = memoryview(records), len(records)
        unpack = _MESSAGE_HEAD.unpack_from
        start = behind = held = 0
        is_timely = True
        last = size - _MESSAGE_HEAD.size
        while start < size:
            head = unpack(view, start) if start <= last else _NO_HEAD
            opcode, length, channel_id, _, record_ns = head
            end = start + RECORD.size + length
            if opcode == Opcode.MESSAGE and start + MESSAGE_DATA <= end <= size:
                held += 1
                if (chosen := choose(channel_id)) is not None:
                    is_timely &= first_ns <= record_ns <= last_ns
                    yield chosen, min(record_ns, _LATEST_NS), view[start + MESSAGE_DATA : end]
            elif opcode in _DESCRIPTIONS and end <= size:
                self._describe(table, opcode, position, view[start + RECORD.size : end])
            else:
                self._note(position, f"is damaged {size - start} bytes before its end")
                end = find_record(BytesIO(view), behind, size) or size
                start = end
            behind, start = start + RECORD.size, end
        if not is_timely:
            self._note(position, "holds messages from outside the times that it states")
        if indexed not in {0, held}:
            self._note(position, f"holds {held} messages, its index {indexed}")

    def _describe(self, table: ChannelTable, opcode: int, position: int, body: memoryview) -> None:
        try:
            table.add(opcode, bytes(body))
        except RECORD_ERRORS:
            self._note(position, "holds a channel that cannot be read")

    def _note(self, position: int, problem: str) -> None:
        add_note(self.notes, f"the chunk at byte {position} {problem}")


class McapReader(RosReader):
    """Reads MCAP files, as https://mcap.dev/spec has them."""

    name = "mcap"
    description = "MCAP with ROS 2, ROS 1 or Foxglove messages (uncompressed, lz4, zstd)"
    open_source = McapSource

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as MCAP files do."""
        return probe.raw.startswith(MAGIC)
