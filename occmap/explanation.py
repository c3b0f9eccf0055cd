"""Why a cell is what it is: what evidence holds of it, and which scans made it so.

Each scan is traced once more, as its build traced it. A log is known by its hash, not by its name.
Options are read back from the JSON that `write_value` made of them.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from occmap import evidence
from occmap.cells import Box, CellBox, Evidence, Ground, Manifest, OccupancyMap, Slices
from occmap.choices import option, take
from occmap.errors import LogError, MapError, OccmapError, PoseError, UsageError, require
from occmap.evidence import manifest as records
from occmap.evidence.manifest import BuildRecord
from occmap.grid import Lattice, tiles
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, EvidenceKind, TileGrid, find_unit, unite
from occmap.options import OPTIONS, BuildOptions
from occmap.posing import NO_DRIFT
from occmap.report import HIDDEN, Count, Printed, Share, count, join_names, printed_as
from occmap.scans import Keep, make_engine, plan_grid
from occmap.scans.stream import Drive
from occmap.scans.tracing import Progress, Reading, ignore_progress, read_views
from occmap.sensor import interpret
from occmap.sensor.models import MODEL, SensorModel, describe_model
from occmap.store import Blocks, read_part
from occmap.store.painting import open_map
from occmap.types import Int64, Pose, PosedScans, PoseSample, Update
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


class Use(NamedTuple):
    """A log, and how a build used it."""

    log: Path
    build: int
    """Which of `Manifest.builds`"""
    options: BuildOptions


def find_uses(part: Evidence, logs: Iterable[Path], poses: Iterable[Path]) -> list[Use]:
    """Find every build that used a log.

    Parameters
    ----------
    poses
        The trajectory files of the builds that had one, in any order.

    Raises
    ------
    LogError
        The evidence was not made of a log, or a file cannot be read.
    PoseError
        A trajectory is missing, or none of these builds had it.
    """
    builds = part.manifest.builds
    held = [{entry["sha256"] for entry in records.list_inputs(build)} for build in builds]
    given = {digest: path for path in poses for digest in hash_files(path)}
    uses: list[Use] = []
    # Of equal logs one will do: a build cannot tell them apart.
    for hashes, log in {hash_files(log): log for log in logs}.items():
        times = [at for at, of_build in enumerate(held) if hashes <= of_build]
        if not times:
            made_of = join_names(records.list_logs(*builds) or ["no log"])
            found = f"{part.where} was not made of it, or it was changed since"
            fix = f"it was made of {made_of}: give `logs` with one of these"
            raise LogError(found, where=log, fix=fix)
        uses += [Use(log, at, recall_build(builds[at], part.where, log, given)) for at in times]
    used = {entry["sha256"] for use in uses for entry in records.list_trajectory(builds[use.build])}
    if idle := given.keys() - used:
        found = "is not a trajectory that these logs were built with"
        raise PoseError(found, where=given[min(idle)], fix="leave it out")
    return uses


def hash_files(path: Path) -> frozenset[str]:
    """SHA-256 of a file, or of all files in a folder; raises LogError if one cannot be read."""
    return frozenset(entry["sha256"] for entry in records.describe_files(path))


def recall_build(build: BuildRecord, where: str, log: Path, given: dict[str, Path]) -> BuildOptions:
    """Recall the options of a build, with the trajectory that it had.

    Parameters
    ----------
    where
        The evidence file, for errors.
    log
        The log that needs the trajectory, for errors.
    given
        The trajectory files that the user gives, by their hashes.

    Raises
    ------
    PoseError
        The trajectory is not among those given.
    MapError
        As `recall_options`.
    """
    options = recall_options(build["options"], where)
    if not (trajectory := records.list_trajectory(build)):
        return options
    name = trajectory[0]["name"].partition("/")[0]
    if (path := given.get(trajectory[0]["sha256"])) is None:
        others = ", ".join(dict.fromkeys(map(str, given.values())))
        differs = f" (the SHA-256 of {others} is another)" if others else ""
        found = f"its poses came from {name}, which is needed again{differs}"
        raise PoseError(found, where=log, fix=f"add `poses={name}`")
    topic = (options.posing.poses or "").removeprefix(name)  # as in ":/path"
    return replace(options, posing=replace(options.posing, poses=f"{path}{topic}"))


def recall_options(plain: dict[str, Any], where: str) -> BuildOptions:
    """Turn what `describe_build` wrote of the options of a build back into options.

    What changes nothing about the evidence (threads, what was resumed) is at its default; a
    trajectory file is a name without its folder. An option that was not there yet has its default.

    Parameters
    ----------
    where
        The evidence file, for errors.

    Raises
    ------
    MapError
        This occmap does not know an option, or a value of it.
    """
    try:
        told: dict[str, Any] = {}
        for name, value in plain.items():
            told |= value if isinstance(value, dict) else {name: value}
        values = {name: recall(name, value) for name, value in told.items()}
        if values.get("update") is Update.CLOUD:  # a drift that was found is told
            values.setdefault("height_drift", NO_DRIFT)
            values.setdefault("own_points", {})
        return take(BuildOptions, values)
    except (OccmapError, TypeError, ValueError, OverflowError) as error:
        found = f"the options of a build in it cannot be read ({error})"
        fix = "use the occmap that built it, or build it again"
        raise MapError(found, where=where, fix=fix) from None


def recall(name: str, plain: Any) -> Any:
    """Turn the value of an option back that was written as JSON.

    Poses and transforms are lists of all their fields there.

    Raises
    ------
    TypeError, ValueError, UsageError
        There is no such option, or it is not such a value.
    """
    if name not in OPTIONS:
        raise ValueError(f"no option is called {name!r}")
    option = OPTIONS[name]
    if option.kind is Pose and plain is not None:
        plain = Pose(*plain)
    elif name == "static_transforms":
        plain = [PoseSample(*[*it[:3], Pose(*it[3]), *it[4:]]) for it in plain]
    elif name in {"height_drift", "own_points"}:  # that they were found is kept: they are again
        plain = "on" if plain else "off"
    return option.read(plain)


FARTHEST_CELL = 1 << 44
"""Beyond this a float cannot tell the parts of a cell apart."""


@dataclass(frozen=True)
class Observation:
    """What observed a cell."""

    hits: Count | None
    """Hits; null for evidence in log-odds"""
    misses: Count | None
    """Misses; null for evidence in log-odds"""
    log_odds: float | None
    """Sum of log-odds (natural logarithm); null for evidence in counts"""
    observations: Count
    """Observations: hits and misses, or those that the sum is of"""

    numbers: tuple[int, int] = field(metadata=HIDDEN)
    """Hits and misses, or log-odds in units of 1/65536 and observations"""
    unit: int = field(metadata=HIDDEN)
    """What one observation counts in all of these"""

    @classmethod
    def read(cls, numbers: Iterable[int], kind: EvidenceKind, unit: int) -> Self:
        """Read the two numbers of a cell."""
        first, second = numbers
        if kind is EvidenceKind.LOG_ODDS:
            return cls(None, None, first * LOG_ODDS_UNIT, second, (first, second), unit)
        return cls(first, second, None, first + second, (first, second), unit)

    @property
    def pair(self) -> tuple[float, float]:
        """Hits and misses, or log-odds and observations; a whole observation is 1."""
        first, second = (each / self.unit for each in self.numbers)
        return first if self.log_odds is None else first * LOG_ODDS_UNIT, second

    def __str__(self) -> str:
        first, second = self.pair
        if self.log_odds is not None:
            return f"log-odds {first:.3f} of {count(second, 'observation')}"
        return f"{count(first, 'hit')} and {count(second, 'miss')}"


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

    lattice_row: int = field(metadata=printed_as("row"))
    """Row of the cell in the lattice, which is no index of an array: floor(y / resolution)"""
    lattice_column: int = field(metadata=printed_as("column"))
    """Column of the cell in the lattice, likewise: floor(x / resolution)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""

    @classmethod
    def find(cls, lattice: Lattice, x: float, y: float) -> Self:
        """Find the cell that holds a point (m).

        Raises
        ------
        UsageError
            It is too far away, or not finite.
        """
        farthest = max(abs(x), abs(y)) / lattice.resolution
        if math.isnan(x + y) or not farthest < FARTHEST_CELL:
            found = f"the point ({x:g}, {y:g}) is in no map"
            raise UsageError(found, fix="give x and y in metres, in the map frame")
        row, col = lattice.to_cell(x, y)
        return cls(row, col, lattice.measure(CellBox.at(row, col)))

    @property
    def box(self) -> CellBox:
        """The cell as a box of cells."""
        return CellBox.at(self.lattice_row, self.lattice_column)

    def read_slices(self, part: Evidence) -> list[Slices]:
        """Take from each layer of slices, one of each build, that of the cell's tile."""
        tile = self.lattice_row // TILE, self.lattice_column // TILE
        mine = [np.flatnonzero((each.tiles == tile).all(axis=1)) for each in part.slices]
        return [tiles.take_tiles(*each) for each in zip(part.slices, mine, strict=True)]

    def read_around(self, grid: TileGrid) -> list[list[Observation]]:
        """Read what observed the cell and its neighbours: rows by falling y, in them by rising x.

        A cell that is in no tile has zeros.
        """
        rows = np.moveaxis(grid.gather(self.box.grow(1), np.int64), 0, -1)[::-1]
        like = grid.kind, grid.unit
        return [[Observation.read(numbers, *like) for numbers in row] for row in rows.tolist()]

    def read_visits(self, slices: Slices, manifest: Manifest) -> Visits | None:
        """Read from the slices of its tile when the cell was observed; None: never."""
        row, col = self.lattice_row % TILE, self.lattice_column % TILE
        seen = np.unpackbits(tiles.unpack_bits(slices)[:, 1, row], axis=1)[:, col].astype(np.bool_)
        if not seen.any():
            return None
        numbers = slices.numbers[seen].tolist()
        slice_ns = round(manifest.pass_gap_s * 1e9)
        hit, seen_visits = tiles.count_visits(slices)[:, row, col].tolist()
        hit_visits = hit if manifest.kind == EvidenceKind.COUNTS else None
        return Visits(numbers[0] * slice_ns, (numbers[-1] + 1) * slice_ns, hit_visits, seen_visits)


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
    seen: Observation
    """What the scan added to the cell"""
    x: float
    """Where the sensor was (m)"""
    y: float
    """Where the sensor was (m)"""
    distance: float
    """From there to the middle of the cell (m)"""

    @classmethod
    def note(cls, use: Use, posed: PosedScans, scan: int, seen: Observation, cell: Cell) -> Self:
        """Note what one of some scans did to a cell."""
        low_x, low_y, high_x, high_y = cell.extent
        middle = (low_x + high_x) / 2, (low_y + high_y) / 2
        place = posed.position if posed.origin is None else posed.origin
        places = place[scan].reshape(-1, 3)  # one, or one a beam
        x, y, _ = places[len(places) // 2].tolist()
        stamp_ns, away = int(posed.batch.stamp_ns[scan]), math.dist((x, y), middle)
        return cls(stamp_ns, str(use.log), use.build, posed.batch.topic, seen, x, y, away)


def find_sightings(
    uses: Sequence[Use], cell: Cell, ground: Ground | None, progress: Progress
) -> tuple[list[Sighting], int]:
    """Trace all scans of the logs once more, as builds do, and see what each does to a cell.

    Parameters
    ----------
    ground
        That their clouds were traced over.

    Returns
    -------
    sightings, used
        By time; and how many scans of these logs the builds used.
    """
    sightings: list[Sighting] = []
    used = 0
    for use in uses:
        reading = Reading([use.log], use.options, progress)
        (drive,) = reading.list_drives()
        look = prepare_look(drive, cell, ground)
        spec = plan_grid(drive.options)
        for posed in read_views(drive, reading.tally):
            numbers = look(posed)
            for scan in np.flatnonzero(numbers.any(axis=1)).tolist():
                seen = Observation.read(numbers[scan].tolist(), spec.kind, spec.unit)
                sightings.append(Sighting.note(use, posed, scan, seen, cell))
            used += len(numbers)
    return sorted(sightings, key=lambda each: each.stamp_ns), used


def prepare_look(drive: Drive, cell: Cell, ground: Ground | None) -> Callable[[PosedScans], Int64]:
    """Prepare to say which two numbers (S, 2) each scan of a drive, or each cloud, adds to a cell.

    From here on the drive corrects heights as its build did.
    """
    from occmap.grid.engine import look_at_cell  # noqa: PLC0415  late: it brings numba
    from occmap.scans.levelling import count_ground  # noqa: PLC0415  likewise

    options, row, col = drive.options, cell.lattice_row, cell.lattice_column
    if ground is None:
        spec = plan_grid(options)
        return lambda posed: look_at_cell(interpret(posed, options.returns)[0], spec, row, col)
    if None in (options.posing.height_drift, options.clouds.own_points):  # that they are recorded
        counted = count_ground(drive, drive.scans, None)
        drive.bodies = counted.bodies
        drive.poser.drift = counted.drifts.get(str(drive.log.path))
    engine = make_engine(options, Keep(ground=ground))

    def look(posed: PosedScans) -> Int64:
        sums = [engine.finish().gather(cell.box, np.int64)[:, 0, 0]]
        for at in range(len(posed.stamp_ns)):
            engine.add(posed.take(np.array([at])))
            sums.append(engine.finish().gather(cell.box, np.int64)[:, 0, 0])
        return np.diff(sums, axis=0)

    return look


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
    seen: Observation
    """What observed the cell"""
    kept: Observation | None
    """What of that makes the class, where `min_passes` forgets hits, or misses beside lasting hits;
    null where nobody asked"""
    ground: float | None
    """How high the ground is at the point (m); null where no points of clouds showed it"""
    around: list[list[Observation]]
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
    explained: Observation = field(metadata=HIDDEN)
    """What the scans add up to"""


def explain(saved: Blocks, question: Question, progress: Progress = ignore_progress) -> Explanation:
    """Say what was observed at a point, and by which scans of the logs that the user has.

    Raises
    ------
    OccmapError
        The point is in no map, the model cannot read the evidence, a log cannot be read or is none
        that the evidence was made of, or a trajectory is missing.
    """
    model = evidence.choose_model_for(saved, question.model, question.min_passes)
    cell = Cell.find(Lattice(saved.manifest.resolution), question.x, question.y)
    # All that is in memory, or the tile that holds the point and those beside it.
    part = read_part(saved, cell.box)
    manifest, (grid, lasting) = part.manifest, evidence.find_lasting(part, question.min_passes)
    around = cell.read_around(grid)
    layers = cell.read_slices(part)
    made = evidence.paint_box(lasting, model, cell.box)
    uses = find_uses(part, question.logs, question.poses)
    sightings, scans_used = find_sightings(uses, cell, part.ground, progress)
    seen = around[1][1]
    sums = (sum(each.seen.numbers[part] for each in sightings) for part in (0, 1))
    explained = Observation.read(sums, grid.kind, grid.unit)
    notes = list(records.list_doubts(manifest))
    if uses and explained != seen:
        notes.append(tell_unexplained(f"{explained} of {seen}", part, uses))
    return Explanation(
        point=(question.x, question.y),
        cell=cell,
        map_extent=open_map(saved, model).extent if saved.blocks else None,
        verdict=name_class(made, question.writing),
        probability=float(made.probability[0, 0]),
        model=describe_model(model),
        unit=find_unit(manifest.update),
        seen=seen,
        kept=cell.read_around(lasting)[1][1] if question.min_passes else None,
        ground=measure_ground(saved, question),
        around=around,
        min_passes=question.min_passes,
        visits=cell.read_visits(unite(layers), manifest),
        builds=tuple(list_visits(cell, layers, manifest)),
        scans_used=scans_used,
        scans=tuple(sightings),
        notes=tuple(notes),
        explained=explained,
    )


def list_visits(cell: Cell, layers: Sequence[Slices], manifest: Manifest) -> Iterator[BuildVisits]:
    """List when each build observed the cell, of those that did."""
    for at, (layer, build) in enumerate(zip(layers, manifest.builds, strict=True)):
        if visits := cell.read_visits(layer, manifest):
            yield BuildVisits(**vars(visits), build=at, logs=records.list_logs(build))


def name_class(made: OccupancyMap, writing: WriteOptions) -> Verdict:
    """Name what the one cell of a map is."""
    decided = replace(made, decision=writing.decide(made.decision))
    if decided.occupied.all():
        return "occupied"
    if decided.free.all():
        return "free"
    return "undecided" if made.observed.all() else "unknown"


def measure_ground(saved: Blocks, question: Question) -> float | None:
    """How high the ground is at the point (m), as clouds showed it; None where they did not."""
    if saved.ground is None:
        return None
    (height,) = saved.ground.find_heights(np.array([[question.x, question.y]])).tolist()
    return None if math.isnan(height) else height


def tell_unexplained(explained: str, part: Evidence, uses: Sequence[Use]) -> str:
    """Say why the scans that were found explain only a part."""
    told = f"these logs explain {explained}"
    builds, named = part.manifest.builds, {use.log.name for use in uses}
    if missing := [name for name in records.list_logs(*builds) if name not in named]:
        return f"{told}; the rest is in {join_names(missing)}"
    makers = ", ".join(sorted({build["occmap"] for build in builds}))
    grown = ", the ground grew with a later build" if part.ground and len(builds) > 1 else ""
    return (
        f"{told}: a build read one of them twice, evidence was subtracted or moved by `occmap "
        f"merge`{grown}, or the occmap that built it ({makers}) read them differently"
    )
