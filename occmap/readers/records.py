"""Files of records, one after the other, some of which hold others: MCAP files and ROS 1 bags.

What a record is: a head that says which kind it is and how long, and a body. A chunk is a record
whose body holds others, mostly compressed: messages, and the descriptions of their channels. The
end of the file sums up what lies in it. A format says how these are written; all else is the same
for both, and is here.

Such a file is read from its start, in the order in which it was written, so that one without an
index, or one that breaks off, is not a special case. After damage, reading goes on with the next
record that is found, and a note says where. The libraries of the two formats do neither: mcap stops
at the first damage, and rosbags needs an index, which the bags of robots that lost power do not
have.
"""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, ClassVar, NamedTuple, TypeAlias

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import NoteList
from occmap.readers.containers import MAX_INFLATED, Buffer, Channel, RawMessage
from occmap.report import count

DESCRIPTION, OTHER = -1, -2
"""Stand in place of a message's channel for a record that describes one, and for any other."""
_EVERY_ID = range(1 << 32)
"""The numbers of all channels that there can be."""
_WINDOW = 1 << 20
_LONGEST_MATCH = 64
"""Bytes that `head` looks at, at most."""


class Kind(Enum):
    """What a record of a file is to its reader."""

    PLAIN = "a message, or the description of a channel"
    """In a chunk, or in the open if a recorder makes none, or died before it closed one"""
    CHUNK = "a chunk"
    OTHER = "something else"


class Record(NamedTuple):
    """Where a record of a file lies."""

    kind: Kind
    position: int
    start: int
    """Where its body begins"""
    end: int
    """Where its body ends; of a record that is cut, beyond the file"""


Inner: TypeAlias = tuple[int, int, int, int]
"""A record of a block: a message's channel, when it was recorded (ns), and where in the block the
message begins and the record ends; one that describes a channel is given from its start. A plain
tuple, since a log has tens of thousands."""

Descriptions: TypeAlias = dict[bytes, int]
"""Records that describe channels, each with the position of the chunk where it first lies."""


