"""No-return bands: where drivers write a number when nothing came back, and have no infinity.

They write numbers beyond what they can measure: one value, or several close together, with a stray
one above them at times. Such numbers lie in a band at the top of all ranges, far more of them than
of the ranges just below.
"""

import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from occmap.sensor import ReturnOptions, read_limits
from occmap.types import Cloud, Float32, Int64, Recorded, Scan, ScanBatch
from occmap.values import as_float32

BAND = 0.025
"""How wide a band is, and the nearly empty part below it, as a share of the band's top"""
MIN_READINGS = 10
"""A band has at least so many readings, and fewer than so many lie above it"""
DOMINANCE = 10
"""How many times more readings than what is around it something must have that stands out: a band
than the part below it, and in a check one value than any near it"""
MOST_CODES = 3
"""At least half of a band's readings are of so few values; a far wall has noise, and thus more.
Or, where a band ends at the limit that the scans state, half as many are at the limit or beyond."""
MIN_VALUES = 16
"""Fewer different ranges tell nothing: in a log made by hand all may be 5 m"""
SICK_CODES = (81.82, 81.92)
"""Between these the SICK LMS writes its error codes, from 8183 to 8191 cm, which `COARSE` rounds
down: one is enough"""
STRAY = 0.001
"""A smaller share of ranges above what a scan states is noise, of which nobody need be told"""
COARSE = np.uint32(0xFFFFFF00)
"""The bits of a float32 by which ranges are counted, so that near 80 m they are 2 mm apart"""


@dataclass(frozen=True)
class Band:
    """Ranges that stand for "no return"."""

    limit: float
    """From this range on (m)"""
    low: float
    """The smallest of them and the largest, rounded down as `COARSE` says (m)"""
    high: float
    count: int

    @property
    def values(self) -> str:
        """From the smallest to the largest, or the one that there is."""
        return " to ".join(dict.fromkeys((f"{self.low:.4g} m", f"{self.high:.4g} m")))


class RangeTally:
    """Counts the largest ranges of a stream of scans, in bounded memory and in any order."""

    def __init__(self) -> None:
        self.total = 0
        """Ranges seen"""
        self.stated = 0.0
        """The largest range_max that the scans state (m)"""
        self.above = 0
        """Finite ranges above the limit that their own scan states"""
        self.largest = 0.0
        """The largest finite range above the limit of its scan (m)"""
        self.about = 0
        """Ranges from that limit up to a band's width above it"""
        self.may_be_wall = False
        """Whether a band may be the farthest wall, as of a laser that never moves: from one place
        that repeats as a code would"""
        self._different: set[float] = set()
        """Different measured ranges, until there are at least MIN_VALUES"""
        self._values = np.zeros(0, np.float32)
        """The largest ranges in ascending order, rounded down"""
        self._counts = np.zeros(0, np.int64)
        """How many there are of each of the `_values`"""
        self._floor: Float32 = as_float32(np.finfo(np.float32).tiny)

    def add(self, ranges: Float32, range_max: float) -> None:
        """Count the ranges (of any shape) of scans that state one limit (m)."""
        self.total += ranges.size
        self.stated = max(self.stated, range_max)
        limit = as_float32(range_max)
        if len(self._different) < MIN_VALUES:
            measured = ranges[(ranges > 0) & (ranges < limit)]
            self._different.update(np.unique(measured)[:MIN_VALUES].tolist())
        far = ranges[ranges >= np.minimum(self._floor, limit)]  # few; all ranges are looked at once
        above = far[(far > limit) & (far < np.inf)]
        self.above += above.size
        self.largest = max(self.largest, float(above.max(initial=0)))
        with np.errstate(over="ignore"):  # a damaged log may state any limit
            self.about += int(np.count_nonzero((far >= limit) & (far <= (1 + BAND) * limit)))
        if (far := far[(far >= self._floor) & (far < limit)]).size:
            self._keep(*np.unique(round_down(far), return_counts=True))

    def _keep(self, values: Float32, counts: Int64) -> None:
        """Add to the counts of values (N,), all different, and forget what no band can reach."""
        every = np.concatenate([self._counts, counts])
        both, places = np.unique(np.concatenate([self._values, values]), return_inverse=True)
        counts = np.bincount(places, weights=every).astype(np.int64)
        at_or_above = np.cumsum(counts[::-1])[::-1]
        # Any band has so many readings at or above its top.
        if at_or_above.size and at_or_above[0] >= MIN_READINGS:
            top = both[at_or_above >= MIN_READINGS][-1]
            self._floor = round_down(as_float32((1 - 2 * BAND) * float(top)))
        kept = both >= self._floor
        self._values, self._counts = both[kept], counts[kept]

    def find_band(self) -> Band | None:
        """Find the ranges that stand for "no return" below what the scans state as their limit."""
        values, counts = self._values.astype(np.float64), self._counts
        for at in range(len(values) - 1, -1, -1):
            if counts[at + 1 :].sum() >= MIN_READINGS:  # too many to be stray
                return None
            top = values[at]
            is_code = SICK_CODES[0] <= top <= SICK_CODES[1]
            limit = SICK_CODES[0] if is_code else (1 - BAND) * top
            low, empty = np.searchsorted(values, [limit, (1 - 2 * BAND) * top])
            readings, below = counts[low : at + 1].sum(), counts[empty:low].sum()
            enough = len(self._different) >= MIN_VALUES and readings >= MIN_READINGS
            enough = enough and not self.may_be_wall
            codes = np.sort(counts[low : at + 1])[-MOST_CODES:].sum()
            if top >= (1 - BAND) * self.stated:  # where simulators add noise to it
                codes = max(codes, self.about)
            stands_out = readings >= DOMINANCE * below and 2 * codes >= readings
            if is_code or (enough and stands_out):
                count = int(counts[low:].sum())
                return Band(float(limit), float(values[low]), float(values[-1]), count)
        return None


