"""Slices of time: which cells each of them hit and saw, and the visits that this makes.

A visit of a cell is a run of consecutive slices in which it was seen. Slices are what is kept,
since they merge: what is in either of two parts is in the whole, at a seam between them, too. This
module does not load numba.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from occmap.cells import Slices
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid, stack_tiles
from occmap.types import Int64, UInt8

BITS = (2, TILE, TILE // 8)
"""Bytes of hit and seen cells of a tile, row by row, in the order of `np.packbits`"""
BLOCK = 4096
"""Tiles that are unpacked at the same time, 1 KiB each"""


def mark_observed(grid: TileGrid, number: int) -> Slices:
    """Mark what was hit and seen in slice `number`; `grid` is the evidence of that slice."""
    tiles, cells = stack_tiles(grid.tiles)
    bits = np.packbits(cells != 0, axis=-1)
    if grid.kind is EvidenceKind.COUNTS:
        bits[:, 1] |= bits[:, 0]
    else:
        bits[:, 0] = 0  # the sum of log-odds, which says nothing of hits
    return pack(tiles, np.full(len(tiles), number), bits)


def pack(tiles: Int64, numbers: Int64, bits: UInt8) -> Slices:
    """Pack the bits (K, 2, 64, 8) of tiles (K, 2) in slices (K,)."""
    changes = bits.copy()
    changes[:, :, 1:] ^= bits[:, :, :-1]
    rows = changes.reshape(-1, BITS[-1])
    parts = np.packbits(rows != 0, axis=1)[:, 0]
    there = np.packbits((parts != 0).reshape(-1, BITS[0] * TILE), axis=1)
    return Slices(tiles, numbers, there, parts[parts != 0], rows[rows != 0])


def unpack(slices: Slices) -> UInt8:
    """(K, 2, 64, 8) bits of each tile's hit and seen cells."""
    parts = np.zeros(slices.rows.size * 8, np.uint8)
    parts[np.unpackbits(slices.rows).view(np.bool_)] = slices.parts
    changes = np.zeros(parts.size * 8, np.uint8)
    changes[np.unpackbits(parts).view(np.bool_)] = slices.changes
    return np.asarray(np.bitwise_xor.accumulate(changes.reshape(-1, *BITS), axis=2))


def take(slices: Slices, which: Int64) -> Slices:
    """Some of the tiles, in the order of `which`."""
    part_sizes, change_sizes = measure(slices)
    return Slices(
        slices.tiles[which],
        slices.numbers[which],
        slices.rows[which],
        slices.parts[spread(part_sizes, which)],
        slices.changes[spread(change_sizes, which)],
    )


def measure(slices: Slices) -> tuple[Int64, Int64]:
    """(K,) how many `parts` and (K,) how many `changes` each tile has."""
    part_sizes = np.bitwise_count(slices.rows).sum(axis=1, dtype=np.int64)
    ends = np.cumsum(part_sizes)
    change_ends = np.append(0, np.cumsum(np.bitwise_count(slices.parts), dtype=np.int64))
    return part_sizes, change_ends[ends] - change_ends[ends - part_sizes]


def spread(sizes: Int64, which: Int64) -> Int64:
    """Places of all items of some runs; the runs, of these sizes, lie one behind the other."""
    starts, wanted = (np.cumsum(sizes) - sizes)[which], sizes[which]
    shift = np.repeat(starts - (np.cumsum(wanted) - wanted), wanted)
    return np.asarray(shift + np.arange(len(shift)))


def unite(parts: Iterable[Slices]) -> Slices:
    """Put slices in order; a cell was hit or seen in a slice where any of the parts says so."""
    whole = Slices.join(parts)
    whole = take(whole, np.lexsort((whole.numbers, *whole.tiles.T[::-1])))
    keys = np.column_stack([whole.tiles, whole.numbers])
    is_new = np.append(True, (np.diff(keys, axis=0) != 0).any(axis=1))[: len(keys)]
    if is_new.all():
        return whole
    starts = np.flatnonzero(is_new)
    united = []
    for first in range(0, len(starts), BLOCK):
        block = starts[first : first + BLOCK]
        end = starts[first + BLOCK] if first + BLOCK < len(starts) else len(keys)
        bits = unpack(take(whole, np.arange(block[0], end)))
        bits = np.bitwise_or.reduceat(bits, block - block[0], axis=0)
        united.append(pack(whole.tiles[block], whole.numbers[block], bits))
    return Slices.join(united)


def split_tiles(slices: Slices) -> Iterator[tuple[tuple[int, int], Slices]]:
    """What each tile has of slices that are in order."""
    part_sizes, change_sizes = measure(slices)
    part_ends, change_ends = (np.append(0, np.cumsum(s)) for s in (part_sizes, change_sizes))
    new = np.flatnonzero((np.diff(slices.tiles, axis=0) != 0).any(axis=1)) + 1
    for begin, end in pairwise([0, *new.tolist(), len(slices.tiles)]):
        if begin < end:
            row, col = slices.tiles[begin].tolist()
            parts = slices.parts[part_ends[begin] : part_ends[end]]
            changes = slices.changes[change_ends[begin] : change_ends[end]]
            numbers, rows = slices.numbers[begin:end], slices.rows[begin:end]
            yield (row, col), Slices(slices.tiles[begin:end], numbers, rows, parts, changes)


def count_visits(slices: Slices) -> Int64:
    """(2, 64, 64) of one tile: visits that hit each cell, once or often, and visits that saw it."""
    began = np.zeros((len(slices.numbers), *BITS), np.uint8)
    nothing = np.zeros(BITS[1:], np.uint8)
    going = was_hit = nothing  # cells seen in the slice before; cells hit on the visit so far
    before = None
    of_slices = zip(began, slices.numbers.tolist(), unpack(slices), strict=True)
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
    nothing = np.zeros((TILE, TILE), np.bool_)
    for key, of_tile in split_tiles(slices):
        tile = grid.tiles.get(key)
        still = np.packbits(nothing if tile is None else grid.observed(*tile), axis=-1)
        bits = unpack(of_tile) & still
        some = bits.any(axis=(1, 2, 3))
        kept.append(pack(of_tile.tiles[some], of_tile.numbers[some], bits[some]))
    return Slices.join(kept)
