"""The page of a comparison: all variants on one linked view, their scores and reliability."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bokeh.models import Range1d
from bokeh.palettes import Category10_10
from bokeh.plotting import figure

from occmap.evidence.manifest import describe_files
from occmap.page.document import Block, Page, Section, Stage, describe_maker, name_logs, write_page
from occmap.page.findings import tell_notes
from occmap.page.layers import describe_rasters, name_layers
from occmap.page.plots import plot_map
from occmap.page.raster import MOST_BYTES, make_raster
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
    write_page(path, Page(title, subtitle, sections, stage(results)))


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


def stage(results: Sequence[ScoredVariant]) -> Stage:
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
