"""Leaps: damaged poses take scans to where the robot cannot have been, and the map with them.

Some scans in a row, none of which leaps, show where the robot is. Where one row is left by a leap,
and another one soon goes on where it ended, what lies between the two is left out. Where nothing
goes on, the robot was carried, or stamps or poses do not mean what they seem to: all is kept.
"""

from collections.abc import Iterable, Iterator
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
MOST_PATHS = 1000
"""Paths that are judged: each holds back scans until it is known what follows them."""

Shape: TypeAlias = tuple[str, str, float, float, tuple[int, ...]]
"""What scans share that are compared with each other: those of one shape come in the order in which
they were recorded, however they are batched."""


class Attached(NamedTuple):
    """Some scans, and what became of them."""

    batch: ScanBatch
    posed: PosedScans | None
    """Those that have poses; None where none has"""
    dropped: dict[DropReason, int]
    """How many have none, by reason"""


class Ends(NamedTuple):
    """Where the scans of one shape begin and end."""

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


class _Path:
    """The way of the scans of one shape."""

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._stamp_ns = np.zeros(0, np.int64)
        """(N,) of the scans that are held back, and of some before them ..."""
        self._place = np.zeros((0, 3))
        """(N, 3) ... and where they were (m)"""
        self._astray = np.zeros(0, np.bool_)
        """(N,)"""
        self._step = 0
        """The first step between these scans that was not looked at"""
        self._decided = 0
        """Of so many of the N it is known whether they are astray"""
        self._held: list[tuple[Attached, PosedScans]] = []
        self._begin: tuple[Int64, Float64] | None = None
        self._leaps = 0
        self.first_astray = ""
        """What the first scan did that is astray"""

    @property
    def ends(self) -> Ends:
        """Where it begins and ends so far."""
        stamp_ns, place = self._begin or (self._stamp_ns[:1], self._place[:1])
        return Ends(
            np.append(stamp_ns, self._stamp_ns[-1:]),
            np.concatenate([place, self._place[-1:]]),
            self._leaps,
        )

    def go_on(self, attached: Attached, posed: PosedScans) -> None:
        """Hold back some scans, until it is known which of them are astray."""
        last = max(len(self._stamp_ns) - 1, 0)
        place = posed.position if posed.position.ndim == 2 else posed.position[:, 0]
        self._held.append((attached, posed))
        self._stamp_ns = np.concatenate([self._stamp_ns, posed.batch.stamp_ns])
        self._place = np.concatenate([self._place, place])
        self._astray = np.concatenate([self._astray, np.zeros(len(place), np.bool_)])
        self._begin = self._begin or (self._stamp_ns[:1], self._place[:1])
        _, leaps = find_leaps(self._stamp_ns[last:], self._place[last:], self._max_speed)
        self._leaps += int(np.count_nonzero(leaps))

    def release(self, is_over: bool) -> Iterator[tuple[Attached, PosedScans, Bool]]:
        """Give the scans of which it is known whether they are astray (S,), in order."""
        self._judge(is_over)
        at = len(self._stamp_ns) - sum(len(posed.batch.stamp_ns) for _, posed in self._held)
        while self._held and at + len(self._held[0][1].batch.stamp_ns) <= self._decided:
            attached, posed = self._held.pop(0)
            end = at + len(posed.batch.stamp_ns)
            yield attached, posed, self._astray[at:end]
            at = end
        spent = max(at - ROW - 1, 0)
        self._stamp_ns, self._place = self._stamp_ns[spent:], self._place[spent:]
        self._astray, self._step = self._astray[spent:], self._step - spent
        self._decided -= spent

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
        seconds = (self._stamp_ns[step + 1 : part.stop] - self._stamp_ns[step]) / 1e9
        soon = int(np.searchsorted(seconds, SPARSE_S, side="right"))
        later = np.arange(step + 1, step + 1 + soon)
        way = self._place[later] - self._place[step]
        fits = ~is_too_far(way, seconds[:soon], self._max_speed)
        begin, end = (each[later] for each in rows)
        is_row = end - later >= ROW
        if is_whole and before >= ROW:  # then a row may be short that reaches to the end
            is_row |= end == part.stop - 1
        back = later[fits & is_row & (begin == later)]  # by a leap, too
        if len(back):
            return range(step + 1, int(back[0]))
        if not is_whole and soon + ROW >= len(seconds):
            return None
        if step == part.start and is_row[:1].any():
            return range(step, step + 1)
        return range(step + 1, part.stop) if before >= ROW and len(seconds) == 1 else range(0)

    def _describe(self, step: int, astray: range) -> str:
        """Say what the first of the scans that a leap leads astray did."""
        metres = np.linalg.norm(self._place[step + 1] - self._place[step])
        seconds = (self._stamp_ns[step + 1] - self._stamp_ns[step]) / 1e9
        return (
            f"the scan at {self._stamp_ns[astray.start] / 1e9:.3f} s lies {metres:,.6g} m from its "
            f"neighbour, {seconds:.3g} s away"
        )


class LeapFilter:
    """Leaves out scans that leaps lead astray.

    What it says of a scan depends only on the scans that come up to ten seconds before and after
    it, never on how they are batched.
    """

    def __init__(self, max_speed: float, notes: list[str]) -> None:
        self._max_speed = max_speed
        self._notes = notes
        """Grows by what the first scan of each topic that is left out did"""
        self._noted: set[str] = set()
        self._paths: dict[Shape, _Path] = {}

    def find_ends(self) -> dict[Shape, Ends]:
        """Where the scans that were seen begin and end, by their shape."""
        return {shape: path.ends for shape, path in self._paths.items()}

    def sift(self, attached: Iterable[Attached]) -> Iterator[Attached]:
        """Leave out the scans that are astray, and count them among those without a usable pose.

        Scans are held back while it is not known what follows them; those of one shape stay in
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

    def _find_path(self, posed: PosedScans) -> _Path | None:
        """Find the path that scans are on; None where it is one too many to be judged."""
        batch, kind = posed.batch, (posed.batch.ranges.shape[1], posed.position.ndim)
        shape = batch.topic, batch.frame, batch.angle_min, batch.angle_increment, kind
        if shape not in self._paths and len(self._paths) < MOST_PATHS:
            self._paths[shape] = _Path(self._max_speed)
        return self._paths.get(shape)

    def _release(self, path: _Path, is_over: bool) -> Iterator[Attached]:
        outcome = "it and others that leap so are left out; `max_speed=inf` keeps them"
        keeps_all = self._max_speed == np.inf
        if keeps_all:
            outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
        for attached, posed, astray in path.release(is_over):
            topic, leaps = posed.batch.topic, int(np.count_nonzero(astray))
            if leaps and topic not in self._noted:
                self._noted.add(topic)
                self._notes.append(f"{topic}: {path.first_astray}: {outcome}")
            if keeps_all or not leaps:
                yield attached
            else:
                rest = posed.take(~astray) if leaps < len(astray) else None
                yield Attached(attached.batch, rest, {**attached.dropped, DropReason.LEAP: leaps})
