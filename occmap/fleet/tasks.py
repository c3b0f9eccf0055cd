"""What workers do with logs: plain functions of plain values, which may run anywhere and again.

Each leaves its result in the scratch folder and gives it at once where it is there already.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from occmap.errors import LogError, MapError, name_log
from occmap.evidence.manifest import describe_files, list_files
from occmap.fleet.runs import Job, Piece, once, read_mapped, write_mapped, write_run
from occmap.posing.jumps import find_breaks
from occmap.posing.leaps import Ends, Laser
from occmap.readers import Note, open_log, read_scans, split_log
from occmap.selection import Seam, Selector
from occmap.sensor.no_return import RangeLimits
from occmap.steps.engines import make_engine
from occmap.steps.opening import count_scans
from occmap.steps.tally import Tally
from occmap.steps.tracing import Drive, open_drive, trace
from occmap.store.blocks import Block, split_blocks
from occmap.types import Float64, Rays


class LogSurvey(NamedTuple):
    """What there is to know of a log before its scans are traced."""

    name: str
    """What files of it are called; a log that is given twice is two"""
    path: Path
    scans: int
    """As the log announces them"""
    parts: int
    """How many parts it is traced in"""
    bytes: int
    notes: tuple[Note, ...]
    first_ns: int | None
    """The stamp of the first scan; None where there is none"""


@dataclass(frozen=True)
class TraceJob(Job):
    """A part of a log to be traced."""

    survey: LogSurvey
    part: int | None
    """None: all of it"""
    seam: Seam
    limits: RangeLimits | None = None
    """Those of the whole log, where they are known"""


@dataclass(frozen=True, eq=False)
class Traced:
    """What a part of a log showed."""

    tally: Tally
    limits: RangeLimits
    """The limits by which its ranges were read"""
    notes: tuple[str, ...] = ()
    """Notes on its poses and scans"""
    log_notes: tuple[Note, ...] = ()
    """Notes of the reader"""
    depends: bool = False
    """True where the rest of the log could change this: a message is damaged, a frame appears for
    the first time, or a pose jumps"""
    ends: dict[Laser, Ends] = field(default_factory=dict)
    """Where the scans of each laser begin and end"""
    bounds: dict[str, Float64] = field(default_factory=dict)
    """(2, 3) around the sensor of each topic (m)"""
    pieces: Mapping[Block, tuple[Piece, ...]] = field(default_factory=dict)


@once
def survey_log(job: Job) -> LogSurvey:
    """Open a log, read its poses, and cut it into parts.

    Raises
    ------
    LogError, PoseError
        It cannot be read, has no scans, or its scans have no poses.
    """
    options = job.setting.options
    path = Path(job.where)
    log = open_log(path, options.reading)
    scans = count_scans(log, options.selection.topics)
    drive = open_drive(log, options)
    parts = split_log(log, job.setting.slice_bytes)
    if parts:
        for chain in filter(None, drive.poser.chains.values()):
            find_breaks(chain)  # so that every part is pickled with tracks that have cached steps
        drives = [drive._replace(log=part) for part in parts]
        write_mapped(job.setting.folder / f"{job.name}.parts", drives)
    stamps = options.posing.stamps
    firsts = (some.first for some in read_scans(log, drive.topics))
    first_ns = next((stamps.choose(one.stamp_ns, one.record_ns) for one in firsts), None)
    size = sum(each.stat().st_size for each in list_files(path))
    return LogSurvey(job.name, path, scans, len(parts) or 1, size, tuple(log.notes), first_ns)


def open_part(job: TraceJob) -> Drive:
    """Open a part of a log as the survey left it, or all of it."""
    if job.part is None:
        options = job.setting.options
        return open_drive(open_log(job.survey.path, options.reading), options)
    parts: Sequence[Drive] = read_mapped(job.setting.folder / f"{job.survey.name}.parts")
    return parts[job.part]._replace(seam=job.seam)


def count_in_window(job: TraceJob) -> int:
    """Count the scans of a part that lie in the time window, of which a stride takes every n-th."""
    drive = open_part(job)
    options = job.setting.options
    selector = Selector(options.selection, options.posing.stamps, drive.seam)
    for _ in selector.judge(read_scans(drive.log, drive.topics)):
        pass
    return selector.wanted


@once
def trace_part(job: TraceJob) -> Traced:
    """Trace a log or a part of one, and leave what it observed in run files.

    A part that depends on the rest of its log says so.

    Raises
    ------
    OccmapError
        As `trace`, or the scratch folder cannot be written.
    """
    setting, options = job.setting, replace(job.setting.options, jobs=1)
    drive = open_part(job)
    frames = set(drive.poser.chains)
    limits = job.limits or RangeLimits(options.returns)
    recorder = setting.keep.make_recorder(job.survey.scans, setting.logs, options.returns)
    tally, sink = Tally(recorder=recorder), RunWriter(job)
    try:
        with name_log(job.survey.path):
            odd = trace(drive, options, sink.add, limits, tally)
            sink.flush()
    except (LogError, MapError):
        # Only the log as a whole shows if it can be read, and which ranges are no walls far away.
        if job.part is not None:
            return Traced(Tally(), limits, depends=True)
        raise
    poser, log_notes = drive.poser, tuple(drive.log.notes)
    is_damaged, has_new_frames = log_notes != job.survey.notes, set(poser.chains) != frames
    jumps = any(course.find_jumps() for course in poser.courses.values())
    return Traced(
        tally,
        limits,
        notes=(*poser.notes, *odd),
        log_notes=log_notes,
        depends=is_damaged or has_new_frames or jumps,
        ends=poser.find_ends(),
        bounds={topic: course.bounds for topic, course in poser.courses.items()},
        pieces={key: tuple(pieces) for key, pieces in sink.pieces.items()},
    )


class RunWriter:
    """Observes rays, and writes a run file whenever memory holds enough tiles."""

    def __init__(self, job: TraceJob) -> None:
        self._job = job
        self._runs = 0
        self.pieces: dict[Block, list[Piece]] = {}
        self._begin()

    def _begin(self) -> None:
        setting = self._job.setting
        self._engine = make_engine(setting.options, setting.keep.slices, setting.window_cells)

    def add(self, rays: Rays) -> None:
        """Observe rays."""
        self._engine.add(rays)
        if self._engine.bytes_held > self._job.setting.most_bytes:
            self.flush()

    def flush(self) -> None:
        """Write what memory holds, block by block: a copy of all of it would not fit."""
        parts = split_blocks(self._engine.finish().tiles, self._engine.read_slices())
        name = f"{self._job.name}-{self._runs}.run"
        for key, piece in write_run(self._job.setting.folder, name, parts).items():
            self.pieces.setdefault(key, []).append(piece)
        self._runs += 1
        self._begin()


def hash_log(job: Job) -> list[dict[str, Any]]:
    """Name, size and SHA-256 of the files of a log.

    Raises
    ------
    LogError
        A file cannot be read.
    """
    return list(describe_files(Path(job.where)))
