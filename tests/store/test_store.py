"""Stores: what is read is what was written, whoever wrote which block, and nothing else is read."""

import json
import shutil
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from occmap import store
from occmap.cells import CellClass, Evidence, Manifest
from occmap.errors import MapError
from occmap.grid.tiles import TILE, pack_bits
from occmap.store import Block, Blocks, open_store, read_all, split_evidence
from occmap.store.painting import RenderOptions, render_saved
from occmap.store.writing import ZarrWriter, create_store, finish_store, paint_block, write_block
from occmap.types import BEAM_UPDATES, UInt8, Update
from tests.evidence.saving import choose, save, write_bytes
from tests.grid.scans import are_equal
from tests.store.conftest import shrink_blocks

SIDE_M = 0.05
"""Metres: the drive then reaches over four blocks, on both sides of zero"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    options = replace(choose(Update.SURFACE, "counting"), resolution=SIDE_M)
    return save(tmp_path_factory.mktemp("drive") / "m.npz", options)


@pytest.fixture(scope="module")
def kept(drive: Evidence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kept") / "m.zarr"
    ZarrWriter().write_blocks(path, Blocks.of(drive))
    return path


def open_group(path: Path) -> Any:
    """Open it as others do."""
    return zarr.open_group(path, mode="r")


def find_offset(store: Blocks) -> Any:
    return np.array(store.root.attrs["occmap"]["offset"])


@pytest.fixture
def path(kept: Path, tmp_path: Path) -> Path:
    """A store that may be damaged."""
    copy = tmp_path / "m.zarr"
    shutil.copytree(kept, copy)
    return copy


def test_the_drive_reaches_over_blocks_on_both_sides_of_zero(kept: Path) -> None:
    blocks = list(open_store(kept).blocks)
    assert blocks == [(-1, -1), (-1, 0), (0, -1), (0, 0)]


ALL_OF_EACH = list(zip(BEAM_UPDATES, ("counting", "quadratic", "simple"), strict=True))
"""Every update and every model; what a store keeps of them does not depend on both"""


@pytest.mark.parametrize(("update", "model"), ALL_OF_EACH)
def test_an_npz_that_is_written_from_a_store_is_that_of_the_build(
    tmp_path: Path, update: Update, model: str
) -> None:
    evidence = save(tmp_path / "m.npz", replace(choose(update, model), resolution=SIDE_M))
    ZarrWriter().write_blocks(tmp_path / "m.zarr", Blocks.of(evidence))
    store = open_store(tmp_path / "m.zarr")
    assert write_bytes(tmp_path, read_all(store)) == (tmp_path / "m.npz").read_bytes()
    assert read_digest(store) == digest_evidence(evidence)


def read_digest(store: Blocks) -> str:
    """What a store says of all that was observed."""
    return str(store.root.attrs["occmap"]["digest"])


def digest_evidence(evidence: Evidence) -> str:
    """The digest that a store of this evidence has."""
    blocks = {key: store.hash_content(content) for key, content in split_evidence(evidence)}
    return store.writing.compute_digest(evidence.manifest, blocks)


def test_the_same_numbers_in_a_map_that_is_turned_are_another_digest(drive: Evidence) -> None:
    turned = replace(drive, manifest=replace(drive.manifest, align=10.0))
    assert digest_evidence(turned) != digest_evidence(drive)


def test_zarr_alone_reads_numbers_at_their_places(kept: Path, drive: Evidence) -> None:
    root = open_group(kept)
    assert [root[name].metadata.dimension_names for name in ("hits", "x")] == [("y", "x"), ("x",)]
    row, col = root.attrs["occmap"]["offset"]
    assert row < 0
    assert root["y"][0] == pytest.approx((row + 0.5) * SIDE_M)
    keys = sorted(drive.tiles)
    for key in (keys[0], keys[len(keys) // 2], keys[-1]):
        tile = key[0] * TILE - row, key[1] * TILE - col
        rows, cols = (slice(at, at + TILE) for at in tile)
        assert np.array_equal(root["hits"][rows, cols], drive.tiles[key][0])
        assert np.array_equal(root["misses"][rows, cols], drive.tiles[key][1])
    assert root["hits"][:].sum() == sum(tile[0].sum() for tile in drive.tiles.values())


def test_the_pictures_show_the_map(kept: Path, drive: Evidence) -> None:
    store, classes = open_store(kept), open_group(kept / "classes")
    shown = render_saved(Blocks.of(drive), RenderOptions(choose(model="counting").model)).grid
    (row, col), (rows, cols) = (shown.box[:2] - find_offset(store), shown.shape)
    whole = np.zeros(classes["1"].shape, np.uint8)
    whole[row : row + rows, col : col + cols] = shown.classes
    assert np.array_equal(classes["1"][:], whole)
    assert set(np.unique(whole)) == set(CellClass)
    for side in (4, 16):
        assert np.array_equal(classes[str(side)][:], shrink(whole, side))


def shrink(classes: UInt8, side: int) -> UInt8:
    height, width = (-(-length // side) for length in classes.shape)
    small = np.zeros((height, width), np.uint8)
    for row, col in np.ndindex(small.shape):
        square = classes[row * side : (row + 1) * side, col * side : (col + 1) * side]
        small[row, col] = square.max()
    return small


def test_coarse_pictures_of_a_store_of_blocks_far_apart(tmp_path: Path, drive: Evidence) -> None:
    path, far = tmp_path / "m.zarr", round(100_000 / 0.05 / store.BLOCK)
    tile = next(iter(drive.tiles.values()))
    blocks = [Block(-far, -far), Block(far, far - 3)]
    tiles = {(block.row * store.SIDE + 1, block.col * store.SIDE + 3): tile for block in blocks}
    bits = np.packbits([tile != 0] * 2, axis=-1)
    bits[:, 1] |= bits[:, 0]
    slices = pack_bits(np.array(list(tiles)), np.array([3, 4]), bits)
    evidence = replace(drive, tiles=tiles, slices=(slices,))
    contents = dict(split_evidence(evidence))
    assert list(contents) == blocks
    create_store(path, drive.manifest, contents)
    records = [write_block(path, *each) for each in contents.items()]
    for block in contents:
        paint_block(path, block)
    finish_store(path, drive.manifest, records)
    classes, saved = open_group(path / "classes"), open_store(path)
    assert sorted(classes.array_keys(), key=int) == ["1", "4", "16", "64", "256", "1024", "4096"]
    coarse = classes["4096"]
    rows, cols = np.nonzero(coarse[:])
    expected = {tuple((np.array(key) * TILE - find_offset(saved)) // 4096) for key in tiles}
    assert set(zip(rows.tolist(), cols.tolist(), strict=True)) == expected
    assert are_equal(read_all(saved).tiles, tiles)


def test_the_table_says_what_is_where_and_who_saw_it(kept: Path, drive: Evidence) -> None:
    table, contents = open_group(kept / "blocks"), dict(split_evidence(drive))
    assert [tuple(place) for place in table["place"][:]] == list(contents)
    assert table["logs"][:].tolist() == [[0b10000000]] * len(contents)  # one log, which saw all
    for content, count, reach in zip(
        contents.values(), table["cells"][:], table["reach"][:].tolist(), strict=True
    ):
        seen = {key: np.argwhere(tile.any(axis=0)) for key, tile in content.tiles.items()}
        cells = np.concatenate([np.array(key) * TILE + places for key, places in seen.items()])
        assert count == len(cells)
        assert reach == [*cells.min(axis=0), *(cells.max(axis=0) + 1)]


def test_processes_write_blocks_at_once_and_a_task_may_run_twice(
    tmp_path: Path, drive: Evidence, kept: Path
) -> None:
    path, contents = tmp_path / "m.zarr", dict(split_evidence(drive))
    create_store(path, replace(drive.manifest, builds=()), contents)
    twice, patch = [*contents, *contents], pytest.MonkeyPatch()
    with ProcessPoolExecutor(2, get_context("spawn"), shrink_blocks, (patch,)) as pool:
        done = pool.map(write_block, repeat(path), twice, [contents[each] for each in twice])
        records = set(done)
        assert len(records) == len(contents)

        list(pool.map(paint_block, repeat(path), [*contents, *contents]))
    finish_store(path, drive.manifest, records)
    assert read_digest(open_store(path)) == read_digest(open_store(kept))
    assert write_bytes(tmp_path, read_all(open_store(path))) == write_bytes(tmp_path, drive)


def test_a_store_that_is_not_finished_is_refused(tmp_path: Path, drive: Evidence) -> None:
    path, contents = tmp_path / "m.zarr", dict(split_evidence(drive))
    create_store(path, drive.manifest, contents)
    for each in contents.items():
        write_block(path, *each)
        assert "is not complete" in refuse(path)
    for block in contents:
        paint_block(path, block)
    assert "is not complete" in refuse(path)


def refuse(path: Path) -> str:
    """Return the one line that a store is refused with."""
    with pytest.raises(MapError) as caught:
        read_all(open_store(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_no_store_is_refused(tmp_path: Path) -> None:
    assert "no such folder" in refuse(tmp_path / "m.zarr")
    assert "is not a store" in refuse(tmp_path)
    zarr.create_group(tmp_path / "other.zarr", attributes={"a": 1})
    assert "not evidence of occmap" in refuse(tmp_path / "other.zarr")


def list_files(folder: Path) -> dict[str, bytes]:
    """All that is in a folder and those below it."""
    files = sorted(filter(Path.is_file, folder.rglob("*")))
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def list_read(path: Path) -> list[Path]:
    """Files that evidence is read from: one shard, one list, and the table with its metadata."""
    blocks, (hits, *_) = (list_files(path / part) for part in ("blocks/sha256", "hits/c"))
    names = [f"hits/c/{hits}", "hits/zarr.json", "slices/-1.0/c/0", "slices/-1.0/zarr.json"]
    return [path / name for name in (*names, *(f"blocks/sha256/{each}" for each in blocks))]


def test_every_file_that_is_missing_cut_or_altered_is_refused(path: Path) -> None:
    for file in list_read(path):
        whole = file.read_bytes()
        file.unlink()
        refuse(path)
        wrong = [whole[: int(part * len(whole))] for part in (0, 0.5, 0.99)]
        if file.name != "zarr.json":
            third = len(whole) // 3
            wrong.append(whole[:third] + bytes([whole[third] ^ 0x40]) + whole[third + 1 :])
        for content in wrong:
            file.write_bytes(content)
            refuse(path)
        file.write_bytes(whole)
    read_all(open_store(path))


ALTERED = {"resolution": 0.02, "offset": [0, 0], "digest": "0" * 64, "model": None}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *((name, value, "its attributes were altered") for name, value in ALTERED.items()),
        ("version", 3, "of version 3"),
        ("format", "other", "not evidence of occmap"),
        ("complete", False, "is not complete"),
    ],
)
def test_altered_attributes_are_refused(
    path: Path, name: str, value: object, expected: str
) -> None:
    attributes = json.loads((path / "zarr.json").read_text())
    attributes["attributes"]["occmap"][name] = value
    (path / "zarr.json").write_text(json.dumps(attributes))
    assert expected in refuse(path)


def test_evidence_of_nothing(tmp_path: Path) -> None:
    manifest = Manifest(0.05, "beam", "counts", "", 10.0, 0.0, "simple", ())
    ZarrWriter().write_blocks(tmp_path / "m.zarr", Blocks.of(Evidence(manifest, {})))
    store = open_store(tmp_path / "m.zarr")
    assert (store.blocks, len(read_all(store).tiles)) == ({}, 0)
