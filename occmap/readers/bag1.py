"""ROS 1 bags of format 2.0: closed or not, whole or cut.

http://wiki.ros.org/Bags/Format/2.0 says what their records are.
"""

import re
import struct
from collections.abc import Iterator
from io import BytesIO

from rosbags.rosbag1.reader import Header, ReaderError, read_uint32

from occmap.readers import records
from occmap.readers.containers import Buffer, Channel, inflate
from occmap.readers.records import Bytes, Descriptions, FileBytes, Record, RecordSource, Summary

MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
"""The opcodes."""
_INFO_ENTRY = struct.Struct("<II")
"""An entry of the record about a chunk: a connection, and how many messages it has there."""
_ENTRY_BYTES = {INDEX: 12, CHUNK_INFO: _INFO_ENTRY.size}
"""Bytes of an entry; the header states how many there are. Behind a chunk: a time and an offset."""
_KINDS = {CONNECTION: records.DESCRIPTION, CHUNK: records.CHUNK} | dict.fromkeys(
    (INDEX, CHUNK_INFO, BAG), records.OTHER
)
"""What records are to `records`; a message is its channel."""
_LONGEST_HEADER = 1 << 12
"""Bytes of a header and its lengths, at most; it is a hundred bytes, and the name of a topic."""

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


class Bag1Source(RecordSource):
    """The channels and raw messages of a ROS 1 bag."""

    magic = b"#ROSBAG V2.0\n"
    errors = (ReaderError, struct.error, LookupError, ValueError)
    head = re.compile(rb"(?=..\x00{2}..\x00{2}[a-z_]+=)", re.DOTALL)
    """A header starts with its length, and that of its first field."""
    unit = "connection"

    def _parse(self, block: Bytes, at: int) -> Record | None:
        head = block[at : at + _LONGEST_HEADER]
        match = _MESSAGE_HEAD.match(head)
        if match is not None and match.end() == _MESSAGE_HEAD_SIZE:
            connection, time, length = match.group("conn", "time", "length")
            key, start = int.from_bytes(connection, "little"), at + _MESSAGE_HEAD_SIZE
            return key, _read_time(time), at, start, start + int.from_bytes(length, "little")
        try:
            header, start, length = parse_header(head)
            opcode, start = header["op"][0], at + start
            if opcode == MESSAGE:
                record_ns = _read_time(header["time"])
                return header.get_uint32("conn"), record_ns, at, start, start + length
            if opcode in _ENTRY_BYTES:
                # There are bags whose recorder stated another length; the entries have one size.
                length = _ENTRY_BYTES[opcode] * header.get_uint32("count")
            return _KINDS[opcode], 0, at, at, start + length
        except self.errors:
            return None

    def _open_chunk(self, position: int, record: memoryview) -> Buffer:
        try:
            header, start, _ = parse_header(record)
            compression, size = header.get_string("compression"), header.get_uint32("size")
        except self.errors:
            self._note(position, "does not say how it is compressed")
            return b""
        block, problem = inflate(record[start:], compression, size)
        if problem:
            self._note(position, problem)
        return block

    def _describe(self, descriptions: Descriptions) -> dict[int, Channel]:
        found: dict[int, Channel] = {}
        for record, position in descriptions.items():
            try:
                source = BytesIO(record)
                header, fields = Header.read(source), Header.read(source)
                described = Channel(
                    topic=header.get_string("topic"),
                    type=fields.get_string("type"),
                    encoding="ros1",
                    definition=fields["message_definition"].decode(errors="replace"),
                )
                found.setdefault(header.get_uint32("conn"), described)
            except self.errors:
                self._note(position, "holds a connection that cannot be read")
        return found

    def _read_summary(self, file: FileBytes) -> Summary:
        """Read the index at the end, which is there if the bag was closed."""
        start = len(self.magic)
        bag, _, _ = parse_header(file[start : start + _LONGEST_HEADER])
        if not (start := bag.get_uint64("index_pos")):
            raise ValueError("the bag was not closed")
        summary, chunks = Summary(is_whole=True), 0
        descriptions: Descriptions = {}
        for record in self._split(file, start):
            header, at, _ = parse_header(record)
            if header["op"][0] == CONNECTION:
                descriptions[record] = 0
            elif header["op"][0] == CHUNK_INFO:
                chunks += 1
                for key, messages in _INFO_ENTRY.iter_unpack(record[at:]):
                    summary.counts[key] += messages
        summary.channels = self._describe(descriptions)
        announced = bag.get_uint32("conn_count"), bag.get_uint32("chunk_count")
        if announced != (len(summary.channels), chunks) or summary.counts.keys() - summary.channels:
            raise ValueError("it has not what the start of the bag says")
        return summary

    def _split(self, block: Bytes, at: int) -> Iterator[bytes]:
        """Give the records from a position on; raises ValueError where one is damaged."""
        while at < len(block):
            record = self._parse(block, at)
            if record is None or record[4] > len(block):
                raise ValueError(f"no record is at byte {at}")
            yield bytes(block[at : record[4]])
            at = record[4]


def parse_header(block: Buffer) -> tuple[Header, int, int]:
    """Parse the header that a block starts with, and find where its data begins and how long it is.

    Raises
    ------
    ReaderError
        The block breaks off, or holds something else.
    """
    source = BytesIO(block)
    header, length = Header.read(source), read_uint32(source)
    return header, source.tell(), length


def _read_time(value: bytes) -> int:
    """Read a time in ns."""
    seconds, nanoseconds = map(int, _TIME.unpack(value))
    return seconds * 1_000_000_000 + nanoseconds
