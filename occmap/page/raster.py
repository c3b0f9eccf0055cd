"""What a page knows of each cell of a map, in layers that the browser unpacks one by one.

A map is read tile by tile, so that one of a thousand million cells needs little memory beside its
own. Where it has more cells than a page can carry, only one of each square block of cells is kept:
the one that is most likely occupied, with all that is known of it.

The page's script fills the maps, by what it is told here of how their layers are coloured.
"""

import zlib
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from bokeh import palettes
from bokeh.models import BasicTicker, ColumnDataSource, HoverTool, Range1d, WheelZoomTool
from bokeh.plotting import figure
from bokeh.transform import linear_cmap
from numpy.typing import NDArray

from occmap.cells import Box, CellBox, Evidence, Ground, OccupancyMap, Slices, cut_squares
from occmap.evidence import to_grid
from occmap.grid import tiles
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid
from occmap.page import Stage
from occmap.types import Int64, Trajectory
from occmap.writers.pgm import RAW_UNKNOWN, to_raw

MOST_CELLS = 4100 * 4100
"""A page with more of them takes long to open."""
MOST_BYTES = 12_500_000
"""Of all layers of a page together, compressed and as text"""
UNKNOWN, FREE, UNDECIDED, OCCUPIED = range(4)
STEPS = (1, 2, 4, 8, 16, 32, TILE)
"""Where a map has too many cells, of each square with so many along its side one is shown."""

Layers: TypeAlias = dict[str, NDArray[Any]]
"""(H, W) unsigned numbers by name; row 0 is the lowest y"""


@dataclass(frozen=True)
class Packed:
    """An array as a page holds it: compressed, and its script unpacks it again.

    All lowest bytes come first, then all second ones and so on, as many as the largest number
    needs: of most numbers only the lowest byte differs from that of the number before.
    """

    rows: int
    columns: int
    planes: int
    """Bytes of each number: 1 to 4"""
    largest: int
    data: str
    """Deflated, in the format of zlib, in base 64"""


@dataclass(frozen=True, eq=False)
class Raster:
    """Layers of a map, packed, and where they lie."""

    x: float
    y: float
    """Lower-left corner (m)"""
    size: float
    """Side of what is shown as one cell (m)"""
    step: int
    """How many cells of the map that is wide"""
    layers: dict[str, Packed]


