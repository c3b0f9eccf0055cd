"""`occmap render`, `occmap merge` and `occmap build --resume` as a user types them."""

import json
from pathlib import Path

import pytest

from tests.cli.runner import occmap, read_error
from tests.samples import PLAIN_WORDS, write_csv


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with the evidence of two logs, and of a quadratic build."""
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "a.csv", [(0.0, 0.0, 0.0)], [0.3])
    write_csv(tmp_path / "b.csv", [(0.0, 1.0, 0.0)], [0.4])
    for name in ("a", "b"):
        assert occmap("build", *PLAIN_WORDS, f"{name}.csv", "-o", f"{name}.npz").code == 0
    words = ["build", "beam", "a.csv", "-o", "q.npz", "--model", "quadratic"]
    assert occmap(*words).code == 0
    return tmp_path


def read_bytes(*names: str) -> bytes:
    return b"".join(Path(name).read_bytes() for name in names)


def test_render_says_what_it_made() -> None:
    result = occmap("render", "a.npz", "-o", "a.pgm")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines() == [
        "map      7 x 1 cells of 0.05 m, x 0 to 0.35 m, y 0 to 0.05 m",
        "cells    14.3% occupied, 85.7% free",
        "agree    100.0% of the hits lie in occupied cells",
        "update   beam, model simple:spread=0",
        "scans    1 of 1 used",
        "files    a.pgm",
        "         a.yaml",
    ]


def test_render_takes_a_model_thresholds_and_a_mode() -> None:
    words = ["--p-miss", "0.1", "--free-thresh", "0.15", "--mode", "raw"]
    assert occmap("build", *PLAIN_WORDS, "a.csv", "-o", "built.pgm", *words).code == 0
    assert occmap("render", "a.npz", "-o", "built2.pgm", *words).code == 0
    assert read_bytes("built.pgm") == read_bytes("built2.pgm")
    found = json.loads(occmap("render", "a.npz", "-o", "c.pgm", "--json", *words).out)
    assert found["map"]["model"] == "simple:p_hit=0.7,p_miss=0.1,prior=0.5,cut=0.5,spread=0.0"
    assert found["map"]["free"] == pytest.approx(6 / 7)
    words = ["--model", "counting", "--prior", "0.4"]
    assert "counting:prior=0.4" in occmap("render", "a.npz", "-o", "c.pgm", *words).out
    words = ["--clamp-min", "0.1", "--clamp-max", "0.9"]
    bounds = "clamp_min=0.1,clamp_max=0.9"
    for name, shown in (("a.npz", f"spread=0,{bounds}"), ("q.npz", f"quadratic:{bounds}")):
        assert shown in occmap("render", name, "-o", "c.pgm", *words).out
    assert occmap("render", "q.npz", "-o", "c.pgm", "--prior", "0.45").code == 0


def test_render_shows_a_part_of_a_map_and_keeps_evidence_whole() -> None:
    words = ["render", "a.npz", "-o", "c.pgm", "-o", "c.npz", "--extent", "0.1,0,0.2,1"]
    assert "map      2 x 20 cells of 0.05 m, x 0.1 to 0.2 m, y 0 to 1 m" in occmap(*words).out
    assert read_bytes("c.npz") == read_bytes("a.npz")


def test_merge_and_resume_are_a_build_of_both_and_back() -> None:
    assert occmap("build", *PLAIN_WORDS, "a.csv", "b.csv", "-o", "both.pgm").code == 0
    assert occmap("merge", "a.npz", "b.npz", "-o", "ab.npz", "-o", "ab.pgm").code == 0
    assert read_bytes("ab.pgm") == read_bytes("both.pgm")
    assert occmap("merge", "ab.npz", "--subtract", "a.npz", "-o", "rest.npz").code == 0
    assert read_bytes("rest.npz") == read_bytes("b.npz")
    assert occmap("build", *PLAIN_WORDS, "b.csv", "--resume", "a.npz", "-o", "a.npz").code == 0
    assert read_bytes("a.npz") == read_bytes("ab.npz")


def test_scan_counts_say_what_they_count() -> None:
    words = ["build", *PLAIN_WORDS, "b.csv", "--resume", "a.npz", "-o", "ab.npz"]
    lines = occmap(*words).out.splitlines()
    assert "scans    1 of 1 used, added to 1 of 1 in a.npz" in lines
    words = ["build", *PLAIN_WORDS, "b.csv", "--resume", "ab.npz", "-o", "abb.npz", "--json"]
    found = json.loads(occmap(*words).out)
    assert found["scans"]["used"] == found["builds"] == 1
    assert found["resumed"] == {"file": "ab.npz", "read": 2, "used": 2}
    merged = occmap("merge", "ab.npz", "a.npz", "-o", "m.npz").out.splitlines()
    assert "scans    3 of 3 used, in 3 builds" in merged
    rendered = json.loads(occmap("render", "m.npz", "-o", "m.pgm", "--json").out)
    assert (rendered["scans"]["used"], rendered["builds"], rendered["resumed"]) == (3, 3, None)


@pytest.mark.parametrize(
    "words", [["build", *PLAIN_WORDS, "a.csv"], ["render", "a.npz"], ["merge", "a.npz"]]
)
@pytest.mark.parametrize(
    ("flags", "found"),
    [
        ("-o m.tif --mode scale", "--mode scale does nothing"),
        ("-o m.pgm -o n.npz --light-occupied", "--light-occupied does nothing"),
        ("-o m.PGM -o m.png --mode raw --light-occupied", ""),
        ("-o m.pgm -o n.npz --georeference 1,2,3", "--georeference does nothing"),
        ("-o m.pgm -o m.png --georeference 1,2,3", ""),
        ("-o m.png --mode trinary", ""),
    ],
)
def test_an_option_that_does_nothing_is_noted(words: list[str], flags: str, found: str) -> None:
    result = occmap(*words, *flags.split())
    assert result.code == 0
    assert result.err.startswith(f"note: {found}" if found else "")
    assert len(result.err.splitlines()) == bool(found)
    assert len(json.loads(occmap(*words, *flags.split(), "--json").out)["notes"]) == bool(found)


def test_a_log_that_counts_twice_is_noted_and_taken_out_as_the_note_says() -> None:
    resumed = occmap("build", *PLAIN_WORDS, "a.csv", "--resume", "a.npz", "-o", "map.npz")
    merged = occmap("merge", "a.npz", "a.npz", "-o", "aa.npz")
    assert (resumed.code, merged.code, resumed.err) == (0, 0, merged.err)
    assert merged.err.startswith("note: a.csv is in it more than once")
    assert "let `occmap merge` subtract that" in merged.err
    told = occmap("merge", "map.npz", "--subtract", "a.npz", "-o", "once.npz")
    assert (told.code, told.err) == (0, "")
    assert "0 cells, 0.000%" in occmap("diff", "once.npz", "a.npz").out
    assert occmap("build", *PLAIN_WORDS, "b.csv", "--resume", "a.npz", "-o", "ab.npz").err == ""


def test_a_single_file_is_not_fitted_to_anything() -> None:
    told = occmap("merge", "a.npz", "--fit", "-o", "m.npz")
    assert (told.code, "--fit does nothing" in told.err) == (0, True)


def test_halves_that_are_merged_are_no_loss() -> None:
    write_csv(Path("long.csv"), [(0, 0, 0)] * 4, [1.0])
    assert occmap("build", "long.csv", "--end", "2", "-o", "1.npz").code == 0
    assert occmap("build", "long.csv", "--start", "2", "-o", "2.npz").code == 0
    merged = occmap("merge", "1.npz", "2.npz", "-o", "12.npz").out.splitlines()
    assert "scans    4 used of 4 asked for, in 2 builds" in merged
    assert not any(line.startswith("dropped") for line in merged)


def test_what_evidence_does_not_hold_is_refused_before_it_is_read() -> None:
    Path("damaged.npz").write_bytes(b"")
    told = occmap("merge", "damaged.npz", "a.npz", "-o", "way.tum")
    assert "way.tum: evidence does not say where the robot went" in read_error(told, 2)


def test_evidence_is_a_map_to_diff() -> None:
    assert occmap("build", *PLAIN_WORDS, "a.csv", "-o", "a.pgm").code == 0
    assert occmap("diff", "a.npz", "a.pgm", "--fail-above", "0").code == 0
    assert occmap("diff", "a.npz", "b.npz", "--fail-above", "0").code == 3


def test_an_undecided_cell_is_not_called_unknown() -> None:
    told = occmap("render", "a.npz", "-o", "a.pgm", "--free-thresh", "0.196")
    assert "85.7% undecided" in told.out
    assert occmap("render", "a.npz", "-o", "sure.pgm", "--p-miss", "0.1").code == 0
    assert "6 neither to free" in occmap("diff", "a.pgm", "sure.pgm").out


@pytest.mark.parametrize(
    ("words", "code", "found"),
    [
        (["render", "a.npz"], 2, "where to write is not given; add -o map.pgm"),
        (["render", "x.npz", "-o", "m.pgm"], 1, "x.npz: no such file"),
        (["render", "a.csv", "-o", "m.pgm"], 1, "a.csv: is not an evidence file; build one"),
        (
            ["render", "a.npz", "-o", "m.jpg"],
            2,
            "occmap writes .csv, .ground.tif, .html, .keepout.pgm",
        ),
        (["render", "a.npz", "-o", "m.pgm", "--max-cells", "3"], 1, "more than --max-cells 3"),
        (["render", "a.npz", "-o", "m.pgm", "--extent", "0,0,1"], 2, "3 values where 4 belong"),
        (["render", "a.npz", "-o", "m.pgm", "--extent", "0,0,0,1"], 2, "is not a box"),
        (
            ["render", "a.npz", "-o", "m.pgm", "--extent", "5,5,6,6"],
            1,
            "no cell of the map lies in",
        ),
        (["render", "a.npz", "-o", "m.pgm", "--epsilon", "1"], 2, "has no parameter 'epsilon'"),
        (
            ["render", "a.npz", "-o", "m.pgm", "--model", "counting", "--p-hit", "0.8"],
            2,
            "the model counting has no parameter 'p_hit'; choose --model simple",
        ),
        (["render", "q.npz", "-o", "m.pgm", "--model", "simple"], 1, "q.npz: was summed up for"),
        (["render", "q.npz", "-o", "m.pgm", "--p-min", "0.3"], 1, "no other can read it"),
        (
            ["merge", "-o", "m.npz"],
            2,
            "Missing argument 'NPZ|ZARR...'; write, for example, occmap merge monday.npz",
        ),
        (["merge", "a.npz"], 2, "add -o merged.npz"),
        (["merge", "a.npz", "q.npz", "--fit", "-o", "m.npz"], 1, "q.npz: its kind is log_odds"),
        (["merge", "a.npz", "b.npz", "--fit", "-o", "m.npz"], 1, "not sure how b.npz lies on it"),
        (["merge", "a.npz", "q.npz", "-o", "m.npz"], 1, "q.npz: its kind is log_odds"),
        (["merge", "a.npz", "--subtract", "b.npz", "-o", "m.npz"], 1, "cells that a.npz lacks"),
        (
            ["build", "b.csv", "--resume", "a.npz", "-o", "m.npz"],
            1,
            "a.npz: its update is beam, that of what it is to be combined with is surface",
        ),
        (
            ["build", *PLAIN_WORDS, "b.csv", "--resume", "q.npz", "-o", "m.npz"],
            1,
            "q.npz: its kind is log_odds",
        ),
        (["build", "b.csv", "--resume", "b.csv", "-o", "m.npz"], 1, "is not an evidence file"),
    ],
)
def test_bad_input_is_one_line_and_no_file(words: list[str], code: int, found: str) -> None:
    before = sorted(Path.cwd().iterdir())
    assert found in read_error(occmap(*words), code)
    assert sorted(Path.cwd().iterdir()) == before
