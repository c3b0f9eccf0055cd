"""Sparse tiles of integers: what was observed, not yet what it means.

A tile exists only where something was observed, so a pose far away costs a tile and not all the
space between. A cell has two numbers; sums of integers do not depend on their order.

Slices of time tell which cells each of them hit and saw. A visit of a cell is a run of consecutive
slices in which it was seen. Slices are what is kept, since they merge: what is in either of two
parts is in the whole, at a seam between them, too. This module does not load numba.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from occmap.cells import MOST_OBSERVED, CellBox, Key, Slices, Tile, stack_tiles
from occmap.errors import MapError
from occmap.grid import Lattice, kernels
from occmap.grid.kernels import BEAM_WEIGHT, COUNT_BITS, NEAR_WEIGHT, TABLE_STEPS, Tables
from occmap.report import write_metres
from occmap.types import Bool, Float64, Int64, UInt8, Update

TILE = kernels.TILE
"""Cells along the side of a tile."""
PART = 4 * TILE
"""Cells along the side of what is worked out at a time."""
MAX_CELLS = 10**9
"""The most cells of a map, unless the user allows more."""
INT32_LIMIT = 2**31 - 1
LOG_ODDS_UNIT = 1 / 65536
"""What 1 means in a tile of log-odds."""

CellNumbers: TypeAlias = tuple[Float64, Float64]
"""(H, W) each, in observations: hits and misses, or log-odds and observations."""


class EvidenceKind(StrEnum):
    """What the two numbers of a cell are."""

    COUNTS = "counts"
    """Hits, misses."""
    LOG_ODDS = "log_odds"
    """Sum of log-odds in units of 1/65536, number of observations."""


class TileGrid:
    """Evidence of one kind on one lattice; it grows while a map is built."""

    def __init__(self, lattice: Lattice, kind: EvidenceKind, unit: int = 1) -> None:
        self.lattice = lattice
        self.kind = kind
        self.unit = unit
        """What one observation weighs in the numbers of a cell"""
        self.tiles: dict[Key, Tile] = {}
        self._bounds: dict[Key, int] = {}

    def add(self, tiles: Mapping[Key, Tile], bound: int) -> None:
        """Add what was observed to tiles at the same places, made wider before a sum overflows.

        The tiles now belong to the grid. They may be parts of one large array, which stays in
        memory while any of them is kept: so where some are not kept, the others are copied. A tile
        of `add_tiles` is 64 bits wide already, and has no bound.

        Parameters
        ----------
        bound
            No value in them is larger than this, either way.
        """
        kept_whole = self.tiles.keys().isdisjoint(tiles)
        for key, tile in tiles.items():
            total = self._bounds[key] = self._bounds.get(key, 0) + bound
            mine = self.tiles.get(key)
            if mine is None:
                self.tiles[key] = tile if kept_whole else tile.copy()
                continue
            if total > np.iinfo(mine.dtype).max:
                mine = self.tiles[key] = mine.astype(np.min_scalar_type(-1 - total))
            mine += tile

    def merge(self, other: Self) -> None:
        """Take over the evidence of another grid of the same lattice and kind."""
        self.add(other.tiles, max(other._bounds.values(), default=INT32_LIMIT + 1))

    def like(self, tiles: Mapping[Key, Tile]) -> "TileGrid":
        """A grid of these tiles instead, on the same lattice and of the same kind."""
        made = TileGrid(self.lattice, self.kind, self.unit)
        made.tiles.update(tiles)
        return made

    def refuse_outgrown(self, max_cells: int) -> None:
        """Refuse evidence that makes too large a map already, before more is added to it.

        Raises
        ------
        MapError
            The smallest map that all tiles can be a part of is too large.
        """
        if not self.tiles:
            return
        # Maybe only the innermost cells of the outermost tiles are observed.
        row, col, row_end, col_end = CellBox.enclose(self.tiles).scale(TILE).grow(1 - TILE)
        box = CellBox(row, col, max(row_end, row + 1), max(col_end, col + 1))
        refuse_large(box, self.lattice, max_cells)

    def observed(self, first: NDArray[Any], second: NDArray[Any]) -> Bool:
        """Which cells hold an observation, by their two numbers, of any shape."""
        return np.asarray((first != 0) | (second != 0))

    def mark_seen(self, number: int) -> Slices:
        """Mark what was hit and seen, where all of it was in slice `number`."""
        tiles, cells = stack_tiles(self.tiles)
        bits = np.packbits(cells != 0, axis=-1)
        if self.kind is EvidenceKind.COUNTS:
            bits[:, 1] |= bits[:, 0]
        else:
            bits[:, 0] = 0  # the sum of log-odds, which says nothing of hits
        return pack_bits(tiles, np.full(len(tiles), number), bits)

    def find_box(self, key: Key) -> CellBox | None:
        """The smallest box around the observed cells of a tile; None: it has none."""
        row, col = key
        return CellBox.around(self.observed(*self.tiles[key]), row * TILE, col * TILE)

    def gather(self, box: CellBox, dtype: DTypeLike = np.int64) -> NDArray[Any]:
        """(2, H, W): what the tiles hold of the cells of a box; 0 where there is no tile."""
        whole = box.align(TILE)
        cells = np.zeros((2, *whole.shape), dtype)
        for row, col in whole.shrink(TILE).places:
            if (tile := self.tiles.get((row, col))) is not None:
                up, right = row * TILE - whole.row, col * TILE - whole.col
                cells[:, up : up + TILE, right : right + TILE] = tile
        return cells[:, *box.within(whole)]

    def read(self, box: CellBox) -> CellNumbers:
        """(H, W) each: the numbers of the cells of a box, in observations."""
        cells = self.gather(box, np.float64)
        cells /= self.unit
        return cells[0], cells[1]

    def list_parts(self, box: CellBox) -> Iterator[CellBox]:
        """Cut a box into parts of which a processor's cache holds all that is worked out.

        Parts more than a cell away from every tile are left out.
        """
        for part in box.cut(PART):
            near = part.grow(1).align(TILE).shrink(TILE)
            if not self.tiles.keys().isdisjoint(near.places):
                yield part


def add_tiles(tiles: Mapping[Key, Tile], others: Mapping[Key, Tile]) -> dict[Key, Tile]:
    """Add tiles to others; a sum is 64 bits wide, and no tile is written to.

    Raises
    ------
    MapError
        A sum is more than evidence may hold.
    """
    total = dict(tiles)
    for key, tile in others.items():
        added = total[key] = tile.astype(np.int64) + tiles.get(key, 0)
        if max(-int(added.min()), int(added.max())) > MOST_OBSERVED:
            found = f"the observations of a cell add up to more than {MOST_OBSERVED:,}"
            fix = "no log holds so many: build the evidence again from its logs"
            raise MapError(found, fix=fix)
    return total


def drop_empty(tiles: Mapping[Key, Tile]) -> dict[Key, Tile]:
    """Leave out tiles in which nothing is observed any more."""
    return {key: tile for key, tile in tiles.items() if tile.any()}


def refuse_large(box: CellBox, lattice: Lattice, max_cells: int) -> None:
    """Refuse a map of more cells than the user allows.

    Raises
    ------
    MapError
        Saying how far it would reach, and what to do.
    """
    if box.cells > max_cells:
        x, y, right, top = write_metres(lattice.measure(box))
        raise MapError(
            f"the map would reach at least from ({x}, {y}) to ({right}, {top}) m: {box.cols} x "
            f"{box.rows} cells, more than `max_cells={max_cells}`",
            fix="if a pose is wrong, leave it out with `start_s` and `end_s`; else use a coarser "
            "`resolution`, a shorter `max_range`, or raise `max_cells`",
        )


WINDOW_CELLS = 1 << 24
"""The largest window; scans that need more are traced part by part."""
COUNTS = Tables(0.0, np.ones(1, np.int64), 1.0, 1, COUNT_BITS)
"""What stands for a model that counts: a plain cell gets a miss."""

Formula = Callable[[Float64], Float64]
"""(T,) shares in [0, 1] to (T,) probabilities of being occupied."""

SUREST = 2.0**-53
"""No probability is tabulated nearer to 0 or 1 than this: a float has none between it and 1, and
sums of log-odds fit a window's integers, whatever a model says."""


