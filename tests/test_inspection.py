"""Inspection of rooms written by formula."""

import json
import math
import re
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from occmap.choices import read_options
from occmap.errors import MapError, OccmapError
from occmap.inspection import Inspection, inspect, poses
from occmap.inspection.findings import MountFindings, ScanFindings, describe_mount
from occmap.inspection.survey import RangeCensus, StampLog, find_crossing, list_repeated
from occmap.options import BuildOptions, Selection, compose_build
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.posing.tracks import rotate_by
from occmap.posing.trajectory import FROM_CAMERA
from occmap.readers import Echo, PluginLog, ReaderOptions
from occmap.report.results import LEAST_AGREEMENT
from occmap.scans.mounts import SUSPECT, find_mount, prepare, turn_mount
from occmap.sensor import NoReturn, ReturnOptions
from occmap.types import Float32, Float64, Pose, PosedScans, Scan
from tests.clouds.simulation import HALL, follow_hall
from tests.csv_logs import write_poses, write_scans
from tests.inspection_logs import BEAMS, SCANS, Drive, measure_room, read_line, write_bag, write_csv
from tests.posing.scenes import bolted, drive
from tests.posing.scenes import build as make_poser
from tests.readers.clouds import cloud
from tests.readers.ros import ROS1, SECOND, Written
from tests.samples import PLAIN, SAMPLE_LOGS, copy_mcap, make_batch
from tests.samples import write_csv as write_row

TOPICS, FRAMES = ("/front", "/rear"), ("front", "rear")
MOUNTED: dict[str, Any] = {"mount": [(0.0, 0.0)]}
BARE: dict[str, Any] = {"mount": []}
NO_MOUNT = "no transform to the laser's frame 'laser'"
OTHERS = {"camera": 0.0, "laser": 1.0, "odd": 1.5}


def look(path: Path, options: BuildOptions | None = None) -> Inspection:
    found = inspect([path], options or BuildOptions())
    json.dumps(found.to_json(), allow_nan=False)
    return found


def refuse(path: Path, options: BuildOptions | None = None) -> str:
    """What a build is refused with, which is the first problem that a check finds."""
    with pytest.raises(OccmapError) as told:
        build([path], options or BuildOptions())
    assert look(path, options).problems[0] == str(told.value)
    return str(told.value)


def topic(found: Inspection) -> ScanFindings:
    (log,) = found.logs
    (scans,) = log.scans
    return scans


def count_specials(found: Inspection) -> dict[str, int]:
    return {special.name: special.count for special in topic(found).ranges.specials}


def test_the_room_is_measured(tmp_path: Path) -> None:
    found = look(write_csv(tmp_path / "room.csv", Drive()))
    scans = topic(found)
    (shape,) = scans.shapes
    assert found.buildable
    assert found.problems == found.warnings == ()
    assert found.map is not None
    # Hits lie behind the walls at -5 and 5 m: in the cells beside these lines. There is one more
    # cell around those.
    assert found.map.extent == (-5.1, -3.1, 5.1, 3.1)
    assert (found.map.columns, found.map.rows, found.map.file_bytes) == (204, 124, 204 * 124)
    assert (shape.beams, shape.scans, scans.shape_count) == (BEAMS, SCANS, 1)
    assert shape.angle_increment == pytest.approx(2 * math.pi / BEAMS)
    assert scans.times.duration_s == SCANS - 1
    assert scans.times.rate_hz == pytest.approx(1)
    assert (scans.poses.stated, scans.poses.posed) == (True, SCANS)
    nearest = min(measure_room(*_at(index)).min() for index in range(SCANS))
    assert scans.ranges.smallest == pytest.approx(nearest, abs=1e-5)
    assert found.command[:3] == ("occmap", "build", str(tmp_path / "room.csv"))
    assert found.command[3:] == ("-o", "room.pgm")


def _at(index: int) -> tuple[float, float, Float64]:
    x, y, yaw = Drive().pose(index)
    return x, y, yaw + Drive().bearings


def test_the_estimate_is_the_size_of_the_map(tmp_path: Path) -> None:
    room = write_csv(tmp_path / "room.csv", Drive())
    for path, options in product((room, SAMPLE_LOGS / "drive.mcap"), (BuildOptions(), PLAIN)):
        found = look(path, options).map
        made = build([path], options).map
        assert found is not None
        assert (found.rows, found.columns) == made.shape
        assert found.extent == pytest.approx(made.extent)


def test_special_ranges_are_counted_by_kind(tmp_path: Path) -> None:
    specials = [np.inf, -np.inf, np.nan, 0.0, -1.0, 0.1, 30.0, 31.0]

    def spoil(ranges: Float64) -> Float64:
        ranges[: len(specials)] = specials
        return ranges

    found = look(write_csv(tmp_path / "odd.csv", Drive(spoil=spoil)))
    names = ("+inf", "-inf", "nan", "zero", "negative", "< range_min")
    assert count_specials(found) == dict.fromkeys((*names, "= range_max", "> range_max"), SCANS)
    assert topic(found).ranges.measured == SCANS * (BEAMS - len(specials))
    advice = {s.name: s.no_return for s in topic(found).ranges.specials}
    assert [name for name, text in advice.items() if text] == ["+inf", "= range_max", "> range_max"]


