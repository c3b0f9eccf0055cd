import math
from dataclasses import replace

import numpy as np
import pytest

from occmap.errors import UsageError
from occmap.inspection.poses import list_coverage
from occmap.posing import Deskew, DropReason, PosingOptions, Stamps
from occmap.posing.attach import Poser
from occmap.posing.frames import Source
from occmap.sensor import ReturnOptions, interpret
from occmap.types import Cloud, Float64, Pose, PoseSample, ScanBatch
from tests.posing.scenes import SECOND, at, attach, batch_at, bolted, build, drive, turned, yaw_of

MOUNT = bolted("base_link", "laser", Pose.planar(0.5, 0, 0))


def test_scans_without_a_pose_are_left_out_and_counted() -> None:
    log = drive("odom", "base_link", seconds=[0, 1, 2, 6, 7])
    batch = batch_at([-1, 0.5, 3, 4, 6.5, 7.5, 8, 9])
    batch = replace(batch, ranges=np.arange(8, dtype=np.float32)[:, None])
    (posed,), dropped = attach(build(*log, MOUNT), batch)
    assert dropped == {DropReason.BEFORE: 1, DropReason.GAP: 2, DropReason.AFTER: 3}
    assert posed.position[:, 0].tolist() == [1, 7]
    assert posed.batch.stamp_ns.tolist() == [SECOND // 2, 13 * SECOND // 2]
    assert posed.batch.ranges[:, 0].tolist() == [1, 4]


def test_a_batch_without_any_pose_or_any_scan_gives_nothing() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT)
    assert attach(poser, batch_at([20, 30])) == ([], {DropReason.AFTER: 2})
    assert attach(poser, batch_at([])) == ([], {})


def test_the_gap_limit_may_be_lifted() -> None:
    poser = build(*drive("odom", "base_link", seconds=[0, 60]), MOUNT, max_pose_gap_s=None)
    (posed,), dropped = attach(poser, batch_at([30]))
    assert not dropped
    assert posed.position.tolist() == [[30.5, 0, 0]]


def test_the_gap_limit_is_for_what_moves_and_not_for_its_correction() -> None:
    """Corrections every 5 s, odometry at 10 Hz: no scan of a minute lacks a pose."""
    corrections = [at(t, "map", "odom", Pose.planar(0, t / 100, 0)) for t in range(0, 61, 5)]
    tenths = [t / 10 for t in range(601)]
    poser = build(*corrections, *drive("odom", "laser", seconds=tenths))
    (posed,), dropped = attach(poser, batch_at(tenths))
    assert (len(posed.position), dropped) == (601, {})
    # Between two corrections the small one grows as the time does.
    np.testing.assert_allclose(posed.position[125], [12.5, 0.125, 0], atol=1e-12)


def test_odometry_that_stops_between_two_corrections_is_a_gap() -> None:
    corrections = [at(t, "map", "odom", Pose.planar(0, t / 100, 0)) for t in (0, 5, 10)]
    poser = build(*corrections, *drive("odom", "laser", seconds=(0, 1, 2, 6, 7, 8, 9, 10)))
    _, dropped = attach(poser, batch_at([1.5, 2.0, 3.0, 5.9, 6.0]))
    assert dropped == {DropReason.GAP: 2}


@pytest.mark.parametrize("gap", [2.0, None])
def test_clouds_in_a_turn_between_key_frames_are_left_out_but_no_scans(gap: float | None) -> None:
    poses = [at(t, "map", "laser", turned(20 * t)) for t in (0, 1, 2)]
    scans = batch_at([0, 0.5, 1, 1.5, 2])
    clouds = tuple(Cloud(0, "laser", np.zeros((1, 3), np.float32)) for _ in scans.stamp_ns)
    (posed,), dropped = attach(build(*poses, max_pose_gap_s=gap), replace(scans, clouds=clouds))
    assert dropped == ({} if gap is None else {DropReason.TURN: 2})
    assert len(posed.position) == (5 if gap is None else 3)
    assert not attach(build(*poses), scans)[1]


