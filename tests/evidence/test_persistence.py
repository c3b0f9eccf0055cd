"""Hits that last: people who walk through once vanish, walls that are hit on every pass stay."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Slices
from occmap.errors import MapError
from occmap.evidence import keep_lasting
from occmap.grid.tiles import TILE, TileGrid, pack_bits
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.sensor import ReturnOptions
from occmap.sensor.models import parse_model
from occmap.store.painting import RenderOptions, open_map
from occmap.types import Update
from occmap.writers import DEFAULT_THRESHOLDS
from occmap.writers.npz import read_evidence
from tests.cli.runner import occmap
from tests.csv_logs import write_scans
from tests.evidence.saving import hold
from tests.grid.scans import are_equal, make_grid
from tests.samples import PLAIN, PLAIN_WORDS, import_generator, write_csv

office = import_generator("office")
BEAMS, FIRST, STEP = 80, -19.75, 0.5
"""Degrees: a narrow view ahead, in which no beam runs along a wall."""
BEARINGS = np.radians(FIRST + STEP * np.arange(BEAMS))
WALLS_Y = (-0.42, 0.42)
"""In the rows of cells from -0.45 and from 0.4 m, in cells of 5 cm. The sensor looks ahead, so all
beams come in flat and cross some cells of the row before they end."""
LENGTH = 6.0
"""From x = 0 (m); the corridor is open at both ends."""
WALLS = np.array([(0, y, LENGTH, y) for y in WALLS_Y])
STEP_S, STEP_M = 0.4, 0.15
PASS_S = 60.0
RADIUS = 0.15


PASSES = 3
PERSON_X, PERSON_Y, PERSON_SPEED, PERSON_PASS = 1.0, 0.1, 0.375, 1
"""Walks along the corridor on one pass, at the robot's own pace, a metre ahead of it."""
FIRST_HIT_X = WALLS_Y[1] / math.tan(BEARINGS[-1])
"""Where the widest beam meets a wall on the first scan."""
WALL_CELLS = 2 * (round(LENGTH / 0.05) - math.floor(FIRST_HIT_X / 0.05))


ALL_MEASURED = replace(PLAIN, returns=ReturnOptions(range_max=100.0))
"""Few beams see the far end of the walls: no band is looked for there"""


def write_passes(path: Path) -> Path:
    steps = np.arange(int(LENGTH / STEP_M))
    stamps, places, ranges = [], [], []
    for index in range(PASSES):
        for x, seconds in zip(steps * STEP_M, steps * STEP_S, strict=True):
            person = PERSON_X + PERSON_SPEED * seconds if index == PERSON_PASS else 1e6
            stamps.append(index * PASS_S + seconds)
            places.append((x, 0.0, 0.0))
            circle = (person, PERSON_Y, RADIUS)
            ranges.append(office.cast_rays((x, 0.0), BEARINGS, WALLS, circle))
    first, step = math.radians(FIRST), math.radians(STEP)
    shape = {"angle_min": first, "angle_increment": step, "range_max": 1e6}
    return write_scans(path, stamps, ranges, places, **shape)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_passes(tmp_path_factory.mktemp("passes") / "log.csv")


def count_occupied(log: Path, options: BuildOptions) -> tuple[int, int]:
    """Cells of the map that are occupied: between the walls, and where these are."""
    grid = replace(build([log], options).map, decision=DEFAULT_THRESHOLDS)
    rows, _ = np.nonzero(grid.occupied)
    y = grid.origin[1] + (rows + 0.5) * grid.resolution
    on_wall = np.abs(y) > 0.4
    return int(np.count_nonzero(~on_wall)), int(np.count_nonzero(on_wall))


