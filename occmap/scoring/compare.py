"""Several ways to map the same logs, in one read: which of them predicts scans best."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from occmap.errors import LogError
from occmap.options import DEFAULT_UPDATE, BuildOptions, compose_build
from occmap.report import HIDDEN, Count, Noted, count, printed_as
from occmap.report.results import list_frames
from occmap.scans.tally import ScanCounts
from occmap.scans.tracing import Progress, Remarks, ignore_progress
from occmap.scoring import SMALL, ScoredVariant, Trials, Variant, read_scans
from occmap.types import Update

FEW_SCANS = 10
"""Fewer scans do not show how far the next one may lie from them."""


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
    notes: list[str]
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
    paths: Sequence[Path],
    variants: Sequence[Variant],
    options: BuildOptions,
    progress: Progress = ignore_progress,
) -> VariantComparison:
    """Map logs in several ways, with every fifth scan held out, and score the maps on those.

    The held-out scans stay in memory: five bytes a beam.

    Parameters
    ----------
    options
        Shared by all variants; its own update and model do not matter.

    Raises
    ------
    OccmapError
        As `build`, or no held-out beam measured a range.
    """
    trials = Trials(variants, options)
    with trials.tracing() as workers:
        tally, remarks = read_scans(paths, options, partial(trials.begin, workers), progress)
    hold_out = trials.hold_out
    refuse_unscored(remarks.logs, hold_out.scans, hold_out.hits)
    remarks.notes += list_frames(tally)
    if hold_out.scans < FEW_SCANS:
        held_out = count(hold_out.scans, "held-out scan")
        remarks.notes.append(f"{held_out}: too few to tell variants apart; give a longer log")
    scans = HeldOutScans(**vars(tally.scans), held_out=hold_out.scans)
    return choose_best(trials.score(), options, remarks, scans)


def choose_best(
    results: Sequence[ScoredVariant], options: BuildOptions, remarks: Remarks, scans: HeldOutScans
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
        **vars(remarks),
        scans=scans,
        resolution=options.resolution,
        results=tuple(results),
        best=recommended.name,
        command=compose_variant(remarks.logs, options, recommended),
        likeliest_name=likeliest.name,
        likeliest_command=compose_variant(remarks.logs, options, likeliest),
        recommended=recommended,
        likeliest=likeliest,
        preference=f"{names}; of these, {why} is preferred" if len(equals) > 1 else "",
    )


def compose_variant(
    logs: Sequence[str], options: BuildOptions, variant: ScoredVariant
) -> tuple[str, ...]:
    """Compose the command line that builds the map of a variant from all scans."""
    if variant.update is not Update.POLYGON:
        options = replace(options, border_gap=BuildOptions.border_gap)
    if variant.update is Update.BEAM:  # which knows no surfaces
        options = replace(options, jump=BuildOptions.jump)
    return compose_build(logs, options, {"model": variant.model}, variant.update.value)


def refuse_unscored(logs: Sequence[str], held_out: int, beams: float) -> None:
    """Refuse to rank maps by nothing: so many held-out scans, whose beams measured so many ranges.

    Raises
    ------
    LogError
        No held-out beam measured a range.
    """
    if not beams:
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
