"""GeoTIFF: the cells of the map at their places, with overviews, in one sound file."""

from pathlib import Path

import numpy as np
import pytest
import rasterio

from occmap.cells import OccupancyMap
from occmap.errors import OutputError
from occmap.writers import WriteOptions
from occmap.writers.geotiff import GeoTiffWriter


def make_map() -> OccupancyMap:
    """1,500 rows from -400 on, 1,300 columns from 20 on; p = 1 / (1 + e^-l)."""
    log_odds, observed = np.zeros((1500, 1300), np.float32), np.zeros((1500, 1300), np.bool_)
    for row, col, odds in [(0, 0, 2), (1499, 1299, -2), (700, 3, 0.5), (1023, 1100, 5)]:
        log_odds[row, col], observed[row, col] = odds, True
    return OccupancyMap(log_odds, observed, 0.1, (2.0, -40.0))


def test_cells_are_where_they_are(tmp_path: Path) -> None:
    path = tmp_path / "m.tif"
    assert GeoTiffWriter().write(path, make_map(), WriteOptions()) == (path,)
    with rasterio.open(path) as image:
        cells = image.read(1)
        assert (image.nodata, image.shape, image.overviews(1)) == (255, (1500, 1300), [2, 4])
        assert image.bounds == pytest.approx((2, -40, 132, 110))
        assert image.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        # 88, 12, 62 and 99 per cent; y of row 0 is -39.95.
        for x, y, percent in [(2, -40, 88), (131.9, 109.9, 12), (2.3, 30, 62), (112, 62.3, 99)]:
            assert cells[image.index(x + 0.05, y + 0.05)] == percent
    assert np.count_nonzero(cells != 255) == 4
    assert [each.name for each in tmp_path.iterdir()] == ["m.tif"]


def test_nothing_is_left_where_it_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rasterio.shutil.copy", fail)
    with pytest.raises(OutputError, match=r"m\.tif: cannot be written \(No space left on device\)"):
        GeoTiffWriter().write(tmp_path / "m.tif", make_map(), WriteOptions())
    assert list(tmp_path.iterdir()) == []
