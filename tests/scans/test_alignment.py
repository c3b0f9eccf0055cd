"""Maps whose walls run along the axes: the angle from rooms by formula, and from real buildings."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import OccupancyMap
from occmap.errors import MapError
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.scans.align import COMMON_SHARE, find_turn
from occmap.types import Float64
from occmap.writers.npz import read_evidence
from tests import inspection_logs
from tests.cli.runner import occmap
from tests.inspection_logs import HALF_HEIGHT, HALF_WIDTH, Drive
from tests.samples import PLAIN, find_real, write_csv

ALIGNED = replace(PLAIN, posing=PosingOptions(align=None))


def draw_walls(*degrees: float, noise: float = 0.0) -> Float64:
    """Chords (N, 2) of 0.7 m along walls of these directions, a hundred each."""
    angle = np.radians(np.repeat(degrees, 100))
    along = 0.7 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return along + np.random.default_rng(1).normal(0, noise, along.shape)


@pytest.mark.parametrize(
    ("degrees", "turn"),
    [(0, 0), (17.3, -17.3), (44.9, -44.9), (45.1, 44.9), (90, 0), (-100, 10), (179.99, 0.01)],
)
def test_the_turn_is_the_smallest_one(degrees: float, turn: float) -> None:
    found, share = find_turn(draw_walls(degrees, degrees + 90))
    assert found == pytest.approx(turn, abs=0.011)
    assert share == pytest.approx(1)


def test_noise_and_a_few_other_walls_do_not_matter() -> None:
    found, share = find_turn(draw_walls(12.5, 12.5, 102.5, 102.5, 57.0, noise=0.02))
    assert found == pytest.approx(-12.5, abs=0.2)
    assert COMMON_SHARE < share < 0.8


def test_a_round_room_has_no_direction() -> None:
    _, share = find_turn(draw_walls(*np.arange(0, 360, 0.5)))
    assert share == pytest.approx(6 / 90, rel=0.05)
    assert find_turn(np.zeros((0, 2))) == (0.0, 0.0)


def turn_back(index: int, degrees: float) -> tuple[float, float, float]:
    """Say where the robot in the room is in a frame in which the room is turned."""
    x, y, yaw = Drive().pose(index)
    angle = math.radians(degrees)
    cosine, sine = math.cos(angle), math.sin(angle)
    return x * cosine - y * sine, x * sine + y * cosine, yaw + angle


@pytest.mark.parametrize("degrees", [17.3, -31.0])
def test_a_room_that_lies_askew_is_turned(tmp_path: Path, degrees: float) -> None:
    poses = [turn_back(index, degrees) for index in range(40)]
    log = inspection_logs.write_csv(tmp_path / "log.csv", Drive(), poses=poses)
    askew, made = build([log], PLAIN), build([log], ALIGNED)
    assert made.report.map.align == pytest.approx(-degrees, abs=0.1)
    assert not any("common" in note for note in made.report.notes)
    room = (-HALF_WIDTH, -HALF_HEIGHT, HALF_WIDTH, HALF_HEIGHT)
    assert made.map.extent == pytest.approx(room, abs=0.11)
    assert askew.report.map.align == 0
    assert askew.map.extent[3] > HALF_HEIGHT + 1
    # Whoever types the angle that was found gets the same map.
    typed = build([log], replace(PLAIN, posing=PosingOptions(align=made.report.map.align)))
    assert np.array_equal(typed.map.log_odds, made.map.log_odds)


def test_a_map_without_a_direction_stays_as_it_is(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.0, 0.0, 0.0)] * 5, [4.0] * 90, step=math.tau / 90)
    made = build([log], ALIGNED)
    assert any("`align=DEG`" in note for note in made.report.notes)
    assert made.report.map.align == 0
    assert np.array_equal(made.map.log_odds, build([log], PLAIN).map.log_odds)


def test_what_is_added_is_turned_as_what_is_there(tmp_path: Path) -> None:
    poses = [turn_back(index, 20.0) for index in range(40)]
    first = inspection_logs.write_csv(tmp_path / "first.csv", Drive(), poses=poses[:20])
    second = inspection_logs.write_csv(tmp_path / "second.csv", Drive(), poses=poses[20:], first=20)
    kept = tmp_path / "first.npz"
    made = build([first], ALIGNED, [kept])
    assert read_evidence(kept).manifest.align == made.report.map.align
    assert build([second], replace(ALIGNED, resume=kept)).report.map.align == made.report.map.align
    found = rf"first.npz: its align is {made.report.map.align}, .* is 0.0"
    refused = f"{found}; build both with `align=0.0`, or both with `align={made.report.map.align}`"
    with pytest.raises(MapError, match=refused):
        build([second], replace(PLAIN, resume=kept))


def measure_askew(grid: OccupancyMap) -> float:
    """By how many degrees walls lie off the axes: where their shadows on both are the sharpest."""
    y, x = np.nonzero(grid.occupied)
    sharpness = {}
    for degrees in np.arange(-4, 4, 0.05):
        cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        shadows = (np.rint(s).astype(int) for s in (x * cosine + y * sine, y * cosine - x * sine))
        sharpness[degrees] = sum(
            float((np.bincount(shadow - shadow.min()) ** 2).sum()) for shadow in shadows
        )
    return max(sharpness, key=lambda degrees: sharpness[degrees])


@pytest.mark.parametrize(
    ("name", "turn"), [("intel-corrected", -2.3), ("freiburg-079-corrected", 4.8)]
)
def test_real_buildings_stand_upright(name: str, turn: float) -> None:
    path = find_real(f"carmen/{name}.log.gz")
    made = build([path], BuildOptions(posing=PosingOptions(align=None)))
    assert made.report.map.align == pytest.approx(turn, abs=0.5)
    assert measure_askew(made.map) == pytest.approx(0, abs=0.5)


def test_the_angle_may_be_left_out_on_the_command_line(tmp_path: Path) -> None:
    poses = [turn_back(index, 20.0) for index in range(20)]
    log = inspection_logs.write_csv(tmp_path / "log.csv", Drive(), poses=poses)
    out = str(tmp_path / "m.pgm")
    words = [
        ["--align", str(log), "-o", out],
        [str(log), "-o", out, "--align"],
        [str(log), "--align", "-o", out],
        [str(log), "--align", "auto", "-o", out],
    ]
    (said,) = {occmap("build", *each).out.splitlines()[0] for each in words}
    (turn,) = re.findall(r", turned by (\S+) degrees$", said)
    assert float(turn) == pytest.approx(-20, abs=0.1)
    assert "turned by -7.5 degrees" in occmap("build", str(log), "-o", out, "--align", "-7.5").out
    assert "turned" not in occmap("build", str(log), "-o", out).out
