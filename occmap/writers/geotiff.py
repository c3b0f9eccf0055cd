"""GeoTIFF images, cloud-optimised, for maps that a GIS shows: one file, read part by part."""

import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from errno import ENOSPC
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from occmap.cells import About, CellBox, OccupancyMap, list_captions
from occmap.errors import OutputError
from occmap.types import BLOCK_BITS, COLUMN_MM
from occmap.writers import Product, WriteOptions, Writer
from occmap.writers.atomic import check_target, follow_links, open_atomic
from occmap.writers.pgm import RAW_UNKNOWN, to_raw

WINDOW = 1024
"""Cells along the side of what is painted at once, from a multiple of as many cells on"""
BLOCK = 512
"""Pixels along the side of a block of the file; those at its edges are as large"""


class GeoTiffWriter(Writer):
    """8 bit, 0 to 100 per cent of being occupied, with overviews; 255 is no data."""

    description = "cloud-optimised GeoTIFF of the probability in per cent, for GIS"
    in_parts = True
    needs = "geotiff", "rasterio"

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> None:
        """Write the image part by part.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        parts = ((window, to_raw(part)[::-1]) for window, part in paint_windows(grid))
        globe, about = options.georeference, grid.about
        where = lay_out(grid.box, grid.resolution, globe, about)
        layout = where | {"dtype": "uint8", "nodata": RAW_UNKNOWN}
        write_image(path, layout, parts, list_captions(about))


class GroundWriter(Writer):
    """Heights of the ground in the map (m, float32) where it was measured; NaN is no data."""

    description = "GeoTIFF of the height of the ground that clouds show (m)"
    needs_evidence = True
    needs = GeoTiffWriter.needs

    def write_product(self, path: Path, product: Product, options: WriteOptions) -> None:
        """Write the ground that the evidence was traced over.

        Raises
        ------
        OutputError
            There is none, or it cannot be written; then nothing is left behind.
        """
        ground = product.evidence().ground
        if ground is None:
            found = "shows the ground below clouds, and this map was made of none"
            raise OutputError(found, where=path, fix="leave it out")
        side, box = 1 << BLOCK_BITS, CellBox.enclose(ground.blocks.tolist())
        rows, cols = (ground.blocks - box[:2]).T
        squares = np.full((*box.shape, side, side), np.nan, np.float32)
        known = np.where(ground.measured, ground.height_mm / 1000, np.nan)
        squares[rows, cols] = known.reshape(-1, side, side)
        heights = np.block([list(row) for row in squares])
        about = product.grid.about
        where = lay_out(box.scale(side), COLUMN_MM / 1000, options.georeference, about)
        kind = {"dtype": "float32", "nodata": math.nan}
        write_image(path, where | kind, [(None, heights[::-1])], list_captions(about))


def write_image(
    path: Path, layout: dict[str, Any], parts: Iterable[tuple[Any, Any]], tags: Mapping[str, str]
) -> None:
    """Write an image part by part: where in the image each part lies, and its pixels.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    import rasterio  # noqa: PLC0415  late: it is an extra
    import rasterio.shutil  # noqa: PLC0415  likewise

    check_target(path)
    try:
        with TemporaryDirectory(prefix=".occmap-", dir=follow_links(path).parent) as folder:
            # GDAL can only copy into this format: all is written once without compression.
            plain, done = Path(folder) / "plain.tif", Path(folder) / "done.tif"
            refuse_full_disk(folder, layout)
            with rasterio.open(plain, "w", **layout) as image:
                image.update_tags(**tags)
                for window, pixels in parts:
                    image.write(pixels, 1, window=window)
            how = {"driver": "COG", "compress": "DEFLATE", "overview_resampling": "average"}
            rasterio.shutil.copy(plain, done, **how)
            with open_atomic(path) as (file,), done.open("rb") as made:
                shutil.copyfileobj(made, file)
    # What GDAL itself reports, such as a full disk, is no error of rasterio's own.
    except (OSError, rasterio.errors.RasterioError, rasterio._err.CPLE_BaseError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"cannot be written ({reason})", where=path) from None


def refuse_full_disk(folder: str, layout: Mapping[str, Any]) -> None:
    """Raise OSError where an image has no room, before libtiff would print lines of its own."""
    height, width = (-(-layout[side] // BLOCK) * BLOCK for side in ("height", "width"))
    if shutil.disk_usage(folder).free < height * width * np.dtype(layout["dtype"]).itemsize:
        raise OSError(ENOSPC, os.strerror(ENOSPC))


def lay_out(
    box: CellBox, size: float, globe: tuple[float, float, float] | None, about: About | None
) -> dict[str, Any]:
    """Say where an image of cells, `size` (m) wide, lies and how it is laid out.

    Without a place on the globe its frame is that of the map. With one it is a plane that touches
    the globe there, on which distances from there are true (azimuthal equidistant). That place is
    of the map of the logs, so that a map which is turned has its walls where they were.
    """
    x, y = round(box.col * size, 12), round(box.row_end * size, 12)
    latitude, longitude, yaw = globe or (0.0, 0.0, 0.0)
    yaw -= about.align if globe and about else 0.0
    cos, sin = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    across, up = (size * cos, size * sin, x * cos - y * sin), (size * sin, -size * cos)
    plane = f"+proj=aeqd +lat_0={latitude!r} +lon_0={longitude!r} +datum=WGS84 +units=m +no_defs"
    return {
        "driver": "GTiff",
        "count": 1,
        "height": box.rows,
        "width": box.cols,
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "bigtiff": "if_safer",
        "transform": (*across, *up, x * sin + y * cos),
        "crs": plane if globe else None,
    }


def paint_windows(grid: OccupancyMap) -> Iterator[tuple[tuple[slice, slice], OccupancyMap]]:
    """Paint a map part by part, and say where in the image, top row first, each part lies."""
    for part in grid.box.cut(WINDOW):
        up, across = part.within(grid.box)
        down = slice(grid.box.rows - up.stop, grid.box.rows - up.start)
        yield (down, across), grid.take(up, across)
