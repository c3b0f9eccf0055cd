"""Leaps: damaged poses take scans to where the robot cannot have been, and the map with them.

A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes in
that time; four scans or more without one show where the robot is. Where such a row ends in a leap
and another one goes on from there at most ten seconds later, the scans in between are left out, as
is a single scan that a leap parts from a row at the beginning or at the end. Where nothing goes on
there, the robot was carried, or stamps or poses do not mean what they seem to: all is kept.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import starmap
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from occmap.posing.options import DropReason
from occmap.types import Bool, Float64, Int64, PosedScans, ScanBatch
from occmap.wording import count

SLACK_M = 1.0
"""A shorter step is no leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
FASTEST = 50.0
"""What is told of where all scans are kept (m/s): cars reach it."""
ROW = 3
"""So many steps without a leap, one after the other, show where the robot is."""
MOST_SCANS = 1000
"""A row that goes on is looked for among so many scans behind a leap: a hundred a second are many,
and by wrong stamps a whole log lasts ten seconds."""
MOST_PATHS = 1000
"""Paths that are judged: each holds back scans until it is known what follows them."""

Laser: TypeAlias = tuple[str, str, bool]
"""Topic, frame, and whether its scans are de-skewed: scans that are compared with each other."""


class Attached(NamedTuple):
    """Some scans, and what became of them."""

    batch: ScanBatch
    posed: PosedScans | None
    """Those that have poses; None where none has"""
    dropped: dict[DropReason, int]
    """How many have none, by reason"""


class Ends(NamedTuple):
    """Where the scans of one laser begin and end."""

    stamp_ns: Int64
    """(2,)"""
    place: Float64
    """(2, 3) m"""
    leaps: int
    """Leaps between scans, whether or not any scan is left out for it"""

    def leads_to(self, other: Self, max_speed: float) -> bool:
        """Whether no leap lies between these scans and others that follow them."""
        stamp_ns = np.array([self.stamp_ns[1], other.stamp_ns[0]])
        _, leaps = find_leaps(stamp_ns, np.stack([self.place[1], other.place[0]]), max_speed)
        return not leaps.any()


def find_leaps(stamp_ns: Int64, place: Float64, max_speed: float) -> tuple[Bool, Bool]:
    """Which steps between scans (S,) at places (S, 3) are short in time, and which of them leap."""
    seconds = np.diff(stamp_ns) / 1e9
    near: Bool = (seconds > 0) & (seconds <= SPARSE_S)
    return near, near & is_too_far(np.diff(place, axis=0), seconds, max_speed)


def is_too_far(way: Float64, seconds: Float64, max_speed: float) -> Bool:
    """Which ways (S, 3) nobody goes in so many seconds (S,)."""
    speed = FASTEST if max_speed == np.inf else max_speed
    too_far: Bool = np.linalg.norm(way, axis=1) > np.maximum(SLACK_M, speed * seconds)
    return too_far


class Rows(NamedTuple):
    """Scans in a row without a leap, from pause to pause and from leap to leap; (R,) each."""

    start: Int64
    """The first scan"""
    stop: Int64
    """The scan behind the last one"""
    opens: Bool
    """Whether it is the first row behind a pause ..."""
    closes: Bool
    """... and whether the last one before a pause; else a leap is there, or nothing is known"""
    shows: Bool
    """Whether it shows where the robot is"""


def find_rows(near: Bool, leaps: Bool, is_over: bool) -> Rows:
    """Find the rows of scans by their steps, as `find_leaps` gives them; at the end all is over."""
    start = np.append(0, np.flatnonzero(~near | leaps) + 1)
    stop = np.append(start[1:], len(near) + 1)
    pauses = ~near[start[1:] - 1]
    opens, closes = np.append(True, pauses), np.append(pauses, is_over)
    return Rows(start, stop, opens, closes, stop - start > ROW)


NO_ROWS = find_rows(np.zeros(0, np.bool_), np.zeros(0, np.bool_), is_over=True)


class _Held(NamedTuple):
    """Scans that are held back, until it is known which of them are astray."""

    attached: Attached
    posed: PosedScans
    at: Int64
    """(S,) how many scans are before each of them on the path"""


