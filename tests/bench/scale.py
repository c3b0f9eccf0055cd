"""What a build by many workers costs beside one by a single process: `make bench-scale`."""

import os
import resource
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from distributed import Client, LocalCluster

from occmap.fleet import Fleet
from occmap.fleet.storing import build_store
from occmap.observing import ignore_progress
from occmap.options import BuildOptions
from occmap.store.layout import import_zarr
from tests.bench.limits import Row
from tests.bench.logs import write_mcap
from tests.bench.processes import OCCMAP, run
from tests.bench.tables import draw_rows
from tests.bench.workloads import Sensor, make_office

LOGS, SCANS, BEAMS = 10, 1500, 541
SENSOR = Sensor.spanning(BEAMS, 270, 30.0)
APART = np.array([60.0, 0.0, 0.0])
"""Metres between two offices that lie beside each other"""
SLICE = 8_000_000
MEMORY = "1GB"
OPTIONS = BuildOptions(jobs=1)


class Cost(NamedTuple):
    """What workers needed."""

    seconds: float
    processor_seconds: float
    """Of workers and driver"""
    worker_bytes: int
    """Of memory that a worker took at most"""


def write_fleet(folder: Path, offices: int) -> list[Path]:
    """Write logs of drives through offices that lie beside each other."""
    office, paths = make_office("office", SENSOR, SCANS), []
    for number in range(LOGS):
        place = folder / f"{offices}-{number}"
        place.mkdir()
        shifted = replace(office, poses=office.poses + APART * (number % offices))
        paths.append(write_mcap(shifted, place))
    return paths


def measure_process() -> tuple[float, int]:
    """Processor time of this process (s), and its peak of memory (bytes)."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss << 10


@contextmanager
def start_workers(number: int) -> Iterator[tuple[Client, str]]:
    """Start workers that have loaded all that they need."""
    with (
        LocalCluster(
            n_workers=number,
            threads_per_worker=1,
            memory_limit=MEMORY,
            dashboard_address=":0",
            config={"distributed.worker.profile.enabled": False},
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client, cluster.scheduler_address


def build_by(workers: int, logs: Sequence[Path], output: Path) -> Cost:
    """Build a store by new workers, and say what it cost."""
    with start_workers(workers) as (client, address):
        fleet = Fleet(address, output.with_suffix(".scratch"), SLICE)
        build_store(fleet, logs[:4], OPTIONS, output.with_suffix(".warm.zarr"), ignore_progress)
        before = sum(seconds for seconds, _ in client.run(measure_process).values())
        start, own = perf_counter(), measure_process()[0]
        build_store(fleet, logs, OPTIONS, output, ignore_progress)
        seconds = perf_counter() - start
        after = list(client.run(measure_process).values())
        spent = sum(each for each, _ in after) - before + measure_process()[0] - own
        peak = max(each for _, each in after)
        return Cost(seconds, spent, peak)


def measure_size(path: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(each.stat().st_size for each in path.rglob("*") if each.is_file())


def measure(folder: Path) -> list[Row]:
    """Measure all that has a limit."""
    small, large = write_fleet(folder, 1), write_fleet(folder, 10)
    flags = ["--jobs", "1", "-q"]
    alone = run([OCCMAP, "build", *large, "-o", folder / "alone.zarr", *flags])
    archive = folder / "alone.npz"
    run([OCCMAP, "build", *large, "-o", archive, *flags])
    few = build_by(2, small, folder / "few.zarr")
    two = build_by(2, large, folder / "two.zarr")
    one = build_by(1, large, folder / "one.zarr")
    start = perf_counter()
    levels = import_zarr().open_group(folder / "two.zarr", mode="r")["classes"]
    levels["16"][:]
    overview = perf_counter() - start
    start = perf_counter()
    levels["1"][:]
    whole = perf_counter() - start
    mega = 1e-6
    return [
        Row(
            "processor time, two workers / one process",
            1.5,
            two.processor_seconds / alone.processor_seconds,
            f"{two.processor_seconds:.1f} / {alone.processor_seconds:.1f} s",
        ),
        Row(
            "time, two workers / one",
            0.6,
            two.seconds / one.seconds,
            f"{two.seconds:.1f} / {one.seconds:.1f} s, {os.cpu_count()} cores",
        ),
        Row(
            "a worker's peak of memory, ten times the map",
            1.1,
            two.worker_bytes / few.worker_bytes,
            f"{two.worker_bytes * mega:.0f} / {few.worker_bytes * mega:.0f} MB",
        ),
        Row(
            "store / .npz",
            0.35,
            measure_size(folder / "two.zarr") / archive.stat().st_size,
            f"{measure_size(folder / 'two.zarr') * mega:.1f} / "
            f"{archive.stat().st_size * mega:.1f} MB",
        ),
        Row(
            "an overview picture / one at full resolution",
            0.05,
            overview / whole,
            f"{overview * 1e3:.1f} / {whole * 1e3:.1f} ms",
        ),
    ]


def main() -> None:
    """Measure, and print the figures."""
    with tempfile.TemporaryDirectory() as folder:
        sys.stdout.write(draw_rows(measure(Path(folder))))


if __name__ == "__main__":
    main()
