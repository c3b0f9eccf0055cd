"""What becomes of scans, what is timed meanwhile, and where the robot went."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from occmap.errors import LogError, MapError, PoseError
from occmap.posing import DropReason
from occmap.report import Count, Note, is_damage, write_counts, write_unused
from occmap.sensor import ReturnCounts
from occmap.types import Kind, Rays, ScanHits, Trajectory

SHOWN_HITS = 400
"""How many hits of a scan are shown: enough to draw its walls, however many beams it has."""


Item = TypeVar("Item")


class LeftOut(StrEnum):
    """Why a scan is not used, whatever its pose is."""

    NO_BEAMS = "no beams"
    BAD_ANGLES = "angles not finite"
    TIME = "outside `start_s` and `end_s`"
    STRIDE = "left out by `stride`"
    STOOD = "of one view, as the sensor stood still"


NOT_ASKED_FOR = (LeftOut.TIME, LeftOut.STRIDE)
"""The user's own choice"""
NO_LOSS = (*NOT_ASKED_FOR, LeftOut.STOOD)
"""Nothing is wrong with these scans, and none of them is lost."""


def count_wanted(read: int, unused: Mapping[str, int], but: Collection[str] = NOT_ASKED_FOR) -> int:
    """Count the scans that were asked for, of those read; `unused` counts scans by reason."""
    return read - sum(unused.get(reason, 0) for reason in but)


REASON_ORDER = tuple(map(str, (*DropReason, *LeftOut)))
"""Why scans are not used, in the order in which reports list it"""
_LOCK = Lock()


@dataclass(frozen=True)
class ScanCounts:
    """What became of the scans."""

    read: Count
    """Scans in the logs"""
    used: Count
    """Scans in the map, or, where maps are scored, scans with a pose"""
    dropped: dict[str, Count]
    """Scans that are not used, by reason"""

    @property
    def wanted(self) -> int:
        """Scans that the user asked for."""
        return count_wanted(self.read, self.dropped)

    @property
    def dropped_share(self) -> float:
        """The share of these that are not used, and are a loss; 0 of nothing."""
        meant = count_wanted(self.read, self.dropped, NO_LOSS)
        return (meant - self.used) / max(meant, 1)


