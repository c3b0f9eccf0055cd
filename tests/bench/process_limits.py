"""What occmap must reach, as ratios within one run: the rows of whole processes."""

import json
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from occmap.types import BEAM_UPDATES, Update
from tests.bench.foreign import Mrpt
from tests.bench.limits import Row, compare, divide
from tests.bench.logs import write_mcap
from tests.bench.measuring import take_in_turn
from tests.bench.processes import OCCMAP, Usage, build_command, run, time_process, time_processor
from tests.bench.workloads import Sensor, Workload, make_corridor

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"
MRPT_LIMIT = 0.7
BYTES_A_CELL = 16
FIELD = {"length": 1000.0, "spacing": 0.25, "width": 50.0}
"""Metres; at 40 scans a second that is 10 m/s, so 1 s there is what 10 s are at 1 m/s."""
MIB = 2**20


def compare_mrpt(log: Path, folder: Path, rounds: int) -> list[Row]:
    """Warm, on a real log, against MRPT's two programs one after the other."""
    names = {update: f"build {update.value} freiburg-079 / MRPT" for update in BEAM_UPDATES}
    missing = Mrpt.find_missing() if log.exists() else [log.name]
    if missing:
        why = f"absent: {', '.join(missing)}"
        return [Row(name, MRPT_LIMIT, None, why) for name in names.values()]
    timers: dict[str, Callable[[], float]] = {"mrpt": Mrpt(log, folder).build}
    for update in BEAM_UPDATES:
        command = build_command(update, log, folder / "mrpt.pgm", "--resolution", "0.05")
        timers[update.value] = partial(time_process, *command)
    times = take_in_turn(timers, rounds)
    return [
        compare(times, (update.value, "mrpt"), name, MRPT_LIMIT) for update, name in names.items()
    ]


def compare_tenfold_memory(logs: Mapping[int, Path], rounds: int) -> list[Row]:
    """Ten times the scans of the same rooms."""
    few, many = sorted(logs)
    rows = []
    for update in BEAM_UPDATES:
        peaks = {
            scans: median(run_build(update, log).peak_bytes for _ in range(rounds)) / MIB
            for scans, log in logs.items()
        }
        what = f"build {update.value}: peak memory for 10 x the scans"
        rows.append(divide(what, 1.1, peaks[many], peaks[few], "MiB"))
    return rows


def measure_corridor(length: float, folder: Path) -> list[Row]:
    """Peak memory on a long corridor against 16 bytes a cell and the peak of a small build."""
    log = write_mcap(make_corridor(Sensor.spanning(541, 270, 30.0), length, spacing=1.0), folder)
    constant = run_build(Update.POLYGON, find_smallest_sample(), folder).peak_bytes
    what = f"peak memory on {length / 1000:g} km / (16 B x cells + constant)"
    rows = []
    for update in BEAM_UPDATES:
        usage = run_build(update, log)
        cells = count_observed(json.loads(usage.output)["map"])
        rows.append(
            Row(
                f"build {update.value}: {what}",
                2.0,
                usage.peak_bytes / (BYTES_A_CELL * cells + constant),
                f"{usage.peak_bytes / MIB:.0f} MiB for {cells / 1e6:.1f} M cells; "
                f"constant {constant / MIB:.0f} MiB: a build of the smallest sample log",
            )
        )
    return rows


def count_observed(grid: Mapping[str, Any]) -> int:
    """How many cells of a reported map are not unknown."""
    columns, rows, unknown = (float(grid[name]) for name in ("columns", "rows", "unknown"))
    return round(columns * rows * (1 - unknown))


def compare_slices(log: Path, rounds: int) -> list[Row]:
    """Processor time of evidence, which keeps slices of time, against that of a picture."""
    rows = []
    for update in BEAM_UPDATES:
        timers = {
            suffix: partial(
                time_processor, *build_command(update, log, log.with_suffix(f".{suffix}"))
            )
            for suffix in ("npz", "pgm")
        }
        times = take_in_turn(timers, rounds)
        what = f"build {update.value} -o map.npz / -o map.pgm, processor time"
        rows.append(compare(times, ("npz", "pgm"), what, 1.5))
    return rows


def measure_field(folder: Path) -> list[Row]:
    """Peak memory of a build that keeps slices of time, on a field that is seen once."""
    log = write_mcap(make_corridor(Sensor.spanning(541, 270, 30.0), **FIELD), folder)
    rows = []
    for update in BEAM_UPDATES:
        usage = run(build_command(update, log, folder / "field.npz", "--pass-gap", "1"))
        cells = count_observed(json.loads(usage.output)["map"])
        what = f"build {update.value} -o map.npz: bytes of peak memory for a cell of a field"
        detail = f"{usage.peak_bytes / MIB:.0f} MiB for {cells / 1e6:.1f} M cells"
        rows.append(Row(what, 48.0, usage.peak_bytes / cells, detail))
    return rows


def compare_help(rounds: int) -> list[Row]:
    """The start-up of the command against the import of click."""
    timers = {
        "help": partial(time_process, OCCMAP, "--help"),
        "click": partial(time_process, sys.executable, "-c", "import click"),
    }
    times = take_in_turn(timers, rounds)
    return [compare(times, ("help", "click"), "occmap --help / import click", 1.5)]


def measure_smallest(folder: Path, rounds: int) -> list[Row]:
    """Seconds of a build that is mostly start-up, and where they go."""
    log = find_smallest_sample()
    command = build_command(Update.POLYGON, log, folder / "process.pgm")
    timers = {
        "build": partial(time_process, *command),
        "python": partial(time_process, sys.executable, "-c", "pass"),
        "numpy": partial(time_process, sys.executable, "-c", "import numpy"),
    }
    times = take_in_turn(timers, rounds)
    python = times.median("python")
    stages = json.loads(run(command).output)["seconds"]
    longest = ", ".join(f"{stage} {s:.3f}" for stage, s in stages.items() if s >= 0.005)
    detail = (
        f"python {python:.3f}, import numpy {times.median('numpy') - python:.3f}, "
        f"stages {sum(stages.values()):.3f} ({longest})"
    )
    return [Row(f"build {log.name}, seconds", 1.0, times.median("build"), detail)]


def measure_writing(workload: Workload, folder: Path, rounds: int) -> list[Row]:
    """The write stage of a large map, a PNG beside the PGM, with all that it loads (s)."""
    log, image = write_mcap(workload, folder), folder / "large.pgm"
    command = build_command(Update.BEAM, log, image, "-o", str(image.with_suffix(".png")))
    reports = [json.loads(run(command).output) for _ in range(rounds)]
    seconds = [report["seconds"]["write"] for report in reports]
    cells = reports[0]["map"]["columns"] * reports[0]["map"]["rows"]
    detail = f"{cells / 1e6:.1f} M cells, shortest: {min(seconds):.2f}"
    return [Row(f"{workload.name}: write PGM and PNG, seconds", 0.3, median(seconds), detail)]


def find_smallest_sample() -> Path:
    """The sample log of the fewest bytes."""
    logs = [path for path in SAMPLE_LOGS.glob("drive*") if path.suffix != ".py"]
    return min(logs, key=measure_size)


def measure_size(path: Path) -> int:
    """Bytes of a file, or of the files in a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def run_build(update: Update, log: Path, folder: Path | None = None) -> Usage:
    """Build a map in a process of its own, with the default number of threads."""
    return run(build_command(update, log, (folder or log.parent) / "process.pgm"))
