"""How long each stage of a build takes, for the same drive in every format."""

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.types import Update
from tests.bench.logs import FORMATS
from tests.bench.measuring import ROUNDS
from tests.bench.workloads import Workload

WHOLE = "whole"
READING = ("open", "poses", "read")
"""Which of these a format reads its file in is its own affair."""

Stages = Mapping[str, float]
"""Seconds by stage."""


def measure_stages(workload: Workload, folder: Path) -> dict[str, Stages]:
    """Build from every format with one thread, the polygon update, and a PGM and a PNG."""
    logs = {name: write(workload, folder) for name, write in FORMATS.items()}
    found: dict[str, list[Stages]] = {name: [] for name in logs}
    for _ in range(ROUNDS):
        for name, log in logs.items():
            found[name].append(time_build(log, folder))
    return {name: take_shortest(builds) for name, builds in found.items()}


def time_build(log: Path, folder: Path) -> Stages:
    """Build once."""
    options = BuildOptions(update=Update.POLYGON, jobs=1)
    start = perf_counter()
    report = build([log], options, [folder / "map.pgm", folder / "map.png"]).report
    whole = perf_counter() - start
    reading = sum(report.seconds.get(stage, 0.0) for stage in READING)
    others = {stage: s for stage, s in report.seconds.items() if stage not in READING}
    return {"read": reading, **others, WHOLE: whole}


def take_shortest(builds: list[Stages]) -> Stages:
    """Each stage where it went best: no ratio is made of these."""
    return {stage: min(build[stage] for build in builds) for stage in builds[0]}
