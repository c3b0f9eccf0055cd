"""Decompression that never gives more than was announced, and gives what lies before damage."""

import bz2
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import lz4.frame  # type: ignore[import-untyped]  # it ships no types
import zstandard

Buffer: TypeAlias = bytes | memoryview

MAX_INFLATED = 1 << 30
"""No recorder writes blocks near this size (bytes); one that claims more is damaged or a bomb."""

MAX_RATIO = 1000
"""Recordings shrink to a tenth at best; what grows by more than this is a bomb."""

_STEP = 1 << 16
_LARGEST_READ = 1 << 24
_UNKNOWN_SIZE = -1
_INFLATE_ERRORS = (zstandard.ZstdError, zlib.error, OSError, EOFError, RuntimeError, ValueError)


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes:
        """Give at most `size` bytes, and none at the end."""


class _Steps:
    """Reads from a decompressor with the interface of bz2's, one step of its input at a time."""

    def __init__(self, decompressor: Any, data: Buffer) -> None:
        self._decompressor = decompressor
        self._input = BytesIO(data)

    def read(self, size: int, /) -> bytes:
        """Give at most `size` bytes, and none at the end."""
        while not self._decompressor.eof:
            hungry = self._decompressor.needs_input
            step = self._input.read(_STEP) if hungry else b""
            piece: bytes = self._decompressor.decompress(step, size)
            if piece or (hungry and not step):
                return piece
        return b""


_OPENERS: dict[str, Callable[[Buffer], _Stream]] = {
    "zstd": lambda data: zstandard.ZstdDecompressor().stream_reader(data),
    "lz4": lambda data: _Steps(lz4.frame.LZ4FrameDecompressor(), data),
    "bz2": lambda data: _Steps(bz2.BZ2Decompressor(), data),
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
    block = _read_whole(_OPENERS[compression](data), min(size, _LARGEST_READ), size)
    if len(block) != size:
        block = _read_whole(_OPENERS[compression](data), _STEP, size)
        return block, f"is damaged: {len(block)} of its {size} bytes come out of {compression}"
    return block, ""


def _read_whole(stream: _Stream, step: int, size: int) -> bytes:
    """Read at most `size` bytes, ending early where the data is damaged."""
    pieces = []
    left = size
    try:
        while left and (piece := stream.read(min(step, left))):
            pieces.append(piece)
            left -= len(piece)
    except _INFLATE_ERRORS:
        pass
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def inflate_message(data: Buffer) -> memoryview:
    """Decompress one message that was compressed on its own with zstd.

    Raises
    ------
    ValueError
        It is damaged, or announces no size or an absurd one.
    """
    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise ValueError("the message is not compressed with zstd") from error
    if size == _UNKNOWN_SIZE:
        raise ValueError("the message announces no size")
    message, problem = inflate(data, "zstd", size)
    if problem:
        raise ValueError(f"the message {problem}")
    return memoryview(message)


def unzip_file(path: Path, target: Path) -> str:
    """Decompress a zstd file into another; say what was wrong, "" where all is well."""
    limit = MAX_INFLATED + MAX_RATIO * path.stat().st_size
    with path.open("rb") as file, target.open("wb") as out:
        try:
            size = zstandard.frame_content_size(file.read(_STEP))
            file.seek(0)
            stream = zstandard.ZstdDecompressor().stream_reader(file)
            while piece := stream.read(_LARGEST_READ):
                out.write(piece)
                if out.tell() > limit:
                    return f"grows more than {MAX_RATIO}-fold, and is read to byte {out.tell()}"
        except zstandard.ZstdError:
            return f"is damaged: {out.tell()} bytes come out of zstd"
        if size in {out.tell(), _UNKNOWN_SIZE}:
            return ""
        return f"is cut: {out.tell()} of its {size} bytes come out of zstd"
