"""How a sensor sits and where it goes: tilts, lasers that stand, poses that jump or leap."""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from occmap.inspection import inspect
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import Concern, DropReason, PosingOptions, Stamps
from occmap.posing.attach import Poser
from occmap.posing.course import find_strides
from occmap.posing.tracks import Track
from occmap.report.results import Build
from occmap.scans import stream
from occmap.scans.stream import stack
from occmap.types import Cloud, Pose, PoseSample, Scan, ScanBatch
from tests.posing.scenes import SECOND, at, attach, attach_twice, batch_at, bolted, drive, turned
from tests.posing.scenes import build as make_poser
from tests.samples import Planar, find_real, write_csv


def mount(roll: float = 0.0, pitch: float = 0.0, height: float = 0.3, nod: int = 1) -> Poser:
    """A drive whose laser is turned on the robot, in degrees; it nods at each scan by -1."""
    sensor = []
    for s in range(41):
        angles = math.radians(roll), math.radians(pitch) * nod**s, 0.0
        sensor += [at(s, "base_link", "laser", Pose.from_xyzrpy((0, 0, height), angles))]
    poser = make_poser(*drive("odom", "base_link", seconds=range(41)), *sensor)
    for first in (0, 10, 20, 30):
        attach(poser, batch_at(range(first, first + 10)))
    return poser


def tell(poser: Poser, max_range: float = math.inf) -> list[str]:
    return [concern.text for _, concern in poser.list_concerns(0, max_range)]


@pytest.mark.parametrize(
    ("poser", "found"),
    [
        # 0.3 m / sin 5 deg = 3.44 m
        (mount(pitch=5), ["by 5.0 deg (5.0 deg down ahead)", "0.3 m over", "`max_range=3.4`"]),
        (mount(roll=4, height=0.5), ["by 4.0 deg", "0.5 m over", "7.1 m away", "`max_range=7.1`"]),
        (mount(pitch=5, height=0.0), ["by 5.0 deg (5.0 deg down ahead): it meets the floor"]),
        (mount(pitch=45), ["by 45.0 deg (45.0 deg down ahead)", "the floor or the ceiling, not"]),
        (mount(pitch=-60), ["(60.0 deg up ahead): the laser looks at the floor or the ceiling"]),
        (mount(pitch=5, nod=-1), ["nods by 10 deg and meets the floor: map clouds of its scans"]),
        (mount(roll=90), ["by 90.0 deg: the laser looks at the floor or the ceiling"]),
    ],
)
def test_a_tilted_laser_is_told(poser: Poser, found: list[str]) -> None:
    (told,) = tell(poser)
    for part in found:
        assert part in told


@pytest.mark.parametrize("poser", [mount(), mount(pitch=2.5), mount(roll=180), mount(pitch=178)])
def test_a_level_laser_is_not_told(poser: Poser) -> None:
    assert tell(poser) == []


def test_a_range_that_ends_before_the_floor_is_right() -> None:
    poser = mount(pitch=5)
    assert tell(poser, max_range=3.4) == []
    ((_, concern),) = poser.list_concerns(0, 10.0)
    assert concern.remedy == {"max_range": "3.4"}


def stand(*poses: Pose, scans: int = 41) -> list[str]:
    """What is noted of a robot at these poses, one a second in turn."""
    samples = [at(t, "odom", "base_link", poses[t % len(poses)]) for t in range(41)]
    sensor = bolted("base_link", "laser", Pose.planar(0.2, 0, 0))
    poser = make_poser(*samples, sensor)
    batch = batch_at(range(scans))
    attach(poser, batch)
    assert not list(poser.list_concerns(0, math.inf))
    return [note for note in poser.notes if "never moves" in note]


def test_a_laser_that_stands_is_noted() -> None:
    (note,) = stand(Pose.planar(1, 2, 3), Pose.planar(1.01, 2, 3.001))
    assert "the laser never moves, so the map is what it sees from one place" in note
    assert note.endswith("its poses are missing: give them with `poses`")


