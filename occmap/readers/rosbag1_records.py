"""The records of a ROS 1 bag, format 2.0: http://wiki.ros.org/Bags/Format/2.0."""

import re
import struct
from collections.abc import Container, Iterator
from typing import BinaryIO, NamedTuple

from occmap.readers.inflate import Buffer
from occmap.readers.ros_source import Channel

MAGIC = b"#ROSBAG V2.0\n"

MESSAGE, BAG, INDEX, CHUNK, CONNECTION = 2, 3, 4, 5, 7
"""The opcodes that matter; 6 sums up a chunk in the index at the end."""
INDEX_ENTRY = 12
"""Bytes of an entry of an index record: a time and an offset."""

RECORD_ERRORS = (struct.error, LookupError, ValueError)

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_VALUES = {b"conn": b"(?P<conn>.{4})", b"time": b"(?P<time>.{8})"}
"""What differs between the headers of messages."""
_MAX_HEADER = 1 << 20
"""A header is a hundred bytes; one that claims to be longer than this is no header."""


class Header(NamedTuple):
    """What comes before a record's data."""

    raw: bytes
    """As it lies in the file, with both lengths."""
    fields: dict[bytes, bytes]
    length: int
    """Of the data."""

    @property
    def opcode(self) -> int:
        """What kind of record this is; 0 where the header does not say."""
        return self.fields.get(b"op", b"\0")[0]

    def number(self, name: bytes) -> int:
        """Read an unsigned integer.

        Raises
        ------
        LookupError
            The header has no such field.
        """
        return int.from_bytes(self.fields[name], "little")

    def text(self, name: bytes) -> str:
        """Read a text, "" where there is none."""
        return self.fields.get(name, b"").decode(errors="replace")

    def time_ns(self) -> int:
        """Read when a message was recorded."""
        return _read_time(self.fields[b"time"])


def read_header(file: BinaryIO) -> Header | None:
    """Read a record's header; None where the file ends or holds something else."""
    start = file.read(_LENGTH.size)
    try:
        (length,) = _LENGTH.unpack(start)
        raw = start + file.read(min(length, _MAX_HEADER) + _LENGTH.size)
        return _parse_header(raw, 0)
    except RECORD_ERRORS:
        return None


def split_records(block: Buffer, at: int = 0) -> Iterator[tuple[Header, int, int]]:
    """Give the header of each record, from an offset on, and where its data starts and ends.

    Raises
    ------
    struct.error, LookupError
        The block breaks off, or holds something else.
    """
    while at < len(block):
        header = _parse_header(block, at)
        start = at + len(header.raw)
        at = start + header.length
        _check_end(block, start, at)
        yield header, start, at


def split_messages(block: Buffer, wanted: Container[int]) -> Iterator[tuple[int, int, int, int]]:
    """Give connection, time (ns), start and end of the data of each message of these connections.

    A program writes the headers of all its messages alike, so most are read by the pattern of the
    one before them: in a tenth of the time that it takes field by field.

    Raises
    ------
    struct.error, LookupError
        As `split_records`.
    """
    at = 0
    pattern: re.Pattern[bytes] | None = None
    while at < len(block):
        match = pattern.match(block, at) if pattern else None
        if match is None:
            header, start, end = next(split_records(block, at))
            if header.opcode == MESSAGE:
                pattern = _describe_alike(header)
                if (connection := header.number(b"conn")) in wanted:
                    yield connection, header.time_ns(), start, end
        else:
            start = match.end()
            end = start + _LENGTH.unpack(match["length"])[0]
            _check_end(block, start, end)
            (connection,) = _LENGTH.unpack(match["conn"])
            if connection in wanted:
                yield connection, _read_time(match["time"]), start, end
        at = end


def _describe_alike(header: Header) -> re.Pattern[bytes] | None:
    """Build what matches the headers that differ from one in connection, time and length alone.

    None where the header is not as recorders write it: there may be anything in it.
    """
    if header.fields.keys() != {b"op", *_VALUES}:
        return None
    parts = [re.escape(header.raw[: _LENGTH.size])]
    for name, value in header.fields.items():
        start = name + b"="
        parts.append(re.escape(_LENGTH.pack(len(start) + len(value)) + start))
        parts.append(_VALUES.get(name) or re.escape(value))
    pattern = re.compile(b"".join(parts) + b"(?P<length>.{4})", re.DOTALL)
    return pattern if pattern.fullmatch(header.raw) else None  # a field may stand in it twice


def parse_connection(header: Header, data: Buffer) -> Channel:
    """Build the channel of a connection record."""
    fields = Header(b"", _parse_fields(data), 0)
    return Channel(
        topic=header.text(b"topic"),
        type=fields.text(b"type"),
        encoding="ros1",
        definition=fields.text(b"message_definition"),
        syntax="msg",
    )


def _check_end(block: Buffer, start: int, end: int) -> None:
    if end > len(block):
        raise LookupError(f"{len(block) - start} of {end - start} bytes are there")


def _read_time(value: bytes) -> int:
    """Read a time in ns."""
    seconds, nanoseconds = _TIME.unpack(value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _parse_header(block: Buffer, at: int) -> Header:
    """Parse the header that starts at an offset of a block."""
    (length,) = _LENGTH.unpack_from(block, at)
    end = at + _LENGTH.size + length
    (data_length,) = _LENGTH.unpack_from(block, end)
    fields = _parse_fields(block[at + _LENGTH.size : end])
    if len(fields.get(b"op", b"")) != 1:
        raise LookupError("a record without an opcode")
    return Header(bytes(block[at : end + _LENGTH.size]), fields, data_length)


def _parse_fields(header: Buffer) -> dict[bytes, bytes]:
    """Parse `name=value` fields, each with its length before it."""
    fields = {}
    at = 0
    while at < len(header):
        (length,) = _LENGTH.unpack_from(header, at)
        at += _LENGTH.size + length
        name, _, value = bytes(header[at - length : at]).partition(b"=")
        fields[name] = value
    return fields
