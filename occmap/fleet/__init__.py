"""A build by many workers, here or on a cluster: who they are, and where they leave what they find.

Evidence adds up in any order, so logs are traced anywhere, and blocks of the map are added up
anywhere. What workers observe goes through files that all of them share; the driver gets only
counts and notes.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path

from occmap import pipeline, writers
from occmap.evidence import manifest as manifests
from occmap.fleet import tasks
from occmap.fleet.cluster import Job, open_cluster, refuse_unseen_files
from occmap.fleet.tasks import Crew, Setting
from occmap.grid.rendering import Framing
from occmap.grid.tiles import WINDOW_CELLS
from occmap.options import BuildOptions
from occmap.report import join_names
from occmap.report.results import Report
from occmap.scans import Keep
from occmap.scans.align import settle_align
from occmap.scans.tally import Tally, refuse_unseen, refuse_unused
from occmap.scans.tracing import Observed, Progress
from occmap.store import open_store
from occmap.store.painting import RenderOptions, open_map, survey_blocks
from occmap.store.writing import create_store, finish_store
from occmap.types import Paths
from occmap.writers.atomic import lock, make_folder, refuse_unwritable

BASE_BYTES = 300 << 20
"""What a worker takes before it observes anything"""
WINDOW_CELL_BYTES = 20
"""What a cell takes in a window"""
ROOMY_BYTES = 4 << 30
"""What a worker without a limit is taken to have"""


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
        self, paths: Paths, options: BuildOptions, outputs: Paths, progress: Progress
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
        self, paths: Paths, options: BuildOptions, keep: Keep, progress: Progress
    ) -> Observed:
        """Trace all usable scans of logs by many workers, as `occmap.scans.tracing.observe` does.

        Raises
        ------
        OccmapError
            As there, or the workers cannot do it.
        """
        with self.work(paths, options, keep, progress) as crew, crew.tally.time("fold"):
            # By workers: many logs of one place are more than this process adds up in their time.
            pieces = crew.cluster.run(tasks.reduce_block, crew.setting, crew.blocks)
            where, ground = join_names(crew.tally.logs), crew.setting.keep.ground
            seen = replace(tasks.add_up(crew.setting, pieces), where=where, ground=ground)
            return Observed(seen, crew.tally, crew.setting.options)

    def _build_store(
        self, paths: Paths, options: BuildOptions, output: Path, progress: Progress
    ) -> Report:
        """Build a store of which this process never holds the map; raises as `build`."""
        writers.check_outputs([output], pipeline.list_input_files(paths, options), options.writing)
        options, unaligned = settle_align(paths, options)
        options, keep = pipeline.choose_keep(options, [output], None)
        with self.work(paths, options, keep, progress) as crew:
            tally, options = crew.tally, crew.setting.options
            refuse_unused(tally)
            refuse_unseen(tally, crew.blocks)
            with tally.time("fold"):
                hashed = crew.cluster.run(tasks.hash_log, crew.setting, crew.logs)
                files = chain.from_iterable(hashed)
                made = manifests.describe_build(files, options, tally.to_json())
                manifest = replace(manifests.plan_manifest(options), builds=(made,))
            with make_folder(output, f".occmap-{crew.setting.folder.name}.tmp") as store:
                crew.setting = replace(crew.setting, store=store)
                with tally.time("fold"):
                    create_store(store, manifest, [job.block for job in crew.blocks])
                    records = crew.cluster.run(tasks.store_block, crew.setting, crew.blocks)
                with tally.time("render"):
                    facts = crew.paint(records)
                with tally.time("write"):
                    finish_store(store, manifest, records, crew.setting.keep.ground)
                if options.writing.shapes:  # which may lie between blocks, or reach beyond the map
                    with tally.time("render"):
                        edited = RenderOptions(writing=options.writing)
                        shown = open_map(open_store(store), options.model, edited)
                        facts = facts._replace(counts=survey_blocks(shown).counts)
        tally.notes += unaligned
        report = pipeline.make_report(options, [output], tally, facts, manifest)
        return replace(report, files=(str(output),))

    @contextmanager
    def work(
        self, paths: Paths, options: BuildOptions, keep: Keep, progress: Progress
    ) -> Iterator[Crew]:
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
            logs = [Job(f"log{place:05}", str(each)) for place, each in enumerate(paths)]
            tally = Tally(logs=list(map(str, paths)), notes=list(list_other_builds(folder)))
            crew = Crew(cluster, setting, logs, tally)
            crew.settle()
            crew.trace(progress)
            yield crew


def list_other_builds(folder: Path) -> Iterator[str]:
    """Say which folders beside that of a build are of other ones."""
    for other in sorted({*folder.parent.glob("build-*")} - {folder}):
        yield (
            f"{other}: of a build with another log, option or version of occmap, which this build "
            "does not go on from; remove the folder if nobody will"
        )


@contextmanager
def open_scratch(scratch: Path, paths: Paths, options: BuildOptions, keep: Keep) -> Iterator[Path]:
    """Make, or find again, the folder where the tasks of this very build leave what they found.

    It goes away when the build is done, and with it `scratch`, unless that was there and empty.
    Where the build fails or is killed, it stays, and the same build goes on where it was. Meanwhile
    another process that begins the same build waits.

    Raises
    ------
    OutputError
        The folder cannot be made.
    """
    digest = digest_build(scratch, paths, options, keep)
    folder, mark = (scratch.absolute() / f"{kind}-{digest}" for kind in ("build", "lock"))
    with ExitStack() as outer, ExitStack() as stack:
        if not scratch.is_dir() or any(scratch.iterdir()):  # else the user made it
            outer.callback(remove_empty, scratch)  # another build may have something in it
        is_held = False
        while not is_held:  # whoever had the lock before took both away
            stack.close()
            with refuse_unwritable(scratch):
                folder.mkdir(parents=True, exist_ok=True)
                mark.touch()
            is_held = lock(mark, stack) and mark.exists()
        stack.callback(mark.unlink, missing_ok=True)
        stack.callback(remove_empty, folder)  # where nothing was done that is worth to go on from
        yield folder
        shutil.rmtree(folder, ignore_errors=True)


def remove_empty(folder: Path) -> None:
    """Remove a folder in which nothing is."""
    with suppress(OSError):
        folder.rmdir()


def digest_build(scratch: Path, paths: Paths, options: BuildOptions, keep: Keep) -> str:
    """Name a build by all that its tasks depend on: version, options, and files as they are."""
    inputs = [*paths, *options.posing.files]
    states = [it.stat() for path in inputs if path.exists() for it in manifests.list_files(path)]
    what = [
        version("occmap"),
        manifests.write_options(options),
        str(scratch.absolute()),  # from two of them, one output may be written at once
        keep[:2],
        keep.ground and hashlib.sha256(keep.ground.height_mm.tobytes()).hexdigest(),
        [str(path) for path in inputs],
        [[state.st_size, state.st_mtime_ns] for state in states],
    ]
    return hashlib.sha256(json.dumps(what).encode()).hexdigest()[:16]
