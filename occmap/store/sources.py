"""What is read block by block: a store, evidence in memory, sums and differences of both."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Protocol, TypeAlias

import numpy as np

from occmap.arrays import Int64
from occmap.cells import Evidence, Manifest
from occmap.evidence import Described
from occmap.evidence.manifest import list_inputs
from occmap.grid.lattice import CellBox
from occmap.grid.slices import take
from occmap.grid.tiles import TILE
from occmap.store.blocks import (
    NO_CONTENT,
    Block,
    BlockContent,
    join_contents,
    list_blocks,
    list_observing_logs,
    split_evidence,
)
from occmap.store.reading import Store, open_store
from occmap.writers.npz import read_evidence


class Blocks(Described, Protocol):
    """Evidence that is read block by block."""

    @property
    def blocks(self) -> Collection[Block]:
        """All blocks that anything was observed in."""

    def read_block(self, block: Block) -> BlockContent:
        """What was observed in one of the blocks."""


Saved: TypeAlias = Evidence | Blocks


def open_saved(path: Path) -> Evidence | Store:
    """Read an evidence file, or open a store.

    Raises
    ------
    UsageError
        It is a store, and zarr is not installed.
    MapError
        It is missing, damaged, or no evidence.
    """
    if path.is_dir() or path.suffix.lower() == ".zarr":
        return open_store(path)
    return read_evidence(path)


def as_blocks(saved: Saved) -> Blocks:
    """Cut evidence into blocks, where it is not yet."""
    if isinstance(saved, Evidence):
        return Held(saved.manifest, saved.where, dict(split_evidence(saved)))
    return saved


def read_all(saved: Saved) -> Evidence:
    """Read all blocks at once."""
    if isinstance(saved, Evidence):
        return saved
    contents = map(saved.read_block, saved.blocks)
    return join_contents(contents, saved.manifest, saved.where)


def read_part(
    saved: Saved, box: CellBox, read_block: Callable[[Block], BlockContent] | None = None
) -> Evidence:
    """Read the tiles that lie in a box of cells or beside it; of evidence in memory, all.

    Parameters
    ----------
    read_block
        Takes the place of the evidence's own.
    """
    if isinstance(saved, Evidence):
        return saved
    read = read_block or saved.read_block
    near = box.align(TILE).grow(TILE)
    contents = (read(block) for block in list_blocks(near) if block in saved.blocks)
    cut = (cut_content(content, near.shrink(TILE)) for content in contents)
    return join_contents(cut, saved.manifest, saved.where)


def cut_content(content: BlockContent, box: CellBox) -> BlockContent:
    """Keep the tiles in a box, which counts tiles."""

    def find(tiles: Int64) -> Int64:
        return np.flatnonzero(((tiles >= box[:2]) & (tiles < box[2:])).all(axis=1))

    which = find(content.tiles)
    slices = tuple(take(layer, find(layer.tiles)) for layer in content.slices)
    return BlockContent(content.tiles[which], content.cells[which], slices, content.logs)


@dataclass(frozen=True, eq=False)
class Held:
    """Evidence in memory; all logs of a build are said to have observed its blocks."""

    manifest: Manifest
    where: str
    blocks: dict[Block, BlockContent]
    """All of it"""

    def read_block(self, block: Block) -> BlockContent:
        """What was observed in a block."""
        return self.blocks[block]


@dataclass(frozen=True, eq=False)
class Combined:
    """Evidence added up or taken apart, a block only when it is read."""

    parts: tuple[Blocks, ...]
    combine: Callable[[Sequence[Evidence]], Evidence]
    """Makes one evidence of all parts, which may be empty"""
    manifest: Manifest
    blocks: Collection[Block]
    """Those of all parts, in ascending order"""
    where: str = ""

    def read_block(self, block: Block) -> BlockContent:
        """What is in a block of the sum or the difference."""
        contents = [
            part.read_block(block) if block in part.blocks else NO_CONTENT for part in self.parts
        ]
        pairs = zip(self.parts, contents, strict=True)
        parts = [join_contents([content], part.manifest, part.where) for part, content in pairs]
        made = self.combine(parts)
        if len(self.manifest.builds) < sum(len(each.manifest.builds) for each in self.parts):
            logs = list_observing_logs(self.manifest, made.slices)
        else:
            starts = accumulate((count_logs(each.manifest) for each in self.parts), initial=0)
            shifts = zip(starts, contents, strict=False)
            logs = tuple(start + log for start, content in shifts for log in content.logs)
        return BlockContent(made.tiles, made.cells, made.slices, logs)


def count_logs(manifest: Manifest) -> int:
    """How many logs all builds have."""
    return sum(len(list_inputs(build)) for build in manifest.builds)
