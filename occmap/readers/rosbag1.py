"""ROS 1 bags: closed or not, whole or cut."""

from collections import Counter
from collections.abc import Container, Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from occmap.errors import LogError
from occmap.readers.chunked import Block, ChunkedSource, Record
from occmap.readers.inflate import inflate
from occmap.readers.ros_source import Channel, add_note
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
    ChannelTable,
    Header,
    find_header,
    leads_on,
    parse_header,
    read_header,
    split_messages,
)


class _Index:
    """What the records around the messages of a bag say that it holds."""

    def __init__(self) -> None:
        self.bag = Header(b"", {}, 0)
        self.table = ChannelTable()
        self.chunks: list[int] = []
        """Where they begin"""
        self.infos = 0
        """Chunks, as the end of the bag has them."""
        self.counts: Counter[int] = Counter()
        """Messages by connection, as the end of the bag has them."""
        self.entries: Counter[int] = Counter()
        """Messages by connection, as the records behind each chunk have them."""

    def add(self, record: Record, file: BinaryIO) -> None:
        """Take in a record, whose data the file is at."""
        header = parse_header(record.head, 0)
        if record.opcode == BAG:
            self.bag = header
        elif record.opcode == CHUNK:
            self.chunks.append(record.position)
        elif record.opcode == INDEX:
            self.entries[header.number(b"conn")] += header.number(b"count")
        with suppress(*RECORD_ERRORS):
            if record.opcode == CONNECTION:
                self.table.add(header, file.read(record.length))
            elif record.opcode == CHUNK_INFO:
                self.infos += 1
                for key, messages in INFO_ENTRY.iter_unpack(file.read(record.length)):
                    self.counts[key] += messages


class Bag1Source(ChunkedSource[ChannelTable]):
    """The channels and raw messages of a ROS 1 bag."""

    magic = MAGIC
    chunk = CHUNK
    plain = frozenset({MESSAGE, CONNECTION})
    """The last chunk of a recording that was not closed has no length yet: they lie open."""
    unit = "connection"
    table = ChannelTable
    find_record = staticmethod(find_header)

    def __init__(self, path: Path) -> None:
        self._odd_index = False
        super().__init__(path)

    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Take the connections and their counts from a whole index; else read all of the bag."""
        index = _Index()
        for record in self._walk(file):
            index.add(record, file)
        bag, chunks, infos = index.bag, len(index.chunks), index.infos
        if encryptor := bag.text(b"encryptor"):
            raise LogError(
                f"the bag is encrypted with {encryptor}",
                where=self.path,
                fix="decrypt it with `rosbag decrypt` first",
            )
        self._has_doubles = chunks > infos
        channels = dict(index.table.build())
        stated = bag.number(b"conn_count"), bag.number(b"chunk_count")
        if not (channels and bag.number(b"index_pos") and stated == (len(channels), infos)):
            if not self.notes:
                text = "the bag was not closed, or its index is damaged: all of it is read"
                add_note(self.notes, text)
            return self._survey(file)
        if chunks != infos:
            add_note(self.notes, f"{chunks} chunks are in it, its index has {infos}")
        if +index.entries != +index.counts:
            add_note(self.notes, "the indexes of its chunks and the one at its end differ")
        self._chunks = index.chunks
        return channels, index.counts

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        file.seek(position)
        header = read_header(file)
        if header is None:
            return None
        length = self._find_length(file, header, position)
        is_chunk = header.opcode == CHUNK
        return Record(header.opcode, position, header.raw, length, is_sure=is_chunk)

    def _find_length(self, file: BinaryIO, header: Header, position: int) -> int:
        """Find how long a record's data is, where it states another length than it has."""
        start = position + len(header.raw)
        if header.opcode == INDEX:
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

    def _open_chunk(self, record: Record, body: bytes, _file: BinaryIO) -> Block:
        header = parse_header(record.head, 0)
        block, problem = inflate(body, header.text(b"compression"), header.number(b"size"))
        if problem:
            self._note(record.position, problem)
        return Block(record.position, block)

    def _split_block(
        self, block: Block, wanted: Container[int], table: ChannelTable
    ) -> Iterator[tuple[int, int, memoryview]]:
        view = memoryview(block.records)
        damaged: list[int] = []
        for connection, record_ns, start, end in split_messages(view, wanted, table, damaged):
            yield connection, record_ns, view[start:end]
        if damaged:
            more = f" and in {len(damaged) - 1} more of its places" if len(damaged) > 1 else ""
            self._note(block.position, f"is damaged at byte {damaged[0]}{more}")
