"""Scoring: which update and sensor model suits a log, measured on scans that no map has seen.

A variant of a map is an update and a sensor model; it is scored by how well its map predicts scans
that are kept from all of them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from time import thread_time
from typing import Generic, NamedTuple, Self, TypeVar

import numpy as np

from occmap.cells import OccupancyMap
from occmap.evidence import render
from occmap.evidence.manifest import describe_profile
from occmap.grid.tiles import TileGrid
from occmap.options import BuildOptions, choose_model
from occmap.report import HIDDEN, IN_PLACE, Count, Finite, Share
from occmap.scans import make_engine
from occmap.scans.logs import count_scans, open_scans
from occmap.scans.tally import Tally, refuse_unused
from occmap.scans.tracing import AddRays, Progress, Remarks, trace_logs
from occmap.sensor.models import SensorModel, make_model, parse_model
from occmap.types import BEAM_UPDATES, Float64, Kind, Rays, ScanBatch, Update
from occmap.workers import Workers

NOISE = 2.0
"""Standard errors: a difference that is not larger may be chance."""
SMALL = 0.005
"""A smaller difference of shares does not show in a map, however certain it is: as all maps are
asked about the same scans, a difference of a thousandth may well be certain."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Cells of nearly equal probability, each as often as a held-out beam looked at it.

    A reliability diagram (DeGroot and Fienberg 1983) shows `observed` over `predicted`: equal where
    probabilities mean what they say.
    """

    looks: int
    """How often a beam crossed or ended in such a cell"""
    predicted: float
    """Mean probability of being occupied, a share from 0 to 1"""
    observed: float
    """Share of the looks that found the cell occupied: the beam ended in it"""


@dataclass(frozen=True)
class Score:
    """How well a map predicts the beams of held-out scans. An unknown cell has probability 0.5."""

    beams: Count
    """Held-out beams that measured a range"""
    share: Share
    """Share of these whose first occupied cell is within two cells of the range"""
    share_error: Finite
    """Standard error of the share, the held-out scans taken as independent draws; null where
    one scan is all there is"""
    log_likelihood: float
    """Mean log-likelihood of the measured ranges: that the beam stops within two cells of its
    range, mixed with 5% of returns from anywhere (nat)"""
    occupied_cost: float
    """Mean cross-entropy of the cells that beams ended in (nat)"""
    free_cost: float
    """Mean cross-entropy of the cells that beams crossed before (nat)"""
    cross_entropy: float
    """Mean of both, so that the cells found occupied weigh as much as the many found free (nat)"""
    reliability: tuple[ReliabilityBin, ...] = ()
    """What the map says of cells beside what beams found in them: a bin for each tenth of
    probability, without those that nothing was in; unknown cells do not count"""


class Trial(NamedTuple):
    """How a map fared."""

    score: Score
    predicted: Float64
    """(N, 2) of each held-out scan: beams that measured a range, and those of them it predicted"""


class Gain(NamedTuple):
    """How much larger the share of one map is than that of another, by the same scans."""

    share: float = 0.0
    error: float = 0.0
    """Standard error, from the differences scan by scan; it is smaller than those of the shares,
    since both maps are asked about the same scans"""

    @property
    def certain(self) -> bool:
        """Whether it is more than noise, and so much that it shows in a map."""
        return self.share > max(NOISE * self.error, SMALL)

    def __neg__(self) -> "Gain":
        """How much smaller the share is."""
        return Gain(-self.share, self.error)

    @classmethod
    def measure(cls, before: Float64, after: Float64) -> "Gain":
        """Measure it by how two maps fared with some scans (N, 2), as `Trial.predicted` has it."""
        beams, now = after.T
        more = now - before[:, 1]
        return cls(math.fsum(more) / max(math.fsum(beams), 1), estimate_error(more, beams))


def score_map(grid: OccupancyMap, held_out: Sequence[Rays], jobs: int) -> Trial:
    """Cast held-out beams, of which some must have measured a range, through a map."""
    from occmap.grid.kernels.cast import BINS, CERTAIN, Chart, cast_beams  # noqa: PLC0415  late: loads numba

    probability = np.where(grid.observed, grid.probability, np.float32(0.5))
    free_cost = -np.log(np.maximum(1 - probability, np.float32(CERTAIN)))
    tenths = np.minimum(probability * BINS, BINS - 1)
    bins = np.where(grid.observed, tenths, BINS).astype(np.uint8)
    chart = Chart(grid.occupied, probability, free_cost, bins, grid.origin, grid.resolution)
    totals = [np.zeros((len(rays.kind), 6)) for rays in held_out]
    tallies = [np.zeros((BINS + 1, 3)) for _ in held_out]

    def cast(index: int) -> None:
        cast_beams(held_out[index], chart, totals[index], tallies[index])

    with Workers(cast, jobs) as workers:
        for index in range(len(held_out)):
            workers.give(index)
    by_scan = np.concatenate(totals)
    reliability = tuple(
        ReliabilityBin(int(looks), predicted / looks, ended / looks)
        for looks, predicted, ended in np.sum(tallies, axis=0)[:BINS].tolist()
        if looks
    )
    return Trial(replace(sum_up(by_scan), reliability=reliability), by_scan[:, :2])


def sum_up(totals: Float64) -> Score:
    """Turn (N, 6) totals of N scans, as `cast_beams` writes them, into means."""
    beams, near, log_likelihood, occupied, cells, free = (math.fsum(each) for each in totals.T)
    occupied_cost, free_cost = occupied / beams, free / max(cells, 1)
    return Score(
        beams=int(beams),
        share=near / beams,
        share_error=estimate_error(totals[:, 1], totals[:, 0]),
        log_likelihood=log_likelihood / beams,
        occupied_cost=occupied_cost,
        free_cost=free_cost,
        cross_entropy=(occupied_cost + free_cost) / 2,
    )


def estimate_error(part: Float64, whole: Float64) -> float:
    """Estimate the standard error of sum(part) / sum(whole) over scans (N,).

    A scan, not a beam, is an independent draw: its beams see the same wall by the same pose. So
    this is the error of a ratio of sums over clusters (Cochran 1977, ch. 6); inf for one scan.
    """
    scans, total = int(np.count_nonzero(whole)), math.fsum(whole)
    if scans < 2:
        return math.inf
    rest = part - math.fsum(part) / total * whole
    return math.sqrt(scans / (scans - 1) * math.fsum(rest**2)) / total


def read_scans(
    paths: Sequence[Path],
    options: BuildOptions,
    begin: Callable[[], AddRays],
    progress: Progress,
) -> tuple[Tally, Remarks]:
    """Read all usable scans of logs in their order; say what became of them, and what to note.

    Parameters
    ----------
    begin
        Called each time that the logs are read; returns what takes their rays.

    Raises
    ------
    OccmapError
        As a build.
    """
    tally = Tally()
    logs = open_scans(paths, options)
    total = sum(count_scans(log, options.selection.topics) for log in logs)
    tally.tell = lambda scans: progress(scans, total)
    remarks = Remarks([str(log.path) for log in logs])
    for log, notes in trace_logs(logs, replace(options, jobs=1), begin, tally):
        remarks.note(log.path, log.notes, notes)
    refuse_unused(paths, tally)
    return tally, remarks


Taken = TypeVar("Taken", Rays, ScanBatch)
GOLDEN = (math.sqrt(5) - 1) / 2


class Sample(Generic[Taken]):
    """Scans spread evenly over all that came, of which no more than so many are kept.

    The fractions of the multiples of the golden ratio lie evenly between 0 and 1, and so do those
    below a limit among all. Every n-th scan could be of one laser only, where lasers take turns.
    """

    def __init__(self, most: int) -> None:
        self.seen = 0
        """How many scans came"""
        self._most, self._limit = most, 1.0
        self._kept: list[tuple[Float64, Taken]] = []
        """The fractions of scans, and the scans"""

    @property
    def parts(self) -> list[Taken]:
        """The scans that are kept."""
        return [part for _, part in self._kept]

    @property
    def scans(self) -> int:
        """How many are kept."""
        return sum(len(fraction) for fraction, _ in self._kept)

    def add(self, part: Taken) -> None:
        """Take scans that come after all others; where there are too many, half of them go."""
        numbers = self.seen + np.arange(len(part.stamp_ns), dtype=np.float64)
        fraction = np.asarray(numbers * GOLDEN % 1, np.float64)
        self.seen += len(numbers)
        self._kept += self._take_low([(fraction, part)])
        while self.scans > self._most:
            self._limit /= 2
            self._kept = self._take_low(self._kept)

    def _take_low(self, parts: Sequence[tuple[Float64, Taken]]) -> list[tuple[Float64, Taken]]:
        return [
            (fraction[low], part.take(low))
            for fraction, part in parts
            if (low := fraction < self._limit).any()
        ]


DEFAULT_MODELS = ("simple", "quadratic")
"""Beside the one that an update is used with"""


@dataclass(frozen=True)
class Variant:
    """One way to make a map."""

    update: Update
    model: SensorModel

    @property
    def name(self) -> str:
        """The update, the model, and the parameters that are not at their defaults."""
        return f"{self.update} {shorten_model(self.model)}"

    @property
    def evidence(self) -> str:
        """Equal for variants that differ only in what they make of the same evidence."""
        return f"{self.update} {describe_profile(self.model) or 'counts'}"


def shorten_model(model: SensorModel) -> str:
    """Write a model as `model` takes it, without the parameters that are at their defaults."""
    default = make_model(model.name, {})
    changed = [
        f"{field.name}={getattr(model, field.name):g}"
        for field in fields(model)  # type: ignore[arg-type]  # a dataclass
        if getattr(model, field.name) != getattr(default, field.name)
    ]
    return model.name + (":" + ",".join(changed) if changed else "")


def combine(updates: Sequence[Update], models: Sequence[SensorModel]) -> list[Variant]:
    """Combine every update with every model, each once; where none is given, with the usual ones.

    Raises
    ------
    UsageError
        A model does not load.
    """
    others = models or [parse_model(text) for text in DEFAULT_MODELS]
    variants = [
        Variant(update, model)
        for update in updates or BEAM_UPDATES
        for model in ([] if models else [choose_model(update)]) + list(others)
    ]
    return list({each.name: each for each in variants}.values())


EVERY = 5
"""Every n-th scan is held out"""
FIRST = 2
"""The first scan that is held out, counted from 0"""


class HoldOut:
    """Keeps every fifth scan from the maps; the scans must come in one order, so in one thread."""

    def __init__(self) -> None:
        self.held: list[Rays] = []
        self._seen = 0

    def split(self, rays: Rays) -> Rays:
        """Keep some scans, and return the others."""
        scans = len(rays.kind)
        kept = (self._seen + np.arange(scans)) % EVERY == FIRST
        self._seen += scans
        if kept.any():
            self.held.append(rays.take(kept))
        return rays.take(~kept)

    @property
    def scans(self) -> int:
        """Held-out scans."""
        return sum(len(rays.kind) for rays in self.held)

    @property
    def hits(self) -> int:
        """Held-out beams that measured a range."""
        return sum(int(np.count_nonzero(rays.kind == Kind.HIT)) for rays in self.held)


def make_scans(scans: int) -> Rays:
    """A corner of a room, from one place."""
    ways, reach = np.tile(np.eye(2), (scans, 1, 1)), np.ones((scans, 2), np.float32)
    kind, stamp_ns = np.full((scans, 2), Kind.HIT, np.uint8), np.zeros(scans, np.int64)
    return Rays.along(np.zeros((scans, 1, 2)), ways, reach, kind, stamp_ns, full_circle=False)


class SharedEvidence:
    """The evidence of one or more variants, and the processor time that it took."""

    def __init__(self, options: BuildOptions) -> None:
        # No variant is charged for compiling kernels: those for few scans, and those for many.
        engine = make_engine(options)
        for scans in (1, 500):
            engine.add(make_scans(scans))
        engine.finish()
        self._engine = make_engine(options)
        self._seconds: list[float] = []

    def add(self, rays: Rays) -> None:
        """Trace scans; any thread may."""
        start = thread_time()
        self._engine.add(rays)
        self._seconds.append(thread_time() - start)

    def finish(self) -> TileGrid:
        """Return the evidence of all scans."""
        start = thread_time()
        grid = self._engine.finish()
        self._seconds.append(thread_time() - start)
        return grid

    @property
    def seconds(self) -> float:
        """Processor time of all threads together (s)."""
        return sum(self._seconds)


Task = tuple[SharedEvidence, Rays]
"""Scans for one piece of evidence"""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoredVariant:
    """One way to make the map, and how well that map predicts the held-out scans."""

    variant: Variant = field(metadata=HIDDEN)
    map: OccupancyMap = field(metadata=HIDDEN)
    predicted: Float64 = field(metadata=HIDDEN)
    """(N, 2) of each held-out scan: beams that measured a range, and those of them it predicted"""
    score: Score = field(metadata=IN_PLACE)
    name: str
    """The update, the model, and its parameters that are not at their defaults"""
    update: Update
    """How scans became observations of cells"""
    model: str
    """Sensor model, as `model` takes it"""
    behind: Share = 0.0
    """How much lower the share is than the best one"""
    behind_error: Finite = 0.0
    """Standard error of that, from the differences scan by scan; null where one scan is all
    there is"""
    as_good: bool = True
    """The share is behind the best one by at most two standard errors, or half a percent"""
    columns: Count
    """Cells of the map from left to right (along x)"""
    rows: Count
    """Cells of the map from bottom to top (along y)"""
    seconds: float
    """Processor time to trace and render (s)"""
    bytes: Count
    """Size of the evidence in memory (bytes)"""

    def compare_with(self, best: Self) -> Self:
        """Measure how far the share is behind the best one."""
        behind = Gain.measure(self.predicted, best.predicted)
        return replace(
            self, behind=behind.share, behind_error=behind.error, as_good=not behind.certain
        )


class Trials:
    """The variants of one comparison. Those that need the same evidence share it."""

    def __init__(self, variants: Sequence[Variant], options: BuildOptions) -> None:
        self._options = options
        self._variants = variants
        self._evidence: dict[str, SharedEvidence] = {}
        self.hold_out = HoldOut()

    def tracing(self) -> Workers[Task]:
        """Make threads that trace."""
        return Workers(lambda task: task[0].add(task[1]), self._options.jobs)

    def begin(self, workers: Workers[Task]) -> Callable[[Rays], None]:
        """Start anew; return a function that holds some scans out and has the others traced."""
        self.hold_out = HoldOut()
        self._evidence = {
            key: SharedEvidence(replace(self._options, update=each.update, model=each.model))
            for key, each in {each.evidence: each for each in self._variants}.items()
        }

        def observe(rays: Rays) -> None:
            seen = self.hold_out.split(rays)
            if len(seen.kind):
                for evidence in self._evidence.values():
                    workers.give((evidence, seen))

        return observe

    def score(self) -> list[ScoredVariant]:
        """Render every variant and score it on the scans held out, the best share first.

        Raises
        ------
        MapError
            Nothing was observed, or a map would be too large.
        """
        grids = {key: evidence.finish() for key, evidence in self._evidence.items()}
        results = [self._score(each, grids[each.evidence]) for each in self._variants]
        results.sort(key=lambda each: (-each.score.share, -each.score.log_likelihood))
        return [each.compare_with(results[0]) for each in results]

    def _score(self, variant: Variant, grid: TileGrid) -> ScoredVariant:
        start = thread_time()
        made = render(grid, variant.model, self._options.max_cells)
        seconds = self._evidence[variant.evidence].seconds + thread_time() - start
        trial = score_map(made, self.hold_out.held, self._options.jobs)
        return ScoredVariant(
            variant=variant,
            map=made,
            predicted=trial.predicted,
            score=trial.score,
            name=variant.name,
            update=variant.update,
            model=shorten_model(variant.model),
            columns=made.shape[1],
            rows=made.shape[0],
            seconds=round(seconds, 4),
            bytes=sum(tile.nbytes for tile in grid.tiles.values()),
        )