def test_a_census_counts_batches_of_other_limits_together() -> None:
    census = RangeCensus()
    for limit in (8.0, 9.0):
        census.add(make_batch([[1, 8, 9]], range_max=limit))
    counts = {name: number for (name, _), number in census.counts.items() if number}
    assert counts == {"= range_max": 2, "> range_max": 1}
    assert (census.total, census.smallest, census.largest) == (6, 1.0, 8.0)


def test_walls_are_not_suspicious_and_markers_are() -> None:
    rng = np.random.default_rng(1)
    noisy = rng.normal(4.0, 0.01, 5000).round(3)  # a wall, seen by a robot that stands still
    spread = rng.uniform(0.5, 7.5, 5000).round(2)
    values = np.concatenate([noisy, spread, np.full(300, 5.6)]).astype(np.float32)

    def find(ranges: Float32) -> list[float]:
        batch = make_batch([ranges])
        part = PosedScans(batch, np.zeros((1, 3)), np.eye(3)[None])
        return [number for it in list_repeated([part], 8.0) for number in (it.value, it.share)]

    assert find(values[:-300]) == []
    markers = np.count_nonzero(values == np.float32(5.6))
    assert find(values) == pytest.approx([5.6, markers / 10300])
    assert find(np.full(1000, 5.0, np.float32)) == []  # drawn by hand


@pytest.mark.parametrize(("codes", "suspected"), [(3, 3), (4, 0)])
def test_many_values_that_repeat_are_no_codes(tmp_path: Path, codes: int, suspected: int) -> None:
    number, beam = np.arange(40)[:, None], np.arange(20)
    ranges = 2 + 0.9 * beam + 0.003 * number  # beyond the codes, which no band is made of
    ranges[:, :codes] = 12 + np.arange(codes)
    shape = {"angle_min": 0, "angle_increment": 0.02, "range_max": 30}
    log = write_scans(tmp_path / "log.csv", range(40), ranges, 0.1 * number * (1, 0, 0), **shape)
    found = look(log)
    assert sum("may mean no return" in text for text in found.warnings) == suspected
    assert len(topic(found).ranges.repeated) == suspected


def test_a_band_below_the_limit_is_no_return_without_a_flag(tmp_path: Path) -> None:
    def spoil(ranges: Float64) -> Float64:
        ranges[::9] = 25.6
        return ranges

    log = write_csv(tmp_path / "marker.csv", Drive(spoil=spoil))
    found, told = look(log), look(log, BuildOptions(returns=ReturnOptions(range_max=25.6)))
    share = f"{SCANS * 10} of {SCANS * BEAMS:,} ranges (11.1%) read 25.6 m"
    (note,) = found.logs[0].notes
    assert share in note
    assert "--range-max" not in found.command
    assert told.command[3:5] == ("--range-max", "25.6")
    assert found.map == told.map is not None
    assert topic(found).ranges.measured == SCANS * (BEAMS - 10)


@pytest.mark.parametrize(
    ("lost", "advice"), [("wall", "ignore"), ("gap", "ignore"), ("far", "clear")]
)
def test_the_log_itself_tells_whether_no_return_is_open_space(
    tmp_path: Path, lost: str, advice: str
) -> None:
    counter = iter(range(10**6))

    def spoil(ranges: Float64) -> Float64:
        index = next(counter)
        x, _, heading = _at(index)
        if lost == "gap":  # the left wall is of glass, or there is none
            ranges[x + ranges * np.cos(heading) < -4.99] = np.inf
        elif lost == "far":  # beams graze the walls, and lead through none
            ranges[ranges > 4.5] = np.inf
        else:  # any beam may fail
            ranges[index % 7 :: 7] = np.inf
        return ranges

    limit = 4.5 if lost == "far" else 30.0
    found = look(write_csv(tmp_path / "lost.csv", Drive(spoil=spoil), limit))
    assert {s.no_return for s in topic(found).ranges.specials} == {advice}
    assert ("--no-return" in found.command) == (advice == "clear")
    if advice == "clear":  # of several logs, one line must suit all
        other = write_csv(tmp_path / "whole.csv", Drive())
        both = inspect([Path(found.logs[0].path), other], BuildOptions())
        assert both.command[:4] == ("occmap", "build", found.logs[0].path, str(other))
        assert "--no-return" not in both.command


@pytest.mark.parametrize(
    ("start", "heading", "crosses"),
    [
        ((5.0, -2.0), math.pi / 2, True),
        ((3.0, -2.0), math.pi / 4, True),
        ((0.5, 0.03), 0.0, False),  # along the wall, 3 cm off
        ((0.5, -0.3), math.radians(3), False),  # towards it, and ends before it
        ((10.03, -2.0), math.pi / 2, False),  # past its end
        ((9.0, -1.1), math.pi / 4, False),
    ],
)
def test_a_beam_that_grazes_a_wall_does_not_lead_through_it(
    start: tuple[float, float], heading: float, crosses: bool
) -> None:
    """A wall from (0, 0) to (10, 0) that was hit every 5 cm, and a beam of 4 m."""
    wall = np.stack([np.arange(0, 10.01, 0.05), np.zeros(201)], axis=1)
    direction = np.array([[math.cos(heading), math.sin(heading)]])
    found = find_crossing(np.array([start]), direction, np.array([4.0]), wall)
    assert found.tolist() == [crosses]


