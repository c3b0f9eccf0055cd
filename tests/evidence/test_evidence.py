"""Saved evidence: maps come out of it unchanged, what it was made of, and hits that last."""

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap import Map, build_map, merge
from occmap.cells import Manifest, Slices
from occmap.errors import MapError
from occmap.evidence import find_lasting, list_misfit, measure_conflict, weigh
from occmap.evidence.manifest import list_doubts, list_repeated
from occmap.grid.tiles import TILE, EvidenceKind, TileGrid, pack_bits
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.sensor import ReturnCounts, ReturnOptions
from occmap.sensor.models import CountingModel, QuadraticModel, SimpleModel, parse_model
from occmap.store import Blocks, read_all
from occmap.store.painting import RenderOptions, open_map, publish, render_saved
from occmap.types import Update
from occmap.writers import DEFAULT_THRESHOLDS
from occmap.writers.npz import read_evidence
from tests.cli.runner import occmap
from tests.csv_logs import write_scans
from tests.evidence.saving import DRIVE, MIDDLE_S, choose, each_combination, hold, save
from tests.grid.scans import are_equal, make_grid
from tests.samples import DRIVES, PLAIN, PLAIN_WORDS, import_generator, write_csv
from tests.tuning.simulated import write_parts


@each_combination
def test_a_rendered_map_is_the_one_that_was_built(
    tmp_path: Path, update: Update, model: str
) -> None:
    options = choose(update, model)
    built = build([DRIVE], options, [tmp_path / "m.npz", tmp_path / "m.pgm"])
    evidence = read_evidence(tmp_path / "m.npz")
    report = publish(
        Blocks.of(evidence), RenderOptions(), [tmp_path / "r.pgm", tmp_path / "again.npz"]
    )
    assert (tmp_path / "r.pgm").read_bytes() == (tmp_path / "m.pgm").read_bytes()
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "m.npz").read_bytes()
    expected = replace(built.report, logs=("drive.csv",), files=report.files, seconds={}, notes=())
    assert report == expected


@pytest.mark.parametrize(
    ("model", "other"),
    [
        ("simple", "counting"),
        ("counting", "simple:p_hit=0.9,p_miss=0.3,prior=0.4"),
        ("quadratic", "quadratic:prior=0.45"),
    ],
)
def test_another_model_renders_what_a_build_with_it_would(
    tmp_path: Path, model: str, other: str
) -> None:
    evidence = save(tmp_path / "m.npz", choose(model=model))
    expected = build([DRIVE], choose(model=other)).map
    grid = render_saved(Blocks.of(evidence), RenderOptions(parse_model(other))).grid
    assert np.array_equal(grid.log_odds, expected.log_odds)
    assert (grid.origin, grid.resolution) == (expected.origin, expected.resolution)


@each_combination
def test_bounds_are_set_where_a_map_is_rendered(tmp_path: Path, update: Update, model: str) -> None:
    evidence = save(tmp_path / "m.npz", choose(update, model))
    bounded = choose(update, f"{model}:clamp_min=0.2,clamp_max=0.9")
    grid, plain = (
        render_saved(Blocks.of(evidence), RenderOptions(each.model)).grid
        for each in (bounded, choose(update, model))
    )
    expected = np.where(plain.observed, np.clip(plain.log_odds, -math.log(4), math.log(9)), 0)
    np.testing.assert_array_equal(grid.log_odds, expected.astype(np.float32))
    assert 0 < np.count_nonzero(grid.log_odds != plain.log_odds) < np.count_nonzero(plain.observed)
    again = save(tmp_path / "bounded.npz", bounded)
    assert are_equal(again.tiles, evidence.tiles)
    assert again.manifest.profile == evidence.manifest.profile


def test_bounds_are_of_probability_and_leave_what_is_between() -> None:
    model = SimpleModel(p_hit=0.75, p_miss=0.25, clamp_min=0.2, clamp_max=0.9)
    hits, misses = np.array([0, 1, 2, 3, 0, 0]), np.array([0, 0, 0, 0, 1, 2])
    expected = [0, math.log(3), math.log(9), math.log(9), -math.log(3), -math.log(4)]
    np.testing.assert_allclose(weigh(model, hits, misses), expected, rtol=1e-12)


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
    assert made["options"]["model"] == "simple:p_hit=0.7,p_miss=0.4,prior=0.5,cut=0.5,spread=0.08"
    assert "jobs" not in made["options"]
    assert made["scans"]["read"] == made["scans"]["used"] + sum(made["scans"]["dropped"].values())


