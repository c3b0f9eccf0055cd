"""MCAP files in every variant that https://mcap.dev/spec allows, by the library and its options."""

import struct
from collections.abc import Collection, Iterator, Sequence
from functools import reduce
from io import BytesIO
from itertools import combinations
from operator import or_
from unittest import mock

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from tests.readers.ros import Written, add_messages, encode

MESSAGES = 3
"""In each chunk."""
PACK = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
ALONE = (
    *("repeated schemas", "repeated channels", "statistics", "summary offsets", "padding"),
    *("attachment", "attachment index", "metadata", "metadata index", "checksums"),
)
"""What a file may have or lack, whether it has chunks or not."""
OF_CHUNKS = ("message index", "chunk index")
INDEXES = {f"{kind.name} index".lower(): kind for kind in IndexType}


def list_variants() -> Iterator[frozenset[str]]:
    """Name what each variant has."""
    for size in range(len(ALONE) + 1):
        for has in combinations(ALONE, size):
            yield frozenset(has)
            for chunked in ((), ("message index",), ("chunk index",), OF_CHUNKS):
                yield frozenset({"chunks", *chunked, *has})


def write_variant(log: Sequence[Written], has: Collection[str], compression: str = "") -> bytes:
    """Write a log of ROS 2 messages as a file that has some features and lacks the others."""
    out, channels = BytesIO(), dict[str, int]()
    writer = Writer(
        out,
        compression=PACK[compression],
        index_types=reduce(or_, (INDEXES[each] for each in has if each in INDEXES), IndexType.NONE),
        repeat_channels="repeated channels" in has,
        repeat_schemas="repeated schemas" in has,
        use_chunking="chunks" in has,
        use_statistics="statistics" in has,
        use_summary_offsets="summary offsets" in has,
        enable_crcs="checksums" in has,
        enable_data_crcs="checksums" in has,
    )
    finish = pad if "padding" in has else FINISH
    with mock.patch.object(RecordBuilder, "finish_record", finish):
        writer.start("ros2", "occmap's tests")
        if "attachment" in has:
            writer.add_attachment(1, 2, "plan.txt", "text/plain", b"walls")
        for start in range(0, len(log), MESSAGES):
            add_messages(writer, map(encode, log[start : start + MESSAGES]), channels)
            writer.flush()  # type: ignore[no-untyped-call]
        if "metadata" in has:
            writer.add_metadata("site", {"floor": "third"})
        writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


FINISH = RecordBuilder.finish_record


def pad(builder: RecordBuilder) -> None:
    """End a record with bytes that a reader must pass over, where its fields may end before it."""
    opcode = builder._buffer.getbuffer()[builder._record_start_offset]
    if opcode not in {Opcode.MESSAGE, Opcode.FOOTER, Opcode.ATTACHMENT}:
        builder.write(b"\x01\xff\xff")
    FINISH(builder)  # type: ignore[no-untyped-call]


def list_records(
    data: bytes | bytearray, opcode: int, at: int = 8, end: int | None = None
) -> list[tuple[int, int]]:
    """Position and length of each record of a kind, its head included; in plain chunks, too."""
    found = []
    while at < (len(data) - 8 if end is None else end):
        kind, length = struct.unpack_from("<BQ", data, at)
        found += [(at, 9 + length)] if kind == opcode else []
        if kind == Opcode.CHUNK and not data[at + 37]:  # its compression has no name
            (size,) = struct.unpack_from("<Q", data, at + 41)
            found += list_records(data, opcode, at + 49, at + 49 + size)
        at += 9 + length
    return found
