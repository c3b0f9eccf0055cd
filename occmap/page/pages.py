"""The pages of one map, of several ways to map the same logs, and of two maps."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.palettes import Category10_10
from bokeh.plotting import figure

from occmap import page
from occmap.cells import CellBox, Evidence
from occmap.difference import COLOURS, MapDifference, tell_changes
from occmap.evidence.manifest import describe_files, list_logs
from occmap.page import Block, Page, Section, Stage, raster
from occmap.report.results import tell_beams, tell_map, tell_scans
from occmap.scoring import compare
from occmap.types import Journey
from occmap.writers import Product, WriteOptions
from occmap.writers.edits import Change

HIT_UNIT_M = 0.02
"""The hits of single scans are rounded to this."""


def describe_product(product: Product, options: WriteOptions) -> Page:
    """Lay out all that there is to show of a map, and all that is known beside it."""
    evidence, report = product.evidence(), product.report
    builds = evidence.manifest.builds
    rows, cols = product.grid.shape
    size = product.grid.resolution
    spread = f"{cols * size:.4g} x {rows * size:.4g} m"
    used = sum(build["scans"]["used"] for build in builds)
    subtitle = f"{spread}, {cols:,} x {rows:,} cells of {size:g} m, {used:,} scans"
    sections = []
    about = product.grid.about
    names = [("evidence", about.evidence), ("rendering", about.rendering)] if about else []
    if report is not None:
        made = tell_map(report.map, report.hint)
        scans = [*tell_scans(report), *tell_beams(report)]
        sections += [
            Section("The map", [Block("facts", [*made, *names])], wide=False),
            Section("Scans and beams", [Block("facts", scans)], wide=False),
            page.tell_notes(report),
        ]
    if product.inspect:
        sections += page.tell_findings(product.inspect())
    inputs = (entry for build in builds for entry in build["inputs"])
    sections.append(page.describe_maker(inputs))
    stage = stage_map(product, evidence, options)
    return Page(f"Map of {page.name_logs(list_logs(*builds))}", subtitle, sections, stage)


def stage_map(product: Product, evidence: Evidence, options: WriteOptions) -> Stage:
    """Set out a map, and what was recorded over it."""
    grid = replace(product.grid, decision=options.decide(product.grid.decision))
    seen = raster.Seen.of(evidence)
    made = raster.make_raster(grid, seen)
    note = " ".join(list_losses(made, product, evidence))
    stage = raster.set_out([made], raster.name_layers([made], seen), grid.extent, note)
    for shape in options.shapes:
        for ring in shape.rings:
            closed = ring if shape.width else [*ring, ring[0]]
            style = {"line_width": 2, "color": raster.EDITED}
            stage.plots[0].line(*np.transpose(closed), name="edits", **style)
    raster.add_drawing(stage.plots[0])
    stage.data["changes"] = list(Change)
    journey = product.journey
    if journey and journey.trajectories:
        stage.data["journey"] = raster.add_way(stage.plots[0], journey.trajectories)
        if journey.scans:
            raster.add_scan(stage.plots[0])
            stage.data["journey"] |= pack_scans(journey)
    return stage


def list_losses(made: raster.Raster, product: Product, evidence: Evidence) -> Iterator[str]:
    """Say what the page does not show as it is."""
    if made.step > 1:
        yield (
            f"The map is too large for a page: of each {made.step} x {made.step} cells the one "
            "most likely occupied is shown."
        )
    if product.journey is None:
        yield "This map is of saved evidence, which does not keep where the robot went."
    elif len(evidence.manifest.builds) > 1:
        yield "The way and the scans are those of this build, without what it was added to."


def pack_scans(journey: Journey) -> dict[str, Any]:
    """Pack the hits of scans, and say when and where each was taken."""
    scans = sorted(journey.scans, key=lambda each: each.stamp_ns)
    hits = [np.concatenate([getattr(each, axis) for each in scans]) for axis in ("x", "y")]
    origin = [float(axis.min(initial=0)) for axis in hits]
    known = {
        "t": [round(each.stamp_ns / 1e9, 3) for each in scans],
        "ends": np.cumsum([len(each.x) for each in scans]).tolist(),
        "x": [round(each.origin[0], 3) for each in scans],
        "y": [round(each.origin[1], 3) for each in scans],
        "hits": [
            raster.pack_layer(np.rint((axis - low) / HIT_UNIT_M).astype(np.int64)[None])
            for axis, low in zip(hits, origin, strict=True)
        ],
    }
    return {"scans": known, "origin": origin, "unit": HIT_UNIT_M}


def write_comparison(path: Path, comparison: compare.VariantComparison) -> None:
    """Write the page of a comparison.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    logs, scans, results = list(map(Path, comparison.logs)), comparison.scans, comparison.results
    subtitle = (
        f"{len(results)} ways to make a map of {scans.used:,} scans, "
        f"scored on {scans.held_out:,} that were held out"
    )
    sections = [
        Section("Verdict", [Block("list", texts=list(compare.tell_verdict(comparison)))]),
        Section("Scores", [tell_scores(comparison)]),
        Section("Do probabilities mean what they say?", [tell_reliability(results)]),
        page.tell_notes(comparison),
        page.describe_maker(describe_files(*logs)),
    ]
    title = f"Comparison of maps of {page.name_logs(log.name for log in logs)}"
    page.write_page(path, Page(title, subtitle, sections, stage_variants(results)))


