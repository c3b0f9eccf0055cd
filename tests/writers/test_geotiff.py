"""GeoTIFF: the cells of the map at their places, with overviews, in one sound file."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from occmap import build_map
from occmap.cells import About, Evidence, Ground, OccupancyMap
from occmap.errors import OutputError
from occmap.writers import Product, WriteOptions, write_outputs
from occmap.writers.geotiff import GeoTiffWriter, GroundWriter
from tests.samples import SAMPLE_LOGS
from tests.writers.maps import map_of_places, nothing_kept


def make_map() -> OccupancyMap:
    """1,500 rows from -400 on, 1,300 columns from 20 on; p = 1 / (1 + e^-l)."""
    drawn = ((0, 0), 2.0), ((1499, 1299), -2.0), ((700, 3), 0.5), ((1023, 1100), 5.0)
    return map_of_places((1500, 1300), (2.0, -40.0), *drawn)


def test_cells_are_where_they_are(tmp_path: Path) -> None:
    path = tmp_path / "m.tif"
    GeoTiffWriter().write(path, make_map(), WriteOptions())
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


@pytest.mark.parametrize(("yaw", "align"), [(30.0, 0.0), (42.5, 12.5)])
@pytest.mark.parametrize("name", ["m.tif", "m.png"])
def test_a_place_on_the_globe_is_where_it_is(
    name: str, yaw: float, align: float, tmp_path: Path
) -> None:
    """A point of the map, 10 m and 5 m from its zero, where x points 30 degrees north of east.

    The x axis of logs whose map is turned by 12.5 degrees points to 42.5.
    """
    latitude, longitude = 52.5, 13.4
    options = WriteOptions(georeference=(latitude, longitude, yaw))
    turned = replace(make_map(), about=About("0.1", "e", "r", "a.bag", align))
    product = Product(turned, nothing_kept)
    files = write_outputs([tmp_path / name], product, options)
    assert sorted(map(Path, files)) == sorted(tmp_path.iterdir())
    with rasterio.open(tmp_path / name) as image:
        # Rows are counted from the top, which is at 110 m; column 0 begins at 2 m.
        col, row = (10 - 2) / 0.1, (110 - 5) / 0.1
        a, b, c, d, e, f, *_ = image.transform
        x, y = c + a * col + b * row, f + d * col + e * row
        (east,), (north,) = transform(image.crs, "EPSG:4326", [x], [y])
    turn = math.radians(30)
    assert x == pytest.approx(10 * math.cos(turn) - 5 * math.sin(turn), abs=1e-6)
    assert y == pytest.approx(10 * math.sin(turn) + 5 * math.cos(turn), abs=1e-6)
    # Radii of curvature of WGS 84 along the meridian and across it.
    squared, axis, phi = 0.00669437999014, 6378137.0, math.radians(latitude)
    across = axis / math.sqrt(1 - squared * math.sin(phi) ** 2)
    along = across * (1 - squared) / (1 - squared * math.sin(phi) ** 2)
    assert north == pytest.approx(latitude + math.degrees(y / along), abs=1e-9)  # 0.1 mm
    assert east == pytest.approx(longitude + math.degrees(x / across / math.cos(phi)), abs=1e-9)


def test_a_disk_that_is_too_full_is_told_before_libtiff_tells_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """3 x 3 blocks of 512 x 512 bytes."""
    disk = SimpleNamespace(free=9 * 512**2 - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda _: disk)
    with pytest.raises(OutputError, match=r"m\.tif: cannot be written \(No space left"):
        GeoTiffWriter().write(tmp_path / "m.tif", make_map(), WriteOptions())
    assert list(tmp_path.iterdir()) == []
    disk.free += 1
    GeoTiffWriter().write(tmp_path / "m.tif", make_map(), WriteOptions())


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left"), rasterio._err.CPLE_AppDefinedError(3, 1, "No space")]
)
def test_nothing_is_left_where_it_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("rasterio.shutil.copy", fail)
    with pytest.raises(OutputError, match=r"m\.tif: cannot be written \(.*No space"):
        GeoTiffWriter().write(tmp_path / "m.tif", make_map(), WriteOptions())
    assert list(tmp_path.iterdir()) == []


def write_ground(path: Path, ground: Ground | None) -> None:
    nothing = np.zeros((0, 2), np.int64)
    evidence = Evidence(None, nothing, nothing, ground=ground)  # type: ignore[arg-type]  # not read
    product = Product(make_map(), lambda: evidence)
    GroundWriter().write_product(path, product, WriteOptions())


def test_the_ground_lies_where_it_was_measured(tmp_path: Path) -> None:
    height, measured = np.full((2, 4096), 70, np.int32), np.zeros((2, 4096), np.bool_)
    # Blocks of 64 x 64 columns of 0.15 m: columns (-64 + 2, 0) and (1, 64 + 3), row first.
    for block, at, level in ((0, 2 * 64, -250), (1, 64 + 3, 1400)):
        height[block, at], measured[block, at] = level, True
    ground = Ground(np.array([[-1, 0], [0, 1]]), height, measured)

    write_ground(tmp_path / "m.ground.tif", ground)

    with rasterio.open(tmp_path / "m.ground.tif") as image:
        assert image.bounds == pytest.approx((0, -9.6, 19.2, 9.6))
        heights = image.read(1)
        assert heights[image.index(0.07, -9.6 + 2.5 * 0.15)] == pytest.approx(-0.25)
        assert heights[image.index(9.6 + 3.5 * 0.15, 1.5 * 0.15)] == pytest.approx(1.4)
        assert np.count_nonzero(~np.isnan(heights)) == 2  # what was filled is not shown


def test_the_ground_of_a_planar_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"m\.ground\.tif: .* made of none"):
        write_ground(tmp_path / "m.ground.tif", None)


def test_the_ground_of_a_hall_is_a_floor_and_a_ramp_beyond_5_m(tmp_path: Path) -> None:
    build_map(SAMPLE_LOGS / "hall.mcap", outputs=tmp_path / "hall.ground.tif")
    with rasterio.open(tmp_path / "hall.ground.tif") as image:
        assert image.tags()["logs"] == '"hall.mcap"'
        heights = image.read(1)
        assert abs(heights[image.index(1, 3)]) < 0.02
        assert heights[image.index(8, 3)] > 0.2
