"""Decompression that never gives more than was announced, and gives what lies before damage."""

from bz2 import BZ2File
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias

import zstandard
from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]  # it ships no types

Buffer: TypeAlias = bytes | memoryview

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
