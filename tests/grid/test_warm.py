"""Kernels are compiled once, for all logs; where they cannot be kept, once a process."""

import os
import subprocess
import sys
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

KERNELS: list[Any] = [
    project_ends,
    note_beams,
    trace_beams,
    trace_polygons,
    trace_radial_polygons,
    read_tiles,
]
SAMPLE = Path(__file__).parents[2] / "sample_logs" / "drive.mcap"
NOWHERE_TO_KEEP = """
from pathlib import Path
from occmap import jit
jit.list_bases = lambda _: [Path("/dev/null/below a file")]
from occmap.grid.warm import compile_kernels
compile_kernels()
print("compiled")
"""


@pytest.mark.parametrize("update", Update)
@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_a_build_needs_no_kernel_that_was_not_compiled_before(
    update: Update, model: str, tmp_path: Path
) -> None:
    compile_kernels()
    compiled = [len(kernel.signatures) for kernel in KERNELS]
    assert min(compiled) >= 1
    options = BuildOptions(update=update, model=parse_model(model), jobs=1)
    build([SAMPLE], options, [tmp_path / "m.npz"])
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


def test_kernels_that_cannot_be_kept_work_and_say_so_once() -> None:
    done = subprocess.run(
        [sys.executable, "-c", NOWHERE_TO_KEEP], capture_output=True, text=True, check=True
    )
    assert done.stdout == "compiled\n"
    assert done.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


LOADED = """
import sys
from occmap.cli import run
assert run(["build", "polygon", *sys.argv[1:], "-q"]) == 0
print("numba.np.linalg" in sys.modules)
"""


def test_kept_machine_code_is_loaded_without_preparing_to_compile(tmp_path: Path) -> None:
    maps = [tmp_path / "compiled.pgm", tmp_path / "kept.pgm"]
    prepared = [
        subprocess.run(
            [sys.executable, "-c", LOADED, SAMPLE, "-o", path],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        ).stdout
        for path in maps
    ]
    assert prepared == ["True\n", "False\n"]
    assert maps[0].read_bytes() == maps[1].read_bytes()
