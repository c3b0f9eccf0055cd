"""Sifting: holds scans back until it is known whether they are outliers, and leaves those out."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from occmap.arrays import Bool, Int64
from occmap.posing.leaps import Moment, Row, find_outliers, find_rows
from occmap.posing.options import DropReason
from occmap.types import PosedScans, ScanBatch
from occmap.wording import count

MOST_PATHS = 1000
"""Lasers whose scans are judged; of further ones all scans are kept, to bound the memory."""

Laser: TypeAlias = tuple[str, str, bool]
"""Topic, frame, and whether its scans are de-skewed; scans of one laser are compared."""


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
    """Leaps between its scans, including those for which no scan is left out"""

    def leads_to(self, other: Self, max_speed: float) -> bool:
        """Whether no leap lies between the last of these scans and the first of others."""
        return not self.last.leaps_to(other.first, max_speed)


class LeapFilter:
    """Leaves out the outliers that `leaps` describes.

    Which scans these are depends only on the scans of the same laser, in the order in which they
    were recorded, and not on how they are batched.
    """

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._paths: dict[Laser, _Path] = {}

    def find_ends(self) -> dict[Laser, Ends]:
        """Where the scans that were seen begin and end, by their laser."""
        return {laser: path.ends for laser, path in self._paths.items()}

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
                self._paths[laser].take(some, posed)
                yield from self._paths[laser].release()
            else:
                yield some
        for path in self._paths.values():
            yield from path.finish()

    def list_notes(self) -> Iterator[str]:
        """Say of each topic with outliers where the first one lies."""
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


class _Path:
    """The way of one laser, in the order in which its scans were recorded."""

    def __init__(self, max_speed: float) -> None:
        self._max_speed = max_speed
        self._mixed: list[tuple[Attached, PosedScans]] = []
        """Scans that came; others from between them may still come"""
        self._held: list[_Held] = []
        self._rows: list[Row] = []
        """From the row that is judged next to the last one, which still grows"""
        self._begin: Moment | None = None
        self._leaps = 0
        self.outliers = 0
        """How many scans are known to be outliers"""
        self.first_outlier = 0, ""
        """Stamp of the first of them, and where it lies"""

    @property
    def ends(self) -> Ends:
        """Where the path begins and ends so far, and how many leaps it has."""
        last = self._rows[-1].last
        return Ends(self._begin or last, last, self._leaps)

    def take(self, attached: Attached, posed: PosedScans) -> None:
        """Take further scans.

        Batches come in the order of their first scans. Where a laser's geometry changes, one batch
        may hold scans from between those of another. So once a batch begins after all scans that
        came, nothing is missing between these, and they can be put in order.
        """
        number = attached.batch.number
        numbers = [some.batch.number for some, _ in self._mixed if some.batch.number is not None]
        if numbers and (number is None or number[0] > max(each[-1] for each in numbers)):
            self._put_in_order()
        self._mixed.append((attached, posed))
        if number is None:
            self._put_in_order()

    def _put_in_order(self) -> None:
        """Put the scans that came in order, and add them to the path."""
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
        self._leaps += sum(not row.before_pause for row in rows[:-1])
        self._begin = self._begin or rows[0].first
        if self._rows:  # the first begins with the last scan so far
            growing = self._rows[-1]
            rows[0] = replace(rows[0], first=growing.first, after_pause=growing.after_pause)
        self._rows[-1:] = rows

    def finish(self) -> Iterator[Attached]:
        """Give all scans that are still held back, since no others follow."""
        if self._mixed:
            self._put_in_order()
        self._rows[-1].before_pause = True
        yield from self.release()

    def release(self) -> Iterator[Attached]:
        """Give the batches that are judged, in the order in which they came."""
        while len(self._rows) > 1:
            judged, outliers = find_outliers(self._rows, self._max_speed)
            if not judged:
                break
            if outliers and not self.outliers:
                self.first_outlier = outliers[0].first.stamp_ns, self._describe(outliers[0])
            for row in outliers:
                self._mark(row.first.number, row.last.number)
            del self._rows[:judged]
        while self._held and self._held[0].number[-1] < self._count_judged():
            yield self._strip(self._held.pop(0))

    def _count_judged(self) -> int:
        """Count the scans, from the first on, that are known to be outliers or not."""
        row = self._rows[0]
        is_open = row.after_pause and row.is_single and not row.before_pause
        return row.first.number if is_open else row.last.number + 1

    def _mark(self, first: int, last: int) -> None:
        """Mark the scans from one number to another as outliers."""
        self.outliers += last - first + 1
        for held in self._held:
            held.is_outlier[(held.number >= first) & (held.number <= last)] = True

    def _describe(self, outlier: Row) -> str:
        """Say how far an outlier lies from the scan before or after it."""
        metres, seconds = self._rows[0].last.measure(self._rows[1].first)
        return (
            f"the scan at {outlier.first.stamp_ns / 1e9:.3f} s lies {metres:,.6g} m from its "
            f"neighbour, {seconds:.3g} s away"
        )

    def _strip(self, held: _Held) -> Attached:
        """Leave out the outliers among some scans, unless the user keeps all."""
        attached, posed, _, is_outlier = held
        leaps = int(np.count_nonzero(is_outlier))
        if not leaps or self._max_speed == math.inf:
            return attached
        rest = posed.take(~is_outlier) if leaps < len(is_outlier) else None
        return Attached(attached.batch, rest, {**attached.dropped, DropReason.LEAP: leaps})
