"""Counts of hits and misses: the engine against the rules, written the slow way."""

from collections import Counter
from dataclasses import replace
from itertools import permutations
from threading import Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.errors import MapError, UsageError
from occmap.grid import Lattice
from occmap.grid.engine import BeamWindow, GridEngine, Window, choose_windows
from occmap.grid.kernels.projection import join_viewpoints, prepare, project
from occmap.grid.tiles import TILE, WINDOW_CELLS, GridSpec, tabulate
from occmap.sensor.models import QuadraticModel
from occmap.types import BEAM_UPDATES, Kind, Rays, Update
from tests.grid import reference
from tests.grid.scans import (
    FEW,
    MANY,
    Drive,
    aim,
    aligned_drives,
    drives,
    observe,
    read_cells,
    shift,
    take,
    upright_drives,
)

WINDOWS = st.sampled_from([50, 400, WINDOW_CELLS])
HALVES = (0.0625, 0.5)
"""Resolutions that are powers of two: whole cells are then whole numbers of metres, exactly."""


def radial_tables(resolution: float, p_min: float = 0.2) -> GridSpec:
    model = QuadraticModel(epsilon=1.5 * resolution, p_min=p_min)
    return GridSpec(
        Update.BEAM,
        Lattice(resolution),
        radial=tabulate(model.free, model.hit, model.depth(resolution)),
    )


def all_specs(resolution: float) -> list[GridSpec]:
    """Every update with both sorts of evidence."""
    radial = radial_tables(resolution)
    return [
        replace(radial, update=update, radial=tables)
        for update in BEAM_UPDATES
        for tables in (None, radial.radial)
    ]


KINDS_OF_MAP = pytest.mark.parametrize(
    "kind_of_map",
    range(6),
    ids=["beam", "beam-radial", "polygon", "polygon-radial", "surface", "surface-radial"],
)


@MANY
@given(drive=drives(), window_cells=WINDOWS)
def test_beam_update_follows_the_rule(drive: Drive, window_cells: int) -> None:
    rays, resolution = drive
    spec = GridSpec(Update.BEAM, Lattice(resolution))
    assert observe(spec, [rays], window_cells) == reference.trace_beams(rays, resolution)


@MANY
@given(drive=drives(), jump_cells=st.sampled_from([0.0, 0.5, 4.0, 1e9]), window_cells=WINDOWS)
def test_surface_update_follows_the_rule(
    drive: Drive, jump_cells: float, window_cells: int
) -> None:
    rays, resolution = drive
    jump = jump_cells * resolution
    spec = GridSpec(Update.SURFACE, Lattice(resolution), jump)
    expected = reference.trace_surfaces(rays, resolution, jump)
    assert observe(spec, [rays], window_cells) == expected


@pytest.mark.parametrize("update", BEAM_UPDATES)
@FEW
@given(drive=drives(), cells=st.sampled_from([0.25, 0.5, 2.0]))
def test_a_hit_is_moved_outward_before_anything_is_rounded(
    update: Update, drive: Drive, cells: float
) -> None:
    rays, resolution = drive
    offset = np.float32(cells * resolution)
    farther = np.where(rays.kind == Kind.HIT, rays.distance + offset, rays.distance)
    moved = rays._replace(distance=farther)
    spec = GridSpec(update, Lattice(resolution))
    assert observe(replace(spec, hit_offset=cells), [rays]) == observe(spec, [moved])


@MANY
@given(
    drive=drives(),
    jump_cells=st.sampled_from([0.0, 0.5, 4.0, 1e9]),
    border_gap=st.sampled_from([0, 1, 8]),
    window_cells=WINDOWS,
)
def test_polygon_update_follows_the_rule(
    drive: Drive, jump_cells: float, border_gap: int, window_cells: int
) -> None:
    rays, resolution = drive
    jump = jump_cells * resolution
    spec = GridSpec(Update.POLYGON, Lattice(resolution), jump, border_gap)
    expected = reference.trace_polygons(join_viewpoints(rays), resolution, jump, border_gap)
    assert observe(spec, [rays], window_cells) == expected


