"""What a page's script must know of layers: how numbers are coloured, and what they mean."""

import zlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from bokeh.palettes import Blues256, Greys256, Oranges256, Purples256, Viridis256

from occmap.cells import Box
from occmap.page.raster import NOT_OBSERVED, Packed, Raster, to_blocks
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
