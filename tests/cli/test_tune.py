"""`occmap tune` as a command line: what it prints, what it exits with, and what is refused."""

import math
import shlex
from pathlib import Path

import pytest

from tests.cli.runner import occmap, read_error
from tests.inspection_logs import Drive, write_bag
from tests.samples import SAMPLE_LOGS, write_csv
from tests.tuning.simulated import write_drive

DRIVE = SAMPLE_LOGS / "drive.csv"


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A drive whose scans are stamped a tenth of a second late, and its poses."""
    return write_drive(tmp_path_factory.mktemp("late"), lambda _: 0.1)


def test_what_is_found_is_said_with_the_line_that_mends_it(
    late: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, _ = late
    monkeypatch.chdir(scans.parent)
    result = occmap("tune", "scans.csv", "--poses", "poses.csv", "--resolution", 0.1)
    assert result.code == 0
    time, mount, share, scored, line = result.out.splitlines()
    assert time.startswith("time     offset -0.1 s gains 0.")
    assert mount == "mount    nothing to gain"
    assert ", 0.9" in share
    assert scored.startswith("scored   by 3,")
    assert line == (
        "occmap build scans.csv --resolution 0.1 --poses poses.csv --time-offset -0.1 -o scans.pgm"
    )
    mended = occmap("tune", "scans.csv", *shlex.split(line)[3:-2])
    assert mended.out.splitlines()[-1] == "nothing to gain"
    assert occmap(*shlex.split(line)[1:]).code == 0
    assert (scans.parent / "scans.pgm").exists()


def test_a_gain_can_fail_a_pipeline(late: tuple[Path, Path]) -> None:
    scans, poses = late
    words = [scans, "--poses", poses, "--resolution", 0.1, "--end", 20, "--json", "-q"]
    result = occmap("tune", *words, "--fail-if", "gain > 2%", "--fail-if", "share < 10%")
    assert result.code == 3
    assert result.err.startswith("error: gain is ")
    printed = result.json
    assert [each["name"] for each in printed["failed"]] == ["gain"]
    assert printed["time"]["verdict"] == "found"
    assert printed["share"] - printed["share_before"] == pytest.approx(printed["gain"])
    still = {"yaw": 0.0, "x": 0.0, "y": 0.0, "deskew": False}
    assert printed["correction"] == {"time_s": -0.1, **still}
    assert printed["tried"][0]["share"] == printed["share_before"]


def test_halves_that_disagree_are_told(tmp_path: Path) -> None:
    scans, poses = write_drive(tmp_path, lambda number: 0.15 if number < 207 else 0.0)
    result = occmap("tune", scans, "--poses", poses)
    time, *others, last = result.out.splitlines()
    assert time.startswith("time     the halves do not agree: the first half of the scans gains 0.")
    assert time.endswith(" s, the second 0.0000 +- 0.0000 by no change")
    assert not any(line.startswith("mount") for line in others)
    assert last == "nothing is recommended"
    assert "the mount is not searched" in result.err


def test_several_logs_have_a_table_of_what_each_gains(late: tuple[Path, Path]) -> None:
    scans, poses = late
    result = occmap("tune", scans, scans, "--poses", poses, "--resolution", 0.2, "--end", 15)
    head, one, other = (line.split() for line in result.out.splitlines()[-5:-2])
    assert head == ["log", "share", "before", "share", "gain", "agreement"]
    assert one == other
    assert one[0] == str(scans)
    assert float(one[2]) - float(one[1]) == pytest.approx(float(one[3]), abs=2e-4)


@pytest.mark.parametrize(("resolution", "why"), [(0.3, "half"), (0.1, "too little")])
def test_a_gain_that_is_not_sure_is_told_with_why(resolution: float, why: str) -> None:
    result = occmap("tune", DRIVE, "--resolution", resolution, "--stride", 4)
    mount, *_, last = result.out.splitlines()
    assert mount.startswith("mount    nothing sure to gain: y")
    assert why in mount
    assert last == "nothing to gain"


def test_few_scans_are_told(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "a.csv", [(0.1 * i, 0.0, 0.1 * i) for i in range(10)], [1.0, 2.0])
    result = occmap("tune", log)
    few = "nothing is recommended: 1 held-out scan in each half: too few to tell"
    assert result.out.splitlines()[-1].startswith(few)
    assert "note: 1 held-out scan in each half: too few to tell; give a longer log" in result.err


def test_a_missing_mount_is_asked_for_as_by_build(tmp_path: Path) -> None:
    log = write_bag(tmp_path / "room.bag", Drive(3.14159))
    asked = read_error(occmap("tune", log), 1)
    assert "--sensor-pose 0,0,3.14159, which suits the scans best of all turns: " in asked
    assert asked == read_error(occmap("build", log, "-o", tmp_path / "m.pgm"), 1)


def test_of_a_log_without_a_beam_to_score_by_nothing_is_said(tmp_path: Path) -> None:
    blind = write_csv(tmp_path / "blind.csv", [(0.1 * i, 0.0, 0.0) for i in range(20)], [math.nan])
    lines = occmap("tune", DRIVE, blind, "--resolution", 0.2, "--end", 10).out.splitlines()
    assert [line.split() for line in lines if "blind" in line] == [[str(blind), *"----"]]