def test_how_long_a_sensor_of_clouds_stands_still() -> None:
    """It stands until 10 s, drives 1 m a second until 12 s, and stands until 60 s.

    It is looked for 2, 8 and 32 s before, and as long after.
    """
    track = [at(t, "map", "laser", Pose.planar(min(max(t - 10, 0), 2), 0, 0)) for t in range(61)]
    scans = batch_at([1, 5, 9, 11, 13, 14, 25, 48])
    clouds = tuple(Cloud(0, "laser", np.zeros((1, 3), np.float32)) for _ in scans.stamp_ns)
    poser = build(*track)
    (posed,), _ = attach(poser, replace(scans, clouds=clouds))
    assert poser.measure_standstills(posed).tolist() == [8, 2 + 2, 8, 0, 32, 2 + 32, 8 + 32, 32 + 8]


def test_the_time_offset_is_added_to_the_stamps_of_scans() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, time_offset_s=-100.25)
    (posed,), _ = attach(poser, batch_at([104.25]))
    assert posed.position.tolist() == [[4.5, 0, 0]]
    assert posed.batch.stamp_ns.tolist() == [104.25 * SECOND]


def test_pose_samples_may_be_dated_by_the_recorder() -> None:
    late = [sample._replace(stamp_ns=0) for sample in drive("odom", "base_link")]
    (posed,), _ = attach(build(*late, MOUNT, stamps=Stamps.RECORD), batch_at([4]))
    assert posed.position.tolist() == [[4.5, 0, 0]]


def test_the_order_of_the_log_changes_nothing() -> None:
    log = [*drive("odom", "base_link"), MOUNT, *drive("map", "odom")]
    (forward,), _ = attach(build(*log), batch_at([3.3]))
    (backward,), _ = attach(build(*log[::-1]), batch_at([3.3]))
    assert forward.position.tolist() == backward.position.tolist()


@pytest.mark.parametrize("stamp_ns", [-(2**63), 2**63 - 1])
def test_stamps_that_are_damage_harm_nothing(stamp_ns: int) -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, time_offset_s=-1e9)
    batch = replace(batch_at([0]), stamp_ns=np.array([stamp_ns]))
    posed, dropped = attach(poser, batch)
    assert posed == []
    assert sum(dropped.values()) == 1


def test_scans_without_transform_are_counted_alone_and_beside_others() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT)
    assert "'bumper'" in str(poser.find_chains(["bumper"])["bumper"])
    assert attach(poser, batch_at([1], "bumper")) == ([], {DropReason.NO_TRANSFORM: 1})
    assert len(attach(poser, batch_at([1]))[0]) == 1
    assert attach(poser, batch_at([1, 2], "bumper")) == ([], {DropReason.NO_TRANSFORM: 2})


# Poses that the log states beside its scans


def stated(*poses: Pose) -> ScanBatch:
    return replace(batch_at([0] * len(poses)), pose=np.array(poses, np.float64))


def test_scans_that_lack_the_pose_beside_them_are_counted() -> None:
    posed, dropped = attach(build(), stated(Pose.planar(1, 0, 0)), batch_at([1, 2]))
    assert [len(each.position) for each in posed] == [1]
    assert dropped == {DropReason.NO_TRANSFORM: 2}


def test_a_stated_pose_is_used_as_it_is() -> None:
    (posed,), dropped = attach(build(), stated(turned(90, x=1, y=2), turned(0)))
    assert not dropped
    assert posed.position.tolist() == [[1, 2, 0], [0, 0, 0]]
    np.testing.assert_allclose(yaw_of(posed.rotation), [math.pi / 2, 0])


def test_a_stated_pose_that_is_not_finite_is_left_out() -> None:
    bad = Pose.planar(math.nan, 0, 0), Pose(0, 0, 0, 0, 0, 0, 0), turned(0, x=math.inf)
    (posed,), dropped = attach(build(), stated(turned(0, x=5), *bad))
    assert dropped == {DropReason.UNUSABLE: 3}
    assert posed.position.tolist() == [[5, 0, 0]]
    assert posed.batch.pose is not None
    assert len(posed.batch.pose) == 1


def test_a_stated_pose_is_the_bodys_where_the_sensors_is_given() -> None:
    (posed,), _ = attach(build(sensor_pose=turned(90, x=2)), stated(turned(90, x=1)))
    np.testing.assert_allclose(posed.position, [[1, 2, 0]], atol=1e-12)
    np.testing.assert_allclose(np.abs(yaw_of(posed.rotation)), [math.pi])


