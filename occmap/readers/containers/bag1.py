"""ROS 1 bags: closed or not, whole or cut.

The records of format 2.0, as http://wiki.ros.org/Bags/Format/2.0 has it, come first, then the file
that is made of them.
"""

import re
import struct
from bisect import bisect
from collections import Counter
from collections.abc import Container, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from occmap.errors import LogError
from occmap.readers.containers.chunked import EVERY_ID, Block, ChunkedSource, Descriptions, Record
from occmap.readers.containers.inflate import Buffer, inflate
from occmap.readers.containers.source import Channel

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""The opcodes."""
INFO_ENTRY = struct.Struct("<II")
"""An entry of the record about a chunk: a connection, and how many messages it has there."""
ENTRY_BYTES = {INDEX: 12, CHUNK_INFO: INFO_ENTRY.size}
"""Bytes of an entry; the header states how many there are. Behind a chunk: a time and an offset."""

RECORD_ERRORS = (struct.error, LookupError, ValueError)

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_MESSAGE_HEAD = re.compile(
    rb"\x26\x00{3}(?:\x09\x00{3}conn=(?P<conn>.{4})|\x04\x00{3}op=\x02|\x0d\x00{3}time=(?P<time>.{8}))"
    rb"{3}(?P<length>.{4})",
    re.DOTALL,
)
"""The header of a message as recorders write it, but for the order of its fields. A bag is read in
half the time by it, and a polygon build takes an eighth less."""
_MESSAGE_HEAD_SIZE = 46
"""Bytes of such a header if it has each field once, which the pattern does not ask for."""
_FIELDS = {
    MESSAGE: {b"conn", b"time"},
    BAG: set(),
    INDEX: {b"conn", b"count"},
    CHUNK: {b"compression", b"size"},
    CHUNK_INFO: {b"chunk_pos", b"count"},
    CONNECTION: {b"conn", b"topic"},
}
"""Which fields the header of each kind must have."""
_HEAD = re.compile(rb"(?=..\x00{2}..\x00{2}[a-z_]+=)", re.DOTALL)
"""How a header starts: with its length, and that of its first field."""
_WINDOW = 1 << 20
_LONGEST_HEADER = 1 << 12
"""Bytes of a header and its lengths, at most; it is a hundred bytes, and the name of a topic."""


class Header(NamedTuple):
    """What comes before a record's data."""

    raw: bytes
    """As it lies in the file, with both lengths."""
    fields: dict[bytes, bytes]
    length: int
    """Bytes of the data."""

    @property
    def opcode(self) -> int:
        """What kind of record this is; 0 where the header does not say."""
        return self.fields.get(b"op", b"\0")[0]

    def number(self, name: bytes) -> int:
        """Read an unsigned integer, 0 where there is none."""
        return int.from_bytes(self.fields.get(name, b""), "little")

    def text(self, name: bytes) -> str:
        """Read a text, "" where there is none."""
        return self.fields.get(name, b"").decode(errors="replace")


NO_HEADER = Header(b"", {}, 0)


def split_messages(
    block: Block, wanted: Container[int], descriptions: Descriptions, damaged: list[int]
) -> Iterator[tuple[int, int, int, int]]:
    """Find the messages of some connections. A damaged record ends nothing: the next is looked for.

    Parameters
    ----------
    descriptions
        Gets the records of connections.
    damaged
        Gets where in the block records are damaged.

    Yields
    ------
    message
        Its connection, when it was recorded (ns), and where in the block its bytes start and end.
    """
    position, records, *_ = block
    at = behind = 0
    while at < len(records):
        match = _MESSAGE_HEAD.match(records, at)
        try:
            if match is not None and match.end() == at + _MESSAGE_HEAD_SIZE:
                start = match.end()
                end = start + _LENGTH.unpack(match["length"])[0]
                (connection,) = _LENGTH.unpack(match["conn"])
                record_ns = _read_time(match["time"]) if connection in wanted else 0
            else:
                header = parse_header(records, at)
                start = at + len(header.raw)
                end = start + header.length
                connection = header.number(b"conn") if header.opcode == MESSAGE else -1
                record_ns = _read_time(header.fields[b"time"]) if connection in wanted else 0
                if header.opcode == CONNECTION and end <= len(records):
                    descriptions.setdefault(bytes(records[at:end]), position)
            if end > len(records):
                raise LookupError(f"{len(records) - start} of {end - start} bytes are there")
        except RECORD_ERRORS:
            damaged.append(at)
            found = find_header(BytesIO(records), behind, len(records))
            at, behind = (len(records), 0) if found is None else (found, found + 1)
            continue
        if connection in wanted:
            yield connection, record_ns, start, end
        at, behind = end, start