def tabulate(free: Formula, hit: Formula, depth: float) -> Tables:
    """Tabulate a radial model's probabilities, each at the middle of its step."""
    middle = np.minimum((np.arange(TABLE_STEPS + 1) + 0.5) / TABLE_STEPS, 1)
    tables = []
    for formula in (free, hit):
        p = np.clip(formula(middle), SUREST, 1 - SUREST)
        tables.append(np.rint(np.log(p / (1 - p)) / LOG_ODDS_UNIT).astype(np.int64))
    largest = max(int(np.abs(table).max()) for table in tables)
    # A cell's sum of log-odds and number of observations, its sign apart, share 63 bits.
    bits = (63 - largest.bit_length()) // 2
    entries = np.append((np.concatenate(tables) << bits) + 1, 0)
    constant = int(np.argmax(np.append(entries[:TABLE_STEPS], 0) != entries[0]))
    plain = float(np.sqrt(constant / TABLE_STEPS))
    return Tables(depth, entries, plain, largest, bits)


def find_unit(update: str) -> int:
    """What a beam, scan or cloud weighs at most in a cell; raises ValueError if it is unknown."""
    return {Update.SURFACE: BEAM_WEIGHT, Update.CLOUD: NEAR_WEIGHT}.get(Update(update), 1)


