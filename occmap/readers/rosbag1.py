"""ROS 1 bags, read from their start in the order in which they were written.

The rosbags library needs an index that is whole, and the bags of robots that lost power have none.
A walk over the records needs no index, so sound and damaged bags are read the same way.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from occmap.errors import LogError
from occmap.readers import Note
from occmap.readers.inflate import Buffer, inflate
from occmap.readers.ros_source import Channel, RawMessage, add_note
from occmap.readers.rosbag1_records import (
    BAG,
    CHUNK,
    CONNECTION,
    INDEX,
    INDEX_ENTRY,
    MAGIC,
    MESSAGE,
    RECORD_ERRORS,
    Header,
    parse_connection,
    read_header,
    split_messages,
    split_records,
)


class Bag1Source:
    """The channels and raw messages of a ROS 1 bag."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = []
        self._odd_index = False
        try:
            with path.open("rb") as file:
                self._size = file.seek(0, 2)
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
                yield from self._iterate_messages(position, block, by_id)

    def _survey_index(self, file: BinaryIO) -> dict[int, Channel]:
        """Find the connections and their counts in the index; none where it is not whole."""
        connections: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        chunks = 0
        bag = Header(b"", {}, 0)
        with suppress(*RECORD_ERRORS):
            for header, _ in self._walk(file):
                if header.opcode == BAG:
                    bag = header
                elif header.opcode == CHUNK:
                    chunks += 1
                elif header.opcode == INDEX:
                    counts[header.number(b"conn")] += header.number(b"count")
                elif header.opcode == CONNECTION:
                    data = file.read(header.length)
                    connections[header.number(b"conn")] = parse_connection(header, data)
        self._refuse_encrypted(bag)
        if _is_whole(bag, len(connections), chunks):
            return _with_counts(connections, counts)
        if not self.notes:
            add_note(self.notes, "the bag was not closed, and has no index: all of it is read")
        return {}

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
            with suppress(*RECORD_ERRORS):
                for header, start, end in split_records(block):
                    key = header.number(b"conn")
                    if header.opcode == MESSAGE:
                        counts[key] += 1
                    elif header.opcode == CONNECTION:
                        connections.setdefault(key, parse_connection(header, block[start:end]))
        return _with_counts(connections, counts)

    def _iterate_blocks(self, file: BinaryIO) -> Iterator[tuple[int, Buffer]]:
        """Give the bag's records in blocks: a chunk's, or one that stands by itself."""
        for header, position in self._walk(file):
            if header.opcode == CHUNK:
                data = file.read(header.length)
                size = int.from_bytes(header.fields.get(b"size", b""), "little")
                block, problem = inflate(data, header.text(b"compression"), size)
                if problem:
                    self._note(position, problem)
                yield position, block
            elif header.opcode in {MESSAGE, CONNECTION}:
                # The last chunk of a recording that was not closed: its length was never written.
                yield position, header.raw + file.read(header.length)

    def _walk(self, file: BinaryIO) -> Iterator[tuple[Header, int]]:
        """Give the header and position of each record, with the file at the record's data."""
        position = file.seek(len(MAGIC))
        while position < self._size:
            header = read_header(file)
            if header is None:
                break
            start = position + len(header.raw)
            end = start + self._find_length(header, position)
            if end <= self._size or header.opcode == CHUNK:
                yield header, position
            if end > self._size:
                break
            position = file.seek(end)
        if position < self._size:
            lost = self._size - position
            add_note(
                self.notes, f"the bag breaks off at byte {position}, {lost} bytes before its end"
            )

    def _find_length(self, header: Header, position: int) -> int:
        """Find how long a record's data is; some index records state another length than theirs."""
        count = header.fields.get(b"count")
        if header.opcode != INDEX or count is None:
            return header.length
        length = INDEX_ENTRY * header.number(b"count")
        if length != header.length and not self._odd_index:
            self._odd_index = True
            add_note(
                self.notes,
                f"index records state a wrong length, the first at byte {position};"
                " the messages are all there",
            )
        return length

    def _iterate_messages(
        self, position: int, block: Buffer, wanted: Mapping[int, Channel]
    ) -> Iterator[RawMessage]:
        """Give the messages of a block."""
        view = memoryview(block)
        try:
            for connection, record_ns, start, end in split_messages(view, wanted):
                yield wanted[connection], record_ns, view[start:end]
        except RECORD_ERRORS as error:
            self._note(position, f"cannot be read to its end ({error})")

    def _note(self, position: int, problem: str) -> None:
        add_note(self.notes, f"the chunk at byte {position} {problem}")


def _is_whole(bag: Header, connections: int, chunks: int) -> bool:
    """Say whether a bag was closed, and holds all that its header counts."""
    try:
        return bag.number(b"index_pos") > 0 and (connections, chunks) == (
            bag.number(b"conn_count"),
            bag.number(b"chunk_count"),
        )
    except LookupError:
        return False


def _with_counts(
    connections: Mapping[int, Channel], counts: Mapping[int, int]
) -> dict[int, Channel]:
    return {key: replace(item, count=counts.get(key, 0)) for key, item in connections.items()}
