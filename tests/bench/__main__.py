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
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numba

from tests.bench import limits, tables
from tests.bench.clouds import measure_clouds
from tests.bench.engine import Figure, check_equal, measure_engine
from tests.bench.logs import FORMATS, Stages, measure_stages, write_mcap
from tests.bench.workloads import Sensor, Workload, make_office, make_yard, read_workload
from tests.bench.yardstick import AVX2, FLAGS, Trace, compile_cpp
from tests.samples import REAL_LOGS

FREIBURG = REAL_LOGS / "carmen" / f"{limits.FREIBURG}.log.gz"
SHARE = 20
"""Every n-th scan is compared cell by cell."""
WIDE = Sensor.spanning(1081, 270, 30.0)
QUICK = 500, 1000.0
"""Scans, and metres of a corridor"""


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


@dataclass
class Bench:
    """Measures one thing after the other, shows each as it is done, and holds all figures."""

    folder: Path
    scans: int = 2000
    corridor: float = 10_000
    """m"""
    machine: dict[str, Any] = field(default_factory=describe_machine)
    engine: dict[str, list[Figure]] = field(default_factory=dict)
    stages: dict[str, Stages] = field(default_factory=dict)
    rows: list[limits.Row] = field(default_factory=list)

    def to_json(self) -> str:
        """Everything, for programs."""
        verdicts = [{**asdict(row), "verdict": row.verdict} for row in self.rows]
        return json.dumps({**asdict(self), "rows": verdicts}, indent=2, default=str) + "\n"

    @cached_property
    def yardsticks(self) -> dict[str, Trace]:
        """What the engine is held against."""
        return compile_cpp(self.folder)

    def run(self) -> None:
        """Measure everything."""
        self.run_engine()
        self._measure_avx2()
        few = make_office(limits.OFFICE, WIDE, self.scans)
        self.stages = measure_stages(few, self.folder)
        show(tables.draw_stages(few.scans, self.stages))
        self._measure_texts(few)
        self._measure_many(few)
        self.rows += [
            *limits.compare_mrpt(FREIBURG, self.folder),
            *limits.measure_corridor(self.corridor, self.folder),
            *limits.measure_field(self.folder),
            limits.compare_help(),
            limits.measure_smallest(self.folder),
            limits.measure_writing(make_large_place(), self.folder),
            *measure_clouds(self.folder),
        ]
        show(tables.draw_rows(self.rows))

    def run_engine(self) -> None:
        """Trace every workload."""
        few_beams, long = Sensor.spanning(360, 360, 30.0), Sensor.spanning(180, 180, 80.0)
        self._measure_engine(make_office(limits.OFFICE, WIDE, self.scans))
        self._measure_engine(make_office("office, 360 beams", few_beams, self.scans))
        self._measure_engine(make_yard("yard, 80 m range", long, self.scans))
        self._measure_engine(make_large_place())
        if FREIBURG.exists():
            self._measure_engine(read_workload(FREIBURG, 0.05))
        else:
            show(f"\n{FREIBURG.name} is absent from {REAL_LOGS}: not measured\n")

    def _measure_engine(self, workload: Workload) -> None:
        check_equal(workload.thin(SHARE), self.yardsticks)
        figures, times = measure_engine(workload, self.yardsticks)
        self.engine[workload.name] = figures
        self.rows += limits.compare_engine(times, workload)
        show(tables.draw_engine(workload, figures))

    def _measure_avx2(self) -> None:
        """Measure the engine once more as for a processor that knows nothing beyond AVX2."""
        if platform.machine() not in ("x86_64", "AMD64"):
            return
        found = self.folder / "avx2.json"
        words = [sys.executable, "-m", "tests.bench", "--engine", "--json", str(found)]
        words += ["--quick"] if self.scans == QUICK[0] else []
        show("\nwith AVX2 alone:\n")
        subprocess.run(words, check=True, env=os.environ | {"NUMBA_CPU_NAME": AVX2})
        rows = json.loads(found.read_text(encoding="utf-8"))["rows"]
        self.rows += [
            limits.Row(f"{row['what']} (AVX2)", row["limit"], row["value"], row["detail"])
            for row in rows
        ]

    def _measure_texts(self, office: Workload) -> None:
        logs = {name: FORMATS[name](office, self.folder) for name in ("CSV", "CARMEN")}
        if FREIBURG.exists():
            plain = logs["freiburg-079 as plain text"] = self.folder / "freiburg-079.log"
            plain.write_bytes(gzip.decompress(FREIBURG.read_bytes()))
        self.rows += [limits.compare_loadtxt(log, name) for name, log in logs.items()]

    def _measure_many(self, few: Workload) -> None:
        """What needs ten times the scans."""
        many, folder = make_office("office", WIDE, 10 * few.scans), self.folder / "tenfold"
        folder.mkdir()
        logs = {workload.scans: write_mcap(workload, folder) for workload in (few, many)}
        self.rows += [
            *limits.compare_builds(logs[many.scans]),
            *limits.compare_tenfold_time(logs),
            *limits.compare_tenfold_memory(logs),
            *limits.compare_slices(logs[many.scans]),
        ]


def make_large_place() -> Workload:
    """A place of 9 million cells, of which few beams cross each."""
    return make_yard("861 scans of a yard", Sensor.spanning(181, 180, 50.0), 861, 0.05)


def show(text: str) -> None:
    """Print a result as soon as it is there."""
    sys.stdout.write(text)
    sys.stdout.flush()


def main() -> None:
    """Measure, show tables, and write JSON where asked to."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description="Measure occmap.")
    parser.add_argument("--quick", action="store_true", help="of fewer scans")
    parser.add_argument("--engine", action="store_true", help="the engine alone, and once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), *QUICK if arguments.quick else ())
        (bench.run_engine if arguments.engine else bench.run)()
    if arguments.json:
        arguments.json.write_text(bench.to_json(), encoding="utf-8")


if __name__ == "__main__":
    main()
