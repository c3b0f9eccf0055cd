"""What a build did: numbers for people and for programs."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock, local
from time import perf_counter
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from occmap.batching import LeftOut, Selection, count_wanted
from occmap.errors import LogError, MapError, PoseError
from occmap.journey import JourneyRecorder
from occmap.plain import Count, Share, to_plain
from occmap.posing.options import DropReason
from occmap.readers import Note
from occmap.sensor.bounds import Clamped
from occmap.sensor.models import SensorModel, find_decision
from occmap.sensor.returns import ReturnCounts
from occmap.types import Box, Manifest, OccupancyMap, Update
from occmap.wording import write_counts
from occmap.writers import WriteOptions, list_idle

Item = TypeVar("Item")

LONGEST_LOG_S = 1e8
"""Three years: a time that is later is a date."""
LEAST_AGREEMENT = 0.55
"""At 5 cm, logs with sound poses reach 0.68 to 0.94, raw odometry 0.72; noise of 10 cm in the poses
of the same logs leaves 0.27 to 0.56."""
DOUBTFUL_AGREEMENT = 0.78
"""Logs with corrected poses reach 0.80 to 0.87 at 5 cm. Those with odometry, below this, have walls
that are doubled here and there, and `tune` takes a floor from 0.72 to 0.85."""


REASON_ORDER = tuple(map(str, (*DropReason, *LeftOut)))
"""Why scans are not used, in the order in which reports list it"""
_LOCK = Lock()
_WITHIN = local()
"""How long the stages took that are part of the one that runs in a thread (s)"""


def ignore_advance(_scans: int) -> None:
    """Show no progress."""


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
        """The share of these that are not used; 0 of nothing."""
        return (self.wanted - self.used) / max(self.wanted, 1)


class Tally:
    """Counts and times that grow while a map is built.

    Any thread may call `time`; all other methods belong to one thread.
    """

    def __init__(
        self,
        tell: Callable[[int], None] = ignore_advance,
        recorder: JourneyRecorder | None = None,
    ) -> None:
        self.tell = tell
        """Called now and then with the scans read since the last call"""
        self.told = 0
        self.recorder = recorder
        """Learns where the scans were taken, where an output wants that"""
        self.seconds: dict[str, float] = {}
        self.scans_read = self.scans_used = 0
        self.dropped: dict[str, int] = {}
        self.beams = ReturnCounts()
        self.frames: dict[str, str | None] = {}
        """In which frame each log is mapped; None where it states poses and names no frame"""
        self.lasers = 0
        """The most topics of scans that any log has"""

    @property
    def scans(self) -> ScanCounts:
        """What became of the scans so far."""
        return ScanCounts(self.scans_read, self.scans_used, dict(self.dropped))

    def start_over(self) -> "Tally":
        """Make an empty tally with the same listeners, to read the logs once more."""
        return Tally(self.tell, self.recorder and self.recorder.start_over())

    def advance(self, scans: int) -> None:
        """Report that so many more scans were read; a negative number takes some back."""
        self.told += scans
        self.tell(scans)

    def add(self, other: "Tally") -> None:
        """Add the counts and times of another tally."""
        if self.recorder and other.recorder:
            self.recorder.add(other.recorder)
        self.frames |= other.frames
        self.lasers = max(self.lasers, other.lasers)
        self.scans_read += other.scans_read
        self.drop(other.dropped)
        self.use(other.scans_used, other.beams)
        for stage, seconds in other.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def drop(self, reasons: dict[Any, int]) -> None:
        """Count scans that are not used, by reason."""
        for reason, scans in reasons.items():
            self.dropped[str(reason)] = self.dropped.get(str(reason), 0) + scans
        self.dropped = {why: self.dropped[why] for why in REASON_ORDER if why in self.dropped}

    def use(self, scans: int, beams: ReturnCounts) -> None:
        """Count scans that are used, and what their beams meant."""
        self.scans_used += scans
        self.beams += beams

    def to_json(self) -> dict[str, Any]:
        """What became of the scans and their beams, as JSON values."""
        return {**vars(self.scans), "beams": self.beams._asdict()}

    def list_seconds(self) -> dict[str, float]:
        """The time of each stage (s), as it is printed."""
        return {stage: round(seconds, 4) for stage, seconds in self.seconds.items()}

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        """Add the time of a block to a stage, but for stages within it; threads add up."""
        start, outer = perf_counter(), getattr(_WITHIN, "seconds", 0.0)
        _WITHIN.seconds = 0.0
        try:
            yield
        finally:
            seconds = perf_counter() - start
            own, _WITHIN.seconds = seconds - _WITHIN.seconds, outer + seconds
            with _LOCK:
                self.seconds[stage] = self.seconds.get(stage, 0.0) + own

    def time_each(self, stage: str, items: Iterator[Item]) -> Iterator[Item]:
        """Pass items on, and add the time that each takes to come to a stage."""
        while True:
            with self.time(stage):
                item = next(items, None)
            if item is None:
                return
            yield item


@dataclass(frozen=True)
class Resumed:
    """The evidence that a build was added to."""

    file: str
    """The evidence file"""
    read: Count
    """Scans that its builds read"""
    used: Count
    """Scans that its builds used"""


class Shares(NamedTuple):
    """The shares of a map's cells by class; the rest was observed and is undecided."""

    occupied: float
    free: float
    unknown: float


