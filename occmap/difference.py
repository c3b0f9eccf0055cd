"""What changed between two maps on one lattice: cells by class, the largest blob, a picture.

Maps that were written are read back as what their cells are, whatever the format. A cell is
occupied, free, or neither; a map image does not tell a cell that nothing observed from one that
stayed undecided, so both are called neither here.
"""

import math
import re
import reprlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from occmap.cells import Box, CellClass, Decision, OccupancyMap
from occmap.errors import MapError, UsageError
from occmap.evidence import read_model
from occmap.grid import CellBox
from occmap.grid.tiles import MAX_CELLS
from occmap.report import HIDDEN, Count, Printed, Share, printed_as
from occmap.store import as_blocks, identify, open_saved
from occmap.store.publishing import classify_blocks, open_map
from occmap.types import Bool, Float64, Int64, UInt8
from occmap.writers import MapMode, WriteOptions
from occmap.writers.edits import Shape, apply_edits

if TYPE_CHECKING:
    from occmap.writers.images import GreyImage


IN_PNG = ("free_thresh", "occupied_thresh", "negate")
"""What a PNG of occmap says of its pixels, as a YAML would"""
YAML_BYTES = 1 << 16
"""A map's YAML has a dozen lines."""
FARTHEST_M = 1e15
"""Farther out, or with larger cells, a float cannot tell one cell from the next."""
BYTES = {0xDC80 + byte: 0xE080 + byte for byte in range(128)}
"""Private characters for bytes of file names that are not UTF-8: YAML has no surrogates."""


class Place(NamedTuple):
    """Where a map lies in the world."""

    resolution: float
    """Side of a cell (m)"""
    x: float
    y: float
    """Lower-left corner of cell (0, 0) (m)"""

    def measure(self, box: CellBox) -> Box:
        """Lowest x and y, highest x and y of a box of cells (m)."""
        row, col, row_end, col_end = (edge * self.resolution for edge in box)
        return self.x + col, self.y + row, self.x + col_end, self.y + row_end

    def list_middles(self, mask: Bool) -> Float64:
        """(N, 2) x and y of the middles of the cells of a mask (H, W) that are true (m)."""
        rows, cols = np.nonzero(mask)
        return np.column_stack([cols + 0.5, rows + 0.5]) * self.resolution + self[1:]

    def find_cells(self, points: Float64, shape: tuple[int, ...]) -> tuple[Int64, Int64]:
        """Rows and columns of the cells of points (N, 2); those outside are on the border."""
        cells = np.floor((points - self[1:]) / self.resolution)
        cols, rows = np.clip(cells, 0, np.array(shape[::-1]) - 1).astype(np.int64).T
        return rows, cols


@dataclass(frozen=True, slots=True, eq=False)
class ClassMap:
    """A map as classes of cells."""

    path: Path
    classes: UInt8
    """(H, W) of CellClass; row 0 is the lowest y"""
    place: Place | None
    """None: a bare image, which says nothing of the world"""
    image: Path | None = None
    """What the cells were read from, where that is another file than `path`"""
    evidence: str | None = None
    """Names what was observed, by `Manifest.identify`; None where an image does not say"""


def load_map(path: Path, thresholds: WriteOptions) -> ClassMap:
    """Load a map that was written before.

    Parameters
    ----------
    path
        A map_server YAML, a PGM with its YAML beside it, a PNG of probabilities, or evidence.
    thresholds
        For formats that hold probabilities; a YAML states its own.

    Raises
    ------
    UsageError
        Not a format of maps.
    MapError
        A file is missing or damaged.
    """
    loader = LOADERS.get(path.suffix.lower())
    if loader is None:
        found = f"the suffix {path.suffix!r} is not that of a map"
        raise UsageError(found, where=path, fix=f"maps are {', '.join(LOADERS)}")
    if not path.exists():
        raise MapError("no such file", where=path, fix="check the path")
    return loader(path, thresholds)


