"""What a build did: numbers for programs, rows that a terminal and a page lay out, and doubts."""

import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from occmap.cells import Box, Evidence, Manifest, OccupancyMap
from occmap.evidence import list_contradictions
from occmap.options import BuildOptions, choose_model, compose_build
from occmap.report import HIDDEN, Count, Noted, Row, Share, count, write_box, write_counts
from occmap.scans.mounts import list_misfits
from occmap.scans.tally import NO_LOSS, NOT_ASKED_FOR, ScanCounts, Tally, advise_on_dropped
from occmap.sensor import ReturnCounts
from occmap.sensor.models import SensorModel, find_decision, parse_model, shorten_model
from occmap.types import Int64, Paths, Trajectory, Update
from occmap.writers import MapMode, WriteOptions, find_writer, list_idle

LEAST_AGREEMENT = 0.55
"""At 5 cm, logs with sound poses reach 0.68 to 0.94, raw odometry 0.72; noise of 10 cm in the poses
of the same logs leaves 0.27 to 0.56."""
DOUBTFUL_AGREEMENT = 0.78
"""Logs with corrected poses reach 0.80 to 0.87 at 5 cm. Those with odometry, below this, have walls
that are doubled here and there, and `tune` takes a floor from 0.72 to 0.85."""


@dataclass(frozen=True)
class Resumed:
    """The evidence that a build was added to."""

    file: str
    """The evidence file"""
    read: Count
    """Scans that its builds read"""
    used: Count
    """Scans that its builds used"""


class MapFacts(NamedTuple):
    """What is measured of a map for its report."""

    resolution: float
    """Side of a cell, or of a pixel of an overview (m)"""
    extent: Box
    shape: tuple[int, int]
    """Rows and columns"""
    counts: Int64
    """(4,) as `count_cells` gives them"""
    agreement: float | None
    lost: Sequence[str] = ()
    """What there is to say of cells that do not last"""
    steady: tuple[int, int] = (0, 0)
    """Of clouds, as `count_steady` counts their hits"""


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
    """Share of hits, also of those that `min_passes` takes away, that lie in cells called
    occupied: low where poses are wrong; null where hits are not kept"""

    @property
    def cells(self) -> int:
        """How many there are."""
        return self.columns * self.rows

    @property
    def area(self) -> float:
        """Area of the cells that are not unknown (m²)."""
        return self.cells * (1 - self.unknown) * self.resolution**2

    @classmethod
    def describe(cls, facts: MapFacts, manifest: Manifest, min_passes: int | None) -> Self:
        """Sum up a map of evidence."""
        rows, columns = facts.shape
        cells = rows * columns
        observed, occupied, free, _ = facts.counts.tolist()
        return cls(
            update=Update(manifest.update),
            model=manifest.model,
            min_passes=min_passes,
            resolution=facts.resolution,
            columns=columns,
            rows=rows,
            extent=facts.extent,
            align=manifest.align or 0.0,
            occupied=occupied / cells,
            free=free / cells,
            unknown=(cells - observed) / cells,
            undecided=(observed - occupied - free) / cells,
            agreement=facts.agreement,
        )


@dataclass(frozen=True, kw_only=True)
class Report(Noted):
    """A map and how it came about: what occmap build, render and merge print."""

    logs: tuple[str, ...]
    """Logs of the map: as they were given, or, where it is made of evidence, by the names of their
    files"""
    scans: ScanCounts
    """What became of the scans"""
    builds: Count = 1
    """How many builds the logs, scans and beams are of: more than one in evidence that was
    merged"""
    resumed: Resumed | None = None
    """The evidence that the build was added to (`resume`), whose scans and beams are not counted
    here; null where there is none"""
    beams: ReturnCounts
    """How many beams of the used scans were read as what"""
    points: dict[str, Count] = field(default_factory=dict)
    """What became of the points of clouds, by kind; empty where there are none, or where no log
    was read"""
    map: MapSummary
    """The map"""
    notes: tuple[str, ...]
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = field(init=False)
    """Those of the notes that tell of damage to a log"""
    files: tuple[str, ...] = ()
    """Files that were written"""
    seconds: dict[str, float] = field(default_factory=dict)
    """Time by stage (s); where threads work at the same time, their times add up; empty where no
    log was read"""
    hint: str = field(default="", metadata=HIDDEN)
    """What to try where scans fit each other poorly; empty where nothing need be wrong"""

    @property
    def beam_shares(self) -> dict[str, float]:
        """Which shares of the beams hit something, and met nothing; none where it is on clouds."""
        total = max(sum(self.beams), 1)
        shares = {"hits": self.beams.hit / total, "no_return": self.beams.no_return / total}
        return {} if self.map.update is Update.CLOUD else shares


