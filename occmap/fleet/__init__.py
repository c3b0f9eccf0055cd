"""A build by many workers, on this machine or on a cluster: the tasks of a build, and their order.

Evidence adds up in any order, so parts of logs are traced anywhere, and blocks of the map are added
up anywhere. What workers observe goes through files that all of them share; the driver gets only
counts and notes.
"""

import hashlib
import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from occmap.errors import OutputError
from occmap.evidence.manifest import UNRECORDED, list_files, write_value
from occmap.fleet.cluster import Cluster, open_cluster, refuse_unseen_files
from occmap.fleet.runs import BlockJob, Job, Piece, Setting, add_up, reduce_block
from occmap.fleet.settling import trace_logs
from occmap.fleet.tasks import survey_log
from occmap.grid.spec import WINDOW_CELLS
from occmap.options import BuildOptions
from occmap.steps.observing import Keep, Observed, Progress, Remarks
from occmap.steps.tally import Tally
from occmap.store.blocks import Block

SLICE_BYTES = 256_000_000
"""Small enough for any worker, and large enough that the same tiles are seldom touched again"""
BASE_BYTES = 300 << 20
"""What a worker takes before it observes anything"""
WINDOW_CELL_BYTES = 20
"""What a cell takes in a window"""
ROOMY_BYTES = 4 << 30
"""What a worker without a limit is taken to have"""


class Work(NamedTuple):
    """What workers found in logs, and where they left what was observed."""

    cluster: Cluster
    setting: Setting
    tally: Tally
    remarks: Remarks
    blocks: dict[Block, dict[int, list[Piece]]]
    """Of each block of the map, by the places of logs on the command line"""


@dataclass(frozen=True)
class Fleet:
    """Who does the work of a build, and where they leave what they found."""

    address: str
    """Of a Dask scheduler, or `local`"""
    scratch: Path
    """A folder that all workers share"""
    slice_bytes: int = SLICE_BYTES
    """About how much of a log is one task"""
    describe: Callable[[str], None] = lambda _text: None
    """Told how far the work is"""

    def observe(
        self, paths: Sequence[Path], options: BuildOptions, keep: Keep, progress: Progress
    ) -> Observed:
        """Trace all usable scans of logs by many workers, as `observing.observe` does by one.

        Raises
        ------
        OccmapError
            As there, or the workers cannot do it.
        """
        with self.work(paths, options, keep, progress) as work, work.tally.time("fold"):
            pieces = work.cluster.run("reduce", reduce_block, list_reductions(work))
            work.remarks.notes += work.cluster.list_losses()
            return Observed(*add_up(work.setting, pieces), work.tally, work.remarks)

    @contextmanager
    def work(
        self, paths: Sequence[Path], options: BuildOptions, keep: Keep, progress: Progress
    ) -> Iterator[Work]:
        """Find workers, and let them trace all scans; what they found goes when the block ends.

        Raises
        ------
        OccmapError
            As `observe`.
        """
        tally = Tally(recorder=keep.make_recorder(0, 1, options.returns))
        remarks = Remarks([str(path) for path in paths])
        with (
            open_cluster(self.address, options.jobs, self.describe) as cluster,
            open_scratch(self, paths, options, keep) as folder,
        ):
            remarks.notes += [
                f"{other}: of a build with another log, option or version of occmap, which this "
                "build does not go on from; remove the folder if nobody will"
                for other in sorted(self.scratch.absolute().glob("build-*"))
                if other != folder
            ]
            # A log that is not here either is refused when it is opened.
            refuse_unseen_files(cluster, [folder, *(path for path in paths if path.exists())])
            spare = ((cluster.memory or ROOMY_BYTES) - BASE_BYTES) // 4
            window = min(1 << (spare // WINDOW_CELL_BYTES).bit_length() - 1, WINDOW_CELLS)
            sizes = self.slice_bytes, window, spare
            setting = Setting(options, keep, folder, *sizes, logs=len(paths))
            with tally.time("open"):
                surveys = cluster.run("open", survey_log, list_surveys(setting, paths))
            blocks: dict[Block, dict[int, list[Piece]]] = defaultdict(lambda: defaultdict(list))
            for place, log in enumerate(trace_logs(cluster, setting, surveys, progress)):
                remarks.note(log.survey.path, log.parts[0].log_notes, log.list_findings())
                for part in log.parts:
                    tally.add(part.tally)
                    for block, pieces in part.pieces.items():
                        blocks[block][place] += pieces
            yield Work(cluster, setting, tally, remarks, blocks)


@contextmanager
def open_scratch(
    fleet: Fleet, paths: Sequence[Path], options: BuildOptions, keep: Keep
) -> Iterator[Path]:
    """Make, or find again, the folder where the tasks of this very build leave what they found.

    It goes away when the build is done. Where the build fails or is killed, it stays, and the same
    build goes on where it was.

    Raises
    ------
    OutputError
        The folder cannot be made.
    """
    poses = options.posing.poses
    inputs = [*paths, Path(poses)] if poses else paths
    states = [file.stat() for path in inputs if path.exists() for file in list_files(path)]
    what = [
        version("occmap"),
        {name: value for name, value in write_value(options).items() if name not in UNRECORDED},
        keep,
        fleet.slice_bytes,
        [str(path) for path in inputs],
        [[state.st_size, state.st_mtime_ns] for state in states],
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


def list_surveys(setting: Setting, paths: Sequence[Path]) -> list[Job]:
    """List the logs that are to be opened."""
    return [Job(setting, f"log{place:05}", str(path)) for place, path in enumerate(paths)]


def list_reductions(work: Work) -> list[BlockJob]:
    """List the blocks that are to be added up, each with all that was observed in it."""
    return [
        replace(BlockJob.of(work.setting, block), pieces=tuple(chain.from_iterable(found.values())))
        for block, found in sorted(work.blocks.items())
    ]
