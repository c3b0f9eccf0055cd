"""Arrays of unsigned numbers, compressed for a page whose script unpacks them again.

All lowest bytes come first, then all second ones and so on, as many as the largest number needs:
of most numbers only the lowest byte differs from that of the number before.
"""

import zlib
from base64 import b64encode
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from occmap.arrays import UInt8

LEVEL = 6


class Packed(NamedTuple):
    """An array as a page holds it."""

    data: bytes
    """Deflated, in the format of zlib"""
    rows: int
    columns: int
    planes: int
    """Bytes of each number: 1 to 4"""
    largest: int
    table: tuple[int, ...] = ()
    """If it is not empty, places in it are packed, as differences from the cell to the left"""

    @property
    def text(self) -> str:
        """The data as text, in base 64."""
        return b64encode(self.data).decode()

    def unpack_bytes(self) -> UInt8:
        """(H, W) the numbers, where none is above 255 and no table stands between."""
        return np.frombuffer(zlib.decompress(self.data), np.uint8).reshape(self.rows, self.columns)

    def to_json(self) -> dict[str, Any]:
        """What the page's script must know to unpack the text."""
        return {
            name: getattr(self, name) for name in ("rows", "columns", "planes", "largest", "table")
        }


def pack(array: NDArray[Any]) -> Packed:
    """Pack (H, W) numbers from 0 to 2^32 - 1; larger ones become the largest."""
    largest = min(int(array.max(initial=0)), 2**32 - 1)
    planes = max(-(-largest.bit_length() // 8), 1)
    numbers = np.minimum(array, 2**32 - 1).astype(np.uint32) if planes > 1 else array
    squeeze = zlib.compressobj(LEVEL)
    data = b"".join(
        squeeze.compress(((numbers >> (8 * plane)) & 255).astype(np.uint8).tobytes())
        for plane in range(planes)
    )
    rows, columns = array.shape
    return Packed(data + squeeze.flush(), rows, columns, planes, largest)


def pack_few(array: NDArray[Any]) -> Packed:
    """Pack (H, W) numbers of which few differ, as rounded ones do, in two thirds of the bytes."""
    table = np.unique(array)
    if len(table) > 256:
        return pack(array)
    places = np.searchsorted(table, array).astype(np.uint8)
    packed = pack(np.diff(places, axis=1, prepend=np.uint8(0)))
    return packed._replace(largest=int(table[-1]), table=tuple(table.tolist()))
