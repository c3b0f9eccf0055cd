"""MCAP files in every variant that https://mcap.dev/spec allows, written record by record."""

import struct
import zlib
from collections.abc import Collection, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from tests.readers.ros import ROS2, Written

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 3, 4, 5, 6, 7, 8
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = 9, 10, 11, 12, 13
SUMMARY_OFFSET, DATA_END, FOOTER, HEADER = 14, 15, 2, 1
MESSAGES = 3
"""In each chunk."""

PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
ALONE = (
    *("repeated schemas", "repeated channels", "statistics", "summary offsets", "padding"),
    *("attachment", "attachment index", "metadata", "metadata index", "checksums"),
)
"""What a file may have or lack, whether it has chunks or not."""
OF_CHUNKS = ("message index", "chunk index")


class Chunked(NamedTuple):
    """A chunk, and what indexes say of it."""

    start: int
    length: int
    times: tuple[int, int]
    indexes: dict[int, int]
    index_length: int
    compression: str
    sizes: tuple[int, int]


def list_variants() -> Iterator[frozenset[str]]:
    """Name what each variant has."""
    for size in range(len(ALONE) + 1):
        for has in combinations(ALONE, size):
            yield frozenset(has)
            for chunked in ((), ("message index",), ("chunk index",), OF_CHUNKS):
                yield frozenset({"chunks", *chunked, *has})


def write_variant(log: Sequence[Written], has: Collection[str], compression: str = "") -> bytes:
    """Write a log of ROS 2 messages as a file that has some features and lacks the others."""
    return _Writer(has, compression).write(log)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