def test_logs_that_need_different_options_get_no_line(tmp_path: Path) -> None:
    """One needs a mount, or `occmap tune`, and the other one nothing."""
    right = write_bag(tmp_path / "right.bag", Drive(), **MOUNTED)
    for turn, mount in ((math.pi, BARE), (0.3, MOUNTED)):
        other = write_bag(tmp_path / f"{turn}.bag", Drive(turn), **mount)
        seen = inspect([right, other], BuildOptions())
        assert (seen.command, "one by one" in seen.warnings[-1]) == ((), True)


@pytest.mark.parametrize(("roll", "tilt"), [(math.pi, 0.0), (0.2, 0.2)])
def test_an_upside_down_or_tilted_laser_is_told(tmp_path: Path, roll: float, tilt: float) -> None:
    path = write_bag(tmp_path / "room.bag", Drive(), mount=[(roll, 0.0)])
    found = look(path)
    mount = topic(found).mount
    assert mount is not None
    assert mount.upside_down == (roll > 1)
    assert mount.tilt == pytest.approx(tilt, abs=1e-6)
    tilted = [text for text in found.warnings if "tilted by 11.5 deg" in text]
    assert len(tilted) == (tilt > 0)
    assert set(tilted) <= set(build([path], BuildOptions()).report.notes)


def test_a_clock_that_jumps_midway_is_told_with_what_fits_better(tmp_path: Path) -> None:
    """The robot turns by 0.33 rad meanwhile."""

    def jump(stamp: int) -> int:
        return stamp + 3 * SECOND * (stamp >= 120 * SECOND)

    found = look(write_bag(tmp_path / "jump.bag", Drive(), **MOUNTED, scan_stamp=jump))
    assert topic(found).times.drift_s == 3
    warned = [[word in text for text in found.warnings] for word in ("drift", "`stamps=record`")]
    assert list(map(sum, warned)) == [1, 1]
    assert found.command[3:-2] == ("--stamps", "record")
    told = look(tmp_path / "jump.bag", read_line(found.command))
    assert (topic(told).agreement or 0) > (topic(found).agreement or 0) + 0.05
    assert ["stamps drift by" in text for text in told.warnings] == [True]


def test_a_check_tells_what_is_left_out_or_does_nothing_as_a_build_does(tmp_path: Path) -> None:
    points = Written("/points", 100 * SECOND, cloud(ROS1, [(1.0, 2.0, 3.0)]))
    path = write_bag(tmp_path / "both.bag", Drive(), **MOUNTED, more=[points])
    for topics, told in (((), True), (("/scan",), False)):
        options = BuildOptions(reading=ReaderOptions(Echo.LAST), selection=Selection(topics))
        for notes in (look(path, options).logs[0].notes, build([path], options).report.notes):
            told_of = [it for it in notes if "clouds are left out" in it or "`echo=last`" in it]
            assert ["`topics=/points`" in each for each in told_of] == [False, *[True] * told]


def test_other_poses_than_a_log_states_are_judged_as_any(tmp_path: Path) -> None:
    log, way = SAMPLE_LOGS / "drive.log", tmp_path / "way.tum"
    build([log], BuildOptions(selection=Selection(stride=5)), [way])
    found = look(log, BuildOptions(posing=PosingOptions(poses=str(way), max_pose_gap_s=0.3)))
    assert "more scans have a pose with `max_pose_gap_s=" in found.warnings[-1]


