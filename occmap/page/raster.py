"""What a page knows of each cell of a map, in layers that the browser unpacks one by one.

A map is read tile by tile, so that one of a thousand million cells needs little memory beside its
own. Where it has more cells than a page can carry, only one of each square block of cells is kept:
the one that is most likely occupied, with all that is known of it.
"""

import zlib
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.cells import Evidence, OccupancyMap, Slices
from occmap.evidence import make_empty
from occmap.grid.lattice import CellBox
from occmap.grid.slices import count_visits, split_tiles, take, unite, unpack
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid, view_tiles
from occmap.types import Bool, Int64

MOST_CELLS = 4100 * 4100
"""A page with more of them takes long to open."""
MOST_BYTES = 9_500_000
"""Of all layers of a page together, compressed; as text they take a third more"""
COUNTS = {"hits", "misses", "looks"}
UNKNOWN, FREE, UNDECIDED, OCCUPIED = range(4)
NOT_OBSERVED = 255
"""In the layer of probabilities, which are in per cent."""
STEPS = (1, 2, 4, 8, 16, 32, TILE)
"""Where a map has too many cells, of each square with so many along its side one is shown."""
COUNT_STEPS = (16, 4)
"""Before that, counts are rounded to so many steps for each doubling, which makes them compress
better."""

Layers: TypeAlias = dict[str, NDArray[Any]]
"""(H, W) unsigned numbers by name; row 0 is the lowest y"""


class Packed(NamedTuple):
    """An array as a page holds it: compressed, and its script unpacks it again.

    All lowest bytes come first, then all second ones and so on, as many as the largest number
    needs: of most numbers only the lowest byte differs from that of the number before.
    """

    data: bytes
    """Deflated, in the format of zlib"""
    rows: int
    columns: int
    planes: int
    """Bytes of each number: 1 to 4"""
    largest: int

    @property
    def text(self) -> str:
        """The data as text, in base 64."""
        return b64encode(self.data).decode()

    def to_json(self) -> dict[str, Any]:
        """What the page's script must know to unpack the text."""
        return {name: getattr(self, name) for name in ("rows", "columns", "planes", "largest")}


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
    rounding: float
    """By what share of itself a count may be off"""
    unit: int = 1
    """What one observation counts in the layers of hits and misses"""
    slice_s: float = 0.0
    """How long the slices of time are that the layer of last sights counts (s)"""
    start_s: float = 0.0
    """When the first of these slices begins (s)"""


class Seen(NamedTuple):
    """What evidence says of cells."""

    grid: TileGrid
    slices: Slices
    """Those of all builds, in order"""
    first: int
    """The first of them"""
    slice_s: float
    """How long each is (s)"""


def make_raster(
    grid: OccupancyMap, evidence: Evidence | None, most_bytes: int = MOST_BYTES
) -> Raster:
    """Take the layers of a map as exactly as a page of bearable size can hold them.

    Parameters
    ----------
    evidence
        What the map was made of; it may reach beyond the map. None: only classes and probabilities
        are known.
    """
    for raster in list_rasters(grid, evidence):
        if sum(len(each.data) for each in raster.layers.values()) <= most_bytes:
            break
    return raster


def list_rasters(grid: OccupancyMap, evidence: Evidence | None) -> Iterator[Raster]:
    """Take the layers of a map more and more roughly, so that they take fewer and fewer bytes."""
    box, seen = CellBox.of(grid), see(evidence) if evidence else None
    times = (seen.grid.unit, seen.slice_s, seen.first * seen.slice_s) if seen else (1, 0.0, 0.0)
    steps = [each for each in STEPS if box.cells <= MOST_CELLS * each**2]
    for step in steps or STEPS[-1:]:
        bands = [thin(band, step) for band in read_bands(grid, seen, box)]
        shown, size = box.align(step).shrink(step), grid.resolution * step
        window = shown.within(box.align(TILE).shrink(step))
        layers = {
            name: np.concatenate([band[name] for band in bands])[window]
            for name in bands[0]
            if name != "rank"
        }
        place = round(shown.col * size, 9), round(shown.row * size, 9), size, step
        packed = {name: pack(layer) for name, layer in layers.items()}
        yield Raster(*place, packed, 0.0, *times)
        for parts in COUNT_STEPS:
            counts = {name: round_counts(layers[name], parts) for name in COUNTS & layers.keys()}
            packed = packed | {name: pack(layer) for name, layer in counts.items()}
            yield Raster(*place, packed, 0.5 / parts, *times)


