"""The benchmark measures what it says: right ranges, equal counts, one drive in every log."""

import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import CellBox
from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.bench.__main__ import Bench
from tests.bench.engine import DisagreementError, check_equal
from tests.bench.limits import Row
from tests.bench.logs import FORMATS
from tests.bench.measuring import Times, take_in_turn
from tests.bench.plans import cast_scans
from tests.bench.processes import ProcessError, run
from tests.bench.tables import draw
from tests.bench.workloads import Sensor, Workload, make_corridor, make_office, make_yard
from tests.bench.yardstick import PLAIN, Counts, Trace, compile_cpp, find_box

WIDE = Sensor.spanning(91, 270, 30.0)
ROUND = Sensor.spanning(72, 360, 30.0)
LONG = Sensor.spanning(45, 180, 80.0)
WORKLOADS = [
    make_office("wide", WIDE, 12),
    make_office("round", ROUND, 12),
    make_yard("long", LONG, 12),
]


def test_rays_end_on_the_nearest_box() -> None:
    boxes = np.array([(2.0, -1, 3, 1), (4, -9, 5, 9), (-9, 3, 9, 4)])
    poses = np.array([(0.0, 0, 0), (0, 0, math.pi / 2), (1, 2, 0)])
    ranges = cast_scans(poses, np.radians([0.0, 45.0, -90.0]), boxes)
    expected = [(2, 3 * math.sqrt(2), np.inf), (3, 3 * math.sqrt(2), 2), (3, math.sqrt(2), np.inf)]
    assert ranges == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("workload", WORKLOADS, ids=lambda workload: workload.name)
def test_generated_scans_are_the_same_in_every_run_and_clear_of_walls(workload: Workload) -> None:
    make = make_yard if workload.name == "long" else make_office
    again = make(workload.name, workload.sensor, workload.scans)
    assert np.array_equal(again.ranges, workload.ranges)
    assert np.array_equal(again.poses, workload.poses)
    assert workload.ranges.min() > 0.2
    assert np.isfinite(workload.ranges).mean() > 0.7


@pytest.fixture(scope="module")
def yardsticks(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Trace]:
    return compile_cpp(tmp_path_factory.mktemp("cpp")) or pytest.skip("no g++ here")


@pytest.mark.parametrize("workload", WORKLOADS, ids=lambda workload: workload.name)
def test_the_yardsticks_count_as_occmap_does(
    workload: Workload, yardsticks: Mapping[str, Trace]
) -> None:
    check_equal(workload, yardsticks)


def test_a_yardstick_that_counts_otherwise_is_found_out(yardsticks: Mapping[str, Trace]) -> None:
    def trace_wrongly(workload: Workload, box: CellBox) -> tuple[Counts, Counts]:
        hits, misses = yardsticks[PLAIN](workload, box)
        misses[np.nonzero(misses)[0][0], np.nonzero(misses)[1][0]] += 1
        return hits, misses

    with pytest.raises(DisagreementError, match="misses of 1 cells"):
        check_equal(WORKLOADS[0], {"wrong": trace_wrongly})


def test_no_beam_leaves_the_box_that_yardsticks_are_given(yardsticks: Mapping[str, Trace]) -> None:
    corridor = make_corridor(WIDE, 20.0, spacing=5.0)
    hits, misses = yardsticks[PLAIN](corridor, find_box(corridor))
    assert hits.sum() == np.count_nonzero(corridor.ranges < 30)
    assert not any(edge.any() for edge in (misses[0], misses[-1], misses[:, 0], misses[:, -1]))


def test_every_format_holds_the_same_drive(tmp_path: Path) -> None:
    maps = [
        build([write(WORKLOADS[0], tmp_path)], BuildOptions(jobs=1)).map
        for write in FORMATS.values()
    ]
    assert all(grid.origin == maps[0].origin for grid in maps)
    assert all(np.array_equal(grid.log_odds, maps[0].log_odds) for grid in maps)


def test_ratios_are_taken_within_rounds() -> None:
    times = Times({"mine": [2.0, 3.0, 40.0], "base": [1.0, 2.0, 10.0]})
    assert times.median("mine") == 3.0
    assert times.ratio("mine", "base") == 2.0
    assert times.best_ratio("mine", "base") == 2.0 / 1.0


def test_rounds_turn_round_and_the_first_is_not_counted() -> None:
    asked: list[str] = []

    def answer(name: str) -> float:
        asked.append(name)
        return float(len(asked))

    times = take_in_turn({name: lambda name=name: answer(name) for name in "ab"}, 2)  # type: ignore[misc]
    assert asked == ["a", "b", "b", "a", "a", "b"]
    assert times.seconds == {"a": [4.0, 5.0], "b": [3.0, 6.0]}


def test_a_process_has_its_own_peak_memory() -> None:
    held = np.ones(100 << 17)  # this process holds 100 MiB that the measured one must not inherit
    usage = run([sys.executable, "-c", "print(len(bytearray(30 << 20)))"])
    assert usage.output == f"{30 << 20}\n"
    assert 30 << 20 < usage.peak_bytes < held.nbytes


def test_a_process_that_fails_is_an_error() -> None:
    with pytest.raises(ProcessError, match="oh no"):
        run([sys.executable, "-c", "raise SystemExit('oh no')"])


def test_rows_say_whether_their_limit_is_met_in_json_too() -> None:
    rows = [Row("", 0.5, value, "") for value in (0.5, 0.6, None)]
    told = json.loads(Bench(Path(), rows=rows).to_json())["rows"]
    assert [row["verdict"] for row in told] == ["met", "NOT MET", "not measured"]


def test_tables_line_up() -> None:
    assert draw(("", "us"), [("beam", "7")]) == "|      | us |\n| ---- | -: |\n| beam |  7 |\n"


def test_the_command_explains_itself() -> None:
    command = [sys.executable, "-m", "tests.bench", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--quick" in done.stdout