def find_header(file: BinaryIO, start: int, size: int, chunk_end: int = 0) -> int | None:
    """Find where records go on behind damage; None where they do not.

    Before `chunk_end`, messages and connections are passed over: they lie in the chunk.
    """
    while start < size:
        file.seek(start)
        window = file.read(_WINDOW)
        for match in _HEAD.finditer(window):
            position = start + match.start()
            header = _try_header(window, match.start(), size - start)
            if header is None:
                continue
            if position >= chunk_end or header.opcode not in {MESSAGE, CONNECTION}:
                return position
        start += _WINDOW - _LONGEST_HEADER
    return None


def _leads_on(file: BinaryIO, position: int, size: int) -> bool:
    """Say whether a record, or the end of the file, is at a position."""
    if position >= size:
        return position == size
    file.seek(position)
    return _try_header(file.read(_LONGEST_HEADER)) is not None


def _try_header(block: Buffer, at: int = 0, size: int | None = None) -> Header | None:
    """Parse what may be a header; None where it is none, or its data reaches beyond a size."""
    with suppress(*RECORD_ERRORS):
        header = parse_header(block, at)
        if size is None or at + len(header.raw) + header.length <= size:
            return header
    return None


def _read_time(value: bytes) -> int:
    """Read a time in ns."""
    seconds, nanoseconds = _TIME.unpack(value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def parse_header(block: Buffer, at: int) -> Header:
    """Parse the header that starts at an offset of a block.

    Raises
    ------
    struct.error, LookupError
        The block breaks off, or holds something else.
    """
    (length,) = _LENGTH.unpack_from(block, at)
    end = at + _LENGTH.size + length
    (data_length,) = _LENGTH.unpack_from(block, end)
    fields = _parse_fields(bytes(block[at + _LENGTH.size : end]))
    header = Header(bytes(block[at : end + _LENGTH.size]), fields, data_length)
    if not _FIELDS[header.opcode] <= fields.keys():
        raise LookupError("a field is missing")
    return header


def _parse_fields(header: bytes) -> dict[bytes, bytes]:
    """Parse `name=value` fields, each with its length before it."""
    fields = {}
    at, size = 0, len(header)
    unpack = _LENGTH.unpack_from
    while at < size:
        start = at + _LENGTH.size
        at = start + unpack(header, at)[0]
        name, _, value = header[start:at].partition(b"=")
        fields[name] = value
    if at > size:
        raise LookupError("a header that breaks off")
    return fields


@dataclass
class _Index:
    """What the records around the messages of a bag say that it holds."""

    bag: Header = NO_HEADER
    descriptions: Descriptions = field(default_factory=dict)
    chunks: list[int] = field(default_factory=list)
    """Where they begin"""
    at_end: dict[int, Counter[int]] = field(default_factory=dict)
    """Messages by connection of the chunk at a position, as the end of the bag has them."""
    behind: list[tuple[int, int, int]] = field(default_factory=list)
    """The records behind the chunks: position, connection, and how many messages it has."""

    def add(self, record: Record, file: BinaryIO) -> None:
        """Take in a record, whose data the file is at."""
        header = parse_header(record.head, 0)
        if record.opcode == BAG:
            self.bag = header
        elif record.opcode == CHUNK:
            self.chunks.append(record.position)
        elif record.opcode == INDEX:
            messages = record.length // ENTRY_BYTES[INDEX]
            self.behind.append((record.position, header.number(b"conn"), messages))
        elif record.opcode == CONNECTION:
            self.descriptions[record.head + file.read(record.length)] = record.position
        elif record.opcode == CHUNK_INFO:
            counts = self.at_end.setdefault(header.number(b"chunk_pos"), Counter())
            with suppress(struct.error):
                for key, messages in INFO_ENTRY.iter_unpack(file.read(record.length)):
                    counts[key] += messages

    def count(self) -> tuple[Counter[int], Counter[int]]:
        """Count the messages of each connection by the end of the bag, and behind its chunks."""
        behind: Counter[int] = Counter()
        for _, key, messages in self.behind:
            behind[key] += messages
        return sum(self.at_end.values(), Counter()), +behind

    def count_parts(self) -> tuple[Counter[int], set[int]]:
        """Count what is left of a damaged index, and find the chunks of which nothing is left.

        Of a chunk, the records behind it count, and where one is lost, the end of the bag does.
        """
        if self.at_end and max(self.at_end) not in self.chunks:
            # Bytes are lost or added, so that the positions at the end are those of no chunk.
            at_end, behind = self.count()
            return at_end if len(self.chunks) > len(self.at_end) else at_end | behind, set()
        places = sorted({*self.at_end, *self.chunks})
        counts = {at: dict(self.at_end.get(at, {})) for at in places}
        for position, key, messages in self.behind:
            if messages and (place := bisect(places, position)):
                counts[places[place - 1]][key] = messages
        total: Counter[int] = Counter()
        for each in counts.values():
            total.update(each)
        return total, {at for at, each in counts.items() if not each}


class Bag1Source(ChunkedSource):
    """The channels and raw messages of a ROS 1 bag."""

    magic = b"#ROSBAG V2.0\n"
    chunk = CHUNK
    plain = frozenset({MESSAGE, CONNECTION})
    """The last chunk of a recording that was not closed has no length yet: they lie open."""
    unit = "connection"
    find_record = staticmethod(find_header)

    def __init__(self, path: Path) -> None:
        self._odd_index = False
        super().__init__(path)

    def _find_channels(self, file: BinaryIO) -> tuple[dict[int, Channel], Counter[int]]:
        """Take the connections and their counts from a whole index; else read all of the bag."""
        index = _Index()
        for record in self._walk(file):
            index.add(record, file)
        bag, chunks, infos = index.bag, len(index.chunks), len(index.at_end)
        if encryptor := bag.text(b"encryptor"):
            raise LogError(
                f"the bag is encrypted with {encryptor}",
                where=self.path,
                fix="decrypt it with `rosbag decrypt` first",
            )
        channels = dict(self._describe(index.descriptions))
        counts, behind = index.count()
        stated = bag.number(b"conn_count"), bag.number(b"chunk_count")
        is_closed = bag.number(b"index_pos") and stated == (len(channels), infos) and channels
        if not is_closed:
            problem = "the bag was not closed, or its index is damaged: all of it is read"
        elif chunks != infos:
            problem = f"{chunks} chunks are in it, its index has {infos}"
        elif behind != counts:
            problem = "the indexes of its chunks and the one at its end differ"
        else:
            self._chunks = index.chunks
            return channels, counts
        if not self.notes:
            self.notes.add_damage(problem)
        counts, lost = index.count_parts()
        if lost := lost - {self._cut_at}:
            text = f"nothing is left of the index of {len(lost)} of its {chunks} chunks"
            self.notes.add_damage(f"{text}: how many messages they should hold is not known")
        self._has_doubles = chunks > infos
        found, held = self._survey(file)
        channels = found | channels if is_closed else found
        known = channels.keys() | held.keys()
        return channels, held | Counter({key: counts[key] for key in counts.keys() & known})

    def _read_record(self, file: BinaryIO, position: int) -> Record | None:
        file.seek(position)
        header = _try_header(file.read(_LONGEST_HEADER))
        if header is None:
            return None
        length = self._find_length(file, header, position)
        return Record(header.opcode, position, header.raw, length, header.opcode == CHUNK)

    def _find_length(self, file: BinaryIO, header: Header, position: int) -> int:
        """Find how long a record's data is, where it states another length than it has."""
        start, stated = position + len(header.raw), header.length
        if header.opcode in ENTRY_BYTES:
            length = ENTRY_BYTES[header.opcode] * header.number(b"count")
            if length != stated and not self._odd_index:
                self._odd_index = True
                self.notes.add_damage(
                    f"index records state a wrong length, the first at byte {position};"
                    " the messages are all there",
                )
            return length if _leads_on(file, start + length, self._size) else stated
        if header.opcode != CHUNK or _leads_on(file, start + stated, self._size):
            return stated
        following = find_header(file, start, self._size, chunk_end=self._size)
        if following is None:
            return stated
        if start + stated < following:  # what follows is the damage if messages fill the chunk
            file.seek(start)
            block, problem = _inflate(header, file.read(stated))
            ends = [end for *_, end in split_messages(Block(0, block), EVERY_ID, {}, [])]
            if not problem and ends[-1:] == [len(block)]:
                return stated
        self._note(position, "states a wrong length")
        return following - start

    def _open_chunk(self, record: Record, body: bytes, _file: BinaryIO) -> Block:
        block, problem = _inflate(parse_header(record.head, 0), body)
        if problem:
            self._note(record.position, problem)
        return Block(record.position, block)

    def _split_block(
        self, block: Block, wanted: Container[int], descriptions: Descriptions
    ) -> Iterator[tuple[int, int, memoryview]]:
        view = memoryview(block.records)
        damaged: list[int] = []
        for connection, record_ns, start, end in split_messages(
            block, wanted, descriptions, damaged
        ):
            yield connection, record_ns, view[start:end]
        if damaged:
            more = f" and in {len(damaged) - 1} more of its places" if len(damaged) > 1 else ""
            self._note(block.position, f"is damaged at byte {damaged[0]}{more}")

    def _describe(self, descriptions: Descriptions) -> Iterator[tuple[int, Channel]]:
        for record, position in descriptions.items():
            try:
                header = parse_header(record, 0)
                fields = Header(b"", _parse_fields(record[len(header.raw) :]), 0)
            except RECORD_ERRORS:
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


def _inflate(header: Header, body: bytes) -> tuple[Buffer, str]:
    """Decompress a chunk, and say what is wrong with it."""
    return inflate(body, header.text(b"compression"), header.number(b"size"))
