"""The records of ROS 1 bags, format 2.0, as http://wiki.ros.org/Bags/Format/2.0 has them."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO, NamedTuple

from occmap.readers.containers.inflate import Buffer
from occmap.readers.containers.records import DESCRIPTION, OTHER, Inner

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


def read_header(file: BinaryIO, position: int) -> Header | None:
    """Read the header at a position of a file; None where there is none."""
    file.seek(position)
    with suppress(*RECORD_ERRORS):
        return parse_header(file.read(_LONGEST_HEADER), 0)
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
    fields = parse_fields(bytes(block[at + _LENGTH.size : end]))
    header = Header(bytes(block[at : end + _LENGTH.size]), fields, data_length)
    if not _FIELDS[header.opcode] <= fields.keys():
        raise LookupError("a field is missing")
    return header


def parse_fields(header: bytes) -> dict[bytes, bytes]:
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


def parse_records(block: memoryview, at: int) -> Iterator[Inner]:
    """Give the records of a chunk from an offset on, up to the first that is damaged."""
    with suppress(*RECORD_ERRORS):
        while at < len(block):
            match = _MESSAGE_HEAD.match(block, at)
            if match is not None and match.end() == at + _MESSAGE_HEAD_SIZE:
                start = match.end()
                key, record_ns = int.from_bytes(match["conn"], "little"), _read_time(match["time"])
                at = start + int.from_bytes(match["length"], "little")
            else:
                header = parse_header(block, at)
                key, record_ns, start = OTHER, 0, at
                at += len(header.raw) + header.length
                if header.opcode == MESSAGE:
                    key, record_ns = header.number(b"conn"), _read_time(header.fields[b"time"])
                    start = at - header.length
                elif header.opcode == CONNECTION:
                    key = DESCRIPTION
            yield key, record_ns, start, at
