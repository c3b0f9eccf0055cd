"""When cells were observed: the engine against one fresh engine for every scan."""

from collections import defaultdict
from dataclasses import dataclass, field, replace
from itertools import permutations
from threading import Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.grid.engine import WINDOW_CELLS, GridEngine
from occmap.grid.spec import GridSpec
from occmap.grid.tiles import TILE
from occmap.grid.timed import TimedEngine
from occmap.grid.times import TimeGrid, decode_stamps, encode_stamps
from occmap.types import Kind, Rays, Times
from tests.grid.reference import Cell
from tests.grid.scans import FEW, Drive, aim, aligned_drives, drives, read_cells, take
from tests.grid.test_engine import KINDS_OF_MAP, WINDOWS, all_specs

SLICE = 10
LIMITS = np.iinfo(np.int64)


@dataclass
class Seen:
    """When one cell was observed: the stamps, and the slices that hit it and saw it."""

    stamps: list[int] = field(default_factory=list)
    hit: set[int] = field(default_factory=set)
    seen: set[int] = field(default_factory=set)

    def sum_up(self) -> tuple[int, int, int, int]:
        visits = list_runs(self.seen)
        hit = sum(1 for visit in visits if visit & self.hit)
        return min(self.stamps), max(self.stamps), hit, len(visits)


def list_runs(slices: set[int]) -> list[set[int]]:
    runs: list[set[int]] = []
    for slice_ in sorted(slices):
        if slice_ - 1 not in slices:
            runs.append(set())
        runs[-1].add(slice_)
    return runs


Expected = dict[Cell, tuple[int, int, int, int]]


