"""Edits: shapes that a person draws over a map, such as a box over a pallet that is to go.

They lie in a file beside the map and are applied whenever a map is made of evidence; the evidence
stays what was observed. Each line of a CSV is a shape: what becomes of its cells, what it is, and
its corners in the map's frame (m). A line of a drawing may end with its width. `#` begins a
comment:

    free,polygon,1.2,3.4,2.0,3.4,2.0,4.1
    occupied,line,0,0,5,0
    unknown,box,1,1,2,2.5
    forbidden,polygon,4,4,6,4,6,5

GeoJSON has them as polygons and lines, one by one or several in one, with a property `class`, and
for lines `width`.
"""

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from occmap.cells import CellBox, OccupancyMap
from occmap.errors import UsageError, refuse_unreadable
from occmap.types import Bool, Float64

LINE_WIDTH = 0.1
"""Of a line that states none (m)"""
CLOSED = math.sqrt(0.5)
"""The cells whose middle is so near to a line (in cells) leave no gap that a path fits through."""


class Change(StrEnum):
    """What becomes of the cells of a shape."""

    FREE = "free"
    OCCUPIED = "occupied"
    UNKNOWN = "unknown"
    FORBIDDEN = "forbidden"
    """The map stays as it is, and a keepout mask has them."""


LOG_ODDS = {Change.FREE: -30.0, Change.OCCUPIED: 30.0, Change.UNKNOWN: 0.0}
"""Beyond every threshold that a user may give"""
DEGREES = re.compile(r"CRS:?84|EPSG:+4326\b")
"""How programs name the frame of GeoJSON whose places are longitude and latitude"""
MOST_M = 1e9
"""No corner lies farther away."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in the map's frame, and what becomes of its cells."""

    change: Change
    rings: tuple[Float64, ...]
    """(N, 2) each: x and y of the corners of an area's outline and of its holes, or of a line"""
    width: float | None = None
    """Of a line (m); None: it is an area"""

    def find_reach(self, resolution: float) -> float:
        """How far from a line cells of some size belong to it (m)."""
        return 0.0 if self.width is None else max(self.width / 2, CLOSED * resolution)

    def measure(self, resolution: float) -> tuple[Float64, Float64]:
        """Lowest x and y, and highest x and y, of what belongs to it among such cells (m)."""
        corners, reach = np.concatenate(self.rings), self.find_reach(resolution)
        return corners.min(axis=0) - reach, corners.max(axis=0) + reach

    def find_cells(self, whole: CellBox, size: float) -> tuple[tuple[slice, slice], Bool]:
        """Find the cells of a box, of some size (m), with their middle inside the area or near it.

        Returns
        -------
        window, covered
            Rows and columns of a part of the box, and which of its cells it covers.
        """
        reach = self.find_reach(size)
        (low, left), (high, right) = (end[::-1] / size for end in self.measure(size))
        box = whole.clip(CellBox(*(math.floor(edge) for edge in (low, left, high, right))).grow(1))
        # Counted from the map's zero, so that a part of a map has the middles of the whole.
        x = (np.arange(box.col, box.col_end, dtype=np.float64) + 0.5) * size
        y = (np.arange(box.row, box.row_end, dtype=np.float64) + 0.5) * size
        covered = np.zeros((len(y), len(x)), np.bool_)
        for ring in self.rings:
            closed = ring if self.width is not None else np.vstack([ring, ring[:1]])
            for start, end in pairwise(closed):
                low, high = np.sort([start, end], axis=0)
                rows = slice(*np.searchsorted(y, (low[1] - reach, high[1] + reach)))
                if self.width is None:
                    covered[rows] ^= is_left_of(x, y[rows, np.newaxis], start, end)
                else:
                    cols = slice(*np.searchsorted(x, (low[0] - reach, high[0] + reach)))
                    apart = measure_distance(x[cols], y[rows, np.newaxis], start, end)
                    covered[rows, cols] |= apart <= reach
        return box.within(whole), covered


def is_left_of(x: Float64, y: Float64, start: Float64, end: Float64) -> Bool:
    """(H, W) which points a ray to the right leads from across an edge, its upper end left out."""
    (x_start, y_start), (x_end, y_end) = start, end
    crosses = (y_start <= y) != (y_end <= y)
    rise = y_end - y_start or 1.0  # nothing crosses a level edge
    return np.asarray(crosses & (x < x_start + (y - y_start) * (x_end - x_start) / rise))


def measure_distance(x: Float64, y: Float64, start: Float64, end: Float64) -> Float64:
    """(H, W) how far points are from a piece of a line (m)."""
    away, along = (x - start[0], y - start[1]), end - start
    length = float(along @ along)
    share = (away[0] * along[0] + away[1] * along[1]) / length if length else 0.0
    nearest = np.clip(share, 0, 1)
    return np.asarray(np.hypot(away[0] - nearest * along[0], away[1] - nearest * along[1]))


