"""Slices of time and visits: an engine that keeps slices against a fresh one for every scan."""

from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import islice, permutations
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.cells import Slices
from occmap.grid.engine import GridEngine
from occmap.grid.tiles import TILE, WINDOW_CELLS, GridSpec, count_visits, split_tiles, unpack_bits
from occmap.types import Rays
from tests.grid import scans
from tests.grid.reference import Cell
from tests.grid.test_engine import KINDS_OF_MAP, WINDOWS, all_specs

SLICE = 10
LIMITS = np.iinfo(np.int64)


class Seen(NamedTuple):
    """The slices of time that hit one cell, and those that saw it."""

    hit: set[int]
    seen: set[int]

    def count_visits(self) -> tuple[int, int]:
        """How many hit the cell, and how many saw it: a visit is a run of slices."""
        starts = sorted(self.seen - {number + 1 for number in self.seen})
        hits = {max(start for start in starts if start <= number) for number in self.hit}
        return len(hits), len(starts)


Expected = dict[Cell, Seen]


def look_scan_by_scan(spec: GridSpec, rays: Rays, slice_ns: int = SLICE) -> Expected:
    cells: Expected = defaultdict(lambda: Seen(set(), set()))
    for s, stamp in enumerate(rays.stamp_ns.tolist()):
        engine = GridEngine(spec)
        engine.add(scans.take(rays, [s]))
        first, second = scans.read_cells(engine.finish())
        hit = set(first) if spec.radial is None else set()
        for cell in hit | set(second):
            cells[cell].seen.add(stamp // slice_ns)
        for cell in hit:
            cells[cell].hit.add(stamp // slice_ns)
    return dict(cells)


def spread(slices: Slices) -> Expected:
    cells: Expected = defaultdict(lambda: Seen(set(), set()))
    tiles, numbers = (slices.tiles * TILE).tolist(), slices.numbers.tolist()
    for k, layer, row, col in np.argwhere(np.unpackbits(unpack_bits(slices), axis=-1)).tolist():
        seen = cells[tiles[k][0] + row, tiles[k][1] + col]
        (seen.seen if layer else seen.hit).add(numbers[k])
    return dict(cells)


def spread_visits(slices: Slices) -> dict[Cell, tuple[int, int]]:
    found = {}
    for (tile_row, tile_col), of_tile in split_tiles(slices):
        hit, seen = count_visits(of_tile)
        for row, col in np.argwhere(hit + seen).tolist():
            cell = tile_row * TILE + row, tile_col * TILE + col
            found[cell] = int(hit[row, col]), int(seen[row, col])
    return found


def keep(
    spec: GridSpec, batches: list[Rays], window_cells: int = WINDOW_CELLS, slice_ns: int = SLICE
) -> Slices:
    """Which slices are kept; the evidence is that of an engine without any."""
    engine = GridEngine(spec, window_cells, slice_ns=slice_ns)
    plain = GridEngine(spec, window_cells)
    for rays in batches:
        engine.add(rays)
        plain.add(rays)
    assert scans.read_cells(engine.finish()) == scans.read_cells(plain.finish())
    (slices,) = engine.read_slices()
    return slices


@KINDS_OF_MAP
@pytest.mark.parametrize("scene", [scans.drives, scans.aligned_drives])
@scans.FEW
@given(data=st.data(), window_cells=WINDOWS, slice_ns=st.sampled_from([1, 7, SLICE, 1000]))
def test_slices_are_those_of_the_scans_that_observed_a_cell(
    kind_of_map: int,
    scene: Callable[[], st.SearchStrategy[scans.Drive]],
    data: st.DataObject,
    window_cells: int,
    slice_ns: int,
) -> None:
    rays, resolution = data.draw(scene())
    spec = all_specs(resolution)[kind_of_map]
    slices = keep(spec, [rays], window_cells, slice_ns)
    expected = look_scan_by_scan(spec, rays, slice_ns)
    assert spread(slices) == expected
    assert spread_visits(slices) == {cell: seen.count_visits() for cell, seen in expected.items()}


@KINDS_OF_MAP
@scans.FEW
@given(drive=scans.drives(), window_cells=WINDOWS)
def test_batches_windows_and_order_change_no_byte(
    kind_of_map: int, drive: scans.Drive, window_cells: int
) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    whole = keep(spec, [rays])
    for order in islice(permutations(range(len(rays.kind))), 0, None, 5):
        scans.assert_same_slices(keep(spec, [scans.take(rays, list(order))], window_cells), whole)
        scans.assert_same_slices(
            keep(spec, [scans.take(rays, [s]) for s in order], window_cells), whole
        )


@pytest.mark.parametrize("slice_ns", [None, SLICE])
@KINDS_OF_MAP
def test_threads_give_the_same_sums_and_slices(kind_of_map: int, slice_ns: int | None) -> None:
    """A scan every 3 ns, and a pause of 40 after every fifth."""
    stamps = np.array([3 * s + 40 * (s // 5) - 100 for s in range(24)])
    rays = scans.draw_scans(np.random.default_rng(5), 24, 0.02, 100)._replace(stamp_ns=stamps)
    alone, spec = [scans.take(rays, [s]) for s in range(24)], all_specs(0.05)[kind_of_map]
    engine = GridEngine(spec, window_cells=1 << 16, slice_ns=slice_ns)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(engine.add, alone))
    assert scans.read_cells(engine.finish()) == scans.observe(spec, alone)
    for slices in engine.read_slices():
        assert spread(slices) == look_scan_by_scan(spec, rays)


def one_beam(stamps: list[int]) -> Rays:
    """Along x, from cell 0 to a hit in cell 2, at each of these times."""
    return scans.make_rays(scans.MIDDLE, (1, 0), np.full((len(stamps), 1), 2.0), stamp_ns=stamps)


@pytest.mark.parametrize(
    ("hits", "visits"),
    [
        ([0], 1),
        ([0, 20], 1),  # in between the cell was seen, and it was free: the same visit
        ([20, 40], 2),  # in between only other cells were seen
        ([40, 50, 100], 2),
        ([110], 1),
        ([], 0),
    ],
)
def test_a_visit_that_hits_again_and_again_is_one(hits: list[int], visits: int) -> None:
    """Scans along x: one ends in cell 1, some in cell 2, and others go on through it to cell 4."""
    rays = one_beam([0, 10, 20, 30, 40, 50, 100, 110])
    rays.distance[~np.isin(rays.stamp_ns, hits)] = 4
    rays.distance[rays.stamp_ns == 30] = 1
    slices = keep(all_specs(1.0)[0], [rays])
    assert spread_visits(slices)[0, 2] == (visits, 3)


def test_every_stamp_that_there_can_be_has_a_slice() -> None:
    slices = keep(all_specs(1.0)[0], [one_beam([LIMITS.min, -1, 0, LIMITS.max])])
    first, last = LIMITS.min // SLICE, LIMITS.max // SLICE
    assert spread(slices)[0, 2].hit == {int(first), -1, 0, int(last)}
    assert spread_visits(slices)[0, 2] == (3, 3)


def test_nothing_observed_has_no_slices() -> None:
    engine = GridEngine(all_specs(1.0)[0], slice_ns=SLICE)
    assert not engine.finish().tiles
    (slices,) = engine.read_slices()
    assert spread(slices) == {}
    assert list(split_tiles(slices)) == []
