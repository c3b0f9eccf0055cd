"""Finds the range that means "nothing came back" where a log states no limit, or a wrong one."""

import math
from collections import Counter

import numpy as np

from occmap.readers import Note
from occmap.types import Float32

SICK_LOWEST = float(np.float32(81.83))
SICK_HIGHEST = float(np.float32(81.91))
"""The SICK LMS writes 8183 to 8191 cm for its error codes; it measures less than 80 m."""
MIN_REPEATS = 10
DOMINANCE = 10
"""How much more often than any range just below it a marker occurs; a far wall is no marker."""
KEPT_VALUES = 16
BLOCK_RANGES = 1 << 17
"""How many ranges are sorted at once."""


class RangeTally:
    """Counts the largest ranges of a stream of scans, in bounded memory."""

    def __init__(self) -> None:
        self.total = 0
        """Ranges seen."""
        self.stated = 0.0
        """The largest range_max that the scans state (m)."""
        self.above = 0
        """Ranges above the limit that their own scan states."""
        self._largest: Counter[float] = Counter()
        self._block: list[Float32] = []
        self._block_size = 0

    def add(self, ranges: Float32, range_max: float) -> None:
        """Count the ranges (of any shape) of scans that state one limit (m)."""
        self.total += ranges.size
        self.stated = max(self.stated, range_max)
        if range_max < math.inf:
            self.above += int(np.count_nonzero(ranges > range_max))
        self._block.append(ranges.ravel())
        self._block_size += ranges.size
        if self._block_size >= BLOCK_RANGES:
            self._fold()

    def _fold(self) -> None:
        """Fold the block into the counts. What is among the largest overall is so in its block."""
        if not self._block:
            return
        ranges = np.concatenate(self._block)
        self._block.clear()
        self._block_size = 0
        # Less than the smallest that is kept can be among the largest no more: it is not sorted.
        floor = min(self._largest) if len(self._largest) == KEPT_VALUES else -math.inf
        wanted = ranges[np.isfinite(ranges) & (ranges >= floor)]
        values, counts = np.unique(wanted, return_counts=True)
        self._largest.update(
            dict(zip(values[-KEPT_VALUES:].tolist(), counts[-KEPT_VALUES:].tolist(), strict=True))
        )
        for value in sorted(self._largest)[:-KEPT_VALUES]:
            del self._largest[value]

    def largest(self) -> float:
        """Return the largest finite range (m); 0 where there is none."""
        self._fold()
        return max(self._largest, default=0.0)

    def find_marker(self) -> tuple[float, int] | None:
        """Find the range that stands for "no return", and how many ranges are at or above it.

        It is the largest range of all, if that repeats far more often than the ranges just below
        it, or the smallest SICK error code, if the largest is one. The value is a float32 that
        became a float, so that `ranges >= value` holds for the marker itself.
        """
        largest = self.largest()
        if SICK_LOWEST <= largest <= SICK_HIGHEST:
            codes = [value for value in self._largest if value >= SICK_LOWEST]
            return min(codes), sum(self._largest[code] for code in codes)
        (_, repeats), *below = sorted(self._largest.items(), reverse=True) or [(0.0, 0)]
        # Too few different ranges tell nothing: a room drawn by hand may be all of 5 m.
        if largest <= 0 or len(below) < KEPT_VALUES - 1:
            return None
        most_below = max(count for _, count in below)
        return (largest, repeats) if repeats >= max(MIN_REPEATS, DOMINANCE * most_below) else None


def find_limit(name: str, tally: RangeTally) -> tuple[float, Note | None]:
    """Find from what range on a stream means "no return" (m), and what its user should know.

    The limit is inf where the ranges show none; a limit that the scans state holds beside it.
    """
    unstated = math.isinf(tally.stated)
    states = f"{name} states " + ("no range limit" if unstated else f"{tally.stated:g} m as limit")
    of_total = f"of {tally.total} ranges"
    marker = tally.find_marker()
    if marker is not None and marker[0] < tally.stated:
        found = f"{marker[1]} {of_total} read {marker[0]:g} m or more, taken as no return"
        return marker[0], Note(f"{states}; {found}: --range-max overrides")
    if unstated:
        found = "no range repeats as one for no return would, so all are taken as measured"
        return math.inf, Note(f"{states}; {found}: --range-max sets one")
    if tally.above:
        found = f"{tally.above} {of_total} are above it, up to {tally.largest():g} m"
        return math.inf, Note(f"{states}; {found}, taken as no return: --range-max overrides")
    return math.inf, None
