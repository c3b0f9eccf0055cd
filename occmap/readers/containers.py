"""What every container of ROS messages gives: channels, and the raw messages of some of them.

Decompression never gives more than was announced, and gives what lies before damage.
"""

from bz2 import BZ2File
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import zstandard
from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]  # it ships no types

from occmap.readers import NoteList
from occmap.values import ZSTD_MAGIC


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
    def kind(self) -> str:
        """The type in its ROS 2 form."""
        return normalise_type(self.type)


Buffer: TypeAlias = bytes | memoryview

RawMessage: TypeAlias = tuple[Channel, int, Buffer]
"""A message as it was recorded: its channel, when that was (ns), and its bytes"""


class Source(Protocol):
    """A container of ROS messages."""

    path: Path
    notes: NoteList

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel, also those that no map needs."""

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""


MAX_INFLATED = 1 << 30
"""No recorder writes blocks near this size (bytes); one that claims more is damaged or a bomb."""

MAX_RATIO = 1000
"""Recordings shrink to a tenth at best; what grows by more than this is a bomb."""

_STEP = 1 << 16
_LARGEST_READ = 1 << 24
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
    if size > min(MAX_INFLATED, max(_LARGEST_READ, MAX_RATIO * len(data))):
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


def inflate_message(data: Buffer) -> Buffer:
    """Decompress one message if it was compressed on its own with zstd.

    One that is damaged, or announces no size or an absurd one, is given as it is, so that it is
    counted as one that cannot be decoded.
    """
    if data[:4] == ZSTD_MAGIC:
        with suppress(zstandard.ZstdError):
            if (size := zstandard.frame_content_size(data)) >= 0:
                message, problem = inflate(data, "zstd", size)
                return data if problem else message
    return data


def unzip_file(path: Path, target: Path) -> str:
    """Decompress a zstd file into another; say what was wrong, "" where nothing is.

    One that is cut gives a file that is cut, which whoever reads that will say.
    """
    limit = MAX_INFLATED + MAX_RATIO * path.stat().st_size
    with path.open("rb") as file, target.open("wb") as out:
        stream = zstandard.ZstdDecompressor().stream_reader(file)
        try:
            while out.tell() <= limit and (piece := stream.read(_LARGEST_READ)):
                out.write(piece)
        except zstandard.ZstdError:
            return f"is damaged: {out.tell()} bytes come out of zstd"
        if out.tell() > limit:
            return f"grows more than {MAX_RATIO}-fold, and is read to byte {out.tell()}"
    return ""
