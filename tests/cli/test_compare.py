"""`occmap compare` as a command line: table, JSON, picture, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.cli.runner import ask, occmap
from tests.samples import write_csv


@pytest.fixture
def log(here: Path) -> Path:
    """Ten scans of two walls; the second is seen at a slant."""
    return write_csv(here / "my room.csv", [(0.1 * i, 0, 0) for i in range(10)], [1.0, 2.0], 0.3)


def test_the_table_names_the_best_and_how_to_build_it(log: Path) -> None:
    result = occmap("compare", log, "--resolution", 0.1, "--model", "simple", "--model", "counting")
    assert result.code == 0
    assert "note: 2 held-out scans: too few to tell variants apart" in result.err
    lines = result.out.splitlines()
    assert lines[0].split()[:5] == ["variant", "share", "error", "log-likelihood", "entropy"]
    names = [" ".join(line.split()[:2]) for line in lines[1:7]]
    updates, models = ("beam", "polygon", "surface"), ("simple", "counting")
    assert set(names) == {f"{update} {model}" for update in updates for model in models}
    shares = [float(line.split()[2]) for line in lines[1:7]]
    assert shares == sorted(shares, reverse=True)
    assert lines[7:9] == ["", "cells of surface counting, as held-out beams look at them"]
    assert lines[12:14] == ["", "scored by 4 beams of 2 held-out scans; 10 of 10 used"]
    build = f"occmap build surface '{log}' --resolution 0.1 --model counting -o 'my room.pgm'"
    equals = ", ".join(names[:4])  # two scans tell little
    assert lines[14] == f"as good within the error: {equals}; of these, the default is preferred"
    assert lines[15:17] == ["best: surface counting", build]
    likely = build.replace("surface", "beam")
    assert lines[17:] == ["where probabilities matter: beam counting", likely]


def test_the_reliability_is_told_of_the_recommended_map_and_in_json_of_all(tmp_path: Path) -> None:
    """One beam crosses 19 free cells and ends; the other crosses those and the end of the first.

    Of the 8 scans in the map the nearer end has 8 hits and 8 misses, the other 8 hits.
    """
    log = write_csv(tmp_path / "wall.csv", [(0.025, 0.025, 0)] * 10, [1.0, 0.96], 1e-6)
    words = ["compare", log, "--update", "beam", "--model", "simple:spread=0", "--hit-offset", 0]
    lines = [line.split() for line in occmap(*words).out.splitlines()]
    ends = [1 / (1 + (3 / 7) ** 8 * (3 / 2) ** misses) for misses in (8, 0)]
    predicted = (2 * ends[0] + ends[1]) / 3
    assert lines[3][:4] == ["cells", "of", "beam", "simple:spread=0,"]
    assert lines[4] == ["predicted", "occupied", "0.002", f"{predicted:.3f}"]
    assert lines[5:7] == [["found", "occupied", "0.000", "0.667"], ["looks", "76", "6"]]
    (variant,) = ask(*words)["variants"]
    assert [each["looks"] for each in variant["reliability"]] == [76, 6]
    assert variant["reliability"][1]["observed"] == pytest.approx(4 / 6)
    costs = variant["free_cost"] + variant["occupied_cost"]
    assert variant["cross_entropy"] == pytest.approx(costs / 2)


def test_the_error_of_one_scan_is_not_known(log: Path) -> None:
    result = occmap("compare", log, "--model", "simple", "--update", "beam", "--end", "5")
    assert result.out.splitlines()[1].split()[:4] == ["beam", "simple", "1.0000", "-"]
    assert "note: 1 held-out scan: too few" in result.err


def test_the_best_command_builds_by_that_update_and_model(log: Path, here: Path) -> None:
    words = ["--start", "1", "--end", "8", "--stride", "2", "--border-gap", "3"]
    words += ["--no-return", "clear", "--range-max", "9", "--update", "polygon"]
    command = ask("compare", log, *words, "--model", "simple:p_hit=0.8")["command"]
    assert {*words, "build"} - {"--update"} <= set(command)
    made = ask(*command[1:])["map"]
    assert (made["update"], made["model"][:16]) == ("polygon", "simple:p_hit=0.8")
    assert (here / "my room.pgm").exists()


def test_the_picture_shows_every_map_and_the_disagreement(log: Path, here: Path) -> None:
    target = here / "compare.png"
    result = occmap("compare", log, "-o", target)
    assert f"picture: {target}" in result.out.splitlines()
    with Image.open(target) as picture:
        assert picture.format == "PNG"
        pixels = np.asarray(picture.convert("RGB"))
    again = here / "again.png"
    assert occmap("compare", log, "-o", again, "--jobs", 1).code == 0
    assert again.read_bytes() == target.read_bytes()
    is_red = (pixels == (214, 39, 40)).all(axis=-1)
    assert is_red.any()  # the polygon closes over what the beams left
