"""Images in and out, through pillow: one, panels with titles, and folders of PNG tiles.

Tiles are for maps that no single image holds: z/x/y, as web maps have them. At the top level a
pixel is a cell, and a tile has a map_server YAML beside it. One level below, a pixel stands for
2 x 2 of them: occupied where any is, else free where any is; and so on down to level 0, a single
tile. x counts to the right and y down. Tiles in which nothing was observed are left out.
"""

import io
import math
import struct
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError

from occmap.cells import CellBox, CellClass, OccupancyMap, keep_largest
from occmap.errors import MapError
from occmap.types import Bool, UInt8
from occmap.writers import USUAL, WriteOptions, Writer
from occmap.writers.atomic import make_folder, open_atomic
from occmap.writers.pgm import GREYS, describe_image, write_yaml

FORMATS = ("PPM", "PNG", "BMP")
"""What map servers load; PPM is pillow's name for the family of PGM."""
COLOURED = ("P", "RGB", "RGBA")
"""Map servers take the mean of red, green and blue, and pillow weighs these as an eye does."""
EIGHT_BIT_MODES = ("1", "L", "LA", *COLOURED)
DECODING_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error)
"""What pillow raises on damaged files."""

TEXT_PX = 15
LINE_PX = 20
GAP_PX = 16
ASPECT = 1.5
"""Width by height that a picture comes near to."""
PAPER, INK = (255, 255, 255), (0, 0, 0)


class GreyImage(NamedTuple):
    """An image as map servers see it."""

    grey: UInt8
    """(H, W), first row on top"""
    visible: Bool
    """(H, W): not fully transparent"""
    texts: dict[str, str]
    """What a PNG says of itself, by name"""


def read_grey(path: Path) -> GreyImage:
    """Read an image as shades of grey.

    Raises
    ------
    MapError
        It cannot be read, is cut, too large, or not of 8 bits a channel.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise MapError("is not a file", where=path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=FORMATS) as image:
                mode, pixels = image.mode, np.asarray(image.convert("LA"))
                if mode in COLOURED:
                    colours = np.asarray(image.convert("RGB")).mean(axis=-1, dtype=np.float32)
                    pixels = np.stack([np.rint(colours).astype(np.uint8), pixels[..., 1]], axis=-1)
                texts = {str(k): text for k, text in image.info.items() if isinstance(text, str)}
    except FileNotFoundError:
        raise MapError("no such file", where=path, fix="check the path") from None
    except UnidentifiedImageError:
        raise MapError("is not a PGM, PNG or BMP image", where=path) from None
    except Image.DecompressionBombError as error:
        raise MapError(f"is too large: {error}", where=path) from None
    except DECODING_ERRORS as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"the image cannot be read ({reason})", where=path) from None
    if mode not in EIGHT_BIT_MODES:
        found = f"pixels of the kind {mode} are not a map"
        raise MapError(found, where=path, fix="save it as 8 bit")
    return GreyImage(pixels[..., 0], pixels[..., 1] > 0, texts)


def write_colours(path: Path, pixels: UInt8) -> None:
    """Write (H, W, 3) red, green, blue, first row on top, as a PNG.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    with open_atomic(path) as (file,):
        file.write(encode_png(pixels))


