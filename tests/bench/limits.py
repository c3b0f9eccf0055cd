"""What occmap must reach, as ratios within one run: rows of this process, and of whole ones."""

import gzip
import json
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers import open_log
from occmap.scans.logs import choose_topics
from occmap.types import BEAM_UPDATES, Scan, ScanBatch, Update
from tests.bench.logs import write_mcap
from tests.bench.measuring import ROUNDS, Times, take_in_turn, time_in_turn
from tests.bench.processes import OCCMAP, Command, build_command, measure_size, run
from tests.bench.workloads import Sensor, Workload, make_corridor
from tests.bench.yardstick import PLAIN, TUNED
from tests.samples import DRIVES

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


MRPT_LIMIT = 0.7
MRPT_PROGRAMS = ("carmen2simplemap", "observations2map")
"""They make a grid map of a CARMEN log, one after the other"""
MRPT_MAP = Path(__file__).with_name("mrpt.ini")
BYTES_A_CELL = 16
FIELD = {"length": 1000.0, "spacing": 0.25, "width": 50.0}
"""Metres; at 40 scans a second that is 10 m/s, so 1 s there is what 10 s are at 1 m/s."""
MIB = 2**20


def compare_mrpt(log: Path, folder: Path) -> list[Row]:
    """Warm, on a real log, against MRPT's two programs one after the other."""
    names = {update: f"build {update.value} freiburg-079 / MRPT" for update in BEAM_UPDATES}
    missing = [name for name in MRPT_PROGRAMS if shutil.which(name) is None]
    missing = missing if log.exists() else [log.name]
    if missing:
        why = f"absent: {', '.join(missing)}"
        return [Row(name, MRPT_LIMIT, None, why) for name in names.values()]
    flags = ("--resolution", "0.05")
    commands = {
        update.value: [build_command(update, log, folder / "mrpt.pgm", *flags)]
        for update in BEAM_UPDATES
    }
    times = time_commands({**commands, "mrpt": prepare_mrpt(log, folder)}, 2 * ROUNDS)
    return [
        compare(times, (update.value, "mrpt"), name, MRPT_LIMIT) for update, name in names.items()
    ]


def prepare_mrpt(log: Path, folder: Path) -> list[Command]:
    """Both programs as commands, one after the other."""
    plain, between = (folder / f"mrpt.{suffix}" for suffix in ("log", "simplemap"))
    plain.write_bytes(gzip.decompress(log.read_bytes()))  # which it reads here; not in its time
    convert: Command = [MRPT_PROGRAMS[0], "-q", "-w", "-i", plain, "-o", between]
    insert: Command = [MRPT_PROGRAMS[1], MRPT_MAP, between, folder / "mrpt"]
    return [convert, insert]


def time_commands(
    runs: Mapping[str, Sequence[Command]], rounds: int = ROUNDS, measure: str = "seconds"
) -> Times:
    """Run commands in turn, each in a process of its own; those of a name follow each other."""

    def time(commands: Sequence[Command]) -> float:
        return float(sum(getattr(run(command), measure) for command in commands))

    return take_in_turn({name: partial(time, commands) for name, commands in runs.items()}, rounds)


def compare_tenfold_memory(logs: Mapping[int, Path]) -> Iterator[Row]:
    """Ten times the scans of the same rooms."""
    for update in BEAM_UPDATES:
        few, many = (
            median(measure_peak(update, logs[scans]) for _ in range(ROUNDS))
            for scans in sorted(logs)
        )
        what = f"build {update.value}: peak memory for 10 x the scans"
        yield divide(what, 1.1, many, few, "MiB")


def measure_peak(update: Update, log: Path) -> int:
    """Bytes of memory at most that a build in a process of its own takes."""
    return run(build_command(update, log, log.with_name("process.pgm"))).peak_bytes


