"""Evidence added up and taken apart: parts make the whole, cell by cell, and come out again."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import Evidence, Manifest
from occmap.errors import MapError
from occmap.explanation import Question, Visits, explain
from occmap.grid.tiles import LOG_ODDS_UNIT, TILE, count_visits, split_tiles, unite
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.sensor.models import QuadraticModel
from occmap.store import Blocks
from occmap.store.merging import Transform, merge, move_evidence, subtract
from occmap.store.painting import RenderOptions, publish
from occmap.types import Update
from occmap.writers.npz import read_evidence
from tests.evidence import saving
from tests.evidence.saving import DRIVE, MIDDLE_S, choose, halve, save, write_bytes
from tests.grid.scans import are_equal, assert_same_slices
from tests.samples import write_csv


@saving.each_combination
def test_two_halves_make_the_whole(tmp_path: Path, update: Update, model: str) -> None:
    """A slice of time goes on over the middle, 20 s after the start."""
    options = choose(update, model)
    first, second = (save(tmp_path / "half.npz", each) for each in halve(options))
    assert min(half.manifest.builds[0]["scans"]["used"] for half in (first, second)) > 20
    whole = save(tmp_path / "whole.npz", options)
    assert set(first.slices[0].numbers) & set(second.slices[0].numbers)
    for halves in ([first, second], [second, first]):
        assert are_equal(merge(halves).tiles, whole.tiles)
        assert merge(halves).slices == halves[0].slices + halves[1].slices
        assert_same_slices(unite(merge(halves).slices), whole.slices[0])
    hits = [count_visits(tile)[0].any() for _, tile in split_tiles(whole.slices[0])]
    assert any(hits) == (model != "quadratic")
    for taken, left in ((second, first), (first, second)):
        rest = subtract(merge([first, second]), taken)
        assert are_equal(rest.tiles, left.tiles)
        assert rest.manifest == left.manifest
        assert write_bytes(tmp_path, rest) == write_bytes(tmp_path, left)


def test_a_seam_between_halves_is_no_visit_more(tmp_path: Path) -> None:
    whole, *halves = (save(tmp_path / "m.npz", each) for each in (choose(), *halve(choose())))
    options = RenderOptions(min_passes=2)
    for evidence, name in ((whole, "whole.pgm"), (merge(halves), "both.pgm")):
        publish(Blocks.of(evidence), options, [tmp_path / name])
    assert (tmp_path / "both.pgm").read_bytes() == (tmp_path / "whole.pgm").read_bytes()


@pytest.mark.parametrize(("other_start", "visits"), [(0, 1), (8, 1), (11, 1), (30, 2)])
def test_logs_of_the_same_hours_are_one_visit_however_they_are_built(
    tmp_path: Path, other_start: int, visits: int
) -> None:
    """Two logs of 9 s each, of one corner, that overlap, follow one another or lie apart."""
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for log, start in zip(logs, (0, other_start), strict=True):
        write_csv(log, [(0.05, 0.05, 0.0)] * 9, [0.32], start=start)
    build(logs, BuildOptions(), [tmp_path / "both.npz"])
    apart = merge([save(tmp_path / "m.npz", BuildOptions(), log) for log in logs])
    for evidence in (read_evidence(tmp_path / "both.npz"), apart):
        found = explain(Blocks.of(evidence), Question(0.35, 0.05)).visits
        until_ns = (other_start + 8) // 10 * 10**10 + 10**10
        assert found == Visits(0, until_ns, visits, visits)


def test_what_was_no_build_leaves_visits_that_are_bounds(tmp_path: Path) -> None:
    whole, part = (save(tmp_path / "m.npz", each) for each in (choose(), halve(choose())[0]))
    rest = subtract(whole, part)
    (before,), (after,) = whole.slices, rest.slices
    left = {key for key, _ in split_tiles(after)}
    assert left == rest.tiles.keys()
    for key, of_tile in split_tiles(after):
        seen = (rest.tiles[key] != 0).any(axis=0)
        assert np.array_equal(count_visits(of_tile)[1] > 0, seen)
    assert 0 < len(after.numbers) <= len(before.numbers)
    assert rest.manifest.builds == whole.manifest.builds
    report = publish(Blocks.of(rest), RenderOptions(), [tmp_path / "m.pgm"])
    (note,) = report.notes
    for said in ("no whole logs", "beams are counted as before", "are upper bounds"):
        assert said in note
    assert report.scans.used == whole.manifest.builds[0]["scans"]["used"]
    assert publish(Blocks.of(whole), RenderOptions(), [tmp_path / "m.pgm"]).notes == ()


def test_logs_of_a_build_are_taken_out_with_their_scans(tmp_path: Path) -> None:
    """Two logs, a day apart: what is left is named and counted as that log alone."""
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for log, scans, start in zip(logs, (9, 4), (0, 86400), strict=True):
        write_csv(log, [(0.05, 0.05, 0.0)] * scans, [0.32], start=start)
    build(logs, BuildOptions(), [tmp_path / "both.npz"])
    both = read_evidence(tmp_path / "both.npz")
    one, other = (save(tmp_path / "m.npz", BuildOptions(), log) for log in logs)
    rest = subtract(both, one)
    told, alone = (publish(Blocks.of(each), RenderOptions(), []) for each in (rest, other))
    assert replace(told, notes=()) == replace(alone, notes=())
    assert [note.endswith("numbers of visits are upper bounds") for note in told.notes] == [True]
    nothing = subtract(rest, other)
    assert (nothing.manifest.builds, nothing.manifest.subtracted, nothing.slices) == ((), (), ())
    # A build of that log alone goes before a larger one.
    assert subtract(merge([both, one]), one).manifest == both.manifest
    # A log that was read otherwise is not taken for the same.
    half = save(tmp_path / "m.npz", BuildOptions(selection=Selection(end_s=3)), logs[0])
    assert subtract(both, half).manifest.builds == both.manifest.builds


def test_a_build_that_is_there_only_in_part_takes_no_slices_away(tmp_path: Path) -> None:
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
    for found, each in zip(rest.slices, (whole, half), strict=True):
        assert_same_slices(found, each.slices[0])


@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_a_build_resumes(tmp_path: Path, model: str) -> None:
    options = choose(model=model)
    path = tmp_path / "m.npz"
    first, second = halve(options)
    save(path, first)
    resumed = build([DRIVE], replace(second, resume=path), [path])
    whole = save(tmp_path / "whole.npz", options)
    assert are_equal(read_evidence(path).tiles, whole.tiles)
    parts = merge([save(tmp_path / "half.npz", each) for each in (first, second)])
    assert path.read_bytes() == write_bytes(tmp_path, parts)
    assert np.array_equal(resumed.map.log_odds, build([DRIVE], options).map.log_odds)
    assert len(read_evidence(path).manifest.builds) == 2


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"resolution": 0.1}, "its resolution is 0.1, .*; build both with `resolution=0.05`, or "),
        ({"update": Update.POLYGON}, "its update is polygon, .* is beam; build both with the same"),
        ({"model": QuadraticModel()}, "its kind is log_odds, .* is counts; build both with the sa"),
        ({"pass_gap_s": 5.0}, "its pass_gap_s is 5.0, .* is 10.0"),
        ({"hit_offset": 0.25}, "its hit_offset is 0.25, .* is 0.5"),
        ({"posing": PosingOptions(align=2.5)}, "its align is 2.5, .*; .* `align=0.0`, or .* `ali"),
    ],
)
def test_evidence_that_does_not_add_up_is_refused(
    tmp_path: Path, changed: dict[str, Any], found: str
) -> None:
    first = save(tmp_path / "a.npz", choose())
    second = save(tmp_path / "b.npz", replace(choose(), **changed))
    refused = rf"b.npz: {found}"
    with pytest.raises(MapError, match=refused):
        merge([first, second])
    with pytest.raises(MapError, match=refused):
        subtract(first, second)
    with pytest.raises(MapError, match=refused):  # before the log is read
        build([tmp_path / "nothing.csv"], replace(choose(), resume=tmp_path / "b.npz"))


LEANING = PosingOptions(level=(0.0, 1.0))


@pytest.mark.parametrize(
    ("update", "changed", "notes"),
    [
        (Update.BEAM, {"jump": 0.5}, []),
        (Update.SURFACE, {"jump": 0.5, "border_gap": 3}, ["jump` (0.1, 0.5)"]),
        (Update.POLYGON, {"border_gap": 3}, ["border_gap` (3, 8)"]),
        (Update.POLYGON, {"jump": math.inf}, ["jump` (0.1, inf)"]),
        (Update.BEAM, {"posing": LEANING}, ["level` ([0.0, 0.0], [0.0, 1.0])"]),
    ],
)
def test_options_that_differ_between_builds_are_noted(
    tmp_path: Path, update: Update, changed: dict[str, Any], notes: list[str]
) -> None:
    first, second = halve(choose(update))
    one = save(tmp_path / "a.npz", first)
    other = save(tmp_path / "b.npz", replace(second, **changed))
    mine = [f"its builds differ in `{text}" for text in notes]
    assert publish(Blocks.of(merge([one, other])), RenderOptions(), []).notes == tuple(mine)
    added = build([DRIVE], replace(first, resume=tmp_path / "b.npz"), [tmp_path / "c.npz"])
    assert [note for note in added.report.notes if "differ" in note] == mine


def test_radial_evidence_of_two_depths_is_refused(tmp_path: Path) -> None:
    first = save(tmp_path / "a.npz", choose(model="quadratic"))
    second = save(tmp_path / "b.npz", choose(model="quadratic:epsilon=0.1"))
    with pytest.raises(MapError, match=r"b.npz: its profile is quadratic:epsilon=0.1,p_min=0.4, "):
        merge([first, second])


def test_what_is_said_of_a_sum_is_said_of_what_is_left_of_it(tmp_path: Path) -> None:
    first, second = (save(tmp_path / "m.npz", each) for each in halve(choose()))
    told = merge([first, replace(second, notes=("moved",))], [second])
    assert told.notes == ("moved",)


@pytest.mark.parametrize("model", ["simple", "quadratic"])
def test_more_than_is_there_cannot_be_taken_away(tmp_path: Path, model: str) -> None:
    first, second = (save(tmp_path / "m.npz", each) for each in halve(choose(model=model)))
    with pytest.raises(MapError, match=r"holds observations of [\d,]+ cells that .* lacks; "):
        subtract(first, second)


def test_what_was_moved_is_not_said_to_be_absent(tmp_path: Path) -> None:
    first, second = (save(tmp_path / "m.npz", each) for each in halve(choose()))
    moved = merge([first, move_evidence(second, Transform(0.3, 0.0, 0.1))])
    with pytest.raises(MapError, match=r"lacks; `fit` moved what it holds, .* the others again"):
        subtract(moved, second)


@pytest.mark.parametrize("layer", [0, 1])
def test_neither_hits_nor_misses_that_are_not_there_are_taken(tmp_path: Path, layer: int) -> None:
    whole = save(tmp_path / "m.npz", choose())
    key, tile = next((key, tile) for key, tile in whole.tiles.items() if tile[0].any())
    part, place = np.zeros_like(tile), tuple(np.argwhere(tile[0])[0])
    part[layer][place] = tile[layer][place]
    assert len(subtract(whole, replace(whole, tiles={key: part})).tiles)
    part[layer][place] += 1
    with pytest.raises(MapError, match="holds observations of 1 cell that "):
        subtract(whole, replace(whole, tiles={key: part}))


def test_nothing_left_is_no_map(tmp_path: Path) -> None:
    whole = save(tmp_path / "m.npz", choose())
    nothing = subtract(whole, whole)
    assert (len(nothing.tiles), nothing.manifest.builds) == (0, ())
    with pytest.raises(MapError, match="all were subtracted"):
        publish(Blocks.of(nothing), RenderOptions(), [tmp_path / "m.pgm"])
    assert not (tmp_path / "m.pgm").exists()


def hold_one_cell(log_odds: float, observations: int) -> Evidence:
    """Evidence of a quadratic model with a prior of 0.2, by hand: one cell, 1 m wide."""
    manifest = Manifest(1.0, "beam", "log_odds", "quadratic", 10.0, 0.0, "quadratic:prior=0.2", ())
    tile = np.zeros((2, TILE, TILE), np.int64)
    tile[:, 3, 4] = round(log_odds / LOG_ODDS_UNIT), observations
    return Evidence(manifest, {(0, 0): tile})


def test_what_is_left_of_log_odds_by_hand() -> None:
    """1.5 of five observations without -0.5 of two of them is 2 of three."""
    rest = subtract(hold_one_cell(1.5, 5), hold_one_cell(-0.5, 2))
    assert rest.tiles[0, 0][:, 3, 4].tolist() == [2 * 65536, 3]


def test_no_log_odds_are_left_without_an_observation() -> None:
    """As many observations go, but not the same ones: no scan says 0.5 without observing."""
    with pytest.raises(MapError, match="holds observations of 1 cell that the sum lacks"):
        subtract(hold_one_cell(1.5, 2), hold_one_cell(1.0, 2))
    assert not len(subtract(hold_one_cell(1.5, 2), hold_one_cell(1.5, 2)).tiles)
