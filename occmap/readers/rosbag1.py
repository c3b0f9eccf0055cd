"""ROS 1 bags, read from their start in the order in which they were written.

The rosbags library needs an index that is whole, and the bags of robots that lost power have none.
A walk over the records needs no index, so sound and damaged bags are read the same way.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

from occmap.errors import LogError
from occmap.readers import Note, NoteList, Span, make_part
from occmap.readers.inflate import Buffer, inflate
from occmap.readers.ros_source import Channel, RawMessage, add_note
from occmap.readers.rosbag1_records import (
    BAG,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    INDEX_ENTRY,
    INFO_ENTRY,
    MAGIC,
    MESSAGE,
    RECORD_ERRORS,
    Findings,
    Header,
    find_header,
    leads_on,
    parse_connection,
    read_header,
    split_messages,
)
from occmap.wording import count

_EVERY_ID = range(1 << 32)


@dataclass
class _Index:
    """What the records around the messages of a bag say that it holds."""

    bag: Header = Header(b"", {}, 0)  # noqa: RUF009  it is not changed
    kinds: Counter[int] = field(default_factory=Counter)
    connections: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    """Messages by connection, as the end of the bag has them."""
    entries: Counter[int] = field(default_factory=Counter)
    """Messages by connection, as the records behind each chunk have them."""

    def add(self, header: Header, data: bytes) -> None:
        """Take in a record.

        Raises
        ------
        struct.error, LookupError
            It is not well formed.
        """
        if header.opcode == BAG:
            self.bag = header
        elif header.opcode == INDEX:
            self.entries[header.number(b"conn")] += header.number(b"count")
        elif header.opcode == CHUNK_INFO:
            for key, count in INFO_ENTRY.iter_unpack(data):
                self.counts[key] += count
        elif header.opcode == CONNECTION:
            self.connections[header.number(b"conn")] = parse_connection(header, data)
        self.kinds[header.opcode] += 1

    def is_whole(self) -> bool:
        """Say whether the bag was closed, and its end is as long as its header has it."""
        try:
            return self.bag.number(b"index_pos") > 0 and (
                len(self.connections),
                self.kinds[CHUNK_INFO],
            ) == (self.bag.number(b"conn_count"), self.bag.number(b"chunk_count"))
        except LookupError:
            return False


class Bag1Source:
    """The channels and raw messages of a ROS 1 bag."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = NoteList()
        self._odd_index = False
        self._has_doubles = False
        self._chunks: list[int] = []
        """Where chunks begin, in a bag whose index is whole"""
        try:
            with path.open("rb") as file:
                self._size = file.seek(0, 2)
                self._span = Span(len(MAGIC), self._size)
                self._by_id = self._survey_index(file) or self._survey_chunks(file)
        except OSError as error:
            raise LogError(f"cannot be read ({error.strerror})", where=path) from None
        if self.notes and not self._by_id:
            found = "; ".join(note.text for note in self.notes[:3])
            raise LogError(f"nothing in it can be read: {found}", where=path)

    @property
    def channels(self) -> Sequence[Channel]:
        """Every connection of the bag."""
        return list(self._by_id.values())

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some connections, in file order."""
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        with self.path.open("rb") as file:
            for position, block in self._iterate_blocks(file):
                view = memoryview(block)
                findings = Findings()
                for connection, record_ns, start, end in split_messages(view, by_id, findings):
                    yield by_id[connection], record_ns, view[start:end]
                self._note_damage(position, findings)

    def split(self, size: int) -> Sequence["Bag1Source"]:
        """Cut the bag between chunks, into parts of about so many bytes."""
        if self.notes or self._has_doubles:
            return [self]
        cuts = [self._span.start]
        cuts += [at for before, at in pairwise(self._chunks) if at // size > before // size]
        return [make_part(self, _span=Span(*ends)) for ends in pairwise([*cuts, self._span.end])]

    def _survey_index(self, file: BinaryIO) -> dict[int, Channel]:
        """Find the connections and their counts in the index; none where it is not whole."""
        index = _Index()
        chunk_starts = []
        for header, position, length in self._walk(file):
            if header.opcode == CHUNK:
                chunk_starts.append(position)
            data = file.read(length) if header.opcode in {CHUNK_INFO, CONNECTION} else b""
            with suppress(*RECORD_ERRORS):
                index.add(header, data)
        self._refuse_encrypted(index.bag)
        chunks, infos = index.kinds[CHUNK], index.kinds[CHUNK_INFO]
        self._has_doubles = chunks > infos
        if not index.is_whole():
            if not self.notes:
                text = "the bag was not closed, or its index is damaged: all of it is read"
                add_note(self.notes, text)
            return {}
        if chunks != infos:
            add_note(self.notes, f"{chunks} chunks are in it, its index has {infos}")
        if +index.entries != +index.counts:
            add_note(self.notes, "the indexes of its chunks and the one at its end differ")
        self._chunks = chunk_starts
        return self._add_counts(index.connections, index.counts)

    def _refuse_encrypted(self, bag: Header) -> None:
        if encryptor := bag.text(b"encryptor"):
            raise LogError(
                f"the bag is encrypted with {encryptor}",
                where=self.path,
                fix="decrypt it with `rosbag decrypt` first",
            )

    def _survey_chunks(self, file: BinaryIO) -> dict[int, Channel]:
        """Find the connections and count their messages by reading the whole bag."""
        connections: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        for _, block in self._iterate_blocks(file):
            findings = Findings(connections)
            counts.update(key for key, *_ in split_messages(block, _EVERY_ID, findings))
        return self._add_counts(connections, counts)

    def _add_counts(
        self, connections: Mapping[int, Channel], counts: Counter[int]
    ) -> dict[int, Channel]:
        """Say of each connection how many messages it has, and note those of no connection."""
        if lost := sum(count for key, count in counts.items() if key not in connections):
            add_note(self.notes, f"the bag names no connection for {count(lost, 'message')}")
        return {key: replace(item, count=counts[key]) for key, item in connections.items()}

    def _iterate_blocks(self, file: BinaryIO) -> Iterator[tuple[int, Buffer]]:
        """Give the bag's records in blocks: a chunk's, or one that stands by itself."""
        seen: set[int] = set()
        for header, position, length in self._walk(file):
            if header.opcode == CHUNK:
                data = file.read(length)
                if self._has_doubles and hash(data) in seen:
                    self._note(position, "is there twice, and is used once")
                    continue
                seen.add(hash(data) if self._has_doubles else 0)
                size = int.from_bytes(header.fields.get(b"size", b""), "little")
                block, problem = inflate(data, header.text(b"compression"), size)
                if problem:
                    self._note(position, problem)
                yield position, block
            elif header.opcode in {MESSAGE, CONNECTION}:
                # The last chunk of a recording that was not closed: its length was never written.
                yield position, header.raw + file.read(length)

    def _walk(self, file: BinaryIO) -> Iterator[tuple[Header, int, int]]:
        """Give header, position and length of each record, with the file at the record's data.

        Behind damage it goes on with the next record that is sound.
        """
        position = behind = self._span.start
        chunk_end = 0
        while position < self._span.end:
            file.seek(position)
            header = read_header(file)
            start = position + len(header.raw) if header else position
            end = start + self._find_length(file, header, position) if header else self._size + 1
            if header and (end <= self._size or header.opcode == CHUNK):
                file.seek(start)
                yield header, position, min(end, self._size) - start
                if end > self._size:
                    break
                position, behind = end, start
                chunk_end = end if header.opcode == CHUNK else 0
            elif (found := find_header(file, behind, self._size, chunk_end)) is not None:
                add_note(self.notes, f"damaged at byte {position}, read on from byte {found}")
                position, behind = found, found + 1
            else:
                break
        if position < self._span.end:
            lost = self._size - position
            unread = f"from byte {position} on, the last {count(lost, 'byte')} hold no whole record"
            add_note(self.notes, unread)

    def _find_length(self, file: BinaryIO, header: Header, position: int) -> int:
        """Find how long a record's data is, where it states another length than it has."""
        start = position + len(header.raw)
        if header.opcode == INDEX and b"count" in header.fields:
            length = INDEX_ENTRY * header.number(b"count")
            if length != header.length and not self._odd_index:
                self._odd_index = True
                add_note(
                    self.notes,
                    f"index records state a wrong length, the first at byte {position};"
                    " the messages are all there",
                )
            return length if leads_on(file, start + length, self._size) else header.length
        if header.opcode == CHUNK and not leads_on(file, start + header.length, self._size):
            following = find_header(file, start, self._size, chunk_end=self._size)
            if following is not None:
                self._note(position, "states a wrong length")
                return following - start
        return header.length

    def _note_damage(self, position: int, findings: Findings) -> None:
        if places := findings.damaged:
            more = f" and in {len(places) - 1} more of its places" if len(places) > 1 else ""
            self._note(position, f"is damaged at byte {places[0]}{more}")
        for key, other in findings.connections.items():
            known = self._by_id.get(key, other)
            if known.description != other.description:
                add_note(self.notes, f"connection {key} is described in two ways: {known.topic}")

    def _note(self, position: int, problem: str) -> None:
        add_note(self.notes, f"the chunk at byte {position} {problem}")
