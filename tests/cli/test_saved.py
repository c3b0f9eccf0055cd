"""`occmap render`, `occmap merge` and `occmap build --resume` as a user types them."""

import re
import shutil
from pathlib import Path

import pytest

from tests.cli.runner import ask, occmap, read_error
from tests.samples import PLAIN_WORDS, write_csv

BUILD = " ".join(["build", *PLAIN_WORDS])


@pytest.fixture(scope="module")
def made(workplace: Path) -> Path:
    """A folder with the evidence of two logs, and of a quadratic build."""
    write_csv(workplace / "a.csv", [(0.0, 0.0, 0.0)], [0.3])
    write_csv(workplace / "b.csv", [(0.0, 1.0, 0.0)], [0.4])
    for line in ("a.csv -o a.npz", "b.csv -o b.npz", "a.csv --model quadratic -o q.npz"):
        assert occmap(f"{BUILD} {line}").code == 0
    return workplace


@pytest.fixture(autouse=True)
def _evidence(made: Path, here: Path) -> None:
    shutil.copytree(made, here, dirs_exist_ok=True)


def read_bytes(*names: str) -> bytes:
    return b"".join(Path(name).read_bytes() for name in names)


def test_render_says_of_the_map_what_the_build_said() -> None:
    built, told = occmap(f"{BUILD} a.csv -o a.pgm"), occmap("render a.npz -o a.pgm")
    lines = [each for each in built.out.splitlines() if not each.startswith("time ")]
    assert len(lines) == 8
    assert (told.code, told.err, told.out.splitlines()) == (0, "", lines)


def test_render_takes_a_model_thresholds_and_a_mode() -> None:
    words = "--p-miss 0.1 --free-thresh 0.15 --mode raw"
    assert occmap(f"{BUILD} a.csv -o built.pgm {words}").code == 0
    found = ask(f"render a.npz -o c.pgm {words}")["map"]
    assert read_bytes("built.pgm") == read_bytes("c.pgm")
    assert found["model"] == "simple:p_hit=0.7,p_miss=0.1,prior=0.5,cut=0.5,spread=0.0"
    assert found["free"] == pytest.approx(6 / 7)
    bounds = "--clamp-min 0.1 --clamp-max 0.9"
    for line, shown in (
        ("a.npz --model counting --prior 0.4", "counting:prior=0.4"),
        (f"a.npz {bounds}", "spread=0,clamp_min=0.1,clamp_max=0.9"),
        (f"q.npz {bounds}", "quadratic:clamp_min=0.1,clamp_max=0.9"),
        ("q.npz --prior 0.45", "quadratic:prior=0.45"),
    ):
        assert shown in occmap(f"render {line} -o c.pgm").out


def test_render_shows_a_part_of_a_map_and_keeps_evidence_whole() -> None:
    out = occmap("render a.npz -o c.pgm -o c.npz --extent 0.1,0,0.2,1").out
    assert "map      2 x 20 cells of 0.05 m, x 0.1 to 0.2 m, y 0 to 1 m" in out
    assert read_bytes("c.npz") == read_bytes("a.npz")


def test_scan_counts_say_what_they_count() -> None:
    lines = occmap(f"{BUILD} b.csv --resume a.npz -o ab.npz").out.splitlines()
    assert "scans    1 of 1 used, added to 1 of 1 in a.npz" in lines
    found = ask(f"{BUILD} b.csv --resume ab.npz -o abb.npz")
    assert found["scans"]["used"] == found["builds"] == 1
    assert found["resumed"] == {"file": "ab.npz", "read": 2, "used": 2}
    merged = occmap("merge ab.npz a.npz -o m.npz").out.splitlines()
    assert "scans    3 of 3 used, in 3 builds" in merged
    rendered = ask("render m.npz -o m.pgm")
    assert (rendered["scans"]["used"], rendered["builds"], rendered["resumed"]) == (3, 3, None)


@pytest.mark.parametrize("command", [f"{BUILD} a.csv", "render a.npz", "merge a.npz"])
@pytest.mark.parametrize(
    ("flags", "found"),
    [
        ("-o m.tif --mode scale", "--mode does nothing"),
        ("-o m.pgm -o n.npz --light-occupied", "--light-occupied does nothing"),
        ("-o m.PGM -o m.png --mode raw --light-occupied", ""),
        ("-o m.pgm -o n.npz --georeference 1,2,3", "--georeference does nothing"),
        ("-o m.pgm -o m.png --georeference 1,2,3", ""),
        ("-o m.png --mode trinary", ""),
    ],
)
def test_an_option_that_does_nothing_is_noted(command: str, flags: str, found: str) -> None:
    result = occmap(f"{command} {flags} --json")
    assert result.code == 0
    assert result.err == "".join(f"note: {note}\n" for note in result.json["notes"])
    assert result.err.startswith(f"note: {found}" if found else "")
    assert result.err.count("\n") == bool(found)


