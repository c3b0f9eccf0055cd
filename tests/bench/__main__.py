"""Measure occmap: `python -m tests.bench [--quick] [--engine] [--json FILE]`.

Every timed pair is run in turn within one run, and a ratio is the median of the ratios of the
rounds. Beside it stands the ratio of the shortest times, for machines that others use too.

The engine's figures are processor time of one thread; all others are time on the clock. The timed
part of occmap's engine is what the yardsticks do too: from ranges and poses (x, y, yaw) to counts.
It includes allocating windows and folding them into tiles, and the last fold is spread over all
scans. The yardsticks allocate their arrays in their time as well, but they are told the map's
extent beforehand and check no bounds.

The engine is measured twice: with all instructions of this processor, and by a process of its own
with those that nearly all processors have (AVX2), since limits must hold on both.
"""

import argparse
import gzip
import json
import os
import platform
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numba

from tests.bench import limits, process_limits, tables
from tests.bench.clouds import measure_clouds
from tests.bench.engine import Figure, check_equal, measure_engine
from tests.bench.logs import FORMATS, write_mcap
from tests.bench.measuring import Times
from tests.bench.stages import Stages, measure_stages
from tests.bench.workloads import Sensor, Workload, make_office, make_yard, read_workload
from tests.bench.yardstick import AVX2, FLAGS, Trace, compile_cpp, trace_in_numba

ROOT = Path(__file__).parents[2]
REAL_LOGS = Path(os.environ.get("OCCMAP_REAL_LOGS", ROOT.parent / "shared" / "logs"))
FREIBURG = REAL_LOGS / "carmen" / "freiburg-079-corrected.log.gz"
SHARE = 20
"""Every n-th scan is compared cell by cell."""
WIDE = Sensor.spanning(1081, 270, 30.0)


@dataclass(frozen=True)
class Settings:
    """How much to measure."""

    scans: int
    rounds: int
    corridor: float
    """m"""


FULL = Settings(scans=2000, rounds=5, corridor=10_000)
QUICK = Settings(scans=500, rounds=5, corridor=1_000)


@dataclass
class Results:
    """All that was measured."""

    settings: Settings
    machine: dict[str, Any]
    engine: dict[str, list[Figure]] = field(default_factory=dict)
    stages: dict[str, Stages] = field(default_factory=dict)
    rows: list[limits.Row] = field(default_factory=list)

    def to_json(self) -> str:
        """Everything, for programs."""
        verdicts = [{**asdict(row), "verdict": row.verdict} for row in self.rows]
        return json.dumps({**asdict(self), "rows": verdicts}, indent=2) + "\n"


