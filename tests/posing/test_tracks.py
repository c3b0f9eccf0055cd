import math

import numpy as np
import pytest

from occmap.posing.tracks import Track, TrackBuilder
from occmap.types import Pose

HERE = Pose(1, 2, 3, 0, 0, 0, 1)


Sample = tuple[int, int, Pose]
"""A stamp, when it was recorded (ns), and a pose"""


def sample(stamp_ns: int, pose: Pose = HERE, record_ns: int = 0) -> Sample:
    return stamp_ns, record_ns, pose


def build(*samples: Sample) -> tuple[Track | None, int]:
    """Build a track of samples that come one by one, and of all at once."""
    single, whole = TrackBuilder(), TrackBuilder()
    for one in samples:
        single.add(*one)
    stamp_ns, record_ns, poses = zip(*samples, strict=True)
    whole.add(np.array(stamp_ns), np.array(record_ns), np.array(poses))
    track, as_batch = single.build(), whole.build()
    assert whole.unusable == single.unusable
    assert (as_batch is None) == (track is None)
    if track is not None and as_batch is not None:
        for name in ("stamp_ns", "position", "quaternion"):
            np.testing.assert_array_equal(getattr(as_batch, name), getattr(track, name))
    return track, single.unusable


def build_all(*samples: Sample) -> Track:
    """Build a track of samples of which none is left out."""
    track, unusable = build(*samples)
    assert track is not None
    assert unusable == 0
    return track


def stamps_of(track: Track | None) -> list[int]:
    assert track is not None
    stamps: list[int] = track.stamp_ns.tolist()
    return stamps


def test_samples_are_sorted_by_stamp() -> None:
    assert stamps_of(build_all(sample(30), sample(10), sample(20))) == [10, 20, 30]


@pytest.mark.parametrize(("reverse", "record_ns"), [(False, 101), (True, 101), (False, 100)])
def test_of_one_stamp_the_sample_recorded_last_stays(reverse: bool, record_ns: int) -> None:
    """Or the last in the log, of those that were recorded at once."""
    first = sample(10, HERE, record_ns=100)
    second = sample(10, HERE._replace(x=5), record_ns=record_ns)
    track = build_all(*((second, first) if reverse else (first, second)))
    assert track.position.tolist() == [[5, 2, 3]]


def test_poses_without_a_stamp_are_left_out_where_others_have_one() -> None:
    moved = HERE._replace(x=5)
    track, unusable = build(sample(0), sample(0, moved, record_ns=9), sample(20))
    assert (stamps_of(track), unusable) == ([20], 2)
    assert stamps_of(build_all(sample(0), sample(0, moved), sample(20))) == [0, 20]  # coarse times
    assert stamps_of(build_all(sample(0), sample(0), sample(20))) == [0, 20]  # a simulator's zero
    assert stamps_of(build_all(sample(0), sample(0, moved))) == [0]  # a log without any


@pytest.mark.parametrize(
    ("times", "set_back_s"),
    [
        ([(10, 10), (11, 11), (4, 12), (5, 13)], 7),  # a simulation that begins anew
        ([(10, 10), (4, 12), (11, 11), (5, 13)], 7),  # however the log is sorted
        ([(10, 10), (9, 11), (11, 12)], 1),
        ([(1, 10), (2, 10), (1, 11), (2, 11), (3, 11)], 0),  # a path that grows
        ([(5, 5), (4, 4), (6, 6)], 0),  # a log that knows one time
    ],
)
def test_how_far_the_clock_of_a_sender_was_set_back(
    times: list[tuple[int, int]], set_back_s: float
) -> None:
    second = 10**9
    samples = [sample(stamp * second, record_ns=record * second) for stamp, record in times]
    assert build_all(*samples).set_back_s == set_back_s


@pytest.mark.parametrize(
    "pose",
    [
        HERE._replace(x=math.nan),
        HERE._replace(z=-math.inf),
        HERE._replace(qx=math.nan),
        HERE._replace(qw=0),
        HERE._replace(qw=1e200),
        HERE._replace(y=1e308),
    ],
)
def test_a_pose_that_is_none_is_left_out_and_counted(pose: Pose) -> None:
    track, unusable = build(sample(10, pose), sample(20))
    assert stamps_of(track) == [20]
    assert unusable == 1
    assert build(sample(10, pose)) == (None, 1)


def test_a_pose_a_light_hour_away_is_the_last_that_is_one() -> None:
    far = HERE._replace(x=1e12)
    track, unusable = build(sample(0, far), sample(1, far._replace(x=-1.0001e12)))
    assert (stamps_of(track), unusable) == ([0], 1)


@pytest.mark.parametrize("stamp_ns", [2**62, -(2**62)])
def test_a_stamp_of_2116_is_the_last_that_is_one(stamp_ns: int) -> None:
    assert stamps_of(build_all(sample(stamp_ns, record_ns=stamp_ns))) == [stamp_ns]


@pytest.mark.parametrize("stamp_ns", [2**62 + 1, -(2**63), 2**63 - 1])
def test_a_stamp_that_is_damage_is_left_out(stamp_ns: int) -> None:
    assert build(sample(stamp_ns)) == (None, 1)
    assert build(sample(5, record_ns=stamp_ns)) == (None, 1)


def test_quaternions_get_unit_length() -> None:
    track = build_all(sample(0, HERE._replace(qz=3, qw=4)))
    np.testing.assert_allclose(track.quaternion, [[0, 0, 0.6, 0.8]])


def test_what_is_sent_again_and_again_does_not_move() -> None:
    assert not build_all(*(sample(t) for t in range(5))).moves
    for pose, moves in (({"y": 2.01}, True), ({"qz": 0.01}, True), ({"qw": -1}, False)):
        assert build_all(sample(0), sample(1, HERE._replace(**pose))).moves is moves


def test_steps_and_intervals_lie_between_samples() -> None:
    away = Pose.planar(4, 6, math.pi / 2)._replace(z=3)
    track = build_all(sample(0), sample(2 * 10**9, away))
    assert track.interval_s.tolist() == [2]
    assert track.step_m.tolist() == [5]
    np.testing.assert_allclose(track.step_rad, [math.pi / 2])
