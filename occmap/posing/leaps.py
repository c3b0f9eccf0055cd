"""Leaps: damaged poses put scans where the robot cannot have been, and spoil the map there.

A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes in
that time. Scans, in the order of time, are cut into parts where there is a pause, and parts into
rows where there is a leap. A row of at least four scans is long: it shows where the robot is. Two
kinds of scans are outliers, and are left out:

- A long row, or the first one of a part, ends with a leap, and at most ten seconds and a thousand
  rows later a long row continues where it ended. (After a long row, the last row of the part need
  not be long.) All scans between the two rows are outliers.
- The first row of a part, or its last one, is a single scan beside a long row. It is an outlier.

Where no row continues, the robot was carried, or stamps or poses do not mean what they seem to, and
all scans are kept.
"""

import math

import numpy as np

from occmap.posing.tracks import Track
from occmap.types import Bool, Float64

SLACK_M = 1.0
"""A shorter step is not a leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""A longer step in time is a pause, in which a robot may have been carried."""
FASTEST = 50.0
"""With `max_speed=inf` all scans are kept, and steps above this speed (m/s) are noted as leaps."""
MOST_ROWS = 1000
"""Ten seconds of scans that all leap. Where stamps are in a wrong unit, ten seconds hold the whole
log, and to look at all of it for each row would take hours."""
LONG_ROW_STEPS = 3
"""A row with at least this many steps shows where the robot is."""


class Rows:
    """The scans of a laser, cut where there is a pause or a leap.

    Parameters
    ----------
    track
        Where the laser was at its scans.
    max_speed
        Faster steps (m/s) are leaps.
    """

    def __init__(self, track: Track, max_speed: float) -> None:
        self._track = track
        self._max_speed = FASTEST if max_speed == math.inf else max_speed
        pauses = track.interval_s > SPARSE_S
        cuts = np.flatnonzero(pauses | is_too_far(track.step_m, track.interval_s, self._max_speed))
        self.first, self.last = np.append(0, cuts + 1), np.append(cuts, len(track) - 1)
        """(R,) which scan each row begins and ends with"""
        self.opens, self.closes = np.append(True, pauses[cuts]), np.append(pauses[cuts], True)
        """(R,) whether it is the first row of its part, and the last one"""
        self.is_long: Bool = self.last - self.first >= LONG_ROW_STEPS
        """(R,) whether each shows where the robot is"""
        self._begin_ns = track.stamp_ns[self.first]

    def find_continuation(self, row: int) -> int | None:
        """Find the row that goes on where a row ended; None where there is none."""
        place, end = self._track.position, self.last[row]
        end_ns = int(self._track.stamp_ns[end])
        soon = np.searchsorted(self._begin_ns, end_ns + int(SPARSE_S * 1e9), side="right")
        # No row of the next part begins so soon.
        others = np.arange(row + 1, soon)[:MOST_ROWS]
        metres = np.linalg.norm(place[self.first[others]] - place[end], axis=1)
        seconds = (self._begin_ns[others] - end_ns) / 1e9
        shows = self.is_long[others] | (self.is_long[row] & self.closes[others])
        found = others[shows & ~is_too_far(metres, seconds, self._max_speed)]
        return int(found[0]) if len(found) else None


def has_leap(track: Track, max_speed: float) -> bool:
    """Whether any row of a laser's scans ends with a leap."""
    return not Rows(track, max_speed).closes.all()


def find_outliers(track: Track, max_speed: float) -> Bool:
    """(N,) which scans of a laser are outliers, by where it was at each (N)."""
    rows = Rows(track, max_speed)
    outliers = np.zeros(len(track), np.bool_)
    is_long, is_single = rows.is_long, rows.first == rows.last
    row = 0
    while row < len(rows.first) - 1:
        following = row + 1
        back = rows.find_continuation(row) if is_long[row] or rows.opens[row] else None
        if back is not None:
            outliers[rows.first[following] : rows.first[back]] = True
        elif not rows.closes[row]:
            if rows.opens[row] and is_single[row] and is_long[following]:
                outliers[rows.first[row]] = True
            elif is_long[row] and is_single[following] and rows.closes[following]:
                outliers[rows.first[following]] = True
        row = back or following
    return outliers


def is_too_far(metres: Float64, seconds: Float64, max_speed: float) -> Bool:
    """(N,) whether steps are longer than a robot can go in that time."""
    too_far: Bool = metres > np.maximum(SLACK_M, max_speed * seconds)
    return too_far


def describe_first(track: Track, outliers: Bool, offset_ns: int) -> str:
    """Say where the first outlier of a laser lies.

    Parameters
    ----------
    offset_ns
        What was added to the stamps of the scans.
    """
    first = int(np.argmax(outliers))
    # The first scan of a part has its neighbour after it.
    step = first - 1 if first and track.interval_s[first - 1] <= SPARSE_S else first
    seconds = (int(track.stamp_ns[first]) - offset_ns) / 1e9
    away = f"{track.step_m[step]:,.6g} m from its neighbour, {track.interval_s[step]:.3g} s away"
    return f"the scan at {seconds:.3f} s lies {away}"
