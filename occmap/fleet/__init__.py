"""A build by many workers, on this machine or on a cluster: the tasks of a build, and their order.

Evidence adds up in any order, so logs are traced anywhere, and blocks of the map are added up
anywhere. What workers observe goes through files that all of them share; the driver gets only
counts and notes.
"""

import hashlib
import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import reduce
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occmap import pipeline, writers
from occmap.cells import CellBox
from occmap.errors import require
from occmap.evidence import manifest as manifests
from occmap.fleet import tasks
from occmap.fleet.cluster import Cluster, open_cluster, refuse_unseen_files
from occmap.fleet.tasks import BlockJob, Job, Piece, Setting
from occmap.grid import Lattice
from occmap.grid.rendering import Framing
from occmap.grid.tiles import WINDOW_CELLS
from occmap.options import BuildOptions
from occmap.report.results import MapFacts, Report, list_notes
from occmap.scans import tracing
from occmap.scans.align import settle_align
from occmap.scans.tally import Tally, refuse_unseen, refuse_unused
from occmap.scans.tracing import BuildGround, Keep, Observed, Progress, Remarks
from occmap.store.layout import Block, BlockRecord, list_blocks
from occmap.store.writing import create_store, finish_store
from occmap.types import Update
from occmap.writers.atomic import lock, make_folder, refuse_unwritable

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
    jobs: list[Job]
    """One for each log"""
    tally: Tally
    remarks: Remarks
    reductions: list[BlockJob]
    """One for each block that is to be added up, with all that was observed in it"""