def encode_png(pixels: UInt8) -> bytes:
    """Make a PNG of (H, W, 3) red, green, blue, first row on top."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


Panel: TypeAlias = tuple[Sequence[str], UInt8]
"""The lines of a title, and what is below it: (H, W, 3), first row on top"""


def write_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write panels as one PNG.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    font = ImageFont.load_default(TEXT_PX)
    text_px = max(font.getlength(line) for title, _ in panels for line in title)
    heights, widths = zip(*(pixels.shape[:2] for _, pixels in panels), strict=True)
    head = LINE_PX * max(len(title) for title, _ in panels)
    width = max(*widths, math.ceil(text_px)) + GAP_PX
    height = max(heights) + head + GAP_PX
    columns, rows = arrange(len(panels), width, height)
    picture = Image.new("RGB", (columns * width + GAP_PX, rows * height + GAP_PX), PAPER)
    draw = ImageDraw.Draw(picture)
    for index, (title, pixels) in enumerate(panels):
        row, column = divmod(index, columns)
        left, top = GAP_PX + column * width, GAP_PX + row * height
        for number, line in enumerate(title):
            draw.text((left, top + number * LINE_PX), line, INK, font)
        picture.paste(Image.fromarray(pixels), (left, top + head))
    write_colours(path, np.asarray(picture))


def arrange(count: int, width: int, height: int) -> tuple[int, int]:
    """Choose in how many columns and rows places of one size stand, by the shape of the whole."""

    def measure(columns: int) -> float:
        across, up = columns * width + GAP_PX, -(-count // columns) * height + GAP_PX
        return abs(math.log(across / up / ASPECT))

    columns = min(range(1, count + 1), key=measure)
    return columns, -(-count // columns)


TILE_PIXELS = 1024
"""Along the side of a tile, which begins at a multiple of as many cells"""


class TilesWriter(Writer):
    """A folder of PNG tiles."""

    description = "folder of PNG tiles (z/x/y), those at full resolution with a YAML each"
    in_parts = is_folder = True

    def owns(self, path: Path) -> bool:
        """Whether a folder is one that this writer made."""
        return all(each.name.isdigit() for each in path.iterdir())

    def write(self, path: Path, grid: OccupancyMap, options: WriteOptions) -> None:
        """Write all tiles.

        Raises
        ------
        OutputError
            One cannot be written; then nothing is left behind.
        """
        with make_folder(path) as folder:
            folder.mkdir()
            TileTree(folder, grid, options).write(level=0, x=0, y=0)


BLANK: UInt8 = np.full((TILE_PIXELS, TILE_PIXELS), CellClass.NEITHER, np.uint8)
"""The classes of a tile that shows nothing"""


class TileTree:
    """Tiles of a map, each made of the four below it."""

    def __init__(self, folder: Path, grid: OccupancyMap, options: WriteOptions) -> None:
        self.folder, self.grid, self.options = folder, grid, options
        self.tiles = grid.box.align(TILE_PIXELS).shrink(TILE_PIXELS)
        """The rows and columns of tiles that there are"""
        self.top = (max(self.tiles.shape) - 1).bit_length()
        """The level at which a pixel is a cell"""

    def write(self, level: int, x: int, y: int) -> UInt8:
        """Write a tile and all above it, unless they show nothing; return its classes."""
        below = self.top - level
        if x << below >= self.tiles.cols or y << below >= self.tiles.rows:
            return BLANK
        if level == self.top:
            classes = self.paint(x, y)
        else:  # row 0 is the lowest y
            down, right = (2 * y + 1, 2 * y), (2 * x, 2 * x + 1)
            parts = [[self.write(level + 1, across, along) for across in right] for along in down]
            is_blank = all(part is BLANK for row in parts for part in row)
            classes = BLANK if is_blank else keep_largest(np.block(parts), 2)
        if not classes.any():
            return BLANK
        file = self.folder / f"{level}" / f"{x}" / f"{y}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(GREYS[classes][::-1]).save(file)
        if level == self.top:
            self.describe(file, self.find_cells(x, y))
        return classes

    def find_cells(self, x: int, y: int) -> CellBox:
        """The cells of a tile at the top level."""
        return CellBox.at(self.tiles.row_end - 1 - y, self.tiles.col + x).scale(TILE_PIXELS)

    def paint(self, x: int, y: int) -> UInt8:
        """Find the classes of the cells of a tile at the top level."""
        tile = self.find_cells(x, y)
        seen, classes = tile.clip(self.grid.box), BLANK.copy()
        part = self.grid.take(*seen.within(self.grid.box))
        decision = self.options.decide(part.decision)
        classes[seen.within(tile)] = replace(part, decision=decision).classes
        return classes

    def describe(self, image: Path, tile: CellBox) -> None:
        """Write beside the image of a tile where its cells lie."""
        size = self.grid.resolution
        origin = round(tile.col * size, 12), round(tile.row * size, 12)
        fields = describe_image(image.name, size, origin, USUAL)  # its greys are classes
        with image.with_suffix(".yaml").open("wb") as opened:
            write_yaml(opened, fields, self.grid.about)