@dataclass
class Summary:
    """What the end of a file says of it."""

    channels: dict[int, Channel] = field(default_factory=dict)
    """By their numbers"""
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel; none where it does not say"""
    chunks: dict[int, Collection[int]] = field(default_factory=dict)
    """The channels that have messages in the chunk at a position, where that is certain"""
    is_whole: bool = False
    """Whether it has all of the channels and counts"""
    problem: str = ""
    """Why it cannot be used"""


class RecordSource(ABC):
    """The channels and raw messages of a file of records."""

    magic: ClassVar[bytes]
    """What a file begins with"""
    head: ClassVar[re.Pattern[bytes]]
    """What a record may begin with, as a look-ahead: the matches of damaged bytes may overlap"""
    unit: ClassVar[str] = "channel"
    """What the format calls a channel"""
    is_unmistakable: ClassVar[bool] = False
    """Whether nothing else begins like a record; otherwise only two in a row are records"""
    errors: ClassVar[tuple[type[Exception], ...]]
    """What is raised where a record is not well formed"""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        with refuse_unreadable(path), path.open("rb") as file:
            self._size = self._cut_at = file.seek(0, 2)
            """Where a record begins in the middle of which the file ends, or the end of the file"""
            try:
                self._summary = self._read_summary(file)
            except self.errors as error:
                text = f"the index at its end cannot be used ({error})"
                self._summary = Summary(problem=f"{text}: what should be in it is not known")
            channels, counts = self._summary.channels, self._summary.counts
            if not self._summary.is_whole:
                channels, counts = self._survey(file)
        self._by_id = {key: replace(each, count=counts[key]) for key, each in channels.items()}
        self.channels = list(self._by_id.values())
        if lost := sum(messages for key, messages in counts.items() if key not in channels):
            self.notes.add_damage(f"the file names no {self.unit} for {count(lost, 'message')}")
        for each in self.channels:
            if each.encoding in {"cdr", "ros1"} and not each.type:
                self.notes.add_damage(f"the type of the messages on {each.topic} is not stated")
        if self.notes and not self.channels:
            found = "; ".join(note.text for note in self.notes[:3])
            raise LogError(f"nothing in it can be read: {found}", where=path)

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        descriptions: Descriptions = {}
        with self.path.open("rb") as file:
            for block, records in self._iterate_blocks(file, by_id, descriptions):
                for key, record_ns, start, end in records:
                    if key in by_id:
                        yield by_id[key], record_ns, block[start:end]
        for key, other in self._describe(descriptions):
            known = self._by_id.get(key, other)
            if known.description != other.description:
                text = f"{self.unit} {key} is described in two ways: {known.topic}"
                self.notes.add_damage(text)

    @abstractmethod
    def _read_summary(self, file: BinaryIO) -> Summary:
        """Read what the end of the file says of it; raises `errors` where it is damaged."""

    @abstractmethod
    def _read_record(self, file: BinaryIO, position: int, size: int) -> Record | None:
        """Read a record's head in a file, or a block, of some size; None where there is none."""

    @abstractmethod
    def _parse_records(self, block: memoryview, at: int) -> Iterator[Inner]:
        """Give the records of a block from an offset on, up to the first that is damaged.

        The last may end beyond the block.
        """

    @abstractmethod
    def _open_chunk(self, position: int, record: bytes) -> Buffer:
        """Decompress the chunk at a position, and note what is wrong with it."""

    @abstractmethod
    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        """Give channels with their numbers; one that is described in two ways comes twice."""

    def _survey(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Find the channels and count their messages by reading the whole file.

        Where the summary counts those of a channel, its count stands.
        """
        descriptions: Descriptions = {}
        held: Counter[int] = Counter()
        for _, records in self._iterate_blocks(file, _EVERY_ID, descriptions):
            held.update(key for key, *_ in records)
        found: dict[int, Channel] = {}
        for key, channel in self._describe(descriptions):
            found.setdefault(key, channel)
        channels, counts = {**self._summary.channels, **found}, self._summary.counts
        if self._summary.problem and not self.notes:
            self.notes.add_damage(self._summary.problem)
        announced = {key: counts[key] for key in counts.keys() & channels}
        return channels, Counter({**held, **announced})

    def _iterate_blocks(
        self, file: BinaryIO, wanted: Container[int], descriptions: Descriptions
    ) -> Iterator[tuple[memoryview, Iterator[Inner]]]:
        """Give what may hold messages of some channels: unpacked chunks, or single records.

        With each come its messages. The records in it that describe channels are added to
        `descriptions`.
        """
        for kind, position, _, end in self._walk(file):
            held = self._summary.chunks.get(position)
            if kind is Kind.OTHER or (held and not any(key in wanted for key in held)):
                continue
            file.seek(position)
            # Of a record that is too long to be sound, only the first bytes are read.
            data: Buffer = file.read(min(end - position, MAX_INFLATED))
            if kind is Kind.CHUNK:
                data = self._open_chunk(position, bytes(data))
            block = memoryview(data)
            yield block, self._list_messages(position, block, descriptions)

    def _list_messages(
        self, position: int, block: memoryview, descriptions: Descriptions
    ) -> Iterator[Inner]:
        """Give the messages of a block. A damaged record ends nothing: the next is looked for."""
        size, at, search = len(block), 0, 0
        damaged: list[int] = []
        while at < size:
            for record in self._parse_records(block, at):
                key, _, start, end = record
                if end > size:
                    break
                if key >= 0:
                    yield record
                elif key == DESCRIPTION:
                    descriptions.setdefault(bytes(block[start:end]), position)
                # The length of the last one may be what is wrong, so it is searched, too.
                search, at = at + 1, end
            if at < size:
                damaged.append(at)
                found = self._find_record(BytesIO(block), search, size, {Kind.PLAIN})
                at = found.position if found else size
                search = at + 1
        if damaged:
            more = f" and in {len(damaged) - 1} more of its places" if len(damaged) > 1 else ""
            self._note(position, f"is damaged at byte {min(damaged)}{more}")

    def _walk(self, file: BinaryIO) -> Iterator[Record]:
        """Give the records of the file one by one.

        Where no record follows one, its length may be wrong. So it ends where the next one begins
        that is found behind its head.
        """
        record = Record(Kind.OTHER, 0, len(self.magic), len(self.magic))
        while record.end != self._size:
            following = self._read_record(file, min(record.end, self._size), self._size)
            # The length of a chunk that seems to be cut is looked at in the next round.
            if following and following.end > self._size and following.kind is not Kind.CHUNK:
                following = None
            if following is None:
                following = self._find_following(file, record)
                if following is None:
                    break
                at = record.end if record.end < following.position else record.start
                found = f"damaged at byte {at}, read on from byte {following.position}"
                self.notes.add_damage(found)
                record = record._replace(end=min(record.end, following.position))
            yield record
            record = following
        if record.end != self._size:
            self._note_rest(file, record)
        if record.end <= self._size or record.kind is Kind.CHUNK:
            yield record._replace(end=min(record.end, self._size))

    def _find_following(self, file: BinaryIO, record: Record) -> Record | None:
        """Find the next record behind the head of one; what lies in a chunk does not follow it."""
        if record.kind is not Kind.CHUNK:
            return self._find_record(file, record.start, self._size, set(Kind))
        found = self._find_record(file, record.start, self._size, {Kind.CHUNK, Kind.OTHER})
        # Before it may lie the messages of a chunk that lost its head.
        until = found.position if found else self._size
        return self._find_record(file, record.end, until, {Kind.PLAIN}) or found

    def _note_rest(self, file: BinaryIO, record: Record) -> None:
        """Note that the last bytes of the file, in or behind a record, hold no whole one."""
        is_cut = record.end > self._size
        cut = record if is_cut else self._read_record(file, record.end, self._size)
        if cut is None:
            left = count(self._size - record.end, "byte")
            text = f"from byte {record.end} on, the last {left} hold no whole record"
        else:
            self._cut_at = cut.position
            there = f"{self._size - cut.position:,} of its {cut.end - cut.position:,} bytes"
            text = f"the file ends in the middle of the record at byte {cut.position}"
            text = f"{text}: {there} are there"
        self.notes.add_damage(text)

    def _find_record(
        self, file: BinaryIO, start: int, size: int, kinds: Container[Kind]
    ) -> Record | None:
        """Find where records of some kinds go on in a file, or a block, of some size."""
        while start < size:
            file.seek(start)
            for match in self.head.finditer(file.read(_WINDOW)):
                record = self._read_record(file, start + match.start(), size)
                if record is None or record.kind not in kinds or record.end > size:
                    continue
                if self.is_unmistakable or self._leads_on(file, record.end, size):
                    return record
            start += _WINDOW - _LONGEST_MATCH
        return None

    def _leads_on(self, file: BinaryIO, position: int, size: int) -> bool:
        """Say whether a record, or the end of the file, is at a position."""
        record = self._read_record(file, position, size)
        return position == size if record is None else record.end <= size

    def _split(self, file: BinaryIO, start: int, end: int) -> Iterator[bytes]:
        """Give the records from one position up to another.

        Raises
        ------
        ValueError
            One of them is damaged.
        """
        while start < end:
            record = self._read_record(file, start, self._size)
            if record is None or record.end > end:
                raise ValueError(f"no record is at byte {start}")
            file.seek(start)
            yield file.read(record.end - start)
            start = record.end

    def _note(self, position: int, problem: str) -> None:
        """Note what is wrong with a chunk, unless it is clear since the file ends within it."""
        if position != self._cut_at:
            self.notes.add_damage(f"the chunk at byte {position} {problem}")
