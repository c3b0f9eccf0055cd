"""What workers do, plain functions of plain values that may run anywhere and again, and when.

A task leaves its result in the scratch folder, and does nothing where its result is there already.
What a log observed lies in run files, block by block and end to end; results say where. All files
are renamed into place, and a result comes after the run files that it tells of.
"""

import operator
import pickle
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, reduce, wraps
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

import numpy as np
import zstandard

from occmap.cells import CellBox, Evidence, Ground, Slices
from occmap.errors import MapError, name_log
from occmap.evidence import count_steady, make_empty
from occmap.evidence.manifest import describe_files, plan_manifest
from occmap.fleet.cluster import AnyJob, Cluster, Job, Result, Task
from occmap.grid import Lattice
from occmap.grid.rendering import count_agreeing
from occmap.grid.tiles import TILE, unite
from occmap.options import BuildOptions
from occmap.readers import Role, open_log
from occmap.report.results import MapFacts, count_cells
from occmap.scans import Keep, make_engine
from occmap.scans.logs import count_scans, list_kinds, suit_kinds
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally
from occmap.scans.tracing import Progress, trace_drive
from occmap.store import Block, list_blocks, split_evidence
from occmap.store.writing import BlockRecord, paint_block, write_block
from occmap.types import Int64, Update
from occmap.writers.atomic import open_atomic

if TYPE_CHECKING:  # these bring numba
    from occmap.clouds.counting import Counted

COMPRESSOR = zstandard.ZstdCompressor(write_checksum=True)
"""Its checksum tells altered data from what was written"""


@dataclass(frozen=True)
class Setting:
    """What all tasks of a build share."""

    options: BuildOptions
    keep: Keep
    folder: Path
    """Where results go"""
    logs: int
    """How many logs the build has"""
    window_cells: int
    """The largest window of an engine"""
    most_bytes: int
    """How much evidence is kept in memory before it goes to a run file"""
    scans: int = 0
    """How many scans all logs have, where that is known"""
    store: Path = Path()
    """Where blocks are written"""


class Piece(NamedTuple):
    """Where the part of a block lies."""

    file: str
    """The name of a run file"""
    offset: int
    size: int


@dataclass(frozen=True)
class BlockJob(Job):
    """A block of the map to be added up, written or painted."""

    block: Block
    pieces: tuple[Piece, ...]
    """All that was observed in it; none of a block that only lies beside others"""

    @classmethod
    def of(cls, block: Block, pieces: Iterable[Piece] = ()) -> Self:
        """Make a job of a block."""
        name, where = f"block{block.row}_{block.col}", f"block {tuple(block)}"
        return cls(name, where, block, tuple(pieces))


Pieces: TypeAlias = dict[Block, list[Piece]]
"""What was observed in each block"""


UNREADABLE = (
    *(OSError, EOFError, pickle.UnpicklingError),
    *(ValueError, LookupError, ImportError, AttributeError),
)
"""A result is not there, or damaged, which pickle meets by many errors"""


def once(task: Task[AnyJob, Result]) -> Task[AnyJob, Result]:
    """Let a task keep its result in the scratch folder, and read it from there the next time.

    Then it also raises OutputError, where its result cannot be written.
    """

    @wraps(task)
    def do_once(setting: Setting, job: AnyJob) -> Result:
        stub = job.find_stub(setting.folder, task)
        with suppress(*UNREADABLE):
            known: Result = pickle.loads(stub.read_bytes())
            return known
        result = task(setting, job)
        with open_atomic(stub) as (file,):
            pickle.dump(result, file)
        return result

    return do_once


@once
def survey_log(setting: Setting, job: Job) -> tuple[int, dict[Role, str]]:
    """Count the scans of a log, and say of what kinds; raises LogError if it cannot be read."""
    log = open_log(Path(job.where), setting.options.reading)
    topics = setting.options.selection.topics
    return count_scans(log, topics), list_kinds(log, topics)


@once
def survey_ground(setting: Setting, job: Job) -> "Counted":
    """Count what the clouds of a log show of the ground; raises OccmapError as `count_ground`."""
    from occmap.scans.levelling import count_ground  # noqa: PLC0415  late: it brings numba

    options = replace(setting.options, jobs=1)
    drive = open_drive(open_log(Path(job.where), options.reading), options)
    return count_ground(drive, setting.scans, setting.keep.ground)