def load_grey(path: Path, _thresholds: WriteOptions) -> ClassMap:
    """Load the image that a map_server YAML names, or a PGM by the YAML of its name.

    Raises
    ------
    MapError
        The YAML or its image is missing, damaged or not of a map.
    """
    is_image = path.suffix.lower() == ".pgm"
    stating = path.with_suffix(".yaml") if is_image else path
    if not stating.is_file():
        raise MapError(f"there is no {stating.name} beside it", where=path, fix="give the YAML")
    meta = parse_meta(stating, read_yaml(stating))
    image = path if is_image else path.parent / meta.image
    with stating.open("rb") as file:
        said = re.search(rb"^# evidence: ([0-9a-f]{12})$", file.read(YAML_BYTES), re.M)
    name = said[1].decode() if said else None
    return ClassMap(path, classify(read_image(image), meta), meta.place, image, evidence=name)


def load_png(path: Path, thresholds: WriteOptions) -> ClassMap:
    """Load a PNG: transparent is neither, and a text in it says how the rest is decided.

    Where it has none, dark is occupied.

    Raises
    ------
    MapError
        It cannot be read.
    """
    image = read_image(path)
    said = {name: text for name, text in image.texts.items() if name in IN_PNG}
    free, occupied = thresholds.thresholds
    if len(said) == len(IN_PNG):
        stated = (parse_number(path, name, said[name]) for name in IN_PNG[:2])
        free, occupied = thresholds.decide(Decision(*stated))
    meta = Meta(path.name, MapMode.TRINARY, occupied, free, said.get("negate") == "1")
    name = image.texts.get("evidence")
    return ClassMap(path, classify(image, meta), None, evidence=name)


def load_saved(path: Path, thresholds: WriteOptions) -> ClassMap:
    """Load evidence, from a file or a store, as the map that its own model makes of it.

    Raises
    ------
    MapError
        It cannot be read, or is damaged.
    """
    saved = open_saved(path)
    made = open_map(as_blocks(saved), read_model(saved))
    x, y, *_ = made.extent
    classes = classify_blocks(made, thresholds, MAX_CELLS)
    return ClassMap(path, classes, Place(made.resolution, x, y), evidence=identify(saved))


LOADERS: dict[str, Callable[[Path, WriteOptions], ClassMap]] = {
    ".pgm": load_grey,
    ".yaml": load_grey,
    ".yml": load_grey,
    ".png": load_png,
    ".npz": load_saved,
    ".zarr": load_saved,
}


@dataclass(frozen=True)
class Meta:
    """What a map_server YAML says (wiki.ros.org/map_server)."""

    image: str
    mode: MapMode
    occupied_thresh: float
    free_thresh: float
    negate: bool = False
    place: Place | None = None


