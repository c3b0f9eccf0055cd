"""`occmap diff`: text, JSON, picture, and the limit that a pipeline sets."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap.writers import WriteOptions
from occmap.writers.pgm import PgmWriter
from tests.cli.runner import ask, occmap
from tests.writers.maps import map_of_art


@pytest.fixture(autouse=True)
def _maps(here: Path) -> None:
    """Two maps that differ in one of five known cells."""
    for name, art in (("a", "#.? ..#"), ("b", "#.? .##")):
        PgmWriter().write(here / f"{name}.pgm", map_of_art(art), WriteOptions())


def test_the_text_says_what_changed() -> None:
    result = occmap("diff a.pgm b.yaml")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines() == [
        "changed  1 cell, 20.000% of 5 known cells",
        "         1 free to occupied",
        "largest  1 connected cell, x 0.05 to 0.1, y 0 to 0.05",
    ]


@pytest.mark.parametrize("words", ["diff a.pgm b.pgm", "score a.pgm --truth b.pgm"])
def test_a_map_whose_unknown_cells_load_as_free_is_noted(words: str) -> None:
    for name in ("a.yaml", "b.yaml"):
        text = Path(name).read_text()
        Path(name).write_text(text.replace("free_thresh: 0.196", "free_thresh: 0.25"))
    notes = ask(words)["notes"]
    assert [note.split(":")[0] for note in notes] == ["a.yaml", "b.yaml"]
    assert all("write `free_thresh: 0.196` into it" in note for note in notes)


def test_json() -> None:
    found = ask("diff a.pgm b.pgm")
    assert (found["share"], found["changed"], found["known"]) == (0.2, 1, 5)
    assert found["by_class"]["free to occupied"] == 1
    assert found["largest_blob"] == {"cells": 1, "extent": [0.05, 0.0, 0.1, 0.05]}


@pytest.mark.parametrize(("limit", "code"), [("0.2", 0), ("20%", 0), ("19.9%", 3), ("0", 3)])
def test_the_limit_is_held(limit: str, code: int) -> None:
    result = occmap(f"diff a.pgm b.pgm --fail-above {limit} -o d.png")
    assert result.code == code
    assert "changed  1 cell," in result.out
    assert np.asarray(Image.open("d.png"))[1, 1].tolist() == [213, 94, 0]
    assert ("changed is 20%, and --fail-above says > " in result.err) == (code == 3)