@once
def trace_log(setting: Setting, job: Job) -> tuple[Tally, Pieces]:
    """Trace all scans of a log, leave what they observed in run files, and say where it lies.

    Raises
    ------
    OccmapError
        As `open_drive`, or the scratch folder cannot be written.
    """
    options, tally = replace(setting.options, jobs=1), Tally()
    log = open_log(Path(job.where), options.reading)
    with tally.time("poses"):
        drive = open_drive(log, options)
    tally.shown_every = setting.keep.choose_shown(drive.scans * setting.logs)
    # A name is used once, also where the log is read anew: another worker may be at the same log.
    names = (f"{job.name}.{number}.run" for number in count())
    runs = trace_drive(drive, partial(RunWriter, setting, names), tally)
    with name_log(log.path):
        runs.flush()
    tally.points.update(runs.points)
    tally.note(log.path, [*drive.list_notes(setting.keep.ground), *log.notes])
    return tally, runs.pieces


class RunWriter:
    """Observes the rays of a log, and writes a run file whenever memory holds enough tiles."""

    def __init__(self, setting: Setting, names: Iterator[str]) -> None:
        self._setting, self._names = setting, names
        self._begin = partial(make_engine, setting.options, setting.keep, setting.window_cells)
        self._engine = self._begin()
        self.pieces = defaultdict[Block, list[Piece]](list)
        self.points = Counter[str]()

    def add(self, seen: Any) -> None:
        """Observe rays, or posed clouds."""
        self._engine.add(seen)
        if self._engine.bytes_held > self._setting.most_bytes:
            self.flush()

    def flush(self) -> None:
        """Write what memory holds, block by block: a copy of all of it would not fit."""
        self.points.update(self._engine.points)
        plan = plan_manifest(self._setting.options)
        seen = Evidence(plan, self._engine.finish().tiles, self._engine.read_slices())
        parts = write_run(self._setting.folder / next(self._names), split_evidence(seen))
        for block, piece in parts.items():
            self.pieces[block].append(piece)
        self._engine = self._begin()


