"""Leaps: damaged poses put scans where the robot cannot have been, and spoil the map there.

A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes in
that time. Scans are cut into parts where there is a pause, and parts into rows where there is a
leap. A row of at least four scans is long: it shows where the robot is. Two kinds of scans are
outliers, and are left out:

- A long row, or the first one of a part, ends with a leap, and at most ten seconds later a long row
  continues where it ended. (After a long row, the last row of the part need not be long.) All scans
  between the two rows are outliers.
- The first row of a part, or its last one, is a single scan beside a long row. It is an outlier.

Where no row continues, the robot was carried, or stamps or poses do not mean what they seem to, and
all scans are kept.

Scans are held back until it is known whether they are outliers.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from occmap.posing import DropReason
from occmap.report import count
from occmap.types import Attached, Bool, Float64, Int64, PosedScans

SLACK_M = 1.0
"""A shorter step is not a leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""A longer step in time is a pause, in which a robot may have been carried; so is one back."""
FASTEST = 50.0
"""With `max_speed=inf` all scans are kept, and steps above this speed (m/s) are noted as leaps."""
LONG_ROW_STEPS = 3
"""A row with at least this many steps shows where the robot is."""
MOST_SCANS = 1000
"""The row that continues must begin within this many scans after a leap. Ten seconds have no more
at a hundred scans a second, and wrong stamps may put a whole log into ten seconds."""
MOST_PATHS = 1000
"""Lasers whose scans are judged; of further ones all scans are kept, to bound the memory."""

Laser: TypeAlias = tuple[str, str, bool]
"""Topic, frame, and whether its scans are de-skewed; scans of one laser are compared."""


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
        return 0 < seconds <= SPARSE_S and bool(_is_too_far(metres, seconds, max_speed))

    def is_soon(self, later: Self) -> bool:
        """Whether a later scan comes soon enough for its row to continue the row that ends here."""
        _, seconds = self.measure(later)
        return later.number - self.number <= MOST_SCANS and seconds <= SPARSE_S


@dataclass(slots=True)
class Row:
    """Scans one after the other, without a leap or a pause between them."""

    first: Moment
    last: Moment

    @property
    def is_long(self) -> bool:
        """Whether it is long enough to show where the robot is."""
        return self.last.number - self.first.number >= LONG_ROW_STEPS

    @property
    def is_single(self) -> bool:
        """Whether it has only one scan."""
        return self.last.number == self.first.number


class LeapFilter:
    """Leaves out the outliers among scans.

    Which scans these are depends only on the scans of the same laser, in the order in which they
    were recorded, and not on how they are batched.
    """

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._paths: dict[Laser, _Path] = {}

    def sift(self, attached: Iterable[Attached]) -> Iterator[Attached]:
        """Leave out the outliers, and count them among the scans without a usable pose.

        Scans are held back while those that follow may still make outliers of them. The scans of
        one laser stay in order.
        """
        for some in attached:
            if (posed := some.posed) is None:
                yield some
                continue
            laser = posed.batch.topic, posed.batch.frame, posed.position.ndim == 3
            if laser not in self._paths and len(self._paths) < MOST_PATHS:
                self._paths[laser] = _Path(self._max_speed)
            if laser in self._paths:
                yield from self._paths[laser].take(some, posed)
            else:
                yield some
        for path in self._paths.values():
            yield from path.finish()

    def list_notes(self) -> Iterator[str]:
        """Say where the first outlier of each topic lies, and how many there are."""
        topics: defaultdict[str, list[tuple[int, str, int]]] = defaultdict(list)
        for (topic, *_), path in self._paths.items():
            if path.outliers:
                topics[topic].append((*path.first_outlier, path.outliers))
        for topic, found in sorted(topics.items()):
            scans = count(sum(scans for *_, scans in found), "scan")
            outcome = f"{scans} left out for such leaps; `max_speed=inf` keeps all"
            if self._max_speed == math.inf:
                outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
            yield f"{topic}: {min(found)[1]}: {outcome}"


class _Held(NamedTuple):
    """Scans that are held back."""

    attached: Attached
    posed: PosedScans
    number: Int64
    """(S,) how many scans come before each of them on the path"""
    is_outlier: Bool
    """(S,) which of them are known to be outliers; filled in as rows are judged"""

    def sift(self, max_speed: float) -> Attached:
        """Leave out the outliers, unless the user keeps all scans."""
        leaps = int(np.count_nonzero(self.is_outlier))
        if not leaps or max_speed == math.inf:
            return self.attached
        rest = self.posed.take(~self.is_outlier) if leaps < len(self.is_outlier) else None
        dropped = {**self.attached.dropped, DropReason.LEAP: leaps}
        return Attached(self.attached.batch, rest, dropped)


class _Path:
    """The way of one laser: its scans are put in order, cut into rows, judged and passed on."""

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._unordered: list[tuple[Attached, PosedScans]] = []
        """Scans that others may still come between"""
        self._scans = 0
        """How many are in order"""
        self._held: list[_Held] = []
        """Scans in order that are not passed on yet"""
        self._rows: list[Row] = []
        """Of the part that goes on: from the row that is judged next to the one that grows"""
        self._begins_part = True
        """Whether the first of these is the first row of its part"""
        self._last: Moment | None = None
        """The last scan in order; None before there is any"""
        self.outliers = 0
        """How many scans are known to be outliers"""
        self.first_outlier = 0, ""
        """Stamp of the first of them, and where it lies"""

    def take(self, attached: Attached, posed: PosedScans) -> Iterator[Attached]:
        """Take further scans, and pass on those that are judged by then.

        Batches come in the order of their first scans. Where a laser's geometry changes, one batch
        may hold scans from between those of another. So once a batch begins after all scans that
        came, nothing is missing between these, and they can be put in order.
        """
        number = attached.batch.number
        numbers = (some.batch.number for some, _ in self._unordered)
        latest = max((each[-1] for each in numbers if each is not None), default=-1)
        if number is None or number[0] > latest:
            self._put_in_order()
        self._unordered.append((attached, posed))
        if number is None:
            self._put_in_order()
        yield from self._release()

    def finish(self) -> Iterator[Attached]:
        """Pass on all scans that are still held back, since no others follow."""
        self._put_in_order()
        self._end_part()
        yield from self._release()

    def _release(self) -> Iterator[Attached]:
        """Pass on the batches of which all scans are judged."""
        known = self._scans
        if self._rows:
            row = self._rows[0]
            is_open = self._begins_part and row.is_single
            known = row.first.number if is_open else row.last.number + 1
        while self._held and self._held[0].number[-1] < known:
            yield self._held.pop(0).sift(self._max_speed)

    def _put_in_order(self) -> None:
        """Number the scans that came, hold them, and go on along them."""
        if not self._unordered:
            return
        batches = [posed.batch for _, posed in self._unordered]
        in_log = [np.arange(len(b.stamp_ns)) if b.number is None else b.number for b in batches]
        order = np.argsort(np.concatenate(in_log))
        bounds = np.cumsum([len(number) for number in in_log])[:-1]
        on_path = np.split(self._scans + np.argsort(order), bounds)
        self._scans += len(order)
        for some, number in zip(self._unordered, on_path, strict=True):
            self._held.append(_Held(*some, number, np.zeros(len(number), np.bool_)))
        stamp_ns = np.concatenate([batch.stamp_ns for batch in batches])
        place = np.concatenate([posed.at_first_beam[0] for _, posed in self._unordered])
        self._unordered = []
        self._go_on(stamp_ns[order], place[order])

    def _go_on(self, stamp_ns: Int64, place: Float64) -> None:
        """Cut further scans, with stamps (S,) and places (S, 3), into rows, and judge these."""
        first = 0
        if self._last:  # the step from the last scan so far may be a leap, too
            first, stamp, known = self._last
            stamp_ns, place = np.append([stamp], stamp_ns), np.concatenate([[known], place])
        metres: Float64 = np.linalg.norm(np.diff(place, axis=0), axis=1)
        seconds = np.diff(stamp_ns) / 1e9
        pauses = (seconds <= 0) | (seconds > SPARSE_S)
        cuts = np.flatnonzero(pauses | _is_too_far(metres, seconds, self._max_speed))

        def list_moments(at: Int64) -> Iterator[Moment]:
            return map(Moment, (first + at).tolist(), stamp_ns[at].tolist(), place[at].tolist())

        begins = list_moments(np.append(0, cuts + 1))
        ends = list_moments(np.append(cuts, len(stamp_ns) - 1))
        rows = list(map(Row, begins, ends))
        if self._rows:  # the first row begins with the last scan so far, and goes on with its row
            self._rows[-1].last = rows[0].last
        else:
            self._rows.append(rows[0])
        for row, after_pause in zip(rows[1:], pauses[cuts].tolist(), strict=True):
            if after_pause:
                self._end_part()
            self._rows.append(row)
        self._judge(is_over=False)
        self._last = rows[-1].last

    def _end_part(self) -> None:
        self._judge(is_over=True)
        self._rows, self._begins_part = [], True

    def _judge(self, is_over: bool) -> None:
        """Judge the rows of a part; while it is not over, only those that no scan can change."""
        while len(self._rows) > 1:
            verdict = find_outliers(self._rows, self._begins_part, is_over, self._max_speed)
            if verdict is None:
                return
            judged, outliers = verdict
            if outliers:
                self._mark(outliers[0].first, outliers[-1].last)
            del self._rows[:judged]
            self._begins_part = False

    def _mark(self, first: Moment, last: Moment) -> None:
        """Mark the scans from one to another as outliers."""
        if not self.outliers:
            metres, seconds = self._rows[0].last.measure(self._rows[1].first)
            where = f"the scan at {first.stamp_ns / 1e9:.3f} s lies {metres:,.6g} m from its"
            self.first_outlier = first.stamp_ns, f"{where} neighbour, {seconds:.3g} s away"
        self.outliers += last.number - first.number + 1
        for held in self._held:
            held.is_outlier[(held.number >= first.number) & (held.number <= last.number)] = True


def find_outliers(
    rows: Sequence[Row], begins_part: bool, is_over: bool, max_speed: float
) -> tuple[int, Sequence[Row]] | None:
    """Find the outliers on either side of the leap that ends the first of some rows.

    Parameters
    ----------
    rows
        At least two, of one part.
    begins_part, is_over
        Whether the first row is the first of the part, and the last row the last of it; else that
        one still grows.

    Returns
    -------
    judged, outliers
        How many of the first rows are done with, and the rows whose scans are outliers. None while
        that depends on scans still to come.
    """
    row, following = rows[:2]
    if not (row.is_long or begins_part):
        return 1, ()
    back = find_continuation(rows, is_over, max_speed)
    if back is None:
        return None
    if back:
        return back, rows[1:back]
    if begins_part and row.is_single and following.is_long:
        return 1, [row]
    ends_part = is_over and len(rows) == 2
    return 1, [following] if ends_part and row.is_long and following.is_single else ()


def find_continuation(rows: Sequence[Row], is_over: bool, max_speed: float) -> int | None:
    """Find the index of the row that continues the first one. 0: none; None: not known yet."""
    row, *others = rows
    for at, later in enumerate(others, start=1):
        if not row.last.is_soon(later.first):
            return 0
        ends_part = is_over and later is rows[-1]
        shows = later.is_long or (row.is_long and ends_part)
        if shows and not row.last.leaps_to(later.first, max_speed):
            return at
        if later.is_long and not row.last.is_soon(later.last):
            return 0  # a row after this one begins too late
    return 0 if is_over else None


def _is_too_far(metres: Float64 | float, seconds: Float64 | float, max_speed: float) -> Bool:
    """Whether a step, or each of many steps (S,), is longer than a robot can go in that time."""
    speed = FASTEST if max_speed == math.inf else max_speed
    too_far: Bool = np.asarray(metres > np.maximum(SLACK_M, speed * seconds))
    return too_far
