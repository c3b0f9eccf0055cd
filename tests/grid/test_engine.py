"""Counts of hits and misses: the engine against the rules, written the slow way."""

from collections import Counter, defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice, permutations
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.cells import CellBox, Slices
from occmap.errors import MapError
from occmap.grid import Lattice
from occmap.grid.engine import BeamWindow, GridEngine, choose_windows, find_near, look_at_cell
from occmap.grid.kernels.projection import join_viewpoints, prepare, project
from occmap.grid.tiles import (
    TILE,
    WINDOW_CELLS,
    GridSpec,
    TileGrid,
    count_visits,
    split_tiles,
    tabulate,
    unpack_bits,
)
from occmap.sensor.models import QuadraticModel
from occmap.types import BEAM_UPDATES, Kind, Rays, Update
from tests.grid import reference, scans
from tests.grid.reference import Cell

WINDOWS = st.sampled_from([50, 400, WINDOW_CELLS])
JUMPS = [0.0, 0.5, 4.0, 1e9]
"""In cells"""
HALVES = (0.0625, 0.5)
"""Resolutions that are powers of two: whole cells are then whole numbers of metres, exactly."""


def radial_tables(resolution: float, p_min: float = 0.2) -> GridSpec:
    model = QuadraticModel(epsilon=1.5 * resolution, p_min=p_min)
    tables = tabulate(model.free, model.hit, model.depth(resolution))
    return GridSpec(Update.BEAM, Lattice(resolution), radial=tables)


def all_specs(resolution: float) -> list[GridSpec]:
    """Every update with both sorts of evidence."""
    radial = radial_tables(resolution)
    return [
        replace(radial, update=update, radial=tables)
        for update in BEAM_UPDATES
        for tables in (None, radial.radial)
    ]


NAMES = [f"{update}{sort}" for update in BEAM_UPDATES for sort in ("", "-radial")]
KINDS_OF_MAP = pytest.mark.parametrize("kind_of_map", range(6), ids=NAMES)
each_update = pytest.mark.parametrize("update", BEAM_UPDATES)


@each_update
@pytest.mark.parametrize(
    ("scene", "jumps", "gaps"),
    [
        (scans.drives, JUMPS, [8, 1, 0]),
        (scans.upright_drives, JUMPS, [8]),
        (scans.aligned_drives, [2.0], [8]),
    ],
    ids=["drives", "straight up and down", "on centres and borders of cells"],
)
@scans.MANY
@given(data=st.data(), window_cells=WINDOWS)
def test_every_update_follows_its_rule(
    update: Update,
    scene: Callable[[], st.SearchStrategy[scans.Drive]],
    jumps: list[float],
    gaps: list[int],
    data: st.DataObject,
    window_cells: int,
) -> None:
    rays, resolution = data.draw(scene())
    jump = data.draw(st.sampled_from(jumps)) * resolution
    spec = GridSpec(update, Lattice(resolution), jump, data.draw(st.sampled_from(gaps)))
    assert scans.observe(spec, [rays], window_cells) == reference.trace(spec, rays)


@each_update
@scans.FEW
@given(drive=scans.drives(), cells=st.sampled_from([0.25, 0.5, 2.0]))
def test_a_hit_is_moved_outward_before_anything_is_rounded(
    update: Update, drive: scans.Drive, cells: float
) -> None:
    rays, resolution = drive
    offset = np.float32(cells * resolution)
    farther = np.where(rays.kind == Kind.HIT, rays.distance + offset, rays.distance)
    moved = rays._replace(distance=farther)
    spec = GridSpec(update, Lattice(resolution))
    assert scans.observe(replace(spec, hit_offset=cells), [rays]) == scans.observe(spec, [moved])