class Build(NamedTuple):
    """A map and how it came about."""

    map: OccupancyMap
    """Maybe a `BlockMap`, where no output needs the whole of a large one"""
    report: Report
    evidence: Evidence
    """What the map was made of; it has slices of time only where an output or an option needs it"""


def count_cells(grid: OccupancyMap, writing: WriteOptions) -> Int64:
    """(4,) cells that are observed; that are occupied, and free, as they are written; and walls.

    These are the cells that the map itself calls occupied.
    """
    written = replace(grid, decision=writing.decide(grid.decision))
    masks = written.observed, written.occupied, written.free, grid.occupied
    return np.array([np.count_nonzero(mask) for mask in masks])


MEASURED_WITH = {"resolution", "update", "hit_offset", "jump", "no_return", "min_passes"}
"""What the bounds of the agreement hold for: these options as they are by default, and the model"""
MOST_NAMED = 3
"""Logs that a command in a sentence names"""


def hint_at_tune(agreement: float | None, logs: Sequence[str], options: BuildOptions) -> str:
    """What to try where the agreement is poor, though it may be as good as it gets; else empty.

    It is for poses that were looked up by time: those beside scans were corrected with these. It
    stands beside the number and not among the notes, as nothing need be wrong. Where the agreement
    is poorer still, a note says more.
    """
    is_usual = MEASURED_WITH.isdisjoint(options.list_changed())
    is_poor = agreement is not None and LEAST_AGREEMENT <= agreement < DOUBTFUL_AGREEMENT
    if not is_poor or not is_usual or options.model != choose_model(options.update):
        return ""
    words = compose_build(logs[:MOST_NAMED], options, ())[2:-2]
    named = shlex.join(words) + " ..." * (len(logs) > MOST_NAMED)
    return f"; walls may be doubled: `occmap tune {named}` looks for a wrong clock or mount"


def tell_map(grid: MapSummary, hint: str = "") -> Iterator[Row]:
    """Say how large a map is, what its cells are, how well scans fit it, and how it was made."""
    size = f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m"
    turned = f", turned by {grid.align:g} degrees" if grid.align else ""
    yield "map", f"{size}, {write_box(grid.extent)}{turned}"
    # Between occupied and free there may be undecided cells.
    shares = {name: getattr(grid, name) for name in ("occupied", "free", "unknown", "undecided")}
    told = [name for name, share in shares.items() if share > 5e-4 or name == "occupied"]
    yield "cells", ", ".join(f"{shares[name]:.1%} {name}" for name in told)
    if grid.agreement is not None:
        yield "agree", f"{grid.agreement:.1%} of the hits lie in occupied cells{hint}"
    passes = "" if grid.min_passes is None else f", hits of {grid.min_passes} visits or more"
    yield "update", f"{grid.update}, model {shorten_model(parse_model(grid.model))}{passes}"


def tell_scans(report: Report) -> list[Row]:
    """Say how many scans were used, what they were added to, and why others were not used."""
    used = f"{report.scans.used:,} of {report.scans.read:,} used"
    if report.resumed:
        past = f"{report.resumed.used:,} of {report.resumed.read:,}"
        used = f"{used}, added to {past} in {report.resumed.file}"
    elif report.builds > 1:
        if report.scans.wanted < report.scans.read:  # most leave out what is in another one
            used = f"{report.scans.used:,} used of {report.scans.wanted:,} asked for"
        used = f"{used}, in {count(report.builds, 'build')}"
    # What one build left out on purpose may well be in another one.
    chosen = NOT_ASKED_FOR if report.builds > 1 else ()
    reasons = report.scans.dropped.items()
    dropped = write_counts({reason: scans for reason, scans in reasons if reason not in chosen})
    return [("scans", used), *([("dropped", dropped)] if dropped else [])]