@dataclass(eq=False)
class Tally:
    """Counts, times and notes that grow while a map is built.

    Any thread may call `time`; all other methods belong to one thread.
    """

    tell: Callable[[int], None] | None = None
    """Called now and then with the scans read since the last call; None: nobody is told"""
    shown_every: int = 0
    """The hits of every n-th used scan are kept, to be shown; 0: an output wants none"""
    logs: list[str] = field(default_factory=list)
    """Those that are read, by their paths"""
    notes: list[str] = field(default_factory=list)
    """What there is to say of them beside numbers"""
    trajectories: list[Trajectory] = field(default_factory=list)
    """Where lasers went, if an output wants that"""
    shown: list[ScanHits] = field(default_factory=list)
    advanced: int = 0
    """Scans that were reported so far"""
    seconds: dict[str, float] = field(default_factory=dict)
    scans_read: int = 0
    scans_used: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    """Scans that are not used, by reason"""
    beams: ReturnCounts = field(default_factory=ReturnCounts)
    points: Counter[str] = field(default_factory=Counter)
    """What became of the points of clouds, by kind"""
    frames: dict[str, str | None] = field(default_factory=dict)
    """In which frame each log is mapped; None where it states poses and names no frame"""
    lasers: int = 0
    """The most topics of scans that any log has"""

    @property
    def looked_up(self) -> bool:
        """Whether some poses were looked up by time, and do not stand beside their scans."""
        return any(self.frames.values())

    @property
    def scans(self) -> ScanCounts:
        """What became of the scans so far."""
        dropped = {why: self.dropped[why] for why in REASON_ORDER if why in self.dropped}
        return ScanCounts(self.scans_read, self.scans_used, dropped)

    def start_over(self) -> "Tally":
        """Make an empty tally with the same listeners, to read the logs once more."""
        return Tally(self.tell, self.shown_every)

    def advance(self, scans: int) -> None:
        """Report that so many more scans were read; a negative number takes some back."""
        self.advanced += scans
        if self.tell:
            self.tell(scans)

    def add(self, other: "Tally") -> None:
        """Add the counts and times of another tally."""
        self.notes += other.notes
        self.trajectories += other.trajectories
        self.shown += other.shown
        self.frames |= other.frames
        self.lasers = max(self.lasers, other.lasers)
        self.scans_read += other.scans_read
        self.dropped.update(other.dropped)
        self.use(other.scans_used, other.beams)
        self.points.update(other.points)
        for stage, seconds in other.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def note(self, log: Path, notes: Iterable[str]) -> None:
        """Keep notes on a log; those of a plugin's reader may be text."""
        self.notes += [Note(note, is_damage(note), str(log)) for note in notes]

    def use(self, scans: int, beams: ReturnCounts) -> None:
        """Count scans that are used, and what their beams meant."""
        self.scans_used += scans
        self.beams += beams

    def show(self, rays: Rays) -> None:
        """Keep the hits of some scans that are used next."""
        if not self.shown_every:
            return
        some = rays.take(slice(-self.scans_used % self.shown_every, None, self.shown_every))
        columns = some.stamp_ns.tolist(), some.origin[:, 0].tolist(), some.end, some.kind
        for stamp_ns, (x, y), end, kind in zip(*columns, strict=True):
            hits = end[kind == Kind.HIT].astype(np.float32)
            hits = hits[:: max(-(-len(hits) // SHOWN_HITS), 1)]
            self.shown.append(ScanHits(stamp_ns, (x, y), hits[:, 0], hits[:, 1]))

    def to_json(self) -> dict[str, Any]:
        """What became of the scans and their beams, as JSON values."""
        return {**vars(self.scans), "beams": self.beams._asdict()}

    def list_seconds(self) -> dict[str, float]:
        """The time of each stage (s), as it is printed."""
        return {stage: round(seconds, 4) for stage, seconds in self.seconds.items()}

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Add the time of a block to a stage; no stage lies within another. Threads add up."""
        start = perf_counter()
        try:
            yield
        finally:
            seconds = perf_counter() - start
            with _LOCK:
                self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def time_each(self, stage: str, items: Iterator[Item]) -> Iterator[Item]:
        """Pass items on, and add the time that each takes to come to a stage."""
        while True:
            with self.time(stage):
                item = next(items, None)
            if item is None:
                return
            yield item


def advise_on_dropped(dropped: Mapping[str, int]) -> str:
    """Say what to do about scans that are not used, by the reason of most of them."""
    most = max(dropped, key=dropped.__getitem__, default="")
    if most == DropReason.GAP:
        fix = "a larger `max_pose_gap_s` interpolates across the gaps"
        return f"{fix}, and smears walls where the robot turned in one"
    if most == DropReason.TURN:
        fix = "`max_pose_gap_s=inf` uses them all the same"
        return f"poses of key frames do not tell how the robot turned at clouds between them; {fix}"
    return "`occmap check` shows the times of scans and poses"


def refuse_unused(tally: Tally) -> None:
    """Refuse to make a map of nothing.

    Raises
    ------
    LogError, PoseError
        No scan was used; the message says why.
    """
    if tally.scans_used:
        return
    where = ", ".join(tally.logs)
    if tally.scans_read:
        dropped = tally.scans.dropped
        found = write_unused(tally.scans_read, dropped)
        raise PoseError(found, where=where, fix=advise_on_dropped(dropped))
    if lost := next(filter(is_damage, tally.notes), None):
        raise LogError(f"no scan can be read: {lost.text}", where=lost.log)
    fix = "`occmap check` shows what it holds"
    raise LogError("holds no scan that can be read", where=where, fix=fix)


UNSEEN_CLOUDS = "no point of any cloud observed a cell"
MEND_CLOUDS = (
    "points count between `min_range` and `max_range`, over ground that was found, and up to "
    "`max_height` above it"
)


def refuse_unseen(tally: Tally, seen: Collection[object]) -> None:
    """Refuse to make a map in which no tile, or block of tiles, was seen.

    Raises
    ------
    MapError
        Saying what the beams of all scans were read as.
    """
    if seen:
        return
    found = f"no beam of any scan observed a cell: {write_counts(tally.beams.by_name)}"
    fix = "see the ranges in `occmap check`"
    if tally.points:
        found, fix = f"{UNSEEN_CLOUDS}: {write_counts(tally.points)}", MEND_CLOUDS
    raise MapError(found, where=", ".join(tally.logs), fix=fix)