class Bench:
    """Measures one thing after the other and shows each as it is done."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        self._settings = settings
        self._folder = folder
        self._yardsticks: dict[str, Trace] = {**compile_cpp(folder), "numba": trace_in_numba}
        self.results = Results(settings, describe_machine())

    def run(self) -> Results:
        """Measure everything."""
        few = make_office("office, 1081 beams", WIDE, self._settings.scans)
        self._measure_engines(few)
        self.results.rows += self._measure_avx2()
        self._measure_stages(few)
        self._measure_texts(few)
        self._measure_many(few)
        self._measure_processes()
        self.results.rows += measure_clouds(self._folder, self._settings.rounds)
        show(tables.draw_rows(self.results.rows))
        return self.results

    def run_engine(self) -> Results:
        """Measure the engine alone."""
        self._measure_engines(make_office("office, 1081 beams", WIDE, self._settings.scans))
        return self.results

    def _measure_avx2(self) -> list[limits.Row]:
        """Measure the engine once more as for a processor that knows nothing beyond AVX2."""
        if platform.machine() not in ("x86_64", "AMD64"):
            return []
        found = self._folder / "avx2.json"
        words = [sys.executable, "-m", "tests.bench", "--engine", "--json", str(found)]
        words += ["--quick"] if self._settings == QUICK else []
        show("\nwith AVX2 alone:\n")
        subprocess.run(words, check=True, env=os.environ | {"NUMBA_CPU_NAME": AVX2})
        names = [each.name for each in fields(limits.Row)]
        rows = json.loads(found.read_text(encoding="utf-8"))["rows"]
        made = [limits.Row(**{name: row[name] for name in names}) for row in rows]
        return [replace(row, what=f"{row.what} (AVX2)") for row in made]

    def _measure_engines(self, office: Workload) -> None:
        """Trace every workload."""
        times = self._measure_engine(office)
        self.results.rows += limits.compare_engine(times, office.scans)
        self.results.rows.append(limits.compare_updates(times, office.scans, "office"))
        scans = self._settings.scans
        few = make_office("office, 360 beams", Sensor.spanning(360, 360, 30.0), scans)
        yard = make_yard("yard, 80 m range", Sensor.spanning(180, 180, 80.0), scans)
        others = (
            (few, limits.FEW_BEAMS_LIMITS),
            (yard, limits.YARD_LIMITS),
            (make_large_place(), limits.SPARSE_LIMITS),
        )
        for workload, engine_limits in others:
            times = self._measure_engine(workload)
            self.results.rows += limits.compare_workload(times, workload, engine_limits)
        if FREIBURG.exists():
            freiburg = read_workload(FREIBURG, 0.05)
            times = self._measure_engine(freiburg)
            row = limits.compare_updates(times, freiburg.scans, freiburg.name)
            self.results.rows.append(row)
        else:
            show(f"\n{FREIBURG.name} is absent from {REAL_LOGS}: not measured\n")

    def _measure_engine(self, workload: Workload) -> Times:
        check_equal(workload.thin(SHARE), self._yardsticks)
        figures, times = measure_engine(workload, self._yardsticks, self._settings.rounds)
        self.results.engine[workload.name] = figures
        show(tables.draw_engine(workload, figures))
        return times

    def _measure_stages(self, office: Workload) -> None:
        self.results.stages = measure_stages(office, self._folder, self._settings.rounds)
        show(tables.draw_stages(office.scans, self.results.stages))

    def _measure_texts(self, office: Workload) -> None:
        rounds, rows = 2 * self._settings.rounds, self.results.rows
        for name in ("CSV", "CARMEN"):
            log = FORMATS[name](office, self._folder)
            rows.append(limits.compare_loadtxt(log, name, 0.4, rounds))
        if FREIBURG.exists():
            log = self._folder / "freiburg-079.log"
            log.write_bytes(gzip.decompress(FREIBURG.read_bytes()))
            rows.append(limits.compare_loadtxt(log, "freiburg-079 as plain text", 0.4, rounds))

    def _measure_many(self, few: Workload) -> None:
        """What needs ten times the scans."""
        rounds = self._settings.rounds
        many = make_office("office", WIDE, 10 * few.scans)
        self.results.rows += limits.compare_threads(many, 2 * rounds)
        folder = self._folder / "tenfold"
        folder.mkdir()
        logs = {workload.scans: write_mcap(workload, folder) for workload in (few, many)}
        self.results.rows += limits.compare_builds(logs[many.scans], rounds)
        self.results.rows += limits.compare_tenfold_time(logs, rounds)
        self.results.rows += process_limits.compare_tenfold_memory(logs, rounds)
        self.results.rows += process_limits.compare_slices(logs[many.scans], rounds)

    def _measure_processes(self) -> None:
        rounds, folder = self._settings.rounds, self._folder
        self.results.rows += process_limits.compare_mrpt(FREIBURG, folder, 2 * rounds)
        self.results.rows += process_limits.measure_corridor(self._settings.corridor, folder)
        self.results.rows += process_limits.measure_field(folder)
        self.results.rows += process_limits.compare_help(2 * rounds)
        self.results.rows += process_limits.measure_smallest(folder, rounds)
        self.results.rows += process_limits.measure_writing(make_large_place(), folder, rounds)


def make_large_place() -> Workload:
    """A place of 9 million cells, of which few beams cross each."""
    return make_yard("861 scans of a yard", Sensor.spanning(181, 180, 50.0), 861, 0.05)


def describe_machine() -> dict[str, Any]:
    """What the figures depend on."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "load before": os.getloadavg(),
        "python": platform.python_version(),
        "numba": numba.__version__,
        "g++": {name: " ".join(flags) for name, flags in FLAGS.items()},
    }


def show(text: str) -> None:
    """Print a result as soon as it is there."""
    sys.stdout.write(text)
    sys.stdout.flush()


def main() -> None:
    """Measure, show tables, and write JSON where asked to."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description="Measure occmap.")
    parser.add_argument("--quick", action="store_const", const=QUICK, default=FULL, dest="settings")
    parser.add_argument("--engine", action="store_true", help="the engine alone, and once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(arguments.settings, Path(folder))
        results = bench.run_engine() if arguments.engine else bench.run()
    if arguments.json:
        arguments.json.write_text(results.to_json(), encoding="utf-8")


if __name__ == "__main__":
    main()
