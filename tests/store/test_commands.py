"""Commands on a store do what they do on an .npz of the same build."""

import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap import build_map
from occmap.difference.maps import load_map
from occmap.options import Selection
from occmap.pipeline import build
from occmap.store import open_store, painting
from occmap.types import Update
from occmap.writers import WriteOptions
from occmap.writers.npz import read_evidence
from tests.cli.runner import Result, ask, occmap, read_error
from tests.evidence.saving import DRIVE, MIDDLE_S, choose
from tests.grid.scans import are_equal
from tests.samples import SAMPLE_LOGS, write_csv
from tests.store.test_store import SIDE_M, list_files

HALVES = {"early": Selection(end_s=MIDDLE_S), "late": Selection(start_s=MIDDLE_S)}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the drive, whole and in halves, as .npz and as store of each."""
    folder = tmp_path_factory.mktemp("built")
    options = replace(choose(Update.SURFACE, "counting"), resolution=SIDE_M, pass_gap_s=3.0)
    for name, selection in {"whole": Selection(), **HALVES}.items():
        outputs = [folder / f"{name}.npz", folder / f"{name}.zarr"]
        build([DRIVE], replace(options, selection=selection), outputs)
    return folder


def run_both(folder: Path, tmp_path: Path, line: str) -> list[Result]:
    """Run a command on files and on stores; `.in` and `.out` stand for what is read and written."""
    results = []
    for suffix in (".npz", ".zarr"):
        words = line.replace("IN/", f"{folder}/").replace(".in", suffix)
        results.append(occmap(words.replace("OUT/", f"{tmp_path}/{suffix[1:]}-")))
        assert results[-1].code == 0, results[-1].err
    return results


def assert_same_files(tmp_path: Path, *names: str) -> None:
    for name in names:
        one, other = (tmp_path / f"{kind}-{name}" for kind in ("npz", "zarr"))
        assert one.read_bytes() == other.read_bytes(), name


def strip(text: str, tmp_path: Path) -> str:
    return text.replace(f"{tmp_path}/zarr-", f"{tmp_path}/npz-").replace(".zarr", ".npz")


@pytest.mark.parametrize(
    "options",
    [
        "",
        "--model simple --p-hit 0.8 --mode scale",
        "--spread 0.3",
        "--min-passes 4 --spread 0",
        "--margin 2.5 --min-passes 2",
    ],
)
def test_a_map_of_a_store_is_that_of_the_file(built: Path, tmp_path: Path, options: str) -> None:
    outputs = "-o OUT/m.pgm -o OUT/m.png -o OUT/m.mcap -o OUT/m.tif"
    one, other = run_both(built, tmp_path, f"render IN/whole.in {outputs} {options} --json")
    assert one.json == Result(0, strip(other.out, tmp_path), "").json
    assert one.err == other.err
    assert_same_files(tmp_path, "m.pgm", "m.png", "m.mcap", "m.tif")


@pytest.mark.parametrize(
    ("box", "options"),
    [
        ("-3,-2,1,4", "--min-passes 2"),
        ("-0.5,-0.5,0.5,0.5", ""),
        ("-25,-9,25,-1", ""),
        ("5,1,45,9", "--min-passes 2"),
        ("-30,-30,30,30", ""),
    ],
)
def test_a_part_of_a_map_is_that_of_the_whole(
    built: Path, tmp_path: Path, box: str, options: str
) -> None:
    wanted = f"--extent {box} {options} --json"
    one, other = run_both(built, tmp_path, f"render IN/whole.in -o OUT/m.pgm {wanted}")
    found = one.json
    assert found == json.loads(strip(other.out, tmp_path))
    assert_same_files(tmp_path, "m.pgm")
    assert found["map"]["extent"] == [float(edge) for edge in box.split(",")]
    in_parts = occmap(f"render {built}/whole.zarr -o {tmp_path}/m.tif {wanted}")
    assert in_parts.json["map"] == found["map"]


SPANS = [  # as scans that lie in whole slices of 3 s
    ("--since 2023-11-14T22:13:39", 19.0, math.inf),
    ("--since 1700000019 --until 2023-11-14T23:14:00+01:00", 19.0, 43.0),
]


@pytest.mark.parametrize(("span", "start", "end"), SPANS)
def test_what_was_seen_in_a_span_of_time_is_shown_as_the_whole_shows_it(
    built: Path, tmp_path: Path, span: str, start: float, end: float
) -> None:
    part = build_map(DRIVE, model="counting:spread=0", resolution=SIDE_M, start_s=start, end_s=end)
    whole, box = tmp_path / "whole.pgm", ",".join(map(str, part.extent))
    occmap(f"render {built}/whole.npz -o {whole} --spread 0 --extent {box}")
    run_both(built, tmp_path, f"render IN/whole.in -o OUT/m.tif -o OUT/m.pgm --spread 0 {span}")
    assert_same_files(tmp_path, "m.tif", "m.pgm")
    shown, expected = (np.asarray(Image.open(each)) for each in (tmp_path / "npz-m.pgm", whole))
    assert np.array_equal(shown, np.where(part.observed[::-1], expected, 205))


def test_other_formats_of_a_store(built: Path, here: Path) -> None:
    whole = ask("render", built / "whole.npz", "-o", "m.pgm")["map"]
    assert ask("render", built / "whole.zarr", "-o", "m.tif")["map"] == whole
    assert occmap("render", built / "whole.zarr", "-o", here / "m.html").code == 0
    done = occmap("render", built / "whole.zarr", "-o", "m.tum")
    assert "does not say where the robot went" in read_error(done, 2)


def test_a_box_beside_the_map_is_refused_alike(built: Path, tmp_path: Path) -> None:
    words = ("-o", tmp_path / "m.pgm", "--extent", "99,99,100,100")
    one, other = (occmap("render", built / f"whole.{kind}", *words) for kind in ("npz", "zarr"))
    assert read_error(one, 1) == read_error(other, 1)


@pytest.mark.parametrize(
    "words",
    [
        f"1.5 -0.25 --log {DRIVE}",
        f"-0.01 2 --log {DRIVE} --min-passes 2",
        "0 0",
        "-0.01 2 --min-passes 2",
        "50 50",
    ],
)
def test_a_cell_is_explained_alike(built: Path, tmp_path: Path, words: str) -> None:
    one, other = run_both(built, tmp_path, f"explain IN/whole.in {words}")
    assert one == other


@pytest.mark.parametrize(
    "parts", ["IN/early.npz IN/late.in", "IN/whole.in IN/late.in --subtract IN/late.in"]
)
def test_sums_and_differences_are_those_of_files(built: Path, tmp_path: Path, parts: str) -> None:
    outputs = "-o OUT/m.npz -o OUT/m.zarr -o OUT/m.pgm"
    one, other = run_both(built, tmp_path, f"merge {parts} {outputs} --json")
    assert strip(one.out, tmp_path) == strip(other.out, tmp_path)
    assert_same_files(tmp_path, "m.npz", "m.pgm")
    occmap("render", tmp_path / "zarr-m.zarr", "-o", tmp_path / "back.npz")
    assert (tmp_path / "back.npz").read_bytes() == (tmp_path / "npz-m.npz").read_bytes()


def test_a_merge_into_a_store_alone_says_the_same(built: Path, tmp_path: Path) -> None:
    line = "merge IN/early.in IN/late.in -o OUT/m.zarr --min-passes 2"
    one, other = (strip(each.out, tmp_path) for each in run_both(built, tmp_path, line))
    assert one == other


def test_maps_are_compared_block_by_block(built: Path, tmp_path: Path) -> None:
    one, other = run_both(built, tmp_path, "diff IN/early.in IN/whole.in -o OUT/d.png")
    assert one == other
    stores = [open_store(built / f"{name}.zarr") for name in ("early", "whole")]
    assert one.out.splitlines()[-2:] == [f"evidence {stores[0].name}", f"         {stores[1].name}"]
    assert_same_files(tmp_path, "d.png")
    same = ask("diff", built / "whole.npz", built / "whole.zarr")
    assert (same["changed"], same["evidence"]) == (0, [stores[1].name] * 2)


def test_what_does_not_add_up_is_refused_alike(built: Path, tmp_path: Path) -> None:
    for suffix in ("npz", "zarr"):
        early, late = (built / f"{name}.{suffix}" for name in HALVES)
        done = occmap("merge", early, "--subtract", late, "-o", tmp_path / "m.zarr")
        assert "holds observations of" in read_error(done, 1)
        coarse = tmp_path / f"coarse.{suffix}"
        build([DRIVE], replace(choose(), resolution=0.1), [coarse])
        done = occmap("merge", early, coarse, "-o", tmp_path / "m.zarr")
        assert "its resolution is 0.1" in read_error(done, 1)
    assert not (tmp_path / "m.zarr").exists()
    assert not list(tmp_path.glob(".occmap-*"))


def test_a_build_adds_blocks_to_a_store(built: Path, tmp_path: Path) -> None:
    far = write_csv(tmp_path / "far.csv", [(100.0, 100.0, 0.0)], [2.0, 2.0, 2.0], 0.1)
    line = ["build", "surface", far, "--resolution", SIDE_M, "--pass-gap", "3"]
    new, plain = tmp_path / "new.zarr", tmp_path / "plain.npz"
    assert occmap(*line, "--resume", built / "early.zarr", "-o", new).code == 0
    assert occmap(*line, "--resume", built / "early.npz", "-o", plain).code == 0
    occmap("render", new, "-o", tmp_path / "new.npz")
    assert (tmp_path / "new.npz").read_bytes() == plain.read_bytes()
    assert occmap(*line, "--resume", new, "-o", new).code == 0


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Halves of a drive with clouds, each as a store and as a file."""
    folder = tmp_path_factory.mktemp("hall")
    log, first = SAMPLE_LOGS / "hall.mcap", folder / "first.npz"
    outputs = [part for kind in ("npz", "zarr") for part in ("-o", folder / f"first.{kind}")]
    assert occmap("build", log, "--end", "2", *outputs).code == 0
    for kind in ("npz", "zarr"):
        outputs = ["-o", folder / f"second.{kind}"]
        assert occmap("build", log, "--start", "2", "--ground", first, *outputs).code == 0
    return folder


