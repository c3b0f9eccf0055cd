"""What every container of ROS messages gives: channels, and the raw messages of some of them.

Decompression never gives more than was announced, and gives what lies before damage.
"""

from bz2 import BZ2File
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
import zstandard
from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]  # it ships no types

from occmap.readers import NoteList
from occmap.types import Bool, Int64, UInt8


def normalise_type(name: str) -> str:
    """Bring a message type to its ROS 2 form: `tf/tfMessage` becomes `tf/msg/tfMessage`."""
    package, slash, base = name.rpartition("/")
    return f"{package}/msg/{base}" if slash and not package.endswith("/msg") else name


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """One publisher's messages on a topic. Compared by identity: two may look alike."""

    topic: str
    type: str
    """As recorded, in ROS 1 or ROS 2 form."""
    encoding: str
    """How messages are written as bytes; occmap reads cdr, ros1, json and protobuf."""
    definition: str = ""
    """The message type and those that it is made of, in the text that ROS writes; empty where the
    log has none, or has it in IDL, which ROS makes of types of its own: these are known anyway."""
    count: int = 0
    """Messages in the log."""
    descriptors: bytes = b""
    """The protobuf FileDescriptorSet of the type, where `encoding` is "protobuf"."""

    @property
    def description(self) -> tuple[str, str, str, str, bytes]:
        """The fields that must be equal where a log describes a channel twice."""
        return self.topic, self.type, self.encoding, self.definition, self.descriptors

    @property
    def kind(self) -> str:
        """The type in its ROS 2 form."""
        return normalise_type(self.type)


Buffer: TypeAlias = bytes | memoryview

BLOCK_BYTES = 1 << 20
"""Messages that do not lie in a chunk of their file are put together until they are so long."""
MESSAGE_BYTES = 100
"""What a message that is held takes in memory beside its own bytes."""


RawMessage: TypeAlias = tuple[int, int, Buffer]
"""The number of a message's channel, when it was recorded (ns), and its bytes"""