def round_down(ranges: Float32) -> Float32:
    """Round ranges (m) of any shape down to the values that `COARSE` leaves."""
    rounded: Float32 = (np.ascontiguousarray(ranges).view(np.uint32) & COARSE).view(np.float32)
    return rounded.reshape(np.shape(ranges))


class RangeLimits:
    """For each scan topic of one log, from what range on nothing came back.

    A log shows that only when all of it was read. So the scans that come first say what is applied
    to the rest, and `settle` tells in the end whether that was right: it nearly always is, and if
    not, the log is read once more. Where the user gives a limit, nothing is looked for.
    """

    def __init__(self, options: ReturnOptions) -> None:
        self._looks = options.range_max is None
        self._tallies: dict[str, RangeTally] = {}
        self._applied: dict[str, float] = {}
        self._settled = False

    def see(self, some: Scan | ScanBatch) -> None:
        """Count the ranges of a scan, or of those of a run."""
        if self._looks and not self._settled and some.ranges.size:
            tally = self._tallies.setdefault(some.topic, RangeTally())
            tally.add(some.ranges, read_limits(some)[1])

    def watch(self, scans: Iterable[Recorded]) -> Iterator[Recorded]:
        """Pass scans on, and count their ranges."""
        for some in scans:
            if not isinstance(some, Cloud):
                self.see(some)
            yield some

    def apply(self, batch: ScanBatch) -> ScanBatch:
        """State the limit in a batch of scans."""
        if not self._looks or batch.clouds:
            return batch
        if batch.topic not in self._applied:
            self._applied[batch.topic] = self._find(batch.topic)
        return replace(batch, range_max=min(batch.range_max, self._applied[batch.topic]))

    def settle(self, standing: Collection[str] = ()) -> bool:
        """Say whether the limits so far are the whole log's, and apply those from now on.

        Parameters
        ----------
        standing
            Topics of lasers that never move.
        """
        for topic, tally in self._tallies.items():
            tally.may_be_wall = topic in standing and math.isfinite(tally.stated)
        right = all(limit == self._find(topic) for topic, limit in self._applied.items())
        self._settled = True
        self._applied.clear()
        return right

    def _find(self, topic: str) -> float:
        tally = self._tallies.get(topic)  # of this topic alone: there may be very many
        band = tally and tally.find_band()
        return band.limit if band else math.inf

    def list_notes(self) -> Iterator[str]:
        """Say what the user should know of each topic, and how to change it."""
        for topic, tally in self._tallies.items():
            unstated = math.isinf(tally.stated)
            stated = f"{tally.stated:g} m as its range limit"
            limit = "no usable range limit" if unstated else stated
            band = tally.find_band()
            count, where = tally.above, f"are above it, up to {tally.largest:.4g} m"
            if band is not None:
                count, where = band.count, f"read {band.values}"
            elif count < STRAY * tally.total:
                count = 0
            if count:
                found = f"{count:,} of {tally.total:,} ranges ({count / tally.total:.1%}) {where}"
                yield f"{topic} states {limit}; {found}, taken as no return: `range_max` overrides"
            elif unstated:
                yield (
                    f'{topic} states {limit}; no value stands for "no return", so every range is '
                    "used as measured: `range_max` sets a limit"
                )
