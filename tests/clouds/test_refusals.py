"""What makes no map of clouds is refused at once, and `check` says so beforehand."""

import json
import re
from pathlib import Path

import pytest

from occmap.clouds import CloudOptions
from occmap.clouds.engine import CloudEngine, make_band
from occmap.errors import MapError
from occmap.grid import Lattice
from occmap.sensor import ReturnOptions
from tests.cli.runner import ask, occmap
from tests.clouds.simulation import HALL, LATTICE, ROOM, Room, drive, find_ground, observe
from tests.samples import SAMPLE_LOGS

THIN = HALL, "--stride", 4
COLUMNS, ROWS = 202, 122
"""Of the hall's map at 5 cm, which sees the outer sides of no wall"""


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--max-cells", COLUMNS * ROWS - 1), f"--max-cells {COLUMNS * ROWS - 1}"),
        (("--resolution", "0.0001"), "--max-cells"),
        (("--max-range", "0.001"), "no point of any cloud observed a cell"),
        (("--sensor-height", "50"), "no ground is seen below the sensor"),
        ((SAMPLE_LOGS / "drive.mcap",), "one kind at a time"),
    ],
)
def test_a_check_tells_what_a_build_fails_for(
    options: tuple[object, ...], told: str, tmp_path: Path
) -> None:
    checked = occmap("check", *THIN, *options, "--json")
    built = occmap("build", *THIN, *options, "-o", tmp_path / "hall.pgm")
    (problem,) = json.loads(checked.out)["problems"]
    assert (checked.code, built.code > 0) == (1, True)
    assert told in problem
    assert told in built.err


def test_a_check_says_how_large_the_map_will_be(tmp_path: Path) -> None:
    most = "--max-cells", COLUMNS * ROWS
    checked = json.loads(occmap("check", *THIN, *most, "--json").out)
    built = json.loads(occmap("build", *THIN, *most, "-o", tmp_path / "hall.pgm", "--json").out)
    for size in (checked["map"], built["map"]):
        assert (size["columns"], size["rows"]) == (COLUMNS, ROWS)
    (topic,) = checked["logs"][0]["scans"]
    assert topic["shapes"] == []
    assert topic["ranges"]["total"] == 0
    assert topic["ranges"]["smallest"] is None


def test_a_map_that_is_too_large_is_refused_before_room_is_made_for_it() -> None:
    clouds = drive(Room(), clouds=4)
    ground = find_ground(clouds)
    band = make_band(CloudOptions(), ReturnOptions())
    engine = CloudEngine(Lattice(1e-4), band, ground)
    with pytest.raises(MapError, match="`max_cells=1000000000`"):
        engine.add(clouds[0])
    assert engine.bytes_held == 0

    tight = CloudEngine(LATTICE, band, ground, max_cells=ROOM.cells)
    for each in clouds:
        tight.add(each)  # the map is as large as it may be, though its ground goes on
    sheets, kept = tight.bytes_held, tight.finish().tiles
    assert kept.keys() == observe(clouds, ground).finish().tiles.keys()
    assert tight.bytes_held - sheets == len(kept) * 2 * 64 * 64  # a byte for each number


def test_a_limit_on_beams_is_refused_for_clouds(tmp_path: Path) -> None:
    for words in (("build", *THIN, "-o", tmp_path / "hall.pgm"), ("check", *THIN)):
        done = occmap(*words, "--fail-if", "hits < 50%")
        assert (done.code, "clouds of points have none" in done.err) == (2, True)


def test_a_model_of_beams_is_refused_for_clouds(tmp_path: Path) -> None:
    done = occmap("build", HALL, "--model", "quadratic", "-o", tmp_path / "hall.pgm")
    assert (done.code, "--model counting" in done.err) == (2, True)

    saved = tmp_path / "hall.npz"
    assert occmap("build", *THIN, "-o", saved).code == 0
    rendered = occmap("render", saved, "--model", "quadratic", "-o", tmp_path / "hall.pgm")
    assert (rendered.code, "build it" in rendered.err) == (1, False)


def test_clouds_over_ground_that_is_known_must_lie_on_it(tmp_path: Path) -> None:
    first, other = tmp_path / "first.npz", tmp_path / "other.npz"
    assert occmap("build", HALL, "--end", "2", "-o", first).code == 0
    lower = ("build", HALL, "--start", "2", "--transform", "0.5,0,0,-0.4", "-o", other)
    assert occmap(*lower).code == 0
    for words in (
        (*lower, "--resume", first),
        (*lower, "--ground", first),
        ("merge", first, other, "-o", tmp_path / "both.npz"),
    ):
        done = occmap(*words)
        assert (done.code, "0.40 m lower" in done.err) == (1, True)
        assert "--transform 0.5,0,0" in done.err
    nearly = (*lower[:4], "--transform", "0,0,0,0.02", "--resume", first)
    assert occmap(*nearly, "-o", tmp_path / "nearly.npz").code == 0
    assert occmap("build", HALL, "--end", "1", "-o", first).code == 0
    assert "was not measured in" in occmap("build", HALL, "--ground", first, "-o", other).err


def test_what_a_plane_shows_is_not_added_to_what_lies_over_other_ground(tmp_path: Path) -> None:
    """Of the hall more than a quarter is a ramp and a platform, which a plane calls occupied."""
    hall, flat = tmp_path / "hall.npz", tmp_path / "flat.npz"
    line, plane = ("build", HALL, "-o"), ("--ground", "flat", "--sensor-height", "0.6")
    assert occmap(*line, hall).code == 0
    assert occmap(*line, flat, *plane).code == 0
    for words, found in (
        ((*plane, "--resume", hall), "other ground: 3"),
        ((*plane, "--transform", "0,0,0,9", "--resume", hall), "so leave out --ground flat, too"),
        (("--ground", hall, "--resume", flat), f"that of {flat} goes on"),
    ):
        done = occmap(*line, tmp_path / "both.npz", *words, "--max-cells", 9)  # too few to trace
        assert (done.code, found in done.err) == (1, True)
    assert occmap(*line, tmp_path / "both.npz", *plane, "--resume", flat).code == 0


@pytest.mark.parametrize(("model", "shown"), [("counting:cut=0.2", "=0.2,"), ("simple", "simple:")])
def test_a_session_that_is_added_is_read_by_the_model_that_is_named(
    tmp_path: Path, model: str, shown: str
) -> None:
    first = tmp_path / "first.npz"
    assert occmap("build", HALL, "--end", "2", "-o", first).code == 0
    line = ("build", HALL, "--start", "2", "--model", model, "-o", tmp_path / "more.npz")
    told = ask(*line, "--resume", first)["map"]["model"]
    assert told == ask(*line)["map"]["model"]
    assert shown in told


def test_a_session_counts_the_columns_that_its_own_clouds_show(tmp_path: Path) -> None:
    first = tmp_path / "first.npz"
    assert occmap("build", HALL, "-o", first).code == 0
    line = ("build", HALL, "--end", "1", "--resume", first, "-o", tmp_path / "more.npz")
    shown = re.search(r"for ([\d,]+) of ([\d,]+) columns", " ".join(ask(*line)["notes"]))
    assert shown
    found, filled = (int(number.replace(",", "")) for number in shown.groups())
    assert found <= filled