class _Writer:
    def __init__(self, has: Collection[str], compression: str) -> None:
        self._has = has
        self._compression = compression
        self._out = bytearray(MAGIC)
        self._descriptions: dict[str, tuple[bytes, bytes]] = {}
        self._chunks: list[Chunked] = []
        self._others: list[tuple[str, bytes]] = []

    def write(self, log: Sequence[Written]) -> bytes:
        self._out += self._record(HEADER, text("ros2") + text("occmap's tests"))
        self._add_other("attachment", self._record(ATTACHMENT, self._attachment()))
        pairs = text("floor") + text("third")
        metadata = text("site") + struct.pack("<I", len(pairs)) + pairs
        if "chunks" in self._has:
            for start in range(0, len(log), MESSAGES):
                self._add_chunk(log[start : start + MESSAGES])
        else:
            for written in log:
                self._out += self._describe(written.topic, written.message.__msgtype__)
                self._out += self._message(written)
        self._add_other("metadata", self._record(METADATA, metadata))
        crc = zlib.crc32(self._out) if "checksums" in self._has else 0
        self._out += self._record(DATA_END, struct.pack("<I", crc))
        self._add_summary(log)
        return bytes(self._out)

    def _record(self, opcode: int, body: bytes) -> bytes:
        plain = opcode in {MESSAGE, FOOTER, ATTACHMENT}  # whose fields reach to the end
        body += b"\x01\xff\xff" if "padding" in self._has and not plain else b""
        return struct.pack("<BQ", opcode, len(body)) + body

    def _describe(self, topic: str, kind: str) -> bytes:
        """The schema and channel of a topic, where they have not been written yet."""
        if topic in self._descriptions:
            return b""
        key = len(self._descriptions) + 1
        definition, _ = ROS2.generate_msgdef(kind, ros_version=2)
        schema = struct.pack("<H", key) + text(kind) + text("ros2msg") + text(definition)
        channel = struct.pack("<HH", key, key) + text(topic) + text("cdr") + struct.pack("<I", 0)
        records = self._record(SCHEMA, schema), self._record(CHANNEL, channel)
        self._descriptions[topic] = records
        return b"".join(records)

    def _message(self, written: Written) -> bytes:
        data = bytes(ROS2.serialize_cdr(written.message, written.message.__msgtype__))
        head = struct.pack("<HIQQ", self._key(written.topic), 0, *[written.record_ns] * 2)
        return self._record(MESSAGE, head + data)

    def _key(self, topic: str) -> int:
        return list(self._descriptions).index(topic) + 1

    def _add_other(self, kind: str, record: bytes) -> None:
        if kind in self._has:
            self._others.append((kind, struct.pack("<QQ", len(self._out), len(record))))
            self._out += record

    def _attachment(self) -> bytes:
        body = struct.pack("<QQ", 1, 2) + text("plan.txt") + text("text/plain")
        body += struct.pack("<Q", 5) + b"walls"
        return body + struct.pack("<I", zlib.crc32(body) if "checksums" in self._has else 0)

    def _add_chunk(self, log: Sequence[Written]) -> None:
        records = bytearray()
        entries: dict[int, bytes] = {}
        for written in log:
            records += self._describe(written.topic, written.message.__msgtype__)
            key = self._key(written.topic)
            entry = struct.pack("<QQ", written.record_ns, len(records))
            entries[key] = entries.get(key, b"") + entry
            records += self._message(written)
        times = min(item.record_ns for item in log), max(item.record_ns for item in log)
        crc = zlib.crc32(records) if "checksums" in self._has else 0
        packed = PACK[self._compression](bytes(records))
        body = struct.pack("<QQQI", *times, len(records), crc) + text(self._compression)
        start = len(self._out)
        self._out += self._record(CHUNK, body + struct.pack("<Q", len(packed)) + packed)
        length, indexes = len(self._out) - start, {}
        if "message index" in self._has:
            for key, entry in entries.items():
                indexes[key] = len(self._out)
                head = struct.pack("<HI", key, len(entry))
                self._out += self._record(MESSAGE_INDEX, head + entry)
        rest = len(self._out) - start - length
        sizes = len(packed), len(records)
        chunk = Chunked(start, length, times, indexes, rest, self._compression, sizes)
        self._chunks.append(chunk)

    def _add_summary(self, log: Sequence[Written]) -> None:
        groups = {
            SCHEMA: [schema for schema, _ in self._descriptions.values()],
            CHANNEL: [channel for _, channel in self._descriptions.values()],
            STATISTICS: [self._record(STATISTICS, self._count(log))],
            CHUNK_INDEX: [self._record(CHUNK_INDEX, self._index(chunk)) for chunk in self._chunks],
            ATTACHMENT_INDEX: [
                self._record(
                    ATTACHMENT_INDEX,
                    place + struct.pack("<QQQ", 1, 2, 5) + text("plan.txt") + text("text/plain"),
                )
                for kind, place in self._others
                if kind == "attachment"
            ],
            METADATA_INDEX: [
                self._record(METADATA_INDEX, place + text("site"))
                for kind, place in self._others
                if kind == "metadata"
            ],
        }
        names = {
            SCHEMA: "repeated schemas",
            CHANNEL: "repeated channels",
            STATISTICS: "statistics",
            CHUNK_INDEX: "chunk index",
            ATTACHMENT_INDEX: "attachment index",
            METADATA_INDEX: "metadata index",
        }
        start, offsets = len(self._out), b""
        for opcode, records in groups.items():
            if records and names[opcode] in self._has:
                group = b"".join(records)
                place = struct.pack("<BQQ", opcode, len(self._out), len(group))
                offsets += self._record(SUMMARY_OFFSET, place)
                self._out += group
        end = len(self._out)
        if end > start and "summary offsets" in self._has:
            self._out += offsets
        places = start if end > start else 0, end if len(self._out) > end else 0
        self._out += struct.pack("<BQQQ", FOOTER, 20, *places)
        crc = zlib.crc32(self._out[start:]) if "checksums" in self._has else 0
        self._out += struct.pack("<I", crc) + MAGIC

    def _count(self, log: Sequence[Written]) -> bytes:
        topics = [written.topic for written in log]
        kinds = [kind for kind, _ in self._others]
        numbers = len(topics), len(self._descriptions), len(self._descriptions)
        others = kinds.count("attachment"), kinds.count("metadata"), len(self._chunks)
        times = min(item.record_ns for item in log), max(item.record_ns for item in log)
        counts = b"".join(
            struct.pack("<HQ", self._key(topic), topics.count(topic))
            for topic in self._descriptions
        )
        head = struct.pack("<QHIIIIQQ", *numbers, *others, *times)
        return head + struct.pack("<I", len(counts)) + counts

    @staticmethod
    def _index(chunk: Chunked) -> bytes:
        offsets = b"".join(struct.pack("<HQ", *item) for item in chunk.indexes.items())
        return (
            struct.pack("<QQQQ", *chunk.times, chunk.start, chunk.length)
            + struct.pack("<I", len(offsets))
            + offsets
            + struct.pack("<Q", chunk.index_length)
            + text(chunk.compression)
            + struct.pack("<QQ", *chunk.sizes)
        )
