"""Leaps: damaged poses put scans where the robot cannot have been, and spoil the map there.

A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes in
that time. A row of scans without a leap between them shows where the robot is, if there are at
least four. Two kinds of scans are outliers, and are left out:

- Such a row ends with a leap, and at most ten seconds later another row continues where it ended.
  All scans between the two rows are outliers.
- A leap separates one single scan from such a row, and the scan is the first or the last one before
  or after a pause. It is an outlier.

Where no row continues, the robot was carried, or stamps or poses do not mean what they seem to, and
all scans are kept.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from occmap.arrays import Bool, Float64, Int64

SLACK_M = 1.0
"""A shorter step is not a leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
FASTEST = 50.0
"""With `max_speed=inf` all scans are kept, and steps above this speed (m/s) are noted as leaps."""
LONG_ROW_STEPS = 3
"""A row with at least this many steps shows where the robot is."""
MOST_SCANS = 1000
"""The row that continues must begin within this many scans after a leap. Ten seconds have no more
at a hundred scans a second, and wrong stamps may put a whole log into ten seconds."""


def is_too_far(metres: Float64 | float, seconds: Float64 | float, max_speed: float) -> Bool:
    """Whether a step, or each of many steps (S,), is longer than a robot can go in that time."""
    speed = FASTEST if max_speed == math.inf else max_speed
    too_far: Bool = np.asarray(metres > np.maximum(SLACK_M, speed * seconds))
    return too_far


class Moment(NamedTuple):
    """When and where a scan was taken."""

    number: int
    """How many scans of the laser come before it"""
    stamp_ns: int
    place: list[float]
    """x, y, z (m)"""

    def measure(self, later: Self) -> tuple[float, float]:
        """Measure the distance (m) and the time (s) to a later scan."""
        return math.dist(self.place, later.place), (later.stamp_ns - self.stamp_ns) / 1e9

    def leaps_to(self, later: Self, max_speed: float) -> bool:
        """Whether the step from this scan to a later one is a leap."""
        metres, seconds = self.measure(later)
        return 0 < seconds <= SPARSE_S and bool(is_too_far(metres, seconds, max_speed))

    def is_soon(self, later: Self) -> bool:
        """Whether a later scan comes soon enough for its row to continue the row that ends here."""
        seconds = (later.stamp_ns - self.stamp_ns) / 1e9
        return later.number - self.number <= MOST_SCANS and seconds <= SPARSE_S


@dataclass(slots=True)
class Row:
    """Scans one after the other, without a leap or a pause between them."""

    first: Moment
    last: Moment
    after_pause: bool
    """It begins the log, or a pause comes before it; otherwise a leap does"""
    before_pause: bool
    """It ends the log, or a pause follows; otherwise a leap follows, or the row still grows"""

    @property
    def is_long(self) -> bool:
        """Whether it is long enough to show where the robot is."""
        return self.last.number - self.first.number >= LONG_ROW_STEPS

    @property
    def is_single(self) -> bool:
        """Whether it has only one scan."""
        return self.last.number == self.first.number


def find_rows(first: int, stamp_ns: Int64, place: Float64, max_speed: float) -> list[Row]:
    """Cut scans with stamps (S,) and places (S, 3) into rows; `first` is the first one's number."""
    metres: Float64 = np.linalg.norm(np.diff(place, axis=0), axis=1)
    seconds = np.diff(stamp_ns) / 1e9
    pauses = (seconds <= 0) | (seconds > SPARSE_S)
    cuts = np.flatnonzero(pauses | is_too_far(metres, seconds, max_speed))
    begin, end = (
        map(Moment, (first + at).tolist(), stamp_ns[at].tolist(), place[at].tolist())
        for at in (np.append(0, cuts + 1), np.append(cuts, len(stamp_ns) - 1))
    )
    paused = pauses[cuts].tolist()
    return list(map(Row, begin, end, [True, *paused], [*paused, False]))


def find_outliers(rows: Sequence[Row], max_speed: float) -> tuple[int, Sequence[Row]]:
    """Find the outliers beside the leap that follows the first of some rows.

    Returns
    -------
    judged, outliers
        How many of the first rows are done with, 0 while that depends on scans still to come; and
        the rows whose scans are outliers.
    """
    row, following = rows[:2]
    if row.before_pause or not (row.is_long or row.after_pause):
        return 1, ()
    at = _find_continuation(rows, max_speed)
    if at is None:
        return 0, ()
    if at:
        return at, rows[1:at]
    if row.after_pause and row.is_single and following.is_long:
        return 1, [row]
    is_end = row.is_long and following.is_single and following.before_pause
    return 1, [following] if is_end else ()


def _find_continuation(rows: Sequence[Row], max_speed: float) -> int | None:
    """Find the index of the row that continues the first one; 0: none does, None: not known yet."""
    row, *others = rows
    for at, later in enumerate(others, start=1):
        if not row.last.is_soon(later.first):
            return 0
        may_continue = later.is_long or (later.before_pause and row.is_long)
        if may_continue and not row.last.leaps_to(later.first, max_speed):
            return at
        if later.before_pause or (later.is_long and not row.last.is_soon(later.last)):
            return 0
    return None