@pytest.mark.parametrize("command", ["build beam a.csv -r 0.1", "render a.npz"])
@pytest.mark.parametrize("model", ["simple:p_hit=0.6", "counting:strength=6,cut=0.1"])
def test_walls_below_the_threshold_that_is_written_are_counted(command: str, model: str) -> None:
    """One hit, of probability 0.6 or below: the model calls its cell occupied, a loader not."""
    line = f"{command} --model {model} -o m.pgm --mode scale"
    unknown, told = ask(line)["notes"]
    assert re.match(r"--mode scale: nav2 loads the \d+ unknown cells of a .pgm", unknown)
    assert re.match(r"--mode scale: (\d+) of the \1 cells that count as occupied ", told)
    typed = re.findall(r"--[a-z]+-thresh 0[.0-9]+", told)
    assert len(typed) == (2 if "cut" in model else 1)
    assert ask(f"{line} {' '.join(typed)}")["notes"] == [unknown]
    assert occmap(f"{command} --model {model} -o n.pgm").code == 0
    assert not re.search("occupied to|to occupied", occmap("diff n.pgm m.pgm").out)


def test_a_log_that_counts_twice_is_noted_and_taken_out_as_the_note_says() -> None:
    resumed = occmap(f"{BUILD} a.csv --resume a.npz -o map.npz")
    merged = occmap("merge a.npz a.npz -o aa.npz")
    assert (resumed.code, merged.code, resumed.err) == (0, 0, merged.err)
    assert merged.err.startswith("note: a.csv is in it more than once")
    assert "let `occmap merge` subtract that" in merged.err
    told = occmap("merge map.npz --subtract a.npz -o once.npz")
    assert (told.code, told.err) == (0, "")
    assert "0 cells, 0.000%" in occmap("diff once.npz a.npz").out
    assert occmap(f"{BUILD} b.csv --resume a.npz -o ab.npz").err == ""


def test_a_single_file_is_not_fitted_to_anything() -> None:
    told = occmap("merge a.npz --fit -o m.npz")
    assert (told.code, "--fit does nothing" in told.err) == (0, True)


def test_halves_that_are_merged_are_no_loss() -> None:
    write_csv(Path("long.csv"), [(0, 0, 0)] * 4, [1.0])
    assert occmap("build long.csv --end 2 -o 1.npz").code == 0
    assert occmap("build long.csv --start 2 -o 2.npz").code == 0
    merged = occmap("merge 1.npz 2.npz -o 12.npz").out.splitlines()
    assert "scans    4 used of 4 asked for, in 2 builds" in merged
    assert not any(line.startswith("dropped") for line in merged)


def test_what_evidence_does_not_hold_is_refused_before_it_is_read() -> None:
    Path("damaged.npz").write_bytes(b"")
    told = occmap("merge", "damaged.npz", "a.npz", "-o", "way.tum")
    error = read_error(told, 2)
    assert error.startswith("way.tum: evidence does not say where the robot went")
    assert "build it from the logs: `occmap build`" in error
    assert "`occmap merge`" in read_error(occmap("render a.npz damaged.npz -o m.pgm"), 2)


def test_an_undecided_cell_is_not_called_unknown() -> None:
    assert "85.7% undecided" in occmap("render a.npz -o a.pgm --free-thresh 0.196").out
    assert occmap("render a.npz -o sure.pgm --p-miss 0.1").code == 0
    assert "6 neither to free" in occmap("diff a.pgm sure.pgm").out


def test_what_is_to_be_added_to_may_not_be_there_yet() -> None:
    first = occmap("build a.csv --resume-if-there site.npz -o site.npz --json")
    assert first.json["resumed"] is None
    assert "note: site.npz: no such file, so this build adds to nothing\n" in first.err
    second = occmap("build b.csv --resume-if-there site.npz -o site.npz --json")
    assert second.json["resumed"] == {"file": "site.npz", "read": 1, "used": 1}
    assert "no such file" not in second.err
