"""Kernels are compiled once, for all logs, and kept for the sources they were made of."""

from pathlib import Path
from typing import Any

import pytest

from occmap import jit
from occmap.grid.kernels.beams import note_beams, trace_beams
from occmap.grid.kernels.polygon import trace_polygons
from occmap.grid.kernels.project import project_ends
from occmap.grid.kernels.radial_polygon import trace_radial_polygons
from occmap.grid.kernels.sums import read_tiles
from occmap.grid.warm import compile_kernels
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.sensor.models import parse_model
from occmap.types import Update
from tests.samples import SAMPLE_LOGS

KERNELS: list[Any] = [
    project_ends,
    note_beams,
    trace_beams,
    trace_polygons,
    trace_radial_polygons,
    read_tiles,
]


@pytest.mark.parametrize("update", Update)
@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_a_build_needs_no_kernel_that_was_not_compiled_before(
    update: Update, model: str, tmp_path: Path
) -> None:
    compile_kernels()
    compiled = [len(kernel.signatures) for kernel in KERNELS]
    assert min(compiled) >= 1
    options = BuildOptions(update=update, model=parse_model(model), jobs=1)
    build([SAMPLE_LOGS / "drive.mcap"], options, [tmp_path / "m.npz"])
    assert [len(kernel.signatures) for kernel in KERNELS] == compiled


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
