"""Evidence added up and taken apart: parts make the whole, cell by cell, and come out again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.batching import Selection
from occmap.errors import MapError
from occmap.evidence.merging import merge, subtract
from occmap.evidence.publishing import RenderOptions, publish
from occmap.grid.layers import unpack_cells
from occmap.pipeline import BuildOptions, build
from occmap.types import Int64, Times, Update
from occmap.writers.npz import read_evidence
from tests.evidence.saving import (
    COMBINATIONS,
    DRIVE,
    MIDDLE_S,
    choose,
    each_combination,
    halve,
    save,
    write_bytes,
)
from tests.samples import REAL_LOGS


def test_neither_half_is_empty() -> None:
    first, second = (build([DRIVE], each).report for each in halve(choose()))
    assert min(first.scans_used, second.scans_used) > 20


@each_combination
def test_two_halves_make_the_whole(tmp_path: Path, update: Update, model: str) -> None:
    options = choose(update, model)
    first, second = (save(tmp_path / "half.npz", each) for each in halve(options))
    whole = save(tmp_path / "whole.npz", options)
    for both in (merge([first, second]), merge([second, first])):
        assert np.array_equal(both.tiles, whole.tiles)
        assert np.array_equal(both.cells, whole.cells)
    rest = subtract(merge([first, second]), second)
    assert np.array_equal(rest.tiles, first.tiles)
    assert np.array_equal(rest.cells, first.cells)
    assert rest.manifest == first.manifest
    assert merge([first, second]).times == first.times + second.times
    assert write_bytes(tmp_path, rest) == write_bytes(tmp_path, first)


def spread(times: Times) -> dict[str, Int64]:
    """(T, 64, 64) of each of a layer's four numbers, 0 where it has none."""
    cells = unpack_cells(times)
    tables = {}
    for name in ("first_ns", "last_ns", "hit_visits", "seen_visits"):
        tables[name] = np.zeros(cells.shape, np.int64)
        tables[name][cells] = getattr(times, name)
    return tables


@each_combination
def test_the_layers_of_two_halves_bound_the_times_of_the_whole(
    tmp_path: Path, update: Update, model: str
) -> None:
    options = choose(update, model)
    halves = [save(tmp_path / "half.npz", each) for each in halve(options)]
    (whole,) = save(tmp_path / "whole.npz", options).times
    first, second = (fit_tiles(half.times[0], whole) for half in halves)
    cells, before, after = (unpack_cells(each) for each in (whole, first, second))
    assert np.array_equal(before | after, cells)
    early, late, all_of_it = spread(first), spread(second), spread(whole)
    since = np.where(before, early["first_ns"], late["first_ns"])
    until = np.where(after, late["last_ns"], early["last_ns"])
    assert np.array_equal(all_of_it["first_ns"], since)
    assert np.array_equal(all_of_it["last_ns"], until)
    for name in ("hit_visits", "seen_visits"):  # a visit may go on over the middle
        apart = early[name] + late[name] - all_of_it[name]
        assert set(np.unique(apart)) <= {0, 1}
    assert all_of_it["hit_visits"].any() == (model != "quadratic")


def fit_tiles(times: Times, whole: Times) -> Times:
    """The same layer with a row of cells for each tile of another."""
    mine = map(tuple, times.tiles.tolist())
    known = dict(zip(mine, times.observed, strict=True))
    empty = np.zeros(512, np.uint8)
    observed = np.array([known.get(tuple(tile), empty) for tile in whole.tiles.tolist()])
    assert known.keys() <= set(map(tuple, whole.tiles.tolist()))
    return replace(times, tiles=whole.tiles, observed=observed)


def test_what_was_no_build_leaves_layers_that_are_bounds(tmp_path: Path) -> None:
    whole, part = (save(tmp_path / "m.npz", each) for each in (choose(), halve(choose())[0]))
    rest = subtract(whole, part)
    (layer,), (before,) = rest.times, whole.times
    seen = (rest.cells != 0).any(axis=1)
    assert np.array_equal(layer.tiles, rest.tiles)
    assert np.array_equal(unpack_cells(layer), seen)
    assert 0 < len(layer.first_ns) < len(before.first_ns)
    assert rest.manifest.builds == whole.manifest.builds
    note = "something else than a whole build was subtracted: times and visits are bounds"
    assert note in publish(rest, RenderOptions(), [tmp_path / "m.pgm"]).notes
    assert publish(whole, RenderOptions(), [tmp_path / "m.pgm"]).notes == ()


