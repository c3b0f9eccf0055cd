"""The benchmark measures what it says: right ranges, equal counts, rules of peers by hand."""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import OccupancyMap
from occmap.grid import Lattice
from occmap.grid.engine import GridEngine
from occmap.grid.tiles import GridSpec
from occmap.types import Kind, Rays, Update
from tests.bench import peers, people, quality
from tests.bench.engine import check_equal
from tests.bench.plans import cast_scans
from tests.bench.processes import run
from tests.bench.quality import DEFAULT
from tests.bench.workloads import Sensor, Workload, make_office, make_yard
from tests.bench.yardstick import Trace, compile_cpp
from tests.grid.scans import make_rays, make_scan

WORKLOADS = [
    make_office("wide", Sensor.spanning(91, 270, 30.0), 12),
    make_office("round", Sensor.spanning(72, 360, 30.0), 12),
    make_yard("long", Sensor.spanning(45, 180, 80.0), 12),
]


def test_rays_end_on_the_nearest_box() -> None:
    boxes = np.array([(2.0, -1, 3, 1), (4, -9, 5, 9), (-9, 3, 9, 4)])
    poses = np.array([(0.0, 0, 0), (0, 0, math.pi / 2), (1, 2, 0)])
    ranges = cast_scans(poses, np.radians([0.0, 45.0, -90.0]), boxes)
    expected = [(2, 3 * math.sqrt(2), np.inf), (3, 3 * math.sqrt(2), 2), (3, math.sqrt(2), np.inf)]
    assert ranges == pytest.approx(np.array(expected), abs=1e-9)


@pytest.fixture(scope="module")
def yardsticks(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Trace]:
    return compile_cpp(tmp_path_factory.mktemp("cpp")) or pytest.skip("no g++ here")


@pytest.mark.parametrize("workload", WORKLOADS, ids=lambda workload: workload.name)
def test_the_yardsticks_count_as_occmap_does(
    workload: Workload, yardsticks: Mapping[str, Trace]
) -> None:
    check_equal(workload, yardsticks)


def test_a_process_has_its_own_peak_memory() -> None:
    held = np.ones(100 << 17)  # this process holds 100 MiB that the measured one must not inherit
    usage = run([sys.executable, "-c", "print(len(bytearray(30 << 20)))"])
    assert usage.output == f"{30 << 20}\n"
    assert 30 << 20 < usage.peak_bytes < held.nbytes


SCAN_PEERS = sorted(peers.SCAN_RULES)


def look(verdict: peers.Verdict) -> str:
    """A letter for each cell."""
    odds = math.log(verdict.cut / (1 - verdict.cut))
    with np.errstate(invalid="ignore"):
        occupied = verdict.known & (verdict.log_odds > np.float32(odds))
    return "".join(
        "#" if is_occupied else "." if known else " "
        for is_occupied, known in zip(occupied, verdict.known, strict=True)
    )


@pytest.mark.parametrize(
    ("rule", "counts", "shown"),
    [
        # gmapping calls a cell occupied above one hit in four visits.
        (peers.share_hits, [(0, 0), (0, 5), (1, 0), (1, 2), (1, 3), (3, 8)], " .##.#"),
        # Karto wants three passes and more than one hit in ten, and a hit is two passes:
        # 1 of 2, 1 of 3, 1 of 9, 1 of 10; 0 of 2, 0 of 3.
        (peers.pass_through, [(1, 0), (1, 1), (1, 7), (1, 8), (0, 2), (0, 3)], " ##. ."),
        # Bayes takes two misses for a hit and not three.
        (peers.add_log_odds, [(0, 0), (1, 2), (1, 3), (2, 4)], " #.#"),
    ],
)
def test_a_rule_of_counts_by_hand(
    rule: Callable[..., peers.Verdict], counts: list[tuple[int, int]], shown: str
) -> None:
    """Of cells with these hits and misses."""
    hits, misses = np.array(counts, np.float32).T
    assert look(rule(hits, misses)) == shown


def map_scans(*scans: Rays) -> dict[str, OccupancyMap]:
    engine = GridEngine(GridSpec(Update.BEAM, Lattice(1.0)))
    for rays in scans:
        engine.add(rays)
    return peers.map_peers(scans, engine.finish())