def brief(value: object) -> str:
    """Write a value of a YAML, cut where it is very long."""
    return reprlib.repr(value)[:60]


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file of names and values; a value is text, a list or again names and values.

    No value is converted, however long it is, and an alias is not copied but refers to its value.

    Raises
    ------
    MapError
        It is not YAML.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  late: it takes long to load
    from ruamel.yaml.error import MarkedYAMLError, YAMLError  # noqa: PLC0415  late: as above

    try:
        with path.open("rb") as file:
            text = file.read(YAML_BYTES).decode("utf-8", "surrogateescape")
        values = YAML(typ="base", pure=True).load(text.translate(BYTES))
    except OSError as error:
        raise MapError(f"cannot be read ({error.strerror})", where=path) from None
    except (YAMLError, ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        if isinstance(error, MarkedYAMLError) and error.problem_mark:
            reason = f"line {error.problem_mark.line + 1}: {error.problem}"
        raise MapError(f"is not YAML ({reason})", where=path) from None
    if not isinstance(values, dict):
        raise MapError("is not the YAML of a map: it holds no names with values", where=path)
    return values


def parse_meta(path: Path, values: dict[str, Any]) -> Meta:
    """Check what a map_server YAML says.

    Raises
    ------
    MapError
        A value is missing or impossible, or the map is turned.
    """
    image, mode = values.get("image"), values.get("mode", MapMode.TRINARY.value)
    if not isinstance(image, str):
        raise MapError("names no image", where=path, fix="add a line such as `image: map.pgm`")
    if mode not in list(MapMode):
        raise MapError(
            f"{brief(mode)} is not a mode of a map", where=path, fix="trinary, scale or raw"
        )
    resolution, occupied, free = (
        parse_number(path, name, values.get(name))
        for name in ("resolution", "occupied_thresh", "free_thresh")
    )
    if not 0 < resolution <= FARTHEST_M:
        raise MapError(f"a resolution of {resolution} m is not possible", where=path)
    negate = values.get("negate", "0")
    if negate not in ("true", "false"):
        negate = "true" if parse_number(path, "negate", negate) else "false"
    place = Place(resolution, *parse_origin(path, values.get("origin")))
    image = image.translate({private: byte for byte, private in BYTES.items()})
    return Meta(image, MapMode(mode), occupied, free, negate == "true", place)


def parse_number(path: Path, name: str, value: object) -> float:
    """Check a number of a map_server YAML.

    Raises
    ------
    MapError
        It is missing, or not a number.
    """
    with suppress(ValueError):
        if isinstance(value, str) and math.isfinite(number := float(value)):
            return number
    raise MapError(f"{name} is {brief(value)}, where a number belongs", where=path)


def parse_origin(path: Path, value: object) -> tuple[float, float]:
    """Check the origin of a map_server YAML: x, y and a yaw of 0.

    Raises
    ------
    MapError
        It is missing, or the map is turned.
    """
    if not isinstance(value, list) or len(value) != 3:
        raise MapError(f"origin is {brief(value)}, where [x, y, yaw] belongs", where=path)
    x, y, yaw = (parse_number(path, "a value of origin", each) for each in value)
    if yaw:
        raise MapError(f"the map is turned by {yaw} rad: it lies on no lattice", where=path)
    if max(abs(x), abs(y)) > FARTHEST_M:
        raise MapError(f"an origin of ({x:g}, {y:g}) m is too far away", where=path)
    return x, y


def read_image(path: Path) -> "GreyImage":
    """Read an image as shades of grey; raises MapError where it cannot be read."""
    from occmap.writers.images import read_grey  # noqa: PLC0415  late: it brings pillow

    return read_grey(path)


def classify(image: "GreyImage", meta: Meta) -> UInt8:
    """(H, W) of CellClass, row 0 lowest, by the rules of map_server."""
    grey, visible, _ = image
    levels = np.arange(256)
    if meta.mode is MapMode.RAW:
        known = levels <= 100  # above, a value says nothing
        occupied = known & (levels >= 100 * meta.occupied_thresh)
        free = known & (levels <= 100 * meta.free_thresh)
    else:
        occupancy = (levels if meta.negate else 255 - levels) / 255
        occupied, free = occupancy > meta.occupied_thresh, occupancy < meta.free_thresh
    table = np.select([occupied, free], [CellClass.OCCUPIED, CellClass.FREE], CellClass.NEITHER)
    classes: UInt8 = np.where(visible, table.astype(np.uint8)[grey], np.uint8(CellClass.NEITHER))
    return classes[::-1]


def find_largest_blob(mask: Bool) -> tuple[int, CellBox] | None:
    """Count the cells of the largest blob, and find its box; None where the mask is empty.

    A blob is connected over the edges or corners of its cells; of several alike it is the lowest.
    """
    row, start, end = runs = find_runs(mask)
    if not len(row):
        return None
    labels = label_connected(len(row), *find_contacts(runs, mask.shape[1]))
    cells = np.bincount(labels, weights=end - start)
    row, start, end = runs[:, labels == np.argmax(cells)]
    box = CellBox(int(row[0]), int(start.min()), int(row[-1]) + 1, int(end.max()))
    return int(cells.max()), box


def find_runs(mask: Bool) -> Int64:
    """(3, N) row, first column and column behind the last of each run of cells in a mask (H, W)."""
    change = np.diff(np.pad(mask, [(0, 0), (1, 1)]).view(np.int8), axis=1)
    row, start = np.nonzero(change == 1)
    _, end = np.nonzero(change == -1)
    return np.stack([row, start, end])


def find_contacts(runs: Int64, cols: int) -> tuple[Int64, Int64]:
    """Pairs of runs in neighbouring rows that share an edge or a corner; (C,) each.

    What a run touches in the row above it begins with the first run that ends where it starts or
    later, and goes up to the last one that starts where it ends or earlier.
    """
    row, start, end = runs
    stride = cols + 2  # a run that ends with a row touches none that begins the next
    above = (row + 1) * stride
    first = np.searchsorted(row * stride + end, above + start, "left")
    last = np.searchsorted(row * stride + start, above + end, "right")
    count = np.maximum(last - first, 0)
    lower = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(lower)) - np.repeat(np.cumsum(count) - count, count)
    return lower, np.repeat(first, count) + step


