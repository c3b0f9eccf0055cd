"""Maps that were written, read back as what their cells are, whatever the format.

A cell is occupied, free, or neither; a map image does not tell a cell that nothing observed from
one that stayed undecided, so both are called neither here.
"""

import math
import re
import reprlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from occmap.cells import Box, CellBox, CellClass, Decision
from occmap.errors import MapError, UsageError, refuse_unreadable
from occmap.evidence import read_model
from occmap.report import count
from occmap.store import open_saved
from occmap.store.painting import open_map
from occmap.types import Bool, Float64, Int64, UInt8
from occmap.writers import MapMode, WriteOptions
from occmap.writers.pgm import UNKNOWN

if TYPE_CHECKING:
    from occmap.writers.images import GreyImage

NEGATES = {"0": False, "1": True, "false": False, "true": True}
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
        """Rows and columns of the cells of points (..., 2); those outside are on the border."""
        found = []
        for axis in (1, 0):
            cells = points[..., axis] - self[1 + axis]
            cells /= self.resolution
            np.floor(cells, out=cells).clip(0, shape[1 - axis] - 1, out=cells)
            found.append(cells.astype(np.int64))
        return found[0], found[1]


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
    align: str = ""
    """By what it is turned (degrees), as it says itself; "" where it is not, or does not say"""
    notes: tuple[str, ...] = ()
    """What a user should know of it"""


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
    if (loader := LOADERS.get(path.suffix.lower())) is None:
        found = f"the suffix {path.suffix!r} is not that of a map"
        raise UsageError(found, where=path, fix=f"maps are {', '.join(LOADERS)}")
    if not path.exists():
        raise MapError("no such file", where=path, fix="check the path")
    return loader(path, thresholds)


def load_grey(path: Path, thresholds: WriteOptions) -> ClassMap:
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
    with refuse_unreadable(stating, MapError), stating.open("rb") as file:
        content = file.read(YAML_BYTES)
    meta = parse_meta(stating, parse_yaml(stating, content))
    image = path if is_image else path.parent / meta.image
    if not image.exists():
        found = f"names the image {meta.image}, which is not there"
        raise MapError(found, where=stating, fix="correct its line `image:`")
    lines = re.findall(rb"^# (evidence|align): ([-+.0-9a-f]+)\r?$", content, re.M)
    said = {name.decode(): text.decode() for name, text in lines}
    pixels = read_image(image)
    classes, notes = classify(pixels, meta), list[str]()
    taken = int(np.count_nonzero(classes[pixels.grey[::-1] == UNKNOWN] == CellClass.FREE))
    if taken and meta.mode is MapMode.TRINARY:
        found = f"its free_thresh of {meta.free_thresh:g} makes {count(taken, 'pixel')} of grey"
        fix = "write `free_thresh: 0.196` into it to have them unknown"
        notes = [f"{stating}: {found} {UNKNOWN} free, which map_saver writes for unknown; {fix}"]
    if given := [f"`{it}`" for it in IN_PNG[:2] if getattr(thresholds, it) is not None]:
        notes.append(f"{stating}: its own thresholds count for it, and not {' and '.join(given)}")
    return ClassMap(path, classes, meta.place, image, **said, notes=tuple(notes))


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
    name, turn = image.texts.get("evidence"), image.texts.get("align", "")
    return ClassMap(path, classify(image, meta), None, evidence=name, align=turn)


def load_saved(path: Path, thresholds: WriteOptions) -> ClassMap:
    """Load evidence, from a file or a store, as the map that its own model makes of it.

    Raises
    ------
    MapError
        It cannot be read, or is damaged.
    """
    saved = open_saved(path)
    shown = open_map(saved, read_model(saved))
    made, _ = shown.paint_all()
    classes = replace(made, decision=thresholds.decide(made.decision)).classes
    place, turn = Place(made.resolution, *made.origin), str(saved.manifest.align or "")
    return ClassMap(path, classes, place, evidence=shown.about.evidence, align=turn)


LOADERS: dict[str, Callable[[Path, WriteOptions], ClassMap]] = {
    **dict.fromkeys([".pgm", ".yaml", ".yml"], load_grey),
    ".png": load_png,
    **dict.fromkeys([".npz", ".zarr"], load_saved),
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


def parse_yaml(path: Path, content: bytes) -> dict[str, Any]:
    """Parse YAML of names and values; a value is text, a list or again names and values.

    No value is converted, however long it is, and an alias is not copied but refers to its value.

    Raises
    ------
    MapError
        It is not YAML.
    """
    from ruamel.yaml import YAML  # noqa: PLC0415  late: it takes long to load
    from ruamel.yaml.error import MarkedYAMLError, YAMLError  # noqa: PLC0415  late: as above

    try:
        text = content.decode("utf-8", "surrogateescape")
        values = YAML(typ="base", pure=True).load(text.translate(BYTES))
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
    negate = str(values.get("negate", "0"))
    expect(path, "image", image, isinstance(image, str), "the name of a file such as map.pgm")
    expect(path, "mode", mode, mode in list(MapMode), "trinary, scale or raw")
    expect(path, "negate", negate, negate in NEGATES, "0 or 1")
    resolution, occupied, free = (
        parse_number(path, name, values.get(name))
        for name in ("resolution", "occupied_thresh", "free_thresh")
    )
    wanted = f"no more than occupied_thresh ({occupied:g})"
    expect(path, "free_thresh", free, free <= occupied, wanted)
    image = str(image).translate({private: byte for byte, private in BYTES.items()})
    place = parse_place(path, resolution, values.get("origin"))
    return Meta(image, MapMode(mode), occupied, free, NEGATES[negate], place)


def parse_place(path: Path, resolution: float, origin: Any) -> Place:
    """Check where a map_server YAML says that a map lies; raises MapError."""
    is_triple = isinstance(origin, list) and len(origin) == 3
    expect(path, "origin", origin, is_triple, "[x, y, yaw]")
    x, y, yaw = (parse_number(path, "a value of origin", each) for each in origin)
    if round(math.remainder(yaw, math.tau), 6):  # whole turns turn nothing: 1 cm across 10 km
        found = f"the map is turned by {yaw} rad: it lies on no lattice"
        raise MapError(found, where=path, fix="turn its image, so that the yaw of origin is 0")
    wanted = f"a length up to {FARTHEST_M:g} m"
    expect(path, "resolution", resolution, 0 < resolution <= FARTHEST_M, wanted)
    expect(path, "origin", origin, max(abs(x), abs(y)) <= FARTHEST_M, wanted)
    return Place(resolution, x, y)


def parse_number(path: Path, name: str, value: object) -> float:
    """Check a number of a map_server YAML; raises MapError."""
    number = math.nan
    with suppress(ValueError):
        number = float(value) if isinstance(value, str) else math.nan
    expect(path, name, value, math.isfinite(number), "a number")
    return number


def expect(path: Path, name: str, value: object, is_right: bool, wanted: str) -> None:
    """Refuse a value of a map_server YAML that is not right; raises MapError."""
    if not is_right:
        found = reprlib.repr(value)[:60]  # which may be very long
        raise MapError(f"{name} is {found}, where {wanted} belongs", where=path)


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
