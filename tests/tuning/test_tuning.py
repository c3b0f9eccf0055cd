"""Tuning: what was put out of true in a simulated drive is found, and nothing else is."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap import tuning as tuning_package
from occmap.choices import to_rpy
from occmap.cli.logs import format_tuning
from occmap.errors import LogError, PoseError
from occmap.inspection import inspect
from occmap.options import DEFAULT_UPDATE, OPTIONS, BuildOptions, Selection, choose_model
from occmap.posing import Deskew, PosingOptions
from occmap.scans import GOLDEN, Sample
from occmap.scans.tracing import Reading, ignore_progress
from occmap.scoring import Gain, Trial
from occmap.scoring.compare import Variant, compare
from occmap.sensor import ReturnOptions
from occmap.tuning import Tuning, list_other_cures, list_unlike, search, tune
from occmap.tuning.search import Correction, Verdict, slice_clouds, thin_clouds
from occmap.types import Cloud, Float64, Kind, Pose, ScanBatch
from tests.bench.plans import cast_scans
from tests.clouds.simulation import HALL, place, turn
from tests.csv_logs import write_poses, write_scans
from tests.inspection_logs import Drive, write_bag
from tests.readers.ros import SECOND
from tests.samples import SAMPLE_LOGS, Planar, find_real, write_csv
from tests.tuning.simulated import ROOM, read_drive, write_drive, write_parts, write_two_lasers

pytestmark = pytest.mark.usefixtures("here")
EVERY_SECOND, EVERY_THIRD = (BuildOptions(selection=Selection(stride=stride)) for stride in (2, 3))
"""Show as much as all scans, in less time"""
STEP_S, STEP_RAD, STEP_M = (each.steps[-1] for each in (search.TIME, search.YAW, search.X))


def follow(poses: Path, mount: Planar | None = None, **posing: Any) -> BuildOptions:
    """Options by which a drive's scans are posed; the laser is thought to sit at a mount."""
    sensor_pose = None if mount is None else Pose.planar(*mount)
    posed = PosingOptions(poses=str(poses), sensor_pose=sensor_pose, **posing)
    return BuildOptions(resolution=0.1, posing=posed)


def tune_drive(late_s: float = 0.0, mount: Planar = (0.0, 0.0, 0.0), **known: Any) -> Tuning:
    """Tune a drive whose scans are stamped so much too late, and whose laser sits at a mount."""
    scans, poses = write_drive(Path(), lambda _: late_s, mount)
    return tune([scans], follow(poses, **known))


@pytest.mark.parametrize(("late", "given"), [(-0.31, 0.0), (0.6, -0.5)])
def test_a_known_time_offset_is_found_and_added_to_what_is_given(late: float, given: float) -> None:
    tuning = tune_drive(late, time_offset_s=given)
    found = tuning.correction.time_s
    assert tuning.time.verdict is Verdict.FOUND
    assert found == pytest.approx(-late - given, abs=STEP_S + 1e-9)
    assert tuning.mount.verdict is Verdict.NOTHING
    assert tuning.share > 0.95 > tuning.share_before
    place = tuning.command.index("--time-offset")
    assert float(tuning.command[place + 1]) == pytest.approx(given + found)


def test_where_the_best_is_at_the_edge_of_what_is_tried_it_is_said_where_to_go_on() -> None:
    tuning = tune_drive(0.9)
    assert tuning.command == ()
    assert tuning.mount.verdict is Verdict.UNSEEN
    assert any("tune again with `time_offset_s=-" in text for text in tuning.notes)


