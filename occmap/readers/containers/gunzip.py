"""Gzip read so that everything before damage comes out, to the last byte that is certain."""

import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

MAGIC = b"\x1f\x8b"
GUNZIP_ERRORS = (zlib.error, EOFError)

_GZIP_BITS = 31
"""zlib's code for gzip with its header and checksum."""
_STEP = 1 << 17
_MOST_AT_ONCE = 1 << 18
"""Bytes that are unpacked at once: a bomb comes out a piece at a time."""


def gunzip(file: BinaryIO) -> Iterator[bytes]:
    """Decompress a file piece by piece.

    Where the data is corrupt, all before comes out first; the gzip module loses up to a block.

    Raises
    ------
    zlib.error, EOFError
        The data is corrupt, or the file ends within it.
    """
    inflater = zlib.decompressobj(_GZIP_BITS)
    data = b""
    while data := data or file.read(_STEP):
        if inflater.eof:
            data = data.lstrip(b"\0")  # padding, or one more member
            inflater = zlib.decompressobj(_GZIP_BITS) if data else inflater
            continue
        before = inflater.copy()
        try:
            piece = inflater.decompress(data, _MOST_AT_ONCE)
        except zlib.error:
            yield _salvage(before, data)
            raise
        yield piece
        data = inflater.unconsumed_tail or inflater.unused_data
    while not inflater.eof:
        piece = inflater.decompress(b"", _MOST_AT_ONCE)
        if not piece:
            raise EOFError("the file ends within the gzip data")
        yield piece


def _salvage(inflater: "zlib._Decompress", data: bytes) -> bytes:
    """Decompress byte by byte up to the first that is wrong."""
    pieces: list[bytes] = []
    with suppress(zlib.error):
        pieces.extend(inflater.decompress(data[at : at + 1]) for at in range(len(data)))
    return b"".join(pieces)