class _Path:
    """The way of one laser, in the order in which its scans were recorded."""

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._mixed: list[tuple[Attached, PosedScans]] = []
        """Scans of which some lie between others that are still to come"""
        self._last = -1
        """The largest of their numbers"""
        self._held: list[_Held] = []
        self._spent = 0
        """So many scans are forgotten; of those behind them ..."""
        self._stamp_ns = np.zeros(0, np.int64)
        """(N,)"""
        self._place = np.zeros((0, 3))
        """(N, 3) m"""
        self._astray = np.zeros(0, np.bool_)
        """(N,)"""
        self._next = 0
        """... rows that reach to this one or further are still to be judged, and ..."""
        self._decided = 0
        """... of so many it is known whether they are astray"""
        self._first: tuple[Int64, Float64] | None = None
        self._leaps = 0
        self.first_astray: tuple[int, str] | None = None
        """Stamp of the first scan that is astray, and what it did"""
        self.left_out = 0

    @property
    def ends(self) -> Ends:
        """Where it begins and ends so far."""
        stamp_ns, place = self._first or (self._stamp_ns[:1], self._place[:1])
        return Ends(
            np.append(stamp_ns, self._stamp_ns[-1:]),
            np.concatenate([place, self._place[-1:]]),
            self._leaps,
        )

    def go_on(self, attached: Attached, posed: PosedScans) -> None:
        """Take further scans.

        Where a laser's geometry changes, batches hold scans from between each other, and come by
        their first scans: what is before the first scan of a batch has come when that comes.
        """
        number = attached.batch.number
        if self._mixed and (number is None or number[0] > self._last):
            self._put_in_order()
        self._mixed.append((attached, posed))
        if number is None:
            self._put_in_order()
        else:
            self._last = max(self._last, int(number[-1]))

    def _put_in_order(self) -> None:
        """Hold back the scans that came, all of which are on the path."""
        batches = [posed.batch for _, posed in self._mixed]
        counts = [len(batch.stamp_ns) for batch in batches]
        numbers = [batch.number for batch in batches if batch.number is not None]
        order = np.argsort(np.concatenate(numbers)) if numbers else np.arange(sum(counts))
        at = np.argsort(order) + self._spent + len(self._stamp_ns)
        parts = np.split(at, np.cumsum(counts)[:-1])
        self._held += starmap(_Held, zip(*zip(*self._mixed, strict=True), parts, strict=True))
        places = [each.position for _, each in self._mixed]
        self._mixed = []
        place = np.concatenate([each if each.ndim == 2 else each[:, 0] for each in places])[order]
        stamp_ns = np.concatenate([batch.stamp_ns for batch in batches])[order]

        last = max(len(self._stamp_ns) - 1, 0)
        self._stamp_ns = np.concatenate([self._stamp_ns, stamp_ns])
        self._place = np.concatenate([self._place, place])
        self._astray = np.concatenate([self._astray, np.zeros(len(place), np.bool_)])
        self._first = self._first or (stamp_ns[:1], place[:1])
        _, leaps = find_leaps(self._stamp_ns[last:], self._place[last:], self._max_speed)
        self._leaps += int(np.count_nonzero(leaps))

    def release(self, is_over: bool) -> Iterator[tuple[Attached, PosedScans, Bool]]:
        """Give the scans of which it is known whether they are astray (S,), as they came."""
        if is_over and self._mixed:
            self._put_in_order()
        self._judge(is_over)
        while self._held and self._held[0].at[-1] < self._spent + self._decided:
            attached, posed, at = self._held.pop(0)
            yield attached, posed, self._astray[at - self._spent]
        end = self._spent + len(self._stamp_ns)
        held = min((int(each.at[0]) for each in self._held), default=end)
        spent = max(held - self._spent - ROW - 1, 0)
        self._stamp_ns, self._place = self._stamp_ns[spent:], self._place[spent:]
        self._astray, self._next = self._astray[spent:], self._next - spent
        self._decided, self._spent = self._decided - spent, self._spent + spent

    def _judge(self, is_over: bool) -> None:
        """Find which scans are astray, as far as those that are known tell it."""
        near, leaps = find_leaps(self._stamp_ns, self._place, self._max_speed)
        scans = len(self._stamp_ns)
        # Most batches hold no leap; of them rows are not worth their time.
        rows = find_rows(near, leaps, is_over) if leaps.any() else NO_ROWS
        for row in np.flatnonzero(~rows.closes[:-1]).tolist():
            last = int(rows.stop[row]) - 1
            if last < self._next:
                continue
            astray = self._find_astray(row, rows)
            if astray is None:
                is_first = rows.opens[row] and rows.start[row] == last  # it may be astray itself
                self._next, self._decided = last, last + (not is_first)
                return
            if astray and not self.first_astray:
                self.first_astray = self._describe(last, astray)
            self._astray[astray.start : astray.stop] = True
            self.left_out += len(astray)
            self._next = max(astray.stop, last + 1)
        is_alone = not near[-1:].any()  # nothing is known of a scan that has no neighbour yet
        self._next, self._decided = scans - 1, scans - (is_alone and not is_over)

    def _find_astray(self, row: int, rows: Rows) -> range | None:
        """Find the scans that the leap behind a row leads astray; None: it is not known yet."""
        start, stop, opens, closes, shows = rows
        last = int(stop[row]) - 1
        if not (shows[row] or opens[row]):
            return range(0)
        later = np.arange(row + 1, min(row + 2 + MOST_SCANS, len(start)))
        later = later[: np.argmax(np.append(closes[later], True)) + 1]
        soon = later[self._is_soon(last, start[later])]
        seconds = (self._stamp_ns[start[soon]] - self._stamp_ns[last]) / 1e9
        way = self._place[start[soon]] - self._place[last]
        fits = ~is_too_far(way, seconds, self._max_speed)
        back = soon[fits & (shows[soon] | (closes[soon] & shows[row]))]
        if len(back):
            return range(last + 1, int(start[back[0]]))
        end = later[-1:]
        may_show = self._is_soon(last, start[end]) & ~shows[end]
        if (~closes[end] & (self._is_soon(last, stop[end] - 1) | may_show)).any():
            return None
        if opens[row] and start[row] == last and shows[row + 1]:
            return range(last, last + 1)
        is_last = closes[row + 1] and stop[row + 1] == last + 2
        return range(last + 1, last + 2) if shows[row] and is_last else range(0)

    def _is_soon(self, last: int, scans: Int64) -> Bool:
        """Which scans behind the last one of a row may go on from there."""
        seconds = (self._stamp_ns[scans] - self._stamp_ns[last]) / 1e9
        soon: Bool = (seconds <= SPARSE_S) & (scans - last <= MOST_SCANS)
        return soon

    def _describe(self, step: int, astray: range) -> tuple[int, str]:
        """Say when the first of the scans that a leap leads astray was taken, and what it did."""
        metres = np.linalg.norm(self._place[step + 1] - self._place[step])
        seconds = (self._stamp_ns[step + 1] - self._stamp_ns[step]) / 1e9
        stamp_ns = int(self._stamp_ns[astray.start])
        return stamp_ns, (
            f"the scan at {stamp_ns / 1e9:.3f} s lies {metres:,.6g} m from its neighbour, "
            f"{seconds:.3g} s away"
        )