def label_connected(count: int, one: Int64, other: Int64) -> Int64:
    """(count,) labels of things that pairs connect: the smallest number among the connected.

    Every round gives each label the smallest that it touches, then follows labels to their end, so
    that a long snake takes few rounds.
    """
    labels = np.arange(count)
    while True:
        lowest = np.minimum(labels[one], labels[other])
        target = labels.copy()
        np.minimum.at(target, labels[one], lowest)
        np.minimum.at(target, labels[other], lowest)
        while not np.array_equal(target, target[target]):
            target = target[target]
        if np.array_equal(target[labels], labels):
            return labels
        labels = target[labels]


LATTICE_TOLERANCE = 0.05
"""In cells: other tools round the origin to millimetres."""
SAME_RESOLUTION = 1e-6
"""Relative: so little that it does not add up to a cell across a map."""

FREE, OCCUPIED, NEITHER = CellClass.FREE, CellClass.OCCUPIED, CellClass.NEITHER
COLOURS = {
    (NEITHER, NEITHER): (205, 205, 205),
    (FREE, FREE): (254, 254, 254),
    (OCCUPIED, OCCUPIED): (0, 0, 0),
    (FREE, NEITHER): (204, 121, 167),
    (OCCUPIED, NEITHER): (136, 34, 85),
    (NEITHER, FREE): (86, 180, 233),
    (NEITHER, OCCUPIED): (230, 159, 0),
    (OCCUPIED, FREE): (0, 114, 178),
    (FREE, OCCUPIED): (213, 94, 0),
}
"""Of what a cell was and is: warm is new and occupied, blue new and free, wine a lost wall, pink
lost floor. Colour-blind people tell these apart, too (Okabe and Ito, 2008; wine: Tol, 2021). Where
cells share a pixel, the latest of these shows."""


@dataclass(frozen=True)
class ChangedBlob:
    """Connected cells that changed."""

    cells: int
    """Cells that are connected over their edges or corners"""
    extent: Box
    """Lowest x and y, highest x and y (m; cells where the maps are bare images)"""


@dataclass(frozen=True, eq=False, kw_only=True)
class MapDifference(Printed):
    """What changed between two maps: what occmap diff prints."""

    share: Share
    """Share of the known cells that changed"""
    known: Count
    """Cells that are occupied or free in either map"""
    changed_cells: Count = field(metadata=printed_as("changed"))
    """Cells that changed"""
    changed: dict[str, Count] = field(metadata=printed_as("by_class"))
    """Cells that changed, by what they were and are, such as free to occupied"""
    edited: Count | None
    """Those of them where the shapes of `edits` lie, and may have changed them; null without"""
    largest: ChangedBlob | None = field(metadata=printed_as("largest_blob"))
    """The largest connected change; null where nothing changed"""
    columns: Count
    """Cells of both maps together from left to right (along x)"""
    rows: Count
    """Cells of both maps together from bottom to top (along y)"""
    evidence: tuple[str | None, str | None]
    """Name of what was observed for each map, equal where each cell was observed alike, in whatever
    file; null for an image that does not say"""
    before: UInt8 = field(metadata=HIDDEN)
    after: UInt8 = field(metadata=HIDDEN)
    """(H, W) of CellClass, over both maps; NEITHER is also what a map does not reach"""
    place: Place = field(metadata=HIDDEN)
    """Where cell (0, 0) of both lies"""


