"""The pages of comparisons: of several ways to map the same logs, and of two maps."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.palettes import Category10_10
from bokeh.plotting import figure

from occmap.difference import COLOURS, NEITHER, MapDifference
from occmap.evidence.manifest import describe_files
from occmap.grid.lattice import CellBox
from occmap.page.document import (
    Block,
    Page,
    Section,
    Stage,
    describe_maker,
    name_logs,
    tell_notes,
    write_page,
)
from occmap.page.raster import MOST_BYTES, MOST_CELLS, Layers, Raster, make_raster, pack, thin
from occmap.page.views import CLASS_COLOURS, Layer, describe_rasters, name_layers, plot_map
from occmap.report.words import write_box
from occmap.scoring.compare import SCORES, VariantComparison, list_scores
from occmap.scoring.trials import ScoredVariant


def write_comparison(path: Path, comparison: VariantComparison) -> None:
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
        tell_verdict(comparison),
        Section("Scores", [tell_scores(comparison)]),
        Section("Do probabilities mean what they say?", [tell_reliability(results)]),
        tell_notes(comparison),
        describe_maker(entry for log in logs for entry in describe_files(log)),
    ]
    title = f"Comparison of maps of {name_logs(log.name for log in logs)}"
    write_page(path, Page(title, subtitle, sections, stage_variants(results)))


def tell_verdict(comparison: VariantComparison) -> Section:
    """Say which variant to use, and how."""
    rows = [("best", comparison.best)]
    if comparison.preference:
        rows.append(("as good within the error", comparison.preference))
    blocks = [Block("facts", rows), Block("code", texts=[shlex.join(comparison.command)])]
    if comparison.likeliest is not comparison.recommended:
        command = shlex.join(comparison.likeliest_command)
        rows = [("where probabilities matter", comparison.likeliest_name)]
        blocks += [Block("facts", rows), Block("code", texts=[command])]
    return Section("Verdict", blocks)


def tell_scores(comparison: VariantComparison) -> Block:
    """Tabulate the scores of all variants."""
    variant, *numbers = SCORES
    head = [variant, *(f"#{name}" for name in numbers), "as good within the error"]
    rows = [[*list_scores(each), "yes" if each.as_good else ""] for each in comparison.results]
    rows[comparison.results.index(comparison.recommended)][-1] = "preferred"
    return Block("table", rows, head)


def tell_reliability(results: Sequence[ScoredVariant]) -> Block:
    """Draw what maps say of their cells over what held-out beams found in them."""
    plot = figure(
        height=380,
        sizing_mode="stretch_width",
        tools="pan,wheel_zoom,reset,save",
        x_range=Range1d(start=0, end=1),
        y_range=Range1d(start=0, end=1),
        x_axis_label="predicted: mean probability of being occupied",
        y_axis_label="observed: share of looks that found it occupied",
    )
    plot.toolbar.logo = None
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


def stage_variants(results: Sequence[ScoredVariant]) -> Stage:
    """Set out the maps side by side; what one shows, all show."""
    share = MOST_BYTES // len(results)
    rasters = [make_raster(result.map, None, share) for result in results]
    low_x, low_y, high_x, high_y = zip(*(result.map.extent for result in results), strict=True)
    box = min(low_x), min(low_y), max(high_x), max(high_y)
    data, arrays = describe_rasters(rasters, name_layers(rasters), box)
    first = plot_map(0)
    plots = [first, *(plot_map(index, first) for index in range(1, len(results)))]
    coarse = max(raster.step for raster in rasters)
    note = f"Large maps are shown thinned, up to one of {coarse} x {coarse} cells."
    return Stage(
        plots=plots,
        titles=[f"share {each.score.share:.3f} \u2013 {each.name}" for each in results],
        data=data,
        arrays=arrays,
        note=note if coarse > 1 else "",
    )


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
    rows = [
        (name.replace("neither", CLASSES[NEITHER]), f"{cells:,}")
        for name, cells in difference.changed.items()
        if cells
    ]
    facts = [("before", str(before)), ("after", str(after))]
    facts.append((CLASSES[NEITHER], "or undecided: what is neither occupied nor free"))
    if blob := difference.largest:
        facts.append(("largest", f"{blob.cells:,} connected cells, {write_box(blob.extent)}"))
    blocks = [Block("facts", facts), Block("table", rows, ("what changed", "#cells"))]
    inputs = [entry for each in maps for entry in describe_files(each)]
    sections = [Section("Changes", blocks), describe_maker(inputs)]
    title = f"From {before.name} to {after.name}"
    write_page(path, Page(title, subtitle, sections, stage_changes(difference)))


def stage_changes(difference: MapDifference) -> Stage:
    """Set out the changes and both maps in one place."""
    table = np.zeros((3, 3), np.uint8)
    for code, pair in enumerate(COLOURS):
        table[pair] = code
    layers: Layers = {
        "change": table[difference.before, difference.after],
        "before": difference.before,
        "after": difference.after,
    }
    step = 1
    while layers["change"].size > MOST_CELLS * step**2:
        step *= 2
    place = difference.place
    shown = thin(layers | {"rank": layers["change"]}, step)  # of each block one that changed
    packed = {name: pack(shown[name]) for name in layers}
    raster = Raster(place.x, place.y, place.resolution * step, step, packed, 0.0)
    box = place.measure(CellBox(0, 0, *difference.before.shape))
    data, arrays = describe_rasters([raster], list_change_layers(), box)
    note = f"Of each {step} x {step} cells the one that changed most is shown."
    return Stage([plot_map(0)], [""], data, arrays, note=note if step > 1 else "")


def list_change_layers() -> list[Layer]:
    """How changes and classes are coloured."""
    names = [
        CLASSES[now] if was == now else f"{CLASSES[was]} to {CLASSES[now]}" for was, now in COLOURS
    ]
    of_classes = [CLASS_COLOURS[0], CLASS_COLOURS[1], CLASS_COLOURS[3]]
    changed = [
        "#{:02x}{:02x}{:02x}".format(*rgb) for (was, now), rgb in COLOURS.items() if was != now
    ]
    return [
        Layer("change", "change", "classes", [*of_classes, *changed], names),
        Layer("before", "before", "classes", of_classes, CLASSES),
        Layer("after", "after", "classes", of_classes, CLASSES),
    ]