def test_what_means_nothing_to_stated_poses_is_told() -> None:
    poser = build(map_frame="m", deskew=Deskew.ON)
    attach(poser, stated(turned(0)))
    told = "does nothing: the poses stand beside the scans"
    assert poser.notes == [f"`map_frame` {told}", f"`deskew` {told}"]


def test_whose_stated_poses_are_is_said_once_and_only_where_it_was_decided() -> None:
    mounted, plain = build(sensor_pose=turned(90, x=2)), build()
    for poser in (mounted, mounted, plain):
        attach(poser, stated(turned(90, x=1)))
    (note,) = mounted.notes
    assert "taken as the robot's, with the laser at `sensor_pose`" in note
    assert plain.notes == []


def test_a_chosen_trajectory_goes_before_stated_poses() -> None:
    log = drive("map", "", "/slam")
    (posed,), _ = attach(build(*log, poses="/slam"), stated(turned(0, x=5)))
    assert posed.position.tolist() == [[0, 0, 0]]


# De-skewing

TURN = math.radians(180)
"""A fast turn: radians a second."""


def spin(seconds: float = 2.0, rate_hz: int = 50) -> list[PoseSample]:
    """A robot that turns on the spot while the floor under it carries it along x."""
    return [
        at(i / rate_hz, "odom", "laser", Pose.planar(i / rate_hz, 0, TURN * i / rate_hz))
        for i in range(round(seconds * rate_hz) + 1)
    ]


def see_wall(start_s: float, beams: int, time_increment: float) -> ScanBatch:
    """Measure the wall x = 5 from the spin, each beam at its own moment, over +-40 degrees."""
    bearings = np.linspace(-0.7, 0.7, beams)
    moments = start_s + np.arange(beams) * time_increment
    heading = TURN * moments + bearings
    ranges = (5 - moments) / np.cos(heading)
    step = float(bearings[1] - bearings[0])
    stamps = np.array([round(start_s * SECOND)], np.int64)
    row = ranges[None].astype(np.float32)
    times = stamps, stamps
    return ScanBatch("laser", -0.7, step, 0.0, 50.0, *times, row, np.array([time_increment]))


def find_wall(poser: Poser, batch: ScanBatch) -> Float64:
    """(B,) x of the ends of the beams in the map."""
    (posed,), _ = attach(poser, batch)
    ends: Float64 = interpret(posed, ReturnOptions())[0].end[0, :, 0]
    return ends


@pytest.mark.parametrize("beams", [2, 33, 34, 360])
def test_deskewing_straightens_a_wall_seen_in_a_fast_turn(beams: int) -> None:
    batch = see_wall(0.011, beams, 0.1 / beams)
    skewed = find_wall(build(*spin(), deskew=Deskew.OFF), batch)
    straight = find_wall(build(*spin(), deskew=Deskew.ON), batch)
    assert np.ptp(skewed) > 0.5
    assert np.ptp(straight) < 0.002
    assert abs(straight.mean() - 5) < 0.001


@pytest.mark.parametrize(
    ("rate_hz", "time_increment", "expected"),
    [
        (50, 0.001, True),
        (50, 0.0, False),  # nothing is known about the beams
        (2, 0.001, False),  # half a second between poses shows nothing of a tenth
        (2, 0.006, True),  # as long a scan as the poses are apart
        (50, 0.1, False),  # ten seconds a turn: milliseconds, written as seconds
        (50, -0.001, True),
        (50, math.nan, False),
        (50, math.inf, False),
    ],
)
def test_auto_deskews_where_the_log_allows(
    rate_hz: int, time_increment: float, expected: bool
) -> None:
    poser = build(*spin(4, rate_hz), deskew=Deskew.AUTO)
    (posed,), _ = attach(poser, batch_at([2.0], beams=100, time_increment=time_increment))
    assert (posed.position.ndim == 3) is expected
    assert ("de-skewed: each beam of 'laser' has a pose of its own" in poser.notes) is expected