class MapFacts(NamedTuple):
    """What is measured of a map for its report."""

    shape: tuple[int, int]
    """Rows and columns"""
    extent: Box
    shares: Shares
    agreement: float | None
    has_walls: bool
    """Whether it calls any cell occupied"""


@dataclass(frozen=True)
class MapSummary:
    """The map."""

    update: Update
    """How scans became observations of cells"""
    model: str
    """Sensor model with all its parameters, as `model` takes it"""
    min_passes: Count | None
    """On how many visits a cell had to be hit to keep its hits (`min_passes`); null: all keep
    theirs"""
    resolution: float
    """Side of a cell (m)"""
    columns: Count
    """Cells from left to right (along x)"""
    rows: Count
    """Cells from bottom to top (along y)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    align: float
    """By what the map is turned against the frame of its poses, counter-clockwise (degrees)"""
    occupied: Share
    """Share of the map's cells that are occupied, by `occupied_thresh`"""
    free: Share
    """Share of the map's cells that are free, by `free_thresh`"""
    unknown: Share
    """Share of the map's cells that nothing observed"""
    undecided: Share
    """Share of the map's cells that were observed and are neither occupied nor free"""
    agreement: Share | None
    """Share of hits that lie in cells called occupied, low where poses are wrong; null where hits
    are not kept"""

    @property
    def cells(self) -> int:
        """How many there are."""
        return self.columns * self.rows

    @property
    def area(self) -> float:
        """Area of the cells that are not unknown (m²)."""
        return self.cells * (1 - self.unknown) * self.resolution**2

    @classmethod
    def describe(
        cls, facts: MapFacts, resolution: float, manifest: Manifest, min_passes: int | None
    ) -> Self:
        """Sum up a map of evidence; the cells of an overview are coarser than the evidence's."""
        rows, columns = facts.shape
        return cls(
            update=Update(manifest.update),
            model=manifest.model,
            min_passes=min_passes,
            resolution=resolution,
            columns=columns,
            rows=rows,
            extent=facts.extent,
            align=manifest.align or 0.0,
            **facts.shares._asdict(),
            undecided=max(round(1 - sum(facts.shares), 12), 0.0),  # 0 where all shares add up to 1
            agreement=facts.agreement,
        )