@pytest.mark.parametrize("update", BEAM_UPDATES)
@MANY
@given(drive=upright_drives())
def test_beams_straight_up_and_down_end_at_the_sensor(update: Update, drive: Drive) -> None:
    rays, resolution = drive
    trace = {
        Update.BEAM: reference.trace_beams,
        Update.POLYGON: reference.trace_polygons,
        Update.SURFACE: reference.trace_surfaces,
    }[update]
    seen = join_viewpoints(rays) if update is Update.POLYGON else rays
    assert observe(GridSpec(update, Lattice(resolution)), [rays]) == trace(seen, resolution)


@pytest.mark.parametrize("update", BEAM_UPDATES)
@MANY
@given(drive=aligned_drives())
def test_centres_that_lie_on_edges_and_ends_that_lie_on_borders(
    update: Update, drive: Drive
) -> None:
    rays, resolution = drive
    spec = GridSpec(update, Lattice(resolution), 2 * resolution)
    expected = {
        Update.BEAM: lambda: reference.trace_beams(rays, resolution),
        Update.POLYGON: lambda: reference.trace_polygons(rays, resolution, spec.jump),
        Update.SURFACE: lambda: reference.trace_surfaces(rays, resolution, spec.jump),
    }[update]()
    assert observe(spec, [rays]) == expected


@KINDS_OF_MAP
@FEW
@given(drive=drives(), window_cells=WINDOWS)
def test_batches_windows_and_order_change_nothing(
    kind_of_map: int, drive: Drive, window_cells: int
) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    whole = observe(spec, [rays])
    scans = range(len(rays.kind))
    for order in permutations(scans):
        assert observe(spec, [take(rays, list(order))], window_cells) == whole
    assert observe(spec, [take(rays, [s]) for s in scans], window_cells) == whole


@KINDS_OF_MAP
@FEW
@given(drive=drives())
def test_merging_equals_building_together(kind_of_map: int, drive: Drive) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    maps = [observe(spec, [take(rays, [s])]) for s in range(len(rays.kind))]
    whole = observe(spec, [rays])
    for layer in (0, 1):
        merged: Counter[reference.Cell] = Counter()
        for one in maps:  # update() keeps negative sums, which + would drop
            merged.update(one[layer])
        assert merged == whole[layer]


@KINDS_OF_MAP
@FEW
@given(
    drive=drives(resolutions=HALVES, places=(0.0,)),
    rows=st.integers(-70_000, 70_000),
    cols=st.integers(-70_000, 70_000),
)
def test_a_shift_by_whole_cells_shifts_the_map(
    kind_of_map: int, drive: Drive, rows: int, cols: int
) -> None:
    rays, resolution = drive
    # Origins on the lattice: a float has then bits enough for the sum of both.
    rays = rays._replace(origin=np.rint(rays.origin / resolution * 256) / 256 * resolution)
    spec = all_specs(resolution)[kind_of_map]
    there = observe(spec, [shift(rays, (cols * resolution, rows * resolution))])
    for layer, moved in zip(observe(spec, [rays]), there, strict=True):
        assert {(r + rows, c + cols): n for (r, c), n in layer.items()} == moved


@FEW
@given(drive=drives())
def test_two_updates_agree_on_where_something_was_hit(drive: Drive) -> None:
    rays, resolution = drive
    by_beam = observe(GridSpec(Update.BEAM, Lattice(resolution)), [rays])
    # No gap is closed, so that the border is the end cells.
    by_polygon = observe(GridSpec(Update.POLYGON, Lattice(resolution), 0.0, 0), [rays])
    if rays.origin.shape[1] == 1:
        assert by_beam.first.keys() == by_polygon.first.keys()
        scans = len(rays.kind)
        assert all(count <= scans for layer in by_polygon for count in layer.values())


def one_scan(distance: list[float], kind: list[Kind], increment: float = 0.5) -> Rays:
    """From the middle of cell (0, 0) of cells of a metre, the first beam along x."""
    beams = len(distance)
    return Rays.along(
        np.full((1, 1, 2), 0.5),
        aim(0.0, increment, beams)[None],
        np.array([distance], np.float32),
        np.array([kind], np.uint8),
        np.zeros(1, np.int64),
        full_circle=False,
    )


