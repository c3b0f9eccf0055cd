"""Saved evidence made into files again, and what the report says of it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from occmap.cells import Evidence, Manifest, OccupancyMap
from occmap.choices import option
from occmap.errors import UsageError
from occmap.evidence import read_model, refuse_other_profile, to_grid
from occmap.evidence.manifest import BuildRecord, list_doubts
from occmap.evidence.persistence import check_passes, render_lasting
from occmap.grid.rendering import Framing
from occmap.grid.tiles import MAX_CELLS
from occmap.report.doubts import list_disagreement, list_unreached
from occmap.report.results import Build, MapFacts, MapSummary, Report, describe_map
from occmap.scans.tally import ScanCounts
from occmap.sensor.models import MODEL, SensorModel, describe_model, parse_model
from occmap.sensor.returns import ReturnCounts
from occmap.store import rendering
from occmap.store.reading import Blocks, Saved, Store, as_blocks, read_all
from occmap.store.writer import ZarrWriter
from occmap.writers import Product, ProductWriter, WindowWriter, WriteOptions
from occmap.writers.outputs import check_outputs, find_writer, list_idle, write_outputs


@dataclass(frozen=True)
class RenderOptions:
    """What a user may choose about a map of saved evidence."""

    model: SensorModel | None = option(None, form=MODEL)
    """None: the one that the evidence was built with"""
    writing: WriteOptions = field(default_factory=WriteOptions)
    max_cells: int = MAX_CELLS
    """A map with more cells is refused"""
    framing: Framing = field(default_factory=Framing)
    min_passes: int | None = None
    """A cell keeps its hits only if they came on so many visits; None: it keeps all"""
    overview: int | None = None
    """Make each pixel a square of so many cells, from the pictures in a store; None: a cell"""


def publish(saved: Saved, options: RenderOptions, outputs: Sequence[Path]) -> Report:
    """Render evidence and write it, as a map or as evidence; the report sums up its builds.

    Where no output needs the whole map, it is never made: evidence is written block by block.

    Raises
    ------
    OccmapError
        As `render_kept`, or an output cannot be written.
    """
    check_outputs(outputs)
    writers = [(path, find_writer(path)) for path in outputs]
    for path, writer in writers:
        if isinstance(writer, ProductWriter):
            refuse_unknown(path, writer, options)
    model, manifest = choose_model(saved, options)
    grid: OccupancyMap | rendering.BlockMap
    in_parts = all(isinstance(writer, ZarrWriter | WindowWriter) for _, writer in writers)
    if isinstance(saved, Blocks) and in_parts and options.overview is None:
        grid = rendering.open_map(saved, model, options.framing, options.min_passes)
        facts = rendering.survey_blocks(grid, options.writing)
    else:
        grid, facts = paint_saved(saved, model, options)
    report = summarise(manifest, facts, options, outputs)
    keep = cache(lambda: replace(read_all(saved), manifest=manifest))
    files: list[Path] = []
    for path, writer in writers:
        if isinstance(writer, ZarrWriter):
            files += writer.write_blocks(path, as_blocks(saved), manifest)
        elif isinstance(writer, WindowWriter):
            files += writer.write(path, grid, options.writing)
        elif isinstance(grid, OccupancyMap):
            product = Product(grid, keep, report=report)
            files += map(Path, write_outputs([path], product, options.writing))
    return replace(report, files=tuple(map(str, files)))


def refuse_unknown(path: Path, writer: ProductWriter, options: RenderOptions) -> None:
    """Refuse an output of what saved evidence, or an overview of it, does not say.

    Raises
    ------
    UsageError
        It shows where the robot went, or it shows single cells and an overview is asked for.
    """
    if writer.needs_journey:
        found = "evidence does not say where the robot went, only the logs do"
        raise UsageError(found, where=path, fix="build it from the logs: `occmap build`")
    if writer.needs_evidence and options.overview is not None:
        found = "shows single cells, and `overview` has none"
        raise UsageError(found, where=path, fix="leave out `overview`, or write a .png")


def render_kept(saved: Saved, options: RenderOptions) -> Build:
    """Render evidence, and write nothing.

    Raises
    ------
    OccmapError
        The model cannot read the evidence or knows no visits, or nothing is left of the map or it
        would be too large.
    """
    model, manifest = choose_model(saved, options)
    grid, facts = paint_saved(saved, model, options)
    evidence = replace(read_all(saved), manifest=manifest)
    return Build(grid, summarise(manifest, facts, options), to_grid(evidence), evidence)


def choose_model(saved: Saved, options: RenderOptions) -> tuple[SensorModel, Manifest]:
    """Choose the model, and say what evidence is that is to be rendered by it.

    Raises
    ------
    OccmapError
        The model cannot read the evidence or knows no visits.
    """
    model = options.model or read_model(saved)
    refuse_other_profile(saved, model)
    check_passes(options.min_passes, model)
    return model, replace(saved.manifest, model=describe_model(model))


def paint_saved(
    saved: Saved, model: SensorModel, options: RenderOptions
) -> tuple[OccupancyMap, MapFacts]:
    """Paint a map, or the part of it that is wanted, and measure it.

    Raises
    ------
    OccmapError
        Nothing is left of it, it would be too large, or there is no such overview.
    """
    lost: Sequence[str] = ()
    if options.overview is not None:
        if not isinstance(saved, Store):
            raise UsageError("`overview` goes with a store", where=saved.where, fix="leave it out")
        if options.model or options.min_passes:
            found = (
                "the pictures in a store show what its own model decided of all that was observed"
            )
            raise UsageError(found, fix="leave out `overview`, or the model and `min_passes`")
        side, most = options.overview, options.max_cells
        shown = rendering.read_overview(saved, side, options.framing, most)
    elif isinstance(saved, Evidence):
        shown, lost = render_lasting(to_grid(saved), saved.slices, model, options)
        lost = [*saved.notes, *lost]
    else:
        made = rendering.open_map(saved, model, options.framing, options.min_passes)
        shown, lost = rendering.render_blocks(made, options.max_cells)
    return shown, describe_map(shown, options.writing)._replace(lost=lost)


def summarise(
    manifest: Manifest, facts: MapFacts, options: RenderOptions, outputs: Sequence[Path] = ()
) -> Report:
    """Sum up all builds of evidence, and the map that was made of it by the manifest's model."""
    model = options.model or parse_model(manifest.model)
    beams = [build["scans"]["beams"] for build in manifest.builds]
    # An older occmap may have counted fewer kinds of beams, or others.
    kinds = {kind: sum(each.get(kind, 0) for each in beams) for kind in ReturnCounts._fields}
    return Report(
        logs=tuple(entry["name"] for build in manifest.builds for entry in build["inputs"]),
        scans=sum_scans(manifest.builds),
        builds=len(beams),
        resumed=None,
        beams=ReturnCounts(**kinds),
        points={},
        map=MapSummary.describe(facts, manifest, options.min_passes),
        notes=(
            *list_doubts(manifest),
            *list_idle(outputs, options.writing),
            *list_unreached(model, options.writing),
            *facts.lost,
            *list_disagreement(facts),
        ),
    )


def sum_scans(builds: Sequence[BuildRecord]) -> ScanCounts:
    """Add up what became of the scans of builds."""
    scans = [build["scans"] for build in builds]
    dropped: Counter[str] = Counter()
    for each in scans:
        dropped.update(each["dropped"])
    read, used = (sum(each[name] for each in scans) for name in ("read", "used"))
    return ScanCounts(read, used, dict(dropped))
