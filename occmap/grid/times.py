"""When cells were observed, beside how often: first, last, and on how many visits.

Time is cut into slices of one length that begin at whole multiples of it; a run of consecutive
slices in which a cell was seen is one visit, so that two visits lie at least a slice apart. Neither
the order of scans nor which comes first makes a difference. `--pass-gap` is the length of a slice,
and `--min-passes` counts visits.
"""

from typing import TypeAlias

import numpy as np

from occmap.grid.lattice import CellBox
from occmap.grid.tiles import TILE
from occmap.types import Bool, Int32, Int64, Times, UInt64

TileKey: TypeAlias = tuple[int, int]
SliceBits: TypeAlias = dict[tuple[TileKey, int], UInt64]
"""By tile and slice of time: (2, TILE) words of bits, which cells it hit and which it saw."""

SIGN = np.uint64(1 << 63)
BITS = TILE * TILE


def encode_stamps(stamp_ns: Int64) -> UInt64:
    """(S, 2) early and late of stamps: the one falls with time, the other rises.

    So a maximum keeps the first and the last, and 0 is nothing yet.
    """
    late = stamp_ns.astype(np.uint64) ^ SIGN
    return np.stack([~late, late], axis=-1)


def decode_stamps(early: UInt64, late: UInt64) -> tuple[Int64, Int64]:
    """First and last stamp of what `encode_stamps` gave."""
    return (~early ^ SIGN).astype(np.int64), (late ^ SIGN).astype(np.int64)


class TimeGrid:
    """When the cells of a lattice were observed; it grows beside a `TileGrid`.

    Memory: 64 KiB for a tile, and 1 KiB for every slice of time in which any of it was seen. A
    robot that sees 60 tiles at a time takes 22 MiB an hour with slices of ten seconds.
    """

    def __init__(self) -> None:
        self.tiles: dict[TileKey, UInt64] = {}
        self.slice_bits: SliceBits = {}

    def add(self, box: CellBox, times: UInt64, slice_bits: SliceBits) -> None:
        """Add what a window holds.

        Parameters
        ----------
        box
            Of whole tiles.
        times
            (H, W, 2) of the box: early and late.
        slice_bits
            Bits of what each slice of time hit and saw.
        """
        for key, bits in slice_bits.items():
            known = self.slice_bits.get(key)
            self.slice_bits[key] = bits if known is None else known | bits
        for row, col in {tile for tile, _ in slice_bits}:
            part = times[row * TILE - box.row :, col * TILE - box.col :][:TILE, :TILE]
            known = self.tiles.get((row, col))
            self.tiles[row, col] = part.copy() if known is None else np.maximum(known, part)

    def read(self) -> Times:
        """Sum up when each cell was observed, and count its visits."""
        keys = sorted(self.tiles)
        slices: dict[TileKey, dict[int, UInt64]] = {key: {} for key in keys}
        for (key, slice_), bits in self.slice_bits.items():
            slices[key][slice_] = bits
        masks, stamps = [np.zeros((0, BITS), np.bool_)], [np.zeros((2, 0), np.uint64)]
        visits = [np.zeros((2, 0), np.int32)]
        for key in keys:
            seen = unpack(np.bitwise_or.reduce(list(slices[key].values()))[1])
            masks.append(seen[None])
            stamps.append(self.tiles[key].reshape(BITS, 2)[seen].T)
            visits.append(count_visits(slices[key])[:, seen])
        return Times(
            np.array(keys, np.int64).reshape(-1, 2),
            np.packbits(np.concatenate(masks), axis=1),
            *decode_stamps(*np.concatenate(stamps, axis=1)),
            *np.concatenate(visits, axis=1),
        )


def cut_bits(words: UInt64, row: int, col: int) -> dict[TileKey, UInt64]:
    """Cut bits into tiles, each (2, TILE) words; tiles without any are left out.

    Parameters
    ----------
    words
        (2, TILE x R, C) of R x C whole tiles.
    row, col
        Of the first tile.
    """
    layers, rows, cols = words.shape
    blocks = words.reshape(layers, rows // TILE, TILE, cols).transpose(1, 3, 0, 2)
    some = np.argwhere(blocks.any(axis=(2, 3))).tolist()
    return {(row + r, col + c): blocks[r, c].copy() for r, c in some}


def unpack(words: UInt64) -> Bool:
    """(..., BITS) which cells of (..., TILE) words are set, row by row."""
    flat = np.unpackbits(words.astype("<u8").view(np.uint8), axis=-1, bitorder="little")
    return flat.view(np.bool_)


def count_visits(slices: dict[int, UInt64]) -> Int32:
    """(2, BITS) visits of each cell that hit it, once or often, and visits that saw it."""
    visits = np.zeros((2, BITS), np.int32)
    nothing = np.zeros(TILE, np.uint64)
    going = was_hit = nothing  # visits that the slice before was of; those of them that hit so far
    for slice_ in sorted(slices):
        if slice_ - 1 not in slices:
            going = was_hit = nothing
        hit, seen = slices[slice_]
        was_hit = was_hit & seen
        visits += unpack(np.stack([hit & ~was_hit, seen & ~going]))
        going, was_hit = seen, was_hit | hit
    return visits