def test_poses_that_come_seldom_need_a_larger_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses come every second, and all scans but the first six lie between two."""
    path = write_bag(
        tmp_path / "rare.bag",
        Drive(),
        [(0.0, 0.0)],
        scan_stamp=lambda stamp: stamp - SECOND // 4 * (stamp <= 105 * SECOND),
    )
    options = BuildOptions(posing=PosingOptions(max_pose_gap_s=0.5, time_offset_s=0.25))
    found = look(path, options)
    assert topic(found).poses.posed == 6
    assert "more scans have a pose with `max_pose_gap_s=2`" in found.warnings[-1]
    assert found.command[3:5] == ("--max-pose-gap", "2")
    (note,) = (note for note in build([path], options).report.notes if "most scans" in note)
    assert "33 in a pose gap longer than" in note
    assert "a larger `max_pose_gap_s`" in note
    late = replace(options, selection=Selection(start_s=6.0))
    assert "try `max_pose_gap_s=2`" in look(path, late).problems[0]
    with pytest.raises(OccmapError, match="a larger `max_pose_gap_s`"):
        build([path], late)
    monkeypatch.setattr(poses, "estimate_agreement", lambda *_: 0.54)  # it turned in the gaps
    assert look(path, options).command[3:5] == ("--max-pose-gap", "0.5")


def test_other_times_are_not_tried_for_scans_that_no_time_helps(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "none.bag", Drive(spoil=lambda it: it[:0]), **MOUNTED)
    found = look(path)
    assert "none of 40 scans can be used: 40 no beams" in found.problems[0]
    assert found.command == ()


@pytest.mark.parametrize(
    ("ranges", "places"), [(1000, 1), (1, 1000), (1, 100), (1000, 1000), (1, 1)]
)
def test_millimetres_are_told_by_check_and_by_a_build_that_fails_or_does_not(
    ranges: int, places: int, tmp_path: Path
) -> None:
    """The robot drives at 0.11 m/s, the nearest wall is 1.1 m away, and one beam meets dust."""
    drive = Drive(spoil=lambda measured: np.append(measured[1:] * ranges, 3.0))
    poses = [(x * places, y * places, yaw) for x, y, yaw in map(drive.pose, range(SCANS))]
    log = write_csv(tmp_path / "mm.csv", drive, math.inf, poses)
    expected = {"ranges are metres": ranges > 1, "places are metres": places > 1}
    coarse = BuildOptions(resolution=10.0)
    texts = [look(log).warnings, build([log], coarse).report.notes]
    if max(ranges, places) > 100:
        with pytest.raises(MapError) as told:
            build([log], BuildOptions())
        texts.append((str(told.value),))
        assert look(log).command == ()
    for found in texts:
        whole = " ".join(found)
        assert {words: words in whole for words in expected} == expected


def test_millimetres_are_told_where_the_limit_is_in_metres(tmp_path: Path) -> None:
    """All ranges but one count as no return then, so that hardly any is measured."""
    drive = Drive(spoil=lambda measured: np.append(measured[1:] * 1000, 3.0))
    log = write_csv(tmp_path / "mm.csv", drive, 30.0)
    for found in (look(log).warnings, build([log], BuildOptions()).report.notes):
        assert "ranges are metres" in " ".join(found)
    far = Drive(spoil=lambda measured: np.append(np.full(len(measured) - 1, 999.0), 3.0))
    assert "ranges are metres" not in " ".join(look(write_csv(log, far, 30.0)).warnings)


def test_stamps_that_jump_back_and_drift() -> None:
    stamps, zeros = StampLog(), StampLog()
    for index, header in enumerate([0, 1, 2, 1, 2, 3, 4, 5, 5, 6]):
        scan = Scan(header * 10**9, "", 0, 0.1, np.ones(1, np.float32), 0, 1)
        increment = [math.nan, math.inf, 1e-4, 3e-4][min(index, 3)]
        stamps.add(scan._replace(record_ns=index * 10**9, time_increment=increment))
        zeros.add(scan._replace(stamp_ns=0, record_ns=index * 10**9))
    found, none = (each.sum_up() for each in (stamps, zeros))
    assert (found.jumps_back, found.largest_jump_back_s, found.duplicates) == (1, 1.0, 1)
    assert found.drift_s == -3.0
    assert found.time_increment_s == 3e-4  # the median of those that are finite
    assert (found.duration_s, found.largest_gap_s, found.all_equal) == (6.0, 1.0, False)
    assert (none.all_equal, none.all_zero, none.duplicates, none.offset_s) == (True, True, 9, -4.5)


def test_beams_that_vary_are_listed_by_frequency(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    short, long = (f"FLASER {n} " + "2.5 " * n + "0 0 0 0 0 0 {} host 1\n" for n in (180, 361))
    path.write_text("".join((short if k % 3 else long).format(k) for k in range(1, 10)))
    scans = topic(look(path))
    assert [(shape.beams, shape.scans) for shape in scans.shapes] == [(180, 6), (361, 3)]


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"max_cells": 1000}, "204 x 124 cells, more than `max_cells=1000`"),
        ({"start_s": 900}, f"none of {SCANS} scans can be used: {SCANS} outside `start_s` and"),
    ],
)
def test_what_no_map_can_be_made_of_is_a_problem(
    tmp_path: Path, options: dict[str, Any], found: str
) -> None:
    path = write_csv(tmp_path / "room.csv", Drive())
    seen = look(path, read_options(BuildOptions, options, "build_map"))
    assert found in seen.problems[0]
    assert seen.command == ()


def test_logs_that_cannot_be_read_are_problems_and_left_out_of_the_line(tmp_path: Path) -> None:
    room = write_csv(tmp_path / "room.csv", Drive())
    text, bag = tmp_path / "notes.txt", tmp_path / "lost.bag"
    text.write_text("hello\n")
    bag.write_bytes(b"no bag")
    lost = [text, tmp_path / "missing", bag]
    found = inspect([*lost, room], BuildOptions())
    assert [problem.partition(": ")[0] for problem in found.problems] == list(map(str, lost))
    assert found.command[2:] == (str(room), "-o", "room.pgm")
    assert found.warnings[-1].endswith(f": {', '.join(map(str, lost))}")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"resolution": 0.1, "max_range": 6.5, "no_return": "clear", "map_frame": "odom"},
         "--resolution 0.1 --max-range 6.5 --no-return clear --map-frame odom"),
        ({"resolution": 0.0123456789, "ignore_sectors": [(0.123456, 1.5), (0.25, 3.14159)]},
         "--resolution 0.0123456789 --ignore-sector 0.12346,1.5 --ignore-sector 0.25,3.14159"),
        ({"time_offset_s": 850000000.125, "max_cells": 2 * 10**9},
         "--time-offset 850000000.125 --max-cells 2000000000"),
        ({"start_s": 5, "end_s": 20.5, "stride": 3}, "--start 5 --end 20.5 --stride 3"),
        ({"echo": "last", "footprint": (-0.4, -0.3, 0.2, 0.3), "min_height": 0.2},
         "--echo last --footprint -0.4,-0.3,0.2,0.3 --min-height 0.2"),
        ({"max_pose_gap_s": None}, "--max-pose-gap inf"),
    ],
)  # fmt: skip
def test_options_come_back_as_flags_and_lose_no_digit(options: dict[str, Any], words: str) -> None:
    typed = read_options(BuildOptions, options, "build_map")
    assert " ".join(compose_build(["a.bag"], typed, ())[3:-2]) == words


@pytest.mark.parametrize(
    "selection",
    [Selection(start_s=5, end_s=20), Selection(stride=3), Selection(start_s=2, stride=5)],
)
@pytest.mark.parametrize("topics", [["/scan"], ["/front", "/back"]])
def test_a_part_of_a_log_is_what_a_build_takes_of_it(
    tmp_path: Path, selection: Selection, topics: list[str]
) -> None:
    path = write_bag(tmp_path / "room.bag", Drive(), **MOUNTED, topics=topics)
    options = BuildOptions(selection=selection)
    found, made = look(path, options), build([path], options)
    scans = found.logs[0].scans
    assert sum(each.poses.posed for each in scans) == made.report.scans.used
    assert sum(each.kept for each in scans) == made.report.scans.used
    left_out: Counter[str] = sum((Counter(each.left_out) for each in scans), Counter())
    assert left_out == made.report.scans.dropped
    assert sum(each.ranges.total for each in scans) == sum(made.report.beams)
    assert found.map is not None
    assert (found.map.rows, found.map.columns) == made.map.shape


@pytest.mark.parametrize("mirrored", [True, False])
def test_a_build_of_a_short_log_names_the_mount_of_a_mirrored_laser(
    tmp_path: Path, mirrored: bool
) -> None:
    """The robot turns so little that most hits agree, though left and right are exchanged."""
    whole = (SAMPLE_LOGS / "drive.csv").read_text().splitlines()
    lines = whole[:5]
    for line in whole[5:25]:
        stamp, x, y, yaw, *ranges = line.split(",")
        lines.append(",".join([stamp, x, y, yaw, *(ranges[::-1] if mirrored else ranges)]))
    path = tmp_path / "short.csv"
    path.write_text("\n".join(lines))
    report = build([path], BuildOptions()).report
    assert report.map.agreement is not None
    assert (SUSPECT < report.map.agreement < 0.9) == mirrored
    better = "the scans would fit each other better with `sensor_pose=(0,0,0,3.14159,0)`"
    told = [note for note in report.notes if "fit" in note]
    assert told == ([f"{path}: scan: {better}"] if mirrored else [])


def test_a_few_hits_are_no_reason_to_name_a_mount(tmp_path: Path) -> None:
    places = [(0.1 * step, 0.0, 0.1 * step) for step in range(10)]
    path = tmp_path / "few.csv"
    write_row(path, [(-5.0, 0.0, 0.0), *places], [0.3, 0.4, 0.5], 0.1)
    report = build([path], BuildOptions()).report
    assert (report.map.agreement or 1) < SUSPECT
    assert report.notes == ()


def test_a_build_names_the_mount_of_the_one_laser_of_two_that_is_mirrored(tmp_path: Path) -> None:
    counter = iter(range(SCANS))
    two = Drive(spoil=lambda ranges: np.roll(ranges[::-1], 1) if next(counter) % 2 else ranges)
    path = write_bag(tmp_path / "room.bag", two, **MOUNTED, topics=TOPICS, frames=FRAMES)
    report = build([path], BuildOptions()).report
    assert (report.map.agreement or 0) > LEAST_AGREEMENT
    (note,) = report.notes
    mount = "`static_transforms=(base_link,rear,0,0,0,3.14159,0,0)`"
    assert note == f"{path}: /rear: the scans would fit each other better with {mount}"


def test_two_lasers_that_are_turned_get_a_line_that_mends_both(here: Path) -> None:
    path = write_bag(here / "room.bag", Drive(math.pi), **MOUNTED, topics=TOPICS, frames=FRAMES)
    found = look(path)
    turned = [f"--static-tf base_link,{frame},0,0,0,0,0,3.14159" for frame in FRAMES]
    assert " ".join(found.command[3:-2]) == " ".join(turned)
    again = look(path, read_line(found.command))
    assert (again.command, again.warnings) == (found.command, ())


def test_a_frame_that_is_found_once_another_is_known_has_no_fault() -> None:
    """By itself `a` hangs on `zenith`, which never moves; `b` shows that `world` is the map."""
    here = Pose.planar(0, 0, 0)
    fixed = bolted("zenith", "base", here), bolted("zenith", "a", here), bolted("base", "b", here)
    scans = [
        Scan(0, frame, 0.0, 0.1, np.array([1, 2], np.float32), 0.0, 9.0, topic=f"/{frame}")
        for frame in ("a", "b")
    ]
    samples = [*drive("world", "base"), *fixed]
    log = SimpleNamespace(path=Path("log"), notes=[], streams=[], poses=lambda: iter(samples))
    posing = prepare(PluginLog(log), scans, BuildOptions())
    assert {frame: chain and chain.frames for frame, chain in posing.poser.chains.items()} == {
        "a": ("world", "base", "zenith", "a"),
        "b": ("world", "base", "b"),
    }
    assert posing.faults == {}


@pytest.mark.parametrize("mount", [BARE, MOUNTED])
def test_lasers_with_frames_of_their_own_are_not_put_at_one_place(
    tmp_path: Path, mount: dict[str, Any]
) -> None:
    path = write_bag(tmp_path / "two.bag", Drive(), **mount, topics=TOPICS, frames=FRAMES)
    posing = PosingOptions(sensor_pose=Pose.planar(0, 0, 0))
    told = refuse(path, BuildOptions(posing=posing))
    assert told.startswith(f"{path}: `sensor_pose` would put 2 lasers at one place: front, rear; ")
    assert "`topics=/front`" in told
    assert "`static_transforms=BASE,front,X,Y,Z,ROLL,PITCH,YAW`" in told
    needed = "`static_transforms=base_link,front,X,Y,Z,ROLL,PITCH,YAW`"
    assert mount == MOUNTED or needed in refuse(path)
    one = BuildOptions(posing=posing, selection=Selection(topics=("/front",)))
    assert build([path], one).report.scans.used == SCANS / 2


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
def test_the_line_holds_the_right_mount_in_place_of_a_wrong_one(yaw: float, tmp_path: Path) -> None:
    """A laser half a metre off that looks to the right is said to look ahead or to the left."""
    path = write_bag(tmp_path / "room.bag", Drive(-math.pi / 2), **MOUNTED)
    found = look(path, BuildOptions(posing=PosingOptions(sensor_pose=Pose.planar(0.5, 0, yaw))))
    assert found.command[3:-2] == ("--sensor-pose", "0.5,0,-1.5708")


def test_of_two_lasers_the_one_that_is_off_gets_a_transform_of_its_own(tmp_path: Path) -> None:
    right = write_bag(tmp_path / "right.bag", Drive(), **MOUNTED)
    assert look(right).warnings == ()
    given = bolted("base_link", "laser", Pose.planar(0.0, 0.0, 1.5))
    poser = make_poser(*drive("odom", "base_link"), static_transforms=(given,))
    poser.chains = {"laser": None, "other": None}
    mount = find_mount(poser, "laser")
    assert mount
    assert mount.write(Pose.planar(0, 0, 1.0)) == {"sensor_pose": "0,0,1"}
    poser.chains = {}
    assert not poser.find_chains(["laser"])
    poser.chains["other"] = None
    mount = find_mount(poser, "laser")
    assert mount
    better = mount.write(turn_mount(mount.pose, Pose.planar(0, 0, -1.5)))
    assert better == {"static_transforms": "base_link,laser,0,0,0,0,0,0"}
    options = BuildOptions(posing=PosingOptions(static_transforms=(given,)))
    words = compose_build([str(right)], options, better.items())
    assert words[3:-2] == ("--static-tf", "base_link,laser,0,0,0,0,0,0")


def test_a_log_that_begins_with_a_dash_is_no_option_in_the_line() -> None:
    line = compose_build(["-x.bag", "y.bag"], BuildOptions(), ())
    assert line == ("occmap", "build", "./-x.bag", "y.bag", "-o", "./-x.pgm")


def test_where_the_poses_fit_no_mount_the_line_looks_for_the_reason(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "room.bag", Drive(0.3), **MOUNTED)
    found = look(path, BuildOptions(resolution=0.1))
    (warning,) = found.warnings
    assert "the poses do not fit the scans; try `occmap tune`" in warning
    assert found.command == ("occmap", "tune", str(path), "--resolution", "0.1")


@pytest.mark.parametrize(("shift", "turn"), [(0.5, 0.0), (0.0, 0.2), (0.0, 0.0)])
def test_two_lasers_that_contradict_each_other_are_told(
    shift: float, turn: float, tmp_path: Path
) -> None:
    """The rear one, of every fourth scan, is in a frame that lies elsewhere, or is turned."""
    drive, counter = Drive(), iter(range(SCANS))

    def spoil(ranges: Float64) -> Float64:
        if (index := next(counter)) % 4 < 3:
            return ranges
        x, y, yaw = drive.pose(index)
        return measure_room(x + shift, y + shift, yaw + turn + drive.bearings)

    two = replace(drive, spoil=spoil)
    topics, frames = ("/front", "/front", *TOPICS), ("front", "front", *FRAMES)
    path = write_bag(tmp_path / "two.bag", two, **MOUNTED, topics=topics, frames=frames)
    found = look(path, BuildOptions(resolution=0.2))
    told = [text for text in found.warnings if "of the hits of a sample of all topics" in text]
    assert len(told) == bool(shift or turn)
    assert [("`occmap merge` with `fit`" in text, "`topics=/rear`" in text) for text in told] == [
        (bool(shift), bool(turn)) for _ in told
    ]
    assert (found.command[1] == "tune") == (found.command[-1] == "/rear") == bool(turn)


def swap_stamps(stamp: int) -> int:
    """Let every second scan come 1.5 s late."""
    return stamp + 3 * SECOND // 2 * (stamp // SECOND % 2)


def hide(scans: Float64) -> Float64:
    """What a laser that hangs upside down and looks back reads: clockwise, from behind."""
    return np.roll(scans[::-1], BEAMS // 2 + 1)


def correct(index: int) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if index >= 8 else (9.0, -4.0, 1.7)


QUARTERS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
BETTER = "the scans would fit each other better with "


@pytest.mark.parametrize(
    ("drive", "given", "options", "words", "told"),
    [
        *((Drive(turn), BARE, {}, f"--sensor-pose 0,0,{turn:.6g}", NO_MOUNT) for turn in QUARTERS),
        (Drive(spoil=hide), BARE, {},
         "--sensor-pose 0,0,3.14159,3.14159,0",
         "its mount on base_link: `sensor_pose=(0,0,3.14159,3.14159,0)`, which suits the scans"),
        # It is turned by 1 rad, which is none of the turns that are tried.
        (Drive(1.0), {"mount": [], "frames": ("lidar_link",), "others": OTHERS}, {},
         "--sensor-pose 0,0,1", "`sensor_pose=(0,0,1)`, where tf has 'laser'"),
        (Drive(math.pi), {}, {}, "--sensor-pose 0,0,3.14159",
         f"{BETTER}`sensor_pose=(0,0,3.14159)`"),
        (Drive(math.pi), BARE, {"poses": "poses.csv"},
         "--poses poses.csv --sensor-pose 0,0,3.14159", BETTER),
        (Drive(drift=0.05), {"truth": "/vicon/robot"}, {}, "--poses /vicon/robot",
         "`poses=/vicon/robot`"),
        (Drive(drift=0.05), {"truth": "/tf"}, {}, "--map-frame world", "`map_frame=world`"),
        (Drive(), {"scan_stamp": swap_stamps}, {}, "--stamps record", "`stamps=record`"),
        # By then it has turned by a quarter, as if the laser were.
        (Drive(), {"scan_stamp": lambda stamp: stamp + 14 * 10**9}, {}, "--stamps record",
         "`stamps=record`"),
        (Drive(), {"scan_stamp": lambda _: 0}, {}, "--stamps record",
         "40 before the first pose; try `stamps=record`"),
        (Drive(increment=0.01), {}, {}, "--deskew on", "`deskew=on`"),
        (Drive(), {"correct": correct}, {}, "--start 8", " 97 deg 8.000 s after the first scan: "),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_the_line_that_mends_it(
    drive: Drive, given: dict[str, Any], options: dict[str, str], words: str, told: str, here: Path
) -> None:
    path = write_bag(here / "room.bag", drive, **MOUNTED | given)
    write_poses(here / "poses.csv", np.arange(SCANS) + 100, list(map(drive.pose, range(SCANS))))
    typed = read_options(BuildOptions, options, "check_logs")
    found = look(path, typed)
    assert sum(told in text for text in (*found.problems, *found.warnings)) == 1
    assert " ".join(found.command[3:-2]) == words
    if found.buildable:
        notes = build([path], typed).report.notes
        assert any(told in note for note in notes) == told.startswith((BETTER, " 97 deg"))
        assert not any("occmap tune" in text for text in found.warnings)
    else:
        with pytest.raises(OccmapError, match=re.escape(told.partition(";")[0])):
            build([path], typed)
    again = look(path, read_line(found.command))
    assert again.command == found.command
    assert not any(told in text for text in (*again.problems, *again.warnings))
    assert all(each.agreement and each.agreement > 0.98 for each in again.topics)


@pytest.mark.parametrize(
    ("turned", "line"),
    [
        ((0.0, math.pi), "--poses poses.csv --sensor-pose 0,0,0"),  # the poses are the laser's own
        ((1.2, 0.0), "--poses /vicon/robot"),
    ],
)
def test_of_two_remedies_for_the_poses_a_line_has_the_one_that_keeps_them_if_it_can(
    turned: tuple[float, float], line: str, here: Path
) -> None:
    drive, (pitch, yaw) = Drive(math.pi), turned
    path = write_bag(here / "room.bag", drive, mount=[(0.0, math.pi)], truth="/vicon/robot")
    rows = [(100 + at, *drive.pose(at), pitch) for at in range(SCANS)]
    texts = [f"{stamp},{x},{y},{heading + yaw},{it}" for stamp, x, y, heading, it in rows]
    (here / "poses.csv").write_text("\n".join(["stamp,x,y,yaw,pitch", *texts]))
    found = look(path, BuildOptions(posing=PosingOptions(poses="poses.csv")))
    assert " ".join(found.command[3:-2]) == line
    again = look(path, read_line(found.command))
    assert (again.command, again.warnings) == (found.command, ())
    assert topic(again).agreement == pytest.approx(1, abs=0.02)


def test_space_that_was_cleared_through_walls_is_told() -> None:
    clear = BuildOptions(returns=ReturnOptions(no_return=NoReturn.CLEAR))
    found = look(SAMPLE_LOGS / "drive.mcap", clear)
    (warning,) = found.warnings
    assert "`no_return=clear` is wrong here" in warning
    assert "--no-return" not in found.command


@pytest.mark.parametrize(
    ("pace", "poses_ns", "simulated"),
    [
        (0.8, 5 * 10**9, True),
        (1.0, 10**12, True),
        (3.0, 0, True),
        (0.8, 1_700_000_000 * 10**9, False),  # a laser that counts from its start
        (0.8, None, False),
    ],
)
def test_simulated_time_is_told_from_a_clock_that_drifts(
    pace: float, poses_ns: int | None, simulated: bool
) -> None:
    stamps = StampLog()
    for index in range(100):
        recorded = 1_700_000_000 * 10**9 + index * 10**9
        stamp = round(pace * index * 1e9)
        stamps.add(Scan(stamp, "", 0, 0.1, np.ones(1, np.float32), 0, 9, record_ns=recorded))
    times = stamps.sum_up(poses_ns)
    assert times.simulated == simulated
    assert times.drift_s == pytest.approx(0 if simulated else -0.2 * 90, abs=0.5)


def test_a_beam_that_no_build_traces_is_a_problem(tmp_path: Path) -> None:
    """It runs along an axis, so that the map would not be too large."""
    poses = [(0.0, 0.0, 0.0)] * 3
    log = write_row(tmp_path / "far.csv", poses, [2.5e5, 1.0, 1.5, 2.0], math.pi / 2)
    with pytest.raises(MapError, match=r"a beam of 250000 m is too long for cells of 0\.05 m"):
        build([log], BuildOptions())
    found = look(log)
    assert "a beam of 250000 m is too long for cells of 0.05 m; limit" in found.problems[0]
    assert found.command == ()
    assert found.map is not None
    assert found.map.columns * found.map.rows < BuildOptions().max_cells


def test_clouds_are_told_by_the_ground_below_them() -> None:
    found = look(HALL)
    (topic,) = found.logs[0].scans
    assert (topic.is_of_clouds, topic.scans) == (True, 40)
    assert found.problems == found.warnings == ()
    assert found.command[:2] == ("occmap", "build")
    assert any("0.59 m above the ground" in note for note in found.logs[0].notes)  # of 0.6
    camera = MountFindings(upside_down=True, tilt=math.radians(75), height=0.5, better="")
    assert describe_mount(camera, topic) == "its z axis points 15.0 deg down, z 0.5 m"


@pytest.mark.parametrize(
    ("height", "turned", "told"),
    [
        (0.0, (0.0, 0.0175, 0.0), "tilted by 1.0 deg in the sensor's own frame"),
        (0.0, (0.05, 0.0, 0.0), "tilted by 2.[7-9] deg in the sensor's own frame"),
        (0.0, (-0.1, 0.0, 0.0), "tilted by 5.7 deg in the sensor's own frame"),
        (0.6, (0.0, 0.3, 0.0), "its mount is another"),
        (0.6, (math.pi / 2, 0.0, 0.0), "its mount is another"),
        (0.6, (-2.0, 0.0, -1.5), "its mount is another"),
    ],
)
def test_a_wrong_mount_of_clouds_is_told_with_the_one_that_lays_the_floor_flat(
    height: float, turned: tuple[float, float, float], told: str
) -> None:
    mount = bolted("base_link", "lidar", Pose.from_xyzrpy((0, 0, height), turned))
    found = look(HALL, BuildOptions(posing=PosingOptions(static_transforms=(mount,))))
    assert any(re.search(told, text) for text in (*found.warnings, *found.problems))
    mended = found.command[found.command.index("--static-tf") + 1].split(",")
    assert mended[:2] == ["base_link", "lidar"]
    assert list(map(float, mended[2:])) == pytest.approx([0, 0, height, 0, 0, 0], abs=0.01)
    assert look(HALL, read_line(found.command)).command == found.command


def test_a_quarter_turn_is_advised_where_clouds_contradict_each_other_without_it() -> None:
    mount = Pose.planar(0, 0, math.pi / 2)
    found = look(HALL, BuildOptions(posing=PosingOptions(sensor_pose=mount)))
    (warning,) = found.warnings
    assert "clouds contradict each other" in warning
    assert found.command[3:-2] == ("--sensor-pose", "0,0,0")


def test_a_cloud_without_a_mount_gets_one_by_its_floor_to_be_typed(tmp_path: Path) -> None:
    log = tmp_path / "no_mount.mcap"
    with HALL.open("rb") as source, log.open("wb") as target:
        copy_mcap(source, target, leave_out="/tf_static")
    found = look(log)
    (problem,) = found.problems
    mount = found.command[found.command.index("--sensor-pose") + 1]
    assert f"`sensor_pose=({mount})`" in problem
    assert "by the floor 0.6" in problem
    x, y, yaw, *tilt = map(float, mount.split(","))
    assert (x, y, yaw, *tilt) == pytest.approx((0, 0, 0, 0, 0)[: 3 + len(tilt)], abs=0.01)
    assert problem == refuse(log)


def test_the_lidar_of_kittis_calibration_is_in_the_line_if_poses_are_of_a_camera(
    here: Path,
) -> None:
    rows = follow_hall()
    np.savetxt(here / "times.txt", rows[:, 0], fmt="%.6f")
    (here / "calib.txt").write_text("P0: 7e2\nTr: 0 -1 0 -0.01 0 0 -1 -7.0e-02 1 0 0 -0.27\n")
    for axes, mount in ((np.eye(3), ()), (FROM_CAMERA, ("--sensor-pose", "-0.27,0.01,0"))):
        place, turns = rows[:, 1:4] @ axes, axes.T @ rotate_by(rows[:, 4:]) @ axes
        np.savetxt("poses.txt", np.dstack([turns, place]).reshape(-1, 12))
        found = look(HALL, BuildOptions(posing=PosingOptions(poses="poses.txt")))
        assert found.command[3:-2] == ("--poses", "poses.txt", *mount)
    own = look(HALL, BuildOptions(posing=PosingOptions(poses="poses.txt", base_frame="lidar")))
    assert "--sensor-pose" not in own.command