@KINDS_OF_MAP
def test_skipped_beams_leave_no_trace(kind_of_map: int) -> None:
    rays = one_scan([0.0, 0.0, 0.0], [Kind.SKIP] * 3)
    assert observe(all_specs(1.0)[kind_of_map], [rays]) == (Counter(), Counter())


@pytest.mark.parametrize("update", BEAM_UPDATES)
@pytest.mark.parametrize("distance", [0.0, 0.3])
def test_a_hit_in_the_sensors_own_cell_is_one_hit(update: Update, distance: float) -> None:
    rays = one_scan([distance], [Kind.HIT])
    spec = GridSpec(update, Lattice(1.0))
    lone = 2 if update is Update.SURFACE else 1  # of the 8 that one among its neighbours weighs
    assert observe(spec, [rays]) == ({(0, 0): lone}, {})


def test_free_beam_of_no_length_is_one_miss_by_beam_and_nothing_by_polygon() -> None:
    rays = one_scan([0.0], [Kind.FREE])
    assert observe(GridSpec(Update.BEAM, Lattice(1.0)), [rays]) == ({}, {(0, 0): 1})
    assert observe(GridSpec(Update.POLYGON, Lattice(1.0)), [rays]) == ({}, {})


def test_every_beam_counts_by_beam_and_every_scan_by_polygon() -> None:
    rays = one_scan([3.0] * 3, [Kind.HIT] * 3, increment=0.01)
    assert observe(GridSpec(Update.BEAM, Lattice(1.0)), [rays]) == (
        {(0, 3): 3},
        {(0, 0): 3, (0, 1): 3, (0, 2): 3},
    )
    assert observe(GridSpec(Update.POLYGON, Lattice(1.0)), [rays]).first == {(0, 3): 1}


def make_engine(update: Update = Update.BEAM, resolution: float = 0.05) -> GridEngine:
    return GridEngine(GridSpec(update, Lattice(resolution)))


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_a_wild_pose_costs_only_the_tiles_that_it_touches(update: Update) -> None:
    near = one_scan([3.0] * 3, [Kind.HIT] * 3)
    origin = np.concatenate([near.origin, near.origin + 1e7, near.origin])
    rays = Rays(
        origin,
        np.repeat(near.turn, 3, axis=0),
        near.bearing,
        np.repeat(near.distance, 3, axis=0),
        np.repeat(near.kind, 3, axis=0),
        np.repeat(near.stamp_ns, 3),
        near.full_circle,
    )
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
    rays = Rays.along(
        origin=np.array([[[0.5, TILE]]]),
        direction=np.array([[[1.0, 0.001], [1.0, -0.001]] * 64]),
        distance=np.full((1, 128), 900, np.float32),
        kind=np.full((1, 128), Kind.FREE, np.uint8),
        stamp_ns=np.zeros(1, np.int64),
        full_circle=False,
    )
    engine = GridEngine(GridSpec(Update.BEAM, Lattice(1.0)), window_cells=most)
    engine.add(rays)
    assert windows
    assert max(windows) <= most
    assert read_cells(engine.finish()) == reference.trace_beams(rays, 1.0)


def test_a_beam_that_is_too_long_is_refused_with_what_to_do() -> None:
    rays = one_scan([3e6], [Kind.HIT])
    with pytest.raises(MapError) as caught:
        make_engine().add(rays)
    assert str(caught.value) == (
        "a beam of 3e+06 m is too long for cells of 0.05 m; limit ranges with `max_range`, or use "
        "a coarser `resolution`"
    )


def test_the_longest_beam_is_what_an_int32_holds() -> None:
    # 2**22 cells of 2**8 units, from a sensor half as far from the anchor: 1.5 x 2**30 units, while
    # the next power of two, 3 x 2**30, is beyond 2**31.
    spec = GridSpec(Update.BEAM, Lattice(1.0))
    prepare(one_scan([4_194_304.0], [Kind.HIT]), spec)
    with pytest.raises(MapError, match="is too long for cells of 1"):
        prepare(one_scan([4_194_305.0], [Kind.HIT]), spec)


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_a_scan_that_could_make_a_cell_overflow_is_refused(update: Update) -> None:
    beams = 2**20
    rays = one_scan([1.0] * beams, [Kind.HIT] * beams)
    surest = tabulate(lambda u: 0 * u, lambda w: 1 + 0 * w, 1.0)
    with pytest.raises(MapError, match="a scan of 1048576 beams is more than this model can count"):
        GridEngine(replace(radial_tables(0.5), update=update, radial=surest)).add(rays)


