"""What MCAP files and ROS 1 bags share: records one after the other, some of which hold others.

Such a file is read from its start, in the order in which it was written, so that one without an
index, or one that breaks off, is not a special case. After damage, reading goes on with the next
records that are sound. The libraries of the two formats do neither: mcap stops at the first damage,
and rosbags needs an index, which the bags of robots that lost power do not have.
"""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Container, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, ClassVar

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import NoteList
from occmap.readers.containers.records import (
    DESCRIPTION,
    Descriptions,
    Inner,
    Record,
    RecordBlock,
)
from occmap.readers.containers.source import Channel, RawMessage
from occmap.report.words import count

LONGEST_RECORD = 2**32 - 1
"""Bytes of a record at most; one that states more is damaged."""
EVERY_ID = range(1 << 32)
"""The numbers of all channels that there can be."""
_WINDOW = 1 << 20
_LONGEST_HEAD = 64
"""Bytes that `head` looks at, at most."""


class ChunkedSource(ABC):
    """The channels and raw messages of a file of records."""

    magic: ClassVar[bytes]
    """What a file begins with"""
    chunk: ClassVar[int]
    """The opcode of records that hold others"""
    plain: ClassVar[Collection[int]]
    """The opcodes of those that may be in a chunk, and matter"""
    last: ClassVar[Collection[int]] = ()
    """The opcodes of those behind which no messages follow"""
    unit: ClassVar[str] = "channel"
    """What the format calls a channel"""
    head: ClassVar[re.Pattern[bytes]]
    """What a record may begin with, as a look-ahead: the matches of damaged bytes may overlap"""
    _cut_at = -1
    """Where a record begins in the middle of which the file ends"""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._has_doubles = False
        """Whether chunks may be there twice"""
        with refuse_unreadable(path), path.open("rb") as file:
            self._size = file.seek(0, 2)
            channels, counts = self._find_channels(file)
        self._by_id = {key: replace(each, count=counts[key]) for key, each in channels.items()}
        self.channels = list(self._by_id.values())
        if lost := sum(messages for key, messages in counts.items() if key not in channels):
            self.notes.add_damage(f"the file names no {self.unit} for {count(lost, 'message')}")
        if self.notes and not self.channels:
            found = "; ".join(note.text for note in self.notes[:3])
            raise LogError(f"nothing in it can be read: {found}", where=path)

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        descriptions: Descriptions = {}
        with self.path.open("rb") as file:
            for block in self._iterate_blocks(file, by_id):
                view = memoryview(block.records)
                for key, record_ns, start, end in self._list_messages(block, descriptions):
                    if key in by_id:
                        yield by_id[key], record_ns, view[start:end]
        for key, other in self._describe(descriptions):
            known = self._by_id.get(key, other)
            if known.description != other.description:
                text = f"{self.unit} {key} is described in two ways: {known.topic}"
                self.notes.add_damage(text)

    @abstractmethod
    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Find the channels, and count their messages, as the file announces or by a survey."""

    @abstractmethod
    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        """Read the head of a record; None where there is none."""

    @abstractmethod
    def _open_chunk(self, record: Record, body: bytes, file: BinaryIO) -> RecordBlock:
        """Decompress a chunk. The file stands behind it, at what the indexes say of it."""

    @abstractmethod
    def _parse_records(self, block: memoryview, at: int) -> Iterator[Inner]:
        """Give the records of a block from an offset on, up to the first that is damaged.

        The last may end beyond the block.
        """

    @abstractmethod
    def _peek(self, file: BinaryIO, position: int, size: int) -> int:
        """Say which kind of record begins at a position; 0 where it may be none."""

    @abstractmethod
    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        """Give channels with their numbers; one that is described in two ways comes twice."""

    def _may_hold(self, _position: int, _wanted: Container[int]) -> bool:
        """Whether a chunk can hold messages of these channels, as the file's index has it."""
        return True

    def _survey(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Find the channels and count their messages by reading the whole file.

        That of a file which is not as its index says may hold a chunk twice.
        """
        self._has_doubles = True
        descriptions: Descriptions = {}
        held: Counter[int] = Counter()
        for block in self._iterate_blocks(file, EVERY_ID):
            held.update(key for key, *_ in self._list_messages(block, descriptions))
        channels: dict[int, Channel] = {}
        for key, channel in self._describe(descriptions):
            channels.setdefault(key, channel)
        return channels, held

    def _list_messages(self, block: RecordBlock, descriptions: Descriptions) -> Iterator[Inner]:
        """Give the messages of a block. A damaged record ends nothing: the next is looked for.

        The records that describe channels are added to `descriptions`.
        """
        view, size = memoryview(block.records), len(block.records)
        damaged: set[int] = set()
        messages, is_timely = 0, True
        at = before = 0
        while at < size:
            for record in self._parse_records(view, at):
                key, record_ns, start, end = record
                if end > size:
                    break
                if key >= 0:
                    messages += 1
                    is_timely &= block.first_ns <= record_ns <= block.last_ns
                    yield record
                elif key == DESCRIPTION:
                    descriptions.setdefault(bytes(view[start:end]), block.position)
                before, at = at, end
            if at < size:
                damaged.add(at)
                # The length of the record before may be what is wrong, so it is searched, too.
                at = before = self._find_record(BytesIO(view), before + 1, size)
        self._check_block(block, damaged, messages, is_timely)

    def _check_block(
        self, block: RecordBlock, damaged: Collection[int], messages: int, is_timely: bool
    ) -> None:
        """Note where a block is damaged, and in what it is not as the file states."""
        if damaged:
            more = f" and in {len(damaged) - 1} more of its places" if len(damaged) > 1 else ""
            self._note(block.position, f"is damaged at byte {min(damaged)}{more}")
        if not is_timely:
            self._note(block.position, "holds messages from outside the times that it states")
        if block.indexed not in {0, messages}:
            self._note(block.position, f"holds {messages} messages, its index {block.indexed}")

    def _find_record(self, file: BinaryIO, start: int, size: int, chunk_end: int = 0) -> int:
        """Find where records go on behind damage; the size of the file where they do not.

        Before the end of a chunk, the records that a chunk holds are passed over.
        """
        while start < size:
            file.seek(start)
            for match in self.head.finditer(file.read(_WINDOW)):
                at = start + match.start()
                opcode = self._peek(file, at, size)
                if opcode and (at >= chunk_end or opcode not in self.plain):
                    return at
            start += _WINDOW - _LONGEST_HEAD
        return size

    def _iterate_blocks(self, file: BinaryIO, wanted: Container[int]) -> Iterator[RecordBlock]:
        """Give the records that may hold messages of these channels."""
        seen: set[int] = set()
        for record in self._walk(file):
            if record.opcode in self.plain:
                yield RecordBlock(record.position, record.head + file.read(record.length))
            elif record.opcode == self.chunk and self._may_hold(record.position, wanted):
                body = file.read(record.length)
                key = hash(body) if self._has_doubles else record.position
                if key in seen:
                    self._note(record.position, "is there twice, and is used once")
                else:
                    seen.add(key)
                    yield self._open_chunk(record, body, file)

    def _walk(self, file: BinaryIO) -> Iterator[Record]:
        """Give the records of the file one by one, with the file at the record's body."""
        position, before = len(self.magic), None
        while position < self._size:
            record = self._read_record(file, position)
            is_whole = record is not None and record.end <= self._size
            if not is_whole and not (record and record.is_sure):
                found = self._find_behind(file, position, before)
                if found < self._size:
                    position, before = found, None
                    continue
            if record is None or not is_whole:
                yield from self._take_rest(file, position, record)
                return
            if record.opcode in self.last:
                return
            file.seek(record.start)
            yield record
            position, before = record.end, record
        if self.last and position == self._size:
            self.notes.add_damage(f"the file breaks off at byte {position}, where more belongs")

    def _find_behind(self, file: BinaryIO, position: int, before: Record | None) -> int:
        """Find where records go on behind a position where none is, and note the damage.

        The length of the record before may be what is wrong, so the search begins within it; but
        what a chunk holds is part of it.
        """
        start = before.start if before else position + 1
        chunk_end = before.end if before and before.opcode == self.chunk else 0
        found = self._find_record(file, start, self._size, chunk_end)
        if found < self._size:
            damaged = position if position < found else start
            self.notes.add_damage(f"damaged at byte {damaged}, read on from byte {found}")
        return found

    def _take_rest(self, file: BinaryIO, position: int, record: Record | None) -> Iterator[Record]:
        """Note that the last bytes hold no whole record, and give what there is of a chunk."""
        left = self._size - position
        text = f"from byte {position} on, the last {count(left, 'byte')} hold no whole record"
        if record is not None and record.end - position <= LONGEST_RECORD:
            there = f"{left:,} of its {record.end - position:,} bytes are there"
            text = f"the file ends in the middle of the record at byte {position}: {there}"
            self._cut_at = position
        self.notes.add_damage(text)
        if record is not None and record.opcode == self.chunk and record.start < self._size:
            file.seek(record.start)
            yield record._replace(length=self._size - record.start)

    def _note(self, position: int, problem: str) -> None:
        """Note what is wrong with a chunk, unless it is clear since the file ends within it."""
        if position != self._cut_at:
            self.notes.add_damage(f"the chunk at byte {position} {problem}")