def test_no_command_is_given_where_the_log_fits_badly_then(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("occmap.report.results.LEAST_AGREEMENT", 1e9)  # no log fits so well
    tuning = tune_drive(0.13)
    assert tuning.correction.time_s == pytest.approx(-0.13, abs=STEP_S + 1e-9)
    assert tuning.command == ()
    assert "far from what is right" in tuning.notes[-1]


def test_a_known_error_of_the_mount_is_found() -> None:
    true, thought = (0.25, 0.0, 0.0), (0.29, -0.03, math.radians(3))
    scans, poses = write_drive(Path(), mount=true)
    options = follow(poses, thought)
    tuning = tune([scans], options)
    assert tuning.time.verdict is Verdict.NOTHING
    assert tuning.mount.verdict is Verdict.FOUND
    pose = tuning.correction.apply(options.posing, options.posing.sensor_pose).sensor_pose
    assert pose is not None
    assert (pose.x, pose.y) == pytest.approx(true[:2], abs=2 * STEP_M + 1e-5)
    assert to_rpy(pose)[2] == pytest.approx(true[2], abs=STEP_RAD + 1e-5)


def test_a_wrong_mount_is_not_taken_for_a_wrong_clock() -> None:
    """The laser sits 0.25 m ahead; an offset of 0.2 s would gain as well, but a third of that."""
    given = BuildOptions(resolution=0.1, posing=PosingOptions(sensor_pose=Pose.planar(0, 0, 0)))
    tuning = tune([SAMPLE_LOGS / "drive.mcap"], given)
    assert tuning.time.verdict is Verdict.NOTHING
    assert tuning.mount.verdict is Verdict.FOUND
    found = tuning.correction
    assert found == Correction(x=found.x)
    assert found.x == pytest.approx(0.25, abs=STEP_M + 1e-9)
    assert tuning.share > 0.95


def write_spin(folder: Path, increment_s: float) -> tuple[Path, Path]:
    """A laser in a room of 6 x 4 m that turns at 2 rad/s as it drives; and its poses."""

    def place(seconds: Float64) -> Float64:
        return np.stack([np.sin(seconds / 3) - 3.5, np.cos(seconds / 4) - 2.2, 2 * seconds])

    angles = np.arange(90) * math.tau / 90
    stamps, moments, ranges = np.arange(1.0, 39.0, 0.25), np.arange(0.0, 40.0, 0.02), []
    for second in stamps:
        poses = place(second + np.arange(90) * increment_s).T + np.outer(angles, (0, 0, 1))
        ranges.append(cast_scans(poses, np.zeros(1), ROOM)[:, 0])
    shape = {"angle_min": 0.0, "angle_increment": math.tau / 90, "range_max": 8.0}
    scans = write_scans(folder / "spin.csv", stamps, ranges, **shape, time_increment=0.0025)
    return scans, write_poses(folder / "poses.csv", moments, place(moments).T)


def test_scans_that_take_long_need_a_pose_for_each_beam() -> None:
    scans, poses = write_spin(Path(), 0.0025)
    tuning = tune([scans], follow(poses))
    assert tuning.deskew.verdict is Verdict.FOUND
    assert tuning.correction == Correction(deskew=True)
    assert tuning.share > 0.98 > tuning.share_before + 0.2
    assert tuning.command[-4:-2] == ("--deskew", "on")
    (warning,) = inspect([scans], replace(follow(poses), resolution=0.02)).warnings
    assert "20% of the hits of a sample of scans lie in occupied cells, and 99% with `d" in warning


def test_no_command_is_given_where_other_times_fit_better(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of a laser jumps by three seconds, in which its robot turns by 0.33 rad."""

    def jump(stamp: int) -> int:
        return stamp + 3 * SECOND * (stamp >= 120 * SECOND)

    log = write_bag(Path("jump.bag"), Drive(), [(0.0, 0.0)], scan_stamp=jump)
    (told,) = list_other_cures([log], BuildOptions())
    assert "tune again with `stamps=record`" in told
    monkeypatch.setattr(tuning_package, "list_other_cures", lambda *_: [told])
    tuning = tune_drive(0.1)
    assert (tuning.time.verdict, tuning.command) == (Verdict.FOUND, ())
    assert told in tuning.notes


def test_no_command_is_given_where_poses_jump() -> None:
    scans, poses = write_drive(Path(), lambda _: 0.1)
    table = np.loadtxt(poses, delimiter=",", skiprows=1)
    table[207:, 1] += 2
    tuning = tune([scans], follow(write_poses(poses, table[:, 0], table[:, 1:])))
    assert tuning.correction.time_s
    assert tuning.command == ()
    assert tuning.notes[-1].startswith(f"{scans}: tune again with `end_s=")


def seat_lasers(poses: Path, rear_x: float) -> BuildOptions:
    """Options for two lasers; the rear one is thought to sit at an x, and really at -0.3 m."""
    seats = ["base_link,front,0.3,0,0,0,0,0", f"base_link,rear,{rear_x},0,0,0,0,{math.pi}"]
    known = {"poses": str(poses), "static_transforms": OPTIONS["static_transforms"].read(seats)}
    return BuildOptions(posing=PosingOptions(**known))


@pytest.mark.parametrize(("late_s", "rear_x"), [(0.1, -0.3), (0.0, -0.2)])
def test_a_time_that_makes_up_for_the_mount_of_one_of_two_lasers_is_not_recommended(
    late_s: float, rear_x: float
) -> None:
    """Both halves show it, and certainly; but a clock that is late shows in each laser's map."""
    log, poses = write_two_lasers(Path(), late_s)
    tuning = tune([log], seat_lasers(poses, rear_x))
    assert tuning.time.verdict is Verdict.FOUND
    assert all(half.certain for half in tuning.time.halves)
    assert tuning.correction.time_s == pytest.approx(-0.1, abs=2 * STEP_S + 1e-9)
    assert bool(tuning.command) == bool(late_s)
    doubts = [text.split(",")[0] for text in tuning.notes if "mapped alone, gains only" in text]
    assert doubts == ([] if late_s else ["/front", "/rear"])
    told = list(format_tuning(tuning))[-1].startswith("nothing is recommended: /front")
    assert told == bool(doubts)  # the reason stands beside it
    assert any("`topics=/front`, then with `topics=/rear`" in text for text in tuning.notes)


def test_a_half_that_may_gain_by_chance_is_told() -> None:
    """Of four scans of ten beams the first two gain 4 and 0 beams, the others 2 each."""
    best = Correction(time_s=-0.1)
    fared = {Correction(): [1, 4, 5, 3], best: [5, 4, 7, 5]}
    tried = {
        each: Trial(np.pad(predict(near), [(0, 0), (0, 4)]), np.zeros((1, 3)), None)
        for each, near in fared.items()
    }
    scorer = search.Scorer([], BuildOptions(), None, lambda: None, tried=tried)
    (told,) = list_unlike(scorer, best)
    assert told.startswith("the first half of the scans gains only 0.2000 +- 0.2000 ")


def test_the_mount_of_one_of_two_lasers_is_given_as_a_transform_to_its_frame() -> None:
    log, poses = write_two_lasers(Path(), 0.0)
    options = seat_lasers(poses, -0.2)
    tuning = tune([log], replace(options, selection=Selection(topics=("/rear",))))
    found = tuning.correction
    assert found.x < -0.05
    (given,) = [word for word in tuning.command if word.startswith("base_link,rear,")]
    place = [-0.2 + found.x, found.y, 0, 0, 0]
    assert [*map(float, given.split(",")[2:7])] == pytest.approx(place, abs=1e-5)
    assert math.remainder(float(given.split(",")[7]) - math.pi - found.yaw, math.tau) < 2e-5
    assert "base_link,front,0.3,0,0,0,0,0" in tuning.command
    assert "--sensor-pose" not in tuning.command


def test_better_is_what_surely_gains() -> None:
    scans, poses = write_drive(Path(), lambda _: 0.1)
    logs, _ = keep(scans, follow(poses))
    scorer = search.Scorer(logs, follow(poses), None, lambda: None)
    late = Correction()
    assert search.is_better(scorer, late, late)
    assert search.is_better(scorer, late, Correction(time_s=-0.1))
    assert not search.is_better(scorer, late, Correction(time_s=-0.5))


def test_scans_that_only_say_that_they_take_long_are_left_as_they_are() -> None:
    scans, poses = write_spin(Path(), 0.0)
    tuning = tune([scans], follow(poses))
    assert tuning.deskew.verdict is Verdict.NOTHING
    assert tuning.correction == Correction()
    assert tuning.share > 0.95
    decided = tune([scans], follow(poses, deskew=Deskew.AUTO))
    assert decided.deskew.verdict is Verdict.UNSEEN


def test_a_time_offset_that_a_wrong_mount_hides_is_found() -> None:
    tuning = tune_drive(0.05, mount=(0.15, 0.05, 0.0))
    assert tuning.mount.verdict is tuning.together.verdict is Verdict.FOUND
    found = tuning.correction
    assert found.time_s == pytest.approx(-0.05, abs=STEP_S + 1e-9)
    assert (found.x, found.y) == pytest.approx((0.15, 0.05), abs=2 * STEP_M + 1e-9)
    assert found.yaw == pytest.approx(0.0, abs=STEP_RAD + 1e-9)


@pytest.mark.parametrize("name", ["drive.mcap", "drive.log"])
def test_a_right_log_has_nothing_to_gain_and_scores_what_compare_scores(name: str) -> None:
    """A drive, with ranges that stand for "no return" in the second, of which no scan is lost."""
    log = SAMPLE_LOGS / name
    tuning = tune([log], EVERY_SECOND)
    assert {tuning.time.verdict, tuning.mount.verdict}.isdisjoint({Verdict.FOUND, Verdict.DISAGREE})
    assert (tuning.correction, tuning.command) == (Correction(), ())
    assert (tuning.gain, tuning.gain_error) == (0.0, 0.0)
    if name == "drive.log":
        variant = Variant(DEFAULT_UPDATE, choose_model(DEFAULT_UPDATE))
        (result,) = compare([log], [variant], EVERY_SECOND).results
        scored = tuning.beams, tuning.share_before
        assert scored == (result.score.beams, result.score.share)


def test_halves_that_want_different_times_are_told_and_not_averaged() -> None:
    scans, poses = write_drive(Path(), lambda number: 0.1 if number < 207 else -0.1)
    tuning = tune([scans], follow(poses))
    assert tuning.time.verdict is Verdict.DISAGREE
    first, second = tuning.time.halves
    assert first.correction.time_s < 0 < second.correction.time_s
    assert all(half.certain for half in (first, second))
    assert tuning.mount.verdict is Verdict.UNSEEN
    assert (tuning.correction, tuning.command) == (Correction(), ())


def keep(path: Path, options: BuildOptions) -> tuple[list[search.KeptLog], list[str]]:
    """Read a log as tune does; give what is kept, and the notes."""
    reading = Reading([path], options, ignore_progress)
    return search.keep_logs(reading), reading.tally.notes


@pytest.mark.parametrize(
    ("name", "x"), [("drive.bag", 0.25), ("drive_ros2", 0.25), ("drive.csv", 0.0)]
)
def test_the_mount_that_a_log_states_is_where_the_search_begins(name: str, x: float) -> None:
    options = BuildOptions()
    logs, _ = keep(SAMPLE_LOGS / name, options)
    mount = search.find_common_mount(logs)
    assert mount is not None
    assert mount == pytest.approx((x, 0, 0, 0, 0, 0, 1), abs=1e-9)
    moved = Correction(x=0.005).apply(options.posing, mount).sensor_pose
    assert moved is not None
    assert moved[:2] == (x + 0.005, 0.0)


def test_a_mount_that_is_given_as_it_is_changes_no_pose() -> None:
    options = BuildOptions()
    logs, _ = keep(SAMPLE_LOGS / "drive.bag", options)
    given = replace(options.posing, sensor_pose=search.find_common_mount(logs))
    for one, other in zip(logs[0].pose(options.posing), logs[0].pose(given), strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-9)
        np.testing.assert_allclose(one.rotation, other.rotation, atol=1e-9)


@pytest.mark.parametrize(
    ("poses", "searched", "note"),
    [
        ([(0.1 * i, 0.0, 0.0) for i in range(20)], {"yaw"}, "x and y of the mount are not"),
        ([(0.0, 0.0, 0.1 * i) for i in range(20)], {"x", "y"}, "the yaw of the mount is not"),
        ([(0.0, 0.0, 0.0)] * 20, set(), "the sensor hardly moves"),
    ],
)
def test_only_what_the_motion_shows_is_searched(
    poses: list[Planar], searched: set[str], note: str
) -> None:
    log = write_csv(Path("log.csv"), poses, [1.0, 2.0, 1.5], 0.3)
    tuning = tune([log], BuildOptions())
    names = ("time_s", "yaw", "x", "y")
    assert {name for each in tuning.tried for name in names if getattr(each, name)} == searched
    assert (tuning.mount.verdict is Verdict.UNSEEN) == (not searched)
    assert any(text.startswith(note) for text in tuning.notes)


def test_lasers_at_different_places_have_no_one_mount() -> None:
    tuning = tune([SAMPLE_LOGS / "drive.bag", SAMPLE_LOGS / "drive.csv"], EVERY_SECOND)
    assert tuning.mount.verdict is Verdict.UNSEEN
    assert any("no single `sensor_pose`" in text for text in tuning.notes)


def test_logs_of_one_robot_are_sure_together_where_none_is_alone() -> None:
    """The laser is thought to be turned by 1.2 degrees; each part has 12 held-out scans."""
    off = math.radians(1.2)
    posing = PosingOptions(sensor_pose=Pose.planar(0, 0, off))
    options = BuildOptions(resolution=0.1, posing=posing)
    parts = write_parts(Path(), [0, 0, 0], scans=60)
    alone = [tune([part], options) for part in parts]
    assert [each.command for each in alone] == [()] * 3
    together = tune(parts, options)
    found = together.correction
    assert found.yaw == pytest.approx(-off, abs=STEP_RAD)
    assert (found.x, found.y) == pytest.approx((0, 0), abs=0.02)  # a fifth of a cell
    assert "--sensor-pose" in together.command
    assert [each.log for each in together.by_log] == list(map(str, parts))
    assert [each.share_before for each in together.by_log] == [each.share_before for each in alone]
    assert sum(each.beams for each in together.by_log) == together.beams
    assert all(each.gain > 0.02 for each in together.by_log)


@pytest.mark.parametrize(("last", "verdict"), [(1, Verdict.FOUND), (0, Verdict.DISAGREE)])
def test_no_command_is_given_where_one_of_the_logs_loses(last: float, verdict: Verdict) -> None:
    """Three lasers are turned by 3 degrees from what is thought, the last one by less."""
    parts = write_parts(Path(), [3, 3, 3, last], scans=100)
    tuning = tune(parts, BuildOptions(resolution=0.1))
    assert tuning.mount.verdict is verdict
    assert [each.loses for each in tuning.by_log] == [False, False, False, True]
    assert all(each.gain > 0.05 for each in tuning.by_log[:3])
    assert tuning.command == ()
    assert f"{parts[3]} loses 0." in tuning.notes[-1]


def test_scans_without_a_pose_at_some_offset_are_in_no_map() -> None:
    scans, poses = write_drive(Path())
    ((log,), _) = keep(scans, follow(poses))
    assert log.scans == 207 - 2 - 1  # at either end, of three of five a second, the even ones


def test_too_short_a_log_is_refused() -> None:
    scans, poses = write_drive(Path())
    few = Path("few.csv")
    few.write_text("\n".join(poses.read_text().splitlines()[:5]))
    with pytest.raises(PoseError, match="give a longer log"):
        tune([scans], follow(few))


def test_nothing_to_score_by_is_refused() -> None:
    log = write_csv(Path("blind.csv"), [(0.1 * i, 0.0, 0.0) for i in range(20)], [math.nan])
    with pytest.raises(LogError, match="measured a range"):
        tune([log], BuildOptions())


@pytest.mark.parametrize("sizes", [[800], [1] * 800, [300, 0, 499, 1]])
@pytest.mark.parametrize("lasers", [1, 2, 3, 4, 5, 8])
def test_scans_are_sampled_evenly_however_they_are_batched_or_take_turns(
    sizes: list[int], lasers: int
) -> None:
    sample = Sample[ScanBatch](150)
    for part in np.split(np.arange(800), np.cumsum(sizes)[:-1]):
        ranges, still = np.ones((len(part), 2), np.float32), np.zeros(len(part))
        sample.add(ScanBatch("laser", 0.0, 0.1, 0.0, 9.0, part, part, ranges, still))
    taken = np.concatenate([part.stamp_ns for part in sample.parts])
    assert (sample.seen, sample.scans) == (800, len(taken))
    assert 75 < len(taken) <= 150
    assert set(np.diff(taken).tolist()) <= {5, 8, 13}  # the gaps of multiples of the golden ratio
    of_laser = np.bincount(taken % lasers)
    assert len(of_laser) == lasers
    assert np.abs(of_laser / len(taken) - 1 / lasers).max() < 0.05


def test_a_long_log_is_thinned_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("occmap.tuning.search.MOST_SCANS", 150)
    ((log,), notes) = keep(SAMPLE_LOGS / "drive.csv", BuildOptions())
    (batch,) = log.batches
    kept = [n for n in range(414) if n * GOLDEN % 1 < 0.25]
    np.testing.assert_allclose(batch.stamp_ns / 1e9, read_drive()[kept, 0], rtol=0, atol=1e-3)
    assert f"{log.scans} of 414 scans are tried, spread over the logs" in notes


def predict(predicted: list[int]) -> Float64:
    """Scans of ten beams each."""
    return np.array([(10, near) for near in predicted], float)


def test_a_gain_is_measured_scan_by_scan() -> None:
    gain = Gain.measure(predict([1, 4, 7, 3]), predict([3, 6, 9, 5]))
    assert vars(gain) == pytest.approx({"gain": 0.2, "gain_error": 0.0})
    assert gain.certain
    # Gains of 4, 0, 4, 0 beams in ten: their mean is 0.2, its error sqrt(4/3 * 4 * 4) / 40
    noisy = Gain.measure(predict([1, 4, 1, 3]), predict([5, 4, 5, 3]))
    assert vars(noisy) == pytest.approx({"gain": 0.2, "gain_error": math.sqrt(64 / 3) / 40})
    assert not noisy.certain
    half = Gain.measure(predict([7, 3]), predict([8, 4]))
    assert vars(half) == pytest.approx({"gain": 0.1, "gain_error": 0.0})
    assert not Gain(gain=0.004).certain  # nobody sees that


def test_a_real_robot_whose_stamps_are_late() -> None:
    tuning = tune([find_real("ros2/macfirst_floor_take_2")], EVERY_THIRD)
    assert tuning.time.verdict is Verdict.FOUND
    assert tuning.correction.time_s == pytest.approx(-0.1, abs=0.03)
    assert tuning.time.gain > 0.05


def test_a_mount_that_halves_disagree_about_is_not_made_up_from_a_wrong_time() -> None:
    """Mount first, it gains as much again, but fewer hits agree: 70% and not 73%."""
    tuning = tune([find_real("ros1/test_turtlebot.bag")], EVERY_THIRD)
    assert tuning.mount.verdict is Verdict.DISAGREE
    assert tuning.correction == Correction(time_s=tuning.correction.time_s)


@pytest.mark.parametrize("is_sure", [True, False])
def test_a_time_that_only_the_right_mount_shows_is_told_as_such_and_must_be_sure(
    is_sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not is_sure:
        monkeypatch.setattr("occmap.tuning.search.is_better", lambda *_: False)
    posing = PosingOptions(sensor_pose=Pose.planar(0, 0, math.pi))
    tuning = tune([find_real("ros1/mylaserdata2.bag")], BuildOptions(posing=posing))
    assert tuning.time.verdict is Verdict.NOTHING
    assert bool(tuning.correction.time_s) == ("--time-offset" in tuning.command) == is_sure
    assert any("time     by itself" in line for line in format_tuning(tuning)) == is_sure


def test_a_corrected_log_has_nothing_to_gain() -> None:
    tuning = tune([find_real("carmen/intel-corrected.log.gz")], EVERY_THIRD)
    assert tuning.mount.verdict is Verdict.NOTHING
    askew = [
        each.share
        for each in tuning.tried
        if (each.time_s, each.x, each.y) == (0, 0, 0) and abs(each.yaw) > STEP_RAD / 2
    ]
    assert len(askew) == 2 * len(search.YAW.steps)
    assert max(askew) < tuning.share_before


POINTS = [
    (2.0, 0.1, 0.1),
    (3.0, 0.15, 0.0),  # behind it, in the same half degree
    (0.0, 4.0, -0.15),
    (-5.0, 0.1, 0.3),  # too high
    (0.1, 0.1, 0.0),  # the robot itself
    (0.0, -40.0, 0.0),  # too far away
    (math.nan, 1.0, 0.0),
]


def test_a_scan_has_the_nearest_point_of_each_bearing_at_the_height_of_the_sensor() -> None:
    """Whatever way the sensor is turned."""
    turned = turn(20, -10, 30)
    cloud = Cloud(7, "lidar", (np.array(POINTS) @ turned).astype(np.float32))
    rays = slice_clouds(place(cloud, np.array([1.0, 2.0, 3.0]), turned[None]), ReturnOptions())
    (hit,) = rays.kind == Kind.HIT
    ends = rays.end[0, hit]
    assert sorted(ends.tolist()) == [pytest.approx((1, 6)), pytest.approx((3, 2.1))]
    bearings = np.flatnonzero(hit) * (math.tau / 720)
    assert bearings == pytest.approx([math.atan2(0.1, 2), math.pi / 2], abs=math.radians(0.5))


def test_points_that_may_be_of_no_scan_are_not_kept() -> None:
    points = np.zeros((50_000, 3), np.float32)
    points[:, 0], points[:25_000, 2] = 1, 5
    offset_ns = np.arange(len(points))
    cloud = Cloud(7, "lidar", points, offset_ns)
    (kept,) = thin_clouds(place(cloud, np.zeros(3), np.eye(3)[None])).batch.clouds or ()
    assert kept.offset_ns is not None
    assert kept.offset_ns.min() >= 25_000  # those that do not lie 5 m above the sensor
    assert len(kept.points) == len(kept.offset_ns) == pytest.approx(25_000 / 6, abs=2)


def test_a_late_clock_is_found_by_clouds() -> None:
    posing = PosingOptions(time_offset_s=0.15)
    found = tune([HALL], BuildOptions(resolution=0.1, posing=posing))
    assert found.time.verdict is Verdict.FOUND
    assert found.correction.time_s == pytest.approx(-0.15, abs=0.02)
    (few,) = found.doubts  # three seconds are not much
    assert "too few to tell" in few
    right = tune([HALL], BuildOptions(resolution=0.1))
    assert not right.correction.is_any