def compare_maps(before: ClassMap, after: ClassMap, shapes: Sequence[Shape] = ()) -> MapDifference:
    """Compare two maps cell by cell; they may be of different size.

    Parameters
    ----------
    shapes
        Edits that were drawn over one of them or both.

    Raises
    ------
    MapError
        They lie on different lattices, or too far apart.
    """
    place, shift = align(before, after)
    first = CellBox(0, 0, *before.classes.shape)
    second = CellBox(0, 0, *after.classes.shape).move(*shift)
    both = first.join(second)
    if both.cells > MAX_CELLS:
        found = f"both maps together take {both.cols} x {both.rows} cells, too many to compare"
        raise MapError(found, where=after.path, fix="check that both are in one map frame")
    one, other = place_in(both, first, before.classes), place_in(both, second, after.classes)
    corner = Place(place.resolution, *place.measure(both)[:2])
    blob = find_largest_blob(one != other)
    changed, known = count_changes(one, other), int(np.count_nonzero(one | other))
    changed_cells = sum(changed.values())
    edited = None
    if shapes:
        nothing = np.full(both.shape, np.nan, np.float32)
        blank = OccupancyMap(nothing, one > 0, corner.resolution, (corner.x, corner.y))
        is_drawn = ~np.isnan(apply_edits(blank, shapes).log_odds)
        edited = int(np.count_nonzero(is_drawn & (one != other)))
    return MapDifference(
        share=changed_cells / max(known, 1),
        known=known,
        changed_cells=changed_cells,
        changed=changed,
        edited=edited,
        largest=blob and ChangedBlob(blob[0], corner.measure(blob[1])),
        columns=both.cols,
        rows=both.rows,
        evidence=(before.evidence, after.evidence),
        before=one,
        after=other,
        place=corner,
    )


def align(before: ClassMap, after: ClassMap) -> tuple[Place, tuple[int, int]]:
    """Find the row and column of the first map that the second one's cell (0, 0) lies on.

    Raises
    ------
    MapError
        There is no such cell, or a bare image differs in size from the other map.
    """
    a, b = before.place, after.place
    if a is None or b is None:
        if before.classes.shape != after.classes.shape:
            bare = before.path if a is None else after.path
            found = "a PNG does not say where it lies, and the two maps differ in size"
            raise MapError(found, where=bare, fix="compare the maps as PGM with YAML, or as .npz")
        return a or b or Place(1.0, 0.0, 0.0), (0, 0)
    if abs(a.resolution - b.resolution) > SAME_RESOLUTION * a.resolution:
        found = f"its cells are {b.resolution:g} m, those of {before.path} {a.resolution:g} m"
        raise MapError(found, where=after.path, fix="build both with one `resolution`")
    row, col = (b.y - a.y) / a.resolution, (b.x - a.x) / a.resolution
    if max(abs(row - round(row)), abs(col - round(col))) > LATTICE_TOLERANCE:
        found = f"lies {col:.3f} columns and {row:.3f} rows from {before.path}: not on one lattice"
        fix = "maps that occmap builds with one `resolution` share a lattice"
        raise MapError(found, where=after.path, fix=fix)
    return a, (round(row), round(col))


def place_in(both: CellBox, box: CellBox, classes: UInt8) -> UInt8:
    """Put a map, which covers a box, into a larger one; its other cells are neither."""
    larger = np.full(both.shape, NEITHER, np.uint8)
    larger[box.within(both)] = classes
    return larger


def count_changes(before: UInt8, after: UInt8) -> dict[str, int]:
    """Count cells by what they were and are, where these differ."""
    counts = np.bincount((3 * before + after).ravel(), minlength=9)
    return {
        f"{was.name.lower()} to {now.name.lower()}": int(counts[3 * was + now])
        for was, now in permutations(CellClass, 2)
    }


def paint(difference: MapDifference) -> UInt8:
    """(H, W, 3) red, green, blue, highest y on top: the map, and in colour what changed."""
    table = np.zeros((3, 3, 3), np.uint8)
    for (was, now), colour in COLOURS.items():
        table[was, now] = colour
    return table[difference.before, difference.after][::-1]
