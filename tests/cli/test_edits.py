"""What a person draws over a map outlives rebuilds, merges and fleets, and no evidence has it."""

import os
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from PIL import Image

from occmap import build_map
from occmap.page.pages import describe_product
from occmap.writers import Product
from occmap.writers.npz import read_evidence
from tests.cli.runner import ask, occmap
from tests.grid.scans import are_equal
from tests.samples import SAMPLE_LOGS

DRIVE = SAMPLE_LOGS / "drive.mcap"
X, Y = -4.05, -3.05
"""The corner of its map (m), as occmap prints it"""


@pytest.fixture(autouse=True)
def _edits(here: Path) -> None:
    (here / "edits.csv").write_text("free,box,10.9,-1.5,11.5,-0.9\nforbidden,box,0,0,1,0.5\n")


def read_box(path: str, x: float, y: float, x_end: float, y_end: float) -> np.ndarray:
    """The pixels of a box of the drive's map, in cells of 0.05 m."""
    pixels = np.asarray(Image.open(path))[::-1]
    col, row, col_end, row_end = (
        round((at - low) / 0.05) for at, low in ((x, X), (y, Y), (x_end, X), (y_end, Y))
    )
    return pixels[row:row_end, col:col_end]


def test_edits_outlive_a_rebuild_a_merge_and_a_render() -> None:
    assert occmap("build", DRIVE, "-o", "plain.pgm").code == 0
    assert (read_box("plain.pgm", 10.9, -1.5, 11.5, -0.9) == 0).any()  # the pallet
    assert occmap("build", DRIVE, "--end", 40, "-o", "a.npz").code == 0
    assert occmap("build", DRIVE, "--start", 40, "-o", "b.npz", "--edits", "edits.csv").code == 0
    assert occmap("merge", "a.npz", "b.npz", "-o", "both.npz", "-o", "both.zarr").code == 0
    edited = ("--edits", "edits.csv", "-o")
    assert occmap("build", DRIVE, *edited, "built.pgm").code == 0
    assert occmap("merge", "a.npz", "b.npz", *edited, "merged.pgm").code == 0
    for name in ("both.npz", "both.zarr"):
        assert occmap("render", name, *edited, f"{name}.pgm").code == 0
    for name in ("built.pgm", "merged.pgm", "both.npz.pgm", "both.zarr.pgm"):
        assert (read_box(name, 10.9, -1.5, 11.5, -0.9) == 254).all()
        assert Path(name).read_bytes() == Path("built.pgm").read_bytes()
    assert occmap("render", "both.npz", "-o", "again.pgm").code == 0
    assert Path("again.pgm").read_bytes() == Path("plain.pgm").read_bytes()


def test_what_is_drawn_beyond_all_blocks_of_a_store_is_counted() -> None:
    """A square of 2 m, 100 m away: 40 x 40 cells."""
    Path("far.csv").write_text("occupied,box,100,100,102,102\n")
    occmap("build", DRIVE, "-o", "map.zarr")
    line = "render map.zarr --extent -5,-5,105,105 -o map.tif"
    plain, edited = (ask(each)["map"] for each in (line, f"{line} --edits far.csv"))
    cells = edited["columns"] * edited["rows"]
    assert (edited["occupied"] - plain["occupied"]) * cells == pytest.approx(1600)
    assert (plain["unknown"] - edited["unknown"]) * cells == pytest.approx(1600)


def test_evidence_names_the_file_of_edits_and_has_nothing_of_it() -> None:
    occmap("build", DRIVE, "-o", "plain.npz")
    occmap("build", DRIVE, "-o", "edited.npz", "--edits", "edits.csv")
    plain, edited = (read_evidence(Path(name)) for name in ("plain.npz", "edited.npz"))
    assert are_equal(plain.tiles, edited.tiles)
    assert "edits" not in plain.manifest.builds[0]
    assert edited.manifest.builds[0]["edits"] == "edits.csv"


def test_the_counts_of_a_map_are_those_of_what_is_written() -> None:
    Path("all.csv").write_text("occupied,box,-100,-100,100,100\n")
    assert ask("build", DRIVE, "-o", "m.pgm", "--edits", "all.csv")["map"]["occupied"] == 1.0


def test_a_keepout_mask_has_what_is_forbidden() -> None:
    assert occmap("build", DRIVE, "--edits", "edits.csv", "-o", "keepout.pgm").code == 0
    pixels = np.asarray(Image.open("keepout.pgm"))
    assert (read_box("keepout.pgm", 0, 0, 1, 0.5) == 0).all()
    assert (pixels == 0).sum() == 20 * 10
    assert (pixels == 254).sum() == 322 * 243 - 200
    assert "mode: trinary" in Path("keepout.yaml").read_text()


def test_edits_may_come_from_a_pipe() -> None:
    os.mkfifo("pipe")
    writer = Thread(target=lambda: Path("pipe").write_text("free,box,10.9,-1.5,11.5,-0.9\n"))
    writer.start()
    assert occmap("build", DRIVE, "-o", "m.pgm", "--edits", "pipe").code == 0
    writer.join()
    assert (read_box("m.pgm", 10.9, -1.5, 11.5, -0.9) == 254).all()