def test_where_nothing_can_be_deskewed_it_is_said() -> None:
    asked, unasked = build(*spin(), deskew=Deskew.ON), build(*spin(), deskew=Deskew.AUTO)
    for poser in (asked, unasked):
        attach(poser, batch_at([0.5], beams=10))
    (note,) = asked.notes
    assert "scans of 'laser' that state no believable time between beams" in note
    assert unasked.notes == []


def test_the_mount_of_one_laser_of_two_is_given_by_a_transform() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT)
    poser.find_chains(["bumper", "laser"])  # in any order
    (note,) = poser.notes
    assert "no transform to the laser's frame 'bumper'" in note
    assert note.endswith("`static_transforms=base_link,bumper,X,Y,Z,ROLL,PITCH,YAW`")
    alone = build(*drive("odom", "base_link"), MOUNT).find_chains(["bumper"])
    assert "`sensor_pose=(x,y,yaw)`" in str(alone["bumper"])


@pytest.mark.parametrize("deskew", [Deskew.ON, Deskew.AUTO])
def test_scans_of_one_batch_are_deskewed_each_by_its_own_time(deskew: Deskew) -> None:
    poser = build(*spin(), deskew=deskew)
    batch = batch_at([0.5, 1.0, 1.0, 1.95, 3.0], beams=101)
    increments = np.array([0.001, math.nan, 0.002, 0.001, 0.0])
    (turning, still), dropped = attach(poser, replace(batch, time_increment=increments))
    assert dropped == {DropReason.AFTER: 2}
    assert still.batch.stamp_ns.tolist() == [SECOND]
    assert still.position.tolist() == [[1, 0, 0]]
    np.testing.assert_allclose(turning.position[:, -1, 0], [0.6, 1.2])
    assert turning.batch.time_increment.tolist() == [0.001, 0.002]
    if deskew is Deskew.ON:
        assert poser.notes[0].startswith("scans of 'laser' that state no believable time")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("time_increment", [math.inf, -math.inf, math.nan, 1e308])
def test_a_single_beam_takes_no_time_whatever_is_stated(time_increment: float) -> None:
    batch = batch_at([0.5], beams=1, time_increment=time_increment)
    (posed,), _ = attach(build(*spin(), deskew=Deskew.ON), batch)
    assert posed.position.shape == (1, 3)


def test_a_scan_that_ends_after_the_last_pose_is_left_out_when_deskewed() -> None:
    late = batch_at([0.5, 1.95], beams=101, time_increment=0.001)
    (posed,), dropped = attach(build(*spin(), deskew=Deskew.ON), late)
    assert posed.batch.stamp_ns.tolist() == [SECOND // 2]
    assert dropped == {DropReason.AFTER: 1}
    assert attach(build(*spin(), deskew=Deskew.OFF), late)[1] == {}


# Coverage


def test_coverage_tells_gaps_and_jumps() -> None:
    log = [*drive("odom", "base_link", seconds=[1, 2, 5]), MOUNT, *drive("map", "", "/pose")]
    mount, odom, pose = list_coverage(build(*log).sources)
    assert (mount.parent, mount.child) == ("base_link", "laser")
    assert (mount.static, mount.moves) == (True, False)
    assert (odom.source, odom.samples) == (Source.TF, 3)
    assert (odom.largest_gap_s, odom.largest_step_m) == (3.0, 3.0)
    assert (odom.start_ns, odom.end_ns) == (SECOND, 5 * SECOND)
    assert (pose.topic, pose.child, pose.source) == ("/pose", "", Source.ODOMETRY)


def test_a_note_appears_once_however_many_batches_there_are() -> None:
    poser = build(*drive("odom", "base_link", "/wheels"), MOUNT)
    for second in range(3):
        attach(poser, batch_at([second]))
    assert poser.notes == ["tf does not give odom -> base_link: taken from /wheels"]


NOWHERE = [Pose.planar(math.nan, 0, 0), Pose.planar(0, 2e8, 0), Pose(0, 0, 0, 0, 0, 0, 0)]


@pytest.mark.parametrize("pose", NOWHERE)
def test_a_pose_that_is_nowhere_is_refused(pose: Pose) -> None:
    fixed = (bolted("base", "laser", pose),)
    for given in ({"sensor_pose": pose}, {"transform": pose}, {"static_transforms": fixed}):
        with pytest.raises(UsageError, match="nothing can be at "):
            PosingOptions(**given)
