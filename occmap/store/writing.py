"""The writer of stores, whose names end in `.zarr`: made, written block by block, finished."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occmap import store
from occmap.cells import CellBox, Evidence, Ground, Manifest, OccupancyMap, keep_largest, sum_tiles
from occmap.evidence import paint_box, to_grid
from occmap.evidence.manifest import MEANING, list_inputs
from occmap.grid.tiles import TILE, TileGrid, find_unit
from occmap.sensor.models import parse_model
from occmap.store import BLOCK, FORMAT, LAYERS, TABLE, VERSION, Block, Blocks
from occmap.writers import Product, WriteOptions, Writer
from occmap.writers.atomic import make_folder, refuse_unwritable
from occmap.writers.npz import compute_checksum, pack_ground, pack_slices

CHUNK = 256
"""Cells along the side of what is read at once; with 64, reading takes seven times as long"""
FINE_LEVELS = (1, 4)
"""Sides of the squares of cells in those pictures of which a block is a whole shard"""
OVERVIEW = 16
"""There is always a picture of squares with this side, as that of a city is read at once"""
LEVEL_CELLS = 1024
"""The longest side of the coarsest picture, and the side of a shard of several blocks (pixels)"""


class BlockRecord(NamedTuple):
    """What the table of a store says of a block."""

    block: Block
    cells: int
    """How many were observed"""
    reach: CellBox
    """The smallest box around them"""
    sha256: str
    """Digest of what was observed, however it is compressed"""
    builds: tuple[int, ...]
    """Which builds observed something"""
    total: int
    """`sum_tiles` of its tiles"""


def locate_block(block: Block, offset: tuple[int, int], side: int = 1) -> tuple[slice, slice]:
    """Rows and columns of a block in an array, of which an item is a square of so many cells."""
    row, col = offset
    return block.box.move(-row, -col).shrink(side).slices


def make_head(manifest: Manifest, offset: tuple[int, int]) -> dict[str, Any]:
    """Make what the attributes of a store say of it."""
    head = {"format": FORMAT, "version": VERSION, "block": BLOCK, "offset": list(offset)}
    return dict(json.loads(json.dumps(head | asdict(manifest), allow_nan=False)))


def make_table(records: Sequence[BlockRecord], manifest: Manifest) -> dict[str, Any]:
    """Arrays of what is known of each block, N in all, and of which logs may have observed it."""
    counts = [len(list_inputs(build)) for build in manifest.builds]
    build_of_log = np.repeat(np.arange(len(counts)), counts)
    logs = np.array([np.isin(build_of_log, record.builds) for record in records], np.bool_)
    digests = b"".join(bytes.fromhex(record.sha256) for record in records)
    columns = (
        np.array([record.block for record in records], np.int64).reshape(-1, 2),
        np.array([record.cells for record in records], np.int64),
        np.array([record.reach for record in records], np.int64).reshape(-1, 4),
        np.frombuffer(digests, np.uint8).reshape(-1, 32),
        np.packbits(logs.reshape(len(records), len(build_of_log)), axis=1),
    )
    return dict(zip(TABLE, columns, strict=True))


def compute_digest(manifest: Manifest, blocks: Mapping[Block, str]) -> str:
    """SHA-256 of all that was observed, from those of the blocks: equal for equal evidence.

    It says nothing of how the evidence is cut, compressed or kept, nor of who observed it.
    """
    meaning = {name: getattr(manifest, name) for name in MEANING}
    lines = [json.dumps(meaning), *(f"{key.row} {key.col} {blocks[key]}" for key in sorted(blocks))]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def create_store(path: Path, plan: Manifest, blocks: Iterable[Block]) -> None:
    """Create a store that nothing was written to yet; nobody opens it before it is finished.

    Parameters
    ----------
    path
        A folder that does not exist, as `make_folder` gives it.
    plan
        What the evidence is; its `builds` may be added later.
    blocks
        Those that will be written: the arrays reach around all of them.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    zarr = store.import_zarr()
    box, side = CellBox.enclose(list(blocks) or [Block(0, 0)]).scale(BLOCK), BLOCK
    while max(box.shape) > side * LEVEL_CELLS:  # so that coarser pictures lie on a lattice, too
        side *= 4
        box = box.align(side)
    unit = find_unit(plan.update)
    with refuse_unwritable(path):
        root = zarr.create_group(path, attributes={"occmap": make_head(plan, box[:2])})
        for name in LAYERS[plan.kind]:
            meaning = {"of_one_observation": unit}
            add_picture(root, name, box.shape, BLOCK, dtype=np.int64, attributes=meaning)
        for name, first, size in zip("yx", box[:2], box.shape, strict=True):
            middle = (first + np.arange(size) + 0.5) * plan.resolution
            add_list(root, name, np.round(middle, 12), {"units": "m"})
        root.create_group("slices")
        classes = root.create_group("classes")
        for side in FINE_LEVELS:
            add_level(classes, side, box.shape, BLOCK // side)


def make_codec() -> Any:
    """Make what compresses all arrays."""
    return store.import_zarr().codecs.BloscCodec(cname="zstd", clevel=5, shuffle="shuffle")


def add_picture(group: Any, name: str, shape: tuple[int, ...], side: int, **others: Any) -> Any:
    """Add an array of squares, each a whole shard, with so many cells along the side."""
    cut = {"chunks": (min(CHUNK, side),) * 2, "shards": (side,) * 2}
    kept = {"compressors": make_codec(), "fill_value": 0, "dimension_names": ("y", "x")}
    return group.create_array(name, shape=shape, **cut, **kept, **others)


def add_level(classes: Any, side: int, shape: tuple[int, ...], shard: int) -> Any:
    """Add a picture of a store of this shape, in which each pixel is a square of cells."""
    meaning = {"cells": side, "flag_values": [0, 1, 2], "flag_meanings": "unknown free occupied"}
    size = tuple(-(-length // side) for length in shape)
    return add_picture(classes, str(side), size, shard, dtype=np.uint8, attributes=meaning)


def add_list(group: Any, name: str, values: Any, attributes: dict[str, Any]) -> None:
    """Add an array that is written at once; if it was begun before, by a task that died, go on."""
    array = group.require_array(
        name,
        shape=values.shape,
        dtype=values.dtype,
        chunks=tuple(max(1, min(length, 1 << 20)) for length in values.shape),
        compressors=make_codec(),
        dimension_names=[name] if name in ("y", "x") else None,
        attributes=attributes,
    )
    array[...] = values


@contextmanager
def edit_store(path: Path) -> Iterator[Any]:
    """Open the group of a store to write to it; raises OutputError where that fails."""
    zarr = store.import_zarr()
    with refuse_unwritable(path):
        yield zarr.open_group(path, mode="r+")


def write_block(path: Path, block: Block, content: Evidence) -> BlockRecord:
    """Write all that was observed in a block, which nobody else writes at the same time.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    builds, numbers = store.list_observing_builds(content), to_grid(content).gather(block.box)
    packed = pack_slices([content.slices[build] for build in builds])
    data, arrays = store.pack_arrays({"builds": np.array(builds, "<i8"), **packed})
    with edit_store(path) as root:
        head = root.attrs["occmap"]
        place = locate_block(block, head["offset"])
        for name, layer in zip(LAYERS[head["kind"]], numbers, strict=True):
            root[name][place] = layer
        add_list(root["slices"], f"{block.row}.{block.col}", data, {"arrays": arrays})
    seen, corner = (numbers != 0).any(axis=0), block.box[:2]
    # Of a block where nothing was observed, an empty box at its corner.
    reach = CellBox.around(seen, *corner) or CellBox(*corner, *corner)
    digest, total = store.hash_content(content), sum_tiles(content.tiles)
    return BlockRecord(block, int(np.count_nonzero(seen)), reach, digest, builds, total)


def paint_block(path: Path, block: Block, keep: bool = True) -> tuple[TileGrid, OccupancyMap]:
    """Paint a block as the store's own model sees it, as soon as those around it are written, too.

    Parameters
    ----------
    keep
        Whether the pictures of it in the store are painted, too: not of one that was not written.

    Raises
    ------
    OutputError
        They cannot be written.
    """
    with edit_store(path) as root:
        head = root.attrs["occmap"]
        tiles = store.read_box(root, block.box.grow(TILE))
        grid = to_grid(Evidence(Manifest.from_json(head), tiles))
        made = paint_box(grid, parse_model(head["model"]), block.box)
        for side in FINE_LEVELS if keep else ():
            place = locate_block(block, head["offset"], side)
            root["classes"][str(side)][place] = keep_largest(made.classes, side)
    return grid, made


def finish_store(
    path: Path, manifest: Manifest, records: Iterable[BlockRecord], ground: Ground | None = None
) -> None:
    """Write the table and, last, what makes the store whole, when all is painted.

    Parameters
    ----------
    manifest
        With all builds.
    records
        What `write_block` said of each block; those in which nothing is left are passed over.
    ground
        What clouds were traced over.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    known = sorted(record for record in records if record.cells)
    table, below = make_table(known, manifest), pack_ground(ground)
    with edit_store(path) as root:
        head = make_head(manifest, root.attrs["occmap"]["offset"])
        row, col = head["offset"]
        add_coarse_levels(root, [record.block.box.move(-row, -col) for record in known])
        blocks = root.require_group("blocks")
        for name, values in table.items():
            add_list(blocks, name, values, {})
        for name, values in below.items():  # not beside y and x: xarray asks for their dimensions
            add_list(root.require_group("ground"), name, values, {})
        digests = {record.block: record.sha256 for record in known}
        head |= {
            "digest": compute_digest(manifest, digests),
            "evidence": manifest.identify(sum(record.total for record in known)),
            "table": store.hash_table(table | below),
        }
        head["complete"] = True
        root.attrs["occmap"] = {**head, "checksum": compute_checksum(head, {})}


def add_coarse_levels(root: Any, boxes: Sequence[CellBox]) -> None:
    """Paint the pictures that several blocks share, each from the one before.

    Parameters
    ----------
    boxes
        Where the blocks lie in the arrays of the store.
    """
    side, classes = FINE_LEVELS[-1], root["classes"]
    shape = classes[str(FINE_LEVELS[0])].shape
    while side < OVERVIEW or max(shape) > side * LEVEL_CELLS:
        finer, side = classes[str(side)], side * 4
        level = add_level(classes, side, shape, LEVEL_CELLS)
        reach = LEVEL_CELLS * side
        for row, col in sorted({(box.row // reach, box.col // reach) for box in boxes}):
            shard = CellBox.at(row, col).scale(LEVEL_CELLS)
            level[shard.slices] = keep_largest(finer[shard.scale(4).slices], 4)


class ZarrWriter(Writer):
    """What was observed, as a Zarr folder that is read part by part."""

    description = "evidence as a Zarr folder, for maps of a city; it does all that an .npz does"
    needs_evidence = in_parts = is_folder = True
    needs = "dask", "zarr"

    def owns(self, path: Path) -> bool:
        """Whether a folder is one that this writer made."""
        return (path / "zarr.json").is_file() and (path / "slices").is_dir()

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> None:
        """Write the evidence block by block."""
        self.write_blocks(path, product.blocks or Blocks.of(product.evidence()))

    def write_blocks(self, path: Path, source: Blocks) -> None:
        """Write evidence block by block.

        Raises
        ------
        OccmapError
            A block cannot be read, or the store cannot be written; then nothing is left behind.
        """
        with make_folder(path) as folder:
            create_store(folder, source.manifest, source.blocks)
            records = [write_block(folder, each, source.read_block(each)) for each in source.blocks]
            for block in source.blocks:
                paint_block(folder, block)
            finish_store(folder, source.manifest, records, source.ground)
