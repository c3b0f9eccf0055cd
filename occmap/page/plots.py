"""What Bokeh draws: maps that are filled by the page's script, the way over them, and diagrams."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import BasicTicker, ColumnDataSource, HoverTool, Range1d, WheelZoomTool
from bokeh.palettes import Plasma256
from bokeh.plotting import figure
from bokeh.transform import linear_cmap

from occmap.types import Float64, Trajectory

UNKNOWN_COLOUR = "#d5d9de"
WAY_COLOURS = Plasma256[20:165]
"""Without the lightest: floors are white, and undecided cells yellow."""
MOST_STEPS = 5000
"""Pieces of a way: more cannot be told apart on a screen"""
SCAN_COLOUR, LOST_COLOUR = "#e8590c", "#c92a2a"


def plot_map(index: int, shared: Any = None) -> Any:
    """Make the figure that the script fills as map `index`; all share the ranges of the first."""
    plot = figure(
        name=f"map-{index}",
        x_range=shared.x_range if shared else Range1d(start=0, end=1),
        y_range=shared.y_range if shared else Range1d(start=0, end=1),
        tools="pan",
        sizing_mode="stretch_both",
        min_height=200,
        background_fill_color=UNKNOWN_COLOUR,
        x_axis_label="x (m)",
        y_axis_label="y (m)",
        toolbar_location=None,
    )
    plot.add_tools(wheel := WheelZoomTool())
    plot.toolbar.active_scroll = wheel
    plot.axis.ticker = BasicTicker(desired_num_ticks=5)
    plot.axis.minor_tick_line_color = None
    plot.axis.axis_line_color = None
    plot.axis.major_tick_line_color = "#9aa5b1"
    plot.axis.axis_label_text_font_style = "normal"
    plot.grid.visible = False
    plot.outline_line_color = None
    nothing: dict[str, list[Any]] = {name: [] for name in ("image", "x", "y", "dw", "dh")}
    source = ColumnDataSource(nothing)
    plot.image_rgba("image", "x", "y", "dw", "dh", source=source, name=f"image-{index}")
    return plot


def add_way(plot: Any, trajectories: Sequence[Trajectory], start_ns: int) -> None:
    """Draw where lasers went, coloured by time, and where they were when scans were lost."""
    step = -(-sum(len(each.stamp_ns) for each in trajectories) // MOST_STEPS) or 1
    parts = [each.pose[::step, :2] for each in trajectories]
    times = [(each.stamp_ns[::step] - start_ns) / 1e9 for each in trajectories]
    segments = {
        "x0": join([part[:-1, 0] for part in parts]),
        "y0": join([part[:-1, 1] for part in parts]),
        "x1": join([part[1:, 0] for part in parts]),
        "y1": join([part[1:, 1] for part in parts]),
        "t": join([time[1:] for time in times]),
    }
    colour = linear_cmap("t", WAY_COLOURS, 0, max((t.max() for t in times if t.size), default=1))
    line = {"color": colour, "line_width": 2, "line_cap": "round"}
    source = ColumnDataSource(segments)
    plot.segment("x0", "y0", "x1", "y1", source=source, name="way", **line)
    lost = [place_lost(each) for each in trajectories if len(each.stamp_ns)]
    columns = {
        name: [value for each in lost for value in each[name]] for name in ("x", "y", "t", "why")
    }
    cross = {"marker": "x", "size": 9, "line_width": 2, "color": LOST_COLOUR}
    source = ColumnDataSource(columns)
    crosses = plot.scatter("x", "y", source=source, name="dropped", **cross)
    tips = [("dropped", "@why"), ("stamp", "@t{0.000} s"), ("drawn at", "the scan before")]
    plot.add_tools(HoverTool(renderers=[crosses], tooltips=tips))


def add_scan(plot: Any) -> None:
    """Prepare what the slider fills: the hits of one scan, and the laser."""
    hits = {"size": 3.5, "color": SCAN_COLOUR, "line_color": None}
    laser = {"size": 11, "color": SCAN_COLOUR, "line_color": "#ffffff", "line_width": 2}
    for name, style in (("scan", hits), ("robot", laser)):
        nothing = ColumnDataSource({"x": [], "y": []})
        plot.scatter("x", "y", source=nothing, name=name, **style)


def place_lost(trajectory: Trajectory) -> dict[str, list[Any]]:
    """Place scans without a pose where the laser was at the scan before, or else at the first."""
    stamps = np.array([stamp_ns for stamp_ns, _ in trajectory.dropped], np.int64)
    order = np.argsort(trajectory.stamp_ns, kind="stable")
    before = np.searchsorted(trajectory.stamp_ns[order], stamps) - 1
    places = trajectory.pose[order[np.maximum(before, 0)], :2]
    return {
        "x": places[:, 0].tolist(),
        "y": places[:, 1].tolist(),
        "t": (stamps / 1e9).tolist(),
        "why": [why for _, why in trajectory.dropped],
    }


def join(parts: Sequence[Float64]) -> Float64:
    """Join arrays, of which there may be none, as float32: a screen shows no more."""
    return np.concatenate([*parts, np.zeros(0)]).astype(np.float32)
