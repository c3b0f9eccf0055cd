"""Leaps: damaged poses take scans to where the robot cannot have been, and the map with them.

A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes in
that time. Four scans or more without a leap between them show where the robot is. Where such a row
ends in a leap and another one goes on from there at most ten seconds later, the scans in between
are left out, as is a single scan that a leap parts from a row at the beginning or at the end. Where
nothing goes on there, the robot was carried, or stamps or poses do not mean what they seem to, and
all scans are kept.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from occmap.arrays import Bool, Float64, Int64

SLACK_M = 1.0
"""A shorter step is no leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
FASTEST = 50.0
"""The speed from which on leaps are told where all scans are kept (m/s): cars reach it."""
ROW = 3
"""So many steps without a leap, one after the other, show where the robot is."""
MOST_SCANS = 1000
"""A row that goes on is looked for among so many scans behind a leap: a hundred a second are many,
and by wrong stamps a whole log lasts ten seconds."""


def is_too_far(metres: Float64 | float, seconds: Float64 | float, max_speed: float) -> Bool:
    """Whether no robot goes so far in that time, by one step or by each of many (S,)."""
    speed = FASTEST if max_speed == math.inf else max_speed
    too_far: Bool = np.asarray(metres > np.maximum(SLACK_M, speed * seconds))
    return too_far


class Moment(NamedTuple):
    """When and where a scan was taken."""

    number: int
    """How many scans of the laser are before it"""
    stamp_ns: int
    place: list[float]
    """x, y, z (m)"""

    def measure(self, later: Self) -> tuple[float, float]:
        """How far (m) and how long (s) it is to a later scan."""
        return math.dist(self.place, later.place), (later.stamp_ns - self.stamp_ns) / 1e9

    def leaps_to(self, later: Self, max_speed: float) -> bool:
        """Whether the step from here to there is a leap."""
        metres, seconds = self.measure(later)
        return 0 < seconds <= SPARSE_S and bool(is_too_far(metres, seconds, max_speed))

    def is_soon(self, later: Self) -> bool:
        """Whether a row that ends here may go on there."""
        seconds = (later.stamp_ns - self.stamp_ns) / 1e9
        return later.number - self.number <= MOST_SCANS and seconds <= SPARSE_S


@dataclass(slots=True)
class Row:
    """Scans one after the other, without a leap or a pause between them."""

    first: Moment
    last: Moment
    opens: bool
    """It is the first row behind a pause"""
    closes: bool
    """It is the last row before a pause; else a leap is there, or nothing is known"""

    @property
    def shows(self) -> bool:
        """Whether it shows where the robot is."""
        return self.last.number - self.first.number >= ROW

    @property
    def is_single(self) -> bool:
        """Whether it is of one scan."""
        return self.last.number == self.first.number


def find_rows(first: int, stamp_ns: Int64, place: Float64, max_speed: float) -> list[Row]:
    """Cut scans (S,) at places (S, 3), of which the first one has that number, into rows."""
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


def find_astray(rows: Sequence[Row], max_speed: float) -> tuple[int, Sequence[Row]]:
    """Find the scans that a leap behind the first of some rows leads astray.

    Returns
    -------
    judged, astray
        How many rows need no further look, 0 while scans that are still to come decide it; and
        the rows of the scans that are left out.
    """
    row, following = rows[:2]
    if row.closes or not (row.shows or row.opens):
        return 1, ()
    back = _find_back(rows, max_speed)
    if back is None:
        return 0, ()
    if back:
        return back, rows[1:back]
    if row.opens and row.is_single and following.shows:
        return 1, [row]
    is_end = row.shows and following.is_single and following.closes
    return 1, [following] if is_end else ()


def _find_back(rows: Sequence[Row], max_speed: float) -> int | None:
    """Find the row that goes on where the first one ends; 0: none does, None: not known yet."""
    row, *others = rows
    for at, later in enumerate(others, start=1):
        if not row.last.is_soon(later.first):
            return 0
        goes_on = later.shows or (later.closes and row.shows)
        if goes_on and not row.last.leaps_to(later.first, max_speed):
            return at
        if later.closes or (later.shows and not row.last.is_soon(later.last)):
            return 0
    return None