def write_run(path: Path, parts: Iterable[tuple[Block, Evidence]]) -> dict[Block, Piece]:
    """Write a run file; say where each block lies in it.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    pieces, offset = {}, 0
    with open_atomic(path) as (file,):
        for block, content in parts:
            data = COMPRESSOR.compress(pickle.dumps(content, protocol=5))
            file.write(data)
            pieces[block] = Piece(path.name, offset, len(data))
            offset += len(data)
    return pieces


def read_pieces(folder: Path, pieces: Iterable[Piece]) -> Iterator[Evidence]:
    """Read parts of blocks, one after the other.

    Raises
    ------
    MapError
        A run file is not there any more, or is not as it was written. It goes with the result that
        tells of it, as do all others that are not there, so that the same build makes them anew.
    """
    pieces = list(pieces)
    for name, offset, size in pieces:
        try:
            with (folder / name).open("rb") as file:
                file.seek(offset)
                data = zstandard.decompress(file.read(size))
        except (OSError, zstandard.ZstdError) as error:
            gone = {each for each, *_ in pieces if not (folder / each).exists()}
            gone |= {name} if isinstance(error, zstandard.ZstdError) else set()
            for log in {each.partition(".")[0] for each in gone}:
                for left in folder.glob(f"{log}.*"):
                    left.unlink(missing_ok=True)
            fix = "type the same command: it makes that anew"
            raise MapError(f"cannot be read ({error})", where=folder / name, fix=fix) from None
        yield pickle.loads(data)


def add_up(setting: Setting, pieces: Iterable[Piece]) -> Evidence:
    """Add up parts of blocks: what was observed, and, where that is kept, when.

    Raises
    ------
    MapError
        A run file cannot be read.
    """
    manifest = plan_manifest(setting.options)
    grid = make_empty(manifest)
    layers: list[Slices] = []
    for content in read_pieces(setting.folder, pieces):
        bound = max((int(np.abs(tile).max()) for tile in content.tiles.values()), default=0)
        grid.add(content.tiles, bound)
        layers += content.slices
    slices = (unite(layers),) if setting.keep.slices else ()
    return Evidence(manifest, grid.tiles, slices)


@once
def reduce_block(setting: Setting, job: BlockJob) -> Piece:
    """Add up a block, and leave it in a run file of its own.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the scratch folder cannot be written.
    """
    parts = [(job.block, add_up(setting, job.pieces))]
    return write_run(setting.folder / f"{job.name}.run", parts)[job.block]


def store_block(setting: Setting, job: BlockJob) -> BlockRecord:
    """Add up a block, and write it to the store; if a worker died at that, it is done anew.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the store cannot be written.
    """
    return write_block(setting.store, job.block, add_up(setting, job.pieces))


def measure_block(setting: Setting, job: BlockJob) -> tuple[CellBox | None, Int64]:
    """Paint the pictures of a block, if it is one that was written, and measure it.

    Returns a box around the cells that are observed, if there are any; and (8,) what `count_cells`,
    `count_agreeing` and `count_steady` give.

    Raises
    ------
    OutputError
        They cannot be written.
    """
    box = job.block.box
    grid, made = paint_block(setting.store, job.block, keep=bool(job.pieces))
    reach = CellBox.around(made.observed, box.row, box.col)
    agreeing = count_agreeing(grid, made.occupied, box)
    own = {key: grid.tiles[key] for key in box.shrink(TILE).places if key in grid.tiles}
    cells = count_cells(made, setting.options.writing)
    return reach, np.array([*cells, *agreeing, *count_steady(own)])


def hash_log(_: Setting, job: Job) -> list[dict[str, Any]]:
    """Name, size and SHA-256 of the files of a log; raises LogError if one cannot be read."""
    return list(describe_files(Path(job.where)))


@dataclass
class Crew:
    """Workers at a build, and what they found so far, or where they left it."""

    cluster: Cluster
    setting: Setting
    logs: list[Job]
    tally: Tally
    blocks: Sequence[BlockJob] = ()
    """Those in which anything was observed, each with all of it"""

    def settle(self) -> None:
        """Settle what only the logs show: how many scans, which update, the ground below clouds.

        Raises
        ------
        OccmapError
            A log cannot be read, or they hold scans and clouds.
        """
        with self.tally.time("open"):
            surveyed = self.cluster.run(survey_log, self.setting, self.logs)
        counts, kinds = zip(*surveyed, strict=True)
        options = suit_kinds(reduce(operator.or_, kinds), self.setting.options)
        self.setting = replace(self.setting, options=options, scans=sum(counts))
        if self.setting.options.update is Update.CLOUD:
            with self.tally.time("ground"):
                self.find_ground()

    def find_ground(self) -> None:
        """Find the ground below the clouds of all logs."""
        from occmap.clouds.counting import join_counted  # noqa: PLC0415  late: it brings numba
        from occmap.scans.levelling import settle_ground  # noqa: PLC0415  likewise

        def count(options: BuildOptions, ground: Ground | None) -> "Counted":
            keep = self.setting.keep._replace(ground=ground)
            setting = replace(self.setting, options=options, keep=keep)
            level = "".join(f" {angle}" for angle in options.posing.level or ())
            some = [replace(job, name=f"{job.name}{level} {bool(ground)}") for job in self.logs]
            return join_counted(self.cluster.run(survey_ground, setting, some))

        known = self.setting.keep
        found = settle_ground(count, self.setting.options, known.ground)
        self.tally.notes += found.notes
        keep = known._replace(ground=found.ground)
        self.setting = replace(self.setting, keep=keep, options=found.options)

    def trace(self, progress: Progress) -> None:
        """Trace all scans, and sort what was observed by the blocks that it lies in."""

        def tell(traced: tuple[Tally, Pieces]) -> None:
            progress(traced[0].scans_read, self.setting.scans)

        blocks: Pieces = defaultdict(list)
        for tally, of_log in self.cluster.run(trace_log, self.setting, self.logs, tell):
            self.tally.add(tally)
            for block, pieces in of_log.items():
                blocks[block] += pieces
        self.blocks = [BlockJob.of(*each) for each in sorted(blocks.items())]

    def paint(self, records: Sequence[BlockRecord]) -> MapFacts:
        """Paint the pictures of all blocks of a store, and sum up what the report tells of them.

        Blocks beside those that are written are looked at, too: hits speak for the cells around.
        """
        beside = {block for record in records for block in list_blocks(record.reach.grow(1))}
        around = map(BlockJob.of, beside - {job.block for job in self.blocks})
        measured = self.cluster.run(measure_block, self.setting, [*self.blocks, *around])
        reaches, counts = zip(*measured, strict=True)
        box = reduce(CellBox.join, filter(None, reaches))
        cells, (agreeing, met), steady = np.split(np.sum(counts, axis=0), [4, 6])
        lattice = Lattice(self.setting.options.resolution)
        where = lattice.resolution, lattice.measure(box), box.shape
        facts = MapFacts(*where, cells, float(agreeing / met) if met else None)
        return facts._replace(steady=tuple(steady.tolist())) if self.tally.points else facts
