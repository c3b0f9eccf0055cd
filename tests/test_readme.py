"""The README is short and true: its picture, its options and the list of its pages."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.documents import PAGES, Session, read_page
from tests.samples import ROOT

LONGEST = 9_000
"""Bytes that a newcomer reads in three minutes."""


def find_section(title: str) -> str:
    return read_page("README.md").partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_it_is_read_in_three_minutes() -> None:
    assert (ROOT / "README.md").stat().st_size <= LONGEST


def test_the_picture_on_top_is_what_a_bare_build_makes(tmp_path: Path) -> None:
    build([ROOT / "sample_logs" / "drive.mcap"], BuildOptions(), [tmp_path / "map.png"])
    shown, made = (
        Image.open(path) for path in (ROOT / "sample_logs/map.png", tmp_path / "map.png")
    )
    assert np.array_equal(np.asarray(shown), np.asarray(made))


def test_it_shows_ten_options_and_each_exists(tmp_path: Path) -> None:
    rows = re.findall(r"^\| `(--?[a-z-]+)", find_section("Options"), re.MULTILINE)
    assert len(rows) == 10
    listed = Session(tmp_path).run("occmap build --help")
    for option in rows:
        assert re.search(rf"(?<![\w-]){option}\b", listed), option


@pytest.mark.parametrize("page", [*PAGES[1:], "CONTRIBUTING.md", "CHANGELOG.md"])
def test_it_leads_to_every_page(page: str) -> None:
    assert f"]({page})" in find_section("Read on")
