"""Kernels are compiled once, for all logs, and kept for the sources they were made of."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap import jit
from occmap.cli.warm import compile_kernels
from occmap.clouds.kernels import growth, heights, tracing
from occmap.grid.kernels import beams, cast, polygon, projection, radial_polygon
from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.readers import decimals
from occmap.scoring.compare import combine, compare
from occmap.sensor.models import parse_model
from occmap.types import BEAM_UPDATES, Update
from tests.csv_logs import write_poses, write_scans
from tests.samples import SAMPLE_LOGS

HALL = SAMPLE_LOGS / "hall.mcap"
BUILDING = beams, decimals, polygon, projection, radial_polygon


def count_compiled(*modules: Any) -> dict[str, int]:
    """For how many combinations of types each kernel of some modules is compiled."""
    named = [vars(module).values() for module in modules]
    kernels = [each for values in named for each in values if isinstance(each, jit.Kernel)]
    return {kernel.name: len(kernel.loaded) for kernel in kernels}


@pytest.fixture(autouse=True, scope="module")
def compiled_ahead() -> None:
    compile_kernels()


def write_log(folder: Path) -> tuple[Path, Path]:
    """A CSV that states the time between beams, and its poses."""
    shape = {"angle_min": 0, "angle_increment": 0.5, "time_increment": 0.01}
    log = write_scans(folder / "drive.csv", np.arange(9) + 0.5, [[1, 2, 3]] * 9, **shape)
    return log, write_poses(folder / "poses.csv", range(10), [(0, s, 0) for s in range(10)])


@pytest.mark.parametrize("deskew", [Deskew.OFF, Deskew.ON])
@pytest.mark.parametrize("update", BEAM_UPDATES)
@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_a_build_needs_no_kernel_that_was_not_compiled_before(
    update: Update, model: str, deskew: Deskew, tmp_path: Path
) -> None:
    log, poses = write_log(tmp_path)
    compiled = count_compiled(*BUILDING)
    assert sum(compiled.values()) > 5
    posing = PosingOptions(poses=str(poses), deskew=deskew)
    options = BuildOptions(update=update, model=parse_model(model), jobs=1, posing=posing)
    assert build([log], options, [tmp_path / "m.npz"]).report.scans.used == 9
    assert count_compiled(*BUILDING) == compiled


def test_clouds_and_comparisons_need_no_kernel_that_was_not_compiled_before(tmp_path: Path) -> None:
    log, poses = write_log(tmp_path)
    kernels = *BUILDING, heights, growth, tracing, cast
    compiled = count_compiled(*kernels)
    assert compiled["heights.add_histogram"]
    assert compiled["cast.cast_beams"]
    assert inspect([HALL], BuildOptions()).buildable
    assert build([HALL], BuildOptions(jobs=2), [tmp_path / "m.npz"]).report.scans.used > 9
    options = BuildOptions(jobs=1, posing=PosingOptions(poses=str(poses)))
    compare([log], combine([], []), options)
    assert count_compiled(*kernels) == compiled


def test_machine_code_is_kept_for_just_these_sources_and_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    kernels = tmp_path / "kernels"
    kernels.mkdir()
    folders = []
    for text, checks in (("one", "0"), ("one", "0"), ("another", "0"), ("another", "1")):
        (kernels / "called_by_others.py").write_text(text)
        monkeypatch.setenv("NUMBA_BOUNDSCHECK", checks)
        folders.append(jit.list_folders.__wrapped__(kernels)[0])
    assert folders[0] == folders[1]
    assert len({*folders}) == 3
    assert all(folder.parent == tmp_path for folder in folders)
