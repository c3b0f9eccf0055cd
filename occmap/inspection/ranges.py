"""Census of range values: which are not plain measurements, and which repeat too often."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from occmap.arrays import Float32
from occmap.inspection.findings import RangeFindings, Repeated, Special
from occmap.types import ScanBatch

BLOCK_RANGES = 1 << 17
"""Ranges that are sorted at once to find repeated ones: memory is bounded, sorting pays."""

REPEATED_SHARE = 0.01
DOMINANCE = 10
NEIGHBOURHOOD_M = 0.1
"""A value is suspicious if one finite range in a hundred has it, ten times as many as any other
within this distance: walls, even seen by a robot that stands still, spread by their noise."""
COMMON_SHARE = REPEATED_SHARE / 10
"""A value that is rarer than this among the ranges sorted at once is not counted there."""
MIN_VALUES = 16
"""Fewer different ranges tell nothing: a room drawn by hand may be all of 5 m."""
MAX_REPEATED = 8

SICK_CODES = (81.8, 81.95)
"""The SICK LMS writes 8183 to 8191 cm for its error codes; not all mean that space is open."""

MEANINGS = {
    "+inf": "did not come back (REP 117)",
    "= range_max": "the driver's way to say that nothing came back",
    "> range_max": "the driver's way to say that nothing came back",
    "-inf": "too close to measure (REP 117)",
    "nan": "not measured (REP 117)",
    "zero": "no return or too close: drivers differ",
    "negative": "an error code",
    "< range_min": "too close to trust",
}
NO_RETURNS = ("+inf", "= range_max", "> range_max")
"""The kinds that `no_return` decides about; all others are skipped."""

MOSTLY_OPEN = 0.05
"""Space is open where a smaller share than this of the beams without return leads through walls or
out of everything that was hit. On most real logs nearly all of them do; in a building that is
larger than the sensor's range none does."""


class RangeCensus:
    """Counts the range values of one topic, batch by batch, in bounded memory."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.total = 0
        self.limit = 0.0
        """The largest range_max that the scans state (m)"""
        self.smallest = math.inf
        self.largest = -math.inf
        self._repeated: set[float] = set()
        self._common: Counter[float] = Counter()
        self._positive = 0
        self._block: list[Float32] = []
        self._block_size = 0

    def add(self, batch: ScanBatch) -> None:
        """Count the values of a batch."""
        ranges = batch.ranges
        low, high = np.float32(batch.range_min), np.float32(batch.range_max)
        finite = np.isfinite(ranges)
        positive = finite & (ranges > 0)
        masks = {
            "+inf": ranges == np.inf,
            "-inf": ranges == -np.inf,
            "nan": np.isnan(ranges),
            "zero": ranges == 0,
            "negative": finite & (ranges < 0),
            "< range_min": positive & (ranges < low),
            "= range_max": finite & (ranges == high),
            "> range_max": finite & (ranges > high),
        }
        self.counts.update({name: int(np.count_nonzero(mask)) for name, mask in masks.items()})
        self.total += ranges.size
        self.limit = max(self.limit, batch.range_max)
        measured = ranges[positive & (ranges >= low) & (ranges < high)]
        self.smallest = min(self.smallest, float(measured.min(initial=np.inf)))
        self.largest = max(self.largest, float(measured.max(initial=-np.inf)))
        self._block.append(ranges[positive])
        self._block_size += self._block[-1].size
        if self._block_size >= BLOCK_RANGES:
            self._fold()

    def _fold(self) -> None:
        """Look for repeated values among the ranges gathered, and forget the others."""
        if not self._block:
            return
        values, counts = np.unique(np.concatenate(self._block), return_counts=True)
        self._repeated.update(find_repeated(values, counts).tolist())
        common = counts >= COMMON_SHARE * self._block_size
        self._common.update(
            dict(zip(values[common].tolist(), counts[common].tolist(), strict=True))
        )
        self._positive += self._block_size
        self._block.clear()
        self._block_size = 0

    def list_repeated(self) -> tuple[Repeated, ...]:
        """List the suspicious values, the most frequent first."""
        self._fold()
        ranked = sorted(self._repeated, key=lambda value: (-self._common[value], value))
        return tuple(
            Repeated(value, self._common[value] / self._positive, value >= self.limit)
            for value in ranked[:MAX_REPEATED]
        )

    def sum_up(self, crossed: float | None) -> RangeFindings:
        """Sum up; `crossed` is what is known about beams without return."""
        repeated = self.list_repeated()
        measured = self.total - self.counts.total()
        suggested = self._suggest_no_return(repeated, crossed)
        return RangeFindings(
            total=self.total,
            measured=measured,
            smallest=self.smallest if measured else math.nan,
            largest=self.largest if measured else math.nan,
            specials=tuple(
                Special(
                    name,
                    count,
                    count / self.total,
                    meaning,
                    suggested if name in NO_RETURNS else "",
                )
                for name, meaning in MEANINGS.items()
                if (count := self.counts[name])
            ),
            repeated=repeated,
            crossed=crossed,
        )

    def _suggest_no_return(self, repeated: Sequence[Repeated], crossed: float | None) -> str:
        """Suggest whether beams without return are to clear space.

        Such beams are to clear space only where the log states a limit up to which, where their
        value is not an error code, and where hardly one of them leads through a wall, or out of all
        that was hit, as through glass.
        """
        low, high = SICK_CODES
        is_code = any(low <= item.value <= high for item in repeated)
        open_space = crossed is not None and crossed < MOSTLY_OPEN
        return "clear" if open_space and not is_code and math.isfinite(self.limit) else "ignore"


def find_repeated(values: Float32, counts: NDArray[np.intp]) -> Float32:
    """Find those of some values (N,), in ascending order, that occur suspiciously often."""
    total = counts.sum()
    if len(values) < MIN_VALUES:
        return values[:0]
    frequent = np.flatnonzero(counts >= max(REPEATED_SHARE * total, DOMINANCE))
    low = np.searchsorted(values, values[frequent] - np.float32(NEIGHBOURHOOD_M))
    high = np.searchsorted(values, values[frequent] + np.float32(NEIGHBOURHOOD_M), side="right")
    alone = [
        counts[at]
        >= DOMINANCE * max(counts[first:at].max(initial=0), counts[at + 1 : end].max(initial=0))
        for at, first, end in zip(frequent, low, high, strict=True)
    ]
    return values[frequent[np.array(alone, np.bool_)]]
