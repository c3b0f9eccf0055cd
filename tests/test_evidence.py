"""Saved evidence: parts add up to the whole, cell by cell, and maps come out of it unchanged."""

import hashlib
import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from occmap.batching import Selection
from occmap.errors import MapError
from occmap.evidence import Box, RenderOptions, crop, publish, render_saved
from occmap.grid.layers import unpack_cells
from occmap.manifest import describe_files
from occmap.merging import merge, subtract
from occmap.pipeline import BuildOptions, build
from occmap.posing.options import PosingOptions
from occmap.sensor.models import parse_model
from occmap.sensor.returns import ReturnCounts
from occmap.types import Evidence, Int64, OccupancyMap, Times, Update
from occmap.writers.npz import NpzWriter, read_evidence
from tests.samples import REAL_LOGS, SAMPLE_LOGS

DRIVE = SAMPLE_LOGS / "drive.csv"
COMBINATIONS = list(product(Update, ["simple", "quadratic", "counting"]))
each_combination = pytest.mark.parametrize(("update", "model"), COMBINATIONS)
MIDDLE_S = 20.0005


def choose(update: Update = Update.BEAM, model: str = "simple", jobs: int = 1) -> BuildOptions:
    return BuildOptions(update=update, model=parse_model(model), jobs=jobs)


def save(path: Path, options: BuildOptions, log: Path = DRIVE) -> Evidence:
    build([log], options, [path])
    return read_evidence(path)


def halve(options: BuildOptions, middle: float = MIDDLE_S) -> tuple[BuildOptions, BuildOptions]:
    """Two builds of one log: what comes before a time, and what after."""
    return (
        replace(options, selection=Selection(end_s=middle)),
        replace(options, selection=Selection(start_s=middle)),
    )


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


def write_bytes(folder: Path, evidence: Evidence) -> bytes:
    path = folder / "written.npz"
    NpzWriter().write_evidence(path, evidence)
    return path.read_bytes()


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


@each_combination
def test_a_rendered_map_is_the_one_that_was_built(
    tmp_path: Path, update: Update, model: str
) -> None:
    options = choose(update, model)
    built = build([DRIVE], options, [tmp_path / "m.npz", tmp_path / "m.pgm"])
    evidence = read_evidence(tmp_path / "m.npz")
    report = publish(evidence, RenderOptions(), [tmp_path / "r.pgm", tmp_path / "again.npz"])
    assert (tmp_path / "r.pgm").read_bytes() == (tmp_path / "m.pgm").read_bytes()
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "m.npz").read_bytes()
    expected = replace(built.report, logs=("drive.csv",), files=report.files, seconds={}, notes=())
    assert report == expected


@pytest.mark.parametrize(
    ("model", "other"),
    [
        ("simple", "counting"),
        ("counting", "simple:p_hit=0.9,p_miss=0.3,prior=0.4"),
        ("quadratic", "quadratic:prior=0.3"),
    ],
)
def test_another_model_renders_what_a_build_with_it_would(
    tmp_path: Path, model: str, other: str
) -> None:
    evidence = save(tmp_path / "m.npz", choose(model=model))
    expected = build([DRIVE], choose(model=other)).map
    grid = render_saved(evidence, parse_model(other), 10**9)
    assert np.array_equal(grid.log_odds, expected.log_odds)
    assert (grid.origin, grid.resolution) == (expected.origin, expected.resolution)


@pytest.mark.parametrize("jobs", [2, 5])
def test_the_file_is_the_same_with_any_number_of_threads(tmp_path: Path, jobs: int) -> None:
    save(tmp_path / "one.npz", choose())
    save(tmp_path / "many.npz", choose(jobs=jobs))
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "many.npz").read_bytes()


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


