"""A build by many workers, on this machine or on a cluster: the tasks of a build, and their order.

Evidence adds up in any order, so parts of logs are traced anywhere, and blocks of the map are added
up anywhere. What they say goes through files that all workers share; the driver hears counts and
notes alone.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from occmap.errors import OutputError
from occmap.evidence.manifest import to_plain
from occmap.fleet.cluster import Cluster, open_cluster, refuse_unseen_files
from occmap.fleet.runs import BlockKey, Piece, read_pieces
from occmap.fleet.settling import LogTrace
from occmap.fleet.tasks import (
    ReduceJob,
    Setting,
    Survey,
    SurveyJob,
    Traced,
    TraceJob,
    count_wanted,
    reduce_block,
    survey_log,
    trace_part,
)
from occmap.grid.slices import unite
from occmap.observing import Observed, Progress
from occmap.options import BuildOptions
from occmap.report import Remarks, Tally
from occmap.tracing import make_grid
from occmap.types import Slices

SLICE_BYTES = 256 << 20
"""Small enough for any worker, and large enough that the same tiles are seldom touched again"""
BASE_BYTES = 300 << 20
"""What a worker takes before it observes anything"""
WINDOW_CELL_BYTES = 20
"""What a cell takes in a window"""
LARGEST_WINDOW = 1 << 24
ROOMY_BYTES = 4 << 30
"""What a worker without a limit is taken to have"""


@dataclass(frozen=True)
class Fleet:
    """Who does the work of a build, and where they leave what they found."""

    address: str
    """Of a Dask scheduler, or `local`"""
    scratch: Path
    """A folder that all workers share"""
    slice_bytes: int = SLICE_BYTES
    """About so much of a log is one task"""

    def observe(
        self, paths: Sequence[Path], options: BuildOptions, keep_slices: bool, progress: Progress
    ) -> Observed:
        """Trace all usable scans of logs, as `occmap.observing.observe` does, by many workers.

        Raises
        ------
        OccmapError
            As there, or the workers cannot do it.
        """
        tally = Tally()
        with (
            open_cluster(self.address, options.jobs) as cluster,
            open_scratch(self, paths, options, keep_slices) as folder,
        ):
            refuse_unseen_files(cluster, [*paths, folder])
            setting = self.plan(cluster, options, keep_slices, folder)
            with tally.time("open"):
                surveys = survey_logs(cluster, setting, paths)
            logs = trace_logs(cluster, setting, surveys, progress)
            remarks = Remarks([str(path) for path in paths])
            for log in logs:
                remarks.note(log, log.list_findings())
                for part in log.parts:
                    tally.add(part.tally)
            with tally.time("fold"):
                pieces = reduce_blocks(cluster, setting, logs)
                return gather(setting, pieces, tally, remarks)

    def plan(
        self, cluster: Cluster, options: BuildOptions, keep_slices: bool, folder: Path
    ) -> Setting:
        """Fit the work to the memory of the smallest worker."""
        spare = ((cluster.memory or ROOMY_BYTES) - BASE_BYTES) // 4
        cells = min(1 << (spare // WINDOW_CELL_BYTES).bit_length() - 1, LARGEST_WINDOW)
        return Setting(options, keep_slices, folder, self.slice_bytes, cells, most_bytes=spare)


@contextmanager
def open_scratch(
    fleet: Fleet, paths: Sequence[Path], options: BuildOptions, keep_slices: bool
) -> Iterator[Path]:
    """Make, or find again, the folder where the tasks of this very build leave what they found.

    It goes away when the build is done. Where the build fails or is killed, it stays, and the same
    build goes on where it was.

    Raises
    ------
    OutputError
        The folder cannot be made.
    """
    what = [
        version("occmap"),
        to_plain(options),
        keep_slices,
        fleet.slice_bytes,
        [[str(path), *describe_state(path)] for path in paths],
    ]
    digest = hashlib.sha256(json.dumps(what).encode()).hexdigest()[:16]
    folder = fleet.scratch.absolute() / f"build-{digest}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made ({error.strerror})", where=fleet.scratch) from None
    yield folder
    shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):  # another build may have something in it
        fleet.scratch.rmdir()


def describe_state(path: Path) -> list[int]:
    """Sizes and times of change (ns) of the files of a log; nothing of one that is not there."""
    inner = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
    return [number for each in inner for number in (each.stat().st_size, each.stat().st_mtime_ns)]


def survey_logs(cluster: Cluster, setting: Setting, paths: Sequence[Path]) -> list[Survey]:
    """Open all logs.

    Raises
    ------
    OccmapError
        A log cannot be read, or has no scans or no poses.
    """
    jobs = [SurveyJob(setting, place, path) for place, path in enumerate(paths)]
    surveys = cluster.run(survey_log, jobs)
    for survey in surveys:
        if survey.error is not None:
            raise survey.error
    return surveys


def trace_logs(
    cluster: Cluster, setting: Setting, surveys: Sequence[Survey], progress: Progress
) -> list[LogTrace]:
    """Trace the parts of all logs, until each shows what its whole log shows."""
    total = sum(survey.scans for survey in surveys)

    def tell(_job: TraceJob, traced: Traced) -> None:
        progress(traced.tally.scans_read, total)

    logs = plan_traces(cluster, setting, surveys)
    while pairs := [(log, job) for log in logs for job in log.list_open()]:
        jobs = [job for _, job in pairs]
        for (log, job), traced in zip(pairs, cluster.run(trace_part, jobs, tell), strict=True):
            log.traced[job.name] = traced
    return logs


def plan_traces(cluster: Cluster, setting: Setting, surveys: Sequence[Survey]) -> list[LogTrace]:
    """Plan the parts of all logs; for a stride, the wanted scans of each are counted first."""
    counts = {survey.log: [0] * survey.parts for survey in surveys}
    if setting.options.selection.stride > 1:
        jobs = [
            job
            for survey in surveys
            for job in LogTrace(setting, survey, counts[survey.log]).jobs
            if survey.parts > 1
        ]
        for job, wanted in zip(jobs, cluster.run(count_wanted, jobs), strict=True):
            counts[job.survey.log][job.part or 0] = wanted
    return [LogTrace(setting, survey, counts[survey.log]) for survey in surveys]


def reduce_blocks(cluster: Cluster, setting: Setting, logs: Sequence[LogTrace]) -> list[Piece]:
    """Add up each block of the map from all that was observed in it."""
    found: dict[BlockKey, list[Piece]] = {}
    for part in (part for log in logs for part in log.parts):
        for block, pieces in part.pieces.items():
            found.setdefault(block, []).extend(pieces)
    jobs = [ReduceJob(setting, block, tuple(found[block])) for block in sorted(found)]
    return cluster.run(reduce_block, jobs)


def gather(setting: Setting, pieces: Sequence[Piece], tally: Tally, remarks: Remarks) -> Observed:
    """Put the map together of its blocks."""
    grid, layers = make_grid(setting.options), list[Slices]()
    for content in read_pieces(setting.folder, pieces):
        for (row, col), cells in zip(content.tiles.tolist(), content.cells, strict=True):
            grid.tiles[row, col] = cells
        layers += content.slices
    return Observed(grid, (unite(layers),) if setting.keep_slices else (), tally, remarks)