@KINDS_OF_MAP
@scans.FEW
@given(drive=scans.drives(), window_cells=WINDOWS)
def test_batches_windows_order_and_merging_change_nothing(
    kind_of_map: int, drive: scans.Drive, window_cells: int
) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    grid, slices = observe_slices(spec, [rays])
    plain = GridEngine(spec)
    plain.add(rays)
    assert scans.are_equal(grid.tiles, plain.finish().tiles)
    whole = scans.read_cells(grid)
    alone = [scans.take(rays, [s]) for s in range(len(rays.kind))]
    for order in islice(permutations(range(len(alone))), 0, None, 5):
        for batches in ([scans.take(rays, list(order))], [alone[s] for s in order]):
            found, kept = observe_slices(spec, batches, window_cells)
            assert scans.read_cells(found) == whole
            scans.assert_same_slices(kept, slices)
    parts = [scans.observe(spec, [scan]) for scan in alone]
    for layer in (0, 1):
        merged: Counter[reference.Cell] = Counter()
        for part in parts:  # update() keeps negative sums, which + would drop
            merged.update(part[layer])
        assert merged == whole[layer]


@KINDS_OF_MAP
@scans.FEW
@given(
    drive=scans.drives(resolutions=HALVES, places=(0.0,)),
    rows=st.integers(-70_000, 70_000),
    cols=st.integers(-70_000, 70_000),
)
def test_a_shift_by_whole_cells_shifts_the_map(
    kind_of_map: int, drive: scans.Drive, rows: int, cols: int
) -> None:
    rays, resolution = drive
    # Origins on the lattice: a float has then bits enough for the sum of both.
    rays = rays._replace(origin=np.rint(rays.origin / resolution * 256) / 256 * resolution)
    spec = all_specs(resolution)[kind_of_map]
    there = scans.observe(spec, [scans.shift(rays, (cols * resolution, rows * resolution))])
    for layer, moved in zip(scans.observe(spec, [rays]), there, strict=True):
        assert {(r + rows, c + cols): n for (r, c), n in layer.items()} == moved


def make_engine(update: Update = Update.BEAM, resolution: float = 0.05) -> GridEngine:
    return GridEngine(GridSpec(update, Lattice(resolution)))


@each_update
def test_a_wild_pose_costs_only_the_tiles_that_it_touches(update: Update) -> None:
    origin = np.array([0.5, 0.5 + 1e7, 0.5]).repeat(2).reshape(3, 1, 2)
    rays = scans.make_rays(origin, scans.aim(0, 0.5, 3), 3.0)
    engine = GridEngine(GridSpec(update, Lattice(0.05)), max_cells=10**18)
    engine.add(rays)
    tiles = engine.finish().tiles
    side = 3.0 / 0.05 / TILE
    assert len(tiles) <= 2 * (side + 2) ** 2
    far = 1e7 / 0.05 / TILE
    for tile_row, tile_col in tiles:
        assert any(abs(tile_row - at) <= side + 2 and abs(tile_col - at) <= side + 2
                   for at in (0, far))  # fmt: skip