@pytest.mark.parametrize(
    "elsewhere", [Pose.planar(1.1, 2, 3), Pose.planar(1, 1.9, 3), Pose.planar(1, 2, 3.1)]
)
def test_a_laser_that_moves_or_turns_does_not_stand(elsewhere: Pose) -> None:
    assert stand(Pose.planar(1, 2, 3), elsewhere) == []


def test_a_few_scans_are_no_drive() -> None:
    assert stand(Pose.planar(1, 2, 3), Pose.planar(1, 2, 3), scans=19) == []


SECONDS = range(101)
MOUNT = bolted("base_link", "laser", Pose.planar(0, 0, 0))
NOWHERE = Pose.planar(0, 0, 0)


def make_mounted(*samples: PoseSample, **options: object) -> Poser:
    return make_poser(*samples, MOUNT, **options)


def correct(pose: Callable[[int], Pose], **options: object) -> Poser:
    """The drive along x in `odom`, with a correction every second."""
    corrections = [at(second, "map", "odom", pose(second)) for second in SECONDS]
    return make_mounted(*drive("odom", "base_link", seconds=SECONDS), *corrections, **options)


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
    (concern,) = watch(make_mounted(*driven, *late))
    assert "odom -> base_link were set back by 100 s" in concern.text
    assert concern.remedy == {"stamps": "record"}
    assert not watch(make_mounted(*driven, *late, stamps=Stamps.RECORD))


@pytest.mark.parametrize(
    ("late_s", "frame", "told"), [(0, "laser", 1), (0.01, "laser", 0), (0, "rear", 0)]
)
def test_scans_that_were_filtered_and_those_that_were_not_are_told(
    late_s: float, frame: str, told: int
) -> None:
    rear = bolted("base_link", "rear", NOWHERE)
    poser = make_mounted(*drive("odom", "base_link", seconds=SECONDS), rear)
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
    poser = make_mounted(*drive("odom", "base_link", seconds=SECONDS), rear)
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
    told = [each.text.partition(":")[0] for each in watch(make_mounted(*one, *other))]
    assert told == ["odom -> base_link jumps to and fro at 99% of its 202 samples"][: int(is_told)]


def test_poses_that_are_mixed_are_not_taken_for_places_in_millimetres() -> None:
    fast, one = ([at(s, "odom", "base_link", turned(0, x * s)) for s in SECONDS] for x in (200, 0))
    other = [at(s + 0.4, "odom", "base_link", turned(0, 200)) for s in SECONDS]
    for samples, doubts in ((fast, 1), ([*one, *other], 0)):
        poser = make_mounted(*samples)
        watch(poser)
        assert len(list(poser.suspect_places({"": 5.0}))) == doubts


def test_what_is_not_mixed_is_kept_where_the_recorders_clock_was_set_back_with_the_others() -> None:
    """By 20.4 s, at 70 s: of 200 scans 99 come before what was recorded twice, and 60 behind."""
    driven = [at(s, "odom", "base_link", turned(0, 0.3 * s)) for s in range(70)]
    again = [at(s - 20.4, "odom", "base_link", turned(0, 0.3 * s)) for s in range(70, 121)]
    (concern,) = watch(make_mounted(*driven, *again))
    assert concern.remedy == {"end_s": "49"}
    assert not watch(make_mounted(*driven, *again), last_s=49)
    (concern,) = watch(make_mounted(*driven, *again), first_s=30)
    assert concern.remedy == {"start_s": "69.6"}


def test_odometry_that_is_carried_elsewhere_is_told() -> None:
    driven = [at(s, "odom", "base_link", turned(0, 0.1 * s + 4 * (s >= 30))) for s in SECONDS]
    (concern,) = watch(make_mounted(*driven))
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


DRIVE: list[Planar] = [(second / 2, 0.0, 0.0) for second in range(40)]
LEAP = "further from their neighbours than `max_speed` allows"


def flip(value: float, bit: int) -> float:
    (number,) = struct.unpack("<Q", struct.pack("<d", value))
    (flipped,) = struct.unpack("<d", struct.pack("<Q", number ^ 1 << bit))
    return float(flipped)


