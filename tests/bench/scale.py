"""What a build by many workers costs beside one by a single process: `make bench-scale`."""

import os
import resource
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import dask
import numpy as np
from distributed import Client, LocalCluster

from occmap.fleet import Fleet
from occmap.fleet.cluster import ALLOCATOR
from occmap.fleet.tasks import survey_log, trace_log
from occmap.options import BuildOptions
from occmap.scans import Keep
from occmap.scans.tracing import ignore_progress
from occmap.store import import_zarr
from tests.bench.limits import Row, divide
from tests.bench.logs import write_mcap
from tests.bench.measuring import ROUNDS, time_once
from tests.bench.processes import OCCMAP, measure_size, run
from tests.bench.tables import draw_rows
from tests.bench.workloads import Sensor, make_office

LOGS, SCANS, BEAMS = 40, 1500, 541
FIRST = 4
"""Logs that workers build from before they are measured, so that all is loaded"""
SENSOR = Sensor.spanning(BEAMS, 270, 30.0)
APART = np.array([60.0, 50.0, 0.0])
"""Metres between two offices that lie beside each other in x, and in y"""
ROW = 5
"""Offices that lie beside each other in x"""
MEMORY = "1GB"
OPTIONS = BuildOptions(jobs=1)


class Cost(NamedTuple):
    """What workers needed."""

    start: tuple[float, float]
    """Until they were there, and the processor time of each by then (s)"""
    seconds: float
    processor_seconds: float
    """Of workers, scheduler and driver"""
    worker_bytes: int
    """Of memory that a worker took at most"""
    driver_bytes: int
    """The same for a driver, with all that it loads"""
    passed: tuple[int, int]
    """Bytes of what workers told the driver of some logs, and of the run files of these; nothing
    passes between workers"""


def write_fleet(folder: Path, offices: int) -> list[Path]:
    """Write logs of drives through offices that lie beside each other."""
    office, paths = make_office("office", SENSOR, SCANS), []
    for number in range(LOGS):
        place = folder / f"{offices}-{number}"
        place.mkdir()
        shift = APART * [*divmod(number % offices, ROW)[::-1], 0]
        paths.append(write_mcap(replace(office, poses=office.poses + shift), place))
    return paths


def measure_process() -> tuple[float, int]:
    """Processor time of this process (s), and its peak of memory (bytes)."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss << 10


@contextmanager
def start_workers(number: int) -> Iterator[tuple[Client, str]]:
    """Start workers as `occmap build --dask local` does, each with a limit of memory."""
    with (
        dask.config.set(ALLOCATOR),
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
    start = perf_counter()
    with start_workers(workers) as (client, address):
        started = perf_counter() - start, measure_workers(client)[0] / workers
        fleet = Fleet(address, output.with_suffix(".scratch"))
        passed = measure_shuffle(fleet, logs[:FIRST])
        first = output.with_suffix(".first.zarr")
        fleet.build(logs[:FIRST], OPTIONS, [first], ignore_progress)
        before = measure_workers(client)[0]
        start, own = perf_counter(), measure_process()[0]
        fleet.build(logs, OPTIONS, [output], ignore_progress)
        seconds = perf_counter() - start
        spent, peak = measure_workers(client)
        spent += measure_process()[0] - before - own
        flags = ["--dask", address, "-q"]
        again = run([OCCMAP, "build", *logs, "-o", output.with_suffix(".again.zarr"), *flags])
        return Cost(started, seconds, spent, peak, again.peak_bytes, passed)


def measure_workers(client: Client) -> tuple[float, int]:
    """Processor time of all workers (s), and the highest peak of memory (bytes)."""
    times, peaks = zip(*client.run(measure_process).values(), strict=True)
    return sum(times), max(peaks)


def measure_shuffle(fleet: Fleet, logs: Sequence[Path]) -> tuple[int, int]:
    """Bytes in the stubs of logs, which are what the driver is told, and in their run files."""
    stubs = [f".{task.__name__}" for task in (survey_log, trace_log)]
    with fleet.work(logs, OPTIONS, Keep(slices=True), ignore_progress) as work:
        files = list(work.setting.folder.iterdir())
        told = sum(measure_size(each) for each in files if each.suffix in stubs)
        return told, sum(measure_size(each) for each in files if each.suffix == ".run")


def measure(folder: Path) -> tuple[list[Row], str]:
    """Measure all that has a limit; and say what the start of workers costs, which has none."""
    small, large = write_fleet(folder, 1), write_fleet(folder, 10)
    archive, flags = folder / "alone.npz", ["--jobs", "1", "-q"]
    alone = run([OCCMAP, "build", *large, "-o", folder / "alone.zarr", *flags])
    run([OCCMAP, "build", *large, "-o", archive, *flags])
    few = build_by(2, small, folder / "few.zarr")
    two = build_by(2, large, folder / "two.zarr")
    one = build_by(1, large, folder / "one.zarr")
    levels = import_zarr().open_group(folder / "two.zarr", mode="r")["classes"]
    overview, whole = (
        min(time_once(partial(levels[n].__getitem__, ...)) for _ in range(ROUNDS))
        for n in ("16", "1")
    )
    what_started = (
        f"\nTwo workers are there after {two.start[0]:.1f} s, which takes {two.start[1]:.1f} s of "
        "processor time each; the figures above are without it.\n"
    )
    cores = ", ".join(f"{each.processor_seconds / each.seconds:.1f}" for each in (two, one))
    time = divide("time, two workers / one", 0.6, two.seconds, one.seconds)
    time = replace(time, detail=f"{time.detail}, {cores} of {os.cpu_count()} cores at work")
    peak = "peak of memory, ten times the map"
    work = two.processor_seconds, alone.processor_seconds
    return [
        divide("processor time, two workers / one process", 1.5, *work),
        time,
        divide(f"a worker's {peak}", 1.1, two.worker_bytes, few.worker_bytes, "MB"),
        divide(f"the driver's {peak}", 1.2, two.driver_bytes, few.driver_bytes, "MB"),
        divide("bytes that pass between processes / in run files", 0.01, *two.passed, "MB"),
        divide(
            "store / .npz", 0.35, measure_size(folder / "two.zarr"), measure_size(archive), "MB"
        ),
        divide("an overview picture / one at full resolution", 0.05, overview, whole),
    ], what_started


def main() -> None:
    """Measure, and print the figures."""
    with tempfile.TemporaryDirectory() as folder:
        rows, what_started = measure(Path(folder))
        sys.stdout.write(draw_rows(rows) + what_started)


if __name__ == "__main__":
    main()