def read_row(grid: OccupancyMap) -> list[float | None]:
    """Log-odds of the cells from x = 0 on; None where unknown."""
    row, col = round(-grid.origin[1]), round(-grid.origin[0])
    cells = zip(grid.log_odds[row, col:].tolist(), grid.observed[row, col:].tolist(), strict=True)
    return [value if known else None for value, known in cells]


HIT_MISS = {"OctoMap": (0.7, 0.4), "hector": (0.9, 0.4), "Cartographer": (0.55, 0.49)}


@pytest.mark.parametrize("name", SCAN_PEERS)
def test_a_scan_counts_once_in_a_cell_and_its_hits_come_first(name: str) -> None:
    """Two beams cross the first cells; the third cell is hit by one and crossed by the other."""
    rays = make_scan((2, Kind.HIT), (4, Kind.HIT), (5, Kind.SKIP))
    hit, miss = (math.log(p / (1 - p)) for p in HIT_MISS[name])
    expected = [miss, miss, hit, miss, hit]  # and the last beam shows nothing
    assert read_row(map_scans(rays)[name]) == pytest.approx(expected, abs=1e-6)
    nothing_came_back = map_scans(make_scan((2, Kind.FREE)))[name]
    assert read_row(nothing_came_back) == pytest.approx([miss] * 3, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "at_last", "most", "least"),
    [
        # Five hits end at 3.5, ten misses later at -0.5: bounds at the end alone would say 0.2.
        ("OctoMap", math.log(0.971 / 0.029) + 10 * math.log(0.4 / 0.6), 3.5111, -2.0001),
        ("hector", 5 * math.log(9) + 10 * math.log(0.4 / 0.6), 50, 40 * math.log(0.4 / 0.6)),
        ("Cartographer", 5 * math.log(0.55 / 0.45) + 10 * math.log(0.49 / 0.51), 2.1972,
         40 * math.log(0.49 / 0.51)),
    ],
)  # fmt: skip
def test_bounds_hold_after_each_scan(name: str, at_last: float, most: float, least: float) -> None:
    """Where later scans say something else, and where forty say the same."""
    scans = [make_scan((2, Kind.HIT))] * 5 + [make_scan((4, Kind.HIT))] * 10
    assert read_row(map_scans(*scans)[name])[2] == pytest.approx(at_last, abs=1e-5)
    sure = read_row(map_scans(*[make_scan((2, Kind.HIT))] * 40)[name])
    assert [sure[2], sure[0]] == pytest.approx([most, least], abs=1e-3)


def draw_map(cells: str) -> OccupancyMap:
    """One row of cells of 0.5 m from x = -0.5."""
    occupied = np.array([[cell == "#" for cell in cells]])
    log_odds = np.where(occupied, 3, -3).astype(np.float32)
    return OccupancyMap(log_odds, np.ones_like(occupied), 0.5, (-0.5, 0.0))


@pytest.mark.parametrize(
    ("reach", "foretold"), [(2.4, 0), (2.6, 1), (3.5, 1), (4.5, 1), (4.6, 0), (30.0, None)]
)
def test_the_walk_finds_the_first_occupied_cell_to_two_cells(
    reach: float, foretold: int | None
) -> None:
    """From x = 0.25 steps fall on the middles of cells; the seventh is in the wall at 3.5 m."""
    kinds = [Kind.HIT, Kind.SKIP, Kind.FREE]
    rays = make_rays((0.25, 0.25), (1, 0), [reach, 3.5, 3.5], kinds)
    found = quality.walk(draw_map("........###"), [rays])
    assert found.tolist() == [[0, 0] if foretold is None else [1, foretold]]
    out_of_the_map = make_scan((20, Kind.HIT), (20, Kind.HIT))
    assert quality.walk(draw_map("...."), [out_of_the_map]).tolist() == [[2, 0]]


def test_the_default_keeps_what_stands_and_loses_what_stood_there_once(tmp_path: Path) -> None:
    rules = {"default": DEFAULT, "two visits": replace(DEFAULT, min_passes=2)}
    fates = people.judge(people.Scene(2, boxes=True), tmp_path, rules)
    assert fates["default"].kept >= 0.99
    assert fates["default"].removed >= 0.8
    assert fates["two visits"].kept < fates["default"].kept
    assert fates["two visits"].removed > fates["default"].removed
