"""Messages of equal length stacked as rows, so that a field of all of them is one array slice.

A log holds tens of thousands of scans and transforms; decoded one by one, with an object for each,
they take 40% longer to build a map of. Valid only for definitions of the standard layout, and
where the first message could be decoded: then all its parts lie within it.
"""

from collections.abc import Iterable
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from occmap.types import Bool, Int64, UInt8

LITTLE_ENDIAN = b"\0\1"
"""What a CDR message begins with that can be read so."""
_count = Struct("<I").unpack_from


def count_at(data: memoryview, at: int) -> int:
    """Read the count of what follows, as a sequence and a string begin with one."""
    count: int = _count(data, at)[0]
    return count


def align(at: int, size: int) -> int:
    """Round an offset up; CDR counts its alignment from behind the four encapsulation bytes."""
    return at + (4 - at) % size


def find_alike(raw: UInt8, free: Iterable[tuple[int, int]]) -> Bool:
    """Say which of M messages (M, L) are as the first but for some bytes.

    Parameters
    ----------
    free
        Where bytes that may differ begin, and behind the last of them.

    Returns
    -------
    alike
        (M,)
    """
    fixed = np.ones(raw.shape[1], np.bool_)
    for start, end in free:
        fixed[start:end] = False
    alike: Bool = (raw[:, fixed] == raw[0, fixed]).all(axis=1)
    return alike


def read_columns(raw: UInt8, at: int, kind: str, count: int = 1) -> NDArray[Any]:
    """Read `count` numbers of a NumPy type that begin at an offset in each of M messages (M, L).

    Returns
    -------
    numbers
        (M, count)
    """
    size = count * np.dtype(kind).itemsize
    return np.ascontiguousarray(raw[:, at : at + size]).view(kind)


def read_stamps(raw: UInt8, at: int) -> Int64:
    """Read the stamps (M,) in ns of messages (M, L): seconds, then nanoseconds."""
    seconds = read_columns(raw, at, "<i4")[:, 0].astype(np.int64)
    stamp_ns: Int64 = seconds * 1_000_000_000 + read_columns(raw, at + 4, "<u4")[:, 0]
    return stamp_ns
