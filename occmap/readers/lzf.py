"""LZF, as PCL compresses clouds with it (http://oldhome.schmorp.de/marc/liblzf.html)."""

from occmap.jit import kernel
from occmap.types import UInt8

_SHORT = 32
"""Bytes that stand for themselves come in runs of at most so many; what is above is a copy."""


@kernel
def inflate(packed: UInt8, out: UInt8) -> int:
    """Unpack bytes (P,) into an array of the size that they should have; say how many come."""
    at, end = 0, 0
    while at < len(packed):
        head = int(packed[at])
        at += 1
        if head < _SHORT:
            size = head + 1
            if at + size > len(packed) or end + size > len(out):
                return end
            out[end : end + size] = packed[at : at + size]
            at += size
        else:
            size, far = head >> 5, (head & 31) << 8
            if at + 1 + (size == 7) > len(packed):
                return end
            if size == 7:
                size += int(packed[at])
                at += 1
            start = end - far - int(packed[at]) - 1
            at, size = at + 1, size + 2
            if start < 0 or end + size > len(out):
                return end
            for each in range(size):  # one by one: it may copy what it has just written
                out[end + each] = out[start + each]
        end += size
    return end
