"""What evidence holds at one point, and which scans hit the cell there or cleared it.

Each scan is traced once more, as its build traced it.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from occmap.cells import Box, Evidence, Manifest, Slices
from occmap.errors import UsageError
from occmap.explanation.provenance import Use
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.slices import count_visits, take, unite, unpack
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind, find_unit
from occmap.options import BuildOptions
from occmap.readers import Log, open_log
from occmap.report.printed import Count
from occmap.scans.engines import plan_grid
from occmap.scans.logs import count_scans
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally
from occmap.scans.tracing import Progress
from occmap.sensor.returns import interpret
from occmap.types import Int64, PosedScans

FARTHEST_CELL = 1 << 44
"""Beyond this a float cannot tell the parts of a cell apart."""

Numbers = tuple[int, int]
"""Hits and misses, or log-odds in units of 1/65536 and observations"""


@dataclass(frozen=True)
class Seen:
    """What observed a cell."""

    hits: Count | None
    """Hits; null for evidence in log-odds"""
    misses: Count | None
    """Misses; null for evidence in log-odds"""
    log_odds: float | None
    """Sum of log-odds (natural logarithm); null for evidence in counts"""
    observations: Count
    """Observations: hits and misses, or those that the sum is of"""

    @classmethod
    def read(cls, numbers: Iterable[int], kind: EvidenceKind) -> Self:
        """Read the two numbers of a cell."""
        first, second = numbers
        if kind is EvidenceKind.LOG_ODDS:
            return cls(None, None, first * LOG_ODDS_UNIT, second)
        return cls(first, second, None, first + second)

    @property
    def kind(self) -> EvidenceKind:
        """What the two numbers of the cell are."""
        return EvidenceKind.COUNTS if self.log_odds is None else EvidenceKind.LOG_ODDS

    @property
    def numbers(self) -> Numbers:
        """The two numbers of the cell."""
        if self.log_odds is not None:
            return round(self.log_odds / LOG_ODDS_UNIT), self.observations
        return self.hits or 0, self.misses or 0


@dataclass(frozen=True)
class Visits:
    """When a cell was observed."""

    since_ns: int
    """When the first slice of time (`pass_gap_s`) begins in which the cell was observed (ns)"""
    until_ns: int
    """When the last slice of time ends in which the cell was observed (ns)"""
    hit_visits: Count | None
    """Visits that hit the cell; null for evidence in log-odds"""
    seen_visits: Count
    """Visits that observed the cell"""


@dataclass(frozen=True)
class Cell:
    """A cell of the map."""

    row: int
    """Row of the cell in the lattice: floor(y / resolution)"""
    column: int
    """Column of the cell in the lattice: floor(x / resolution)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""


@dataclass(frozen=True)
class CellHistory:
    """What was observed in one cell."""

    cell: Cell
    unit: int
    """What one beam, or one scan, adds to a number"""
    around: list[list[Seen]]
    """What observed the cell, in the middle, and its neighbours: 3 rows by falling y, in them 3
    cells by rising x"""
    visits: Visits | None
    """When all builds together observed the cell; None where nothing did"""
    builds: tuple[Visits | None, ...]
    """For each of the manifest's builds; None where it did not observe the cell"""

    @property
    def seen(self) -> Seen:
        """What observed the cell."""
        return self.around[1][1]


def look_at(evidence: Evidence, x: float, y: float) -> CellHistory:
    """Look up the cell that holds a point (m); one that is not in the map has zeros.

    Raises
    ------
    UsageError
        No map reaches so far.
    """
    lattice = Lattice(evidence.manifest.resolution)
    row, col = find_cell(lattice, x, y)
    tile = row // TILE, col // TILE
    layers = [
        take(layer, np.flatnonzero((layer.tiles == tile).all(axis=1))) for layer in evidence.slices
    ]
    return CellHistory(
        Cell(row, col, lattice.measure(CellBox.at(row, col))),
        unit=find_unit(evidence.manifest.update),
        around=[
            [read_cell(evidence, row + up, col + right) for right in (-1, 0, 1)]
            for up in (1, 0, -1)
        ],
        visits=read_visits(unite(layers), (row, col), evidence.manifest),
        builds=tuple(read_visits(layer, (row, col), evidence.manifest) for layer in layers),
    )


