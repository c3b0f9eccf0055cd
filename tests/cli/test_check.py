"""`occmap check` as a command line: text, JSON and exit codes."""

import math
from pathlib import Path

import numpy as np
import pytest

from occmap.choices import format_mount, format_static
from occmap.options import OPTIONS
from occmap.types import Float64
from tests.bench.plans import cast_scans
from tests.cli.runner import ask, occmap
from tests.csv_logs import write_scans
from tests.grid.test_pictures import box
from tests.inspection_logs import SCANS, Drive, write_bag, write_csv
from tests.readers.ros import RANGES, ROS2, Written, drive, scan, write_mcap
from tests.samples import SAMPLE_LOGS
from tests.samples import write_csv as write_planar

pytestmark = pytest.mark.usefixtures("here")


def test_text_ends_with_the_recommended_command() -> None:
    write_csv(Path("my room.csv"), Drive())
    result = occmap("check", "my room.csv")
    assert (result.code, result.err) == (0, "")
    lines = result.out.splitlines()
    assert lines[0] == "my room.csv"
    assert lines[-1] == "occmap build 'my room.csv' -o 'my room.pgm'"
    assert f"  poses   {SCANS} of {SCANS} scans, stated beside the scans" in lines
    assert all(line == line.rstrip() for line in lines)


def test_the_recommended_command_builds_the_map() -> None:
    write_bag(Path("room.bag"), Drive(math.pi))
    found = occmap("check room.bag --json")
    assert found.code == 1  # a bare build would fail
    command = found.json["command"]
    assert occmap(*command[1:]).code == 0
    assert Path("room.pgm").exists()
    assert ask("check", "room.bag", *command[3:-2])["buildable"]


def test_what_is_no_log_is_a_problem_which_a_quiet_check_prints_too() -> None:
    Path("notes.txt").write_text("hello\n")
    problem = "notes.txt: a text file of no known log format"
    told = occmap("check notes.txt")
    assert (told.code, told.err) == (1, "")
    assert f"problem   {problem}" in told.out
    told = occmap("check -q notes.txt")
    assert (told.code, told.out) == (1, "")
    assert told.err.startswith(f"error: {problem}")
    assert occmap("check --json notes.txt").err == told.err
    assert occmap("check", "-q", SAMPLE_LOGS / "drive.csv") == (0, "", "")


def test_scans_and_poses_of_other_times_are_shown_beside_each_other() -> None:
    write_bag(Path("room.bag"), Drive(), mount=[(0.0, 0.0)])
    Path("slam.tum").write_text("2.5 0 0 0 0 0 0 1\n4 1 0 0 0 0 0 1\n")
    told = occmap("check room.bag --poses slam.tum")
    assert told.code == 1
    lines = told.out.splitlines()
    assert f"  stamps  100.000 to {99 + SCANS}.000 s" in lines
    assert any("slam.tum: 2 samples, 2.5 to 4.0 s, largest gap" in line for line in lines)
    problem = f"problem   /scan: none of {SCANS} scans can be used: {SCANS} after the last pose; "
    assert lines[-1].startswith(f"{problem}compare stamps and sources, and try --time")


def test_a_laser_without_a_mount_beside_another_is_a_warning() -> None:
    log = drive(ROS2)
    for stamp_ns in range(10**9, 7 * 10**9, 10**9):
        log.append(Written("/bumper", stamp_ns, scan(ROS2, stamp_ns, "bumper", RANGES)))
    write_mcap(Path("two.mcap"), log)
    told = occmap("check", "two.mcap", "--fail-if", "warnings > 0")
    assert told.code == 3
    (warning,) = (line for line in told.out.splitlines() if line.startswith("warning"))
    assert "/bumper: scans without a pose: " in warning
    assert "no transform to the scan's frame" in warning


def test_no_beam_that_sees_anything_is_a_problem() -> None:
    write_planar(Path("log.csv"), [(0, 0, 0)] * 2, [-1.0, math.nan], 0.5)
    told, built = occmap("check log.csv"), occmap("build log.csv -o m.pgm")
    assert (told.code, built.code) == (1, 1)
    assert told.out.splitlines()[-1].startswith("problem   no beam of any scan observes a cell")
    assert "2 too close, 2 nan; see the ranges in `occmap check`" in built.err


def test_what_no_return_may_tell_is_recommended() -> None:
    path = write_planar(Path("log.csv"), [(0, 0, 0)] * 2, [math.inf] * 60, 0.1)
    path.write_text("# range_max: 3\n" + path.read_text())
    found, built = occmap("check log.csv --json"), occmap("build log.csv -o m.pgm")
    assert (found.code, built.code) == (1, 1)
    assert found.json["command"][3:5] == ["--no-return", "clear"]
    assert built.err.endswith("see the ranges in `occmap check`\n")
    assert occmap(*found.json["command"][1:]).code == 0


