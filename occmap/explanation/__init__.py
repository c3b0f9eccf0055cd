"""Why a cell is what it is: what evidence holds of it, and which scans made it so."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from occmap.errors import UsageError
from occmap.evidence import choose_tiles, read_model, refuse_other_profile, to_grid, weigh
from occmap.evidence.manifest import list_doubts
from occmap.evidence.persistence import check_passes, keep_lasting
from occmap.explanation.history import CellHistory, Numbers, Seen, find_cell, look_at
from occmap.explanation.printed import (
    BuildVisits,
    PrintedExplanation,
)
from occmap.explanation.provenance import Use, find_uses, list_logs, list_missing, shorten
from occmap.explanation.sightings import Sighting, add_up, find_sightings
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.rendering import measure_bounds
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind
from occmap.observing import Progress, ignore_progress
from occmap.plain import to_plain
from occmap.sensor.models import SensorModel, describe_model, find_decision
from occmap.store.reading import Store
from occmap.store.rendering import View, find_bounds
from occmap.store.sources import Saved, read_part
from occmap.types import Box, Evidence, OccupancyMap, to_log_odds
from occmap.wording import count
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
    model: SensorModel | None = None
    """None: the one that the evidence was built with"""
    min_passes: int | None = None
    """The cell keeps its hits only if they came on so many visits; None: it keeps all"""
    writing: WriteOptions = field(default_factory=WriteOptions)
    """Its thresholds decide what the cell is called"""


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found out about a cell."""

    question: Question
    history: CellHistory
    model: str
    cell: OccupancyMap
    """The map of this one cell; not observed where `min_passes` leaves nothing"""
    builds: tuple[BuildVisits, ...]
    """Those that observed the cell"""
    extent: Box | None
    """Of all observed cells: lowest x and y, highest x and y (m); None: there are none"""
    digest: str | None
    """SHA-256 of all that a store holds; None for a file, which is not read for it"""
    scans_used: int = 0
    """Scans of the logs that were looked through: those that their builds used"""
    sightings: tuple[Sighting, ...] = ()
    """By time; those scans of the logs that observed the cell"""
    notes: tuple[str, ...] = ()

    @property
    def probability(self) -> float:
        """The probability that the cell is occupied."""
        return float(self.cell.probability[0, 0])

    @property
    def verdict(self) -> Literal["occupied", "free", "undecided", "unknown"]:
        """Occupied, free, undecided, or unknown."""
        if not self.cell.observed.all():
            return "unknown"
        written = self.question.writing.decide(self.cell.decision)
        decided = replace(self.cell, decision=written)
        if decided.occupied.all():
            return "occupied"
        return "free" if decided.free.all() else "undecided"

    def to_json(self) -> dict[str, Any]:
        """The explanation as values that JSON has."""
        history, kind = self.history, self.history.kind
        rows = history.around.tolist()
        around = [[Seen.read((a, b), kind) for a, b in row] for row in rows]
        printed: PrintedExplanation = {
            "point": (self.question.x, self.question.y),
            "cell": {"row": history.row, "column": history.col, "extent": history.extent},
            "digest": self.digest,
            "map_extent": self.extent,
            "class_": self.verdict,
            "probability": self.probability,
            "model": self.model,
            "unit": history.unit,
            "seen": Seen.read((history.first, history.second), kind),
            "around": around[::-1],
            "min_passes": self.question.min_passes,
            "visits": history.visits,
            "builds": self.builds,
            "scans_used": self.scans_used,
            "scans": self.sightings,
            "notes": list(self.notes),
        }
        plain: dict[str, Any] = to_plain(printed)
        return plain