@dataclass(frozen=True)
class Report:
    """A map and how it came about: what occmap build, render and merge print."""

    logs: tuple[str, ...]
    """Logs of the map: as they were given, or, where it is made of evidence, by the names of their
    files"""
    scans: ScanCounts
    """What became of the scans"""
    builds: Count
    """How many builds the logs, scans and beams are of: more than one in evidence that was
    merged"""
    resumed: Resumed | None
    """The evidence that the build was added to (`resume`), whose scans and beams are not counted
    here; null where there is none"""
    beams: ReturnCounts
    """How many beams of the used scans were read as what"""
    map: MapSummary
    """The map"""
    notes: tuple[str, ...]
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = ()
    """Those of the notes that tell of damage to a log"""
    files: tuple[str, ...] = ()
    """Files that were written"""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time by stage (s); where threads work at the same time, their times add up; empty where no
    log was read"""

    @property
    def hit_share(self) -> float:
        """The share of beams that hit something; 0 of nothing."""
        return self.beams.hit / max(sum(self.beams), 1)

    @property
    def no_return_share(self) -> float:
        """The share of beams that nothing came back to; 0 of nothing."""
        return self.beams.no_return / max(sum(self.beams), 1)

    def to_json(self) -> dict[str, Any]:
        """Give the report as values that JSON has."""
        plain: dict[str, Any] = to_plain(self)
        return plain


class Noted(Protocol):
    """A log, or what stands for a log that another process read."""

    @property
    def path(self) -> Path:
        """Where it is."""

    @property
    def notes(self) -> Sequence[Note]:
        """What its reader has to say."""


@dataclass
class Remarks:
    """What is said of logs beside numbers; it grows while they are read."""

    logs: list[str]
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    def note(self, log: Noted, others: Iterable[str]) -> None:
        """Keep the notes of a log, and the notes of others on it."""
        self.notes += [f"{log.path}: {text}" for text in (*others, *(n.text for n in log.notes))]
        self.damage += [f"{log.path}: {note.text}" for note in log.notes if note.damage]


def list_idle_and_repeated(
    logs: Sequence[object], outputs: Sequence[Path], writing: WriteOptions, model: SensorModel
) -> Iterator[str]:
    """Say which options do nothing, and which logs were given more than once and count as often."""
    yield from list_idle(outputs, writing)
    yield from list_unreached(model, writing)
    for log, times in Counter(map(str, logs)).items():
        if times > 1:
            yield f"{log}: given {times} times, and counted as often"


def list_frames(tally: Tally) -> Iterator[str]:
    """Say that logs are mapped in frames of different names, which may lie anywhere."""
    first = {frame: log for log, frame in reversed(tally.frames.items()) if frame}
    if len(first) > 1:
        named = ", ".join(f"{log} in {frame}" for frame, log in reversed(first.items()))
        yield (
            f"the logs are mapped in different frames: {named}; where these do not lie on each "
            "other, choose one with `map_frame`, or build each log alone with its own `transform` "
            "and merge them"
        )


def refuse_unused(logs: Sequence[object], tally: Tally) -> None:
    """Refuse to make a map of nothing.

    Raises
    ------
    LogError, PoseError
        No scan was used; the message says why.
    """
    if tally.scans_used:
        return
    where = name_logs(logs)
    reasons = ", ".join(f"{count} {reason}" for reason, count in tally.dropped.items())
    if tally.scans_read:
        raise PoseError(
            f"none of {tally.scans_read} scans can be used: {reasons}",
            where=where,
            fix="`occmap check` shows the times of scans and poses",
        )
    raise LogError("holds no laser scan that can be read", where=where)


def refuse_unseen(logs: Sequence[object], tally: Tally, seen: Collection[object]) -> None:
    """Refuse to make a map in which no tile, or block of tiles, was seen.

    Raises
    ------
    MapError
        Saying what the beams of all scans were read as.
    """
    if seen:
        return
    clear = ", or try `no_return=clear`" if tally.beams.no_return else ""
    raise MapError(
        f"no beam of any scan observed a cell: {write_counts(tally.beams.by_name)}",
        where=name_logs(logs),
        fix=f"see the ranges in `occmap check`{clear}",
    )


def name_logs(logs: Sequence[object]) -> str:
    """Name the logs, given as paths, that an error is about."""
    return ", ".join(map(str, logs))


def list_lacking(tally: Tally, resumed: Resumed | None) -> Iterator[str]:
    """Say that the logs show no walls."""
    if not tally.beams.hit:
        lack = "of the logs hit anything" if resumed else "hit anything, so the map has no walls"
        yield f"no beam {lack}: see the ranges in `occmap check`"


def note_idle_end(selection: Selection, tally: Tally) -> Iterator[str]:
    """Say that `end_s` leaves nothing out: it may be meant as a date."""
    end_s = selection.end_s
    if end_s < math.inf and (end_s > LONGEST_LOG_S or str(LeftOut.TIME) not in tally.dropped):
        yield f"`end_s={end_s:.12g}` leaves nothing out: it is in seconds after the first scan"


def hint_at_tune(agreement: float) -> str:
    """What to try where the agreement is poor, though it may be as good as it gets; else empty.

    It stands beside the number and is no note, as nothing need be wrong. Where the agreement is
    poorer still, a note says more.
    """
    if not LEAST_AGREEMENT <= agreement < DOUBTFUL_AGREEMENT:
        return ""
    return "; walls may be doubled: `occmap tune LOG` looks for a wrong clock or mount"


def list_disagreement(facts: MapFacts) -> Iterator[str]:
    """Say that the scans of a map contradict each other."""
    agreement = facts.agreement
    if agreement is not None and agreement < LEAST_AGREEMENT and facts.has_walls:
        yield (
            f"only {agreement:.0%} of the hits lie in cells that the map calls occupied: the "
            "poses do not fit the scans; see `occmap check`, try `occmap tune`, another "
            "`time_offset_s` or another trajectory"
        )


def describe_map(grid: OccupancyMap, writing: WriteOptions) -> MapFacts:
    """Measure a map, as it is written."""
    written = replace(grid, decision=writing.decide(grid.decision))
    masks = written.occupied, written.free, ~written.observed
    shares = Shares(*(int(np.count_nonzero(mask)) / mask.size for mask in masks))
    has_walls = bool(grid.occupied.any())
    return MapFacts(grid.shape, grid.extent, shares, grid.agreement, has_walls)


def list_unreached(model: SensorModel, writing: WriteOptions) -> Iterator[str]:
    """Say which class no cell can have, because of the bounds of the model."""
    if not isinstance(model, Clamped):
        return
    free, occupied = writing.decide(find_decision(model))
    if model.clamp_max <= occupied:
        yield f"no cell can be occupied: clamp_max {model.clamp_max:g} is not above {occupied:g}"
    if model.clamp_min >= free:
        yield f"no cell can be free: clamp_min {model.clamp_min:g} is not below {free:g}"
