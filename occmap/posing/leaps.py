"""Leaps: damaged poses take scans to where the robot cannot have been, and the map with them.

A leap is a step between two scans, at most ten seconds apart, that no robot makes in that time; a
few scans in a row without a leap show where the robot is. Where such a row ends in a leap and, at
most ten seconds later, another row goes on from where it ended, the scans between the two are left
out, and so is a single scan that a leap parts from the row at the beginning or at the end. Where
nothing goes on there, the robot was carried, or stamps or poses do not mean what they seem to: all
is kept.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import starmap
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from occmap.posing.options import DropReason
from occmap.types import Bool, Float64, Int64, PosedScans, ScanBatch

SLACK_M = 1.0
"""A shorter step is no leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""Between scans that are further apart in time a robot may have been carried."""
FASTEST = 50.0
"""What is told of where all scans are kept (m/s): cars reach it."""
ROW = 3
"""So many steps without a leap, one after the other, show where the robot is."""
MOST_SCANS = 1000
"""A row that goes on is looked for among so many scans behind a leap: 100 a second are many, and
stamps may all be the same ten seconds."""
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


def find_rows(goes_on: Bool) -> tuple[Int64, Int64]:
    """The first and the last scan (S,) of the row that each scan is in, by which steps go on."""
    cuts = np.concatenate([[-1], np.flatnonzero(~goes_on), [len(goes_on)]])
    place = np.searchsorted(cuts, np.arange(len(goes_on) + 1))
    return cuts[place - 1] + 1, cuts[place]


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
        self._held: list[_Held] = []
        self._spent = 0
        """So many scans are forgotten; of those behind them ..."""
        self._stamp_ns = np.zeros(0, np.int64)
        """(N,)"""
        self._place = np.zeros((0, 3))
        """(N, 3) m"""
        self._astray = np.zeros(0, np.bool_)
        """(N,)"""
        self._step = 0
        """... the first step was not looked at, and ..."""
        self._decided = 0
        """... of so many it is known whether they are astray"""
        self._first: tuple[Int64, Float64] | None = None
        self._leaps = 0
        self.first_astray: tuple[int, str] | None = None
        """Stamp of the first scan that is astray, and what it did"""

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
        if self._mixed and (number is None or number[0] > max(map(_find_last, self._mixed))):
            self._put_in_order()
        self._mixed.append((attached, posed))
        if number is None:
            self._put_in_order()

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
        self._astray, self._step = self._astray[spent:], self._step - spent
        self._decided, self._spent = self._decided - spent, self._spent + spent

    def _judge(self, is_over: bool) -> None:
        """Find which scans are astray, as far as those that are known tell it."""
        near, leaps = find_leaps(self._stamp_ns, self._place, self._max_speed)
        scans = len(self._stamp_ns)
        if leaps.any():
            first, last = find_rows(near)
            rows = find_rows(near & ~leaps)
            for step in np.flatnonzero(leaps).tolist():
                if step < self._step:
                    continue
                part = range(first[step], last[step] + 1)
                found = self._find_astray(step, part, rows, is_over or part.stop < scans)
                if found is None:
                    # The first scan of a part may be the one that is astray.
                    self._step, self._decided = step, step + (step > part.start)
                    return
                if found and not self.first_astray:
                    self.first_astray = self._describe(step, found)
                self._astray[found.start : found.stop] = True
                self._step = max(found.stop, step + 1)
        is_alone = not near[-1:].any()  # nothing is known of a scan that has no neighbour yet
        self._step, self._decided = scans - 1, scans - (is_alone and not is_over)

    def _find_astray(
        self, step: int, part: range, rows: tuple[Int64, Int64], is_whole: bool
    ) -> range | None:
        """Find the scans that a leap leads astray; None where it is not known yet.

        Parameters
        ----------
        step
            The scan before the leap.
        part
            Scans that follow one another without a pause.
        rows
            As `find_rows` gives them, of steps without a leap.
        is_whole
            Whether the part ends there; else further scans of it may come.
        """
        before = step - int(rows[0][step])
        if before < ROW and before < step - part.start:
            return range(0)
        later = np.arange(step + 1, min(part.stop, step + 1 + MOST_SCANS))
        seconds = (self._stamp_ns[later] - self._stamp_ns[step]) / 1e9
        later, seconds = later[seconds <= SPARSE_S], seconds[seconds <= SPARSE_S]
        fits = ~is_too_far(self._place[later] - self._place[step], seconds, self._max_speed)
        begin, end = (each[later] for each in rows)
        is_row = end - later >= ROW
        if is_whole and before >= ROW:  # then a row may be short that reaches to the end
            is_row |= end == part.stop - 1
        back = later[fits & is_row & (begin == later)]  # by a leap, too
        if len(back):
            return range(step + 1, int(back[0]))
        if not is_whole and later[-1] + ROW >= part.stop - 1:
            return None
        if step == part.start and is_row[0]:
            return range(step, step + 1)
        is_last = step + 2 == part.stop
        return range(step + 1, part.stop) if before >= ROW and is_last else range(0)

    def _describe(self, step: int, astray: range) -> tuple[int, str]:
        """Say what the first of the scans that a leap leads astray did."""
        metres = np.linalg.norm(self._place[step + 1] - self._place[step])
        seconds = (self._stamp_ns[step + 1] - self._stamp_ns[step]) / 1e9
        stamp_ns = int(self._stamp_ns[astray.start])
        return stamp_ns, (
            f"the scan at {stamp_ns / 1e9:.3f} s lies {metres:,.6g} m from its neighbour, "
            f"{seconds:.3g} s away"
        )


def _find_last(scans: tuple[Attached, PosedScans]) -> int:
    """The number of the last of some scans in its log; -1 where it does not matter."""
    number = scans[0].batch.number
    return -1 if number is None else int(number[-1])


class LeapFilter:
    """Leaves out scans that leaps lead astray.

    What it says of a scan depends only on the scans that come up to ten seconds before and after
    it, never on how they are batched.
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
        found: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
        for (topic, *_), path in self._paths.items():
            if path.first_astray:
                found[topic].append(path.first_astray)
        outcome = "it and others that leap so are left out; `max_speed=inf` keeps them"
        if self._max_speed == np.inf:
            outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
        for topic in sorted(found):
            yield f"{topic}: {min(found[topic])[1]}: {outcome}"
