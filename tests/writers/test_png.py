from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap import writers
from occmap.writers import Shade, WriteOptions
from occmap.writers.png import PngWriter
from tests.writers.maps import map_of


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


def test_same_map_same_bytes_whatever_the_bands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = map_of(np.random.default_rng(2).uniform(0.01, 0.99, (40, 9)))
    PngWriter().write(tmp_path / "a.png", grid, WriteOptions())
    monkeypatch.setattr(writers, "BAND_CELLS", 20)
    PngWriter().write(tmp_path / "b.png", grid, WriteOptions())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
