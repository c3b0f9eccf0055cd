"""Gzip read so that everything before damage comes out, to the last byte that is certain."""

import io
import zlib
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

MAGIC = b"\x1f\x8b"
GUNZIP_ERRORS = (zlib.error, EOFError)

_GZIP_BITS = 31
"""zlib's code for gzip with its header and checksum."""
_STEP = 1 << 14
_MOST_AT_ONCE = 1 << 16
"""Bytes of output: a bomb comes out a piece at a time."""


class GunzipStream(io.RawIOBase):
    """Decompressed bytes of a file.

    Where the data is corrupt, all before comes out first; only then is an error raised: zlib.error,
    or EOFError where the file is cut. The gzip module loses up to a block before the damage.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._inflater = zlib.decompressobj(_GZIP_BITS)
        self._input = b""
        self._output = b""
        self._fault: Exception | None = None

    def readable(self) -> bool:
        """Yes."""
        return True

    def readinto(self, buffer: "WriteableBuffer", /) -> int:
        """Give some bytes; none at the end.

        Raises
        ------
        zlib.error, EOFError
            Nothing more comes out, though the file does not end here.
        """
        while not self._output:
            if self._fault is not None:
                raise self._fault
            if not self._advance():
                return 0
        view = memoryview(buffer).cast("B")
        size = min(len(view), len(self._output))
        view[:size] = self._output[:size]
        self._output = self._output[size:]
        return size

    def close(self) -> None:
        """Close the file, too."""
        self._file.close()
        super().close()

    def _advance(self) -> bool:
        """Decompress a piece; false where the file ends as it should."""
        if self._inflater.eof:
            rest = (self._inflater.unused_data + self._file.read(_STEP)).lstrip(b"\0")
            if not rest:
                return False
            self._inflater, self._input = zlib.decompressobj(_GZIP_BITS), rest
        data = self._input or self._file.read(_STEP)
        before = self._inflater.copy()
        try:
            self._output = self._inflater.decompress(data, _MOST_AT_ONCE)
            self._input = self._inflater.unconsumed_tail
        except zlib.error as error:
            self._output, self._fault = _salvage(before, data), error
            return True
        if not (data or self._output or self._inflater.eof):
            self._fault = EOFError("the file ends within the gzip data")
        return True


def _salvage(inflater: "zlib._Decompress", data: bytes) -> bytes:
    """Decompress byte by byte up to the first that is wrong."""
    pieces: list[bytes] = []
    with suppress(zlib.error):
        pieces.extend(inflater.decompress(data[at : at + 1]) for at in range(len(data)))
    return b"".join(pieces)