@dataclass(frozen=True)
class Fleet:
    """Who does the work of a build, and where they leave what they found."""

    address: str
    """Of a Dask scheduler, or `local`"""
    scratch: Path
    """A folder that all workers share"""
    describe: Callable[[str], None] = lambda _text: None
    """Told how far the work is"""

    def build(
        self,
        paths: Sequence[Path],
        options: BuildOptions,
        outputs: Sequence[Path],
        progress: Progress,
    ) -> Report:
        """Build one map by many workers, as `occmap.pipeline.build` does in one process.

        Where a store of all that was observed is the only output, the workers write it, block by
        block. For all else this process puts the map together.

        Raises
        ------
        OccmapError
            As there, or the workers cannot do it.
        """
        is_part = options.min_passes is not None or options.framing != Framing()
        is_added = options.resume is not None or options.resume_if_there is not None
        if [each.suffix.lower() for each in outputs] == [".zarr"] and not (is_part or is_added):
            return self._build_store(paths, options, outputs[0], progress)
        return pipeline.build(paths, options, outputs, progress, self.observe).report

    def observe(
        self, paths: Sequence[Path], options: BuildOptions, keep: Keep, progress: Progress
    ) -> Observed:
        """Trace all usable scans of logs by many workers, as `occmap.scans.tracing.observe` does.

        Raises
        ------
        OccmapError
            As there, or the workers cannot do it.
        """
        with self.work(paths, options, keep, progress) as work, work.tally.time("fold"):
            pieces = work.cluster.run("reduce", tasks.reduce_block, work.reductions)
            seen = tasks.add_up_pieces(work.setting, pieces)
            settled = work.setting.keep.ground, work.setting.options
            return Observed(*seen, work.tally, work.remarks, *settled)

    def _build_store(
        self, paths: Sequence[Path], options: BuildOptions, output: Path, progress: Progress
    ) -> Report:
        """Build a store of which this process never holds the map; raises as `build`."""
        writers.check_outputs([output], pipeline.list_input_files(paths, options), options.writing)
        options, unaligned = settle_align(paths, options)
        options, keep = pipeline.choose_keep(options, [output], None)
        with self.work(paths, options, keep, progress) as work:
            tally, remarks, options = work.tally, work.remarks, work.setting.options
            refuse_unused(paths, tally)
            refuse_unseen(paths, tally, work.reductions)
            with tally.time("fold"):
                hashed = work.cluster.run("hash", tasks.hash_log, work.jobs)
                known = dict(zip(paths, hashed, strict=True))
                made = manifests.describe_build(paths, options, tally.to_json(), known)
                manifest = replace(manifests.plan_manifest(options), builds=(made,))
            with make_folder(output, f".occmap-{work.setting.folder.name}.tmp") as store:
                with tally.time("fold"):
                    create_store(store, manifest, [job.block for job in work.reductions])
                    jobs = [replace(job, store=store) for job in work.reductions]
                    records = work.cluster.run("reduce", tasks.store_block, jobs)
                with tally.time("render"):
                    facts = paint_blocks(work, jobs, records)
                with tally.time("write"):
                    finish_store(store, manifest, records, work.setting.keep.ground)
        remarks.notes += [*unaligned, *manifests.list_doubts(manifest)]
        remarks.notes += list_notes(paths, options, [output], tally, facts)
        report = pipeline.make_report(options, tally, remarks, facts, None)
        return replace(report, files=(str(output),))

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
        with (
            open_cluster(self.address, options.jobs, self.describe) as cluster,
            open_scratch(self.scratch, paths, options, keep) as folder,
        ):
            # A log that is not here either is refused when it is opened.
            refuse_unseen_files(cluster, [folder, *(path for path in paths if path.exists())])
            spare = ((cluster.memory or ROOMY_BYTES) - BASE_BYTES) // 4
            window = min(1 << (spare // WINDOW_CELL_BYTES).bit_length() - 1, WINDOW_CELLS)
            setting = Setting(options, keep, folder, len(paths), window, spare)
            jobs = [Job(setting, f"log{place:05}", str(each)) for place, each in enumerate(paths)]
            tally = Tally()
            remarks = Remarks([str(path) for path in paths], list(list_other_builds(folder)))
            setting = settle(cluster, jobs, tally, remarks)
            jobs = [replace(job, setting=setting) for job in jobs]
            traced = cluster.run(
                "trace",
                tasks.trace_log,
                jobs,
                lambda log: progress(log.tally.scans_read, setting.scans),
            )
            blocks: dict[Block, list[Piece]] = defaultdict(list)
            for path, log in zip(paths, traced, strict=True):
                remarks.note(path, log.log_notes, log.notes)
                tally.add(log.tally)
                for block, pieces in log.pieces.items():
                    blocks[block] += pieces
            reductions = [BlockJob.of(setting, *each) for each in sorted(blocks.items())]
            yield Work(cluster, setting, jobs, tally, remarks, reductions)


def list_other_builds(folder: Path) -> Iterator[str]:
    """Say which folders beside that of a build are of other ones."""
    for other in sorted(folder.parent.glob("build-*")):
        if other != folder:
            yield (
                f"{other}: of a build with another log, option or version of occmap, which this "
                "build does not go on from; remove the folder if nobody will"
            )


def settle(cluster: Cluster, jobs: Sequence[Job], tally: Tally, remarks: Remarks) -> Setting:
    """Settle what only the logs show: how many scans, which update, and the ground below clouds.

    Raises
    ------
    OccmapError
        A log cannot be read, or they hold scans and clouds.
    """
    setting = jobs[0].setting
    with tally.time("open"):
        counts, settled = zip(*cluster.run("open", tasks.survey_log, jobs), strict=True)
    require(
        len({each.update for each in settled}) == 1,
        "some of the logs hold laser scans, others clouds of points",
        "map one kind at a time: choose with `topics`",
    )
    options = settled[0]
    setting = replace(setting, options=options, scans=sum(counts))
    if options.update is not Update.CLOUD:
        return setting
    with tally.time("ground"):
        found = find_ground(cluster, jobs, setting)
    remarks.notes += found.notes
    keep = setting.keep._replace(ground=found.ground)
    return replace(setting, keep=keep, options=found.options)


def find_ground(cluster: Cluster, jobs: Sequence[Job], setting: Setting) -> BuildGround:
    """Find the ground below the clouds of all logs."""
    from occmap.clouds.ground import GroundFinder  # noqa: PLC0415  late: it brings numba

    def count(options: BuildOptions) -> GroundFinder:
        turned = replace(setting, options=options)
        level = "".join(f" {angle}" for angle in options.posing.level or ())
        some = [replace(job, setting=turned, name=job.name + level) for job in jobs]
        finder = GroundFinder(setting.scans)
        for counted in cluster.run("ground", tasks.survey_ground, some):
            finder.join(counted)
        return finder

    return tracing.level_ground(count, setting.options, setting.keep.ground)


@contextmanager
def open_scratch(
    scratch: Path, paths: Sequence[Path], options: BuildOptions, keep: Keep
) -> Iterator[Path]:
    """Make, or find again, the folder where the tasks of this very build leave what they found.

    It goes away when the build is done. Where the build fails or is killed, it stays, and the same
    build goes on where it was. Meanwhile another process that begins the same build waits.

    Raises
    ------
    OutputError
        The folder cannot be made.
    """
    inputs = [*paths, *options.posing.files]
    files = [file for path in inputs if path.exists() for file in manifests.list_files(path)]
    states = [file.stat() for file in files]
    what = [
        version("occmap"),
        manifests.write_options(options),
        str(scratch.absolute()),  # from two of them, one output may be written at once
        keep[:2],
        keep.ground and hashlib.sha256(keep.ground.height_mm.tobytes()).hexdigest(),
        [str(path) for path in inputs],
        [[state.st_size, state.st_mtime_ns] for state in states],
    ]
    digest = hashlib.sha256(json.dumps(what).encode()).hexdigest()[:16]
    folder, mark = (scratch.absolute() / f"{kind}-{digest}" for kind in ("build", "lock"))
    with ExitStack() as stack:
        is_held = False
        while not is_held:  # whoever had the lock before took both away
            stack.close()
            with refuse_unwritable(scratch):
                folder.mkdir(parents=True, exist_ok=True)
                mark.touch()
            is_held = lock(mark, stack) and mark.exists()
        stack.callback(mark.unlink, missing_ok=True)
        yield folder
        shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):  # another build may have something in it
        scratch.rmdir()


def paint_blocks(work: Work, jobs: list[BlockJob], records: Sequence[BlockRecord]) -> MapFacts:
    """Paint the pictures of all blocks, and sum up what the report tells of them.

    Blocks beside those that are written are looked at, too: hits speak for the cells around them.
    """
    beside = {block for record in records for block in list_blocks(record.reach.grow(1))}
    beside -= {job.block for job in jobs}
    around = [replace(BlockJob.of(work.setting, block), store=jobs[0].store) for block in beside]
    measured = work.cluster.run("paint", tasks.measure_block, [*jobs, *around])
    reaches, cells, hits = zip(*measured, strict=True)
    box = reduce(CellBox.join, filter(None, reaches))
    agreeing, met = np.sum(hits, axis=0).tolist()
    lattice = Lattice(work.setting.options.resolution)
    where = lattice.resolution, lattice.measure(box), box.shape
    return MapFacts(*where, np.sum(cells, axis=0), agreeing / met if met else None)
