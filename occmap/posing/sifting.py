"""Sifting: scans are held back until it is known whether leaps lead them astray."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from occmap.arrays import Bool, Int64
from occmap.posing.leaps import Moment, Row, find_astray, find_rows
from occmap.posing.options import DropReason
from occmap.types import PosedScans, ScanBatch
from occmap.wording import count

MOST_PATHS = 1000
"""Lasers whose scans are judged: those of each are held back until it is known what follows."""

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

    first: Moment
    last: Moment
    leaps: int
    """Leaps between scans, whether or not any scan is left out for it"""

    def leads_to(self, other: Self, max_speed: float) -> bool:
        """Whether no leap lies between these scans and others that follow them."""
        return not self.last.leaps_to(other.first, max_speed)


class LeapFilter:
    """Leaves out scans that leaps lead astray.

    Which scans these are depends on the scans of the same laser alone, in the order in which they
    were recorded, never on how they are batched.
    """

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
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
            if (posed := some.posed) is None:
                yield some
                continue
            laser = posed.batch.topic, posed.batch.frame, posed.position.ndim == 3
            if laser not in self._paths and len(self._paths) < MOST_PATHS:
                self._paths[laser] = _Path(self._max_speed)
            if laser in self._paths:
                self._paths[laser].take(some, posed)
                yield from self._paths[laser].release()
            else:
                yield some
        for path in self._paths.values():
            yield from path.finish()

    def list_notes(self) -> Iterator[str]:
        """Say of each topic what the first scan did that is astray."""
        topics: defaultdict[str, list[tuple[int, str, int]]] = defaultdict(list)
        for (topic, *_), path in self._paths.items():
            if path.astray:
                topics[topic].append((*path.first_astray, path.astray))
        for topic, astray in sorted(topics.items()):
            scans = count(sum(scans for *_, scans in astray), "scan")
            outcome = f"{scans} that leap so are left out; `max_speed=inf` keeps all"
            if self._max_speed == math.inf:
                outcome = "the map reaches there, as `max_speed=inf` keeps such scans"
            yield f"{topic}: {min(astray)[1]}: {outcome}"


class _Held(NamedTuple):
    """Scans that are held back."""

    attached: Attached
    posed: PosedScans
    number: Int64
    """(S,) how many scans are before each of them on the path"""
    astray: Bool
    """(S,) which of them are known to be astray; changes"""


class _Path:
    """The way of one laser, in the order in which its scans were recorded."""

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._mixed: list[tuple[Attached, PosedScans]] = []
        """Scans between which others may still come"""
        self._held: list[_Held] = []
        self._rows: list[Row] = []
        """From the row that is judged next to the one that still grows"""
        self._begin: Moment | None = None
        self._leaps = 0
        self.astray = 0
        """How many scans are astray"""
        self.first_astray = 0, ""
        """Stamp of the first of them, and what it did"""

    @property
    def ends(self) -> Ends:
        """Where it begins and ends so far."""
        last = self._rows[-1].last
        return Ends(self._begin or last, last, self._leaps)

    def take(self, attached: Attached, posed: PosedScans) -> None:
        """Take further scans.

        Where a laser's geometry changes, batches hold scans from between each other, and come by
        their first scans: what is before the first scan of a batch has come when that comes.
        """
        number = attached.batch.number
        numbers = [some.batch.number for some, _ in self._mixed if some.batch.number is not None]
        if numbers and (number is None or number[0] > max(each[-1] for each in numbers)):
            self._put_in_order()
        self._mixed.append((attached, posed))
        if number is None:
            self._put_in_order()

    def _put_in_order(self) -> None:
        """Hold back the scans that came, and lengthen the path by them."""
        batches = [posed.batch for _, posed in self._mixed]
        numbers = [np.arange(len(b.stamp_ns)) if b.number is None else b.number for b in batches]
        order = np.argsort(np.concatenate(numbers))
        stamp_ns = np.concatenate([batch.stamp_ns for batch in batches])[order]
        place = np.concatenate([posed.at_first_beam[0] for _, posed in self._mixed])[order]
        begin, at = 0, np.argsort(order)
        if self._rows:  # the step from the last scan so far may be a leap, too
            begin, stamp, known = self._rows[-1].last
            stamp_ns, place = np.append([stamp], stamp_ns), np.concatenate([[known], place])
            at += begin + 1
        parts = np.split(at, np.cumsum([len(number) for number in numbers])[:-1])
        self._held += [
            _Held(*some, number, np.zeros(len(number), np.bool_))
            for some, number in zip(self._mixed, parts, strict=True)
        ]
        self._mixed = []
        rows = find_rows(begin, stamp_ns, place, self._max_speed)
        self._leaps += sum(not row.closes for row in rows[:-1])
        self._begin = self._begin or rows[0].first
        if self._rows:  # the first begins with the last scan so far
            rows[0] = replace(rows[0], first=self._rows[-1].first, opens=self._rows[-1].opens)
        self._rows[-1:] = rows

    def finish(self) -> Iterator[Attached]:
        """Give all scans that are still held back: none follow."""
        if self._mixed:
            self._put_in_order()
        self._rows[-1].closes = True
        yield from self.release()

    def release(self) -> Iterator[Attached]:
        """Give the scans of which it is known whether they are astray, as they came."""
        while len(self._rows) > 1:
            judged, astray = find_astray(self._rows, self._max_speed)
            if not judged:
                break
            if astray and not self.astray:
                self.first_astray = astray[0].first.stamp_ns, self._describe(astray[0])
            for row in astray:
                self._mark(row.first.number, row.last.number)
            del self._rows[:judged]
        while self._held and self._held[0].number[-1] < self._decided:
            yield self._strip(self._held.pop(0))

    @property
    def _decided(self) -> int:
        """Of so many scans it is known whether they are astray."""
        row = self._rows[0]
        may_be_astray = row.opens and row.is_single and not row.closes
        return row.first.number if may_be_astray else row.last.number + 1

    def _mark(self, first: int, last: int) -> None:
        """Mark the scans from one to another as astray."""
        self.astray += last - first + 1
        for held in self._held:
            held.astray[(held.number >= first) & (held.number <= last)] = True

    def _describe(self, astray: Row) -> str:
        """Say how far the first scan that is astray lies from the one before or behind it."""
        metres, seconds = self._rows[0].last.measure(self._rows[1].first)
        return (
            f"the scan at {astray.first.stamp_ns / 1e9:.3f} s lies {metres:,.6g} m from its "
            f"neighbour, {seconds:.3g} s away"
        )

    def _strip(self, held: _Held) -> Attached:
        """Leave out those of some scans that are astray, unless the user keeps all."""
        attached, posed, _, astray = held
        leaps = int(np.count_nonzero(astray))
        if not leaps or self._max_speed == math.inf:
            return attached
        rest = posed.take(~astray) if leaps < len(astray) else None
        return Attached(attached.batch, rest, {**attached.dropped, DropReason.LEAP: leaps})