def tell_beams(report: Report) -> Iterator[Row]:
    """Say what the beams of the used scans meant, and what became of the points of clouds."""
    if report.points:
        yield "points", f"{sum(report.points.values()):,}: {write_counts(report.points)}"
    elif report.map.update is not Update.CLOUD:
        yield "beams", f"{sum(report.beams):,}: {write_counts(report.beams.by_name)}"


MOST_DROPPED = 0.5
"""Where more of the scans that were asked for are not used, hardly anybody wants the map"""
LEAST_OBSTACLES = 0.001
"""Of all points of clouds; with fewer in the robot's band, the band is hardly meant"""
NEAR_DEGREES = 0.05
"""Edits of which every corner is so near to the map's longitude and latitude are hardly metres"""


def list_notes(
    options: BuildOptions, outputs: Paths, tally: Tally, facts: MapFacts
) -> Iterator[str]:
    """Say what a user should know of the options, the logs and the map of a build."""
    yield from list_contradictions(facts.steady, tally.points)
    yield from list_idle(outputs, options.writing)
    yield from list_unwritten(facts, options.model, options.writing, outputs)
    yield from list_shared_stamps(outputs, tally.trajectories)
    yield from options.list_idle()
    if options.resume_if_there and not options.resume_if_there.exists():
        yield f"{options.resume_if_there}: no such file, so this build adds to nothing"
    scans = tally.scans
    if scans.dropped_share > MOST_DROPPED:
        lost = {why: many for why, many in scans.dropped.items() if why not in NO_LOSS}
        yield f"most scans are left out: {write_counts(lost)}; {advise_on_dropped(lost)}"
    yield from doubt_frames(tally.frames)
    # Evidence that the logs are added to may have walls; clouds have no beams.
    if not tally.beams.hit and options.update is not Update.CLOUD:
        _, occupied, *_ = facts.counts
        lack = "of the logs hit anything" if occupied else "hit anything, so the map has no walls"
        yield f"no beam {lack}: see the ranges in `occmap check`"
    yield from list_odd_points(tally.points)
    misfits = list(list_misfits(options, facts.agreement, tally))
    yield from misfits or list_disagreement(facts, options.min_passes, tally.looked_up)


def list_shared_stamps(outputs: Paths, ways: Sequence[Trajectory]) -> Iterator[str]:
    """Say which trajectories that are written do not build the same map again."""
    written = ", ".join(str(path) for path in outputs if find_writer(path).needs_journey)
    for way in ways if written else ():
        order = np.argsort(way.stamp_ns, kind="stable")
        is_same, moves = np.diff(way.stamp_ns[order]) == 0, np.diff(way.pose[order], axis=0)
        if shared := int(np.count_nonzero(is_same & moves.any(axis=1))):
            yield (
                f"{written}: {count(shared, 'scan')} of {way.topic} in {way.log} have the stamp of "
                "the one before and another pose, so with `poses=FILE` this builds another map"
            )


def list_odd_points(points: Mapping[str, int]) -> Iterator[str]:
    """Say where hardly a point of clouds lies in the robot's band."""
    if points and points["obstacle"] < LEAST_OBSTACLES * sum(points.values()):
        yield (
            f"hardly a point lies in the robot's band: {points['obstacle']:,} of "
            f"{sum(points.values()):,}; see `min_height`, `max_height` and the line `points`"
        )


def doubt_frames(frames: Mapping[str, str | None]) -> Iterator[str]:
    """Say what to do about logs that are mapped in frames of different names."""
    if apart := name_frames(frames):
        fix = "choose one with `map_frame`, or build each log alone with its own `transform`"
        yield f"{apart}; where these do not lie on each other, {fix} and merge them"


def name_frames(frames: Mapping[str, str | None]) -> str:
    """Say that logs are mapped in frames of different names, which may lie anywhere; else "".

    Parameters
    ----------
    frames
        By log; None where its poses are stated, in no frame.
    """
    first: dict[str, str] = {}
    for log, frame in frames.items():
        if frame:
            first.setdefault(frame, log)
    named = ", ".join(f"{log} in {frame}" for frame, log in first.items())
    return f"the logs are mapped in different frames: {named}" if len(first) > 1 else ""