def test_a_store_keeps_the_ground_of_clouds(hall: Path, tmp_path: Path) -> None:
    late = f"build {SAMPLE_LOGS / 'hall.mcap'} --start 2"
    for line in (
        "merge IN/first.in IN/second.in -o OUT/sum.npz",
        "render IN/first.in -o OUT/again.npz",
        f"{late} --resume IN/first.in -o OUT/resumed.npz",
        f"{late} --ground IN/first.in -o OUT/over.npz",
    ):
        run_both(hall, tmp_path, line)
    assert_same_files(tmp_path, "sum.npz", "again.npz")
    assert (tmp_path / "zarr-again.npz").read_bytes() == (hall / "first.npz").read_bytes()
    for name in ("sum", "resumed", "over"):
        one, other = (read_evidence(tmp_path / f"{kind}-{name}.npz") for kind in ("npz", "zarr"))
        assert one.ground is not None
        assert other.ground is not None
        assert np.array_equal(one.ground.height_mm, other.ground.height_mm)
        assert are_equal(one.tiles, other.tiles)


@pytest.mark.parametrize("kind", ["npz", "zarr"])
def test_explain_says_how_high_the_ground_is(hall: Path, kind: str) -> None:
    heights = [
        ask("explain", hall / f"first.{kind}", *point)["ground"]
        for point in (("2", "1"), ("7.25", "3"), ("50", "3"))
    ]
    assert heights[:2] == pytest.approx([0.0, 0.15], abs=0.03)  # half-way up the ramp
    assert heights[2] is None


