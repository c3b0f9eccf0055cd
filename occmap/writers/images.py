"""Images in and out, through pillow: one, or several as panels in rows with titles."""

import io
import math
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError

from occmap.errors import MapError
from occmap.types import Bool, UInt8
from occmap.writers.atomic import open_atomic

FORMATS = ("PPM", "PNG", "BMP")
"""What map servers load; PPM is pillow's name for the family of PGM."""
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
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


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture with a title."""

    title: tuple[str, ...]
    """Lines"""
    pixels: UInt8
    """(H, W, 3), first row on top"""


def write_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write panels as one PNG.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    font = ImageFont.load_default(TEXT_PX)
    text_px = max(font.getlength(line) for each in panels for line in each.title)
    heights, widths = zip(*(panel.pixels.shape[:2] for panel in panels), strict=True)
    head = LINE_PX * max(len(panel.title) for panel in panels)
    width = max(*widths, math.ceil(text_px)) + GAP_PX
    height = max(heights) + head + GAP_PX
    columns, rows = arrange(len(panels), width, height)
    picture = Image.new("RGB", (columns * width + GAP_PX, rows * height + GAP_PX), PAPER)
    draw = ImageDraw.Draw(picture)
    for index, panel in enumerate(panels):
        row, column = divmod(index, columns)
        left, top = GAP_PX + column * width, GAP_PX + row * height
        for number, line in enumerate(panel.title):
            draw.text((left, top + number * LINE_PX), line, INK, font)
        picture.paste(Image.fromarray(panel.pixels), (left, top + head))
    with open_atomic(path) as (file,):
        picture.save(file, format="PNG")


def arrange(count: int, width: int, height: int) -> tuple[int, int]:
    """Choose in how many columns and rows places of one size stand, by the shape of the whole."""

    def measure(columns: int) -> float:
        across, up = columns * width + GAP_PX, -(-count // columns) * height + GAP_PX
        return abs(math.log(across / up / ASPECT))

    columns = min(range(1, count + 1), key=measure)
    return columns, -(-count // columns)
