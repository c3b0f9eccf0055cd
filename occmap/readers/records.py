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
from collections.abc import Callable, Collection, Container, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, ClassVar, TypeAlias

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import NoteList
from occmap.readers.containers import MAX_INFLATED, Buffer, Channel, RawMessage
from occmap.report import count

DESCRIPTION, CHUNK, OTHER = -1, -2, -3
"""Stand in place of a message's channel for a record that describes one, for one that holds others,
and for any other."""
_ANY = range(OTHER, 1 << 32)
"""Every kind of record"""
_WINDOW = 1 << 20
_LONGEST_MATCH = 64
"""Bytes that `head` looks at, at most."""


class FileBytes:
    """The bytes of a file, sliced as those of a chunk are."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, 2)

    def __len__(self) -> int:
        """How many there are."""
        return self._size

    def __getitem__(self, part: slice) -> memoryview:
        """Read some; of what is too long to be sound, only the first ones."""
        self._file.seek(min(part.start, self._size))
        # A record of a wrong length may be found to end before its message begins.
        return memoryview(self._file.read(min(max(part.stop - part.start, 0), MAX_INFLATED)))


Bytes: TypeAlias = FileBytes | memoryview
"""What holds records: a file, or what was in a chunk"""

Record: TypeAlias = tuple[int, int, int, int, int]
"""A message's channel, when it was recorded (ns), and where in the bytes the record begins, the
message begins, and both end. Any other record is all message. A plain tuple, since a log has tens
of thousands."""

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


class RecordSource(ABC):
    """The channels and raw messages of a file of records."""

    magic: ClassVar[bytes]
    """What a file begins with"""
    head: ClassVar[re.Pattern[bytes]]
    """What a record may begin with, as a look-ahead: the matches of damaged bytes may overlap"""
    unit: ClassVar[str] = "channel"
    """What the format calls a channel"""
    errors: ClassVar[tuple[type[Exception], ...]]
    """What is raised where a record is not well formed"""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._cut_at = -1
        """Where a record begins in the middle of which the file ends"""
        with refuse_unreadable(path), path.open("rb") as opened:
            summary = self._sum_up(FileBytes(opened))
        channels, counts, self._chunks = summary.channels, summary.counts, summary.chunks
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
        """Give the messages of some channels, in file order.

        They are copied out of a chunk that holds much else, so that none of them keeps it.
        """
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        with self.path.open("rb") as opened:
            file = FileBytes(opened)
            skipped = {at for at, held in self._chunks.items() if held and not by_id.keys() & held}
            for _, block, records in self._open_blocks(file, skipped):
                found = [each for each in records if each[0] in by_id]
                size = sum(end - start for _, _, _, start, end in found)
                copied = block is not file and 4 * size < len(block)
                for key, record_ns, _, start, end in found:
                    data = block[start:end]
                    yield by_id[key], record_ns, bytes(data) if copied else data

    @abstractmethod
    def _read_summary(self, file: FileBytes) -> Summary:
        """Read what the end of the file says of it; raises `errors` where it is damaged."""

    @abstractmethod
    def _parse(self, block: Bytes, at: int) -> Record | None:
        """Parse the head of a record, which may end beyond the block; None where there is none."""

    @abstractmethod
    def _open_chunk(self, position: int, record: memoryview) -> Buffer:
        """Decompress the chunk at a position, and note what is wrong with it."""

    @abstractmethod
    def _describe(self, descriptions: Descriptions) -> dict[int, Channel]:
        """Make channels of the records that describe them; of one number, the first counts."""

    def _sum_up(self, file: FileBytes) -> Summary:
        """Find the channels, and count their messages: from the end of the file, or from all of it.

        Where the end counts those of a channel, its count stands.
        """
        summary, problem = Summary(), ""
        try:
            summary = self._read_summary(file)
        except self.errors as error:
            problem = f"the index at its end cannot be used ({error})"
        if summary.is_whole:
            return summary
        descriptions: Descriptions = {}
        held = Counter[int]()
        for position, block, records in self._open_blocks(file):
            for key, _, start, _, end in records:
                if key >= 0:
                    held[key] += 1
                elif key == DESCRIPTION:
                    descriptions.setdefault(bytes(block[start:end]), position)
        if problem and not self.notes:
            self.notes.add_damage(f"{problem}: what should be in it is not known")
        summary.channels |= self._describe(descriptions)
        summary.counts = Counter({**held, **summary.counts})
        return summary

    def _open_blocks(
        self, file: FileBytes, skipped: Container[int] = ()
    ) -> Iterator[tuple[int, Bytes, Sequence[Record]]]:
        """Give what holds records, by its position, with the records in it.

        It is a chunk, but for some that are skipped, or the file itself for a record in the open.
        """
        for record in self._walk(file, len(self.magic), partial(self._tell, file)):
            kind, _, position, _, end = record
            if kind != CHUNK:
                yield position, file, (record,)
            elif position not in skipped:
                block = memoryview(self._open_chunk(position, file[position:end]))
                yield position, block, self._list_records(position, block)

    def _list_records(self, position: int, block: memoryview) -> Sequence[Record]:
        """List the records of a chunk; note where it is damaged."""
        damaged: list[int] = []
        records = list(self._walk(block, 0, lambda at, _: damaged.append(at)))
        if damaged:
            more = f" and in {len(damaged) - 1} more of its places" if len(damaged) > 1 else ""
            self._note(position, f"is damaged at byte {min(damaged)}{more}")
        return records

    def _walk(
        self, block: Bytes, at: int, tell: Callable[[int, Record | None], object]
    ) -> Iterator[Record]:
        """Give the records of a file or a chunk one by one, from a position on.

        Each begins where the one before ends. Where none does, either the length of the one before
        is wrong, or what follows it is damaged. So the next one is looked for from behind the start
        of the one before, which ends there at the latest. `tell` takes the place of the damage, and
        the record behind it.
        """
        size = len(block)
        record: Record = OTHER, 0, at, at, at  # of no bytes, so that each has one before it
        while (end := record[4]) != size:
            following = self._parse(block, end)
            # A chunk may end beyond the file: if its length is wrong, others are found behind it.
            if following is None or (following[4] > size and following[0] != CHUNK):
                following = self._find_next(block, record)
                until = following[2] if following else size
                tell(end if end <= until else record[2], following)
                record = _cut(record, until)
            yield record
            if following is None:
                return
            record = following
        yield record

    def _find_next(self, block: Bytes, record: Record) -> Record | None:
        """Find the next record behind one whose length may be wrong."""
        kind, _, begin, _, end = record
        if kind != CHUNK:
            return self._find(block, begin + 1)
        # What begins within a chunk lies in it, unless it is of the kinds that stand around chunks.
        # Behind its end, messages may have lost the head of their own chunk.
        found = self._find(block, begin + 1, (CHUNK, OTHER)), self._find(block, end)
        return min(filter(None, found), key=itemgetter(2), default=None)

    def _find(self, block: Bytes, at: int, kinds: Container[int] = _ANY) -> Record | None:
        """Find the first record of some kinds from a position on; it leads to another, or the end.

        Anything may look like a record, but not like two of them in a row.
        """
        while at < len(block):
            for match in self.head.finditer(block[at : at + _WINDOW]):
                record = self._parse(block, at + match.start())
                if record and record[0] in kinds and self._leads_on(block, record[4]):
                    return record
            at += _WINDOW - _LONGEST_MATCH
        return None

    def _leads_on(self, block: Bytes, at: int) -> bool:
        """Say whether a whole record, or the end, is at a position."""
        record = self._parse(block, at)
        return record[4] <= len(block) if record else at == len(block)

    def _tell(self, file: FileBytes, at: int, following: Record | None) -> None:
        """Note that a file is damaged at a byte, and where it is read on."""
        record, size = self._parse(file, at), len(file)
        if following:
            text = f"damaged at byte {at}, read on from byte {following[2]}"
        elif record is None:
            text = f"from byte {at} on, the last {count(size - at, 'byte')} hold no whole record"
        else:
            self._cut_at = at
            there = f"{size - at:,} of its {record[4] - at:,} bytes are there"
            text = f"the file ends in the middle of the record at byte {at}: {there}"
        self.notes.add_damage(text)

    def _note(self, position: int, problem: str) -> None:
        """Note what is wrong with a chunk, unless it is clear since the file ends within it."""
        if position != self._cut_at:
            self.notes.add_damage(f"the chunk at byte {position} {problem}")


def _cut(record: Record, until: int) -> Record:
    """Let a record end at a position at the latest."""
    kind, record_ns, begin, start, end = record
    return kind, record_ns, begin, min(start, until), min(end, until)
