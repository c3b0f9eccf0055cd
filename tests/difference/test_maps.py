"""Written maps are read back as what they were; damaged ones are one line."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from occmap.cells import CellClass, Decision
from occmap.difference.maps import Place, load_map
from occmap.errors import MapError, OccmapError
from occmap.writers import MapMode, Shade, WriteOptions, Writer
from occmap.writers.pgm import PgmWriter
from occmap.writers.png import PngWriter
from tests.difference.drawings import write_art
from tests.writers.maps import map_of, map_of_art

OPTIONS = WriteOptions()
ART = """
    #..?
    ..#-
"""
META = "image: m.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"
THRESHOLDS = "occupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.mark.parametrize("mode", MapMode)
def test_every_mode_of_a_pgm_is_read_back(tmp_path: Path, mode: MapMode) -> None:
    grid = map_of_art(ART)
    PgmWriter().write(tmp_path / "m.pgm", grid, WriteOptions(mode))
    for name in ("m.pgm", "m.yaml"):
        loaded = load_map(tmp_path / name, OPTIONS)
        assert write_art(loaded.classes) == "#..? ..#?"
        assert loaded.place == Place(0.05, 0.0, 0.0)


def test_a_png_is_read_back_by_the_thresholds_given(tmp_path: Path) -> None:
    PngWriter().write(tmp_path / "m.png", map_of([[0.7, 0.3, np.nan]]), OPTIONS)
    loaded = load_map(tmp_path / "m.png", OPTIONS)
    assert (write_art(loaded.classes), loaded.place) == ("#.?", None)
    loaded = load_map(tmp_path / "m.png", WriteOptions(occupied_thresh=0.8, free_thresh=0.4))
    assert write_art(loaded.classes) == "?.?"


@pytest.mark.parametrize("shade", Shade)
@pytest.mark.parametrize("cut", [Decision(0.32, 0.32), Decision(0.2, 0.65)])
def test_a_png_says_how_each_cell_was_decided(tmp_path: Path, cut: Decision, shade: Shade) -> None:
    """Also of cells whose probability rounds to a shade on the other side of a threshold."""
    near = [edge + away for edge in cut for away in (-3e-3, -1e-4, 1e-4, 3e-3)]
    grid = replace(map_of([[0.001, *near, 0.999, np.nan]]), decision=cut)
    PngWriter().write(tmp_path / "m.png", grid, WriteOptions(shade=shade))
    assert np.array_equal(load_map(tmp_path / "m.png", OPTIONS).classes, grid.classes)


def test_a_png_of_another_tool_is_dark_where_occupied(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 120, 255]], np.uint8)).save(tmp_path / "m.png")
    assert write_art(load_map(tmp_path / "m.png", OPTIONS).classes) == "#?."


def test_colours_are_as_dark_as_map_server_takes_them(tmp_path: Path) -> None:
    """The mean of red, green and blue: of green and blue 85, of yellow and cyan 170."""
    colours = [(0, 255, 0), (0, 0, 255), (255, 255, 0), (0, 255, 255), (255, 255, 255)]
    image = Image.fromarray(np.array([colours], np.uint8))
    for number, kind in enumerate((image, image.convert("P"), image.convert("RGBA"))):
        kind.save(tmp_path / f"{number}.png")
        assert write_art(load_map(tmp_path / f"{number}.png", OPTIONS).classes) == "##??."


def write_foreign(folder: Path, yaml: str, pixels: list[list[int]]) -> Path:
    Image.fromarray(np.array(pixels, np.uint8)).save(folder / "m.pgm")
    (folder / "m.yaml").write_text(yaml)
    return folder / "m.yaml"


def test_a_yaml_of_another_tool_is_read_by_the_rules_of_map_server(tmp_path: Path) -> None:
    # Without a mode it is trinary; 89.25 is the grey of 0.65, and comparisons are strict.
    text = META.replace("[-1.0, 2.0, 0.0]", "\n- -1\n- 2\n- 0") + THRESHOLDS + "# the end\n"
    loaded = load_map(write_foreign(tmp_path, text, [[89, 90, 205, 206]]), OPTIONS)
    assert write_art(loaded.classes) == "#??."
    assert loaded.place == Place(0.05, -1.0, 2.0)


def test_thresholds_that_a_yaml_goes_before_are_noted(tmp_path: Path) -> None:
    path = write_foreign(tmp_path, META + THRESHOLDS, [[120]])
    loaded = load_map(path, WriteOptions(occupied_thresh=0.5))
    (note,) = loaded.notes
    assert (write_art(loaded.classes), note.endswith("and not `occupied_thresh`")) == ("?", True)


def test_a_map_may_lie_where_a_float_still_tells_metres_apart(tmp_path: Path) -> None:
    text = META.replace("0.05", "1e15").replace("2.0", "-1e15") + THRESHOLDS
    assert load_map(write_foreign(tmp_path, text, [[0]]), OPTIONS).place == Place(1e15, -1.0, -1e15)


def test_negate_turns_black_and_white(tmp_path: Path) -> None:
    path = write_foreign(tmp_path, META.replace("negate: 0", "negate: 1") + THRESHOLDS, [[0, 255]])
    assert write_art(load_map(path, OPTIONS).classes) == ".#"


def test_a_whole_turn_is_none(tmp_path: Path) -> None:
    path = write_foreign(tmp_path, META.replace(", 0.0]", ", 6.28318531]") + THRESHOLDS, [[0]])
    assert load_map(path, OPTIONS).place == Place(0.05, -1, 2)


@pytest.mark.parametrize(("free", "art"), [("0.25", "#.."), ("0.196", "#?.")])
def test_a_threshold_that_makes_what_is_unknown_free_is_told(
    tmp_path: Path, free: str, art: str
) -> None:
    """205 is (255 - 205) / 255 = 0.19608; nav2's map_saver writes 0.25 unless it is told."""
    thresholds = f"occupied_thresh: 0.65\nfree_thresh: {free}\n"
    path = write_foreign(tmp_path, META + thresholds, [[0, 205, 254]])
    loaded = load_map(path, OPTIONS)
    assert write_art(loaded.classes) == art
    told = [f"{path}: its free_thresh of 0.25 makes 1 pixel of grey 205 free"]
    assert [note.split(",")[0] for note in loaded.notes] == told * (free == "0.25")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "holds no names with values"),
        ("- 1\n- 2\n", "holds no names with values"),
        ("a: [1\n", "is not YAML"),
        ("a: 1\nb:\t2\n", "is not YAML (line 2: found character"),
        ("a: \xff\n", "image is None, where the name of a file"),
        (THRESHOLDS, "image is None, where the name of a file"),
        (META, "occupied_thresh is None, where a number belongs"),
        (META.replace("0.05", ".nan") + THRESHOLDS, "resolution is '.nan', where a number"),
        (META.replace("0.05", "0") + THRESHOLDS, "resolution is 0.0, where a length"),
        (META.replace("0.05", "1.01e15") + THRESHOLDS, "resolution is 1010000000000000.0"),
        (META.replace("2.0", "1.01e15") + THRESHOLDS, "where a length up to 1e+15 m"),
        (META.replace("2.0, 0.0", "2.0") + THRESHOLDS, "where [x, y, yaw] belongs"),
        (META.replace("2.0, 0.0", "2.0, 0.1") + THRESHOLDS, "the map is turned by 0.1 rad"),
        (META.replace("e: 0", "e: 2") + THRESHOLDS, "negate is '2', where 0 or 1 belongs"),
        (
            META + "occupied_thresh: 0.2\nfree_thresh: 0.6\n",
            "free_thresh is 0.6, where no more than occ",
        ),
        (META + THRESHOLDS + "mode: grey\n", "mode is 'grey', where trinary, scale or raw"),
        (META.replace("m.pgm", "x.pgm") + THRESHOLDS, "names the image x.pgm, which is not there"),
    ],
)
def test_a_yaml_that_does_not_do_is_one_line(tmp_path: Path, text: str, found: str) -> None:
    path = write_foreign(tmp_path, text, [[0]])
    with pytest.raises(MapError) as caught:
        load_map(path, OPTIONS)
    assert str(caught.value).startswith(str(tmp_path))
    assert found in str(caught.value)


