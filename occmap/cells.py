"""What cells hold: the evidence of what was observed, and the map that a model makes of it."""

import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from itertools import product
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap import types
from occmap.types import Bool, Float32, Float64, Int32, Int64, UInt8

MOST_OBSERVED = 1 << 53
"""No number of a cell is larger, or below its negative: a float64 holds it exactly, and a thousand
of them add up without overflow."""
Box: TypeAlias = tuple[float, float, float, float]
"""Lowest x and y, highest x and y (m)"""
Key: TypeAlias = tuple[int, int]
"""Row and column of a tile in the lattice of tiles."""
Tile: TypeAlias = NDArray[np.signedinteger[Any]]
"""(2, 64, 64), as wide as sums may need; row 0 is the lowest y."""


def to_log_odds(probability: float) -> float:
    """ln(p / (1 - p)) of a probability strictly between 0 and 1."""
    return math.log(probability / (1 - probability))


class CellClass(IntEnum):
    """The class of a cell."""

    NEITHER = 0
    """Unknown or undecided: an image may not tell these apart"""
    FREE = 1
    OCCUPIED = 2


class Decision(NamedTuple):
    """The probabilities above which a cell is called occupied, and below which free.

    Between them, both included, it is undecided.
    """

    free_below: float
    occupied_above: float


EVEN_ODDS = Decision(0.5, 0.5)