def map_drive(folder: Path, poses: list[Planar], **posing: float) -> Build:
    log = write_csv(folder / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    return build([log], BuildOptions(posing=PosingOptions(**posing)))  # type: ignore[arg-type]


@pytest.mark.parametrize("scan", [0, 1, 7, 38, 39])
@pytest.mark.parametrize("x", [1e3, -2e6, flip(3.5, 57), flip(19.5, 56)])
def test_a_scan_that_leaps_is_left_out_and_told(tmp_path: Path, scan: int, x: float) -> None:
    report = map_drive(tmp_path, [*DRIVE[:scan], (x, 0.0, 0.0), *DRIVE[scan + 1 :]]).report
    assert report.scans.dropped == {LEAP: 1}
    assert (report.scans.read, report.scans.used) == (40, 39)
    (note,) = (note for note in report.notes if "`max_speed=inf`" in note)
    assert f"the scan at {scan}.000 s lies" in note
    assert report.map.columns < 600


def test_all_is_kept_on_request(tmp_path: Path) -> None:
    poses = [*DRIVE[:7], (1e3, 0.0, 0.0), *DRIVE[8:]]
    report = map_drive(tmp_path, poses, max_speed=math.inf).report
    assert not report.scans.dropped
    assert report.map.columns > 1000 / 0.05
    (note,) = (note for note in report.notes if "max_speed" in note)
    assert "the scan at 7.000 s lies 997 m from its neighbour, 1 s away: the map reaches" in note


def test_a_transform_that_leaps_takes_its_scans_along() -> None:
    """Scans twice as often as transforms: the ones halfway there and back are wrong, too."""
    samples = drive("odom", "base_link", seconds=range(41))
    samples[20] = at(20, "odom", "base_link", Pose.planar(4000.0, 0.0, 0.0))
    poser = make_poser(*samples, bolted("base_link", "laser", Pose.planar(0, 0, 0)))
    seconds = [half / 2 for half in range(81)]
    (posed,), dropped = attach_twice(poser, batch_at(seconds))
    assert {str(reason): scans for reason, scans in dropped.items()} == {LEAP: 3}
    assert posed.position[:, 0].tolist() == [s for s in seconds if not 19 < s < 21]


def state(xs: Sequence[float], seconds: Sequence[float] | None = None) -> ScanBatch:
    """Scans whose poses stand beside them, one a second unless told otherwise."""
    batch = batch_at(range(len(xs)) if seconds is None else seconds)
    return replace(batch, pose=np.array([Pose.planar(x, 0.0, 0.0) for x in xs]))


HERE = [0.5 * second for second in range(20)]
THERE = [x + 300 for x in HERE]


def leap_by_turns(times: int) -> ScanBatch:
    """Scans of a drive, so many within five seconds that all leap, and the drive again."""
    seconds = [*range(20), *(20 + 5 * leap / times for leap in range(times)), *range(26, 46)]
    return state([*HERE, *(5e3 * (1 + leap % 2) for leap in range(times)), *HERE], seconds)


WAYS = {
    "carried": (state([*HERE, *THERE]), []),
    "one scan": (state([*HERE[:9], 4e3, *HERE[10:]]), [9]),
    "near each other": (state([*HERE[:7], 4e3, 3.5, -2e3, *HERE[10:]]), [7, 8, 9]),
    "from afar and back": (state([*HERE[:9], 2e3, 4e3, 2e3, *HERE[12:]]), [9, 10, 11]),
    "a while elsewhere": (state([*HERE[:6], *THERE[6:12], *HERE[12:]]), [*range(6, 12)]),
    "long elsewhere": (state([*HERE, *THERE, *(x + 20 for x in HERE)]), []),
    "a first and a last one": (state([9e3, *HERE[1:-1], 9e3]), [0, 19]),
    "the second and the last but one": (state([0, 9e3, *HERE[2:-2], 9e3, 9.5]), [1, 18]),
    "beside a pause": (state([*HERE, 9e3, *HERE], [*range(20), *range(99, 120)]), [20]),
    "back after ten seconds": (state([*HERE, 9e3, *HERE], [*range(21), *range(29, 49)]), [20]),
    "back a little later": (
        state([*HERE, 9e3, *HERE], [*range(21), *(29.001 + s for s in range(20))]),
        [],
    ),
    "too far in ten seconds": (
        state([*HERE, 9e3, *(x + 600 for x in HERE)], [*range(21), *range(29, 49)]),
        [],
    ),
    "last after ten seconds": (state([*HERE, 9e3], [*range(20), 29]), [20]),
    "last a little later": (state([*HERE, 9e3], [*range(20), 29.001]), []),
    "two by turns": (state([x for pair in zip(HERE, THERE, strict=True) for x in pair]), []),
    "back after a thousand rows": (leap_by_turns(999), [*range(20, 1019)]),
    "back a row later": (leap_by_turns(1000), []),
    "a car": (state([30.0 * second for second in range(40)]), []),
    "a train": (state([80.0 * second for second in range(40)]), []),
    "three scans": (state([0, 1e3, 0]), []),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("order", [1, -1])
def test_which_scans_are_left_out(way: str, order: int) -> None:
    """In whatever order they come: their stamps tell the order."""
    whole, outliers = WAYS[way]
    poser, rows = make_poser(), np.arange(len(whole.stamp_ns))
    posed, dropped = attach_twice(
        poser, *(whole.take(rows[at : at + 3]) for at in rows[::3][::order])
    )
    stamps = np.concatenate([each.batch.stamp_ns for each in posed])
    assert np.flatnonzero(~np.isin(whole.stamp_ns, stamps)).tolist() == outliers
    assert sum(dropped.values()) == len(outliers)
    assert len(poser.notes) == (1 if outliers else 0)


def test_lasers_are_judged_one_by_one() -> None:
    """Two on one topic, 300 m apart; the scans of one of them change their geometry meanwhile."""
    lasers = ("here", 0.0, [7, 8]), ("there", 300.0, [3])
    scan = partial(Scan, angle_min=0.0, angle_increment=0.1, range_min=0.0, range_max=10.0)
    scans = []
    for second in range(20):
        for frame, x, leaps in lasers:
            pose = Pose.planar(4e3 if second in leaps else x + second / 2, 0.0, 0.0)
            ranges = np.ones(3 + second % 2, np.float32)
            scans.append(scan(second * SECOND, frame, ranges=ranges, pose=pose, topic="/scan"))
    poser = make_poser()
    _, dropped = attach_twice(poser, *stack(scans, Stamps.HEADER))
    assert dropped == {LEAP: 3}
    here, there = poser.notes
    assert here.startswith("/scan: the scan at 7.000 s lies 3,997 m from its neighbour, 1 s away")
    assert "2 scans left out" in here
    assert "the scan at 3.000 s" in there


@pytest.mark.parametrize(
    "selection", [Selection(), Selection(stride=3), Selection(start_s=4.0, end_s=31.0)]
)
def test_jobs_and_batches_leave_out_the_same_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, selection: Selection
) -> None:
    poses = [*DRIVE[:14], *((x + 900, y, yaw) for x, y, yaw in DRIVE[14:18]), *DRIVE[18:]]
    log = write_csv(tmp_path / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    reports = []
    for beams, jobs in ((1, 1), (1 << 18, 2)):
        monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
        report = build([log], BuildOptions(selection=selection, jobs=jobs)).report
        reports.append(replace(report, seconds={}))
    assert reports[0] == reports[1]
    assert reports[0].scans.dropped[LEAP] == (1 if selection.stride == 3 else 4)
    assert sum(reports[0].scans.dropped.values()) + reports[0].scans.used == 40


def test_check_sees_the_map_that_build_makes(tmp_path: Path) -> None:
    made = map_drive(tmp_path, [*DRIVE[:7], (1e5, 0.0, 0.0), *DRIVE[8:]])
    seen = inspect([tmp_path / "log.csv"], BuildOptions())
    (topic,) = seen.logs[0].scans
    assert topic.poses.dropped == {LEAP: 1}
    assert seen.map is not None
    assert abs(seen.map.columns - made.report.map.columns) <= 2


@pytest.mark.parametrize("name", ["carmen/intel-corrected.log.gz", "ros1/test_turtlebot.bag"])
def test_no_scan_of_a_real_log_leaps(name: str) -> None:
    report = build([find_real(name)], BuildOptions(resolution=0.2)).report
    assert LEAP not in report.scans.dropped