@pytest.mark.parametrize(
    ("update", "model", "ghosts", "walls"),
    [
        (Update.BEAM, "simple:spread=0", 28, 140),
        (Update.BEAM, "counting:strength=2,spread=0,ceiling=1,doubt=0", 15, 2),
        (Update.POLYGON, "simple:spread=0", 27, WALL_CELLS),
        (Update.POLYGON, "counting:strength=2,spread=0,ceiling=1,doubt=0", 27, WALL_CELLS),
    ],
)
def test_a_person_vanishes_and_thin_walls_stay(
    log: Path, update: Update, model: str, ghosts: int, walls: int
) -> None:
    options = replace(ALL_MEASURED, update=update, model=parse_model(model), jump=0.2)
    assert WALL_CELLS == 194
    assert count_occupied(log, options) == (ghosts, walls)
    assert count_occupied(log, replace(options, min_passes=2)) == (0, WALL_CELLS)
    # One visit is what the person made.
    assert count_occupied(log, replace(options, min_passes=1))[0] >= ghosts


def test_passes_without_a_pause_are_one_visit(log: Path) -> None:
    options = replace(ALL_MEASURED, min_passes=2, pass_gap_s=100)
    assert count_occupied(log, options) == (0, 0)


def test_walls_that_one_visit_hit_do_not_vanish_without_a_word(log: Path, tmp_path: Path) -> None:
    saved, target = tmp_path / "one.npz", tmp_path / "one.pgm"
    lasting, plain = ["-o", target, "--min-passes", 2], [*PLAIN_WORDS, "--range-max", 100]
    built = occmap("build", *plain, log, "-o", saved, "--pass-gap", 100, *lasting)
    found = r"note: --min-passes takes away 100% of the occupied cells \(179 of 179\), since .*\n"
    assert re.fullmatch(found, built.err)
    assert "cells    0.0% occupied, " in built.out
    assert "agree    0.0% of the hits" in built.out
    assert occmap("render", saved, *lasting).err == built.err
    assert occmap("render", saved, "-o", target, "--min-passes", 1).err == ""
    assert occmap("build", *plain, log, *lasting).err == ""


@pytest.mark.parametrize(("lost", "share"), [(5, 25), (4, None), (19, 95)])
def test_a_quarter_of_the_occupied_cells_is_not_lost_without_a_word(
    lost: int, share: int | None
) -> None:
    """Of 20; others were hit, but are not occupied, or are occupied only now."""
    cells = [(3, 0, 1, 1)] * lost + [(3, 0, 2, 2)] * (20 - lost)
    others = [(0, 5, 0, 1)] * 9 + [(1, 50, 1, 1)] * 7 + [(9, 50, 2, 2)]
    grid, slices = observe(cells + others)
    options = RenderOptions(min_passes=2)
    shown = open_map(hold(grid, slices), parse_model("simple:spread=0"), options)
    made, notes = shown.paint_all()
    # Of 60 + 7 + 9 hits; those that are lost, some of them beside the map, agree with nothing.
    assert made.agreement == (3 * (20 - lost) + 9) / 76
    if share is None:
        assert not notes
    else:
        (note,) = notes
        assert f"{share}% of the occupied cells ({lost} of 20)" in note
        assert "`pass_gap_s`" in note


def test_build_and_render_agree_and_evidence_stays(log: Path, tmp_path: Path) -> None:
    plain, lasting = tmp_path / "plain.npz", tmp_path / "lasting.npz"
    made, rendered = tmp_path / "built.pgm", tmp_path / "rendered.pgm"
    assert occmap("build", log, "-o", plain).code == 0
    built = occmap("build", log, "-o", lasting, "-o", made, "--min-passes", 2)
    assert ", hits of 2 visits or more\n" in built.out
    one, other = read_evidence(plain), read_evidence(lasting)
    assert are_equal(one.tiles, other.tiles)
    assert other.manifest.builds[0]["options"]["min_passes"] == 2
    for saved in (plain, lasting):
        words = ["render", saved, "-o", rendered, "--json"]
        assert json.loads(occmap(*words).out)["map"]["min_passes"] is None
        assert json.loads(occmap(*words, "--min-passes", 2).out)["map"]["min_passes"] == 2
        assert rendered.read_bytes() == made.read_bytes()