def measure_corridor(length: float, folder: Path) -> Iterator[Row]:
    """Peak memory on a long corridor against 16 bytes a cell and the peak of a small build."""
    log = write_mcap(make_corridor(Sensor.spanning(541, 270, 30.0), length, spacing=1.0), folder)
    small = build_command(Update.POLYGON, find_smallest_sample(), folder / "process.pgm")
    constant = run(small).peak_bytes
    for update in BEAM_UPDATES:
        peak, cells = measure_cells(build_command(update, log, folder / "process.pgm"))
        what = f"peak memory on {length / 1000:g} km / (16 B x cells + constant)"
        detail = f"{peak / MIB:.0f} MiB for {cells / 1e6:.1f} M cells; constant "
        detail += f"{constant / MIB:.0f} MiB: a build of the smallest sample log"
        ratio = peak / (BYTES_A_CELL * cells + constant)
        yield Row(f"build {update.value}: {what}", 2.0, ratio, detail)


def measure_cells(command: Command) -> tuple[int, int]:
    """Peak memory of a build (bytes), and how many cells of its map are not unknown."""
    usage = run(command)
    grid = json.loads(usage.output)["map"]
    return usage.peak_bytes, round(grid["columns"] * grid["rows"] * (1 - grid["unknown"]))


def compare_slices(log: Path) -> Iterator[Row]:
    """Processor time of evidence, which keeps slices of time, against that of a picture."""
    for update in BEAM_UPDATES:
        commands = {
            suffix: [build_command(update, log, log.with_suffix(f".{suffix}"))]
            for suffix in ("npz", "pgm")
        }
        times = time_commands(commands, measure="processor_seconds")
        what = f"build {update.value} -o map.npz / -o map.pgm, processor time"
        yield compare(times, ("npz", "pgm"), what, 1.5)


def measure_field(folder: Path) -> Iterator[Row]:
    """Peak memory of a build that keeps slices of time, on a field that is seen once."""
    log = write_mcap(make_corridor(Sensor.spanning(541, 270, 30.0), **FIELD), folder)
    for update in BEAM_UPDATES:
        command = build_command(update, log, folder / "field.npz", "--pass-gap", "1")
        peak, cells = measure_cells(command)
        what = f"build {update.value} -o map.npz: bytes of peak memory for a cell of a field"
        detail = f"{peak / MIB:.0f} MiB for {cells / 1e6:.1f} M cells"
        yield Row(what, 48.0, peak / cells, detail)


def compare_help() -> Row:
    """The start-up of the command against the import of click."""
    commands: dict[str, list[Command]] = {
        "help": [[OCCMAP, "--help"]],
        "click": [[sys.executable, "-c", "import click"]],
    }
    times = time_commands(commands, 2 * ROUNDS)
    return compare(times, ("help", "click"), "occmap --help / import click", 1.5)


def measure_smallest(folder: Path) -> Row:
    """Seconds of a build that is mostly start-up, and where they go."""
    log = find_smallest_sample()
    command = build_command(Update.POLYGON, log, folder / "process.pgm")
    commands: dict[str, list[Command]] = {
        "build": [command],
        "python": [[sys.executable, "-c", "pass"]],
        "numpy": [[sys.executable, "-c", "import numpy"]],
    }
    times = time_commands(commands)
    python = times.median("python")
    stages = json.loads(run(command).output)["seconds"]
    longest = ", ".join(f"{stage} {s:.3f}" for stage, s in stages.items() if s >= 0.005)
    detail = (
        f"python {python:.3f}, import numpy {times.median('numpy') - python:.3f}, "
        f"stages {sum(stages.values()):.3f} ({longest})"
    )
    return Row(f"build {log.name}, seconds", 1.0, times.median("build"), detail)


def measure_writing(workload: Workload, folder: Path) -> Row:
    """The write stage of a large map, a PNG beside the PGM, with all that it loads (s)."""
    log, image = write_mcap(workload, folder), folder / "large.pgm"
    command = build_command(Update.BEAM, log, image, "-o", str(image.with_suffix(".png")))
    reports = [json.loads(run(command).output) for _ in range(ROUNDS)]
    seconds = [report["seconds"]["write"] for report in reports]
    cells = reports[0]["map"]["columns"] * reports[0]["map"]["rows"]
    detail = f"{cells / 1e6:.1f} M cells, shortest: {min(seconds):.2f}"
    return Row(f"{workload.name}: write PGM and PNG, seconds", 0.3, median(seconds), detail)


def find_smallest_sample() -> Path:
    """The sample log of the fewest bytes."""
    return min(DRIVES, key=measure_size)