def cut_squares(layer: NDArray[Any], side: int) -> NDArray[Any]:
    """(H / side, W / side, side * side): each square of a layer (H, W); zeros fill up the last."""
    filled = np.pad(layer, [(0, -length % side) for length in layer.shape])
    rows, cols = (length // side for length in filled.shape)
    squares = filled.reshape(rows, side, cols, side).swapaxes(1, 2)
    return squares.reshape(rows, cols, side * side)


def keep_largest(layer: UInt8, side: int) -> UInt8:
    """(H / side, W / side): the largest number of each square of a layer (H, W).

    Of `CellClass` it makes a square occupied where any cell is, else free where any is.
    """
    return np.asarray(cut_squares(layer, side).max(axis=2))


class About(NamedTuple):
    """What a map is of. All of it is ASCII, as a comment, a tag or a text in a file holds it."""

    occmap: str
    """The version that made it"""
    evidence: str
    """Names what was observed, by `Manifest.identify`"""
    rendering: str
    """Names how that became a map: the model, what is left out, what is drawn over it ..."""
    logs: str
    """Names of the logs"""
    align: float = 0.0
    """By what it is turned against the map of the logs, counter-clockwise (degrees)"""


def list_captions(about: About | None) -> dict[str, str]:
    """List what a file says of its map, by name; nothing where that is not known, or not turned."""
    said = about._asdict() if about else {}
    return {name: str(value) for name, value in said.items() if value}


class CellBox(NamedTuple):
    """A rectangle of cells; the ends are not part of it."""

    row: int
    col: int
    row_end: int
    col_end: int

    @classmethod
    def around(cls, mask: Bool, row: int, col: int) -> Self | None:
        """The smallest box around the cells of a mask (H, W) that are true; None: no cell is.

        The mask begins at cell (row, col).
        """
        rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        if not rows.size:
            return None
        return cls(*map(int, (rows[0], cols[0], rows[-1] + 1, cols[-1] + 1))).move(row, col)

    @classmethod
    def enclose(cls, places: Iterable[Key]) -> Self:
        """The smallest box around some places, at least one."""
        rows, cols = zip(*places, strict=True)
        return cls(min(rows), min(cols), max(rows) + 1, max(cols) + 1)

    @classmethod
    def at(cls, row: int, col: int) -> Self:
        """The box of a single cell."""
        return cls(row, col, row + 1, col + 1)

    @property
    def rows(self) -> int:
        """Height in cells."""
        return self.row_end - self.row

    @property
    def cols(self) -> int:
        """Width in cells."""
        return self.col_end - self.col

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.cols

    @property
    def cells(self) -> int:
        """How many cells it covers."""
        return self.rows * self.cols

    def contains(self, other: Self) -> bool:
        """Whether `other` lies wholly in this box."""
        return self.clip(other) == other

    def find(self, places: Int64) -> Int64:
        """Which of the rows and columns (N, 2) lie in this box."""
        row, col = places.T
        in_rows = (self.row <= row) & (row < self.row_end)
        return np.flatnonzero(in_rows & (self.col <= col) & (col < self.col_end))

    @property
    def places(self) -> Iterator[Key]:
        """Row and column of each of its cells, row by row."""
        return product(range(self.row, self.row_end), range(self.col, self.col_end))

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns in an array that begins at cell (0, 0)."""
        return slice(self.row, self.row_end), slice(self.col, self.col_end)

    def within(self, outer: Self) -> tuple[slice, slice]:
        """Its rows and columns in the array of a box around it."""
        return self.move(-outer.row, -outer.col).slices

    def clip(self, other: Self) -> Self:
        """The part of `other` that lies in this box."""
        return type(self)(
            min(max(other.row, self.row), self.row_end),
            min(max(other.col, self.col), self.col_end),
            max(min(other.row_end, self.row_end), self.row),
            max(min(other.col_end, self.col_end), self.col),
        )

    def move(self, rows: int, cols: int) -> Self:
        """Move the box up by `rows` and to the right by `cols`."""
        ends = (self.row + rows, self.col + cols, self.row_end + rows, self.col_end + cols)
        return type(self)(*ends)

    def grow(self, cells: int) -> Self:
        """The box with so many cells more on each side."""
        ends = self.row_end + cells, self.col_end + cells
        return type(self)(self.row - cells, self.col - cells, *ends)

    def align(self, side: int) -> Self:
        """The smallest box around this one that is made of squares of `side` by `side` cells."""
        ends = (-(-edge // side) * side for edge in (self.row_end, self.col_end))
        return type(self)(self.row // side * side, self.col // side * side, *ends)

    def scale(self, side: int) -> Self:
        """The box in cells, where it counts squares of `side` by `side` cells."""
        return type(self)(*(edge * side for edge in self))

    def shrink(self, side: int) -> Self:
        """Count the box in squares of `side` by `side` cells, of which it is made."""
        return type(self)(*(edge // side for edge in self))

    def cut(self, side: int) -> Iterator[Self]:
        """The parts of the box in squares of `side` by `side` cells, row by row."""
        for place in self.align(side).shrink(side).places:
            yield self.clip(self.at(*place).scale(side))

    def join(self, other: Self) -> Self:
        """The smallest box around both."""
        starts, ends = map(min, self[:2], other[:2]), map(max, self[2:], other[2:])
        return type(self)(*starts, *ends)


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyMap:
    """An occupancy grid. Row 0 is the lowest y and column 0 the lowest x; only writers flip."""

    log_odds: Float32
    """(H, W) of being occupied; the prior where nothing was observed"""
    observed: Bool
    """(H, W); a cell that nothing observed is unknown, whatever its log-odds"""
    resolution: float
    """Side of a cell (m)"""
    origin: tuple[float, float]
    """x, y of the lower-left corner of cell (0, 0) (m)"""
    decision: Decision = EVEN_ODDS
    """The probabilities that make a cell occupied or free"""
    agreement: float | None = None
    """Share of all hits that lie in cells called occupied: low where poses are wrong. None where
    the evidence keeps no hits"""
    about: About | None = None
    """What it is of; None where nobody said"""

    @property
    def probability(self) -> Float32:
        """(H, W) probability of being occupied, 1 / (1 + exp(-log_odds))."""
        # Neither power of e overflows.
        return np.asarray(np.exp(np.minimum(self.log_odds, 0)) / (1 + np.exp(-abs(self.log_odds))))

    @property
    def occupied(self) -> Bool:
        """(H, W): observed, and more probably occupied than the decision asks for."""
        above: Bool = self.log_odds > np.float32(to_log_odds(self.decision.occupied_above))
        return self.observed & above

    @property
    def free(self) -> Bool:
        """(H, W): observed, and less probably occupied than the decision asks for."""
        below: Bool = self.log_odds < np.float32(to_log_odds(self.decision.free_below))
        return self.observed & below

    @property
    def classes(self) -> UInt8:
        """(H, W) of CellClass."""
        classes = np.full(self.shape, CellClass.NEITHER, np.uint8)
        classes[self.free] = CellClass.FREE
        classes[self.occupied] = CellClass.OCCUPIED
        return classes

    def take(self, rows: slice, cols: slice) -> Self:
        """A part of the map; its arrays are views."""
        x, y = self.origin
        right, up = (cols.start or 0) * self.resolution, (rows.start or 0) * self.resolution
        start = round(x + right, 12), round(y + up, 12)
        log_odds, observed = self.log_odds[rows, cols], self.observed[rows, cols]
        return replace(self, log_odds=log_odds, observed=observed, origin=start)

    @property
    def box(self) -> CellBox:
        """Its cells, on the lattice of its resolution."""
        row, col = (round(edge / self.resolution) for edge in self.origin[::-1])
        return CellBox(row, col, row + self.shape[0], col + self.shape[1])

    @property
    def extent(self) -> Box:
        """Lowest x and y, highest x and y (m)."""
        (rows, cols), (x, y) = self.shape, self.origin
        right, top = x + cols * self.resolution, y + rows * self.resolution
        return x, y, round(right, 12), round(top, 12)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.log_odds.shape
        return rows, cols


@dataclass(frozen=True)
class Manifest:
    """What evidence is, and what it was made of; every value is one that JSON has."""

    resolution: float
    """Side of a cell (m)"""
    update: str
    kind: str
    """What the two numbers of a cell are: "counts" or "log_odds"."""
    profile: str
    """The radial model that log-odds were summed by, without prior and bounds; "" for counts"""
    pass_gap_s: float
    """How long a slice of time is, by which visits are told apart (s)"""
    hit_offset: float
    """How far behind the measured points hits lie (cells)"""
    model: str
    """The model to render with, unless the user wants another"""
    builds: tuple[dict[str, Any], ...]
    """What was added: inputs and their hashes, options, scans; see `occmap.evidence.manifest`"""
    subtracted: tuple[dict[str, Any], ...] = ()
    """What was taken away that no entry of `builds` stands for"""
    align: float | None = 0.0
    """By what the map is turned (degrees); None only in a plan: it is yet to be found"""

    def identify(self, total: int) -> str:
        """Name evidence by 12 hex digits: the same for the same numbers in all cells.

        Parameters
        ----------
        total
            `sum_tiles` of all of its tiles.
        """
        what = f"{self.resolution} {self.update} {self.profile} {total % 2**64}"
        return hashlib.sha256(what.encode()).hexdigest()[:12]

    @classmethod
    def from_json(cls, said: Mapping[str, Any]) -> Self:
        """Make one of what a file says; raises LookupError or TypeError where it lacks some."""
        fields = {name: said[name] for name in cls.__dataclass_fields__}
        lists = {name: tuple(said[name]) for name in ("builds", "subtracted")}
        return cls(**{**fields, **lists})


def sum_tiles(tiles: Mapping[Key, Tile]) -> int:
    """Sum all numbers of tiles (2, 64, 64), each times a factor of its own place (row, column).

    So what holds no observation adds nothing, no order counts, and sums of parts are that of all.
    """
    total = 0
    for (row, col), tile in tiles.items():
        place = hashlib.sha256(f"{row} {col}".encode()).digest()[:8]
        inner = np.dot(tile.ravel().astype(np.uint64), make_factors(tile.size))
        total += int(inner) * (int.from_bytes(place) | 1)
    return total


@cache
def make_factors(count: int) -> NDArray[np.uint64]:
    """(count,) numbers of 64 bits that look like random ones, and are the same everywhere."""
    return np.frombuffer(hashlib.shake_256(b"occmap").digest(8 * count), "<u8").astype(np.uint64)


def stack_tiles(tiles: Mapping[Key, Tile]) -> tuple[Int64, Tile]:
    """Row and column of each tile (T, 2), in ascending order, and their cells (T, 2, 64, 64)."""
    keys = sorted(tiles)
    none = np.zeros((0, 2, 64, 64), np.int64)
    cells = np.stack([tiles[key] for key in keys]) if keys else none
    return np.array(keys, np.int64).reshape(-1, 2), cells


def view_tiles(places: Int64, cells: Tile) -> dict[Key, Tile]:
    """Stacked tiles by their places; they share the stack's memory."""
    return {(row, col): tile for (row, col), tile in zip(places.tolist(), cells, strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class Slices:
    """Which cells were hit and seen in which slices of time, a tile at a time.

    Slice n lasts from n to n + 1 times `Manifest.pass_gap_s`, counted from stamp 0, so that logs
    and builds share their slices. A tile in a slice has a bit for each cell that was hit and for
    each that was seen, (2, 64, 64). Of these only the bytes are kept that differ from those of the
    row before, about 50 of 1024; `occmap.grid.tiles` packs and unpacks them.
    """

    tiles: Int64
    """(K, 2) row and column of each tile, in ascending order"""
    numbers: Int64
    """(K,) the slice in which each was seen; ascending for one tile"""
    rows: UInt8
    """(K, 16) a bit for each of the 2 x 64 rows: whether it differs from the row before"""
    parts: UInt8
    """(R,) a bit for each of the 8 bytes of those R rows: whether it differs"""
    changes: UInt8
    """(C,) those bytes, XORed with the bytes of the row before; in the order of `np.packbits`"""

    @property
    def nbytes(self) -> int:
        """Their size in memory (bytes)."""
        return sum(getattr(self, name).nbytes for name in self.__dataclass_fields__)

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """Concatenate slices; of none, the result is empty."""
        no_tiles, nothing = np.zeros((0, 2), np.int64), np.zeros(0, np.uint8)
        empty = cls(no_tiles, no_tiles[:, 0], nothing.reshape(0, 16), nothing, nothing)
        all_of_them = (empty, *parts)
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(s, name) for s in all_of_them]) for name in names))


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground that clouds were traced over: heights of columns of 0.15 m, in blocks of 64 x 64.

    Column (row, col) reaches from (col, row) to (col + 1, row + 1) times 0.15 m.
    """

    blocks: Int64
    """(B, 2) row and column of each block, in ascending order"""
    height_mm: Int32
    """(B, 4096) heights in the map; -2^30: no ground is known"""
    measured: Bool
    """(B, 4096) where points showed it; elsewhere it is filled from columns beside it"""

    def find_heights(self, place: Float64) -> Float64:
        """Find how high it was measured at places (N, 2 or more) (m); NaN where it was not."""
        column = np.floor(place[:, 1::-1] * (1000 / types.COLUMN_MM)).astype(np.int64)
        bits = types.BLOCK_BITS
        at, inside = self.find_blocks(column >> bits), column & ((1 << bits) - 1)
        flat = (inside[:, 0] << bits) + inside[:, 1]
        known = (at >= 0) & self.measured[at, flat]
        return np.where(known, self.height_mm[at, flat] / 1000, np.nan)

    def find_blocks(self, places: Int64) -> Int64:
        """Find which of its blocks lies at each of some places (N, 2); -1 where none does."""
        keys, wanted = ((each[:, 0] << 32) + each[:, 1] for each in (self.blocks, places))
        keys = np.append(keys, np.iinfo(np.int64).max)  # behind all that there are
        at = np.searchsorted(keys, wanted)
        return np.where(keys[at] == wanted, at, -1)

    def lay_out(self, blocks: Int64) -> "Ground":
        """Put it in its place among more blocks (B, 2), which are in ascending order."""
        at = self.find_blocks(blocks)
        there = (at >= 0)[:, np.newaxis]
        height = np.where(there, self.height_mm[at], np.int32(types.NO_GROUND))
        return Ground(blocks, height, there & self.measured[at])

    def measure_rise(self, other: "Ground") -> Int32:
        """How much higher another ground is in each column that both measured (N,; mm)."""
        its = other.find_blocks(self.blocks)
        mine = its >= 0
        both = self.measured[mine] & other.measured[its[mine]]
        return (other.height_mm[its[mine]] - self.height_mm[mine])[both]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What was observed, as a file holds it: integers in tiles, and what they were made of."""

    manifest: Manifest
    tiles: Mapping[Key, Tile]
    """The two numbers of every cell, by row and column of its tile; nobody writes to them"""
    slices: tuple[Slices, ...] = ()
    """When cells were observed, for each of the manifest's builds"""
    where: str = ""
    """The file that it was read from"""
    notes: tuple[str, ...] = ()
    """What there is to say of what it was made of; no file keeps that"""
    ground: Ground | None = None
    """What clouds were traced over"""