@pytest.mark.parametrize(
    ("made_by", "wanted", "found"),
    [
        ("simple", "quadratic", "holds hits and misses, .*; build it with `model=quadratic`"),
        ("quadratic", "simple", "the model quadratic:epsilon=0.0,p_min=0.4; no other"),
        ("quadratic", "quadratic:epsilon=0.1", "no other can read it; leave out `model`"),
    ],
)
def test_a_model_that_cannot_read_it_is_refused(
    tmp_path: Path, made_by: str, wanted: str, found: str
) -> None:
    evidence = save(tmp_path / "m.npz", choose(model=made_by))
    with pytest.raises(MapError, match=rf"m.npz: .*{found}"):
        render_saved(Blocks.of(evidence), RenderOptions(parse_model(wanted)))


def test_a_report_sums_up_what_an_older_occmap_counted(tmp_path: Path) -> None:
    evidence = save(tmp_path / "m.npz", choose())
    (made,) = evidence.manifest.builds
    older = {**made, "scans": {**made["scans"], "beams": {"hit": 5, "lost": 7}}}
    manifest = replace(evidence.manifest, builds=(older, older))
    report = publish(
        Blocks.of(replace(evidence, manifest=manifest)), RenderOptions(), [tmp_path / "m.pgm"]
    )
    assert report.beams == ReturnCounts(hit=10)
    assert report.scans.used == 2 * made["scans"]["used"]
    (note,) = report.notes
    assert note.startswith("drive.csv is in it more than once")


def test_each_observation_adds_what_it_says_beyond_the_prior_by_hand() -> None:
    """Three observations, and one, from a prior of 0.2 (Thrun, Burgard, Fox 2005, ch. 9).

    The prior's odds are 1/4. Observations of odds 3, 3 and 1/2 multiply them by odds over odds of
    the prior: 1/4 * 12 * 12 * 2 = 72. One that says no more than the prior changes nothing.
    """
    model = parse_model("quadratic:prior=0.2,p_min=0.1")
    log_odds = np.array([math.log(3) + math.log(3) + math.log(1 / 2), math.log(1 / 4)])
    sums, observations = np.rint(log_odds * 65536), np.array([3.0, 1.0])
    odds = np.exp(weigh(model, sums, observations))
    np.testing.assert_allclose(odds, [72, 1 / 4], rtol=2e-5)


Chosen = dict[str, Any]
"""Which scans of a log a build takes"""
ALL = {"topics": [], "start_s": "-inf", "end_s": "inf", "stride": 1}


def build_of(*names: str, poses: str | None = None, **selection: Any) -> dict[str, Any]:
    """A build of files, each with its name for a hash, of which the last may be a trajectory."""
    inputs = [{"name": name, "sha256": f"sha of {name}"} for name in names]
    return {"inputs": inputs, "options": {"selection": ALL | selection, "posing": {"poses": poses}}}


def name_repeated(*builds: dict[str, Any]) -> list[str]:
    """The logs that count more than once."""
    return [note.partition(" is in it more than once")[0] for note in list_repeated(builds)]


@pytest.mark.parametrize(
    ("one", "other", "is_shared"),
    [
        ({}, {}, True),
        ({"end_s": 40.0}, {"end_s": 40.0}, True),
        ({"stride": 2}, {"stride": 2}, True),
        ({}, {"end_s": 40.0}, True),
        ({"end_s": 40.0}, {"start_s": 39.9}, True),
        ({}, {"stride": 2}, True),
        ({}, {"topics": ["/a"]}, True),
        ({"topics": ["/a", "/b"]}, {"topics": ["/b"]}, True),
        ({"end_s": 40.0}, {"start_s": 40.0}, False),  # the end is outside
        ({"start_s": 10, "end_s": 20}, {"start_s": 30}, False),
        ({"topics": ["/a"]}, {"topics": ["/b"]}, False),
        ({"stride": 2}, {"stride": 2, "start_s": 0.1}, False),  # they may take turns
    ],
)
def test_shared_scans_count_twice(one: Chosen, other: Chosen, is_shared: bool) -> None:
    for first, second in ((one, other), (other, one)):
        builds = [build_of("a.csv", "b.csv", **first), build_of("b.csv", "c.csv", **second)]
        assert name_repeated(*builds) == (["b.csv"] if is_shared else [])