def explain(saved: Saved, question: Question, progress: Progress = ignore_progress) -> Explanation:
    """Say what was observed at a point, and by which scans of the logs that the user has.

    Raises
    ------
    OccmapError
        The point is in no map, the model cannot read the evidence, a log cannot be read or is none
        that the evidence was made of, or a trajectory is missing.
    """
    model = question.model or read_model(saved)
    refuse_other_profile(saved, model)
    check_passes(question.min_passes, model)
    if question.poses and not question.logs:
        raise UsageError("`poses` goes with a log", fix="add `logs=LOG`, or leave it out")
    evidence = read_around(saved, question.x, question.y)
    history = look_at(evidence, question.x, question.y)
    uses = find_uses(evidence, question.logs, question.poses)
    sightings, scans_used = find_sightings(uses, history, progress)
    builds = evidence.manifest.builds
    return Explanation(
        question,
        history,
        describe_model(model),
        judge_cell(evidence, history, model, question.min_passes),
        tuple(
            BuildVisits(**vars(visits), build=index, logs=list_logs(build))
            for index, (visits, build) in enumerate(zip(history.builds, builds, strict=True))
            if visits is not None
        ),
        measure_extent(saved, model),
        saved.digest if isinstance(saved, Store) else None,
        scans_used,
        tuple(sorted(sightings, key=lambda each: each.stamp_ns)),
        (
            *list_doubts(evidence.manifest),
            *(list_unexplained(evidence, history, uses, sightings) if uses else ()),
        ),
    )


def judge_cell(
    evidence: Evidence, history: CellHistory, model: SensorModel, min_passes: int | None
) -> OccupancyMap:
    """Make a map of the one cell."""
    lasting = keep_lasting(to_grid(evidence), evidence.slices, min_passes)
    tiles = choose_tiles(lasting, model)
    key = history.row // TILE, history.col // TILE
    row, col = history.row % TILE, history.col % TILE
    numbers = tiles.read(key) if key in tiles.keys else np.zeros((2, TILE, TILE))
    first, second = (each[row : row + 1, col : col + 1] for each in numbers)
    observed = tiles.observed(first, second)
    log_odds = np.full((1, 1), to_log_odds(model.prior))
    log_odds[observed] = weigh(model)(first[observed], second[observed])
    low_x, low_y, high_x, _ = history.extent
    place = high_x - low_x, (low_x, low_y)
    return OccupancyMap(log_odds.astype(np.float32), observed, *place, find_decision(model))


def measure_extent(saved: Saved, model: SensorModel) -> Box | None:
    """Lowest x and y, highest x and y of the map that a model makes (m); None: of nothing."""
    if isinstance(saved, Evidence):
        box = measure_bounds(choose_tiles(to_grid(saved), model))
    else:
        box = find_bounds(View(saved, model)) if saved.blocks else None
    lattice = Lattice(saved.manifest.resolution)
    if box is None:
        return None
    low_x, low_y, high_x, high_y = map(
        lattice.to_metres, (box.col, box.row, box.col_end, box.row_end)
    )
    return low_x, low_y, high_x, high_y


def read_around(saved: Saved, x: float, y: float) -> Evidence:
    """Read the tile that holds a point (m) and those beside it, or all that is in memory.

    Raises
    ------
    UsageError
        No map reaches so far.
    """
    row, col = find_cell(Lattice(saved.manifest.resolution), x, y)
    return read_part(saved, CellBox(row, col, row + 1, col + 1))


def list_unexplained(
    evidence: Evidence, history: CellHistory, uses: Sequence[Use], sightings: Sequence[Sighting]
) -> Iterator[str]:
    """Say what is not explained by the scans that were found."""
    found = add_up(sightings)
    held = history.first, history.second
    if found == held:
        return
    sums = f"{describe_numbers(found, history)} of {describe_numbers(held, history)}"
    missing = list_missing(evidence, uses)
    if missing:
        yield f"these logs explain {sums}; the rest is in {shorten(missing)}"
    elif evidence.manifest.subtracted:
        yield f"the scans explain {sums}; other evidence was subtracted"
    else:
        makers = ", ".join(sorted({build["occmap"] for build in evidence.manifest.builds}))
        yield f"the scans explain {sums}: the occmap that built it ({makers}) read them otherwise"


def describe_numbers(numbers: Numbers, history: CellHistory) -> str:
    """Spell out the two numbers of a cell, in observations."""
    first, second = (each / history.unit for each in numbers)
    if history.kind is EvidenceKind.LOG_ODDS:
        return f"log-odds {first * LOG_ODDS_UNIT:.3f} of {count(second, 'observation')}"
    return f"{count(first, 'hit')} and {count(second, 'miss')}"
