"""Builds whose evidence is saved: of the sample drive, whole and in two halves."""

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from occmap.cells import Evidence, Manifest, Slices
from occmap.grid.tiles import TileGrid
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.sensor.models import parse_model
from occmap.store import Blocks
from occmap.types import BEAM_UPDATES, Update
from occmap.writers.npz import read_evidence, write_evidence
from tests.samples import SAMPLE_LOGS

DRIVE = SAMPLE_LOGS / "drive.csv"
COMBINATIONS = list(product(BEAM_UPDATES, ["counting", "quadratic"]))
"""Each update with each kind of evidence: hits and misses are the same whatever reads them"""
each_combination = pytest.mark.parametrize(("update", "model"), COMBINATIONS)
MIDDLE_S = 20.0005


def choose(update: Update = Update.BEAM, model: str = "simple", jobs: int = 1) -> BuildOptions:
    return BuildOptions(update=update, model=parse_model(model), jobs=jobs)


@cache
def build_once(options: BuildOptions, log: Path) -> bytes:
    """What a build of a sample log saves: many tests ask for the same."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "m.npz"
        build([log], options, [path])
        return path.read_bytes()


def save(path: Path, options: BuildOptions, log: Path = DRIVE) -> Evidence:
    if log.parent == SAMPLE_LOGS:
        path.write_bytes(build_once(options, log))
    else:
        build([log], options, [path])
    return read_evidence(path)


def hold(grid: TileGrid, *slices: Slices) -> Blocks:
    """Evidence of hits and misses in memory."""
    size = grid.lattice.resolution
    manifest = Manifest(size, "beam", "counts", "", 10.0, 0.5, "simple", ())
    return Blocks.of(Evidence(manifest, grid.tiles, slices))


def halve(options: BuildOptions, middle: float = MIDDLE_S) -> tuple[BuildOptions, BuildOptions]:
    """Two builds of one log: what comes before a time, and what after."""
    early, late = Selection(end_s=middle), Selection(start_s=middle)
    return replace(options, selection=early), replace(options, selection=late)


def write_bytes(folder: Path, evidence: Evidence) -> bytes:
    path = folder / "written.npz"
    write_evidence(path, evidence)
    return path.read_bytes()
