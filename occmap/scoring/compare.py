"""Several ways to map the same logs, in one read: which of them predicts scans best."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from occmap.command import compose_build
from occmap.errors import LogError
from occmap.observing import Progress, ignore_progress
from occmap.opening import count_scans
from occmap.options import DEFAULT_UPDATE, BuildOptions
from occmap.plain import Count, Finite, Printed, Share, list_printed
from occmap.readers import open_log
from occmap.remarks import Remarks, list_frames
from occmap.scoring.score import Score
from occmap.scoring.trials import SMALL, HoldOut, Result, Trials
from occmap.scoring.variants import Variant, shorten_model
from occmap.tally import ScanCounts, Tally, refuse_unused
from occmap.tracing import trace_logs
from occmap.types import Update
from occmap.wording import count

FEW_SCANS = 10
"""Fewer draws do not tell how far the next one may lie from them."""


@dataclass(frozen=True)
class HeldOutScans(ScanCounts):
    """What became of the scans."""

    held_out: Count
    """Scans that the maps are scored on and not made of"""


@dataclass(frozen=True, kw_only=True)
class Scored(Printed):
    """What is said of any run that scores maps on held-out scans."""

    logs: list[str]
    """Logs, as they were given"""
    scans: HeldOutScans
    """What became of the scans"""
    resolution: float
    """Side of a cell (m)"""
    notes: list[str]
    """What a user should know, one sentence each, as on stderr"""
    damage: list[str]
    """Those of the notes that tell of damage to a log"""


@dataclass(frozen=True, kw_only=True)
class PrintedVariant(Score):
    """One way to make the map, and how well that map predicts the held-out scans."""

    name: str
    """The update, the model, and its parameters that are not at their defaults"""
    update: Update
    """How scans became observations of cells"""
    model: str
    """Sensor model, as `model` takes it"""
    behind: Share
    """How much lower the share is than the best one"""
    behind_error: Finite
    """Standard error of that, from the differences scan by scan; null where one scan is all
    there is"""
    as_good: bool
    """The share is behind the best one by at most two standard errors, or half a percent"""
    columns: Count
    """Cells of the map from left to right (along x)"""
    rows: Count
    """Cells of the map from bottom to top (along y)"""
    seconds: float
    """Processor time to trace and render (s)"""
    bytes: Count
    """Size of the evidence in memory (bytes)"""


@dataclass(frozen=True, kw_only=True)
class PrintedComparison(Scored):
    """Updates and sensor models, scored on held-out scans: what occmap compare prints."""

    variants: list[PrintedVariant]
    """What was compared, the best share first"""
    best: str
    """Name of the variant to use: of those with as good a share as the best, the default, else
    that of the best log-likelihood"""
    command: tuple[str, ...]
    """The command line that builds its map from all scans, word by word"""
    likeliest: str
    """Name of the variant to use where probabilities matter: of those with as good a share as
    the best, that of the best log-likelihood"""
    likeliest_command: tuple[str, ...]
    """The command line that builds its map from all scans, word by word"""
    files: list[str]
    """Files that were written"""


@dataclass(frozen=True, eq=False, kw_only=True)
class VariantComparison(Scored):
    """What was compared, on what, and how it came out."""

    options: BuildOptions
    results: tuple[Result, ...]
    """The best share first"""
    files: Sequence[str] = ()
    """Files that were written"""

    @property
    def recommended(self) -> Result:
        """The one to use: the best, or, of those as good, the default one.

        Where that is not among them, their log-likelihood decides, which tells more than a share.
        """
        return self._find_default() or self.likeliest

    @property
    def likeliest(self) -> Result:
        """The one to use where probabilities matter: as good a share, the best log-likelihood."""
        best = max(self.equals, key=lambda each: each.score.log_likelihood)
        usual = self._find_default()
        if usual and best.score.log_likelihood - usual.score.log_likelihood < SMALL:
            return usual
        return best

    def _find_default(self) -> Result | None:
        """The variant of a bare build, where it is as good as the best."""
        usual = Variant(DEFAULT_UPDATE, BuildOptions().model)
        return next((each for each in self.equals if each.variant == usual), None)

    @property
    def equals(self) -> list[Result]:
        """The best one, and those whose share is as good."""
        return [each for each in self.results if each.as_good]

    @property
    def preference(self) -> str:
        """Which variants are as good, and why one is preferred; "" where there is only one."""
        if len(self.equals) == 1:
            return ""
        names = ", ".join(each.variant.name for each in self.equals)
        why = "the default" if self._find_default() else "the best log-likelihood"
        return f"{names}; of these, {why} is preferred"

    def build_command(self, result: Result) -> tuple[str, ...]:
        """Compose the command line that builds the map of a variant from all scans."""
        variant, options = result.variant, self.options
        if variant.update is not Update.POLYGON:
            options = replace(options, border_gap=BuildOptions.border_gap)
        if variant.update is Update.BEAM:  # which knows no surfaces
            options = replace(options, jump=BuildOptions.jump)
        chosen = {"model": shorten_model(variant.model)}
        return compose_build(self.logs, options, chosen, variant.update.value)

    def to_json(self) -> dict[str, Any]:
        """The comparison as values that JSON has."""
        return PrintedComparison(
            **{name: getattr(self, name) for name in list_printed(Scored)},
            variants=[describe_result(result) for result in self.results],
            best=self.recommended.variant.name,
            command=self.build_command(self.recommended),
            likeliest=self.likeliest.variant.name,
            likeliest_command=self.build_command(self.likeliest),
            files=list(self.files),
        ).to_json()


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
    tally = Tally()
    logs = [open_log(path, options.reading) for path in paths]
    total = sum(count_scans(log, options.selection.topics) for log in logs)
    remarks = Remarks([str(log.path) for log in logs])
    tally.tell = lambda scans: progress(scans, total)
    trials = Trials(variants, options)
    in_order = replace(options, jobs=1)  # which scans are held out must not be chance
    with trials.tracing() as workers:
        for log, notes in trace_logs(logs, in_order, partial(trials.begin, workers), tally):
            remarks.note(log.path, log.notes, notes)
    hold_out = trials.hold_out
    refuse_unused(paths, tally)
    refuse_unscored(remarks.logs, hold_out)
    remarks.notes += list_frames(tally)
    if hold_out.scans < FEW_SCANS:
        held_out = count(hold_out.scans, "held-out scan")
        remarks.notes.append(f"{held_out}: too few to tell variants apart; give a longer log")
    scans = HeldOutScans(**vars(tally.scans), held_out=hold_out.scans)
    results = tuple(trials.score())
    run = describe_run(remarks, options)
    return VariantComparison(**run, scans=scans, options=options, results=results)


def refuse_unscored(logs: Sequence[str], hold_out: HoldOut) -> None:
    """Refuse to rank maps by nothing.

    Raises
    ------
    LogError
        No held-out beam measured a range.
    """
    if not hold_out.hits:
        raise LogError(
            f"no beam of the {hold_out.scans} scans held out for scoring measured a range",
            where=", ".join(logs),
            fix="give more scans: every fifth is held out",
        )


def describe_run(remarks: Remarks, options: BuildOptions) -> dict[str, Any]:
    """Say what maps were scored on, and what there is to know of that: fields of `Scored`."""
    return {
        "logs": remarks.logs,
        "resolution": options.resolution,
        "notes": remarks.notes,
        "damage": remarks.damage,
    }


SCORES = (
    *("variant", "share", "error", "log-likelihood", "entropy", "free", "occupied"),
    *("time (s)", "memory (MB)"),
)
"""What `list_scores` lists: `free` and `occupied` are the two parts of the entropy"""


def list_scores(result: Result) -> list[str]:
    """Write the scores of a variant as a row of a table, whose columns are SCORES."""
    score = result.score
    return [
        result.variant.name,
        f"{score.share:.4f}",
        f"{score.share_error:.4f}" if math.isfinite(score.share_error) else "-",
        f"{score.log_likelihood:.3f}",
        f"{score.cross_entropy:.3f}",
        f"{score.free_cost:.3f}",
        f"{score.occupied_cost:.3f}",
        f"{result.seconds:.2f}",
        f"{result.bytes / 1e6:.1f}",
    ]


def describe_result(result: Result) -> PrintedVariant:
    """Give one variant in the form that is printed."""
    rows, columns = result.map.shape
    return PrintedVariant(
        **vars(result.score),
        name=result.variant.name,
        update=result.variant.update,
        model=shorten_model(result.variant.model),
        behind=result.behind,
        behind_error=result.behind_error,
        as_good=result.as_good,
        columns=columns,
        rows=rows,
        seconds=round(result.seconds, 4),
        bytes=result.bytes,
    )
