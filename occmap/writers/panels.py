"""One picture of several: panels in rows, each with its title above it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont

from occmap.arrays import UInt8
from occmap.writers.atomic import open_atomic

TEXT_PX = 15
LINE_PX = 20
GAP_PX = 16
ASPECT = 1.5
"""Width by height that a picture comes near to."""
PAPER, INK = (255, 255, 255), (0, 0, 0)


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture with a title."""

    title: tuple[str, ...]
    """Lines"""
    pixels: UInt8
    """(H, W, 3), first row on top"""


class Layout(NamedTuple):
    """A table of equal places."""

    columns: int
    rows: int
    width: int
    """Of a place, with the gap beside it (pixels)"""
    height: int
    head: int
    """Of the titles (pixels)"""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the whole (pixels)."""
        return self.columns * self.width + GAP_PX, self.rows * self.height + GAP_PX

    def place(self, index: int) -> tuple[int, int]:
        """Left and top of a place (pixels)."""
        row, column = divmod(index, self.columns)
        return GAP_PX + column * self.width, GAP_PX + row * self.height


def write_panels(path: Path, panels: Sequence[Panel]) -> None:
    """Write panels as one PNG.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    font = ImageFont.load_default(TEXT_PX)
    layout = arrange(panels, max(font.getlength(line) for each in panels for line in each.title))
    picture = Image.new("RGB", layout.size, PAPER)
    draw = ImageDraw.Draw(picture)
    for index, panel in enumerate(panels):
        left, top = layout.place(index)
        for number, line in enumerate(panel.title):
            draw.text((left, top + number * LINE_PX), line, INK, font)
        picture.paste(Image.fromarray(panel.pixels), (left, top + layout.head))
    with open_atomic(path) as (file,):
        picture.save(file, format="PNG")


def arrange(panels: Sequence[Panel], text_width: float) -> Layout:
    """Choose how many panels stand in a row."""
    heights, widths = zip(*(panel.pixels.shape[:2] for panel in panels), strict=True)
    head = LINE_PX * max(len(panel.title) for panel in panels)
    width = max(*widths, math.ceil(text_width)) + GAP_PX
    height = max(heights) + head + GAP_PX

    def lay_out(columns: int) -> Layout:
        return Layout(columns, -(-len(panels) // columns), width, height, head)

    layouts = map(lay_out, range(1, len(panels) + 1))
    return min(layouts, key=lambda each: abs(math.log(each.size[0] / each.size[1] / ASPECT)))
