"""Views of a map: how its layers are coloured, and what Bokeh draws over them.

The page's script fills the maps, by what it is told here of their layers.
"""

import zlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from bokeh.models import BasicTicker, ColumnDataSource, HoverTool, Range1d, WheelZoomTool
from bokeh.palettes import Blues256, Greys256, Oranges256, Plasma256, Purples256, Viridis256
from bokeh.plotting import figure
from bokeh.transform import linear_cmap

from occmap.cells import Box
from occmap.page.raster import NOT_OBSERVED, Packed, Raster, to_blocks
from occmap.types import Float64, Trajectory
from occmap.writers.images import encode_png

CLASS_NAMES = ("unknown", "free", "undecided", "occupied")
CLASS_COLOURS = ("#d5d9de", "#ffffff", "#f2c879", "#1f2430")
SHADES = 64
"""Steps of a ramp of colours: no eye tells more apart"""
POSTER_PX = 800
"""The longer side of what a page shows until it has drawn."""

Kind = Literal["classes", "ramp", "log", "time"]


@dataclass(frozen=True)
class Layer:
    """How the numbers of a layer are shown."""

    key: str
    """The name of the layer in a `Raster`"""
    label: str
    """What the switch of the page calls it"""
    kind: Kind
    colours: Sequence[str]
    names: Sequence[str] = ()
    """Names of classes; the legend leaves out those that are empty"""
    none: int = -1
    """The number of cells that stay without a colour"""
    top: int = 1
    """The number that has the last colour"""
    scale: float = 1.0
    """What a number is multiplied by to be shown"""
    digits: int = 0
    """Decimals of what is shown"""
    start: float = 0.0
    """The time at which the first slice begins (s)"""


def name_layers(rasters: Sequence[Raster]) -> list[Layer]:
    """Say what the layers of maps are, which all have the same ones."""
    first = rasters[0]
    tops = {key: max(*(each.layers[key].largest for each in rasters), 1) for key in first.layers}
    counts = {"scale": 1 / first.unit, "digits": 1 if first.unit > 1 else 0}
    times = {"scale": first.slice_s, "start": first.start_s}

    def shade(key: str, kind: Kind, palette: Sequence[str], **more: Any) -> Layer:
        shown: dict[str, Any] = {"label": key, "none": 0, "top": tops.get(key, 1)}
        return Layer(key=key, kind=kind, colours=pick(palette), **shown | more)

    percent = {"none": NOT_OBSERVED, "top": 100, "scale": 0.01, "digits": 2}
    layers = (
        Layer("class", "class", "classes", CLASS_COLOURS, CLASS_NAMES),
        shade("p", "ramp", Greys256[::-1], label="probability", **percent),
        shade("hits", "log", Oranges256[::-1], **counts),
        shade("misses", "log", Blues256[::-1], **counts),
        shade("looks", "log", Blues256[::-1], **counts),
        shade("visits", "ramp", Purples256[::-1]),
        shade("last", "time", Viridis256, label="last seen", **times),
    )
    return [layer for layer in layers if layer.key in tops]


def pick(colours: Sequence[str]) -> list[str]:
    """Take as many colours of a palette as are told apart."""
    return [colours[round(each * (len(colours) - 1) / (SHADES - 1))] for each in range(SHADES)]


def describe_rasters(
    rasters: Sequence[Raster], layers: Sequence[Layer], box: Box
) -> tuple[dict[str, Any], Mapping[str, str]]:
    """Describe maps for the script, with their packed arrays by name; classes come first."""
    arrays: dict[str, str] = {}
    maps = []
    for index, raster in enumerate(rasters):
        specs = {}
        for name, packed in raster.layers.items():
            arrays[f"map-{index}-{name}"] = packed.text
            specs[name] = packed.to_json() | {"id": f"map-{index}-{name}"}
        poster = draw_poster(raster.layers[layers[0].key], layers[0].colours)
        place = {"x": raster.x, "y": raster.y, "size": raster.size}
        maps.append({**place, "layers": specs, "poster": poster})
    return {"maps": maps, "layers": [vars(each) for each in layers], "box": box}, arrays


def draw_poster(classes: Packed, colours: Sequence[str]) -> str:
    """Draw a small PNG, in base 64: of the cells that share a pixel the largest, y upwards."""
    shape = classes.rows, classes.columns
    cells = np.frombuffer(zlib.decompress(classes.data), np.uint8).reshape(shape)
    small = to_blocks(cells, -(-max(cells.shape) // POSTER_PX)).max(axis=2)
    table = np.array([list(bytes.fromhex(each[1:])) for each in colours], np.uint8)
    return b64encode(encode_png(table[small[::-1]])).decode()


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
