"""Images in and out, through pillow."""

import io
import struct
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, UnidentifiedImageError

from occmap.arrays import Bool, UInt8
from occmap.errors import MapError
from occmap.writers.atomic import open_atomic

FORMATS = ("PPM", "PNG", "BMP")
"""What map servers load; PPM is pillow's name for the family of PGM."""
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "RGB", "RGBA")
DECODING_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error)
"""What pillow raises on damaged files."""


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