def look_scan_by_scan(spec: GridSpec, rays: Rays) -> Expected:
    """First and last stamp, visits that hit and visits that saw each observed cell."""
    cells: dict[Cell, Seen] = defaultdict(Seen)
    for s, stamp in enumerate(rays.stamp_ns.tolist()):
        engine = GridEngine(spec)
        engine.add(take(rays, [s]))
        first, second = read_cells(engine.finish())
        hit = set(first) if spec.radial is None else set()
        for cell in hit | set(second):
            cells[cell].stamps.append(stamp)
            cells[cell].seen.add(stamp // spec.slice_ns)
        for cell in hit:
            cells[cell].hit.add(stamp // spec.slice_ns)
    return {cell: each.sum_up() for cell, each in cells.items()}


def spread(times: Times) -> Expected:
    seen = np.unpackbits(times.observed, axis=1).reshape(-1, TILE, TILE)
    at = [
        (int(times.tiles[t, 0]) * TILE + row, int(times.tiles[t, 1]) * TILE + col)
        for t, row, col in np.argwhere(seen).tolist()
    ]
    columns = (times.first_ns, times.last_ns, times.hit_visits, times.seen_visits)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return dict(zip(at, rows, strict=True))


def time(
    spec: GridSpec, batches: list[Rays], window_cells: int = WINDOW_CELLS
) -> tuple[Expected, Times]:
    """What is kept, once as a table and once as it is."""
    engine = TimedEngine(spec, window_cells)
    for rays in batches:
        engine.add(rays)
    plain = GridEngine(spec)
    for rays in batches:
        plain.add(rays)
    assert read_cells(engine.finish()) == read_cells(plain.finish())
    (times,) = engine.read_times()
    return spread(times), times


@KINDS_OF_MAP
@FEW
@given(drive=drives(), window_cells=WINDOWS, slice_ns=st.sampled_from([1, 7, SLICE, 1000]))
def test_times_are_those_of_the_scans_that_observed_a_cell(
    kind_of_map: int, drive: Drive, window_cells: int, slice_ns: int
) -> None:
    rays, resolution = drive
    spec = replace(all_specs(resolution)[kind_of_map], slice_ns=slice_ns)
    assert time(spec, [rays], window_cells)[0] == look_scan_by_scan(spec, rays)


@KINDS_OF_MAP
@FEW
@given(drive=aligned_drives(), window_cells=WINDOWS)
def test_centres_that_lie_on_edges_have_the_times_of_their_counts(
    kind_of_map: int, drive: Drive, window_cells: int
) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    assert time(spec, [rays], window_cells)[0] == look_scan_by_scan(spec, rays)


@KINDS_OF_MAP
@FEW
@given(drive=drives(), window_cells=WINDOWS)
def test_batches_windows_and_order_change_no_time(
    kind_of_map: int, drive: Drive, window_cells: int
) -> None:
    rays, resolution = drive
    spec = replace(all_specs(resolution)[kind_of_map], slice_ns=SLICE)
    whole, times = time(spec, [rays])
    scans = range(len(rays.kind))
    for order in permutations(scans):
        assert time(spec, [take(rays, list(order))], window_cells)[0] == whole
    single, other = time(spec, [take(rays, [s]) for s in scans], window_cells)
    assert single == whole
    assert np.array_equal(other.tiles, times.tiles)
    assert np.array_equal(other.observed, times.observed)


def drive_about(scans: int) -> Rays:
    """Two metres about zero, a scan every 3 ns, and a pause of 40 after every fifth."""
    rng = np.random.default_rng(5)
    return Rays.along(
        rng.uniform(-2, 2, (scans, 1, 2)),
        np.repeat(aim(-1.0, 0.02, 100)[None], scans, axis=0),
        rng.uniform(0.5, 8, (scans, 100)).astype(np.float32),
        rng.choice(np.array(Kind, np.uint8), (scans, 100)),
        np.array([3 * s + 40 * (s // 5) - 100 for s in range(scans)]),
        full_circle=False,
    )


@KINDS_OF_MAP
def test_threads_give_the_same_times(kind_of_map: int) -> None:
    rays, spec = drive_about(24), replace(all_specs(0.05)[kind_of_map], slice_ns=SLICE)
    engine = TimedEngine(spec, window_cells=1 << 16)

    def work(mine: int) -> None:
        for s in range(mine, 24, 4):
            engine.add(take(rays, [s]))

    threads = [Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    engine.finish()
    assert spread(engine.read_times()[0]) == look_scan_by_scan(spec, rays)


def one_beam(stamps: list[int]) -> Rays:
    """Along x, from cell 0 to a hit in cell 2, at each of these times."""
    scans = len(stamps)
    return Rays.along(
        np.full((scans, 1, 2), 0.5),
        np.tile([1.0, 0.0], (scans, 1, 1)),
        np.full((scans, 1), 2.0, np.float32),
        np.full((scans, 1), Kind.HIT, np.uint8),
        np.array(stamps),
        full_circle=False,
    )


@pytest.mark.parametrize(
    ("stamps", "visits"),
    [
        ([5], 1),
        ([0, 9, 10, 19], 1),  # two slices, one after the other
        ([0, 20], 2),  # a whole slice between them
        ([9, 20], 2),
        ([-1, 0], 1),
        ([-11, 0], 2),
        ([55, 5, 30, 6], 3),
    ],
)
def test_two_visits_are_a_slice_apart(stamps: list[int], visits: int) -> None:
    spec = replace(all_specs(1.0)[0], slice_ns=SLICE)
    found, _ = time(spec, [one_beam(stamps)])
    first, last = min(stamps), max(stamps)
    assert found == {
        (0, 0): (first, last, 0, visits),
        (0, 1): (first, last, 0, visits),
        (0, 2): (first, last, visits, visits),
    }


def look_both_ways(stamps: list[int], hits: list[int]) -> Rays:
    """As `one_beam`, that at some of the times goes on through cell 2 and hits cell 4."""
    rays = one_beam(stamps)
    reach = np.where(np.isin(stamps, hits), 2.0, 4.0).astype(np.float32)
    return Rays.along(
        np.full((len(stamps), 1, 2), 0.5),
        np.tile([1.0, 0.0], (len(stamps), 1, 1)),
        reach[:, None],
        rays.kind,
        rays.stamp_ns,
        full_circle=False,
    )


@pytest.mark.parametrize(
    ("hits", "visits"),
    [
        ([0], 1),
        ([0, 40], 1),  # in between the cell was seen, and it was free: the same visit
        ([10, 20, 40], 1),
        ([40, 100], 2),
        ([110], 1),
        ([], 0),
    ],
)
def test_a_visit_that_hits_again_and_again_is_one(hits: list[int], visits: int) -> None:
    spec = replace(all_specs(1.0)[0], slice_ns=SLICE)
    stamps = [0, 10, 20, 30, 40, 100, 110]
    found, _ = time(spec, [look_both_ways(stamps, hits)])
    assert found[0, 2] == (0, 110, visits, 2)


def test_every_stamp_that_there_can_be_is_kept() -> None:
    stamps = np.array([LIMITS.min, -1, 0, 1, 1_700_000_000_123_456_789, LIMITS.max])
    codes = encode_stamps(stamps)
    assert (np.diff(codes[:, 1].astype(object)) > 0).all()
    assert (np.diff(codes[:, 0].astype(object)) < 0).all()
    for back in decode_stamps(codes[:, 0], codes[:, 1]):
        assert back.tolist() == stamps.tolist()
    found, _ = time(all_specs(1.0)[0], [one_beam([LIMITS.min, LIMITS.max])])
    assert found[0, 2] == (LIMITS.min, LIMITS.max, 2, 2)


def test_nothing_observed_has_no_times() -> None:
    times = TimeGrid().read()
    assert [len(part) for part in (times.tiles, times.observed, times.first_ns)] == [0, 0, 0]