def doubt_agreement(agreement: float | None, hits: str = "the hits") -> str:
    """Say that scans contradict each other, if they do: how few of `hits` agree; else empty."""
    is_low = agreement is not None and agreement < LEAST_AGREEMENT
    return f"only {agreement:.0%} of {hits} lie in occupied cells" if is_low else ""


def list_disagreement(facts: MapFacts, min_passes: int | None, timed: bool = True) -> Iterator[str]:
    """Say that the scans of a map contradict each other; without walls none of its hits agrees.

    Times matter only where poses were looked up by them, and so are `timed`.
    """
    if facts.agreement and (doubt := doubt_agreement(facts.agreement)):
        tune = "`occmap tune` or " if timed else ""
        less = ", or `min_passes` takes away what they hit" if min_passes else ""
        fix = f"see `occmap check`, try {tune}another trajectory by `poses=FILE`"
        yield f"{doubt}: the poses do not fit the scans{less}; {fix}"


def list_unwritten(
    facts: MapFacts, model: SensorModel, writing: WriteOptions, outputs: Paths
) -> Iterator[str]:
    """Say what loaders do not find: edits, walls by the YAML's own thresholds, and the unknown."""
    yield from list_vain_edits(facts, writing)
    observed, occupied, _, walls = facts.counts.tolist()
    unknown = math.prod(facts.shape) - observed
    is_pgm = any(re.search(r"(?<!\.keepout)\.pgm$", path.name.lower()) for path in outputs)
    if writing.mode is MapMode.SCALE and is_pgm and unknown:
        yield (
            f"`mode=scale`: nav2 loads the {count(unknown, 'unknown cell')} of a .pgm as a "
            "probability of 0.5; `mode=trinary` and `mode=raw` tell them apart"
        )
    is_left_to_yaml = writing.mode is not MapMode.TRINARY and writing.occupied_thresh is None
    if is_left_to_yaml and occupied < walls:
        # Rounded down, so that it leaves out none of them.
        cut = math.floor(1e5 * find_decision(model).occupied_above) / 1e5
        free, limit = writing.thresholds
        lower = f" and `free_thresh={max(cut - 0.01, cut / 2):.5g}`" * (cut < free + 0.01)
        yield (
            f"`mode={writing.mode}`: {walls - occupied:,} of the {walls:,} cells that count as "
            f"occupied for `agree` are not by the occupied_thresh that is written, {limit:g}; with "
            f"`occupied_thresh={cut:.5g}`{lower} all are"
        )


def list_vain_edits(facts: MapFacts, writing: WriteOptions) -> Iterator[str]:
    """Say that the user's edits hold no shape, or degrees, or some that change no cell of a map."""
    if writing.edits and not writing.shapes:
        yield f"{writing.edits}: holds no shape, so it edits nothing"
    if writing.georeference and writing.shapes:
        latitude, longitude, _ = writing.georeference
        corners = np.concatenate([ring for each in writing.shapes for ring in each.rings])
        if (np.abs(corners - (longitude, latitude)) < NEAR_DEGREES).all():
            beside = "all corners are near the longitude and latitude of the map's zero"
            yield f"{writing.edits}: {beside}: if they are degrees, write metres of the map"
    map_low, map_high = np.reshape(facts.extent, (2, 2))
    vain = []
    for shape in writing.shapes:
        low, high = shape.measure(facts.resolution)
        # The first and the last cell of the map whose middle may be inside
        first = np.ceil(np.maximum(low, map_low) / facts.resolution - 0.5)
        last = np.floor(np.minimum(high, map_high) / facts.resolution - 0.5)
        if (first > last).any():
            vain.append([*low.round(3), *high.round(3)])
    if vain:
        lie = f"{count(len(vain), 'shape')} outside of the map, or between the middles of cells"
        at = "at" if len(vain) == 1 else "the first at"
        yield f"{writing.edits}: without effect: {lie}: {at} {write_box(vain[0])}"