def test_one_note_names_all_logs_that_count_twice() -> None:
    builds = [build_of(*(f"{day}.csv" for day in range(30)))] * 2
    (note,) = list_repeated(builds)
    assert note.startswith("0.csv, 1.csv, 2.csv, 3.csv, 4.csv, 5.csv and 24 more are in it more")


def test_clouds_that_were_cut_at_other_heights_are_noted() -> None:
    builds = [build_of("a.bag"), build_of("b.bag")]
    for made, height in zip(builds, (1.5, 0.5), strict=True):
        made["options"]["clouds"] = {"min_height": 0.1, "max_height": height}
    manifest = Manifest(0.05, "cloud", "counts", "", 10.0, 0.5, "counting", tuple(builds))
    assert list(list_doubts(manifest)) == ["its builds differ in `max_height` (0.5, 1.5)"]


def test_a_log_is_named_once_and_a_folder_is_one_log() -> None:
    twice, part = build_of("a.csv", "a.csv"), build_of("a.csv", end_s=40.0)
    assert name_repeated() == name_repeated(part) == []
    assert name_repeated(twice, twice, part) == ["a.csv"]
    names = "day/day_0.mcap", "day/metadata.yaml"
    assert name_repeated(*[build_of(*names)] * 8) == ["day"]
    assert name_repeated(build_of(*names), build_of(names[0], "day/metadata2.yaml")) == ["day"]


def test_equal_files_of_a_folder_count_once_for_each_time_that_it_is_given() -> None:
    """As the clouds of a sensor that stands still."""
    (entry,) = build_of("clouds/0.pcd")["inputs"]
    once, twice = build_of(), build_of()
    once["inputs"] = [entry, entry | {"name": "clouds/1.pcd"}]
    twice["inputs"] = 2 * once["inputs"]
    assert name_repeated(once) == []
    assert name_repeated(twice) == name_repeated(once, once) == ["clouds"]


def test_logs_that_share_a_trajectory_are_not_the_same() -> None:
    builds = [build_of(name, "path.txt", poses="path.txt") for name in ("a.csv", "b.csv")]
    assert name_repeated(*builds) == []


RULE = CountingModel(spread=0.0)
ELSEWHERE = (3.0, 1.0, 0.4)


def lay(*cells: tuple[int, int], kind: EvidenceKind = EvidenceKind.COUNTS) -> TileGrid:
    """Cells beside each other, with these hits and misses."""
    return make_grid({(0, col): pair for col, pair in enumerate(cells)}, 0.05, kind)


def test_the_share_of_each_part_counts_as_much_as_the_other() -> None:
    """Hits that are two cells from the other's wall are none that it contradicts."""
    one = lay((8000, 0), *[(0, 50)] * 6)
    other = lay((100, 0), (0, 50), (100, 0), *[(0, 50)] * 3, (300, 0))
    assert measure_conflict(one, other.tiles, RULE) == (0 / 8000 + 300 / 500) / 2
    assert not list(list_misfit(one, other.tiles, RULE, "it"))
    (note,) = list_misfit(one, lay(*[(0, 50)] * 6, (300, 0)).tiles, RULE, "it")
    assert note.startswith("does not fit it: of the hits in cells that both saw, 100% lie where")


def test_little_and_sums_of_log_odds_are_not_judged() -> None:
    few, summed = [(199, 0), *[(0, 400)] * 6], [(400, 9), *[(-400, 9)] * 6]
    one, other = lay(*few), lay(*few[::-1])
    assert measure_conflict(one, other.tiles, RULE) == measure_conflict(one, {}, RULE) == 0
    one, other = (lay(*each, kind=EvidenceKind.LOG_ODDS) for each in (summed, summed[::-1]))
    assert measure_conflict(one, other.tiles, QuadraticModel()) == 0


