"""Files of a map say what it is of, and nothing of when it was made."""

import hashlib
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from mcap.reader import make_reader
from PIL import Image
from ruamel.yaml import YAML

from occmap.cells import Manifest, make_factors, sum_tiles
from occmap.store import identify, open_store
from occmap.writers.npz import read_evidence
from tests.cli.runner import ask, occmap
from tests.samples import SAMPLE_LOGS

DRIVE = SAMPLE_LOGS / "drive.mcap"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive in all formats that say what they are of."""
    folder = tmp_path_factory.mktemp("built")
    suffixes = ("pgm", "png", "npz", "mcap", "tif", "zarr", "html")
    outputs = [word for suffix in suffixes for word in ("-o", folder / f"m.{suffix}")]
    assert occmap("build", "-q", DRIVE, *outputs).code == 0
    return folder


def read_comments(path: Path) -> dict[str, str]:
    lines = (line.partition(": ") for line in path.read_text().splitlines())
    return {name[2:]: text for name, _, text in lines if name.startswith("# ")}


def read_texts(path: Path) -> dict[str, str]:
    """The texts in a PNG."""
    with Image.open(path) as image:
        return {str(name): str(text) for name, text in image.info.items()}


def test_all_formats_say_the_same(built: Path) -> None:
    said = read_comments(built / "m.yaml")
    assert list(said) == ["occmap", "evidence", "rendering", "logs"]
    assert said["logs"] == '"drive.mcap"'
    with (built / "m.mcap").open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.metadata == said
    with rasterio.open(built / "m.tif") as image:
        assert said.items() <= image.tags().items()
    assert said.items() <= read_texts(built / "m.png").items()
    head = json.loads(bytes(np.load(built / "m.npz")["manifest"]))
    store = open_store(built / "m.zarr")
    assert head["evidence"] == store.name == said["evidence"]
    assert identify(replace(store, name="")) == store.name  # as of a store without a name
    page = (built / "m.html").read_text()
    assert said["evidence"] in page
    assert said["rendering"] in page


def test_a_turned_map_says_so_and_diff_notes_it(built: Path, tmp_path: Path) -> None:
    names = ("npz", "zarr", "yaml", "png")
    turned = {name: tmp_path / f"t.{name}" for name in names}
    outputs = [word for name in names for word in ("-o", tmp_path / f"t.{name}") if name != "yaml"]
    words = [*outputs, "-o", tmp_path / "t.pgm", "--align", 30]
    assert occmap("build", "-q", DRIVE, *words).code == 0
    assert read_comments(turned["yaml"])["align"] == "30.0"
    for name, path in turned.items():
        assert ask("diff", path, turned["npz"])["notes"] == []
        if name != "png":  # of another size, and it does not say where it lies
            (note,) = ask("diff", built / "m.npz", path)["notes"]
            assert f"{path} is turned by 30.0 degrees" in note
    assert ask("diff", built / "m.yaml", built / "m.npz")["notes"] == []


def test_loaders_of_the_yaml_see_what_they_always_saw(built: Path) -> None:
    loaded = YAML(typ="safe").load((built / "m.yaml").read_text())
    assert set(loaded) == {
        *("image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
    }


@pytest.mark.parametrize(
    "words", [("--jobs", 2), ("--resume", "a.npz", "--start", 40)], ids=["jobs", "resume"]
)
def test_equal_evidence_has_one_name(words: tuple[Any, ...], built: Path, here: Path) -> None:
    if "--resume" in words:
        assert occmap("build", "-q", DRIVE, "--end", 40, "-o", "a.npz").code == 0
    assert occmap("build", "-q", DRIVE, *words, "-o", "m.pgm").code == 0
    assert (here / "m.yaml").read_bytes() == (built / "m.yaml").read_bytes()


def test_merged_and_rendered_evidence_has_the_name_too(built: Path, tmp_path: Path) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.zarr"
    assert occmap("build", "-q", DRIVE, "--end", 40, "-o", a).code == 0
    assert occmap("build", "-q", DRIVE, "--start", 40, "-o", b).code == 0
    said = read_comments(built / "m.yaml")
    for line in (("merge", b, a), ("render", built / "m.npz"), ("render", built / "m.zarr")):
        assert occmap(*line, "-q", "-o", tmp_path / "m.pgm").code == 0
        assert read_comments(tmp_path / "m.yaml") == said
    for words in (("--cut", "0.5"), ("--margin", "1"), ("--mode", "raw"), ("--min-passes", "2")):
        rendered = occmap("render", "-q", built / "m.npz", "-o", tmp_path / "m.pgm", *words)
        assert rendered.code == 0
        other = read_comments(tmp_path / "m.yaml")
        assert other.pop("rendering") != said["rendering"]
        assert other.items() <= said.items()


def test_edits_change_the_rendering_by_what_they_draw(built: Path, tmp_path: Path) -> None:
    line = ("render", "-q", built / "m.npz", "-o", tmp_path / "m.pgm", "--edits")
    names = []
    for file, text in (("a", "free,box,0,0,1,1"), ("b", "free,box,0,0,1,1 # x"), ("b", "")):
        (tmp_path / file).write_text(text)
        assert occmap(*line, tmp_path / file).code == 0
        names.append(read_comments(tmp_path / "m.yaml")["rendering"])
    assert names[0] == names[1] != names[2] == read_comments(built / "m.yaml")["rendering"]


def test_diff_says_if_maps_are_of_one_evidence(built: Path, here: Path) -> None:
    name = read_comments(built / "m.yaml")["evidence"]
    occmap("render", "-q", built / "m.npz", "-o", "m.png", "--cut", "0.5")
    told = occmap("diff", built / "m.pgm", "m.png")
    assert f"evidence {name}, of both; what changed is the rendering or the image" in told.out
    told = occmap("diff", built / "m.npz", built / "m.pgm")
    assert f"evidence {name}, of both\n" in told.out
    occmap("build", "-q", DRIVE, "--end", 40, "-o", "other.npz")
    second = json.loads(bytes(np.load("other.npz")["manifest"]))["evidence"]
    assert ask("diff", built / "m.pgm", "other.npz")["evidence"] == [name, second]
    lines = (built / "m.yaml").read_text().splitlines(keepends=True)
    (here / "bare.yaml").write_text("".join(line for line in lines if line[0] != "#"))
    shutil.copy(built / "m.pgm", here)
    assert ask("diff", "bare.yaml", built / "m.pgm")["evidence"] == [None, name]


def test_names_of_logs_break_no_line(tmp_path: Path) -> None:
    log = tmp_path / 'a\nimage: b"é.csv'
    log.write_bytes((SAMPLE_LOGS / "drive.csv").read_bytes())
    assert occmap("build", "-q", log, "-o", tmp_path / "m.pgm", "-o", tmp_path / "m.png").code == 0
    said = read_comments(tmp_path / "m.yaml")["logs"]
    assert said == r'"a\nimage: b\"\u00e9.csv"'
    assert read_texts(tmp_path / "m.png")["logs"] == said
    assert YAML(typ="safe").load((tmp_path / "m.yaml").read_text())["image"] == "m.pgm"


def test_a_name_is_that_of_a_slow_sum(built: Path) -> None:
    evidence = read_evidence(built / "m.npz")
    factors = make_factors(2 * 64 * 64).tolist()
    total = 0
    for (row, col), tile in evidence.tiles.items():
        place = int.from_bytes(hashlib.sha256(f"{row} {col}".encode()).digest()[:8], "big") | 1
        numbers = tile.ravel().tolist()
        total += place * sum(map(math.prod, zip(factors, numbers, strict=True)))
    what = f"0.05 surface  {total % 2**64}"
    name = hashlib.sha256(what.encode()).hexdigest()[:12]
    assert name == read_comments(built / "m.yaml")["evidence"]


def test_order_width_and_empty_tiles_count_for_nothing() -> None:
    rng = np.random.default_rng(3)
    tiles = {(-2, 7): rng.integers(-9, 9, (2, 64, 64)), (0, 0): rng.integers(0, 9, (2, 64, 64))}
    manifest = Manifest(0.05, "beam", "counts", "", 10.0, 0.5, "counting", ())
    name = manifest.identify(sum_tiles(tiles))
    nothing = {(5, 5): np.zeros((2, 64, 64), np.int32)}
    others = {key: tile.astype(np.int32) for key, tile in reversed(tiles.items())}
    assert manifest.identify(sum_tiles(others | nothing)) == name
    swapped = dict(zip(tiles, reversed(tiles.values()), strict=True))
    assert manifest.identify(sum_tiles(swapped)) != name
    tiles[0, 0][1, 3, 3] += 1
    assert manifest.identify(sum_tiles(tiles)) != name
