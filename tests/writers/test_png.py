"""Pictures, whole or as tiles, which put together are the map."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap.cells import CellClass, OccupancyMap
from occmap.difference.maps import load_map
from occmap.writers import Shade, WriteOptions
from occmap.writers.images import TILE_PIXELS, TilesWriter
from occmap.writers.png import PngWriter
from tests.writers.maps import map_of, map_of_places


def read(path: Path) -> list[list[list[int]]]:
    with Image.open(path) as image:
        assert image.mode == "LA"
        pixels: list[list[list[int]]] = np.asarray(image).tolist()
        return pixels


def test_grey_is_the_probability_and_unknown_is_transparent(tmp_path: Path) -> None:
    grid = map_of([[0.2, np.nan], [0.999, 0.001]])
    assert PngWriter().write(tmp_path / "m.png", grid, WriteOptions()) == (tmp_path / "m.png",)
    # Top row of the image = row 1 of the map; dark is occupied: grey = 255 (1 - p).
    assert read(tmp_path / "m.png") == [[[0, 255], [255, 255]], [[204, 255], [127, 0]]]


def test_it_is_a_sound_image_that_says_how_its_pixels_are_decided(tmp_path: Path) -> None:
    PngWriter().write(tmp_path / "m.png", map_of([[0.2, 0.9]]), WriteOptions(free_thresh=0.1))
    with Image.open(tmp_path / "m.png") as image:
        assert image.info == {"occupied_thresh": "0.5", "free_thresh": "0.1", "negate": "0"}
        image.verify()  # checksums


def test_light_occupied_is_the_negative(tmp_path: Path) -> None:
    options = WriteOptions(shade=Shade.LIGHT_OCCUPIED)
    PngWriter().write(tmp_path / "m.png", map_of([[0.2, np.nan, 0.999]]), options)
    assert read(tmp_path / "m.png") == [[[51, 255], [127, 0], [255, 255]]]


GREY = {CellClass.NEITHER: 205, CellClass.FREE: 254, CellClass.OCCUPIED: 0}


def make_map() -> OccupancyMap:
    """2,500 x 1,200 cells from row -1,100 and column -30 on: a wall at the left, a free corner."""
    drawn = (np.s_[:, 3], 2.0), (np.s_[-10:, -20:], -2.0)
    return map_of_places((2500, 1200), (-3.0, -110.0), *drawn)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tiles") / "m.tiles"
    TilesWriter().write(path, make_map(), WriteOptions())
    return path


def list_tiles(folder: Path) -> set[str]:
    return {each.relative_to(folder).with_suffix("").as_posix() for each in folder.rglob("*.png")}


def test_tiles_that_nothing_is_in_are_left_out(folder: Path) -> None:
    # Rows -1,100 to 1,399 are in rows -2 to 1 of tiles, columns -30 to 1,169 in columns -1 to 1.
    wall = {f"2/0/{y}" for y in range(4)}
    assert list_tiles(folder) == {"0/0/0", "1/0/0", "1/0/1", "1/1/0", "2/2/0", *wall}


def test_a_tile_at_the_top_is_a_map(folder: Path) -> None:
    shown = load_map(folder / "2" / "0" / "1.yaml", WriteOptions())
    assert shown.place == (0.1, -102.4, 0.0)
    assert np.array_equal(np.unique(np.nonzero(shown.classes)[1]), [TILE_PIXELS - 30 + 3])
    corner = load_map(folder / "2" / "2" / "0.yaml", WriteOptions())
    assert corner.place == (0.1, 102.4, 102.4)
    rows, cols = np.nonzero(corner.classes == CellClass.FREE)
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (366, 375, 126, 145)


def test_a_tile_is_four_of_the_next_level_made_small(folder: Path) -> None:
    half = TILE_PIXELS // 2
    for level in (0, 1):
        for name in [each for each in list_tiles(folder) if each.startswith(f"{level}/")]:
            _, x, y = map(int, name.split("/"))
            whole = np.asarray(Image.open(folder / f"{name}.png"))
            for right, down in np.ndindex(2, 2):
                file = folder / f"{level + 1}" / f"{2 * x + right}" / f"{2 * y + down}.png"
                part = whole[down * half :, right * half :][:half, :half]
                if not file.exists():
                    assert set(np.unique(part)) == {GREY[CellClass.NEITHER]}
                    continue
                above = np.asarray(Image.open(file))
                known = np.argwhere(part != GREY[CellClass.NEITHER])[:99]
                for row, col in [(half - 1, 0), (0, half - 1), (136, 63), *known.tolist()]:
                    square = set(above[2 * row : 2 * row + 2, 2 * col : 2 * col + 2].ravel())
                    expected = 0 if 0 in square else 254 if 254 in square else 205
                    assert part[row, col] == expected


def test_a_folder_is_replaced_only_if_it_holds_tiles(folder: Path, tmp_path: Path) -> None:
    assert TilesWriter().owns(folder)
    (tmp_path / "notes.txt").touch()
    assert not TilesWriter().owns(tmp_path)
    TilesWriter().write(folder, make_map(), WriteOptions())
    assert [each.name for each in folder.parent.iterdir()] == ["m.tiles"]