def keep_misfits(grid: Map) -> list[str]:
    return [note for note in grid.report.notes if "does not fit" in note]


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two halves of a drive, and the drive where it would be were the map's frame elsewhere."""
    folder = tmp_path_factory.mktemp("parts")
    build_map(DRIVE, end_s=MIDDLE_S, outputs=folder / "a.npz")
    build_map(DRIVE, start_s=MIDDLE_S, outputs=folder / "b.npz")
    build_map(DRIVE, transform=ELSEWHERE, outputs=folder / "moved.npz")
    return folder


def test_merged_evidence_that_does_not_fit_is_named(parts: Path) -> None:
    assert not keep_misfits(merge(parts / "a.npz", parts / "b.npz"))
    (note,) = keep_misfits(merge(parts / "a.npz", parts / "b.npz", parts / "moved.npz"))
    assert note.startswith(f"{parts / 'moved.npz'}: does not fit the evidence before it")


def test_a_build_does_not_fit_what_it_is_added_to(parts: Path) -> None:
    past = parts / "a.npz"
    assert not keep_misfits(build_map(DRIVE, start_s=MIDDLE_S, resume=past))
    (note,) = keep_misfits(build_map(DRIVE, transform=ELSEWHERE, resume=past))
    assert note.startswith(f"{DRIVE}: does not fit the evidence before it")


def test_a_log_that_does_not_fit_those_before_it_is_named(tmp_path: Path) -> None:
    """The second log has a frame of its own, turned by a right angle."""
    assert not keep_misfits(build_map(*DRIVES[:2]))
    (moved,) = write_parts(tmp_path, [0.0], scans=414)
    (note,) = keep_misfits(build_map(DRIVE, moved))
    assert note.startswith(f"{moved}: does not fit the logs before it")


office = import_generator("office")
BEAMS, FIRST, STEP = 80, -19.75, 0.5
"""Degrees: a narrow view ahead, in which no beam runs along a wall."""
BEARINGS = np.radians(FIRST + STEP * np.arange(BEAMS))
WALLS_Y = (-0.42, 0.42)
"""In the rows of cells from -0.45 and from 0.4 m, in cells of 5 cm. The sensor looks ahead, so all
beams come in flat and cross some cells of the row before they end."""
LENGTH = 6.0
"""From x = 0 (m); the corridor is open at both ends."""
WALLS = np.array([(0, y, LENGTH, y) for y in WALLS_Y])
STEP_S, STEP_M = 0.4, 0.15
PASS_S = 60.0
RADIUS = 0.15


PASSES = 3
PERSON_X, PERSON_Y, PERSON_SPEED, PERSON_PASS = 1.0, 0.1, 0.375, 1
"""Walks along the corridor on one pass, at the robot's own pace, a metre ahead of it."""
FIRST_HIT_X = WALLS_Y[1] / math.tan(BEARINGS[-1])
"""Where the widest beam meets a wall on the first scan."""
WALL_CELLS = 2 * (round(LENGTH / 0.05) - math.floor(FIRST_HIT_X / 0.05))


ALL_MEASURED = replace(PLAIN, returns=ReturnOptions(range_max=100.0))
"""Few beams see the far end of the walls: no band is looked for there"""


def write_passes(path: Path) -> Path:
    steps = np.arange(int(LENGTH / STEP_M))
    stamps, places, ranges = [], [], []
    for index in range(PASSES):
        for x, seconds in zip(steps * STEP_M, steps * STEP_S, strict=True):
            person = PERSON_X + PERSON_SPEED * seconds if index == PERSON_PASS else 1e6
            stamps.append(index * PASS_S + seconds)
            places.append((x, 0.0, 0.0))
            circle = (person, PERSON_Y, RADIUS)
            ranges.append(office.cast_rays((x, 0.0), BEARINGS, WALLS, circle))
    first, step = math.radians(FIRST), math.radians(STEP)
    shape = {"angle_min": first, "angle_increment": step, "range_max": 1e6}
    return write_scans(path, stamps, ranges, places, **shape)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_passes(tmp_path_factory.mktemp("passes") / "log.csv")


