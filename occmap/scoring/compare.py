"""Several ways to map the same logs, in one read: which of them predicts scans best.

A variant of a map is an update and a sensor model; it is scored by how well its map predicts scans
that are kept from the maps of all variants.
"""

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import thread_time
from typing import Self

import numpy as np

from occmap.cells import OccupancyMap
from occmap.errors import LogError, UsageError, require
from occmap.evidence import render
from occmap.evidence.manifest import describe_profile
from occmap.grid.tiles import TileGrid
from occmap.options import DEFAULT_UPDATE, BuildOptions, choose_model, compose_build
from occmap.report import HIDDEN, IN_PLACE, Count, Finite, Noted, Share, count, printed_as
from occmap.report.results import name_frames
from occmap.scans import make_engine
from occmap.scans.tally import ScanCounts, Tally
from occmap.scans.tracing import Progress, Reading, ignore_progress
from occmap.scoring import SMALL, Gain, Score, Trial, has_hits, hold_out, score_map
from occmap.sensor.models import SensorModel, parse_model, shorten_model
from occmap.types import BEAM_UPDATES, Kind, Paths, Rays, Update

FEW_SCANS = 10
"""Fewer scans do not show how far the next one may lie from them."""
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


def combine(updates: Sequence[Update], models: Sequence[SensorModel]) -> list[Variant]:
    """Combine every update with every model, each once; where none is given, with the usual ones.

    Raises
    ------
    UsageError
        A model does not load, or an update is for clouds.
    """
    found = "the cloud update has no beams, and maps are scored by beams"
    require(Update.CLOUD not in updates, found, f"choose of {', '.join(BEAM_UPDATES)}")
    others = models or [parse_model(text) for text in DEFAULT_MODELS]
    variants = [
        Variant(update, model)
        for update in updates or BEAM_UPDATES
        for model in ([] if models else [choose_model(update)]) + list(others)
    ]
    return list({each.name: each for each in variants}.values())


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
        self.seconds: list[float] = []
        """Processor time of each step, in any thread (s)"""

    def add(self, rays: Rays) -> None:
        """Trace scans; any thread may."""
        start = thread_time()
        self._engine.add(rays)
        self.seconds.append(thread_time() - start)

    def finish(self) -> TileGrid:
        """Return the evidence of all scans."""
        start = thread_time()
        grid = self._engine.finish()
        self.seconds.append(thread_time() - start)
        return grid


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoredVariant:
    """One way to make the map, and how well that map predicts the held-out scans."""

    variant: Variant = field(metadata=HIDDEN)
    map: OccupancyMap = field(metadata=HIDDEN)
    trial: Trial = field(metadata=HIDDEN)
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
        behind = Gain.measure(self.trial.predicted, best.trial.predicted)
        error, as_good = behind.gain_error, not behind.certain
        return replace(self, behind=behind.gain, behind_error=error, as_good=as_good)


def score_variants(
    variants: Sequence[Variant],
    shared: Mapping[str, SharedEvidence],
    held_out: Sequence[Rays],
    options: BuildOptions,
) -> list[ScoredVariant]:
    """Render every variant and score it on the scans held out, the best share first.

    Raises
    ------
    MapError
        Nothing was observed, or a map would be too large.
    """
    grids = {key: evidence.finish() for key, evidence in shared.items()}
    results = []
    for variant in variants:
        grid, start = grids[variant.evidence], thread_time()
        made = render(grid, variant.model, options.max_cells)
        seconds = sum(shared[variant.evidence].seconds) + thread_time() - start
        trial = score_map(made, held_out, options.jobs)
        scored = ScoredVariant(
            variant=variant,
            map=made,
            trial=trial,
            score=trial.score,
            name=variant.name,
            update=variant.update,
            model=shorten_model(variant.model),
            columns=made.shape[1],
            rows=made.shape[0],
            seconds=round(seconds, 4),
            bytes=sum(tile.nbytes for tile in grid.tiles.values()),
        )
        results.append(scored)
    results.sort(key=lambda each: (-each.score.share, -each.score.log_likelihood))
    return [each.compare_with(results[0]) for each in results]


@dataclass(frozen=True)
class HeldOutScans(ScanCounts):
    """What became of the scans."""

    held_out: Count
    """Scans that the maps are scored on and not made of"""


@dataclass(frozen=True, kw_only=True)
class Scored(Noted):
    """What is said of any run that scores maps on held-out scans."""

    logs: list[str]
    """Logs, as they were given"""
    scans: HeldOutScans
    """What became of the scans"""
    resolution: float
    """Side of a cell (m)"""
    notes: tuple[str, ...]
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = field(init=False)
    """Those of the notes that tell of damage to a log"""


@dataclass(frozen=True, eq=False, kw_only=True)
class VariantComparison(Scored):
    """Updates and sensor models, scored on held-out scans: what occmap compare prints."""

    results: tuple[ScoredVariant, ...] = field(metadata=printed_as("variants"))
    """What was compared, the best share first"""
    best: str
    """Name of the variant to use: of those with as good a share as the best, the default, else
    that of the best log-likelihood"""
    command: tuple[str, ...]
    """The command line that builds its map from all scans, word by word"""
    likeliest_name: str = field(metadata=printed_as("likeliest"))
    """Name of the variant to use where probabilities matter: of those with as good a share as
    the best, that of the best log-likelihood"""
    likeliest_command: tuple[str, ...]
    """The command line that builds its map from all scans, word by word"""
    files: tuple[str, ...] = ()
    """Files that were written"""
    recommended: ScoredVariant = field(metadata=HIDDEN)
    """The best one: the default if it is as good, else that of the best log-likelihood, which
    tells more than a share"""
    likeliest: ScoredVariant = field(metadata=HIDDEN)
    preference: str = field(metadata=HIDDEN)
    """Which variants are as good, and why one is preferred; "" where there is only one"""