def read_bands(grid: OccupancyMap, seen: Seen | None, box: CellBox) -> Iterator[Layers]:
    """Read all layers of one row of tiles after the other; `box` is the map's."""
    outer = box.align(TILE)
    for row in range(outer.row, outer.row_end, TILE):
        whole = CellBox(row, outer.col, row + TILE, outer.col_end)
        own = box.clip(whole)
        part, there = grid.take(*own.within(box)), own.within(whole)
        band: Layers = {
            "class": np.zeros((TILE, outer.cols), np.uint8),
            "p": np.full((TILE, outer.cols), NOT_OBSERVED, np.uint8),
            "rank": np.full((TILE, outer.cols), -np.inf, np.float32),
        }
        band["class"][there] = classify(part)
        band["p"][there] = np.where(part.observed, np.rint(100 * part.probability), NOT_OBSERVED)
        band["rank"][there] = np.where(part.observed, part.log_odds, -np.inf)
        if seen:
            band |= read_seen(seen, whole)
        yield band


def classify(grid: OccupancyMap) -> NDArray[np.uint8]:
    """(H, W) what each cell is."""
    classes = np.where(grid.observed, UNDECIDED, UNKNOWN).astype(np.uint8)
    classes[grid.free] = FREE
    classes[grid.occupied] = OCCUPIED
    return classes


def see(evidence: Evidence) -> Seen:
    """Make evidence ready to be read, without a copy of its tiles."""
    grid = make_empty(evidence.manifest).like(view_tiles(evidence.tiles, evidence.cells))
    slices = unite(evidence.slices)
    first = int(slices.numbers.min()) if slices.numbers.size else 0
    return Seen(grid, slices, first, evidence.manifest.pass_gap_s)


def read_seen(seen: Seen, box: CellBox) -> Layers:
    """(64, W) hits and misses, or looks, and visits and last sights in a row of tiles."""
    first, second = seen.grid.gather(box, np.uint32)
    is_counted = seen.grid.kind is EvidenceKind.COUNTS
    band: Layers = {"hits": first, "misses": second} if is_counted else {"looks": second}
    band |= {name: np.zeros(box.shape, np.uint32) for name in ("visits", "last")}
    there = box.shrink(TILE).find(seen.slices.tiles)
    for (_, col), slices in split_tiles(take(seen.slices, there)):
        start = col * TILE - box.col
        band["visits"][:, start : start + TILE] = count_visits(slices)[1]
        band["last"][:, start : start + TILE] = find_last(slices, seen.first)
    return band


def find_last(slices: Slices, first: int) -> Int64:
    """(64, 64) the last slice that saw each cell of one tile, counted from 1; 0 where none did."""
    last = np.zeros((TILE, TILE), np.int64)
    for number, bits in zip(slices.numbers.tolist(), unpack(slices)[:, 1], strict=True):
        seen: Bool = np.unpackbits(bits, axis=-1).view(np.bool_)
        last[seen] = number - first + 1
    return last


def thin(band: Layers, step: int) -> Layers:
    """Keep, of each block of `step` x `step` cells, the one of the highest rank."""
    if step == 1:
        return band
    best = to_blocks(band["rank"], step).argmax(axis=2)[..., None]
    return {
        name: np.take_along_axis(to_blocks(layer, step), best, axis=2)[..., 0]
        for name, layer in band.items()
    }


def to_blocks(layer: NDArray[Any], step: int) -> NDArray[Any]:
    """Sort the cells of (H, W) into (H / step, W / step, step * step); zeros fill up the last."""
    rows, cols = (-(-side // step) for side in layer.shape)
    filling = [(0, -side % step) for side in layer.shape]
    blocks = np.pad(layer, filling).reshape(rows, step, cols, step).swapaxes(1, 2)
    return blocks.reshape(rows, cols, step * step)


def round_counts(counts: NDArray[Any], steps: int) -> NDArray[Any]:
    """Round counts to `steps` values for each doubling; those below twice `steps` stay exact."""
    coarse = np.exp2(np.floor(np.log2(np.maximum(counts / steps, 1))))
    rounded: NDArray[Any] = (np.rint(counts / coarse) * coarse).astype(counts.dtype)
    return rounded


def pack(array: NDArray[Any]) -> Packed:
    """Pack (H, W) numbers from 0 to 2^32 - 1; larger ones become the largest."""
    largest = min(int(array.max(initial=0)), 2**32 - 1)
    planes = max(-(-largest.bit_length() // 8), 1)
    numbers = np.minimum(array, 2**32 - 1).astype(np.uint32) if planes > 1 else array
    squeeze = zlib.compressobj(6)
    data = b"".join(
        squeeze.compress(((numbers >> (8 * plane)) & 255).astype(np.uint8).tobytes())
        for plane in range(planes)
    )
    rows, columns = array.shape
    return Packed(data + squeeze.flush(), rows, columns, planes, largest)