def count_occupied(log: Path, options: BuildOptions) -> tuple[int, int]:
    """Cells of the map that are occupied: between the walls, and where these are."""
    grid = replace(build([log], options).map, decision=DEFAULT_THRESHOLDS)
    rows, _ = np.nonzero(grid.occupied)
    y = grid.origin[1] + (rows + 0.5) * grid.resolution
    on_wall = np.abs(y) > 0.4
    return int(np.count_nonzero(~on_wall)), int(np.count_nonzero(on_wall))


@pytest.mark.parametrize(
    ("update", "model", "ghosts", "walls"),
    [
        (Update.BEAM, "simple:spread=0", 28, 140),
        (Update.BEAM, "counting:strength=2,spread=0,ceiling=1,doubt=0", 15, 2),
        (Update.POLYGON, "simple:spread=0", 27, WALL_CELLS),
        (Update.POLYGON, "counting:strength=2,spread=0,ceiling=1,doubt=0", 27, WALL_CELLS),
    ],
)
def test_a_person_vanishes_and_thin_walls_stay(
    log: Path, update: Update, model: str, ghosts: int, walls: int
) -> None:
    options = replace(ALL_MEASURED, update=update, model=parse_model(model), jump=0.2)
    assert WALL_CELLS == 194
    assert count_occupied(log, options) == (ghosts, walls)
    assert count_occupied(log, replace(options, min_passes=2)) == (0, WALL_CELLS)
    # One visit is what the person made.
    assert count_occupied(log, replace(options, min_passes=1))[0] >= ghosts


def test_passes_without_a_pause_are_one_visit(log: Path) -> None:
    options = replace(ALL_MEASURED, min_passes=2, pass_gap_s=100)
    assert count_occupied(log, options) == (0, 0)


def test_walls_that_one_visit_hit_do_not_vanish_without_a_word(log: Path, tmp_path: Path) -> None:
    saved, target = tmp_path / "one.npz", tmp_path / "one.pgm"
    lasting, plain = ["-o", target, "--min-passes", 2], [*PLAIN_WORDS, "--range-max", 100]
    built = occmap("build", *plain, log, "-o", saved, "--pass-gap", 100, *lasting)
    found = r"note: --min-passes takes away 100% of the occupied cells \(179 of 179\), since .*\n"
    assert re.fullmatch(found, built.err)
    assert "cells    0.0% occupied, " in built.out
    assert "agree    0.0% of the hits" in built.out
    assert occmap("render", saved, *lasting).err == built.err
    assert occmap("render", saved, "-o", target, "--min-passes", 1).err == ""
    assert occmap("build", *plain, log, *lasting).err == ""


@pytest.mark.parametrize(("lost", "share"), [(5, 25), (4, None), (19, 95)])
def test_a_quarter_of_the_occupied_cells_is_not_lost_without_a_word(
    lost: int, share: int | None
) -> None:
    """Of 20; others were hit, but are not occupied, or are occupied only now."""
    cells = [(3, 0, 1, 1)] * lost + [(3, 0, 2, 2)] * (20 - lost)
    others = [(0, 5, 0, 1)] * 9 + [(1, 50, 1, 1)] * 7 + [(9, 50, 2, 2)]
    grid, slices = observe(cells + others)
    options = RenderOptions(min_passes=2)
    shown = open_map(hold(grid, slices), parse_model("simple:spread=0"), options)
    made, notes = shown.paint_all()
    # Of 60 + 7 + 9 hits; those that are lost, some of them beside the map, agree with nothing.
    assert made.agreement == (3 * (20 - lost) + 9) / 76
    if share is None:
        assert not notes
    else:
        (note,) = notes
        assert f"{share}% of the occupied cells ({lost} of 20)" in note
        assert "`pass_gap_s`" in note


def test_build_and_render_agree_and_evidence_stays(log: Path, tmp_path: Path) -> None:
    plain, lasting = tmp_path / "plain.npz", tmp_path / "lasting.npz"
    made, rendered = tmp_path / "built.pgm", tmp_path / "rendered.pgm"
    assert occmap("build", log, "-o", plain).code == 0
    built = occmap("build", log, "-o", lasting, "-o", made, "--min-passes", 2)
    assert ", hits of 2 visits or more\n" in built.out
    one, other = read_evidence(plain), read_evidence(lasting)
    assert are_equal(one.tiles, other.tiles)
    assert other.manifest.builds[0]["options"]["min_passes"] == 2
    for saved in (plain, lasting):
        words = ["render", saved, "-o", rendered, "--json"]
        assert json.loads(occmap(*words).out)["map"]["min_passes"] is None
        assert json.loads(occmap(*words, "--min-passes", 2).out)["map"]["min_passes"] == 2
        assert rendered.read_bytes() == made.read_bytes()


