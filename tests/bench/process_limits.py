"""What occmap must reach, as ratios within one run: the rows of whole processes."""

import gzip
import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median

from occmap.types import BEAM_UPDATES, Update
from tests.bench.limits import Row, compare, divide
from tests.bench.logs import write_mcap
from tests.bench.measuring import ROUNDS, Times, take_in_turn
from tests.bench.processes import OCCMAP, Command, build_command, measure_size, run
from tests.bench.workloads import Sensor, Workload, make_corridor
from tests.samples import DRIVES

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