def find_cell(lattice: Lattice, x: float, y: float) -> tuple[int, int]:
    """Row and column of the cell that holds a point (m).

    Raises
    ------
    UsageError
        It is too far away, or not finite.
    """
    farthest = max(abs(x), abs(y)) / lattice.resolution
    if math.isnan(x + y) or not farthest < FARTHEST_CELL:
        raise UsageError(
            f"the point ({x:g}, {y:g}) is in no map", fix="give x and y in metres, in the map frame"
        )
    return lattice.to_cell(x, y)


def read_visits(slices: Slices, cell: tuple[int, int], manifest: Manifest) -> Visits | None:
    """Read from the slices of its tile when a cell (row, col) was observed; None: never."""
    row, col = cell[0] % TILE, cell[1] % TILE
    seen = np.unpackbits(unpack(slices)[:, 1, row], axis=1)[:, col].astype(np.bool_)
    if not seen.any():
        return None
    numbers = slices.numbers[seen].tolist()
    slice_ns = round(manifest.pass_gap_s * 1e9)
    hit, seen_visits = count_visits(slices)[:, row, col].tolist()
    hit_visits = hit if manifest.kind == EvidenceKind.COUNTS else None
    return Visits(numbers[0] * slice_ns, (numbers[-1] + 1) * slice_ns, hit_visits, seen_visits)


def read_cell(evidence: Evidence, row: int, col: int) -> Seen:
    """Read what observed a cell; a cell that is in no tile has zeros."""
    at = np.flatnonzero((evidence.tiles == (row // TILE, col // TILE)).all(axis=1))
    numbers = evidence.cells[at, :, row % TILE, col % TILE].astype(np.int64).sum(axis=0).tolist()
    return Seen.read(numbers, EvidenceKind(evidence.manifest.kind))


@dataclass(frozen=True)
class Sighting:
    """What one scan did to the cell."""

    stamp_ns: int
    """When the scan was taken, as its log says it (ns)"""
    log: str
    """The log, as it was given"""
    build: Count
    """Which build of the evidence used it, counted from 0 as in the manifest"""
    topic: str
    """The topic, or the kind of line"""
    seen: Seen
    """What the scan added to the cell"""
    x: float
    """Where the sensor was (m)"""
    y: float
    """Where the sensor was (m)"""
    distance: float
    """From there to the middle of the cell (m)"""


def find_sightings(
    uses: Sequence[Use], history: CellHistory, progress: Progress
) -> tuple[list[Sighting], int]:
    """Trace all scans of the logs once more, and see what each does to the cell.

    Returns
    -------
    sightings, used
        In the order of the logs; and how many scans of these logs the builds used.
    """
    from occmap.grid.windows import look_at_cell  # noqa: PLC0415  late: it brings numba

    opened = [(use, open_log(use.log, use.options.reading)) for use in uses]
    total = sum(count_scans(log, use.options.selection.topics) for use, log in opened)
    sightings: list[Sighting] = []
    tally = Tally(lambda scans: progress(scans, total))
    for use, log in opened:
        spec, cell = plan_grid(use.options), (history.cell.row, history.cell.column)
        for posed in pose_again(log, use.options, tally):
            rays, beams = interpret(posed, use.options.returns)
            numbers = look_at_cell(rays, spec, *cell)
            sightings += list_sightings(use, posed, numbers, history)
            tally.use(len(numbers), beams)
    return sightings, tally.scans_used


def pose_again(log: Log, options: BuildOptions, tally: Tally) -> Iterator[PosedScans]:
    """Read and pose the scans of a log as a build does, by the limits that all of it shows."""
    for attached in open_drive(log, options).settle().read(tally):
        if attached.posed is not None:
            yield attached.posed


def list_sightings(
    use: Use, posed: PosedScans, numbers: Int64, history: CellHistory
) -> Iterator[Sighting]:
    """List the scans of a batch that added something (S, 2) to the cell."""
    low_x, low_y, high_x, high_y = history.cell.extent
    middle = np.array([low_x + high_x, low_y + high_y]) / 2
    for scan in np.flatnonzero(numbers.any(axis=1)):
        place = posed.position[scan].reshape(-1, 3)  # one, or one a beam
        sensor = place[len(place) // 2, :2]
        yield Sighting(
            int(posed.batch.stamp_ns[scan]),
            str(use.log),
            use.build,
            posed.batch.topic,
            Seen.read(numbers[scan].tolist(), history.seen.kind),
            x=float(sensor[0]),
            y=float(sensor[1]),
            distance=float(np.hypot(*(sensor - middle))),
        )


def add_up(sightings: Sequence[Sighting]) -> Numbers:
    """Sum up what scans added to the cell."""
    first, second = (sum(each.seen.numbers[part] for each in sightings) for part in (0, 1))
    return first, second
