"""Saved evidence made into files again, and what the report says of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from occmap.evidence import read_model, refuse_other_profile, to_grid
from occmap.evidence.manifest import list_mixed
from occmap.evidence.persistence import check_passes, render_lasting
from occmap.evidence.repetition import list_repeated
from occmap.grid.framing import Framing, frame
from occmap.grid.tiles import MAX_CELLS
from occmap.report import (
    Report,
    Resumed,
    list_disagreement,
    list_unreached,
    measure_shares,
)
from occmap.sensor.models import SensorModel, describe_model
from occmap.sensor.returns import ReturnCounts
from occmap.types import Evidence, Manifest, OccupancyMap
from occmap.writers import (
    Product,
    WriteOptions,
    check_outputs,
    list_idle,
    refuse_journeys,
    write_outputs,
)


@dataclass(frozen=True)
class RenderOptions:
    """What a user may choose about a map of saved evidence."""

    model: SensorModel | None = None
    """None: the one that the evidence was built with"""
    writing: WriteOptions = field(default_factory=WriteOptions)
    max_cells: int = MAX_CELLS
    """A map with more cells is refused"""
    framing: Framing = field(default_factory=Framing)
    min_passes: int | None = None
    """A cell keeps its hits only if they came on so many visits; None: it keeps all"""


class Rendered(NamedTuple):
    """A map of saved evidence, what there is to say of it, and the evidence to save again."""

    map: OccupancyMap
    report: Report
    evidence: Evidence


def publish(evidence: Evidence, options: RenderOptions, outputs: Sequence[Path]) -> Report:
    """Render evidence and write it, as a map or as evidence; the report sums up its builds.

    Raises
    ------
    OccmapError
        As `render_kept`, or an output cannot be written.
    """
    check_outputs(outputs)
    refuse_journeys(outputs)
    made = render_kept(evidence, options, outputs)
    product = Product(made.map, lambda: made.evidence, report=made.report.to_json)
    files = write_outputs(outputs, product, options.writing)
    return replace(made.report, files=tuple(files))


def render_kept(
    evidence: Evidence, options: RenderOptions, outputs: Sequence[Path] = ()
) -> Rendered:
    """Render evidence; a note says which options do nothing for the outputs.

    Raises
    ------
    OccmapError
        The model cannot read the evidence or knows no visits, or nothing is left of the map or it
        would be too large.
    """
    model = options.model or read_model(evidence)
    refuse_other_profile(evidence, model)
    check_passes(options.min_passes, model)
    grid, lost = render_lasting(
        to_grid(evidence), evidence.slices, options.min_passes, model, options.max_cells
    )
    shown = frame(grid, options.framing, model.prior, options.max_cells)
    manifest = replace(evidence.manifest, model=describe_model(model))
    report = summarise(manifest, shown, options.writing)
    notes = (
        *report.notes,
        *list_idle(outputs, options.writing),
        *list_unreached(model, options.writing),
        *lost,
        *list_disagreement(grid),
    )
    report = replace(report, notes=notes, min_passes=options.min_passes)
    return Rendered(shown, report, replace(evidence, manifest=manifest))


def list_notes(manifest: Manifest) -> Iterator[str]:
    """Say what a reader of evidence should know of it."""
    yield from list_repeated(manifest.builds)
    yield from list_mixed(manifest)
    if manifest.subtracted:
        yield "what was subtracted was not a whole build, so numbers of visits are upper bounds"


def summarise(manifest: Manifest, grid: OccupancyMap, writing: WriteOptions) -> Report:
    """Sum up all builds of evidence, and the map that was made of it."""
    scans = [build["scans"] for build in manifest.builds]
    read, used = sum_scans(manifest)
    dropped: dict[str, int] = {}
    for reason, count in (pair for each in scans for pair in each["dropped"].items()):
        dropped[reason] = dropped.get(reason, 0) + count
    rows, cols = grid.shape
    return Report(
        logs=tuple(entry["name"] for build in manifest.builds for entry in build["inputs"]),
        scans_read=read,
        scans_used=used,
        builds=len(scans),
        dropped=dropped,
        beams=sum((read_counts(each["beams"]) for each in scans), ReturnCounts()),
        notes=tuple(list_notes(manifest)),
        update=manifest.update,
        model=manifest.model,
        resolution=manifest.resolution,
        columns=cols,
        rows=rows,
        extent=grid.extent,
        align=manifest.align or 0.0,
        shares=measure_shares(grid, writing),
        agreement=grid.agreement,
    )


def sum_scans(manifest: Manifest) -> tuple[int, int]:
    """How many scans all builds of evidence read, and how many they used."""
    scans = [build["scans"] for build in manifest.builds]
    return sum(each["read"] for each in scans), sum(each["used"] for each in scans)


def describe_resumed(evidence: Evidence) -> Resumed:
    """Say what a build was added to."""
    return Resumed(evidence.where, *sum_scans(evidence.manifest))


def read_counts(beams: dict[str, int]) -> ReturnCounts:
    """What beams meant, as an older occmap may have counted it, with fewer reasons or others."""
    return ReturnCounts(*(beams.get(name, 0) for name in ReturnCounts._fields))
