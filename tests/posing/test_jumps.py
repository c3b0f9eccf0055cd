"""Corrections of odometry that take the robot elsewhere: found, timed, and mended by options."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.posing import Concern, DropReason, Stamps
from occmap.posing.attach import Poser
from occmap.posing.course import find_strides
from occmap.posing.tracks import Track
from occmap.types import Cloud, Pose, PoseSample
from tests.posing.scenes import SECOND, at, attach, attach_twice, batch_at, bolted, drive, turned
from tests.posing.scenes import build as make_poser
from tests.samples import write_csv

SECONDS = range(101)
MOUNT = bolted("base_link", "laser", Pose.planar(0, 0, 0))
NOWHERE = Pose.planar(0, 0, 0)


def build(*samples: PoseSample, **options: object) -> Poser:
    return make_poser(*samples, MOUNT, **options)


def correct(pose: Callable[[int], Pose], **options: object) -> Poser:
    """The drive along x in `odom`, with a correction every second."""
    corrections = [at(second, "map", "odom", pose(second)) for second in SECONDS]
    return build(*drive("odom", "base_link", seconds=SECONDS), *corrections, **options)


def watch(poser: Poser, first_s: float = 0.0, last_s: float = 100.0) -> list[Concern]:
    """What there is to say when scans between two times were attached."""
    stamps = [half / 2 for half in range(201) if first_s <= half / 2 <= last_s]
    for some in np.array_split(np.array(stamps), 7):
        attach(poser, batch_at(some.tolist()))
    return [concern for _, concern in poser.list_concerns(0, math.inf)]


AWAY = math.hypot(11 + 12 * math.cos(math.radians(100)) - 12, 12 * math.sin(math.radians(100)))
"""How far a robot at (12, 0) gets that is turned about the origin by 100 degrees, and then moved"""
JUMPS: dict[str, tuple[Callable[[int], Pose], str, dict[str, str]]] = {
    "one": (lambda second: turned(100, 11.0) if second >= 12 else NOWHERE,
        f"by {AWAY:.3g} m and 100 deg 12.000 s after the first scan: ", {"start_s": "12"}),
    "two, and the longest part between them": (
        lambda second: turned(0, 0.0 if second < 20 else 5.0 if second < 90 else 50.0),
        "by 45 m and 0 deg 90.000 s after the first scan, the largest of 2 jumps: ",
        {"start_s": "20", "end_s": "90"},
    ),
    "a plateau": (lambda second: turned(5, 7.0, -3.0) if 60 <= second < 65 else NOWHERE,
        " 65.000 s after the first scan, the largest of 2 jumps: ", {"end_s": "60"}),
    "a single wrong one": (lambda second: turned(10) if second == 30 else NOWHERE,
        " 31.000 s after the first scan, the largest of 2 jumps: ", {"start_s": "31"}),
}  # fmt: skip


@pytest.mark.parametrize("case", JUMPS)
def test_a_correction_that_jumps_is_told_with_its_time_and_what_keeps_the_longest_part(
    case: str,
) -> None:
    pose, found, remedy = JUMPS[case]
    (concern,) = watch(correct(pose))
    assert concern.text.startswith("map -> odom jumps ")
    assert found in concern.text
    assert concern.remedy == remedy
    for option, value in remedy.items():
        assert f"`{option}={value}`" in concern.text


def test_a_plateau_whose_scans_are_left_out_is_no_jump() -> None:
    poser = correct(lambda second: turned(0, 300.0) if 60 <= second < 65 else NOWHERE)
    posed, dropped = attach_twice(poser, batch_at([half / 2 for half in range(201)]))
    assert dropped == {DropReason.LEAP: 10}
    assert sum(len(each.batch.stamp_ns) for each in posed) == 191
    assert not list(poser.list_concerns(0, math.inf))
    assert any("the scan at 60.000 s lies 30" in note for note in poser.notes)


@pytest.mark.parametrize(("first_s", "last_s"), [(12, 100), (0, 11.5)])
def test_a_jump_beside_the_scans_that_are_used_is_none(first_s: float, last_s: float) -> None:
    assert not watch(correct(JUMPS["one"][0]), first_s, last_s)


def test_the_options_are_by_the_clock_of_the_scans() -> None:
    poser = correct(JUMPS["one"][0], time_offset_s=2.0)
    attach(poser, batch_at(range(5, 90)))
    ((_, concern),) = poser.list_concerns(5 * SECOND, math.inf)
    # The jump at 12 s is at 10 s by the scans, 5 s after the first of them.
    assert concern.remedy == {"start_s": "5"}


def test_a_clock_that_was_set_back_is_told_in_place_of_the_jumps_that_it_makes() -> None:
    driven = [at(s, "odom", "base_link", turned(0, 0.1 * s)) for s in SECONDS]
    again = [at(s, "odom", "base_link", turned(0, -9 - 0.1 * s)) for s in range(40)]
    late = [each._replace(record_ns=each.stamp_ns + 101 * SECOND) for each in again]
    (concern,) = watch(build(*driven, *late))
    assert "odom -> base_link were set back by 100 s" in concern.text
    assert concern.remedy == {"stamps": "record"}
    assert not watch(build(*driven, *late, stamps=Stamps.RECORD))


@pytest.mark.parametrize(
    ("late_s", "frame", "told"), [(0, "laser", 1), (0.01, "laser", 0), (0, "rear", 0)]
)
def test_scans_that_were_filtered_and_those_that_were_not_are_told(
    late_s: float, frame: str, told: int
) -> None:
    rear = bolted("base_link", "rear", NOWHERE)
    poser = build(*drive("odom", "base_link", seconds=SECONDS), rear)
    raw, filtered = batch_at(range(50)), batch_at([s + late_s for s in range(50)], frame)
    attach(poser, replace(raw, topic="/raw"), replace(filtered, topic="/scan"))
    concerns = list(poser.list_concerns(0, math.inf))
    assert [topic for topic, _ in concerns] == ["/scan"] * told
    assert all("stamps of /raw" in concern.text for _, concern in concerns)


@pytest.mark.parametrize(("frame", "told"), [("odom", 1), ("rear", 0)])
def test_clouds_that_are_in_the_map_already_beside_those_they_are_made_of_are_told(
    frame: str, told: int
) -> None:
    """A second lidar may be triggered with the first."""
    rear = bolted("base_link", "rear", NOWHERE)
    poser = build(*drive("odom", "base_link", seconds=SECONDS), rear)
    points = tuple(Cloud(0, "", np.ones((1, 3), np.float32)) for _ in range(50))
    one, other = (batch_at(range(50), each) for each in (frame, "base_link"))
    attach(poser, *(replace(it, topic=it.frame, clouds=points) for it in (one, other)))
    concerns = list(poser.list_concerns(0, math.inf))
    assert sum("and both count" in concern.text for _, concern in concerns) == told


@pytest.mark.parametrize(("apart_m", "is_told"), [(0.11, True), (0.09, False)])
def test_a_transform_that_two_nodes_send_is_told(apart_m: float, is_told: bool) -> None:
    one = [at(s, "odom", "base_link", turned(0, 0.01 * s)) for s in SECONDS]
    other = [at(s + 0.4, "odom", "base_link", turned(0, 0.01 * s, apart_m)) for s in SECONDS]
    # Each sample but the first and the last lies between two of the other node.
    told = [each.text.partition(":")[0] for each in watch(build(*one, *other))]
    assert told == ["odom -> base_link jumps to and fro at 99% of its 202 samples"][: int(is_told)]


def test_poses_that_are_mixed_are_not_taken_for_places_in_millimetres() -> None:
    fast, one = ([at(s, "odom", "base_link", turned(0, x * s)) for s in SECONDS] for x in (200, 0))
    other = [at(s + 0.4, "odom", "base_link", turned(0, 200)) for s in SECONDS]
    for samples, doubts in ((fast, 1), ([*one, *other], 0)):
        poser = build(*samples)
        watch(poser)
        assert len(list(poser.suspect_places({"": 5.0}))) == doubts


def test_what_is_not_mixed_is_kept_where_the_recorders_clock_was_set_back_with_the_others() -> None:
    """By 20.4 s, at 70 s: of 200 scans 99 come before what was recorded twice, and 60 behind."""
    driven = [at(s, "odom", "base_link", turned(0, 0.3 * s)) for s in range(70)]
    again = [at(s - 20.4, "odom", "base_link", turned(0, 0.3 * s)) for s in range(70, 121)]
    (concern,) = watch(build(*driven, *again))
    assert concern.remedy == {"end_s": "49"}
    assert not watch(build(*driven, *again), last_s=49)
    (concern,) = watch(build(*driven, *again), first_s=30)
    assert concern.remedy == {"start_s": "69.6"}


def test_odometry_that_is_carried_elsewhere_is_told() -> None:
    driven = [at(s, "odom", "base_link", turned(0, 0.1 * s + 4 * (s >= 30))) for s in SECONDS]
    (concern,) = watch(build(*driven))
    # From 2.9 m to 7 m between the samples at 29 and 30 s.
    assert "odom -> base_link jumps by 4.1 m and 0 deg 30.000 s after the first" in concern.text
    assert "unless the robot did so" in concern.text
    assert concern.remedy == {"start_s": "30"}


@pytest.mark.parametrize(("every", "jumps"), [(1, 1), (4, 1), (20, 0)])
def test_poses_beside_the_scans_are_watched(tmp_path: Path, every: int, jumps: int) -> None:
    """A robot at 0.2 m a second, carried by 4 m: in 20 s it may have driven there."""
    poses = [(0.2 * every * scan + 4.0 * (scan >= 30), 0.0, 0.0) for scan in range(40)]
    log = write_csv(tmp_path / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1, every=every)
    warnings = inspect([log], BuildOptions()).warnings
    assert sum("the pose beside the scans jumps by" in text for text in warnings) == jumps


def drift(second: int) -> Pose:
    return Pose.planar(0.05 * second, 0, math.radians(0.2) * second)


def close_loop(second: int) -> Pose:
    return Pose.planar(0.8 * (second >= 50), 0, 0)


def swing(second: int) -> Pose:
    """A correction about a far origin: `odom` leaps, and the robot, which is there, does not."""
    angle = math.radians(4) * (second >= 50)
    return Pose.planar(50 - 50 * math.cos(angle), -50 * math.sin(angle), angle)


@pytest.mark.parametrize("pose", [lambda _: NOWHERE, drift, close_loop, swing])
def test_what_corrections_do_every_day_is_no_jump(pose: Callable[[int], Pose]) -> None:
    assert not watch(correct(pose))


def list_strides(usual: tuple[float, float], **others: tuple[float, float]) -> list[int]:
    """Drive 300 steps of so many metres and seconds along x, others where `at_N` says."""
    steps = np.array([others.get(f"at_{at}", usual) for at in range(300)])
    place, time = np.append(np.zeros((1, 2)), steps.cumsum(axis=0), axis=0).T
    position = np.stack([place, np.zeros(301), np.zeros(301)], axis=1)
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (301, 1))
    track = Track(np.rint(time * 1e9).astype(np.int64), position, quaternion)
    strides: list[int] = find_strides(track).tolist()
    return strides


CREEP = (0.2, 1.0)
"""At 0.2 m/s, steps are strides above 1 m and above 2.5 * 0.3 m/s"""
WALK = (1.0, 1.0)
"""At 1 m/s, steps are strides above 2 m, twice the usual, and above 2.5 * 1 m/s"""


@pytest.mark.parametrize(
    ("usual", "step", "is_stride"),
    [
        (CREEP, (0.99, 1.0), False),
        (CREEP, (1.01, 1.0), True),
        (CREEP, (1.2, 1.62), False),
        (CREEP, (1.2, 1.58), True),
        (CREEP, (8.0, 10.0), True),
        (CREEP, (8.5, 10.1), False),
        (WALK, (2.4, 1.0), False),
        (WALK, (2.6, 1.0), True),
        (WALK, (1.9, 0.5), False),
        (WALK, (2.1, 0.5), True),
    ],
)
def test_a_stride_is_long_and_fast(
    usual: tuple[float, float], step: tuple[float, float], is_stride: bool
) -> None:
    assert list_strides(usual, at_150=step) == ([150] if is_stride else [])


@pytest.mark.parametrize(
    ("at", "faster", "is_stride"),
    [
        (150, [140, 141, 142], False),
        (150, [139, 140, 141], True),
        (150, [158, 159, 160], False),
        (150, [159, 160, 161], True),
        (150, [149, 151], True),
        (150, [148, 149, 151], False),
        (150, [149, 151, 152], False),
        (1, [0], True),
        (3, [0, 1, 2], False),
        (297, [298, 299], True),
        (296, [297, 298, 299], False),
    ],
)
def test_a_stride_is_faster_than_the_third_fastest_of_ten_steps_to_either_side(
    at: int, faster: list[int], is_stride: bool
) -> None:
    """1.2 m/s is 2 times as fast as 0.6 m/s, and 6 times as fast as 0.2 m/s."""
    steps = {f"at_{other}": (0.6, 1.0) for other in faster}
    assert list_strides(CREEP, **steps, **{f"at_{at}": (1.2, 1.0)}) == ([at] if is_stride else [])
