"""Variants of a map: an update and a sensor model each, scored on scans kept from all of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from time import thread_time
from typing import Self

import numpy as np

from occmap.cells import OccupancyMap
from occmap.evidence import render
from occmap.evidence.manifest import describe_profile
from occmap.grid.tiles import TileGrid
from occmap.options import BuildOptions, choose_model
from occmap.report.printed import HIDDEN, IN_PLACE, Count, Finite, Share
from occmap.scans.engines import make_engine
from occmap.scoring.score import Gain, Score, score_map
from occmap.sensor.models import SensorModel, make_model, parse_model
from occmap.types import BEAM_UPDATES, Float64, Kind, Rays, Update
from occmap.workers import Workers

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
        self.scans = 0
        self._seen = 0

    def split(self, rays: Rays) -> Rays:
        """Keep some scans, and return the others."""
        scans = len(rays.kind)
        kept = (self._seen + np.arange(scans)) % EVERY == FIRST
        self._seen += scans
        if kept.any():
            self.held.append(rays.take(kept))
            self.scans += int(np.count_nonzero(kept))
        return rays.take(~kept)

    @property
    def hits(self) -> int:
        """Held-out beams that measured a range."""
        return sum(int(np.count_nonzero(rays.kind == Kind.HIT)) for rays in self.held)


def make_scans(scans: int) -> Rays:
    """A corner of a room, from one place."""
    return Rays(
        origin=np.zeros((scans, 1, 2)),
        turn=np.tile(np.eye(2), (scans, 1, 1, 1)),
        bearing=np.array([[1.0, 0.0], [0.0, 1.0]]),
        distance=np.ones((scans, 2), np.float32),
        kind=np.full((scans, 2), Kind.HIT, np.uint8),
        stamp_ns=np.zeros(scans, np.int64),
        full_circle=False,
    )


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
        self.variants = variants
        self.hold_out = HoldOut()
        self.evidence: dict[str, SharedEvidence] = {}

    def tracing(self) -> Workers[Task]:
        """Make threads that trace."""
        return Workers(lambda task: task[0].add(task[1]), self._options.jobs)

    def begin(self, workers: Workers[Task]) -> Callable[[Rays], None]:
        """Start anew; return a function that holds some scans out and has the others traced."""
        self.hold_out, self.evidence = HoldOut(), {}
        for variant in self.variants:
            if variant.evidence not in self.evidence:
                choice = replace(self._options, update=variant.update, model=variant.model)
                self.evidence[variant.evidence] = SharedEvidence(choice)

        def observe(rays: Rays) -> None:
            seen = self.hold_out.split(rays)
            if len(seen.kind):
                for evidence in self.evidence.values():
                    workers.give((evidence, seen))

        return observe

    def score(self) -> list[ScoredVariant]:
        """Render every variant and score it on the scans held out, the best share first.

        Raises
        ------
        MapError
            Nothing was observed, or a map would be too large.
        """
        grids = {key: evidence.finish() for key, evidence in self.evidence.items()}
        held = self.hold_out.held
        results = [self._score(v, grids[v.evidence], held) for v in self.variants]
        results.sort(key=lambda each: (-each.score.share, -each.score.log_likelihood))
        return [each.compare_with(results[0]) for each in results]

    def _score(self, variant: Variant, grid: TileGrid, held_out: Sequence[Rays]) -> ScoredVariant:
        start = thread_time()
        made = render(grid, variant.model, self._options.max_cells)
        seconds = self.evidence[variant.evidence].seconds + thread_time() - start
        trial = score_map(made, held_out, self._options.jobs)
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
