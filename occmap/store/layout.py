"""Where things lie in the folder of a store, and how they are compressed; the owner of zarr.

| in the folder | holds |
|---|---|
| `zarr.json` | the manifest, and what makes the store whole: it is written last |
| `hits`, `misses` | or `log_odds`, `observations`: (H, W) int64, the two numbers of each cell |
| `y`, `x` | (H,) and (W,) float64, the middle of each row and column (m) |
| `slices/R.C` | of block (R, C), when its cells were observed: arrays of bytes end to end |
| `classes/N` | uint8, 0 unknown, 1 free, 2 occupied, for squares of N x N cells |
| `blocks` | the table of blocks |
"""

import json
from dataclasses import asdict
from hashlib import sha256
from typing import Any

from occmap.cells import Manifest
from occmap.grid.tiles import EvidenceKind
from occmap.plugins import need_extra
from occmap.store.blocks import BLOCK, Block

FORMAT, VERSION = "occmap store", 1
CHUNK = 256
"""Cells along the side of what is read at once; with 64, reading takes seven times as long"""
LAYERS = {
    EvidenceKind.COUNTS: ("hits", "misses"),
    EvidenceKind.LOG_ODDS: ("log_odds", "observations"),
}
"""Names of the two arrays of numbers"""
FINE_LEVELS = (1, 4)
"""Sides of the squares of cells in those pictures of which a block is a whole shard"""
OVERVIEW = 16
"""There is always a picture of squares with this side, as that of a city is read at once"""
LEVEL_CELLS = 1024
"""The longest side of the coarsest picture, and the side of a shard of several blocks (pixels)"""


def import_zarr() -> Any:
    """Load zarr, late: it is an extra, and takes 0.4 s.

    Raises
    ------
    UsageError
        It is not installed.
    """
    with need_extra("dask", "a store needs zarr"):
        import zarr  # noqa: PLC0415  as above
    return zarr


def make_head(manifest: Manifest, offset: tuple[int, int]) -> dict[str, Any]:
    """Make what the attributes of a store say of it."""
    head = {"format": FORMAT, "version": VERSION, "block": BLOCK, "offset": list(offset)}
    plain: dict[str, Any] = json.loads(json.dumps({**head, **asdict(manifest)}, allow_nan=False))
    return plain


def compute_checksum(head: dict[str, Any]) -> str:
    """SHA-256 over all that the attributes say, but the checksum itself."""
    said = {name: value for name, value in head.items() if name != "checksum"}
    return sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def find_place(block: Block, offset: tuple[int, int], side: int = 1) -> tuple[slice, slice]:
    """Rows and columns of a block in an array, of which an item is a square of so many cells."""
    starts = [(at * BLOCK - first) // side for at, first in zip(block, offset, strict=True)]
    row, col = (slice(start, start + BLOCK // side) for start in starts)
    return row, col