def test_free_is_free_whatever_the_cut() -> None:
    words = ("--edits", "edits.csv", "--model", "counting:cut=0.005", "-o", "m.pgm")
    assert occmap("build", DRIVE, *words).code == 0
    assert (read_box("m.pgm", 10.9, -1.5, 11.5, -0.9) == 254).all()


def test_what_was_edited_can_be_subtracted_as_what_was_not() -> None:
    occmap("build", DRIVE, "--end", 40, "-o", "a.npz")
    occmap("build", DRIVE, "--start", 40, "-o", "b.npz")
    occmap("build", DRIVE, "--start", 40, "--edits", "edits.csv", "-o", "edited.npz")
    occmap("merge", "a.npz", "edited.npz", "-o", "both.npz")
    done = occmap("merge", "both.npz", "--subtract", "b.npz", "-o", "rest.npz")
    assert (done.code, done.err) == (0, "")
    assert len(read_evidence(Path("rest.npz")).manifest.builds) == 1


@pytest.mark.parametrize(
    ("shape", "is_vain"),
    [
        ("free,box,100,2,101,3", True),
        ("free,box,2,100,3,101", True),
        ("forbidden,polygon,-9,0,-8,0,-8,1", True),
        ("free,box,11,-1,90,2", False),
        ("free,box,1,1,1.02,1.3", True),  # the middle of the cell is at 1.025
        ("free,line,-4.2,0,-4.2,1,0.2", True),  # it ends at -4.1, and the map at -4.05
        ("free,line,-4.2,0,-4.2,1,0.4", False),
        ("free,line,-9,2,-8,2,0.05", True),
    ],
)
def test_a_shape_without_effect_is_named(shape: str, is_vain: bool) -> None:
    Path("edits.csv").write_text(f"{shape}\n")
    assert occmap("build", DRIVE, "-o", "m.npz", "-q").code == 0
    for line in (("build", DRIVE), ("render", "m.npz")):
        made = occmap(*line, "-o", "m.pgm", "--edits", "edits.csv")
        notes = [each for each in made.err.splitlines() if "without effect" in each]
        assert len(notes) == is_vain
        if shape.startswith("free,box,100"):
            assert "x 100 to 101 m, y 2 to 3 m" in notes[0]
        if shape == "free,line,-9,2,-8,2,0.05":  # cells reach sqrt(0.5) x 0.05 m to each side
            assert "x -9.035 to -7.965 m, y 1.965 to 2.035 m" in notes[0]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        *((text, "edits.csv: holds no shape") for text in ("", "# nothing\n", '{"features": []}')),
        ("free,line,1,0.5,1.01,0.51", "if they are degrees"),
        ("free,line,1,0.5,1.1,0.51", ""),
    ],
)
def test_a_file_without_a_shape_or_of_degrees_is_told(text: str, told: str) -> None:
    Path("edits.csv").write_text(text)
    assert occmap("build", DRIVE, "-o", "m.npz", "-q").code == 0
    for line in (("build", DRIVE), ("render", "m.npz")):
        made = occmap(*line, "--georeference", "0.5,1,0", "-o", "m.png", "--edits", "edits.csv")
        assert (made.code, told in made.err, "edits.csv" in made.err) == (0, True, told != "")


def test_diff_tells_changes_where_edits_lie_from_others() -> None:
    Path("more.csv").write_text("free,box,10.9,-1.5,11.5,-0.9\nforbidden,box,0,0,9,9\n")
    Path("elsewhere.csv").write_text("free,box,0,0,1,1\nforbidden,box,10.9,-1.5,11.5,-0.9\n")
    assert occmap("build", "-q", DRIVE, "-o", "m.npz", "-o", "plain.pgm").code == 0
    assert occmap("render -q m.npz -o edited.pgm --edits more.csv").code == 0
    plain, edited = (np.asarray(Image.open(f"{name}.pgm")) for name in ("plain", "edited"))
    line = "diff plain.pgm edited.pgm"
    said = ask(f"{line} --edits more.csv")
    assert said["edited"] == said["changed"] == (plain != edited).sum() > 0
    told = occmap(f"{line} --edits elsewhere.csv")
    assert "edits    0 changed cells in shapes that were drawn" in told.out
    assert ask(line)["edited"] is None


def test_a_page_has_the_outlines_of_edits() -> None:
    Path("edits.csv").write_text("free,polygon,1,2,3,2,3,4\noccupied,line,0,0,5,0\n")
    made = build_map(DRIVE, outputs="m.npz", edits="edits.csv")
    evidence = made.evidence
    page = describe_product(Product(made, lambda: evidence), made.writing)
    assert page.stage is not None
    outlines = [each for each in page.stage.plots[0].renderers if each.name == "edits"]
    corners = [(list(o.data_source.data["x"]), list(o.data_source.data["y"])) for o in outlines]
    assert corners == [([1, 3, 3, 1], [2, 2, 4, 2]), ([0, 5], [0, 0])]
