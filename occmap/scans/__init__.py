"""The steps of a build: from the path of a log to what its scans observe.

`tracing.trace_drive` is the way of a log. `check`, `compare`, `tune` and `explain` go it, too. Here
are the engine for an update and a model, and what a sample of scans is judged by.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np

from occmap.cells import Ground
from occmap.errors import MapError
from occmap.evidence import render
from occmap.grid import Lattice
from occmap.grid.tiles import WINDOW_CELLS, GridSpec, tabulate
from occmap.options import BuildOptions
from occmap.sensor import interpret
from occmap.sensor.models import CountingModel, RadialModel
from occmap.types import Float64, Int64, Kind, PosedScans, Rays, ScanBatch, Update

if TYPE_CHECKING:
    from occmap.grid.engine import Engine


SHOWN_SCANS = 400
"""How many scans of all logs are shown: a slider with more steps cannot be set by hand."""


class Keep(NamedTuple):
    """What is kept of single scans, beside the sum of what all of them observe."""

    slices: bool = False
    """In which slices of time cells were observed"""
    journey: bool = False
    """Where the robot went"""
    ground: Ground | None = None
    """What clouds are traced over, if it is known, or what it grows from"""

    def choose_shown(self, scans: int) -> int:
        """Choose n, where the hits of every n-th of so many scans are shown; 0: of none."""
        return max(scans // SHOWN_SCANS, 1) if self.journey else 0


SUM_ALONE = Keep()


def make_engine(
    options: BuildOptions, keep: Keep = SUM_ALONE, window_cells: int = WINDOW_CELLS
) -> "Engine":
    """Make an engine for what the update is for: rays, or clouds over ground that is known."""
    slice_ns = round(options.pass_gap_s * 1e9) if keep.slices else None
    if options.update is Update.CLOUD and keep.ground is not None:
        from occmap.clouds.engine import CloudEngine, make_band  # noqa: PLC0415  late: it brings numba

        band = make_band(options.clouds, options.returns)
        over = Lattice(options.resolution), band, keep.ground
        return CloudEngine(*over, options.max_cells, slice_ns)
    from occmap.grid.engine import GridEngine  # noqa: PLC0415  likewise

    return GridEngine(plan_grid(options), window_cells, options.max_cells, slice_ns)


def plan_grid(options: BuildOptions) -> GridSpec:
    """Plan how an engine turns rays into evidence."""
    model, radial = options.model, None
    if isinstance(model, RadialModel):
        radial = tabulate(model.free, model.hit, model.depth(options.resolution))
    reach = options.jump, options.border_gap, options.hit_offset
    return GridSpec(options.update, Lattice(options.resolution), *reach, radial)


SAMPLED_SCANS, SAMPLED_CLOUDS = 600, 80
"""Of each topic of a log so many scans, or clouds, are kept at most, and half of that at least"""
SAMPLED_BEAMS = 1 << 19
"""Of large scans fewer are kept: this bounds the memory"""
Taken = TypeVar("Taken", Rays, ScanBatch, PosedScans)
GOLDEN = (math.sqrt(5) - 1) / 2


class Sample(Generic[Taken]):
    """Scans spread evenly over all that came, of which no more than so many are kept.

    The fractions of the multiples of the golden ratio lie evenly between 0 and 1, and so do those
    below a limit among all. Every n-th scan could be of one laser only, where lasers take turns.
    """

    def __init__(self, most: int = SAMPLED_SCANS) -> None:
        self.seen = self.scans = 0
        """How many scans came, and how many of them are kept"""
        self._most, self._limit = most, 1.0
        self._kept: list[tuple[Float64, Taken]] = []
        """The fractions of scans, and the scans"""

    @property
    def parts(self) -> list[Taken]:
        """The scans that are kept."""
        return [part for _, part in self._kept]

    def add(self, part: Taken) -> None:
        """Take scans that come after all others; where there are too many, half of them go."""
        numbers = self.seen + np.arange(len(part.stamp_ns), dtype=np.float64)
        self.seen += len(numbers)
        self._keep_low([(np.asarray(numbers * GOLDEN % 1, np.float64), part)])
        while self.scans > self._most:
            self._limit /= 2
            kept, self._kept, self.scans = self._kept, [], 0
            self._keep_low(kept)

    def _keep_low(self, parts: Sequence[tuple[Float64, Taken]]) -> None:
        for fraction, part in parts:
            low = fraction < self._limit
            if low.any():
                self._kept.append((fraction[low], part.take(low)))
                self.scans += int(np.count_nonzero(low))

    def list_notes(self, what: str = "scans") -> Iterator[str]:
        """Say how many are kept, where not all are."""
        if self.scans < self.seen:
            yield f"{self.scans:,} of {self.seen:,} {what} are asked, spread over the logs"


class TopicSample(Sample[PosedScans]):
    """Posed scans of one topic, by which it is judged how they fit each other."""

    def add(self, part: PosedScans) -> None:
        """Take scans that come after all others, as any sample does."""
        by_size = SAMPLED_BEAMS // max(part.batch.ranges.shape[1], 1)
        self._most = min(self._most, SAMPLED_CLOUDS if part.batch.clouds else by_size)
        super().add(part)


MOST_CELLS = 10**8
"""The largest map that is made of a sample"""


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) of a size (m) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    return np.asarray((cells[..., 0] << 32) + cells[..., 1])


def list_hits(seen: Iterable[Rays]) -> Float64:
    """(N, 2) where the beams of scans ended on something (m)."""
    return np.concatenate([np.zeros((0, 2)), *(rays.end[rays.kind == Kind.HIT] for rays in seen)])
