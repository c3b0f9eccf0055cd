"""`occmap check` as a command line: text, JSON and exit codes."""

import json
import math
from pathlib import Path

import pytest

from occmap.choices import format_mount, format_static
from occmap.cli import run
from occmap.options import OPTIONS
from tests.cli.runner import occmap, read_error
from tests.inspection_logs import SCANS, Drive, write_bag, write_csv
from tests.readers.ros import RANGES, ROS2, Written, drive, scan, write_mcap
from tests.samples import SAMPLE_LOGS
from tests.samples import write_csv as write_planar

Capture = pytest.CaptureFixture[str]


def test_text_ends_with_the_recommended_command(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "my room.csv", Drive())
    assert run(["check", str(path)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[0] == str(path)
    assert lines[-1] == f"occmap build '{path}' -o 'my room.pgm'"
    assert f"  poses   {SCANS} of {SCANS} scans, stated beside the scans" in lines
    assert all(line == line.rstrip() for line in lines)


def test_the_recommended_command_builds_the_map(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / "room.bag", Drive(math.pi))
    monkeypatch.chdir(tmp_path)
    assert run(["check", str(path), "--json"]) == 1  # a bare build would fail
    command = json.loads(capsys.readouterr().out)["command"]
    assert run(command[1:]) == 0
    assert (tmp_path / "room.pgm").exists()
    capsys.readouterr()
    assert run(["check", str(path), *command[3:-2], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["buildable"]


def test_a_problem_is_told_and_fails(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("hello\n")
    assert run(["check", str(path)]) == 1
    out, err = capsys.readouterr()
    assert f"problem   {path}: a text file of no known log format" in out
    assert "Traceback" not in out + err


def test_scans_and_poses_of_other_times_are_shown_beside_each_other(
    tmp_path: Path, capsys: Capture
) -> None:
    path = write_bag(tmp_path / "room.bag", Drive(), mount=[(0.0, 0.0)])
    poses = tmp_path / "slam.tum"
    poses.write_text("2.5 0 0 0 0 0 0 1\n4 1 0 0 0 0 0 1\n")
    assert run(["check", str(path), "--poses", str(poses)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"  stamps  100.000 to {99 + SCANS}.000 s" in lines
    assert any(f"{poses}: 2 samples, 2.5 to 4.0 s, largest gap" in line for line in lines)
    assert lines[-1] == (
        f"problem   /scan: none of {SCANS} scans can be used: {SCANS} after the last pose; "
        "--time-offset -97.5 would put the first scan at the first pose"
    )


def test_a_laser_without_a_mount_beside_another_is_a_warning(
    tmp_path: Path, capsys: Capture
) -> None:
    log = drive(ROS2)
    for stamp_ns in range(10**9, 7 * 10**9, 10**9):
        log.append(Written("/bumper", stamp_ns, scan(ROS2, stamp_ns, "bumper", RANGES)))
    path = tmp_path / "two.mcap"
    write_mcap(path, log)
    assert run(["check", str(path), "--fail-if", "warnings > 0"]) == 3
    lines = capsys.readouterr().out.splitlines()
    (warning,) = (line for line in lines if line.startswith("warning"))
    assert "/bumper: scans without a pose: " in warning
    assert "no transform to the scan's frame" in warning


def test_no_beam_that_sees_anything_is_a_problem(tmp_path: Path, capsys: Capture) -> None:
    path = write_planar(tmp_path / "log.csv", [(0, 0, 0)] * 2, [-1.0, math.nan], 0.5)
    assert run(["check", str(path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "problem   no beam of any scan observes a cell: see the ranges"
    assert run(["build", str(path), "-o", str(tmp_path / "m.pgm")]) == 1
    assert capsys.readouterr().err == (
        f"error: {path}: no beam of any scan observed a cell: 2 too close, 2 nan; see the ranges "
        "in `occmap check`\n"
    )


def test_what_no_return_may_tell_is_recommended(tmp_path: Path, capsys: Capture) -> None:
    path = write_planar(tmp_path / "log.csv", [(0, 0, 0)] * 2, [math.inf] * 60, 0.1)
    path.write_text("# range_max: 3\n" + path.read_text())
    assert run(["check", str(path), "--json"]) == 1
    command = json.loads(capsys.readouterr().out)["command"]
    assert command[3:5] == ["--no-return", "clear"]
    assert run(["build", str(path), "-o", str(tmp_path / "m.pgm")]) == 1
    assert capsys.readouterr().err.endswith("or try --no-return clear\n")
    assert run([*command[1:-1], str(tmp_path / "m.pgm")]) == 0


@pytest.mark.parametrize("log", ["drive.csv", "drive.log"])
def test_a_log_without_record_times_is_not_compared_with_them(log: str) -> None:
    out = occmap("check", SAMPLE_LOGS / log).out
    assert "          largest gap 0.2 s" in out.splitlines()
    assert "record times" not in out


def test_stamps_are_compared_with_the_record_times(tmp_path: Path) -> None:
    log = drive(ROS2)
    late = [written._replace(record_ns=written.record_ns + 2 * 10**9) for written in log]
    write_mcap(tmp_path / "late.mcap", late)
    assert (
        "  2.5 s before the record times, drift 0 s, "
        in occmap("check", tmp_path / "late.mcap").out
    )


@pytest.mark.parametrize("text", ["0,0,3.14159", "0.1,-0.2,1.5708", "0,0,-1.5708,3.14159,0"])
def test_mounts_are_written_as_they_are_read(text: str) -> None:
    assert format_mount(OPTIONS["sensor_pose"].read_one(text)) == text
    sample = OPTIONS["static_transforms"].read_one("base,laser,0.1,0.2,0.3,0.1,-0.2,1.5")
    given = format_static(sample.parent, sample.child, sample.pose)
    assert given == "base,laser,0.1,0.2,0.3,0.1,-0.2,1.5"


def test_the_robot_and_the_reading_come_back_as_flags(tmp_path: Path, capsys: Capture) -> None:
    path = write_csv(tmp_path / "room.csv", Drive())
    flags = [
        "--echo", "last", "--ignore-sector", "2.5,-2.5", "--ignore-sector", "1,2",
        "--footprint", "-0.4,-0.3,0.2,0.3", "--min-height", "0.2", "--max-height", "0.5",
    ]  # fmt: skip
    assert run(["check", str(path), *flags, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["command"][3:-2] == flags


@pytest.mark.parametrize(
    "words", ["", "x.bag --resolution much", "x.bag --footprint 1,1,0,0", "x.bag --resolution inf"]
)
def test_values_that_make_no_sense_are_usage_errors(words: str) -> None:
    assert read_error(occmap("check", *words.split()), 2)


def test_one_of_a_thing_is_in_the_singular(tmp_path: Path, capsys: Capture) -> None:
    assert run(["check", str(write_bag(tmp_path / "room.bag", Drive(), mount=[(0.0, 0.0)]))]) == 0
    assert "1 transform that never changes" in capsys.readouterr().out
    log = write_planar(tmp_path / "one.csv", [(0.0, 0.0, 0.0)], [1.0])
    assert run(["check", str(log)]) == 0
    out = capsys.readouterr().out
    assert "  shape   1 beam over 0 deg" in out
    assert "  poses   1 of 1 scan, stated" in out


def test_damage_is_a_warning_and_told_once(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes((SAMPLE_LOGS / "drive.mcap").read_bytes()[:60_000])
    lines = occmap("check", path).out.splitlines()
    (line,) = (line for line in lines if "the file ends in the middle of the record" in line)
    assert line.startswith(f"warning   {path}: ")


def test_a_log_that_cannot_be_read_through_has_one_problem(tmp_path: Path) -> None:
    log = tmp_path / "few.csv"
    head = "# angle_min: -1\n# angle_increment: 1\n# range_max: 10\nstamp,x,y,yaw,r0,r1\n"
    log.write_text(head + "1,0,0,0,1,2\n2,0,0,0,1,2\njunk\n3,0,0,0,1,2\n")
    found = json.loads(occmap("check", log, "--json").out)
    assert found["warnings"] == []
    (problem,) = found["problems"]
    assert problem.startswith(f"{log}:7: 1 cells where the header has 6")