def apply_edits(grid: OccupancyMap, shapes: Sequence[Shape]) -> OccupancyMap:
    """Draw shapes over a map, one after the other; those that forbid leave it as it is."""
    drawn = [shape for shape in shapes if shape.change in LOG_ODDS]
    if not drawn:
        return grid
    log_odds, observed = grid.log_odds.copy(), grid.observed.copy()
    for shape in drawn:
        window, cells = shape.find_cells(grid.box, grid.resolution)
        log_odds[window][cells] = LOG_ODDS[shape.change]
        observed[window][cells] = shape.change is not Change.UNKNOWN
    return replace(grid, log_odds=log_odds, observed=observed)


def cover(shapes: Iterable[Shape], box: CellBox, resolution: float) -> Bool:
    """(H, W) the cells of a box, of some size (m), that lie in any of some shapes."""
    covered = np.zeros(box.shape, np.bool_)
    for shape in shapes:
        window, cells = shape.find_cells(box, resolution)
        covered[window] |= cells
    return covered


def read_edits(path: Path | None) -> tuple[Shape, ...]:
    """Read a file of edits; None has none.

    Raises
    ------
    UsageError
        It cannot be read, or holds what is no shape.
    """
    if path is None:
        return ()
    try:
        with refuse_unreadable(path, UsageError, "check the path of `edits`"):
            text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise UsageError("is not text", where=path, fix=FORM) from None
    read = read_features if text.lstrip().startswith("{") else read_lines
    return tuple(read(path, text))


FORM = "write lines such as free,box,1,1,2,2.5 or occupied,line,0,0,5,0, or GeoJSON"


def read_lines(path: Path, text: str) -> Iterator[Shape]:
    """Read a shape from each line of a CSV; raises UsageError."""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].rstrip(", \t")  # a spreadsheet makes all rows equally long
        if not words:
            continue
        try:
            change, kind, *numbers = map(str.strip, words.split(","))
            values = [float(word) for word in numbers]
            width = values.pop() if kind == "line" and len(values) % 2 else None
            yield make_shape(change, kind, [np.reshape(values, (-1, 2))], width)
        except ValueError:
            found = f"{line.strip()!r} is no shape"
            raise UsageError(found, where=f"{path}: line {number}", fix=FORM) from None


def read_features(path: Path, text: str) -> Iterator[Shape]:
    """Read the shapes of GeoJSON; raises UsageError."""
    try:
        whole = json.loads(text)
        features, frame = list(whole["features"]), json.dumps(whole.get("crs"))
    except (ValueError, LookupError, TypeError, RecursionError):
        raise UsageError("is no GeoJSON of features", where=path, fix=FORM) from None
    if DEGREES.search(frame):
        fix = "save it in metres of the map, without a CRS"
        raise UsageError("holds degrees (WGS 84)", where=path, fix=fix)
    for number, feature in enumerate(features, start=1):
        try:
            said, geometry = feature["properties"], feature["geometry"]
            kind, parts = geometry["type"].lower(), geometry["coordinates"]
            for part in parts if parts and kind.startswith("multi") else [parts]:
                name, rings = kind.removeprefix("multi"), part
                if name == "linestring":
                    name, rings = "line", [part]
                corners = [np.array(ring, np.float64)[:, :2] for ring in rings]
                yield make_shape(said["class"], name, corners, said.get("width"))
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
            found = f"{json.dumps(feature)[:100]} is no polygon or line with a property `class`"
            classes = f"`class` is {', '.join(Change)}"
            raise UsageError(found, where=f"{path}: feature {number}", fix=classes) from None


def make_shape(change: str, kind: str, rings: Sequence[Float64], width: Any = None) -> Shape:
    """Make a shape of its corners; raises ValueError or TypeError where they make none."""
    if kind == "box":
        ((x, y), (x_end, y_end)) = rings[0]
        rings = [np.array([(x, y), (x_end, y), (x_end, y_end), (x, y_end)])]
    fewest = {"polygon": 3, "box": 4, "line": 2}.get(kind, math.inf)
    sound = [
        ring.shape[1:] == (2,) and len(ring) >= fewest and bool((abs(ring) <= MOST_M).all())
        for ring in rings
    ]
    if not (sound and all(sound)):
        raise ValueError(kind)
    if kind != "line":
        return Shape(Change(change), tuple(rings))
    metres = LINE_WIDTH if width is None else float(width)
    if not 0 < metres < math.inf:
        raise ValueError(width)
    return Shape(Change(change), tuple(rings), metres)