def test_a_low_wide_scan_has_no_window_of_more_cells_than_its_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its box is 4 rows high, but these lie in two rows of tiles."""
    windows: list[int] = []
    allocate = BeamWindow.allocate

    def remember(self: BeamWindow, rows: int, cols: int) -> None:
        windows.append(rows * cols)
        allocate(self, rows, cols)

    monkeypatch.setattr(BeamWindow, "allocate", remember)
    most = 2 * TILE * 4 * TILE
    rays = scans.make_rays((0.5, TILE), [[1.0, 0.001], [1.0, -0.001]] * 64, 900, Kind.FREE)
    spec = GridSpec(Update.BEAM, Lattice(1.0))
    engine = GridEngine(spec, window_cells=most)
    engine.add(rays)
    assert windows
    assert max(windows) <= most
    assert scans.read_cells(engine.finish()) == reference.trace(spec, rays)


def test_the_longest_beam_is_what_an_int32_holds_and_a_longer_one_is_refused() -> None:
    # 2**22 cells of 2**8 units, from a sensor half as far from the anchor: 1.5 x 2**30 units, while
    # the next power of two, 3 x 2**30, is beyond 2**31.
    spec = GridSpec(Update.BEAM, Lattice(1.0))
    prepare(scans.make_scan((4_194_304.0, Kind.HIT)), spec)
    with pytest.raises(MapError, match=r"for cells of 1\.0 m; .* `max_range`, .* `resolution`"):
        prepare(scans.make_scan((4_194_305.0, Kind.HIT)), spec)


@each_update
def test_a_scan_that_could_make_a_cell_overflow_is_refused(update: Update) -> None:
    beams = 2**20
    rays = scans.make_rays(scans.MIDDLE, scans.aim(0, 0.5, beams), 1.0)
    surest = tabulate(lambda u: 0 * u, lambda w: 1 + 0 * w, 1.0)
    with pytest.raises(MapError, match="a scan of 1048576 beams is more than this model can count"):
        GridEngine(replace(radial_tables(0.5), update=update, radial=surest)).add(rays)


@each_update
@pytest.mark.parametrize("metres", [1e12, 1e300, -1e300, float("inf"), float("nan")])
def test_a_sensor_that_is_too_far_away_is_refused(update: Update, metres: float) -> None:
    rays = scans.make_rays(scans.MIDDLE, scans.aim(0, 0.5, 2), 3.0)
    with pytest.raises(MapError, match=r"is too far away for cells of 0\.05 m; if a pose is wrong"):
        make_engine(update).add(scans.shift(rays, (0.0, metres)))


def test_cells_that_are_too_small_are_refused() -> None:
    rays = scans.make_rays(scans.MIDDLE, scans.aim(0, 0.5, 2), 3.0)
    with pytest.raises(MapError, match="use a coarser `resolution`"):
        make_engine(resolution=1e-9).add(rays)


def test_more_may_be_added_after_the_evidence_was_read() -> None:
    rays = scans.make_scan((3.0, Kind.HIT))
    engine = make_engine(resolution=1.0)
    engine.add(rays)
    once = scans.read_cells(engine.finish())
    engine.add(rays)
    twice = scans.read_cells(engine.finish())
    assert once.first == {(0, 3): 1}
    assert twice == tuple({cell: 2 * n for cell, n in layer.items()} for layer in once)


@scans.FEW
@given(drive=scans.drives())
def test_joined_viewpoints_leave_the_ends_where_they_are(drive: scans.Drive) -> None:
    rays, _ = drive
    joined = join_viewpoints(rays)
    measured = rays.kind > 0
    reach = float(joined.distance.max(initial=0)) + 1e-9
    apart = np.abs(joined.end - rays.end)[measured]
    assert joined.origin.shape[1] == 1
    assert apart.max(initial=0.0) <= 2**-23 * reach + 2e-11
    if rays.origin.shape[1] > 1:
        middle = rays.origin.shape[1] // 2
        np.testing.assert_array_equal(joined.origin[:, 0], rays.origin[:, middle])


@pytest.mark.parametrize("kind_of_map", [0, 4])
def test_few_scans_and_many_observe_the_same(kind_of_map: int) -> None:
    """To count, few scans of a place visit its cells, and many note changes: all add the same."""
    rays = scans.draw_scans(np.random.default_rng(7), 40, 0.005, 400)
    rays.distance[:, ::9] = 0  # in the sensor's own cell
    spec = all_specs(0.05)[kind_of_map]

    def name_windows(batches: list[Rays]) -> set[str]:
        beams = [project(some, spec) for some in batches]
        return {choose_windows(spec, each)[0].__name__ for each in beams}

    one_by_one = [scans.take(rays, [s]) for s in range(40)]
    assert name_windows([rays]) != name_windows(one_by_one)
    assert scans.observe(spec, [rays]) == scans.observe(spec, one_by_one)


@KINDS_OF_MAP
@scans.FEW
@given(drive=scans.drives(), place=st.floats(0, 1))
def test_each_scan_adds_what_it_does_alone(
    drive: scans.Drive, place: float, kind_of_map: int
) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    alone = [scans.observe(spec, [scans.take(rays, [s])]) for s in range(len(rays.kind))]
    cells = sorted({cell for each in alone for layer in each for cell in layer}) or [(0, 0)]
    row, col = cells[round(place * (len(cells) - 1))]
    for cell in ((row, col), (row + 1, col), (row, col - 3)):
        seen = look_at_cell(rays, spec, *cell)
        assert seen.tolist() == [[each.first[cell], each.second[cell]] for each in alone]


def fan(origins: list[tuple[float, float]]) -> Rays:
    """Two beams of a metre from each place: along x and along y."""
    return scans.make_rays(np.array(origins).reshape(-1, 1, 2), [(1, 0), (0, 1)], 1.0)


SPEC = GridSpec(Update.BEAM, Lattice(0.1))


def test_scans_far_from_the_cell_are_not_traced() -> None:
    rays = fan([(0.05, 0.05), (0.95, 0.05), (3, 0), (0, 3), (-0.05, 0.05)])
    assert find_near(rays, SPEC, CellBox.at(0, 9)).tolist() == [True, True, False, False, True]
    # A miss on the way; both beams begin in it; too far; too far; the end.
    assert look_at_cell(rays, SPEC, 0, 9).tolist() == [[0, 1], [0, 2], [0, 0], [0, 0], [1, 0]]


def test_nothing_is_seen_without_scans() -> None:
    assert look_at_cell(fan([]), SPEC, 0, 9).shape == (0, 2)


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


def observe_slices(
    spec: GridSpec, batches: list[Rays], window_cells: int = WINDOW_CELLS, slice_ns: int = SLICE
) -> tuple[TileGrid, Slices]:
    """The evidence, and which slices of time are kept."""
    engine = GridEngine(spec, window_cells, slice_ns=slice_ns)
    for rays in batches:
        engine.add(rays)
    grid = engine.finish()
    (slices,) = engine.read_slices()
    return grid, slices


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
    _, slices = observe_slices(spec, [rays], window_cells, slice_ns)
    expected = look_scan_by_scan(spec, rays, slice_ns)
    assert spread(slices) == expected
    assert spread_visits(slices) == {cell: seen.count_visits() for cell, seen in expected.items()}


@pytest.mark.parametrize("slice_ns", [None, SLICE])
@KINDS_OF_MAP
def test_threads_give_the_same_sums_and_slices(kind_of_map: int, slice_ns: int | None) -> None:
    """A scan every 3 ns, and a pause of 40 after every fifth."""
    stamps = np.array([3 * s + 40 * (s // 5) - 100 for s in range(12)])
    rays = scans.draw_scans(np.random.default_rng(5), 12, 0.05, 30)._replace(stamp_ns=stamps)
    alone, spec = [scans.take(rays, [s]) for s in range(12)], all_specs(0.05)[kind_of_map]
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
    _, slices = observe_slices(all_specs(1.0)[0], [rays])
    assert spread_visits(slices)[0, 2] == (visits, 3)


def test_every_stamp_that_there_can_be_has_a_slice() -> None:
    _, slices = observe_slices(all_specs(1.0)[0], [one_beam([LIMITS.min, -1, 0, LIMITS.max])])
    first, last = LIMITS.min // SLICE, LIMITS.max // SLICE
    assert spread(slices)[0, 2].hit == {int(first), -1, 0, int(last)}
    assert spread_visits(slices)[0, 2] == (3, 3)


def test_nothing_observed_has_no_slices() -> None:
    engine = GridEngine(all_specs(1.0)[0], slice_ns=SLICE)
    assert not engine.finish().tiles
    (slices,) = engine.read_slices()
    assert spread(slices) == {}
    assert list(split_tiles(slices)) == []