def test_a_file_that_is_no_map_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "no.png").write_bytes(b"no image")
    (tmp_path / "bare.pgm").write_bytes(b"P5 2 2 255\n")
    for name, found in (
        ("m.txt", "suffix '.txt' is not that of a map; maps are .pgm"),
        ("m.png", "m.png: no such file"),
        ("no.png", "no.png: is not a PGM, PNG or BMP image"),
        ("bare.pgm", "bare.pgm: there is no bare.yaml beside it; give the YAML"),
    ):
        with pytest.raises(OccmapError, match=re.escape(found)):
            load_map(tmp_path / name, OPTIONS)


@pytest.mark.parametrize(("writer", "name"), [(PngWriter(), "m.png"), (PgmWriter(), "m.pgm")])
def test_a_cut_or_altered_image_raises_nothing_else(
    tmp_path: Path, writer: Writer, name: str
) -> None:
    path = tmp_path / name
    writer.write(path, map_of(np.full((9, 9), 0.9)), OPTIONS)
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    with pytest.raises(MapError):
        load_map(path, OPTIONS)
    for at, byte in enumerate(whole):
        for damaged in (whole[:at], whole[:at] + bytes([byte ^ 0xFF]) + whole[at + 1 :]):
            path.write_bytes(damaged)
            try:
                assert load_map(path, OPTIONS).classes.max() <= CellClass.OCCUPIED
            except MapError as error:
                assert str(error).startswith(str(path))  # noqa: PT017  some damage does not show


def test_an_image_of_16_bits_is_refused(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint16)).save(tmp_path / "m.png")
    with pytest.raises(MapError, match="are not a map; save it as 8 bit"):
        load_map(tmp_path / "m.png", OPTIONS)