def test_a_ground_that_was_altered_is_refused(hall: Path, tmp_path: Path) -> None:
    store = shutil.copytree(hall / "first.zarr", tmp_path / "first.zarr")
    shutil.rmtree(store / "ground")
    error = read_error(occmap("render", store, "-o", tmp_path / "map.pgm"), 1)
    assert "first.zarr: its table of blocks, or its ground, was altered" in error


def run_out_of_space(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


def test_outputs_that_cannot_be_are_refused(built: Path, here: Path) -> None:
    render, (file, store) = "render", (built / "whole.npz", built / "whole.zarr")
    (here / "full.zarr").mkdir()
    (here / "full.zarr" / "notes.txt").write_text("mine\n")
    assert "not as occmap writes" in read_error(occmap(render, file, "-o", "full.zarr"), 1)
    assert "is an input" in read_error(occmap(render, store, "-o", store), 2)
    assert "does not exist" in read_error(occmap(render, store, "-o", "none/m.zarr"), 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("zarr.storage._local._put", run_out_of_space)
        error = read_error(occmap(render, file, "-o", "m.zarr"), 1)
    assert error.startswith("m.zarr: cannot be written (No space left on device); make room")


def test_a_store_replaces_a_store(built: Path, here: Path) -> None:
    for name in ("early", "whole"):
        assert occmap("render", built / f"{name}.zarr", "-o", "m.zarr").code == 0
    occmap("render m.zarr -o m.npz")
    assert (here / "m.npz").read_bytes() == (built / "whole.npz").read_bytes()
    assert sorted(each.name for each in here.iterdir()) == ["m.npz", "m.zarr"]


@pytest.mark.parametrize("extent", ["", "--extent -3,-2,9,4"])
def test_tiles_are_painted_one_by_one(built: Path, tmp_path: Path, extent: str) -> None:
    run_both(built, tmp_path, f"render IN/whole.in -o OUT/m.tiles {extent}")
    one, other = (list_files(tmp_path / f"{kind}-m.tiles") for kind in ("npz", "zarr"))
    assert one == other
    assert len(one) > 4


@pytest.mark.parametrize("box", [None, (-3.0, -2.0, 1.0, 4.0), (-30.0, -25.0, 1.0, 4.0)])
def test_an_overview_is_the_map_made_small(
    built: Path, tmp_path: Path, box: tuple[float, ...] | None
) -> None:
    store = built / "whole.zarr"
    extent = [] if box is None else ["--extent", ",".join(map(str, box))]
    assert occmap("render", store, "-o", tmp_path / "all.pgm", *extent).code == 0
    done = occmap("render", store, "-o", tmp_path / "small.pgm", "--overview", "4", *extent)
    assert (done.code, done.out.splitlines()[0].split("cells of ")[1][:5]) == (0, "0.2 m")
    whole, small = (load_map(tmp_path / f"{n}.pgm", WriteOptions()) for n in ("all", "small"))
    assert whole.place
    assert small.place
    starts = zip(whole.place[2:0:-1], small.place[2:0:-1], strict=True)
    before = [round((of_whole - of_small) / SIDE_M) for of_whole, of_small in starts]
    sizes = zip(small.classes.shape, whole.classes.shape, before, strict=True)
    # One pixel more: a hit speaks for the cell beside it, which may be the first one there.
    around = [(start + 4, 4 * few - many - start + 4) for few, many, start in sizes]
    padded = np.pad(whole.classes, around, constant_values=99)
    largest = padded.reshape(-1, 4, padded.shape[1] // 4, 4).max(axis=(1, 3))[1:-1, 1:-1]
    assert (small.classes == largest)[largest < 99].all()
    assert abs(whole.classes.size - small.classes.size * 16) <= 64 * sum(whole.classes.shape)


def test_the_coarsest_overview_lies_on_the_lattice_of_its_pixels(here: Path) -> None:
    """Else a GeoTIFF of it, and what is drawn over it, would lie beside it."""
    log = write_csv(here / "far.csv", [(-100.0, -100.0, 0.0), (60000.0, -100.0, 0.0)], [2.0])
    ask(f"build {log} --max-speed inf -o far.zarr")
    ask("render far.zarr --overview 4096 -o m.pgm")
    place = load_map(here / "m.pgm", WriteOptions()).place
    assert place == (4096 * 0.05, -4096 * 0.05, -4096 * 0.05)


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (lambda folder: os.truncate(folder / "zarr.json", 20), "cannot be read: it is cut or alt"),
        (lambda folder: (folder / "c" / "0" / "0").unlink(), "a file of its pictures is missing"),
    ],
)
def test_an_overview_that_is_cut_says_so(
    built: Path, tmp_path: Path, spoil: Callable[[Path], None], found: str
) -> None:
    store = tmp_path / "cut.zarr"
    shutil.copytree(built / "whole.zarr", store)
    spoil(store / "classes" / "4")
    done = occmap("render", store, "-o", tmp_path / "m.pgm", "--overview", "4")
    assert found in read_error(done, 1)


def test_nothing_is_left_of_blocks_that_are_taken_away(built: Path, here: Path) -> None:
    whole, log = built / "early.zarr", write_csv(here / "far.csv", [(300.0, 0.0, 0.0)], [2.0], 0.1)
    ask(f"build surface {log} --resolution {SIDE_M} --pass-gap 3 -o far.zarr")
    ask(f"merge {whole} far.zarr -o both.zarr")
    ask("merge both.zarr --subtract far.zarr -o left.zarr")
    one, other = (open_store(each) for each in (whole, here / "left.zarr"))
    assert one.blocks == other.blocks
    heads = [each.root.attrs["occmap"] for each in (one, other)]
    assert heads[0]["digest"] == heads[1]["digest"]
    small = [ask(f"render {each} --overview 4 -o m.pgm")["map"] for each in (whole, "left.zarr")]
    assert small[0] == small[1]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("whole.npz --overview 4", "--overview goes with a store"),
        ("whole.zarr --overview 5", "there are those of 1, 4, 16"),
        ("whole.zarr --overview 4 --min-passes 2", "leave out --overview"),
        ("whole.zarr --overview 4 --since 5", "leave out --overview"),
        ("whole.zarr --overview 4 -o m.html", "m.html: shows single cells, and --overview has"),
        ("whole.zarr --overview 4 --p-hit 0.8 --model simple", "leave out --overview"),
    ],
)
def test_overviews_that_cannot_be(built: Path, here: Path, words: str, found: str) -> None:
    assert found in read_error(occmap(f"render {built}/{words} -o m.pgm"), 2)
    assert not list(here.iterdir())


