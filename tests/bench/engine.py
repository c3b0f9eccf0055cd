"""The engine against the yardsticks: microseconds a scan, cells a second, and equal counts."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np

from occmap.grid.tiles import EvidenceKind, TileGrid
from occmap.options import BuildOptions
from occmap.scans import make_engine
from occmap.sensor import ReturnOptions, interpret
from occmap.sensor.models import QuadraticModel, SensorModel, SimpleModel
from occmap.threads import Threads
from occmap.types import BEAM_UPDATES, PosedScans, Update
from tests.bench.measuring import Times, time_in_turn
from tests.bench.workloads import Workload
from tests.bench.yardstick import Trace, find_box

COUNTS = SimpleModel()
MODELS: Mapping[str, SensorModel] = {"simple, counting": COUNTS, "quadratic": QuadraticModel()}
COMBINATIONS = {
    f"{update.value} x {name}": (update, model)
    for name, model in MODELS.items()
    for update in BEAM_UPDATES
}
"""The models simple and counting share their evidence; they differ in what is made of it."""


class DisagreementError(Exception):
    """occmap and a yardstick do not count the same, so their times cannot be compared."""


@dataclass(frozen=True)
class Figure:
    """What one way to trace a workload costs."""

    name: str
    microseconds: float
    """A scan"""
    cells_per_second: float
    """A cell counts as often as it was observed"""


def trace(workload: Workload, update: Update, model: SensorModel, jobs: int = 1) -> TileGrid:
    """What is timed of occmap: poses to matrices, ranges to rays, rays to evidence in tiles."""
    # Ends where they were measured: the yardsticks have them there.
    options = BuildOptions(workload.resolution, update, model, hit_offset=0.0)
    engine = make_engine(options)

    def add(posed: PosedScans) -> None:
        rays, _ = interpret(posed, ReturnOptions())
        engine.add(rays)

    with Threads(add, jobs) as threads:
        for posed in workload.pose_scans():
            threads.give(posed)
    return engine.finish()


def measure_engine(
    workload: Workload, yardsticks: Mapping[str, Trace]
) -> tuple[list[Figure], Times]:
    """Take the processor time of the yardsticks and of every update x model, in turn."""
    box = find_box(workload)
    runs = {name: partial(yardstick, workload, box) for name, yardstick in yardsticks.items()}
    traces = {
        name: partial(trace, workload, update, model)
        for name, (update, model) in COMBINATIONS.items()
    }
    times = time_in_turn({**runs, **traces}, clock=process_time)
    visited: dict[str, float] = {
        name: sum(int(layer.sum(dtype=np.int64)) for layer in run()) for name, run in runs.items()
    }
    for name, run in traces.items():
        visited[name] = count_observations(run())
    figures = [
        Figure(name, 1e6 * times.median(name) / workload.scans, cells / times.median(name))
        for name, cells in visited.items()
    ]
    return figures, times


def count_observations(evidence: TileGrid) -> float:
    """How often all cells together were observed."""
    counts = evidence.kind is EvidenceKind.COUNTS
    tiles = evidence.tiles.values()
    return sum(float((tile if counts else tile[1]).sum()) for tile in tiles) / evidence.unit


def check_equal(workload: Workload, yardsticks: Mapping[str, Trace]) -> None:
    """Compare the counts of occmap's beam update with every yardstick's, cell by cell.

    Raises
    ------
    DisagreementError
        Saying how many cells differ.
    """
    box = find_box(workload)
    evidence = trace(workload, Update.BEAM, COUNTS)
    expected = evidence.gather(box)
    for name, yardstick in yardsticks.items():
        counts = zip(("hits", "misses"), expected, yardstick(workload, box), strict=True)
        for what, mine, its in counts:
            differing = int(np.count_nonzero(mine != its))
            if differing:
                raise DisagreementError(f"{workload.name}: {what} of {differing} cells, {name}")