@pytest.mark.parametrize(("start", "visits"), [(0, 1), (20, 2)])
def test_resumed_and_merged_builds_share_slices(tmp_path: Path, start: int, visits: int) -> None:
    for name, first in (("a", 0), ("b", start)):
        write_csv(tmp_path / f"{name}.csv", [(0.0, 0.0, 0.0)], [0.32], start=first)
        words = [tmp_path / f"{name}.csv", "-o", tmp_path / f"{name}.npz"]
        assert occmap("build", *words).code == 0
    lasting = ["-o", tmp_path / "m.pgm", "--min-passes", 2, "--json"]

    def share(*words: object) -> float:
        found = json.loads(occmap(*words, *lasting).out)
        return float(found["map"]["occupied"])

    assert share("render", tmp_path / "a.npz") == 0
    assert (share("merge", tmp_path / "a.npz", tmp_path / "b.npz") > 0) == (visits == 2)
    assert (share("build", tmp_path / "b.csv", "--resume", tmp_path / "a.npz") > 0) == (visits == 2)


def observe(cells: Sequence[tuple[int, int, int, int]]) -> tuple[TileGrid, Slices]:
    """Cells in a row with these hits, misses, visits that hit and visits that saw."""
    placed = {(5 * TILE, -7 * TILE + col): pair[:2] for col, pair in enumerate(cells)}
    grid = make_grid(placed)
    numbers = 2 * np.arange(max(seen for *_, seen in cells))
    bits = np.zeros((len(numbers), 2, TILE, TILE), np.bool_)
    for col, visits in enumerate(np.array(cells)[:, 2:]):
        for layer, count in enumerate(visits):
            bits[:count, layer, 0, col] = True
    return grid, pack_bits(np.tile([5, -7], (len(numbers), 1)), numbers, np.packbits(bits, axis=-1))


@pytest.mark.parametrize(
    ("cell", "left"),
    [
        ((9, 5, 1, 4), (0, 5)),  # hit on one visit only: as its misses say
        ((9, 0, 1, 1), (0, 0)),  # without any: unknown
        ((9, 50, 2, 4), (9, 0)),  # on half of the visits: misses are forgotten
        ((9, 50, 2, 5), (9, 50)),  # on fewer: as the model says
        ((9, 50, 1, 1), (0, 50)),  # however often on one visit
        ((0, 50, 0, 7), (0, 50)),
    ],
)
def test_what_is_left_of_a_cell(cell: tuple[int, int, int, int], left: tuple[int, int]) -> None:
    grid, slices = observe([cell, (1, 1, 2, 2)])
    before = grid.tiles[5, -7].copy()
    lasting = keep_lasting(grid, [slices], 2).tiles[5, -7]
    assert tuple(lasting[:, 0, 0].tolist()) == left
    assert lasting[:, 0, 1].tolist() == [1, 0]
    assert np.array_equal(grid.tiles[5, -7], before)
    assert keep_lasting(grid, [slices], None) is grid


def test_slices_of_all_builds_count_once() -> None:
    grid, slices = observe([(9, 5, 1, 1), (0, 1, 0, 1)])
    for later, left in ((0, [0, 5]), (1, [0, 5]), (2, [9, 0])):
        other = replace(slices, numbers=slices.numbers + later)
        assert keep_lasting(grid, [slices, other], 2).tiles[5, -7][:, 0, 0].tolist() == left


def test_nothing_left_is_no_map() -> None:
    grid, slices = observe([(9, 0, 1, 1)])
    with pytest.raises(MapError, match=r"no cell was hit on 2 visits, .*; give a smaller `min_p"):
        open_map(hold(grid, slices), parse_model("simple"), RenderOptions(min_passes=2))