def compare(
    paths: Paths,
    variants: Sequence[Variant],
    options: BuildOptions,
    progress: Progress = ignore_progress,
) -> VariantComparison:
    """Map logs in several ways, with every fifth scan held out, and score the maps on those.

    At most 4,000 held-out scans, spread over all of them, stay in memory: five bytes a beam.

    Parameters
    ----------
    options
        Shared by all variants; its own update and model do not matter.

    Raises
    ------
    OccmapError
        As `build`, no held-out beam measured a range, or logs are mapped in different frames.
    """
    reading = Reading(paths, options, progress)
    shared = {  # by the variants that need the same
        each.evidence: SharedEvidence(replace(options, update=each.update, model=each.model))
        for each in variants
    }
    held_out = hold_out(reading.list_rays(), list(shared.values()), options.jobs)
    tally = reading.tally
    fix = "choose one with `map_frame`, or compare each log by itself"
    if apart := name_frames(tally.frames):
        raise UsageError(apart, fix=fix)
    refuse_unscored(tally.logs, held_out.scans, has_hits(held_out))
    tally.notes += held_out.list_notes("held-out scans")
    if held_out.scans < FEW_SCANS:
        few = count(held_out.scans, "held-out scan")
        tally.notes.append(f"{few}: too few to tell variants apart; give a longer log")
    results = score_variants(variants, shared, held_out.parts, options)
    return choose_best(results, options, tally, held_out.scans)


def choose_best(
    results: Sequence[ScoredVariant], options: BuildOptions, tally: Tally, held_out: int
) -> VariantComparison:
    """Choose the variants to use, of those whose share is as good as the best."""
    equals = [each for each in results if each.as_good]
    usual = Variant(DEFAULT_UPDATE, BuildOptions().model)  # of a bare build
    default = next((each for each in equals if each.variant == usual), None)
    likeliest = max(equals, key=lambda each: each.score.log_likelihood)
    if default and likeliest.score.log_likelihood - default.score.log_likelihood < SMALL:
        likeliest = default
    recommended = default or likeliest
    names = ", ".join(each.name for each in equals)
    why = "the default" if default else "the best log-likelihood"
    return VariantComparison(
        logs=tally.logs,
        notes=tuple(tally.notes),
        scans=HeldOutScans(**vars(tally.scans), held_out=held_out),
        resolution=options.resolution,
        results=tuple(results),
        best=recommended.name,
        command=compose_variant(tally.logs, options, recommended),
        likeliest_name=likeliest.name,
        likeliest_command=compose_variant(tally.logs, options, likeliest),
        recommended=recommended,
        likeliest=likeliest,
        preference=f"{names}; of these, {why} is preferred" if len(equals) > 1 else "",
    )


def compose_variant(logs: list[str], options: BuildOptions, way: ScoredVariant) -> tuple[str, ...]:
    """Compose the command line that builds the map of a variant from all scans."""
    if way.update is not Update.POLYGON:
        options = replace(options, border_gap=BuildOptions.border_gap)
    if way.update is Update.BEAM:  # which knows no surfaces
        options = replace(options, jump=BuildOptions.jump)
    return compose_build(logs, options, [("model", way.model)], way.update.value)


def refuse_unscored(logs: Sequence[str], held_out: int, are_told: bool) -> None:
    """Refuse to rank maps by so many held-out scans, unless any of their beams measured a range.

    Raises
    ------
    LogError
        No held-out beam measured a range.
    """
    if not are_told:
        raise LogError(
            f"no beam of the {held_out} scans held out for scoring measured a range",
            where=", ".join(logs),
            fix="give more scans: every fifth is held out",
        )


SCORES = (
    *("variant", "share", "error", "log-likelihood", "entropy", "free", "occupied"),
    *("time (s)", "memory (MB)"),
)
"""What `list_scores` lists: `free` and `occupied` are the two parts of the entropy"""


def list_scores(result: ScoredVariant) -> list[str]:
    """Write the scores of a variant as a row of a table, whose columns are SCORES."""
    score = result.score
    return [
        result.name,
        f"{score.share:.4f}",
        f"{score.share_error:.4f}" if math.isfinite(score.share_error) else "-",
        f"{score.log_likelihood:.3f}",
        f"{score.cross_entropy:.3f}",
        f"{score.free_cost:.3f}",
        f"{score.occupied_cost:.3f}",
        f"{result.seconds:.2f}",
        f"{result.bytes / 1e6:.1f}",
    ]


def tell_verdict(comparison: VariantComparison) -> Iterator[str]:
    """Say which variants to use, each with the command line that builds its map."""
    if comparison.preference:
        yield f"as good within the error: {comparison.preference}"
    yield f"best: {comparison.best}"
    yield shlex.join(comparison.command)
    if comparison.likeliest is not comparison.recommended:
        yield f"where probabilities matter: {comparison.likeliest_name}"
        yield shlex.join(comparison.likeliest_command)