def test_a_robot_that_stands_in_its_own_scans_is_left_out_by_the_command() -> None:
    def stand(ranges: Float64) -> Float64:
        ranges[10:16] = 0.3  # a post at 40 to 60 degrees
        return ranges

    write_csv(Path("post.csv"), Drive(spoil=stand))
    found = ask("check post.csv")
    low, high = math.radians(40), math.radians(60)
    corners = [0.3 * f(angle) for angle in (high, low) for f in (math.cos, math.sin)]
    near = [corners[0] - 0.05, corners[3] - 0.05, corners[2] + 0.05, corners[1] + 0.05]
    assert found["logs"][0]["scans"][0]["ranges"]["body"] == pytest.approx(near, abs=0.006)
    assert found["command"][3] == "--footprint"
    built = occmap(*found["command"][1:], "--json")
    assert built.json["beams"]["own_robot"] == 6 * SCANS


def test_a_wall_beside_a_parked_robot_is_not_the_robot() -> None:
    write_planar(Path("parked.csv"), [(0, 0, 0)] * 60 + [(9, 0, 0)] * 5, [0.5] * 30, 0.1)
    assert ask("check parked.csv")["logs"][0]["scans"][0]["ranges"]["body"] is None


def test_a_wall_that_a_robot_follows_is_not_the_robot() -> None:
    """Round a square of 8 m, 0.4 m from its walls: beams ahead meet the wall that others follow."""
    poses = [(k / 4, 0.0, 0.0) for k in range(29)]
    poses += [(7.2, k / 4, math.pi / 2) for k in range(29)]
    step = math.radians(4)
    walls = np.array(box(-0.4, -0.4, 7.6, 7.6))
    ranges = cast_scans(np.array(poses), step * np.arange(90, dtype=np.float64), walls)
    shape = {"angle_min": 0, "angle_increment": step, "range_max": 30}
    write_scans(Path("wall.csv"), range(58), ranges, poses, **shape)
    assert ask("check wall.csv")["logs"][0]["scans"][0]["ranges"]["body"] is None


def test_ranges_in_millimetres_are_not_taken_for_open_space() -> None:
    write_csv(Path("mm.csv"), Drive(spoil=lambda ranges: 1000 * ranges))
    found = occmap("check mm.csv --json")
    assert (found.code, found.json["command"]) == (1, [])
    assert any(text.endswith("in mm?") for text in found.json["warnings"])


@pytest.mark.parametrize("log", ["drive.csv", "drive.log"])
def test_a_log_without_record_times_is_not_compared_with_them(log: str) -> None:
    out = occmap("check", SAMPLE_LOGS / log).out
    assert "          largest gap 0.2 s" in out.splitlines()
    assert "record times" not in out


def test_stamps_are_compared_with_the_record_times() -> None:
    late = [each._replace(record_ns=each.record_ns + 2 * 10**9) for each in drive(ROS2)]
    write_mcap(Path("late.mcap"), late)
    assert "  2.5 s before the record times, drift 0 s, " in occmap("check late.mcap").out


@pytest.mark.parametrize("text", ["0,0,3.14159", "0.1,-0.2,1.5708", "0,0,-1.5708,3.14159,0"])
def test_mounts_are_written_as_they_are_read(text: str) -> None:
    assert format_mount(OPTIONS["sensor_pose"].read_one(text)) == text
    sample = OPTIONS["static_transforms"].read_one("base,laser,0.1,0.2,0.3,0.1,-0.2,1.5")
    given = format_static(sample.parent, sample.child, sample.pose)
    assert given == "base,laser,0.1,0.2,0.3,0.1,-0.2,1.5"


def test_one_of_a_thing_is_in_the_singular() -> None:
    write_bag(Path("room.bag"), Drive(), mount=[(0.0, 0.0)])
    assert "1 transform that never changes" in occmap("check room.bag").out
    write_planar(Path("one.csv"), [(0.0, 0.0, 0.0)], [1.0])
    out = occmap("check one.csv").out
    assert "  shape   1 beam over 0 deg" in out
    assert "  poses   1 of 1 scan, stated" in out


def test_damage_is_a_warning_and_told_once() -> None:
    Path("cut.mcap").write_bytes((SAMPLE_LOGS / "drive.mcap").read_bytes()[:60_000])
    lines = occmap("check cut.mcap").out.splitlines()
    (line,) = (line for line in lines if "the file ends in the middle of the record" in line)
    assert line.startswith("warning   cut.mcap: ")


def test_a_log_that_cannot_be_read_has_one_problem() -> None:
    head = "# angle_min: -1\n# angle_increment: 1\n# range_max: 10\nstamp,x,y,yaw,r0,r1\n"
    Path("few.csv").write_text(head + "junk\n")
    found = occmap("check few.csv --json").json
    assert found["warnings"] == []
    (problem,) = found["problems"]
    assert problem.startswith("few.csv:5: 1 cells where the header has 6")
