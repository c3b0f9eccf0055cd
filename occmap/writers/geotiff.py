"""GeoTIFF images, cloud-optimised, for maps that a GIS shows: one file, read part by part."""

import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from occmap.cells import OccupancyMap
from occmap.errors import OutputError
from occmap.plugins import need_extra
from occmap.writers import Windows, WriteOptions
from occmap.writers.atomic import check_target, follow_links, open_atomic
from occmap.writers.pgm import RAW_UNKNOWN, to_raw

WINDOW = 1024
"""Cells along the side of what is painted at once, from a multiple of as many cells on"""


class GeoTiffWriter:
    """8 bit, 0 to 100 per cent of being occupied, with overviews; 255 is no data."""

    description = "cloud-optimised GeoTIFF of the probability in per cent, for GIS"
    in_windows = True

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the image."""
        import_rasterio()
        return (path,)

    def write(self, path: Path, grid: Windows, options: WriteOptions) -> tuple[Path, ...]:  # noqa: ARG002  it has no options
        """Write the image part by part; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        rasterio = import_rasterio()
        check_target(path)
        try:
            with TemporaryDirectory(prefix=".occmap-", dir=follow_links(path).parent) as folder:
                # GDAL can only copy into this format: all is written once without compression.
                plain, done = Path(folder) / "plain.tif", Path(folder) / "done.tif"
                with rasterio.open(plain, "w", **describe(grid)) as image:
                    for window, part in paint_windows(grid):
                        image.write(to_raw(part)[::-1], 1, window=window)
                how = {"driver": "COG", "compress": "DEFLATE", "overview_resampling": "average"}
                rasterio.shutil.copy(plain, done, **how)
                with open_atomic(path) as (file,), done.open("rb") as made:
                    shutil.copyfileobj(made, file)
        except (OSError, rasterio.errors.RasterioError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise OutputError(f"cannot be written ({reason})", where=path) from None
        return (path,)


def import_rasterio() -> Any:
    """Load rasterio, late: it is an extra.

    Raises
    ------
    UsageError
        It is not installed.
    """
    with need_extra("geotiff", "a GeoTIFF needs rasterio"):
        import rasterio  # noqa: PLC0415  as above
        import rasterio.shutil  # noqa: PLC0415  as above
    return rasterio


def describe(grid: Windows) -> dict[str, Any]:
    """Say where the image lies and how it is laid out; its frame is the map's, on no globe."""
    (rows, cols), (row, col) = grid.shape, grid.place.tolist()
    size = grid.resolution
    return {
        "driver": "GTiff",
        "dtype": "uint8",
        "count": 1,
        "height": rows,
        "width": cols,
        "tiled": True,
        "blockxsize": 512,
        "blockysize": 512,
        "bigtiff": "if_safer",
        "nodata": RAW_UNKNOWN,
        "transform": (size, 0.0, round(col * size, 12), 0.0, -size, round((row + rows) * size, 12)),
    }


def paint_windows(grid: Windows) -> Iterator[tuple[tuple[slice, slice], OccupancyMap]]:
    """Paint a map part by part, and say where in the image, top row first, each part lies."""
    (rows, cols), (row, col) = grid.shape, grid.place.tolist()
    corners = product(range(-(row % WINDOW), rows, WINDOW), range(-(col % WINDOW), cols, WINDOW))
    for low, left in corners:
        up = slice(max(low, 0), min(low + WINDOW, rows))
        across = slice(max(left, 0), min(left + WINDOW, cols))
        yield (slice(rows - up.stop, rows - up.start), across), grid.take(up, across)
