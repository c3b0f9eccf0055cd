"""Range values: which are not measurements, which repeat too often, and what no return means.

A sample of posed scans shows whether beams without return lead through walls.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from occmap.inspection.findings import RangeFindings, Repeated, Special
from occmap.scans.mounts import encode_cells
from occmap.sensor.no_return import DOMINANCE, MIN_READINGS, MIN_VALUES, SICK_CODES
from occmap.sensor.returns import NoReturn, ReturnOptions, interpret
from occmap.types import Bool, Float32, Float64, Kind, PosedScans, ScanBatch
from occmap.values import as_float32

BLOCK_RANGES = 1 << 17
"""How many ranges are sorted together to find repeated ones: this bounds the memory."""

REPEATED_SHARE = 0.01
NEIGHBOURHOOD_M = 0.1
"""A value is suspicious if one finite range in a hundred has it, and ten times as many (DOMINANCE)
as have any other value within this distance. Ranges to a wall spread by their noise, even if
nothing moves."""
COMMON_SHARE = REPEATED_SHARE / 10
"""A value with a smaller share of the ranges that are sorted together is not counted there."""
MAX_REPEATED = 8
"""How many such values of a topic are told: the most frequent ones"""

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
"""The kinds of ranges that are not plain measurements, and what drivers mean by them"""
NO_RETURNS = ("+inf", "= range_max", "> range_max")
"""The kinds that `no_return` decides about; all others are skipped."""

MOSTLY_OPEN = 0.05
"""Space is open where a smaller share than this of the beams without return leads through walls or
out of everything that was hit. On most real logs nearly all of them do; in a building that is
larger than the sensor's range none does."""

HIT_CELL_M = 0.1
"""Side of the cells by which it is looked up whether something was hit (m), and the step along a
beam"""
ASIDE_M = 0.15
"""How far to the left and right of a beam hits are looked for (m): a surface that it leads through
has hits on both sides, a corner or a wall that it grazes on one side only."""
STEPS_AROUND = 2
"""Steps before and behind that are looked at, too: a surface may be crossed at an angle"""
SHORT_OF_END_M = 0.2
"""A beam is looked at up to this far before its end (m), where it may meet a wall after all."""
MAX_REACH_M = 30.0
"""A beam is looked at up to here (m), however far it would clear space."""
MAX_CROSSING_BEAMS = 250
"""So many beams without return are looked at: enough to tell a share of 5%"""
MIN_CROSSING_BEAMS = 50
"""Fewer beams without return tell nothing."""
SIDES = np.arange(8) * math.pi / 4
"""Directions in which the sides of the octagon around all hits face (rad)"""


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
        """Look for repeated values in the block of ranges that is full, and begin another block."""
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

    def sum_up(self, crossed: float | None) -> RangeFindings:
        """Sum up; `crossed` is what is known about beams without return."""
        self._fold()
        ranked = sorted(self._repeated, key=lambda value: (-self._common[value], value))
        repeated = tuple(
            Repeated(value, self._common[value] / self._positive, value >= self.limit)
            for value in ranked[:MAX_REPEATED]
        )
        measured = self.total - self.counts.total()
        suggested = self._suggest_no_return(repeated, crossed)
        advice = {name: suggested if name in NO_RETURNS else "" for name in MEANINGS}
        return RangeFindings(
            total=self.total,
            measured=measured,
            smallest=self.smallest if measured else math.nan,
            largest=self.largest if measured else math.nan,
            specials=tuple(
                Special(name, count, count / self.total, meaning, advice[name])
                for name, meaning in MEANINGS.items()
                if (count := self.counts[name])
            ),
            repeated=repeated,
            crossed=crossed,
        )

    def _suggest_no_return(self, repeated: Sequence[Repeated], crossed: float | None) -> str:
        """Suggest whether beams without return are to clear space.

        They are if the log states the limit up to which, if their value is not an error code of the
        SICK LMS, of which not all mean that space is open, and if hardly one of them leads through
        a wall or, as through glass, out of all that was hit.
        """
        low, high = SICK_CODES
        is_code = any(low <= item.value <= high for item in repeated)
        open_space = crossed is not None and crossed < MOSTLY_OPEN
        return "clear" if open_space and not is_code and math.isfinite(self.limit) else "ignore"