def tell_scores(comparison: compare.VariantComparison) -> Block:
    """Tabulate the scores of all variants."""
    variant, *numbers = compare.SCORES
    head = [variant, *(f"#{name}" for name in numbers), "as good within the error"]
    rows = [[*compare.list_scores(it), "yes" if it.as_good else ""] for it in comparison.results]
    rows[comparison.results.index(comparison.recommended)][-1] = "preferred"
    return Block("table", rows, head)


def tell_reliability(results: Sequence[compare.ScoredVariant]) -> Block:
    """Draw what maps say of their cells over what held-out beams found in them."""
    plot = figure(
        height=380,
        sizing_mode="stretch_width",
        toolbar_location=None,
        x_range=Range1d(start=0, end=1),
        y_range=Range1d(start=0, end=1),
        x_axis_label="predicted: mean probability of being occupied",
        y_axis_label="observed: share of looks that found it occupied",
    )
    plot.grid.grid_line_color = "#e4e7eb"
    plot.outline_line_color = None
    plot.line([0, 1], [0, 1], color="#9aa5b1", line_dash="dashed")
    for index, result in enumerate(results):
        bins = result.score.reliability
        spots = [each.predicted for each in bins], [each.observed for each in bins]
        style: dict[str, Any] = {
            "color": Category10_10[index % 10],
            "legend_label": result.name,
            "line_dash": "solid" if index < 10 else "dotted",
        }
        plot.line(*spots, line_width=2, **style)
        plot.scatter(*spots, size=6, **style)
    plot.legend.click_policy = "hide"
    plot.add_layout(plot.legend[0], "right")
    plot.legend.border_line_color = None
    return Block("plot", plot=plot)


def stage_variants(results: Sequence[compare.ScoredVariant]) -> Stage:
    """Set out the maps side by side; what one shows, all show."""
    share = raster.MOST_BYTES // len(results)
    rasters = [raster.make_raster(result.map, None, share) for result in results]
    low_x, low_y, high_x, high_y = zip(*(result.map.extent for result in results), strict=True)
    box = min(low_x), min(low_y), max(high_x), max(high_y)
    coarse = max(each.step for each in rasters)
    note = f"Large maps are shown thinned, up to one of {coarse} x {coarse} cells."
    titles = [f"share {each.score.share:.3f} \u2013 {each.name}" for each in results]
    stage = raster.set_out(rasters, raster.name_layers(rasters), box, note * (coarse > 1))
    return replace(stage, titles=titles)


CLASSES = ("unknown", "free", "occupied")


def write_difference(path: Path, difference: MapDifference, maps: tuple[Path, Path]) -> None:
    """Write the page of a difference between two maps.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    before, after = maps
    changed = f"{difference.changed_cells:,} cells changed, {difference.share:.3%}"
    subtitle = f"{changed} of {difference.known:,} known ones"
    facts = [("before", str(before)), ("after", str(after)), *tell_changes(difference)]
    facts.append(("neither", "unknown or undecided"))
    made = page.describe_maker(describe_files(*maps))
    sections = [Section("Changes", [Block("facts", facts)]), made]
    title = f"From {before.name} to {after.name}"
    page.write_page(path, Page(title, subtitle, sections, stage_changes(difference)))


def stage_changes(difference: MapDifference) -> Stage:
    """Set out the changes and both maps in one place."""
    table = np.zeros((3, 3), np.uint8)
    for code, pair in enumerate(COLOURS):
        table[pair] = code
    layers: raster.Layers = {
        "change": table[difference.before, difference.after],
        "before": difference.before,
        "after": difference.after,
    }
    step = 1
    while layers["change"].size > raster.MOST_CELLS * step**2:
        step *= 2
    place = difference.place
    shown = raster.thin(layers | {"rank": layers["change"]}, step)  # of each block one that changed
    packed = {name: raster.pack_layer(shown[name]) for name in layers}
    made = raster.Raster(place.x, place.y, place.resolution * step, step, packed)
    box = place.measure(CellBox(0, 0, *difference.before.shape))
    note = f"Of each {step} x {step} cells the one that changed most is shown."
    return raster.set_out([made], list_change_layers(), box, note * (step > 1))


def list_change_layers() -> list[raster.Layer]:
    """How changes and classes are coloured."""
    names = [
        CLASSES[now] if was == now else f"{CLASSES[was]} to {CLASSES[now]}" for was, now in COLOURS
    ]
    of_classes = [raster.CLASS_COLOURS[0], raster.CLASS_COLOURS[1], raster.CLASS_COLOURS[3]]
    changed = [
        "#{:02x}{:02x}{:02x}".format(*rgb) for (was, now), rgb in COLOURS.items() if was != now
    ]
    return [
        raster.Layer("change", "change", "classes", [*of_classes, *changed], names),
        raster.Layer("before", "before", "classes", of_classes, CLASSES),
        raster.Layer("after", "after", "classes", of_classes, CLASSES),
    ]