class Messages(NamedTuple):
    """Messages that lie in one block of bytes, in the order in which they were written.

    They come many at a time, since a log has tens of thousands.
    """

    channels: Mapping[int, Channel]
    """By the numbers that stand for them"""
    data: UInt8
    """The block"""
    key: Int64
    """(M,) the number of the channel of each"""
    record_ns: Int64
    """(M,) when each was recorded"""
    start: Int64
    end: Int64
    """(M,) where each lies in the block"""

    @property
    def channel(self) -> Channel:
        """That of the first one."""
        return self.channels[int(self.key[0])]

    @property
    def length(self) -> int:
        """How many bytes the first one has."""
        return int(self.end[0] - self.start[0])

    @property
    def size(self) -> int:
        """How many bytes all of them have."""
        return int((self.end - self.start).sum())

    @property
    def first(self) -> tuple[int, memoryview]:
        """The time and the bytes of the first one."""
        return next(self.take(slice(1)).split())[1:]

    def list_raw(self) -> Iterator[tuple[int, int, memoryview]]:
        """Give the number of the channel, the time and the bytes of each."""
        columns, data = (self.key, self.record_ns, self.start, self.end), self.data.data
        for key, record_ns, start, end in zip(*(each.tolist() for each in columns), strict=True):
            yield key, record_ns, data[start:end]

    def split(self) -> Iterator[tuple[Channel, int, memoryview]]:
        """Give the channel, the time and the bytes of each."""
        return ((self.channels[key], at, data) for key, at, data in self.list_raw())

    def take(self, some: slice | Bool | Int64) -> Self:
        """Select some."""
        key, record_ns, start, end = (column[some] for column in self[2:])
        return self._replace(key=key, record_ns=record_ns, start=start, end=end)

    def group(self, most_bytes: int) -> Iterator[Self]:
        """Give those of one channel and length together, in their order."""
        length = self.end - self.start
        order = np.lexsort((length, self.key))
        key, length = self.key[order], length[order]
        cuts = np.flatnonzero((np.diff(key) != 0) | (np.diff(length) != 0)) + 1
        for first, last in pairwise([0, *cuts.tolist(), len(order)]):
            parts = -(-(last - first) * int(length[first]) // most_bytes)
            parts = min(parts, last - first) or 1
            yield from map(self.take, np.array_split(order[first:last], parts))

    def read(self, start: int, end: int) -> UInt8:
        """Copy the same bytes of each (M, end - start)."""
        return gather(self.data, self.start + start, end - start)

    def copy(self) -> Self:
        """Copy them, so that all else which lies in the block need not be kept."""
        data, places = self.data.data, zip(self.start.tolist(), self.end.tolist(), strict=True)
        text = b"".join([data[start:end] for start, end in places])
        length = self.end - self.start
        end = np.cumsum(length)
        return self._replace(data=np.frombuffer(text, np.uint8), start=end - length, end=end)


def join(parts: Sequence[Messages]) -> Messages:
    """Put the messages of several blocks, of the same channels, into one."""
    begin = np.cumsum([0, *(len(part.data) for part in parts[:-1])])
    shift = np.repeat(begin, [len(part.key) for part in parts])
    data, key, record_ns, start, end = (
        np.concatenate([part[at] for part in parts]) for at in range(1, len(Messages._fields))
    )
    return Messages(parts[0].channels, data, key, record_ns, start + shift, end + shift)


def pack(channels: Mapping[int, Channel], messages: Iterable[RawMessage]) -> Iterator[Messages]:
    """Put messages that come one by one, by the number of their channel, into blocks."""
    held: list[RawMessage] = []
    size = 0
    for message in messages:
        held.append(message)
        size += len(message[2]) + MESSAGE_BYTES
        if size >= BLOCK_BYTES:
            yield _pack(channels, held)
            held, size = [], 0
    if held:
        yield _pack(channels, held)


def _pack(channels: Mapping[int, Channel], held: Sequence[RawMessage]) -> Messages:
    key, record_ns, texts = zip(*held, strict=True)
    data, end = np.frombuffer(b"".join(texts), np.uint8), np.cumsum([*map(len, texts)])
    start = np.append(0, end[:-1])
    return Messages(channels, data, np.array(key), np.array(record_ns), start, end)


def gather(data: UInt8, start: Int64, length: int) -> UInt8:
    """Copy so many bytes from each of some places on (M, length)."""
    # One copy for each row: an index of every byte would take eight times the bytes.
    windows = np.ndarray((len(data) - length + 1, length), np.uint8, data, strides=(1, 1))
    return np.asarray(windows[start])


class Source(Protocol):
    """A container of ROS messages."""

    path: Path
    notes: NoteList

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel, also those that no map needs."""

    def messages(self, wanted: Collection[Channel]) -> Iterator[Messages]:
        """Give the messages of some channels, in file order."""


MAX_INFLATED = 1 << 30
"""No recorder writes blocks near this size (bytes); one that claims more is damaged or a bomb."""

MAX_RATIO = 1000
"""Recordings shrink to a tenth at best; what grows by more than this is a bomb."""

_STEP = 1 << 16
_LARGEST_READ = 1 << 24
_UNKNOWN_SIZE = -1
_INFLATE_ERRORS = (zstandard.ZstdError, OSError, EOFError, RuntimeError, ValueError)

_OPENERS: Mapping[str, Callable[[BytesIO], Any]] = {
    "zstd": lambda packed: zstandard.ZstdDecompressor().stream_reader(packed),
    "lz4": LZ4FrameFile,
    "bz2": BZ2File,
}


def inflate(data: Buffer, compression: str, size: int) -> tuple[Buffer, str]:
    """Decompress a block that announces `size` bytes.

    Parameters
    ----------
    data
        The compressed bytes.
    compression
        "zstd", "lz4" or "bz2"; "" and "none" return the data as it is.
    size
        What the block's header says that comes out.

    Returns
    -------
    tuple[Buffer, str]
        What could be decompressed, never more than `size`, and what was wrong, "" where all is
        well.
    """
    if compression in {"", "none"}:
        return data, "" if len(data) == size else f"holds {len(data)} bytes instead of {size}"
    if compression not in _OPENERS:
        return b"", f"is compressed with {compression[:20]!r}, which occmap does not know"
    if size > MAX_INFLATED:
        return b"", f"announces {size} bytes, more than any recorder writes in one block"
    if size > max(_LARGEST_READ, MAX_RATIO * len(data)):
        return b"", f"announces {size} bytes in {len(data)}, as only a bomb does"
    pieces = []
    left = size
    stream = _OPENERS[compression](BytesIO(data))
    with suppress(*_INFLATE_ERRORS):
        while left and (piece := stream.read1(min(left, _STEP))):
            pieces.append(piece)
            left -= len(piece)
    problem = f"is damaged: {size - left} of its {size} bytes come out of {compression}"
    return b"".join(pieces), problem if left else ""


def inflate_message(data: memoryview) -> memoryview:
    """Decompress one message that was compressed on its own with zstd.

    One that is damaged, or announces no size or an absurd one, is given as it is, so that it is
    counted as one that cannot be decoded.
    """
    with suppress(zstandard.ZstdError):
        if (size := zstandard.frame_content_size(data)) != _UNKNOWN_SIZE:
            message, problem = inflate(data, "zstd", size)
            return data if problem else memoryview(message)
    return data


def unzip_file(path: Path, target: Path) -> str:
    """Decompress a zstd file into another; say what was wrong, "" where all is well."""
    limit = MAX_INFLATED + MAX_RATIO * path.stat().st_size
    with path.open("rb") as file, target.open("wb") as out:
        try:
            size = zstandard.frame_content_size(file.read(_STEP))
            file.seek(0)
            stream = zstandard.ZstdDecompressor().stream_reader(file)
            while out.tell() <= limit and (piece := stream.read(_LARGEST_READ)):
                out.write(piece)
        except zstandard.ZstdError:
            return f"is damaged: {out.tell()} bytes come out of zstd"
        if out.tell() > limit:
            return f"grows more than {MAX_RATIO}-fold, and is read to byte {out.tell()}"
        if size in {out.tell(), _UNKNOWN_SIZE}:
            return ""
        return f"is cut: {out.tell()} of its {size} bytes come out of zstd"
