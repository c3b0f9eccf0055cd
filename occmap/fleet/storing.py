"""A store that the workers write themselves, block by block: the driver never holds the map."""

import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from occmap.cells import Manifest
from occmap.evidence.manifest import describe_build, list_doubts, plan_manifest
from occmap.fleet import Fleet, Work, list_reductions, list_surveys
from occmap.fleet.runs import BlockJob, Setting, add_up_block, once, read_stub, write_stub
from occmap.fleet.tasks import hash_log
from occmap.grid.lattice import CellBox, Lattice
from occmap.grid.rendering import count_agreeing
from occmap.options import BuildOptions
from occmap.pipeline import list_inputs, make_report
from occmap.report.doubts import list_notes
from occmap.report.results import MapFacts, Report, count_cells
from occmap.steps.alignment import settle_align
from occmap.steps.observing import Keep, Progress
from occmap.steps.tally import refuse_unseen, refuse_unused
from occmap.store.blocks import Block, BlockRecord, list_blocks
from occmap.store.writing import create_store, finish_store, paint_block, write_block
from occmap.types import Int64
from occmap.writers.atomic import follow_links, publish_folder, refuse_unwritable
from occmap.writers.outputs import check_outputs


def build_store(
    fleet: Fleet, paths: Sequence[Path], options: BuildOptions, output: Path, progress: Progress
) -> Report:
    """Build a store from all usable scans of logs, block by block.

    Raises
    ------
    OccmapError
        As `occmap.pipeline.build`, or the workers cannot do it.
    """
    check_outputs([output], list_inputs(paths, options))
    options, unaligned = settle_align(paths, options)
    with fleet.work(paths, options, keep=Keep(slices=True), progress=progress) as work:
        tally, remarks = work.tally, work.remarks
        refuse_unused(paths, tally)
        refuse_unseen(paths, tally, work.blocks)
        with tally.time("fold"):
            logs = list(dict.fromkeys(paths))
            hashed = work.cluster.run("hash", hash_log, list_surveys(work.setting, logs))
            known = dict(zip(logs, hashed, strict=True))
            build = describe_build(paths, options, tally.to_json(), known)
            manifest = plan_manifest(options, [build])
            store = open_target(work.setting, output, manifest, work.blocks)
            records = write_blocks(work, store, known, paths)
        with tally.time("render"):
            facts = paint_blocks(work, store, records)
        remarks.notes += work.cluster.list_losses()
        with tally.time("write"):
            finish_store(store, manifest, records)
            with refuse_unwritable(output):
                publish_folder(store, follow_links(output))
    remarks.notes += [*unaligned, *list_doubts(manifest)]
    remarks.notes += list_notes(paths, options, [output], tally, facts)
    return replace(make_report(options, tally, remarks, facts), files=(str(output),))


def open_target(
    setting: Setting, output: Path, manifest: Manifest, blocks: Iterable[Block]
) -> Path:
    """Create a store that only a rename puts in its place, or find the one that was begun."""
    target = follow_links(output)
    stub = setting.folder / "store.stub"
    is_near = setting.folder.stat().st_dev == target.parent.stat().st_dev
    store = (setting.folder if is_near else target.parent) / f".occmap-{setting.folder.name}.tmp"
    if read_stub(stub) is None or not store.exists():
        shutil.rmtree(store, ignore_errors=True)
        for done in setting.folder.glob(f"*.{store_block.__name__}"):
            done.unlink()
        create_store(store, manifest, blocks)
        write_stub(stub, True)
    return store


def write_blocks(
    work: Work, store: Path, known: dict[Path, list[dict[str, Any]]], paths: Sequence[Path]
) -> list[BlockRecord]:
    """Write all blocks of a store."""
    ends = np.cumsum([len(known[path]) for path in paths])
    files = [range(end - len(known[path]), end) for end, path in zip(ends, paths, strict=True)]
    jobs = []
    for job in list_reductions(work):
        logs = tuple(chain.from_iterable(files[log] for log in work.blocks[job.block]))
        jobs.append(replace(job, logs=logs, store=store))
    return work.cluster.run("reduce", store_block, jobs)


@once
def store_block(job: BlockJob) -> BlockRecord:
    """Add up a block and write it.

    Raises
    ------
    OccmapError
        A run file cannot be read, or the store cannot be written.
    """
    return write_block(job.store, job.block, add_up_block(job))


def paint_blocks(work: Work, store: Path, records: Sequence[BlockRecord]) -> MapFacts:
    """Paint the pictures of all blocks, and sum up what the report tells of them.

    Blocks beside those that are written are looked at, too: hits speak for the cells around them.
    """
    written = {record.block: record.logs for record in records}
    around = {block for record in records for block in list_blocks(record.reach.grow(1))}
    jobs = [
        replace(BlockJob.of(work.setting, block), logs=written.get(block, ()), store=store)
        for block in sorted(around)
    ]
    measured = work.cluster.run("paint", measure_block, jobs)
    reaches, cells, hits = zip(*measured, strict=True)
    box = reduce(CellBox.join, filter(None, reaches))
    agreeing, met = np.sum(hits, axis=0).tolist()
    lattice = Lattice(work.setting.options.resolution)
    where = lattice.resolution, lattice.measure(box), box.shape
    return MapFacts(*where, np.sum(cells, axis=0), agreeing / met if met else None)


def measure_block(job: BlockJob) -> tuple[CellBox | None, Int64, tuple[int, int]]:
    """Paint the pictures of a block, if it is one that was written, and measure it.

    Returns a box around the cells that are observed, if there are any; numbers (4,) as
    `count_cells` gives them; and the hits in cells called occupied, and all hits.

    Raises
    ------
    OutputError
        They cannot be written.
    """
    box = job.block.box
    grid, made = paint_block(job.store, job.block, keep=bool(job.logs))
    reach = CellBox.around(made.observed, box.row, box.col)
    cells = count_cells(made, job.setting.options.writing)
    return reach, cells, count_agreeing(grid, made.occupied, box)