class Seen(NamedTuple):
    """Evidence, ready to be read without a copy of its tiles."""

    grid: TileGrid
    slices: Slices
    """Those of all builds, in order"""
    slice_s: float
    """How long each of them is (s)"""
    first: int
    """The first of them, from which the layer of last sights counts"""
    ground: Ground | None
    """What clouds were traced over"""
    lowest_cm: int
    """The lowest ground, from which its layer counts (cm)"""

    @classmethod
    def of(cls, evidence: Evidence) -> "Seen":
        """Make evidence ready."""
        grid = to_grid(evidence)
        slices, ground = tiles.unite(evidence.slices), evidence.ground
        heights = ground.height_mm[ground.measured] if ground else np.zeros(0)
        first, lowest = (int(each.min()) if each.size else 0 for each in (slices.numbers, heights))
        return cls(grid, slices, evidence.manifest.pass_gap_s, first, ground, lowest // 10)


def make_raster(grid: OccupancyMap, seen: Seen | None, most_bytes: int = MOST_BYTES) -> Raster:
    """Take the layers of a map as exactly as a page of bearable size can hold them.

    Parameters
    ----------
    seen
        What the map was made of; it may reach beyond the map. None: only classes and probabilities
        are known.
    """
    for raster in list_rasters(grid, seen):
        if sum(len(each.data) for each in raster.layers.values()) <= most_bytes:
            break
    return raster


def list_rasters(grid: OccupancyMap, seen: Seen | None) -> Iterator[Raster]:
    """Take the layers of a map, all cells or fewer and fewer, so that they take fewer bytes."""
    box = grid.box
    steps = [each for each in STEPS if box.cells <= MOST_CELLS * each**2]
    for step in steps or STEPS[-1:]:
        bands = [thin(band, step) for band in read_bands(grid, seen, box)]
        shown, size = box.align(step).shrink(step), grid.resolution * step
        window = shown.within(box.align(TILE).shrink(step))
        packed = {
            name: pack_layer(np.concatenate([band[name] for band in bands])[window])
            for name in bands[0]
            if name != "rank"
        }
        yield Raster(round(shown.col * size, 9), round(shown.row * size, 9), size, step, packed)


def read_bands(grid: OccupancyMap, seen: Seen | None, box: CellBox) -> Iterator[Layers]:
    """Read all layers of one row of tiles after the other; `box` is the map's."""
    outer = box.align(TILE)
    for row in range(outer.row, outer.row_end, TILE):
        whole = CellBox(row, outer.col, row + TILE, outer.col_end)
        own = box.clip(whole)
        part, there = grid.take(*own.within(box)), own.within(whole)
        band: Layers = {
            "class": np.zeros((TILE, outer.cols), np.uint8),
            "p": np.full((TILE, outer.cols), RAW_UNKNOWN, np.uint8),
            "rank": np.full((TILE, outer.cols), -np.inf, np.float32),
        }
        masks = [part.occupied, part.free, part.observed]
        band["class"][there] = np.select(masks, [OCCUPIED, FREE, UNDECIDED], UNKNOWN)
        band["p"][there] = to_raw(part)
        band["rank"][there] = np.where(part.observed, part.log_odds, -np.inf)
        if seen:
            band |= read_seen(seen, whole)
        yield band


def read_seen(seen: Seen, box: CellBox) -> Layers:
    """(64, W) hits and misses, or looks, and visits and last sights in a row of tiles."""
    first, second = seen.grid.gather(box, np.uint32)
    is_counted = seen.grid.kind is EvidenceKind.COUNTS
    band: Layers = {"hits": first, "misses": second} if is_counted else {"looks": second}
    band |= {name: np.zeros(box.shape, np.uint32) for name in ("visits", "last")}
    there = box.shrink(TILE).find(seen.slices.tiles)
    for (_, col), slices in tiles.split_tiles(tiles.take_tiles(seen.slices, there)):
        start = col * TILE - box.col
        band["visits"][:, start : start + TILE] = tiles.count_visits(slices)[1]
        band["last"][:, start : start + TILE] = find_last(slices, seen.first)
    if seen.ground is not None:
        band["ground"] = read_ground(seen.ground, seen.lowest_cm, box, seen.grid.lattice.resolution)
    return band


def read_ground(ground: Ground, lowest_cm: int, box: CellBox, resolution: float) -> Int64:
    """(64, W) how high the ground below the cells of a box is (cm), from 1 on; 0: not measured."""
    rows, cols = np.mgrid[box.row : box.row_end, box.col : box.col_end]
    place = (np.column_stack([cols.ravel(), rows.ravel()]) + 0.5) * resolution
    above_cm = np.floor(100 * ground.find_heights(place)) - lowest_cm + 1
    return np.asarray(np.nan_to_num(above_cm).astype(np.int64).reshape(box.shape))


def find_last(slices: Slices, first: int) -> Int64:
    """(64, 64) the last slice that saw each cell of one tile, counted from 1; 0 where none did."""
    last = np.zeros((TILE, TILE), np.int64)
    for number, bits in zip(slices.numbers.tolist(), tiles.unpack_bits(slices)[:, 1], strict=True):
        last[np.unpackbits(bits, axis=-1).view(np.bool_)] = number - first + 1
    return last


def thin(band: Layers, step: int) -> Layers:
    """Keep, of each block of `step` x `step` cells, the one of the highest rank."""
    if step == 1:
        return band
    best = cut_squares(band["rank"], step).argmax(axis=2)[..., None]
    return {
        name: np.take_along_axis(cut_squares(layer, step), best, axis=2)[..., 0]
        for name, layer in band.items()
    }


def pack_layer(array: NDArray[Any]) -> Packed:
    """Pack (H, W) numbers from 0 to 2^32 - 1; larger ones become the largest."""
    largest = min(int(array.max(initial=0)), 2**32 - 1)
    planes = max(-(-largest.bit_length() // 8), 1)
    numbers = np.minimum(array, largest).astype("<u4").reshape(-1, 1)
    data = zlib.compress(numbers.view(np.uint8)[:, :planes].T.tobytes(), 6)
    rows, columns = array.shape
    return Packed(rows, columns, planes, largest, b64encode(data).decode())


CLASS_NAMES = ("unknown", "free", "undecided", "occupied")
CLASS_COLOURS = ("#d5d9de", "#ffffff", "#f2c879", "#1f2430")
SHADES = 64
"""Steps of a ramp of colours: no eye tells more apart"""

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
    """What is shown for 0: the time at which the first slice begins (s), the lowest ground (m)"""


def name_layers(rasters: Sequence[Raster], seen: Seen | None = None) -> list[Layer]:
    """Say what the layers of maps are, which all have the same ones."""
    tops = {key: max(each.layers[key].largest for each in rasters) for key in rasters[0].layers}

    def shade(key: str, label: str, kind: Kind, palette: tuple[str, ...], **more: Any) -> Layer:
        colours = palettes.linear_palette(palette, SHADES)
        usual = {"none": 0, "top": max(tops.get(key, 1), 1)}
        return Layer(key, label, kind, colours, **usual | more)

    percent = {"none": RAW_UNKNOWN, "top": 100, "scale": 0.01, "digits": 2}
    layers = [
        Layer("class", "class", "classes", CLASS_COLOURS, CLASS_NAMES),
        shade("p", "probability", "ramp", palettes.Greys256[::-1], **percent),
    ]
    if seen is None:
        return layers
    counts = {"scale": 1 / seen.grid.unit, "digits": 1 if seen.grid.unit > 1 else 0}
    times = {"scale": seen.slice_s, "start": seen.first * seen.slice_s}
    heights = {"scale": 0.01, "digits": 2, "start": (seen.lowest_cm - 1) / 100}
    layers += [
        shade("hits", "hits", "log", palettes.Oranges256[::-1], **counts),
        shade("misses", "misses", "log", palettes.Blues256[::-1], **counts),
        shade("looks", "looks", "log", palettes.Blues256[::-1], **counts),
        shade("visits", "visits", "ramp", palettes.Purples256[::-1]),
        shade("last", "last seen", "time", palettes.Viridis256, **times),
        shade("ground", "ground (m)", "ramp", palettes.Cividis256, **heights),
    ]
    return [layer for layer in layers if layer.key in tops]


def set_out(rasters: Sequence[Raster], layers: Sequence[Layer], box: Box, note: str) -> Stage:
    """Set out maps side by side; the first layer, of classes, is the one that is seen first."""
    plots = [first := plot_map(0), *(plot_map(at, first) for at in range(1, len(rasters)))]
    return Stage(plots, {"maps": rasters, "layers": layers, "box": box}, note)


WAY_COLOURS = palettes.Plasma256[20:165]
"""Without the lightest: floors are white, and undecided cells yellow."""
MOST_STEPS = 5000
"""Pieces of a way: more cannot be told apart on a screen"""
SCAN_COLOUR, LOST_COLOUR = "#e8590c", "#c92a2a"
EDITED = "#009e73"
"""What a person drew over the map"""


def plot_map(index: int, shared: Any = None) -> Any:
    """Make the figure that the script fills as map `index`; all share the ranges of the first."""
    plot = figure(
        name=f"map-{index}",
        x_range=shared.x_range if shared else Range1d(start=0, end=1),
        y_range=shared.y_range if shared else Range1d(start=0, end=1),
        tools="pan",
        sizing_mode="stretch_both",
        min_height=200,
        background_fill_color=CLASS_COLOURS[UNKNOWN],
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


def add_drawing(plot: Any) -> None:
    """Prepare what a person draws over the map, to save it as a file for `edits`."""
    shapes = ColumnDataSource({"xs": [], "ys": []})
    style = {"fill_color": EDITED, "fill_alpha": 0.3, "line_color": EDITED, "line_width": 2}
    plot.patches("xs", "ys", source=shapes, name="drawn", **style)
    corners = ColumnDataSource({"x": [], "y": []})
    plot.scatter("x", "y", source=corners, name="corners", size=6, color=EDITED)


def add_way(plot: Any, trajectories: Sequence[Trajectory]) -> dict[str, Any]:
    """Draw where lasers went, coloured by time, and where they were when scans were lost.

    Returns
    -------
    dict
        What the page's script must know: the colours, and what is at their ends.
    """
    step = -(-sum(len(each.stamp_ns) for each in trajectories) // MOST_STEPS) or 1
    stamps = np.concatenate([each.stamp_ns for each in trajectories])
    start_ns, end_ns = int(stamps.min()), int(stamps.max())
    ways = [
        np.column_stack([each.pose[:, :2], (each.stamp_ns - start_ns) / 1e9])[::step]
        for each in trajectories
    ]
    x0, y0, _ = np.concatenate([way[:-1] for way in ways]).T
    x1, y1, t = np.concatenate([way[1:] for way in ways]).T
    colour = linear_cmap("t", WAY_COLOURS, 0, float(t.max(initial=1e-9)))
    line = {"color": colour, "line_width": 2, "line_cap": "round"}
    source = ColumnDataSource({"x0": x0, "y0": y0, "x1": x1, "y1": y1, "t": t})
    plot.segment("x0", "y0", "x1", "y1", source=source, name="way", **line)
    lost = [row for each in trajectories if len(each.stamp_ns) for row in list_lost(each)]
    names = ("x", "y", "t", "why")
    source = ColumnDataSource({name: [row[at] for row in lost] for at, name in enumerate(names)})
    cross = {"marker": "x", "size": 9, "line_width": 2, "color": LOST_COLOUR}
    crosses = plot.scatter("x", "y", source=source, name="dropped", **cross)
    tips = [("dropped", "@why"), ("stamp", "@t{0.000} s"), ("drawn at", "the scan before")]
    plot.add_tools(HoverTool(renderers=[crosses], tooltips=tips))
    return {"ramp": (WAY_COLOURS[::4], start_ns / 1e9, end_ns / 1e9)}


def list_lost(trajectory: Trajectory) -> Iterator[tuple[float, float, float, str]]:
    """List the scans without a pose: x and y at the scan before, or else the first; when, why."""
    order = np.argsort(trajectory.stamp_ns, kind="stable")
    stamps = trajectory.stamp_ns[order]
    for stamp_ns, why in trajectory.dropped:
        before = max(int(np.searchsorted(stamps, stamp_ns)) - 1, 0)
        x, y = trajectory.pose[order[before], :2].tolist()
        yield x, y, stamp_ns / 1e9, why


def add_scan(plot: Any) -> None:
    """Prepare what the slider fills: the hits of one scan, and the laser."""
    hits = {"size": 3.5, "color": SCAN_COLOUR, "line_color": None}
    laser = {"size": 11, "color": SCAN_COLOUR, "line_color": "#ffffff", "line_width": 2}
    for name, style in (("scan", hits), ("robot", laser)):
        plot.scatter("x", "y", source=ColumnDataSource({"x": [], "y": []}), name=name, **style)
