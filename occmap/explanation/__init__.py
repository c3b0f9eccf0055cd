"""Why a cell is what it is: what evidence holds of it, and which scans made it so."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from occmap import evidence
from occmap.cells import Box, Evidence, Manifest, OccupancyMap, Slices
from occmap.choices import option
from occmap.errors import UsageError, require
from occmap.evidence.manifest import list_doubts
from occmap.explanation import history
from occmap.explanation.history import Cell, Numbers, Seen, Sighting, Use, Visits
from occmap.grid import Lattice
from occmap.grid.tiles import LOG_ODDS_UNIT, EvidenceKind, find_unit, unite
from occmap.report import Count, Printed, Share, count, join_names, printed_as
from occmap.scans.tracing import Progress, ignore_progress
from occmap.sensor.models import MODEL, SensorModel, describe_model
from occmap.store import Saved, as_blocks, read_part
from occmap.store.painting import open_map
from occmap.types import Update
from occmap.writers import WriteOptions


@dataclass(frozen=True)
class Question:
    """Which cell a user asks about, and how it is judged."""

    x: float
    y: float
    """A point in the map frame (m)"""
    logs: tuple[Path, ...] = ()
    """The logs whose scans are looked for; none: only the evidence is asked"""
    poses: tuple[Path, ...] = ()
    """The trajectory files of the builds that had one"""
    model: SensorModel | None = option(None, form=MODEL)
    """None: the one that the evidence was built with"""
    min_passes: int | None = None
    """The cell keeps its hits only if they came on so many visits; None: it keeps all"""
    writing: WriteOptions = field(default_factory=WriteOptions)
    """Its thresholds decide what the cell is called"""

    def __post_init__(self) -> None:
        is_of_logs = bool(self.logs) or not self.poses
        require(is_of_logs, "`poses` goes with a log", "add `logs=LOG`, or leave it out")


@dataclass(frozen=True, kw_only=True)
class BuildVisits(Visits):
    """When one build observed the cell."""

    build: Count
    """Which build of the evidence, counted from 0 as in the manifest"""
    logs: list[str]
    """The names of its logs"""


Verdict = Literal["occupied", "free", "undecided", "unknown"]


@dataclass(frozen=True, kw_only=True)
class Explanation(Printed):
    """What was seen at a point, and by which scans: what occmap explain prints."""

    point: tuple[float, float]
    """x and y that were asked for (m)"""
    cell: Cell
    """The cell that holds the point"""
    map_extent: Box | None
    """Lowest x and y, highest x and y of all observed cells (m); null where there are none"""
    verdict: Verdict = field(metadata=printed_as("class"))
    """What the cell is; unknown is what nothing observed, undecided what is neither occupied nor
    free"""
    probability: Share
    """How much the cell is thought to be occupied, from 0 to 1; the prior where it is
    unknown"""
    model: str
    """The sensor model that says so, with its parameters"""
    unit: Count
    """What one observation counts in hits, misses, log_odds and observations: divide these by
    it"""
    seen: Seen
    """What observed the cell"""
    kept: Seen | None
    """What of that makes the class, where `min_passes` forgets hits, or misses beside lasting hits;
    null where nobody asked"""
    ground: float | None
    """How high the ground is at the point (m); null where no points of clouds showed it"""
    around: list[list[Seen]]
    """What observed the cell, in the middle, and its neighbours: rows by falling y, in them
    cells by rising x"""
    min_passes: Count | None
    """On how many visits the cell has to be hit to keep its hits (`min_passes`); null where
    nobody asked"""
    visits: Visits | None
    """When all builds together observed the cell; null where nothing did"""
    builds: tuple[BuildVisits, ...]
    """The builds that observed the cell"""
    scans_used: Count
    """Scans of the logs given that their builds used"""
    scans: tuple[Sighting, ...]
    """Those of them that observed the cell, by time"""
    notes: tuple[str, ...]
    """What else to know of the evidence, and what the scans leave unexplained"""


def explain(saved: Saved, question: Question, progress: Progress = ignore_progress) -> Explanation:
    """Say what was observed at a point, and by which scans of the logs that the user has.

    Raises
    ------
    OccmapError
        The point is in no map, the model cannot read the evidence, a log cannot be read or is none
        that the evidence was made of, or a trajectory is missing.
    """
    model = evidence.choose_model_for(saved, question.model, question.min_passes)
    if question.logs and saved.manifest.update == Update.CLOUD:
        found = "evidence of clouds does not say which of them observed a cell"
        raise UsageError(found, where=saved.where, fix="leave out `logs`")
    cell = Cell.find(Lattice(saved.manifest.resolution), question.x, question.y)
    # All that is in memory, or the tile that holds the point and those beside it.
    part = read_part(saved, cell.box)
    manifest, grid = part.manifest, evidence.to_grid(part)
    around = cell.read_around(grid)
    layers = cell.read_slices(part)
    lasting = evidence.keep_lasting(grid, part.slices, question.min_passes)
    made, blocks = evidence.paint_box(lasting, model, cell.box), as_blocks(saved)
    uses = history.find_uses(part, question.logs, question.poses)
    sightings, scans_used = history.find_sightings(uses, cell, progress)
    return Explanation(
        point=(question.x, question.y),
        cell=cell,
        map_extent=open_map(blocks, model).extent if blocks.blocks else None,
        verdict=name_class(made, question.writing),
        probability=float(made.probability[0, 0]),
        model=describe_model(model),
        unit=find_unit(manifest.update),
        seen=around[1][1],
        kept=cell.read_around(lasting)[1][1] if question.min_passes else None,
        ground=measure_ground(saved, question),
        around=around,
        min_passes=question.min_passes,
        visits=cell.read_visits(unite(layers), manifest),
        builds=tuple(list_visits(cell, layers, manifest)),
        scans_used=scans_used,
        scans=tuple(sightings),
        notes=(*list_doubts(manifest), *list_unexplained(part, around[1][1], uses, sightings)),
    )


def list_visits(cell: Cell, layers: Sequence[Slices], manifest: Manifest) -> Iterator[BuildVisits]:
    """List when each build observed the cell, of those that did."""
    for at, (layer, build) in enumerate(zip(layers, manifest.builds, strict=True)):
        if visits := cell.read_visits(layer, manifest):
            yield BuildVisits(**vars(visits), build=at, logs=history.list_logs(build))


def name_class(made: OccupancyMap, writing: WriteOptions) -> Verdict:
    """Name what the one cell of a map is."""
    decided = replace(made, decision=writing.decide(made.decision))
    if decided.occupied.all():
        return "occupied"
    if decided.free.all():
        return "free"
    return "undecided" if made.observed.all() else "unknown"


def measure_ground(saved: Saved, question: Question) -> float | None:
    """How high the ground is at the point (m), as clouds showed it; None where they did not."""
    if saved.ground is None:
        return None
    (height,) = saved.ground.find_heights(np.array([[question.x, question.y]])).tolist()
    return None if math.isnan(height) else height


def list_unexplained(
    part: Evidence, seen: Seen, uses: Sequence[Use], sightings: Sequence[Sighting]
) -> Iterator[str]:
    """Say what is not explained by the scans that were found."""
    found, manifest = history.add_up(sightings), part.manifest
    if not uses or found == seen.numbers:
        return
    unit = find_unit(manifest.update)
    parts = (describe_numbers(each, seen.kind, unit) for each in (found, seen.numbers))
    sums = " of ".join(parts)
    if missing := history.list_missing(part, uses):
        yield f"these logs explain {sums}; the rest is in {join_names(missing)}"
    elif manifest.subtracted:
        yield f"the scans explain {sums}; other evidence was subtracted"
    elif any("moved" in build for build in manifest.builds):
        yield f"the scans explain {sums}; `occmap merge` moved cells of it, not scans"
    else:
        makers = ", ".join(sorted({build["occmap"] for build in manifest.builds}))
        yield f"the scans explain {sums}: the occmap that built it ({makers}) read them differently"


def describe_numbers(numbers: Numbers, kind: EvidenceKind, unit: int) -> str:
    """Spell out the two numbers of a cell, in observations."""
    first, second = (each / unit for each in numbers)
    if kind is EvidenceKind.LOG_ODDS:
        return f"log-odds {first * LOG_ODDS_UNIT:.3f} of {count(second, 'observation')}"
    return f"{count(first, 'hit')} and {count(second, 'miss')}"
