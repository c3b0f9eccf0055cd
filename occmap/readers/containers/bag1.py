"""ROS 1 bags: closed or not, whole or cut."""

import re
import struct
from bisect import bisect
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from occmap.errors import LogError
from occmap.readers.containers import bag1_records as records
from occmap.readers.containers.chunked import ChunkedSource
from occmap.readers.containers.inflate import Buffer, inflate
from occmap.readers.containers.records import Descriptions, Record, RecordBlock
from occmap.readers.containers.source import Channel

UNCLOSED = "the bag was not closed, or its index is damaged: all of it is read"


@dataclass
class _Index:
    """What the records around the messages of a bag say that it holds."""

    bag: records.Header = records.NO_HEADER
    descriptions: Descriptions = field(default_factory=dict)
    chunks: list[int] = field(default_factory=list)
    """Where they begin"""
    at_end: dict[int, Counter[int]] = field(default_factory=dict)
    """Messages by connection of the chunk at a position, as the end of the bag has them."""
    behind: list[tuple[int, int, int]] = field(default_factory=list)
    """The records behind the chunks: position, connection, and how many messages it has."""

    def add(self, record: Record, file: BinaryIO) -> None:
        """Take in a record, whose data the file is at."""
        header = records.parse_header(record.head, 0)
        if record.opcode == records.BAG:
            self.bag = header
        elif record.opcode == records.CHUNK:
            self.chunks.append(record.position)
        elif record.opcode == records.INDEX:
            messages = record.length // records.ENTRY_BYTES[records.INDEX]
            self.behind.append((record.position, header.number(b"conn"), messages))
        elif record.opcode == records.CONNECTION:
            self.descriptions[record.head + file.read(record.length)] = record.position
        elif record.opcode == records.CHUNK_INFO:
            counts = self.at_end.setdefault(header.number(b"chunk_pos"), Counter())
            with suppress(struct.error):
                for key, messages in records.INFO_ENTRY.iter_unpack(file.read(record.length)):
                    counts[key] += messages

    def is_closed(self, connections: int) -> bool:
        """Whether the bag has the index that it states, with so many connections."""
        stated = self.bag.number(b"conn_count"), self.bag.number(b"chunk_count")
        has_index = self.bag.number(b"index_pos") > 0 and connections > 0
        return has_index and stated == (connections, len(self.at_end))

    def find_problem(self) -> str:
        """Say in what the index at the end differs from what lies before it; "" if in nothing."""
        if len(self.chunks) != len(self.at_end):
            return f"{len(self.chunks)} chunks are in it, its index has {len(self.at_end)}"
        if self.count_behind() != self.count_at_end():
            return "the indexes of its chunks and the one at its end differ"
        return ""

    def count_at_end(self) -> Counter[int]:
        """Count the messages of each connection by the end of the bag."""
        return sum(self.at_end.values(), Counter())

    def count_behind(self) -> Counter[int]:
        """Count them by the records behind its chunks."""
        counts: Counter[int] = Counter()
        for _, key, messages in self.behind:
            counts[key] += messages
        return +counts

    def count_parts(self) -> tuple[Counter[int], set[int]]:
        """Count the messages that a damaged index tells of, and find the chunks that it lost.

        A bag has two indexes: records behind each chunk, and one at its end, which is believed only
        where those are lost.
        """
        if self.at_end and max(self.at_end) not in self.chunks:
            # Bytes are lost or added, so that the positions at the end are those of no chunk.
            at_end = self.count_at_end()
            has_all = len(self.chunks) <= len(self.at_end)
            return at_end | self.count_behind() if has_all else at_end, set()
        places = sorted({*self.at_end, *self.chunks})
        by_chunk = [Counter(self.at_end.get(at)) for at in places]
        for position, key, messages in self.behind:
            if messages and (place := bisect(places, position)):
                by_chunk[place - 1][key] = messages
        lost = {at for at, counts in zip(places, by_chunk, strict=True) if not counts}
        return sum(by_chunk, Counter()), lost