@dataclass(frozen=True)
class GridSpec:
    """How rays become evidence."""

    update: Update
    lattice: Lattice
    jump: float = 0.1
    """Neighbours see the same surface if their ranges differ by at most this (m) or, in the surface
    update, by a tenth of the nearer range; the beam update has no neighbours"""
    border_gap: int = 8
    """The border of a surface is closed over at most so many cells (polygon)"""
    hit_offset: float = 0.0
    """Cells by which a hit lies behind the measured point: that is on a surface, not in it"""
    radial: Tables | None = None
    """None: hits and misses are counted"""

    @property
    def tables(self) -> Tables:
        """What a beam adds to a cell."""
        return COUNTS if self.radial is None else self.radial

    @property
    def unit(self) -> int:
        """What one beam, or one scan, weighs in the numbers of a cell."""
        return find_unit(self.update)

    @property
    def kind(self) -> EvidenceKind:
        """What the two numbers of a cell are."""
        return EvidenceKind.COUNTS if self.radial is None else EvidenceKind.LOG_ODDS


BITS = (2, TILE, TILE // 8)
"""Bytes of hit and seen cells of a tile, row by row, in the order of `np.packbits`"""
BLOCK = 4096
"""Tiles that are unpacked at the same time, 1 KiB each"""


def pack_bits(tiles: Int64, numbers: Int64, bits: UInt8) -> Slices:
    """Pack the bits (K, 2, 64, 8) of tiles (K, 2) in slices (K,)."""
    changes = bits.copy()
    changes[:, :, 1:] ^= bits[:, :, :-1]
    rows = changes.reshape(-1, BITS[-1])
    parts = np.packbits(rows != 0, axis=1)[:, 0]
    there = np.packbits((parts != 0).reshape(-1, BITS[0] * TILE), axis=1)
    return Slices(tiles, numbers, there, parts[parts != 0], rows[rows != 0])


def unpack_bits(slices: Slices) -> UInt8:
    """(K, 2, 64, 8) bits of each tile's hit and seen cells."""
    parts = np.zeros(slices.rows.size * 8, np.uint8)
    parts[np.unpackbits(slices.rows).view(np.bool_)] = slices.parts
    changes = np.zeros(parts.size * 8, np.uint8)
    changes[np.unpackbits(parts).view(np.bool_)] = slices.changes
    return np.asarray(np.bitwise_xor.accumulate(changes.reshape(-1, *BITS), axis=2))


def take_tiles(slices: Slices, which: Int64) -> Slices:
    """Some of the tiles, in the order of `which`."""
    part_edges, change_edges = find_edges(slices)
    parts = slices.parts[list_places(part_edges, which)]
    changes = slices.changes[list_places(change_edges, which)]
    return Slices(slices.tiles[which], slices.numbers[which], slices.rows[which], parts, changes)


def find_edges(slices: Slices) -> tuple[Int64, Int64]:
    """(K + 1,) where the `parts` and the `changes` of each tile begin, and where the last ends."""
    sizes = np.bitwise_count(slices.rows).sum(axis=1), np.bitwise_count(slices.parts)
    parts, changes = (np.append(0, np.cumsum(each, dtype=np.int64)) for each in sizes)
    return parts, changes[parts]


def list_places(edges: Int64, which: Int64) -> Int64:
    """Places of all items of some runs, which lie one behind the other between these edges."""
    sizes = np.diff(edges)[which]
    shift = np.repeat(edges[which] - (np.cumsum(sizes) - sizes), sizes)
    return np.asarray(shift + np.arange(len(shift)))


def unite(parts: Iterable[Slices]) -> Slices:
    """Put slices in order; a cell was hit or seen in a slice where any of the parts says so."""
    whole = Slices.join(parts)
    whole = take_tiles(whole, np.lexsort((whole.numbers, *whole.tiles.T[::-1])))
    keys = np.column_stack([whole.tiles, whole.numbers])
    is_new = np.append(True, (np.diff(keys, axis=0) != 0).any(axis=1))[: len(keys)]
    if is_new.all():
        return whole
    starts = np.flatnonzero(is_new)
    united = []
    for first in range(0, len(starts), BLOCK):
        block = starts[first : first + BLOCK]
        end = starts[first + BLOCK] if first + BLOCK < len(starts) else len(keys)
        bits = unpack_bits(take_tiles(whole, np.arange(block[0], end)))
        bits = np.bitwise_or.reduceat(bits, block - block[0], axis=0)
        united.append(pack_bits(whole.tiles[block], whole.numbers[block], bits))
    return Slices.join(united)


def split(slices: Slices, ends: Iterable[int]) -> Iterator[Slices]:
    """Cut slices behind some of their tiles, in order; the parts share their memory."""
    part_edges, change_edges = find_edges(slices)
    for begin, end in pairwise([0, *ends]):
        parts = slices.parts[part_edges[begin] : part_edges[end]]
        changes = slices.changes[change_edges[begin] : change_edges[end]]
        numbers, rows = slices.numbers[begin:end], slices.rows[begin:end]
        yield Slices(slices.tiles[begin:end], numbers, rows, parts, changes)


def split_tiles(slices: Slices) -> Iterator[tuple[Key, Slices]]:
    """What each tile has of slices that are in order."""
    new = np.flatnonzero((np.diff(slices.tiles, axis=0) != 0).any(axis=1)) + 1
    for part in split(slices, [*new.tolist(), len(slices.tiles)]):
        for row, col in part.tiles[:1].tolist():  # none where there are no slices at all
            yield (row, col), part


def find_seen(slices: Slices) -> UInt8:
    """(64, 64) of one tile: 1 where a slice saw the cell, else 0."""
    return np.unpackbits(np.bitwise_or.reduce(unpack_bits(slices)[:, 1]), axis=1)


def count_visits(slices: Slices) -> Int64:
    """(2, 64, 64) of one tile: visits that hit each cell, once or often, and visits that saw it."""
    began = np.zeros((len(slices.numbers), *BITS), np.uint8)
    nothing = np.zeros(BITS[1:], np.uint8)
    going = was_hit = nothing  # cells seen in the slice before; cells hit on the visit so far
    before = None
    of_slices = zip(began, slices.numbers.tolist(), unpack_bits(slices), strict=True)
    for begin, number, (hit, seen) in of_slices:
        if before != number - 1:
            going = was_hit = nothing
        was_hit = was_hit & seen
        begin[:] = hit & ~was_hit, seen & ~going
        going, was_hit, before = seen, was_hit | hit, number
    return np.asarray(np.unpackbits(began, axis=-1).sum(axis=0, dtype=np.int64))


def restrict(slices: Slices, grid: TileGrid) -> Slices:
    """Forget cells that a grid has no observation of."""
    kept = []
    nothing = np.zeros((2, TILE, TILE), np.int8)
    for key, of_tile in split_tiles(slices):
        still = np.packbits(grid.observed(*grid.tiles.get(key, nothing)), axis=-1)
        bits = unpack_bits(of_tile) & still
        some = bits.any(axis=(1, 2, 3))
        kept.append(pack_bits(of_tile.tiles[some], of_tile.numbers[some], bits[some]))
    return Slices.join(kept)
