"""The whole tool on one page: logs in, an occupancy map and a report out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from occmap.alignment import settle_align
from occmap.evidence import to_evidence
from occmap.evidence.fit import list_misfit, view_tiles
from occmap.evidence.manifest import describe_build, list_mixed, plan_manifest
from occmap.evidence.merging import open_resumed
from occmap.evidence.persistence import render_lasting
from occmap.evidence.publishing import describe_resumed
from occmap.evidence.repetition import list_repeated
from occmap.grid.framing import frame
from occmap.grid.stacks import add_stack
from occmap.grid.tiles import TileGrid
from occmap.mounts import list_misfits
from occmap.observing import Keep, Observe, Observed, Progress, ignore_progress
from occmap.observing import observe as observe_here
from occmap.options import BuildOptions
from occmap.report import (
    MapFacts,
    MapSummary,
    Remarks,
    Report,
    Tally,
    describe_map,
    list_dates,
    list_disagreement,
    list_frames,
    list_lacking,
    list_requested,
    refuse_unseen,
    refuse_unused,
)
from occmap.sensor.models import SensorModel
from occmap.types import Evidence, OccupancyMap
from occmap.writers import Product, check_outputs, want_evidence, want_journey, write_outputs
from occmap.writers.atomic import hold_alone


class Build(NamedTuple):
    """A map and how it came about."""

    map: OccupancyMap
    report: Report
    observed: TileGrid
    """What the map was made of, before `min_passes` forgets anything"""
    evidence: Evidence | None
    """The same to write and to merge, with its slices of time; None where no output is of it"""


def build(
    paths: Sequence[Path],
    options: BuildOptions,
    outputs: Sequence[Path] = (),
    progress: Progress = ignore_progress,
    observe: Observe = observe_here,
) -> Build:
    """Build one map from all usable scans of one or more logs, and write it.

    Parameters
    ----------
    observe
        Who traces the scans: this process, or the workers of an `occmap.fleet.Fleet`.

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, the map would be too large, or an output
        cannot be written.
    """
    check_outputs(outputs, list_inputs(paths, options))
    with hold_alone(options.resume or options.resume_if_there, outputs):
        # Not after a fleet: it would be read once more, here.
        look = partial(look_into, paths, options) if observe is observe_here else dict
        return build_alone(paths, options, outputs, partial(observe, progress=progress), look)


def list_inputs(paths: Sequence[Path], options: BuildOptions) -> list[Path]:
    """List the files that a build reads, which nothing may write over."""
    bags = [path / "metadata.yaml" for path in paths]  # of a folder that is a bag
    return [*paths, *bags, Path(options.posing.poses or "")]


def build_alone(
    paths: Sequence[Path],
    options: BuildOptions,
    outputs: Sequence[Path],
    observe: Callable[[Sequence[Path], BuildOptions, Keep], Observed],
    look: Callable[[], dict[str, Any]],
) -> Build:
    """Build and write a map, while nobody else adds to the same evidence."""
    saved = open_past(options)
    options, unaligned = settle_align(paths, adopt_align(options, saved))
    keeps_times = options.min_passes is not None or want_evidence(outputs)
    keep = Keep(slices=keeps_times, journey=want_journey(outputs))

    tiles, slices, tally, remarks = observe(paths, options, keep)
    misfit: list[str] = []
    if saved:
        misfit = add_past(tiles, saved, options.model)
        slices = saved.slices + slices
    refuse_unused(paths, tally)
    refuse_unseen(paths, tally, tiles.keys)

    with tally.time("render"):
        grid, lost = render_lasting(
            tiles, slices, options.min_passes, options.model, options.max_cells
        )
        grid = frame(grid, options.framing, options.model.prior, options.max_cells)

    manifest = plan_manifest(options)
    if want_evidence(outputs):  # only then: it takes time to hash the logs
        past = saved.manifest if saved else manifest
        with tally.time("write"):
            made = describe_build(paths, options, tally.to_json())
        manifest = replace(manifest, builds=(*past.builds, made), subtracted=past.subtracted)

    resumed = describe_resumed(saved) if saved else None
    disagreement = list(list_disagreement(grid))
    notes = [
        *list_requested(paths, outputs, options.writing, options.model),
        *remarks.notes,
        *list_new(options, saved),
        *unaligned,
        *options.list_idle(),
        *list_dates(options.selection, tally),
        *list_frames(tally),
        *list_lacking(tally, resumed),
        *misfit,
        *lost,
        *disagreement,
        *(list_misfits(paths, options) if disagreement else ()),
        *list_repeated(manifest.builds),
        *list_mixed(manifest),
    ]
    facts, remarks = describe_map(grid, options.writing), replace(remarks, notes=notes)
    report = replace(make_report(facts, options, tally, remarks), resumed=resumed)

    product = Product(
        grid,
        cache(partial(to_evidence, tiles, manifest, slices, saved.where if saved else "")),
        tally.recorder.finish() if tally.recorder else None,
        report.to_json,
        look,
    )
    with tally.time("write"):
        files = write_outputs(outputs, product, options.writing)
    report = replace(report, files=tuple(files), seconds=tally.list_seconds())
    return Build(grid, report, tiles, product.evidence() if want_evidence(outputs) else None)


def look_into(paths: Sequence[Path], options: BuildOptions) -> dict[str, Any]:
    """Look into the logs as `occmap check` does."""
    from occmap.inspection import inspect  # noqa: PLC0415  late: few builds want it

    return inspect(paths, options).to_json()


def open_past(options: BuildOptions) -> Evidence | None:
    """Read the evidence that a build is to be added to, if there is any."""
    there = options.resume_if_there
    path = options.resume or (there if there and there.exists() else None)
    return open_resumed(path, plan_manifest(options)) if path else None


def add_past(tiles: TileGrid, saved: Evidence, model: SensorModel) -> list[str]:
    """Add the evidence that a build goes on from, and say so where the two do not fit."""
    misfit = list(list_misfit(tiles, view_tiles(saved), model, "the logs that are added to it"))
    add_stack(tiles, saved.tiles, saved.cells)
    return [f"{saved.where}: {text}" for text in misfit]


def list_new(options: BuildOptions, saved: Evidence | None) -> Iterator[str]:
    """Say that a build that was to be added to others is the first of them."""
    if options.resume_if_there and not saved:
        yield f"{options.resume_if_there}: no such file, so this build adds to nothing"


def adopt_align(options: BuildOptions, saved: Evidence | None) -> BuildOptions:
    """Turn a map that is added to evidence as that is turned, where the user names no angle."""
    if saved is None or options.posing.align is not None:
        return options
    return replace(options, posing=replace(options.posing, align=saved.manifest.align))


def make_report(facts: MapFacts, options: BuildOptions, tally: Tally, remarks: Remarks) -> Report:
    """Sum up what was done."""
    return Report(
        logs=tuple(remarks.logs),
        scans=tally.scans,
        builds=1,
        resumed=None,
        beams=tally.beams,
        map=MapSummary.describe(
            facts, options.resolution, plan_manifest(options), options.min_passes
        ),
        notes=tuple(remarks.notes),
        damage=tuple(remarks.damage),
        files=tuple(remarks.files),
        seconds=tally.list_seconds(),
    )
