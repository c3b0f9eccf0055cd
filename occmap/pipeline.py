"""The whole tool on one page: logs in, an occupancy map and a report out."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from occmap.batching import Batcher, Selection
from occmap.errors import LogError, MapError, PoseError, UsageError
from occmap.evidence import to_evidence
from occmap.evidence.manifest import describe_build, plan_manifest
from occmap.evidence.merging import open_saved
from occmap.evidence.persistence import check_gap, check_passes, render_lasting
from occmap.evidence.publishing import describe_resumed
from occmap.evidence.repetition import list_repeated
from occmap.grid.framing import Framing, frame
from occmap.grid.lattice import Lattice
from occmap.grid.spec import GridSpec, tabulate
from occmap.grid.stacks import add_stack
from occmap.grid.tiles import MAX_CELLS, TileGrid
from occmap.posing.attach import Poser
from occmap.posing.options import PosingOptions
from occmap.readers import Log, Role, open_log, read_poses, read_scans
from occmap.readers.options import ReaderOptions
from occmap.report import (
    Remarks,
    Report,
    Tally,
    list_disagreement,
    list_lacking,
    measure_shares,
    refuse_unseen,
    refuse_unused,
)
from occmap.sensor.models import CountingModel, RadialModel, SensorModel, describe_model
from occmap.sensor.no_return import RangeLimits, settle
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Evidence, OccupancyMap, Rays, Scan, Slices, Update
from occmap.workers import Workers, count_cores
from occmap.writers import Product, WriteOptions, check_outputs, want_evidence, write_outputs
from occmap.writers.atomic import hold_alone

if TYPE_CHECKING:  # the engine brings numba, which takes longer to load than all else together
    from occmap.grid.engine import GridEngine
    from occmap.grid.sliced import SlicedEngine

MOST_OFFSET = 10
"""Cells; a hit that lies deeper in a wall is none."""
DEFAULT_UPDATE = Update.SURFACE


def choose_model(update: Update) -> SensorModel:
    """The model that an update is used with where nobody names one, by evidence.

    A scan counts once in the polygon update, and its joined borders thicken walls by themselves.
    """
    return CountingModel(cut=0.4, spread=0.0) if update is Update.POLYGON else CountingModel()


Progress = Callable[[int, int], None]
"""Told, now and then, how many scans were read since the last call and how many there are."""


@dataclass(frozen=True)
class BuildOptions:
    """What a user may choose about a map, grouped by the stage that it concerns."""

    resolution: float = 0.05
    """Side of a cell (m)"""
    update: Update = DEFAULT_UPDATE
    model: SensorModel = field(default_factory=CountingModel)
    reading: ReaderOptions = field(default_factory=ReaderOptions)
    returns: ReturnOptions = field(default_factory=ReturnOptions)
    posing: PosingOptions = field(default_factory=PosingOptions)
    selection: Selection = field(default_factory=Selection)
    framing: Framing = field(default_factory=Framing)
    writing: WriteOptions = field(default_factory=WriteOptions)
    jump: float = 0.1
    """Neighbouring beams see one surface where ranges differ by at most this (m; not beam)"""
    border_gap: int = 8
    """... and its border is closed between end cells at most this far apart (cells; polygon)"""
    hit_offset: float = 0.5
    """A hit lies so far behind the measured point, which is on a surface (cells)"""
    max_cells: int = MAX_CELLS
    """A map with more cells is refused"""
    min_passes: int | None = None
    """A cell keeps its hits only if they came on so many visits; None: it keeps all"""
    pass_gap_s: float = 10.0
    """Two visits of a cell lie at least so far apart"""
    jobs: int = field(default_factory=count_cores)
    """Threads"""
    resume: Path | None = None
    """An evidence file: its observations are added to those of the logs"""

    def __post_init__(self) -> None:
        check_passes(self.min_passes, self.model)
        check_gap(self.pass_gap_s)
        if self.jobs < 1:
            raise UsageError(f"{self.jobs} jobs are not possible", fix="give --jobs 1 or more")
        if not self.jump >= 0:
            raise UsageError(f"a jump of {self.jump} m is not possible", fix="try --jump 0.1")
        if not 0 <= self.hit_offset <= MOST_OFFSET:
            raise UsageError(
                f"a hit offset of {self.hit_offset} cells is not possible",
                fix=f"give 0 to {MOST_OFFSET}",
            )
        if not 0 <= self.border_gap <= 1000:
            raise UsageError(
                f"a border gap of {self.border_gap} cells is not possible", fix="give 0 to 1000"
            )

    def list_idle(self) -> Iterator[str]:
        """Say which options do nothing under the update."""
        if self.update is Update.BEAM and self.jump != BuildOptions.jump:
            yield "--jump does nothing under `occmap build beam`"
        if self.update is not Update.POLYGON and self.border_gap != BuildOptions.border_gap:
            yield "--border-gap does nothing: it is for `occmap build polygon`"


class Build(NamedTuple):
    """A map and how it came about."""

    map: OccupancyMap
    report: Report
    observed: TileGrid
    """What the map was made of, before `min_passes` forgets anything"""
    evidence: Evidence | None
    """The same to write and to merge, with its slices of time; None where no output is of it"""


def ignore_progress(_scans: int, _total: int) -> None:
    """Tell nobody."""


def build(
    paths: Sequence[Path],
    options: BuildOptions,
    outputs: Sequence[Path] = (),
    progress: Progress = ignore_progress,
) -> Build:
    """Build one map from all usable scans of one or more logs, and write it.

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, the map would be too large, or an output
        cannot be written.
    """
    check_outputs(outputs, list_inputs(paths, options))
    with hold_alone(options.resume, outputs):
        return build_alone(paths, options, outputs, progress)


def list_inputs(paths: Sequence[Path], options: BuildOptions) -> list[Path]:
    """List the files that a build reads, which nothing may write over."""
    bags = [path / "metadata.yaml" for path in paths]  # of a folder that is a bag
    return [*paths, *bags, Path(options.posing.poses or "")]


def build_alone(
    paths: Sequence[Path], options: BuildOptions, outputs: Sequence[Path], progress: Progress
) -> Build:
    """Build and write a map, while nobody else adds to the same evidence."""
    tally = Tally()
    plan = plan_manifest(options)
    saved = open_saved(options.resume, plan) if options.resume else None
    with tally.time("open"):
        logs = [open_log(path, options.reading) for path in paths]
    total = sum(count_scans(log, options.selection.topics) for log in logs)
    remarks = Remarks([str(log.path) for log in logs], describe_resumed(saved) if saved else None)
    remarks.note_request(outputs, options.writing, options.model)
    tally.advance = lambda scans: progress(scans, total)
    tiles, slices = observe_logs(logs, options, outputs, tally, remarks)
    if saved:
        add_stack(tiles, saved.tiles, saved.cells)
        slices = saved.slices + slices
    refuse_unused(logs, tally)
    refuse_unseen(logs, tally, tiles)
    with tally.time("render"):
        grid, lost = render_lasting(
            tiles, slices, options.min_passes, options.model, options.max_cells
        )
        grid = frame(grid, options.framing, options.model.prior, options.max_cells)
    remarks.notes += (
        *options.list_idle(),
        *list_lacking(tally, remarks.resumed),
        *lost,
        *list_disagreement(grid),
    )

    @cache  # two files may want it, and it takes time to hash the logs
    def keep_evidence() -> Evidence:
        past = saved.manifest if saved else plan
        builds = (*past.builds, describe_build(paths, options, tally.to_json()))
        remarks.notes += list_repeated(builds)
        return to_evidence(tiles, replace(plan, builds=builds, subtracted=past.subtracted), slices)

    with tally.time("write"):
        remarks.files += write_outputs(outputs, Product(grid, keep_evidence), options.writing)
    report = make_report(grid, options, tally, remarks)
    return Build(grid, report, tiles, keep_evidence() if want_evidence(outputs) else None)


def observe_logs(
    logs: Sequence[Log],
    options: BuildOptions,
    outputs: Sequence[Path],
    tally: Tally,
    remarks: Remarks,
) -> tuple[TileGrid, tuple[Slices, ...]]:
    """Trace all scans; give what was observed and, where it is kept, in which slices of time."""

    def begin() -> Callable[[Rays], None]:
        engines[:] = [choose_engine(options, outputs)]
        return engines[0].add

    engines: list[GridEngine | SlicedEngine] = []
    for log, notes in trace_logs(logs, options, begin, tally):
        remarks.note(log, notes)
    with tally.time("fold"):
        return engines[0].finish(), engines[0].read_slices()


def trace_logs(
    logs: Sequence[Log],
    options: BuildOptions,
    begin: Callable[[], Callable[[Rays], None]],
    tally: Tally,
) -> Iterator[tuple[Log, list[str]]]:
    """Read logs and trace their scans; give each log with what there is to say of it.

    What stands for "no return" is known for sure only when a log was read to its end. Where its
    first scans did not show that, all logs are read once more.

    Parameters
    ----------
    begin
        Called before the logs are read; gives what is to observe the rays.
    """
    limits = [RangeLimits(options.returns) for _ in logs]
    for _ in range(2):
        tally.start_over()
        observe = begin()
        notes = [
            trace_log(log, options, observe, tally, limit)
            for log, limit in zip(logs, limits, strict=True)
        ]
        if settle(limits):
            break
    for log, texts, limit in zip(logs, notes, limits, strict=True):
        yield log, [*texts, *limit.list_notes()]


def trace_log(
    log: Log,
    options: BuildOptions,
    observe: Callable[[Rays], None],
    tally: Tally,
    limits: RangeLimits,
) -> list[str]:
    """Read a log twice, the poses, which are small, then the scans as a stream; return notes."""
    topics = choose_topics(log, options.selection.topics)
    with tally.time("poses"):
        poser = make_poser(log, topics, options.posing)
    batcher = Batcher(options.selection, options.posing.stamps, limits)

    def trace(rays: Rays) -> None:
        with tally.time("trace"):
            try:
                observe(rays)
            except MapError as error:
                raise error.placed(log.path) from None

    with Workers(trace, options.jobs) as workers:
        for batch in tally.time_each("read", batcher.stack(read_scans(log, topics))):
            # Here, not in a worker: each of many short NumPy calls would wait for the GIL.
            with tally.time("pose"):
                posed, dropped = poser.attach(batch)
            tally.drop(dropped)
            for scans in posed:
                with tally.time("interpret"):
                    rays, beams = interpret(scans, options.returns)
                tally.use(len(rays.kind), beams)
                workers.give(rays)
            tally.advance(len(batch.stamp_ns))
    tally.scans_read += batcher.read
    tally.drop(dict(batcher.left_out))
    return poser.notes + batcher.notes


def choose_topics(log: Log, wanted: Sequence[str]) -> list[str]:
    """Choose the scan topics of a log: those that the user names, else all.

    Clouds of points are taken where there are no scans, or where the user names them.

    Raises
    ------
    LogError
        The log has no scans, or not on a wanted topic.
    """
    scans = [s.topic for s in log.streams if s.role is Role.SCAN and s.count]
    clouds = [s.topic for s in log.streams if s.role is Role.CLOUD and s.count]
    there = scans + clouds if wanted else scans or clouds
    if not there:
        held = ", ".join(f"{s.topic} ({s.type}, {s.count})" for s in log.streams if s.count)
        raise LogError(f"holds no laser scans; it holds {held or 'nothing'}", where=log.path)
    missing = sorted(set(wanted) - set(there))
    if missing:
        raise LogError(
            f"has no scans on the topic {missing[0]}",
            where=log.path,
            fix=f"it has scans on {', '.join(there)}",
        )
    return [topic for topic in there if topic in wanted or not wanted]


def count_scans(log: Log, wanted: Sequence[str]) -> int:
    """Count the scans that will be read.

    Raises
    ------
    LogError
        As `choose_topics`.
    """
    return count_messages(log, choose_topics(log, wanted))


def count_messages(log: Log, topics: Sequence[str]) -> int:
    """Count the messages of some topics, as the reader has it."""
    wanted = set(topics)
    return sum(stream.count for stream in log.streams if stream.topic in wanted)


def make_poser(log: Log, topics: Sequence[str], options: PosingOptions) -> Poser:
    """Read the poses of a log, unless it states them beside its scans.

    Raises
    ------
    PoseError
        No scan frame has a chain of transforms to a map frame.
    """
    first = take_first(log, topics)
    stated = options.poses is None and all(scan.pose is not None for scan in first)
    poser = Poser.build([] if stated else read_poses(log), options)
    if not stated:
        try:
            poser.resolve({scan.frame for scan in first})
        except PoseError as error:
            raise error.placed(log.path) from None
    return poser


def take_first(log: Log, topics: Sequence[str]) -> list[Scan]:
    """The first scan of each topic, read in one go, as there may be very many; then closed."""
    first: dict[str, Scan] = {}
    scans = log.scans(set(topics))
    for scan in scans:
        first.setdefault(scan.topic, scan)
        if len(first) == len(topics):
            break
    if isinstance(scans, Generator):
        scans.close()
    return list(first.values())


def choose_engine(options: BuildOptions, outputs: Sequence[Path]) -> "GridEngine | SlicedEngine":
    """Make an engine, one that keeps slices of time only where they are asked for."""
    if options.min_passes is None and not want_evidence(outputs):
        return make_engine(options)
    from occmap.grid.sliced import SlicedEngine  # noqa: PLC0415  late: as below

    slice_ns = round(options.pass_gap_s * 1e9)
    return SlicedEngine(plan_grid(options), slice_ns, max_cells=options.max_cells)


def make_engine(options: BuildOptions) -> "GridEngine":
    """Make the grid engine for an update and a model."""
    from occmap.grid.engine import GridEngine  # noqa: PLC0415  late: numba takes a third of a second

    return GridEngine(plan_grid(options), max_cells=options.max_cells)


def plan_grid(options: BuildOptions) -> GridSpec:
    """Say how an engine is to turn rays into evidence."""
    lattice = Lattice(options.resolution)
    model = options.model
    radial = None
    if isinstance(model, RadialModel):
        radial = tabulate(model.free, model.hit, model.depth(options.resolution))
    return GridSpec(
        options.update,
        lattice,
        options.jump,
        options.border_gap,
        options.hit_offset,
        radial,
    )


def make_report(
    grid: OccupancyMap, options: BuildOptions, tally: Tally, remarks: Remarks
) -> Report:
    """Sum up what was done."""
    rows, cols = grid.shape
    return Report(
        logs=tuple(remarks.logs),
        scans_read=tally.scans_read,
        scans_used=tally.scans_used,
        dropped=dict(tally.dropped),
        beams=tally.beams,
        notes=tuple(remarks.notes),
        damage=tuple(remarks.damage),
        update=options.update.value,
        model=describe_model(options.model),
        min_passes=options.min_passes,
        resolution=options.resolution,
        columns=cols,
        rows=rows,
        extent=grid.extent,
        shares=measure_shares(grid, options.writing),
        agreement=grid.agreement,
        seconds=dict(tally.seconds),
        files=tuple(remarks.files),
        resumed=remarks.resumed,
    )
