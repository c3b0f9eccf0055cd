"""The records of MCAP files, as https://mcap.dev/spec has them, and the summary at the end."""

import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from occmap.readers.containers.records import DESCRIPTION, Inner

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""What every record starts with: opcode and length of the body."""
_MESSAGE_DATA = 31
"""Where a message's own bytes start in its record."""
RECORD_ERRORS = (McapError, struct.error, ArithmeticError, LookupError, MemoryError, ValueError)
"""What the mcap library raises on records that are not well formed."""

_FOOTER_BODY = 20
_FOOTER_LENGTH = HEAD.size + _FOOTER_BODY
_LONGEST_DATA_END = 255
"""Four bytes, and what a writer may add to them."""
_LAST_OPCODE = 15
_CHUNK = re.compile(
    rb".{28}(\x00{4}|\x03\x00{3}lz4|\x04\x00{3}(none|zstd))(?P<length>.{5}\x00{3})", re.DOTALL
)
"""How the body of a chunk starts."""
CHUNK_START = 44
"""Bytes of it that say how long the chunk is."""
_INDEX_ENTRY = 16
"""Bytes of an entry: a time, and where in the chunk the message lies."""
_MOST_INDEX = 1 << 24
"""Bytes of an index that are read at most: a million messages."""
_MOST_SUMMARY = 1 << 30
_MESSAGE_HEAD = struct.Struct("<BQHIQ")
"""Opcode, length, channel, sequence number, record time; a second time follows."""
_LATEST_NS = 2**63 - 1
"""A time beyond this is damage."""
DESCRIPTIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})


def parse_records(block: memoryview, at: int) -> Iterator[Inner]:
    """Give the records of a chunk from an offset on, up to the first that is damaged."""
    message, last = int(Opcode.MESSAGE), len(block) - _MESSAGE_HEAD.size
    while at <= last:
        opcode, length, key, _, record_ns = _MESSAGE_HEAD.unpack_from(block, at)
        start, end = at + _MESSAGE_DATA, at + HEAD.size + length
        if opcode == message and start <= end:
            yield key, min(record_ns, _LATEST_NS), start, end
        elif opcode in DESCRIPTIONS:
            yield DESCRIPTION, 0, at, end
        else:
            return
        at = end


def read_head(file: BinaryIO) -> tuple[int, int]:
    """Read opcode and length of the record that the file is at; zeros where the file ends."""
    opcode, length = HEAD.unpack(file.read(HEAD.size).ljust(HEAD.size, b"\0"))
    return opcode, length


def measure_chunk(body: bytes) -> int:
    """Find how long the body of a chunk is by its first bytes; -1 where it is none of a chunk."""
    match = _CHUNK.match(body)
    return match.end() + int.from_bytes(match["length"], "little") if match else -1


def leads_on(file: BinaryIO, position: int, size: int) -> bool:
    """Say whether records follow one another from a position on."""
    for _ in range(2):
        if position > size - HEAD.size:
            return position == size
        file.seek(position)
        opcode, length = read_head(file)
        if not _is_plausible(opcode, length, size - position - HEAD.size):
            return False
        if opcode == Opcode.FOOTER:
            return True
        position += HEAD.size + length
    return True


def is_record(file: BinaryIO, position: int, opcode: int, length: int, size: int) -> bool:
    """Say whether a record of a file of `size` bytes can have the head that it has."""
    start = position + HEAD.size
    if opcode > _LAST_OPCODE:  # of a kind that is yet to come: it must lead to another record
        return leads_on(file, start + length, size)
    if length > size - start:  # the file may be cut within it
        return opcode > 0
    return _is_plausible(opcode, length, size - start)


def _is_plausible(opcode: int, length: int, left: int) -> bool:
    """Say whether a record can be of a kind and length, where `left` bytes of the file follow."""
    if opcode == Opcode.DATA_END and length > _LONGEST_DATA_END:
        return False
    if opcode == Opcode.FOOTER:
        return length == _FOOTER_BODY and left == _FOOTER_BODY + len(MAGIC)
    return 0 < opcode <= _LAST_OPCODE and length <= left


def count_indexed(file: BinaryIO) -> int:
    """Count the messages that are named by the indexes from the file's position on."""
    messages = 0
    opcode, length = read_head(file)
    while opcode == Opcode.MESSAGE_INDEX:
        body = file.read(min(length, _MOST_INDEX))
        size = int.from_bytes(body[2:6], "little")  # of the entries, behind the channel's number
        messages += size // _INDEX_ENTRY
        opcode, length = read_head(file)
    return messages


def read_summary(file: BinaryIO, size: int) -> tuple[Summary, bool, str]:
    """Read the summary at the end of a file, which may be absent.

    Returns
    -------
    summary, is_checked, problem
        Whether it has a checksum, and may be relied on to pass over chunks; and what is wrong.
    """
    end = size - _FOOTER_LENGTH - len(MAGIC)
    file.seek(max(end, 0))
    tail = file.read()
    if end < 0 or not tail.endswith(MAGIC):
        return Summary(), False, "the file is cut before its end"
    if tail[0] != Opcode.FOOTER:
        return Summary(), False, "the footer is damaged"
    footer = Footer.read(ReadDataStream(BytesIO(tail[HEAD.size :])))
    start = footer.summary_start or end
    file.seek(min(start, end))
    section = file.read(min(end - file.tell(), _MOST_SUMMARY))
    # The checksum covers the footer, too, up to the checksum itself.
    crc = zlib.crc32(tail[: _FOOTER_LENGTH - 4], zlib.crc32(section))
    if start > end or footer.summary_crc not in {0, crc}:
        return Summary(), False, "the summary at its end is damaged"
    try:
        return _parse_summary(section + tail), footer.summary_crc != 0, ""
    except RECORD_ERRORS:
        return Summary(), False, "the summary at its end cannot be read"


def _parse_summary(end: bytes) -> Summary:
    """Parse the end of a file. The library does so, too, but unpacks what it takes for chunks.

    Raises
    ------
    McapError, struct.error, LookupError, ValueError
        A record is not well formed, or the last is cut.
    """
    summary = Summary()
    for record in StreamReader(BytesIO(end), skip_magic=True, emit_chunks=True).records:
        if isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
        elif isinstance(record, Statistics):
            summary.statistics = record
        elif isinstance(record, ChunkIndex):
            summary.chunk_indexes.append(record)
    return summary
