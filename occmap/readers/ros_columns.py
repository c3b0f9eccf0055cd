"""Messages of one length under one another, a number of all of them read at a stroke."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from occmap.types import Int64, UInt8

LITTLE_ENDIAN = b"\0\1"
"""What a CDR message begins with that can be read so."""


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
