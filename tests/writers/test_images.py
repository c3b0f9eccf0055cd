"""Panels side by side: where each lies, and that what fails leaves nothing."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap.writers.images import GAP_PX, LINE_PX, Panel, arrange, write_panels


def make_panels(count: int, shape: tuple[int, int] = (40, 60)) -> list[Panel]:
    return [
        ((f"map {i}",), np.full((*shape, 3), (10 * i, 200, 30), np.uint8)) for i in range(count)
    ]


@pytest.mark.parametrize(
    ("count", "shape", "columns", "rows"),
    [(1, (400, 400), 1, 1), (7, (400, 400), 4, 2), (4, (100, 900), 1, 4), (4, (900, 100), 4, 1)],
)
def test_the_picture_is_neither_a_strip_nor_a_tower(
    count: int, shape: tuple[int, int], columns: int, rows: int
) -> None:
    height, width = shape
    assert arrange(count, width + GAP_PX, height + LINE_PX + GAP_PX) == (columns, rows)


def test_each_panel_lies_below_its_title(tmp_path: Path) -> None:
    panels = make_panels(5)
    write_panels(tmp_path / "p.png", panels)
    with Image.open(tmp_path / "p.png") as image:
        pixels = np.asarray(image)
    for _, drawn in panels:
        found = np.argwhere((pixels == drawn[0, 0]).all(axis=-1))
        low, high = found.min(axis=0), found.max(axis=0)
        assert (high - low + 1).tolist() == [40, 60]
        title = pixels[low[0] - LINE_PX : low[0], low[1] : low[1] + 60]
        assert title.min() < 100
        assert (low[0] - LINE_PX - GAP_PX) % (40 + LINE_PX + GAP_PX) == 0


def test_a_title_wider_than_its_panel_is_whole(tmp_path: Path) -> None:
    panel: Panel = ("a title of many words, " * 4,), np.zeros((5, 5, 3), np.uint8)
    write_panels(tmp_path / "p.png", [panel])
    with Image.open(tmp_path / "p.png") as image:
        assert image.width > 400
        assert (np.asarray(image)[:, -GAP_PX:] == 255).all()