def find_repeated(values: Float32, counts: NDArray[np.intp]) -> Float32:
    """Find the values (N,), which are in ascending order, that occur suspiciously often."""
    total = counts.sum()
    if len(values) < MIN_VALUES:
        return values[:0]
    frequent = np.flatnonzero(counts >= max(REPEATED_SHARE * total, MIN_READINGS))
    low = np.searchsorted(values, values[frequent] - np.float32(NEIGHBOURHOOD_M))
    high = np.searchsorted(values, values[frequent] + np.float32(NEIGHBOURHOOD_M), side="right")
    places = zip(frequent, low, high, strict=True)  # each value, and those around it
    beside = [np.delete(counts[a:b], at - a).max(initial=0) for at, a, b in places]
    return values[frequent[counts[frequent] >= DOMINANCE * np.array(beside, np.int64)]]


def measure_crossing(parts: Sequence[PosedScans], options: ReturnOptions) -> float | None:
    """Measure how many beams without return would clear space that they should not.

    Such a beam leads through a surface that other beams hit, or out of everything that was hit: a
    front of glass gives no hits, but what stands around it does.

    Returns
    -------
    float or None
        Their share; None where there are too few such beams, or no distance up to which they would
        call space free.
    """
    options = replace(options, no_return=NoReturn.CLEAR)
    hits, beams = [np.zeros((0, 2))], [np.zeros((0, 5))]
    for part in parts:
        rays, _ = interpret(part, options)
        limit = part.batch.range_max if options.range_max is None else options.range_max
        lost = (rays.kind == Kind.FREE) & (part.batch.ranges >= as_float32(limit))
        hits.append(rays.end[rays.kind == Kind.HIT])
        origin, direction = np.broadcast_arrays(rays.origin, rays.direction)
        beams.append(np.column_stack([origin[lost], direction[lost], rays.distance[lost]]))
    hit, every = np.concatenate(hits), np.concatenate(beams)
    if len(every) < MIN_CROSSING_BEAMS:
        return None
    some = np.linspace(0, len(every) - 1, min(len(every), MAX_CROSSING_BEAMS)).astype(np.int64)
    origin, direction, reach = np.split(every[some], [2, 4], axis=1)
    reach = np.minimum(reach.astype(np.float32), MAX_REACH_M)
    # A beam leaves all that was hit where it ends outside of the octagon around it.
    sides = np.stack([np.cos(SIDES), np.sin(SIDES)])
    far = (hit @ sides).max(axis=0) if len(hit) else np.inf  # no hit, no building
    leaves = ((origin + reach * direction) @ sides > far).any(axis=1)
    return float((leaves | find_crossing(origin, direction, reach[:, 0], hit)).mean())


def find_crossing(origin: Float64, direction: Float64, reach: Float64, hit: Float64) -> Bool:
    """(N,) whether beams (N,) lead through a surface of which there are hits (H, 2)."""
    walls = np.unique(encode_cells(hit, HIT_CELL_M))
    far = reach[:, None] - SHORT_OF_END_M
    steps = np.minimum(np.arange(HIT_CELL_M, MAX_REACH_M, HIT_CELL_M), far)
    ways = origin[:, None] + steps[..., None] * direction[:, None]
    aside = ASIDE_M * np.stack([-direction[:, 1], direction[:, 0]], axis=1)[:, None]
    there, left, right = (
        np.isin(encode_cells(each, HIT_CELL_M), walls)
        for each in (ways, ways + aside, ways - aside)
    )
    crossing: Bool = (there & look_around(left) & look_around(right)).max(axis=1)
    return crossing


def look_around(steps: Bool) -> Bool:
    """(N, K) whether a step (N, K) of a beam, or one of those around it, is true."""
    ends = np.pad(steps, ((0, 0), (STEPS_AROUND, STEPS_AROUND)))
    around: Bool = sliding_window_view(ends, 2 * STEPS_AROUND + 1, axis=1).max(axis=2)
    return around