def test_the_manifest_says_what_was_used(tmp_path: Path) -> None:
    poses = tmp_path / "p.csv"
    poses.write_text("stamp,x,y,yaw\n0,0,0,0\n2000000000,0,0,0\n")
    options = replace(choose(jobs=2), posing=PosingOptions(poses=str(poses), max_pose_gap_s=None))
    manifest = save(tmp_path / "m.npz", options).manifest
    assert (manifest.resolution, manifest.update, manifest.kind) == (0.05, "beam", "counts")
    (made,) = manifest.builds
    content = DRIVE.read_bytes()
    assert made["inputs"][0] == {
        "name": "drive.csv",
        "bytes": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    assert [entry["name"] for entry in made["inputs"]] == ["drive.csv", "p.csv"]
    assert made["options"]["posing"]["poses"] == "p.csv"
    assert made["options"]["returns"]["max_range"] == str(math.inf)
    assert made["options"]["model"] == "simple:p_hit=0.7,p_miss=0.4,prior=0.5"
    assert "jobs" not in made["options"]
    assert made["scans"]["read"] == made["scans"]["used"] + sum(made["scans"]["dropped"].values())


def test_every_file_of_a_folder_is_named() -> None:
    names = [entry["name"] for entry in describe_files(SAMPLE_LOGS / "drive_ros2")]
    assert "drive_ros2/metadata.yaml" in names
    assert len(names) == 2


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


@pytest.mark.parametrize(
    ("made_by", "wanted", "found"),
    [
        ("simple", "quadratic", "holds hits and misses, .*; build it with --model quadratic"),
        ("quadratic", "simple", "the model quadratic:epsilon=0.0,p_min=0.4; no other"),
        ("quadratic", "quadratic:epsilon=0.1", "no other can read it; leave out --model"),
    ],
)
def test_a_model_that_cannot_read_it_is_refused(
    tmp_path: Path, made_by: str, wanted: str, found: str
) -> None:
    evidence = save(tmp_path / "m.npz", choose(model=made_by))
    with pytest.raises(MapError, match=rf"m.npz: .*{found}"):
        render_saved(evidence, parse_model(wanted), 10**9)


@pytest.mark.parametrize(
    ("box", "rows", "cols", "origin"),
    [
        ((0.1, -0.05, 0.25, 0.05), slice(0, 2), slice(1, 4), (0.1, -0.05)),  # edges of cells
        ((0.11, 0.01, 0.12, 0.02), slice(1, 2), slice(1, 2), (0.1, 0.0)),  # within a cell
        ((-9.0, -9.0, 9.0, 9.0), slice(0, 3), slice(0, 4), (0.05, -0.05)),  # all
    ],
)
def test_a_crop_is_the_cells_that_the_box_touches(
    box: Box, rows: slice, cols: slice, origin: tuple[float, float]
) -> None:
    log_odds = np.arange(12, dtype=np.float32).reshape(3, 4)
    grid = OccupancyMap(log_odds, log_odds > 0, 0.05, (0.05, -0.05))
    part = crop(grid, box)
    assert np.array_equal(part.log_odds, log_odds[rows, cols])
    assert np.array_equal(part.observed, log_odds[rows, cols] > 0)
    assert part.origin == pytest.approx(origin)


def test_a_crop_beside_the_map_is_refused() -> None:
    grid = OccupancyMap(np.zeros((2, 2), np.float32), np.ones((2, 2), np.bool_), 0.5, (0.0, 0.0))
    with pytest.raises(MapError, match="in --crop; the map's own box is 0, 0, 1, 1"):
        crop(grid, (1.0, 0.0, 2.0, 1.0))


def test_a_report_sums_up_what_an_older_occmap_counted(tmp_path: Path) -> None:
    evidence = save(tmp_path / "m.npz", choose())
    (made,) = evidence.manifest.builds
    older = {**made, "scans": {**made["scans"], "beams": {"hit": 5, "lost": 7}}}
    manifest = replace(evidence.manifest, builds=(older, older))
    report = publish(replace(evidence, manifest=manifest), RenderOptions(), [tmp_path / "m.pgm"])
    assert report.beams == ReturnCounts(hit=10)
    assert report.scans_used == 2 * made["scans"]["used"]
    assert report.notes == ("drive.csv is in it twice",)


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
