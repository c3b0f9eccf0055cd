from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from occmap import writers
from occmap.cells import Decision, OccupancyMap
from occmap.errors import OutputError
from occmap.writers import MapMode, WriteOptions
from occmap.writers.pgm import PgmWriter, written_thresholds
from occmap.writers.png import PngWriter
from tests.map_loaders import Grid, load_nav2, load_ros1, read_pgm
from tests.writers.maps import map_of, map_of_art

ART = """
##?.
#-..
?..#
"""
pytestmark = pytest.mark.usefixtures("workplace")
TRINARY = WriteOptions()
Loader = Callable[[Path], Grid]
each_loader = pytest.mark.parametrize("load", [load_ros1, load_nav2])


def write(grid: OccupancyMap, options: WriteOptions = TRINARY) -> Path:
    PgmWriter().write(Path("map.pgm"), grid, options)
    return Path("map.yaml")


def expected_classes(grid: OccupancyMap, occupied: float, free: float) -> list[list[int]]:
    """Classify cell by cell, in the probabilities that the map holds."""

    def classify(log_odds: float, observed: bool) -> int:
        p = 1 / (1 + np.exp(-float(log_odds)))
        if not observed:
            return -1
        return 100 if p > occupied else 0 if p < free else -1

    rows = zip(grid.log_odds, grid.observed, strict=True)
    return [[classify(lo, seen) for lo, seen in zip(*row, strict=True)] for row in rows]


def test_golden_file() -> None:
    write(map_of_art(ART))
    black, grey, white = b"\x00", b"\xcd", b"\xfe"
    assert Path("map.pgm").read_bytes() == (
        b"P5\n4 3\n255\n"
        + (black + black + grey + white)
        + (black + grey + white + white)
        + (grey + white + white + black)
    )