class LeapFilter:
    """Leaves out scans that leaps lead astray.

    Which scans these are depends on the scans of the same laser alone, in the order in which they
    were recorded, never on how they are batched.
    """

    def __init__(self, max_speed: float, notes: list[str]) -> None:
        self._max_speed = max_speed
        self._notes = notes
        """Grows by what the first scan of each topic that is left out did"""
        self._paths: dict[Laser, _Path] = {}

    def find_ends(self) -> dict[Laser, Ends]:
        """Where the scans that were seen begin and end, by their laser."""
        return {laser: path.ends for laser, path in self._paths.items()}

    def sift(self, attached: Iterable[Attached]) -> Iterator[Attached]:
        """Leave out the scans that are astray, and count them among those without a usable pose.

        Scans are held back while it is not known what follows them; those of one laser stay in
        order.
        """
        for some in attached:
            path = self._find_path(some.posed) if some.posed else None
            if some.posed and path:
                path.go_on(some, some.posed)
                yield from self._release(path, is_over=False)
            else:
                yield some
        for path in self._paths.values():
            yield from self._release(path, is_over=True)
        self._notes += self._list_notes()

    def _find_path(self, posed: PosedScans) -> _Path | None:
        """Find the path that scans are on; None where it is one too many to be judged."""
        laser = posed.batch.topic, posed.batch.frame, posed.position.ndim == 3
        if laser not in self._paths and len(self._paths) < MOST_PATHS:
            self._paths[laser] = _Path(self._max_speed)
        return self._paths.get(laser)

    def _release(self, path: _Path, is_over: bool) -> Iterator[Attached]:
        for attached, posed, astray in path.release(is_over):
            leaps = int(np.count_nonzero(astray))
            if not leaps or self._max_speed == np.inf:
                yield attached
            else:
                rest = posed.take(~astray) if leaps < len(astray) else None
                yield Attached(attached.batch, rest, {**attached.dropped, DropReason.LEAP: leaps})

    def _list_notes(self) -> Iterator[str]:
        """Say of each topic what the first scan did that is astray."""
        topics: defaultdict[str, list[_Path]] = defaultdict(list)
        for (topic, *_), path in self._paths.items():
            if path.first_astray:
                topics[topic].append(path)
        for topic, paths in sorted(topics.items()):
            _, first = min(path.first_astray for path in paths if path.first_astray)
            scans = sum(path.left_out for path in paths)
            outcome = f"{count(scans, 'scan')} that leap so are left out; `max_speed=inf` keeps all"
            if self._max_speed == np.inf:
                outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
            yield f"{topic}: {first}: {outcome}"