class Bag1Source(ChunkedSource):
    """The channels and raw messages of a ROS 1 bag."""

    magic = b"#ROSBAG V2.0\n"
    chunk = records.CHUNK
    plain = frozenset({records.MESSAGE, records.CONNECTION})
    """The last chunk of a recording that was not closed has no length yet: they lie open."""
    unit = "connection"
    head = re.compile(rb"(?=..\x00{2}..\x00{2}[a-z_]+=)", re.DOTALL)
    """A header starts with its length, and that of its first field."""
    _parse_records = staticmethod(records.parse_records)

    def __init__(self, path: Path) -> None:
        self._odd_index = False
        super().__init__(path)

    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Take the connections and their counts from a whole index; else read all of the bag."""
        index = _Index()
        for record in self._walk(file):
            index.add(record, file)
        if encryptor := index.bag.text(b"encryptor"):
            raise LogError(
                f"the bag is encrypted with {encryptor}",
                where=self.path,
                fix="decrypt it with `rosbag decrypt` first",
            )
        channels = dict(self._describe(index.descriptions))
        is_closed = index.is_closed(len(channels))
        problem = index.find_problem() if is_closed else UNCLOSED
        if not problem:
            return channels, index.count_at_end()
        if not self.notes:
            self.notes.add_damage(problem)
        counts, lost = index.count_parts()
        if lost := lost - {self._cut_at}:
            text = f"nothing is left of the index of {len(lost)} of its {len(index.chunks)} chunks"
            self.notes.add_damage(f"{text}: how many messages they should hold is not known")
        found, held = self._survey(file)
        # Of a bag that was not closed, only what the survey finds is sure to be a connection.
        channels = found | channels if is_closed else found
        known = channels.keys() | held.keys()
        return channels, held | Counter({key: counts[key] for key in counts.keys() & known})

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        header = records.read_header(file, position)
        if header is None:
            return None
        if header.opcode in records.ENTRY_BYTES:
            length = self._measure_entries(file, header, position)
        elif header.opcode == records.CHUNK:
            length = self._measure_chunk(file, header, position)
        else:
            length = header.length
        return Record(header.opcode, position, header.raw, length, header.opcode == records.CHUNK)

    def _measure_entries(self, file: BinaryIO, header: records.Header, position: int) -> int:
        """Find how long a record of an index is: the number of its entries is more often right."""
        length = records.ENTRY_BYTES[header.opcode] * header.number(b"count")
        if length != header.length and not self._odd_index:
            self._odd_index = True
            text = f"index records state a wrong length, the first at byte {position}"
            self.notes.add_damage(f"{text}; the messages are all there")
        following = position + len(header.raw) + length
        return length if self._leads_on(file, following) else header.length

    def _measure_chunk(self, file: BinaryIO, header: records.Header, position: int) -> int:
        """Find how long the data of a chunk is; where it states a wrong length, up to what follows.

        The length is right if something follows there, or if it gives a chunk that its records
        fill: then it is what follows that is damaged.
        """
        start, stated = position + len(header.raw), header.length
        if self._leads_on(file, start + stated):
            return stated
        following = self._find_record(file, start, self._size, chunk_end=self._size)
        if following == self._size:
            return stated
        if start + stated < following:
            file.seek(start)
            block, problem = _inflate(header, file.read(stated))
            if not problem and self._is_filled(memoryview(block)):
                return stated
        self._note(position, "states a wrong length")
        return following - start

    def _is_filled(self, block: memoryview) -> bool:
        """Say whether records follow one another up to the end of a chunk."""
        ends = [end for *_, end in records.parse_records(block, 0)]
        return ends[-1:] == [len(block)]

    def _leads_on(self, file: BinaryIO, position: int) -> bool:
        """Say whether a record, or the end of the file, is at a position."""
        return position == self._size or records.read_header(file, position) is not None

    def _peek(self, file: BinaryIO, position: int, size: int) -> int:
        header = records.read_header(file, position)
        is_whole = header is not None and position + len(header.raw) + header.length <= size
        return header.opcode if header and is_whole else 0

    def _open_chunk(self, record: Record, body: bytes, _file: BinaryIO) -> RecordBlock:
        block, problem = _inflate(records.parse_header(record.head, 0), body)
        if problem:
            self._note(record.position, problem)
        return RecordBlock(record.position, block)

    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        for record, position in descriptions.items():
            try:
                header = records.parse_header(record, 0)
                fields = records.Header(b"", records.parse_fields(record[len(header.raw) :]), 0)
            except records.RECORD_ERRORS:
                self._note(position, "holds a connection that cannot be read")
                continue
            yield (
                header.number(b"conn"),
                Channel(
                    topic=header.text(b"topic"),
                    type=fields.text(b"type"),
                    encoding="ros1",
                    definition=fields.text(b"message_definition"),
                ),
            )


def _inflate(header: records.Header, body: bytes) -> tuple[Buffer, str]:
    """Decompress a chunk, and say what is wrong with it."""
    return inflate(body, header.text(b"compression"), header.number(b"size"))