def test_golden_yaml() -> None:
    yaml = write(map_of([[0.5]], origin=(-12.350000000000001, 1e5)))
    assert yaml.read_text() == (
        "image: map.pgm\n"
        "mode: trinary\n"
        "resolution: 0.05\n"
        "origin: [-12.350000000000001, 100000.0, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )


@pytest.mark.parametrize(
    ("name", "is_plain"),
    [
        *((name, False) for name in ("a: b.pgm", "grüße.PGM", "x " * 60 + ".pgm")),
        *((name, True) for name in ("map-0.05.pgm", "2024-05-01.pgm", "1e3.pgm", "no.pgm")),
    ],
)
def test_yaml_names_the_image_whatever_it_is_called(name: str, is_plain: bool) -> None:
    """Names with dots and words alone need no quotes."""
    PgmWriter().write(Path(name), map_of([[0.5]]), TRINARY)
    image, yaml = PgmWriter().targets(Path(name))
    assert YAML(typ="safe").load(yaml)["image"] == image.name == name
    assert yaml.stem == image.stem
    assert (yaml.read_text().splitlines()[0] == f"image: {name}") == is_plain


def test_numbers_are_numbers_to_yaml_1_1_too() -> None:
    """It takes 1e-05, without a dot, for text."""
    yaml = write(map_of([[0.5]], origin=(1e-05, -2.5e-07)))
    assert "origin: [1.0e-05, -2.5e-07, 0.0]\n" in yaml.read_text()


# A quarter per cent around the default thresholds, and well inside each class.
AROUND = [0.01, 0.19, 0.1935, 0.1985, 0.2, 0.5, 0.6475, 0.6525, 0.66, 0.99, np.nan]


@each_loader
@pytest.mark.parametrize(
    ("occupied", "free"),
    [(0.65, 0.196), (0.65, 0.25), (0.9, 0.4), (0.3, 0.1), (0.15, 0.05), (0.9999, 1e-4)],
)
def test_trinary_classes_survive_both_loaders(load: Loader, occupied: float, free: float) -> None:
    options = WriteOptions(MapMode.TRINARY, occupied, free)
    grid = map_of([AROUND, AROUND[::-1]])
    assert load(write(grid, options)).tolist() == expected_classes(grid, occupied, free)


@each_loader
def test_a_cell_on_a_threshold_is_undecided(load: Loader) -> None:
    for mode in (MapMode.TRINARY, MapMode.SCALE):
        # 0.2 is exactly the grey 204: no loader agrees with the other on that pixel.
        grid = map_of([[0.6, 0.2, 0.601, 0.199]])
        found = load(write(grid, WriteOptions(mode, 0.6, 0.2)))[0].tolist()
        assert found[2:] == [100, 0]
        assert all(each == -1 or 0 < each < 100 for each in found[:2])


@each_loader
def test_trinary_is_what_the_map_decides_and_the_yaml_tells_greys_apart(load: Loader) -> None:
    grid = replace(map_of([[0.31, 0.32, 0.33, np.nan]]), decision=Decision(0.32, 0.32))
    yaml = write(grid)
    assert load(yaml).tolist() == [[0, -1, 100, -1]]
    fields = YAML(typ="safe").load(yaml)
    assert (fields["occupied_thresh"], fields["free_thresh"]) == (0.65, 0.196)


USUAL, LOW = Decision(0.5, 0.5), Decision(0.32, 0.32)


@pytest.mark.parametrize(
    ("mode", "thresholds", "decision", "expected"),
    [
        (MapMode.TRINARY, (None, None), USUAL, USUAL),
        (MapMode.TRINARY, (None, None), LOW, LOW),
        (MapMode.TRINARY, (0.8, None), LOW, Decision(0.32, 0.8)),
        (MapMode.TRINARY, (None, 0.25), LOW, Decision(0.25, 0.32)),
        (MapMode.TRINARY, (0.8, 0.1), LOW, Decision(0.1, 0.8)),
        # What is above the user's one cannot be free by the map's other.
        (MapMode.TRINARY, (0.3, None), USUAL, Decision(0.3, 0.3)),
        (MapMode.TRINARY, (None, 0.6), USUAL, Decision(0.5, 0.5)),
        (MapMode.SCALE, (None, None), LOW, Decision(0.196, 0.65)),
        (MapMode.SCALE, (0.7, None), LOW, Decision(0.196, 0.7)),
        (MapMode.RAW, (None, None), LOW, Decision(0.196, 0.65)),
        (MapMode.RAW, (None, 0.1), USUAL, Decision(0.1, 0.65)),
    ],
)
def test_who_decides_what_a_cell_is(
    mode: MapMode,
    thresholds: tuple[float | None, float | None],
    decision: Decision,
    expected: Decision,
) -> None:
    assert WriteOptions(mode, *thresholds).decide(decision) == expected


@settings(max_examples=60)
@given(
    probabilities=st.lists(st.floats(0.001, 0.999), min_size=1, max_size=30),
    thresholds=st.tuples(st.floats(0.02, 0.98), st.floats(0.02, 0.98)).map(sorted),
)
def test_scale_classes_survive_both_loaders(
    probabilities: list[float], thresholds: list[float]
) -> None:
    free, occupied = thresholds[0], max(thresholds[1], thresholds[0] + 0.00801)
    options = WriteOptions(MapMode.SCALE, occupied, free)
    # Not nearer to a threshold than single precision can tell.
    kept = [p for p in probabilities if min(abs(p - free), abs(p - occupied)) > 1e-6]
    grid = map_of([[*kept, 0.999]])
    yaml = write(grid, options)
    expected = np.select([grid.probability > occupied, grid.probability < free], [100, 0], -1)
    for load in (load_ros1, load_nav2):
        loaded = load(yaml)
        assert np.where((loaded > 0) & (loaded < 100), -1, loaded).tolist() == expected.tolist()
    # The grey is off by its own rounding, by whole per cents, and by a step and half a per cent
    # of the span where it would cross a threshold.
    occupancy = 1 - read_pgm(yaml.with_suffix(".pgm")) / 255
    assert np.abs(occupancy - grid.probability).max() < (0.5 + 1) / 255 + 0.005 + 0.005


@pytest.mark.parametrize(
    ("probabilities", "thresholds", "greys", "loaded"),
    [
        # nav2: grey = (100 - per cent) / 100 of 255 = 229.5, 206.55, 127.5, 25.5, rounded by its
        # image library, halves down; unknown is half, for PGM has no transparency.
        (
            [0.1, 0.19, 0.5, 0.9, np.nan],
            (0.65, 0.196),
            [229, 207, 127, 25, 127],
            [0, 0, 67, 100, 67],
        ),
        # By 0.65 and 0.196 occupied is below 255 * 0.35 = 89.25 and free above 255 * 0.804 =
        # 205.02; nav2 takes half a per cent of the span between, 0.58, to either side. Rounded to
        # per cents, 0.646 and 0.1955 are 65 and 20, whose greys 89 and 204 are of the next class.
        ([0.6505, 0.646, 0.197, 0.1955], (0.65, 0.196), [89, 90, 204, 206], [100, 99, 1, 0]),
        # At the ends, 254 and 1 would load as 0 and 100.
        ([0.002, 0.5, 0.998], (1 - 1e-9, 1e-9), [253, 127, 2], [1, 50, 99]),
        # By 0.8 and 4/255 the span is from grey 51 to grey 251, and half a per cent of it is 1
        # grey. So 52 and 250 lie where nav2 rounds 99.5 and 0.5 per cent, whichever way that goes.
        ([0.799, 0.0167], (0.8, 4 / 255), [53, 249], [99, 1]),
    ],
)
def test_scale_has_nav2s_greys_but_never_those_of_another_class(
    probabilities: list[float], thresholds: tuple[float, float], greys: list[int], loaded: list[int]
) -> None:
    yaml = write(map_of([probabilities]), WriteOptions(MapMode.SCALE, *thresholds))
    assert read_pgm(yaml.with_suffix(".pgm"))[0].tolist() == greys
    assert load_nav2(yaml)[0].tolist() == loaded


@pytest.mark.parametrize("free", [0.55, 0.05])
def test_unknown_is_never_a_class_in_scale(free: float) -> None:
    yaml = write(map_of([[np.nan]]), WriteOptions(MapMode.SCALE, free + 0.1, free))
    assert 0 < load_ros1(yaml)[0, 0] < 100
    assert 0 < load_nav2(yaml)[0, 0] < 100


@each_loader
def test_raw_is_per_cent_and_255(load: Loader) -> None:
    grid = map_of([[0.003, 0.196, 0.5, 0.651, 0.999, np.nan]])
    yaml = write(grid, WriteOptions(MapMode.RAW))
    assert load(yaml).tolist() == [[0, 20, 50, 65, 100, -1]]
    assert read_pgm(yaml.with_suffix(".pgm"))[0, -1] == 255


def test_even_odds_are_undecided() -> None:
    grid = replace(map_of([[0.5] * 3]), log_odds=np.array([[0.0, 1e-6, -1e-6]], np.float32))
    assert load_nav2(write(grid)).tolist() == [[-1, 100, 0]]


def test_extreme_log_odds() -> None:
    log_odds = np.array([[-3e38, 3e38, -1e4, 1e4]], np.float32)
    grid = replace(map_of([[0.5] * 4]), log_odds=log_odds)
    for mode in MapMode:
        yaml = write(grid, WriteOptions(mode))
        assert load_nav2(yaml).tolist() == [[0, 100, 0, 100]]


def test_written_thresholds_keep_the_users_where_the_greys_allow() -> None:
    assert written_thresholds(WriteOptions(MapMode.TRINARY, 0.8, 0.1)) == (0.8, 0.1)
    assert written_thresholds(WriteOptions(MapMode.TRINARY, 0.8, 0.25)) == (0.8, 0.196)
    assert written_thresholds(WriteOptions(MapMode.SCALE, 0.8, 0.25)) == (0.8, 0.25)


@pytest.mark.parametrize("mode", list(MapMode))
def test_bands_do_not_show(monkeypatch: pytest.MonkeyPatch, mode: MapMode) -> None:
    grid = map_of(np.random.default_rng(1).uniform(0.01, 0.99, (37, 11)))
    made = []
    for cells in (writers.BAND_CELLS, 25):
        monkeypatch.setattr(writers, "BAND_CELLS", cells)
        for writer in (PgmWriter(), PngWriter()):
            writer.write(Path("map"), grid, WriteOptions(mode))
            made.append(Path("map").read_bytes())
    assert made[:2] == made[2:]


def test_when_the_yaml_cannot_be_written_there_is_no_image_either(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").mkdir()
    with pytest.raises(OutputError, match=r"map\.yaml: is a folder"):
        PgmWriter().write(tmp_path / "map.pgm", map_of([[0.5]]), TRINARY)
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.yaml"]
