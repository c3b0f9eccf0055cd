"""One simulated drive: the same map from every format and in any order, and true to its plan."""

from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Decision, OccupancyMap
from occmap.options import BuildOptions, choose_model
from occmap.pipeline import build
from occmap.scans import stream, tracing
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import parse_model
from occmap.types import BEAM_UPDATES, Bool, Update
from tests.map_loaders import load_nav2
from tests.samples import DRIVES, SAMPLE_LOGS

COMBINATIONS = list(product(BEAM_UPDATES, ["simple", "quadratic", "counting"]))
each_combination = pytest.mark.parametrize(("update", "model"), COMBINATIONS)


def choose(update: Update, model: str, jobs: int = 1) -> BuildOptions:
    return BuildOptions(update=update, model=parse_model(model), jobs=jobs)


def write_map(folder: Path, logs: list[Path], options: BuildOptions) -> bytes:
    """Return the bytes of the PGM, of its YAML and of the log-odds, which hide no difference.

    Of the YAML the last line names the logs.
    """
    grid = build(logs, options, [folder / "map.pgm"]).map
    *lines, of_logs = (folder / "map.yaml").read_bytes().splitlines()
    assert of_logs.startswith(b"# logs: ")
    files = [(folder / "map.pgm").read_bytes(), *lines]
    return b"".join([*files, grid.log_odds.tobytes()])


@each_combination
def test_five_formats_give_one_map(tmp_path: Path, update: Update, model: str) -> None:
    maps = {write_map(tmp_path, [log], choose(update, model)) for log in DRIVES}
    assert len(maps) == 1


def grow(cells: Bool) -> Bool:
    """Add the eight neighbours of every cell."""
    rows, cols = cells.shape
    padded = np.pad(cells, 1)
    shifted = [padded[r : r + rows, c : c + cols] for r in range(3) for c in range(3)]
    grown: Bool = np.logical_or.reduce(shifted)
    return grown


def crop_to_plan(grid: OccupancyMap, cells: Bool) -> Bool:
    """Cut out what the floor plan shows: 16 by 12 m from (-4, -3)."""
    row, col = round((-3 - grid.origin[1]) / 0.05), round((-4 - grid.origin[0]) / 0.05)
    return cells[row : row + 240, col : col + 320]


PLAIN = {"simple": "simple:spread=0", "counting": "counting:spread=0,ceiling=1,doubt=0"}
"""Models by which a hit speaks for its own cell alone"""


@pytest.mark.parametrize("no_return", NoReturn)
@pytest.mark.parametrize(
    ("update", "model"), [*COMBINATIONS, *((update, "") for update in BEAM_UPDATES)]
)
def test_the_map_agrees_with_the_floor_plan(
    update: Update, model: str, no_return: NoReturn
) -> None:
    """With a model that is named, beams end where they were measured, and classes are as nav2's
    map_saver has them. As usual, hits are half a cell deeper and speak for the cells beside them,
    so that walls are a cell thicker."""
    plan = load_nav2(SAMPLE_LOGS / "floor_plan.yaml")
    wall, free = plan == 100, plan == 0
    rule = parse_model(PLAIN.get(model, model)) if model else choose_model(update)
    returns, offset = ReturnOptions(no_return=no_return), 0.0 if model else BuildOptions.hit_offset
    options = BuildOptions(update=update, model=rule, returns=returns, hit_offset=offset)
    grid = build(DRIVES[:1], options).map
    if model:
        grid = replace(grid, decision=Decision(0.196, 0.65))
    occupied_cells, free_cells = (crop_to_plan(grid, each) for each in (grid.occupied, grid.free))
    # Of the faces 98.9% were hit within a cell; the rest was never in sight.
    assert grow(occupied_cells)[wall].mean() > 0.98
    assert free_cells[free].mean() > 0.97
    assert grow(wall)[occupied_cells].mean() > (0.999 if model else 0.98)
    assert grow(grow(wall))[occupied_cells].mean() > 0.999
    assert free_cells[wall].mean() < 0.002
    assert model or (grid.agreement or 0.0) > 0.9  # poses of a simulated drive are true


@pytest.fixture(params=COMBINATIONS, ids=lambda pair: f"{pair[0]}-{pair[1]}", scope="module")
def reference(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Update, str, bytes]:
    """Build two logs one after the other, in one thread."""
    update, model = request.param
    folder = tmp_path_factory.mktemp("reference")
    return update, model, write_map(folder, DRIVES[:2], choose(update, model))


@pytest.mark.parametrize(
    ("jobs", "backwards", "beams", "window"),
    [
        (1, True, 1 << 18, 0),
        (2, False, 1 << 18, 0),
        (5, False, 1 << 18, 0),
        (1, False, 5000, 0),
        (1, False, 1 << 20, 0),
        (1, False, 1 << 18, 20_000),
    ],
    ids=["order", "2 threads", "5 threads", "small batches", "large batches", "small windows"],
)
def test_the_way_it_is_made_changes_nothing(
    tmp_path: Path,
    reference: tuple[Update, str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    jobs: int,
    backwards: bool,
    beams: int,
    window: int,
) -> None:
    update, model, expected = reference
    monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
    if window:
        monkeypatch.setattr(
            tracing, "choose_engine", partial(tracing.choose_engine, window_cells=window)
        )
    logs = DRIVES[1::-1] if backwards else DRIVES[:2]
    assert write_map(tmp_path, logs, choose(update, model, jobs)) == expected