@pytest.mark.parametrize("more", ["", "--min-passes 2 --extent 0,0,6,5"])
def test_large_maps_in_memory_are_painted_in_parts(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: str
) -> None:
    lines = [f"render {built}/whole.npz -o OUT.{suffix} {more}" for suffix in ("tif", "pgm", "png")]
    lines.append(f"build {DRIVE} -o OUT.npz {more}")

    def run_all(name: str) -> tuple[list[object], list[bytes]]:
        asked = [ask(line.replace("OUT", f"{tmp_path}/{name}")) for line in lines]
        files = [Path(made["files"][0]).read_bytes() for made in asked]
        return [(made["map"], made["notes"]) for made in asked], files

    whole = run_all("whole"), build_map(DRIVE)
    monkeypatch.setattr(painting, "LARGE_TILES", 0)
    assert run_all("parts") == whole[0]
    assert "--max-cells" in read_error(occmap(f"{lines[1]} --max-cells 99"), 1)
    shown = build_map(DRIVE)
    np.testing.assert_array_equal(shown.probability, whole[1].probability)
    assert (shown.agreement, shown.about) == (whole[1].agreement, whole[1].about)


def test_nothing_lies_between_two_sites_far_apart(built: Path, tmp_path: Path) -> None:
    near, far = f"{built}/early.npz", f"{tmp_path}/far.npz"
    ask(f"build {DRIVE} --resolution {SIDE_M} --pass-gap 3 -o {far} --transform 90000,90000,0")
    both = ask(f"merge {near} {far} -o {tmp_path}/both.npz")["map"]
    cells = [ask(f"render {each} -o {tmp_path}/one.pgm")["map"] for each in (near, far)]
    observed = [it["columns"] * it["rows"] * (1 - it["unknown"]) for it in (both, *cells)]
    assert observed[0] == pytest.approx(observed[1] + observed[2], rel=1e-3)