@pytest.mark.parametrize("update", BEAM_UPDATES)
@pytest.mark.parametrize("metres", [1e12, 1e300, -1e300, float("inf"), float("nan")])
def test_a_sensor_that_is_too_far_away_is_refused(update: Update, metres: float) -> None:
    rays = one_scan([3.0, 3.0], [Kind.HIT] * 2)
    with pytest.raises(MapError, match=r"is too far away for cells of 0\.05 m; if a pose is wrong"):
        make_engine(update).add(shift(rays, (0.0, metres)))


def test_cells_that_are_too_small_are_refused() -> None:
    rays = one_scan([3.0, 3.0], [Kind.HIT] * 2)
    with pytest.raises(MapError, match="use a coarser `resolution`"):
        make_engine(resolution=1e-9).add(rays)
    for resolution in (9e-10, 1e-300, 5e-324):
        with pytest.raises(UsageError, match="is not possible"):
            make_engine(resolution=resolution)


@KINDS_OF_MAP
def test_threads_give_the_same_sums(kind_of_map: int) -> None:
    rng = np.random.default_rng(5)
    batches = [
        Rays.along(
            rng.uniform(-2, 2, (4, 1, 2)),
            np.repeat(aim(-1.0, 0.02, 100)[None], 4, axis=0),
            rng.uniform(0.5, 8, (4, 100)).astype(np.float32),
            rng.choice(np.array(Kind, np.uint8), (4, 100)),
            np.zeros(4, np.int64),
            full_circle=False,
        )
        for _ in range(12)
    ]
    spec = all_specs(0.05)[kind_of_map]
    expected = observe(spec, batches)
    engine = GridEngine(spec, window_cells=1 << 16)

    def work(mine: list[Rays]) -> None:
        for rays in mine:
            engine.add(rays)

    threads = [Thread(target=work, args=(batches[i::4],)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert read_cells(engine.finish()) == expected


def test_more_may_be_added_after_the_evidence_was_read() -> None:
    rays = one_scan([3.0], [Kind.HIT])
    engine = make_engine(resolution=1.0)
    engine.add(rays)
    once = read_cells(engine.finish())
    engine.add(rays)
    twice = read_cells(engine.finish())
    assert once.first == {(0, 3): 1}
    assert twice == tuple({cell: 2 * n for cell, n in layer.items()} for layer in once)


@FEW
@given(drive=drives())
def test_joined_viewpoints_leave_the_ends_where_they_are(drive: Drive) -> None:
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


@pytest.mark.parametrize("kind_of_map", [0, 1, 4, 5])
def test_few_scans_and_many_observe_the_same(kind_of_map: int) -> None:
    """Few scans of a place visit its cells, and many note changes: each scan adds the same."""
    rng = np.random.default_rng(7)
    rays = Rays.along(
        rng.uniform(-1, 1, (40, 1, 2)),
        np.repeat(aim(-1.0, 0.005, 400)[None], 40, axis=0),
        rng.uniform(0.5, 8, (40, 400)).astype(np.float32),
        rng.choice(np.array(Kind, np.uint8), (40, 400)),
        np.zeros(40, np.int64),
        full_circle=False,
    )
    spec = all_specs(0.05)[kind_of_map]
    one_by_one = [rays.take(slice(s, s + 1)) for s in range(40)]
    kinds = [{type(choose(spec, some)) for some in batches} for batches in ([rays], one_by_one)]
    assert kinds[0] != kinds[1]
    assert observe(spec, [rays]) == observe(spec, one_by_one)


def choose(spec: GridSpec, rays: Rays) -> Window:
    """The window that some rays are traced in."""
    beams = project(rays, spec)
    return choose_windows(spec, beams)[0](spec, beams.box)