def test_a_build_that_is_there_only_in_part_takes_no_layer_away(tmp_path: Path) -> None:
    options = choose()
    whole = save(tmp_path / "whole.npz", options)
    half, quarter = (
        save(tmp_path / "m.npz", replace(options, selection=Selection(end_s=end)))
        for end in (MIDDLE_S, MIDDLE_S / 2)
    )
    part_of_half = subtract(half, quarter)
    rest = subtract(merge([whole, half]), part_of_half)
    assert rest.manifest.builds == whole.manifest.builds + half.manifest.builds
    assert rest.manifest.subtracted == half.manifest.builds
    assert [len(each.first_ns) for each in rest.times] == [
        len(each.times[0].first_ns) for each in (whole, half)
    ]


@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_a_build_resumes(tmp_path: Path, model: str) -> None:
    options = choose(model=model)
    path = tmp_path / "m.npz"
    first, second = halve(options)
    save(path, first)
    resumed = build([DRIVE], replace(second, resume=path), [path])
    whole = save(tmp_path / "whole.npz", options)
    assert np.array_equal(read_evidence(path).cells, whole.cells)
    parts = merge([save(tmp_path / "half.npz", each) for each in (first, second)])
    assert path.read_bytes() == write_bytes(tmp_path, parts)
    assert np.array_equal(resumed.map.log_odds, build([DRIVE], options).map.log_odds)
    assert len(read_evidence(path).manifest.builds) == 2


def test_resuming_with_other_options_is_refused_before_the_log_is_read(tmp_path: Path) -> None:
    save(tmp_path / "m.npz", choose())
    options = replace(choose(), resolution=0.1, resume=tmp_path / "m.npz")
    with pytest.raises(MapError, match=r"m.npz: its resolution is 0.05, .* is 0.1"):
        build([tmp_path / "nothing.csv"], options)


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (replace(choose(), resolution=0.1), "its resolution is 0.1, .* is 0.05"),
        (choose(Update.POLYGON), "its update is polygon, .* is beam"),
        (choose(model="quadratic"), "its kind is log_odds, .* is counts"),
    ],
)
def test_evidence_that_does_not_add_up_is_refused(
    tmp_path: Path, options: BuildOptions, found: str
) -> None:
    first = save(tmp_path / "a.npz", choose())
    second = save(tmp_path / "b.npz", options)
    refused = rf"b.npz: {found}; build both with the same options"
    with pytest.raises(MapError, match=refused):
        merge([first, second])
    with pytest.raises(MapError, match=refused):
        subtract(first, second)


def test_radial_evidence_of_two_depths_is_refused(tmp_path: Path) -> None:
    first = save(tmp_path / "a.npz", choose(model="quadratic"))
    second = save(tmp_path / "b.npz", choose(model="quadratic:epsilon=0.1"))
    with pytest.raises(MapError, match=r"b.npz: its profile is quadratic:epsilon=0.1,p_min=0.4, "):
        merge([first, second])


@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_more_than_is_there_cannot_be_taken_away(tmp_path: Path, model: str) -> None:
    first, second = (save(tmp_path / "m.npz", each) for each in halve(choose(model=model)))
    with pytest.raises(MapError, match=r"holds observations of \d+ cells that .* lacks; subtract"):
        subtract(first, second)


def test_nothing_left_is_no_map(tmp_path: Path) -> None:
    whole = save(tmp_path / "m.npz", choose())
    nothing = subtract(whole, whole)
    assert (len(nothing.tiles), nothing.manifest.builds) == (0, ())
    with pytest.raises(MapError, match="observed a cell"):
        publish(nothing, RenderOptions(), [tmp_path / "m.pgm"])
    assert not (tmp_path / "m.pgm").exists()


@pytest.mark.skipif(not REAL_LOGS.is_dir(), reason=f"no real logs in {REAL_LOGS}")
@pytest.mark.parametrize(
    ("name", "middle"),
    [("carmen/intel-corrected.log.gz", 1000.00005), ("ros1/test_turtlebot.bag", 10.00005)],
)
@pytest.mark.parametrize(("update", "model"), [COMBINATIONS[0], COMBINATIONS[4]])
def test_two_halves_of_a_real_log_make_the_whole(
    tmp_path: Path, name: str, middle: float, update: Update, model: str
) -> None:
    log, options = REAL_LOGS / name, choose(update, model)
    halves = [save(tmp_path / "half.npz", each, log) for each in halve(options, middle)]
    assert min(half.manifest.builds[0]["scans"]["used"] for half in halves) > 100
    whole = save(tmp_path / "whole.npz", options, log)
    both = merge(halves)
    assert np.array_equal(both.tiles, whole.tiles)
    assert np.array_equal(both.cells, whole.cells)
    publish(both, RenderOptions(), [tmp_path / "both.pgm"])
    publish(whole, RenderOptions(), [tmp_path / "whole.pgm"])
    assert (tmp_path / "both.pgm").read_bytes() == (tmp_path / "whole.pgm").read_bytes()
    rest = subtract(both, halves[1])
    assert write_bytes(tmp_path, rest) == write_bytes(tmp_path, halves[0])
