"""What occmap must reach, as ratios within one run: the rows that this process measures itself."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import open_log
from occmap.scans.logs import choose_topics
from occmap.types import BEAM_UPDATES, Scan, ScanBatch, Update
from tests.bench.engine import COUNTS, trace
from tests.bench.measuring import ROUNDS, Times, time_in_turn
from tests.bench.workloads import Workload
from tests.bench.yardstick import PLAIN, TUNED

OFFICE, FREIBURG = "office, 1081 beams", "freiburg-079-corrected"
ENGINE_LIMITS = {
    OFFICE: {
        "beam x simple, counting": 0.65,
        "polygon x simple, counting": 0.15,
        "beam x quadratic": 0.7,
        "polygon x quadratic": 1.5,
    },
    # The cost of a scan is its area, while that of the yardstick is its beams.
    "office, 360 beams": {"polygon x quadratic": 1.5},
    "yard, 80 m range": {"polygon x simple, counting": 0.5, "polygon x quadratic": 3.0},
    # Few scans of a large place: what nothing crosses costs nothing.
    "861 scans of a yard": {"beam x simple, counting": 1.0},
}
"""By workload"""
BEAM, SURFACE = "beam x simple, counting", "surface x simple, counting"
SURFACE_LIMITS = {OFFICE: 1.6, FREIBURG: 1.6}
THREADS_LIMIT = 0.6
ROSBAGS_LIMITS = {Update.POLYGON: 1.3, Update.BEAM: 1.6, Update.SURFACE: 1.8}


@dataclass(frozen=True)
class Row:
    """A figure and its limit."""

    what: str
    limit: float
    value: float | None
    """None where it could not be measured"""
    detail: str
    """The numbers behind it, or why there are none"""

    @property
    def verdict(self) -> str:
        """Whether the limit is met."""
        if self.value is None:
            return "not measured"
        return "met" if self.value <= self.limit else "NOT MET"


def compare_engine(times: Times, workload: Workload) -> Iterator[Row]:
    """One thread against the C++ loop; its tuned build has no limit, and is told for what it is.

    The surface update is held against the beam update, whose beams it traces, too.
    """

    def tell(name: str) -> str:
        return f"{1e6 * times.median(name) / workload.scans:.1f}"

    where = "" if workload.name == OFFICE else f", {workload.name}"
    for name, limit in ENGINE_LIMITS.get(workload.name, {}).items():
        what = f"{name} / {PLAIN}{where}"
        if PLAIN in times.seconds:
            tuned = f"/ {TUNED}: {times.ratio(name, TUNED):.2f} ({tell(TUNED)} us)"
            detail = f"{tell(name)} / {tell(PLAIN)} us a scan; {tuned}"
            yield Row(what, limit, times.ratio(name, PLAIN), detail)
        else:
            yield Row(what, limit, None, "no g++")
    if (most := SURFACE_LIMITS.get(workload.name)) is not None:
        what = f"surface / beam, counts, {workload.name.partition(',')[0]}"
        detail = f"{tell(SURFACE)} / {tell(BEAM)} us a scan"
        yield Row(what, most, times.ratio(SURFACE, BEAM), detail)


def compare_threads(workload: Workload) -> Iterator[Row]:
    """Two threads against one: ranges to evidence, without reading."""
    for update in BEAM_UPDATES:
        runs = {str(jobs): partial(trace, workload, update, COUNTS, jobs) for jobs in (2, 1)}
        times = time_in_turn(runs, 2 * ROUNDS)
        what = f"{update.value}: two threads / one, engine only, {workload.scans} scans"
        row = compare(times, ("2", "1"), what, THREADS_LIMIT)
        busy = ", ".join(f"{count_busy_cores(run):.2f}" for run in runs.values())
        yield replace(row, detail=f"{row.detail}; cores at work: {busy}")


def count_busy_cores(run: Callable[[], object]) -> float:
    """Processor time over time: less than the threads where these wait, or others work here too."""
    wall, processor = perf_counter(), process_time()
    run()
    return (process_time() - processor) / (perf_counter() - wall)


def compare_builds(log: Path) -> Iterator[Row]:
    """The whole tool on an MCAP in one process, all loaded before: against rosbags reading it, and
    with two threads against one.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)

    def read_all() -> None:
        with Reader(log.parent) as reader:
            for connection, _, data in reader.messages():
                store.deserialize_cdr(data, connection.msgtype)

    builds = {
        f"{update.value}, {jobs}": make_build(update, log, jobs)
        for update in BEAM_UPDATES
        for jobs in (1, 2)
    }
    times = time_in_turn({"rosbags": read_all, **builds})
    for update, limit in ROSBAGS_LIMITS.items():
        what, two, one = f"build {update.value} MCAP", f"{update.value}, 2", f"{update.value}, 1"
        yield compare(times, (two, "rosbags"), f"{what} / rosbags reads it", limit)
        yield compare(times, (two, one), f"{what}: two threads / one", THREADS_LIMIT)


def compare_loadtxt(log: Path, what: str) -> Row:
    """Open and read a text log, against NumPy reading a table of its ranges alone."""
    table = log.with_suffix(".ranges")
    np.savetxt(table, np.vstack([some.ranges for some in read_all(log)]), fmt="%.6g")
    runs: dict[str, Callable[[], object]] = {
        "read": partial(read_all, log),
        "loadtxt": partial(np.loadtxt, table),
    }
    times = time_in_turn(runs, 2 * ROUNDS)
    return compare(times, ("read", "loadtxt"), f"read {what} / np.loadtxt of its ranges", 0.4)


def read_all(path: Path) -> list[Scan | ScanBatch]:
    """Every scan of a log."""
    log = open_log(path)
    return list(log.stacked_scans(choose_topics(log, [])))


def compare_tenfold_time(logs: Mapping[int, Path]) -> Iterator[Row]:
    """Ten times the scans of the same rooms, in this process."""
    few, many = map(str, sorted(logs))
    for update in BEAM_UPDATES:
        runs = {str(scans): make_build(update, log, 2) for scans, log in logs.items()}
        what = f"build {update.value}: time for 10 x the scans"
        yield compare(time_in_turn(runs), (many, few), what, 10.5)


def make_build(update: Update, log: Path, jobs: int) -> Callable[[], object]:
    """A build in this process, with so many threads."""
    return partial(build, [log], BuildOptions(update=update, jobs=jobs), [log.with_suffix(".pgm")])


def divide(what: str, limit: float, mine: float, its: float, unit: str = "s") -> Row:
    """The ratio of two figures: seconds, or bytes that are told in another unit."""
    size = {"s": 1, "MB": 10**6, "MiB": 2**20}[unit]
    return Row(what, limit, mine / its, f"{mine / size:.4g} / {its / size:.4g} {unit}")


def compare(times: Times, pair: tuple[str, str], what: str, limit: float) -> Row:
    """The ratio of the first of a pair to the second."""
    name, base = pair
    best = times.best_ratio(name, base)
    detail = f"{times.median(name):.3f} / {times.median(base):.3f} s, shortest: {best:.2f}"
    return Row(what, limit, times.ratio(name, base), detail)