@pytest.mark.parametrize(("start", "visits"), [(0, 1), (20, 2)])
def test_resumed_and_merged_builds_share_slices(tmp_path: Path, start: int, visits: int) -> None:
    for name, first in (("a", 0), ("b", start)):
        write_csv(tmp_path / f"{name}.csv", [(0.0, 0.0, 0.0)], [0.32], start=first)
        words = [tmp_path / f"{name}.csv", "-o", tmp_path / f"{name}.npz"]
        assert occmap("build", *words).code == 0
    lasting = ["-o", tmp_path / "m.pgm", "--min-passes", 2, "--json"]

    def share(*words: object) -> float:
        found = json.loads(occmap(*words, *lasting).out)
        return float(found["map"]["occupied"])

    assert share("render", tmp_path / "a.npz") == 0
    assert (share("merge", tmp_path / "a.npz", tmp_path / "b.npz") > 0) == (visits == 2)
    assert (share("build", tmp_path / "b.csv", "--resume", tmp_path / "a.npz") > 0) == (visits == 2)


def observe(cells: Sequence[tuple[int, int, int, int]]) -> tuple[TileGrid, Slices]:
    """Cells in a row with these hits, misses, visits that hit and visits that saw."""
    placed = {(5 * TILE, -7 * TILE + col): pair[:2] for col, pair in enumerate(cells)}
    grid = make_grid(placed)
    numbers = 2 * np.arange(max(seen for *_, seen in cells))
    bits = np.zeros((len(numbers), 2, TILE, TILE), np.bool_)
    for col, visits in enumerate(np.array(cells)[:, 2:]):
        for layer, count in enumerate(visits):
            bits[:count, layer, 0, col] = True
    return grid, pack_bits(np.tile([5, -7], (len(numbers), 1)), numbers, np.packbits(bits, axis=-1))


@pytest.mark.parametrize(
    ("cell", "left"),
    [
        ((9, 5, 1, 4), (0, 5)),  # hit on one visit only: as its misses say
        ((9, 0, 1, 1), (0, 0)),  # without any: unknown
        ((9, 50, 2, 4), (9, 0)),  # on half of the visits: misses are forgotten
        ((9, 50, 2, 5), (9, 50)),  # on fewer: as the model says
        ((9, 50, 1, 1), (0, 50)),  # however often on one visit
        ((0, 50, 0, 7), (0, 50)),
    ],
)
def test_what_is_left_of_a_cell(cell: tuple[int, int, int, int], left: tuple[int, int]) -> None:
    grid, slices = observe([cell, (1, 1, 2, 2)])
    before = grid.tiles[5, -7].copy()
    lasting = find_lasting(read_all(hold(grid, slices)), 2)[1].tiles[5, -7]
    assert tuple(lasting[:, 0, 0].tolist()) == left
    assert lasting[:, 0, 1].tolist() == [1, 0]
    assert np.array_equal(grid.tiles[5, -7], before)


def test_slices_of_all_builds_count_once() -> None:
    grid, slices = observe([(9, 5, 1, 1), (0, 1, 0, 1)])
    for later, left in ((0, [0, 5]), (1, [0, 5]), (2, [9, 0])):
        other = replace(slices, numbers=slices.numbers + later)
        _, lasting = find_lasting(read_all(hold(grid, slices, other)), 2)
        assert lasting.tiles[5, -7][:, 0, 0].tolist() == left


def test_nothing_left_is_no_map() -> None:
    grid, slices = observe([(9, 0, 1, 1)])
    with pytest.raises(MapError, match=r"no cell was hit on 2 visits, .*; give a smaller `min_p"):
        open_map(hold(grid, slices), parse_model("simple"), RenderOptions(min_passes=2))
