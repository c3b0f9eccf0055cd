"""Which poses a scan gets, told by where its laser ends up."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.errors import PoseError
from occmap.posing.attach import Poser
from occmap.types import Pose, PoseSample
from tests.posing.scenes import at, bolted, build, drive, positions, turned, yaw_of

AHEAD = Pose.planar(0.5, 0, 0)
MOUNT = bolted("base_link", "laser", AHEAD)
TF = [*drive("odom", "base_link"), MOUNT]
IN_MAP = [*TF, bolted("map", "odom", turned(0, y=7))]
MOVED = bolted("base_link", "laser", turned(0, y=3))
MAST = [bolted("base_link", "mast", turned(0, y=1)), bolted("mast", "laser", AHEAD)]
HULLS = [*drive("odom", "hull"), *drive("odom", "mast")]
MOCAP = [at(t, "mocap", "", turned(0, y=t), "/mocap/pose") for t in range(11)]
FUSED = [at(t, "odom", "base_link", turned(0, y=t), "/fused") for t in range(11)]
LAGGING = [at(t, "odom", "base_link", turned(0, x=-t), "/wheels") for t in range(100)]
ABOVE = bolted("map", "odom", turned(0))
LOOP = [*TF, bolted("laser", "odom", turned(0)), bolted("odom", "camera", turned(0))]
NAMELESS = drive("odom", "", "/odom")
PLACES: dict[str, tuple[list[PoseSample], dict[str, Any], list[float], str]] = {
    "map before odom": (IN_MAP, {}, [4.5, 7, 0], "map"),
    "odom without a map": ([*TF, bolted("world", "odom", turned(0, y=7))], {}, [4.5, 0, 0], "odom"),
    "the root without both": ([*drive("earth", "base_link"), MOUNT], {}, [4.5, 0, 0], "earth"),
    "a chosen map": (IN_MAP, {"map_frame": "odom"}, [4.5, 0, 0], "odom"),
    "leading slashes": ([*drive("/odom", "/base_link"), MOUNT], {}, [4.5, 0, 0], "odom"),
    "a given mount": (drive("odom", "base_link"), {"sensor_pose": AHEAD}, [4.5, 0, 0], "odom"),
    "before that of the log": (TF, {"sensor_pose": turned(0, x=-1)}, [3, 0, 0], "odom"),
    "on a named base": (HULLS, {"sensor_pose": AHEAD, "base_frame": "mast"}, [4.5, 0, 0], "odom"),
    "a given transform": (
        drive("odom", "base_link"),
        {"static_transforms": (MOVED,)},
        [4, 3, 0],
        "odom",
    ),
    "before one of the log": (TF, {"static_transforms": (MOVED,)}, [4, 3, 0], "odom"),
    "the last static one": (
        [*TF, MOUNT._replace(stamp_ns=1, pose=turned(0, y=2)), MOUNT],
        {},
        [4, 2, 0],
        "odom",
    ),
    "odometry": ([*drive("odom", "base_link", "/wheels"), MOUNT], {}, [4.5, 0, 0], "odom"),
    "tf before odometry": ([*LAGGING, *TF], {}, [4.5, 0, 0], "odom"),
    "poses of a still tree": ([*drive("mocap", "", "/pose"), MOUNT], {}, [4.5, 0, 0], "mocap"),
    "poses without a tree": (drive("mocap", "", "/pose"), {}, [4, 0, 0], "mocap"),
    "nameless odometry": (NAMELESS, {"sensor_pose": AHEAD}, [4.5, 0, 0], "odom"),
    "of a base in tf": ([*NAMELESS, MOUNT], {}, [4.5, 0, 0], "odom"),
    "of another base": ([*NAMELESS, bolted("torso", "laser", AHEAD)], {}, [4.5, 0, 0], "odom"),
    "bolted to the map": ([bolted("map", "laser", turned(0, x=3))], {}, [3, 0, 0], "map"),
    "a chosen topic": ([*TF, *MOCAP], {"poses": "/mocap/pose"}, [0.5, 4, 0], "mocap"),
    "chosen odometry": (
        [*TF, *drive("map", "odom"), *FUSED],
        {"poses": "fused"},
        [0.5, 4, 0],
        "odom",
    ),
    "in a chosen map": (
        [*TF, *drive("map", "odom"), *FUSED],
        {"poses": "/fused", "map_frame": "map"},
        [4.5, 4, 0],
        "map",
    ),
    "of an unconnected body": (
        [*drive("odom", "base_footprint", "/odom"), MOUNT],
        {"poses": "/odom", "base_frame": "base_link"},
        [4.5, 0, 0],
        "odom",
    ),
    "a frame above": (TF, {"static_transforms": (ABOVE,)}, [4.5, 0, 0], "map"),
    "two parents": ([*TF, bolted("tower", "laser", turned(0)), ABOVE], {}, [4.5, 0, 0], "map"),
    "a loop": (LOOP, {}, [0, 0, 0], "odom"),
    "a mount sent again": ([*TF, MOUNT._replace(record_ns=5)], {}, [4.5, 0, 0], "odom"),
    "a mount on /tf, too": (
        [*TF, *(at(t, "base_link", "laser", AHEAD) for t in range(3))],
        {},
        [4.5, 0, 0],
        "odom",
    ),
    "and moves there": (
        [*TF, *(at(t, "base_link", "laser", turned(0, y=t)) for t in range(11))],
        {},
        [4, 4, 0],
        "odom",
    ),
}
TAKEN = "poses from {}, taken as those of '{}'"
SHORTEST = "the shortest way counts"
NOTES = {
    "before that of the log": ["the given sensor pose replaces the log's of 'laser'"],
    "before one of the log": ["the given transform base_link -> laser replaces the log's"],
    "the last static one": ["/tf_static changes base_link -> laser: the last pose counts"],
    "odometry": ["tf does not give odom -> base_link: taken from /wheels"],
    "nameless odometry": ["tf does not give odom -> base_link: taken from /odom"],
    "poses of a still tree": [TAKEN.format("/pose", "base_link")],
    "poses without a tree": [
        f"{TAKEN.format('/pose', 'laser')}, the laser itself: give `sensor_pose=(x,y,yaw)` if they "
        "are the robot's"
    ],
    "of a base in tf": [TAKEN.format("/odom", "base_link")],
    "of another base": [TAKEN.format("/odom", "torso")],
    "a chosen topic": [TAKEN.format("/mocap/pose", "base_link")],
    "chosen odometry": [TAKEN.format("/fused", "base_link")],
    "in a chosen map": [TAKEN.format("/fused", "base_link")],
    "of an unconnected body": [TAKEN.format("/odom", "base_link")],
    "two parents": [f"frames that have several parents: laser (base_link, tower); {SHORTEST}"],
    "a loop": [
        f"the transforms laser -> odom -> base_link -> laser form a loop: {SHORTEST}",
        "'laser' never moves in 'odom', though other frames do",
    ],
    "and moves there": ["/tf, /tf_static differ on base_link -> laser: /tf counts"],
}
"""What is said of how the poses of these were found; of the others nothing"""


def place(poser: Poser, second: float = 4, frame: str = "laser") -> list[float]:
    """X, y, z of the sensor at a moment, for what drives at a metre a second."""
    return [round(float(value), 9) for value in positions(poser, [second], frame)[0]]


@pytest.mark.parametrize("case", PLACES)
def test_where_a_laser_ends_up_in_which_map_and_what_is_said_of_it(case: str) -> None:
    samples, options, expected, fixed = PLACES[case]
    poser = build(*samples, **options)
    assert place(poser) == expected
    assert poser.fixed == fixed
    assert poser.notes == NOTES.get(case, [])


REFUSALS: dict[str, tuple[list[PoseSample], dict[str, Any], list[str]]] = {
    "an unknown map": (
        IN_MAP,
        {"map_frame": "moon"},
        ["no frame 'moon' in the log (known: base_link, laser, map, odom)", "`map_frame`"],
    ),
    "no mount": (
        drive("odom", "base_link"),
        {},
        [
            "no transform to the laser's frame 'laser' (known: base_link, odom)",
            "give its mount on base_link: `sensor_pose=(x,y,yaw)`",
        ],
    ),
    "of nameless odometry": (
        NAMELESS,
        {},
        ["give its mount on base_link: `sensor_pose=(x,y,yaw)`"],
    ),
    "many frames": (
        [*drive("odom", "base_link"), *(bolted("base_link", f"w{i:02}", AHEAD) for i in range(20))],
        {},
        ["w03 and 16 more)"],
    ),
    "an unclear base": (
        HULLS,
        {"sensor_pose": AHEAD},
        ["is not clear (known: hull, mast, odom)", "name it: `base_frame=hull`"],
    ),
    "an unknown base": (
        HULLS,
        {"sensor_pose": AHEAD, "base_frame": "moon"},
        ["`base_frame` takes hull, mast, odom"],
    ),
    "no poses": ([], {}, ["the scans have no poses", "give a trajectory: `poses=FILE`"]),
    "goals and plans": (
        [
            sample
            for topic in ("/goal_pose", "/initialpose", "/move_base/global/plan")
            for sample in drive("map", "", topic, range(50))
        ],
        {},
        ["the scans have no poses"],
    ),
    "nothing moves": ([MOUNT], {}, ["tf only says where 'laser' sits on", "`poses=FILE`"]),
    "what moves is elsewhere": (
        [*drive("odom", "base_footprint"), MOUNT],
        {},
        [
            "not connected to what moves: base_footprint",
            "`static_transforms=base_footprint,base_link,0,0,0,0,0,0`",
        ],
    ),
    "a chosen body that is not connected": (
        [*drive("odom", "base_footprint", "/odom"), MOUNT],
        {"poses": "/odom"},
        ["no transform from 'base_footprint' to 'laser'"],
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_why_a_laser_has_no_place(case: str) -> None:
    samples, options, texts = REFUSALS[case]
    poser = build(*samples, **options)
    error = str(poser.find_chains(["laser"])["laser"])
    assert poser.fixed is None
    assert all(text in error for text in texts), error


def test_each_robot_maps_in_its_own_map() -> None:
    log = []
    for robot in ("robot1", "robot2"):
        log += drive(f"{robot}/odom", f"{robot}/base_link")
        log += [
            bolted("world", f"{robot}/map", turned(0, x=100)),
            bolted(f"{robot}/map", f"{robot}/odom", turned(0, y=float(robot[-1]))),
            bolted(f"{robot}/base_link", f"{robot}/laser", AHEAD),
        ]
    poser = build(*log)
    assert place(poser, frame="robot2/laser") == [4.5, 2, 0]
    assert poser.fixed == "robot2/map"
    assert place(poser, frame="robot1/laser") == [4.5, 1, 0]  # in the map that is chosen already


@pytest.mark.parametrize("base", ["base_footprint", "r2d2/base_link", "hull"])
def test_the_base_is_found_under_other_names(base: str) -> None:
    wheel = [at(t, base, "wheel", turned(90 * t)) for t in range(11)]
    poser = build(*drive("odom", base), *wheel, sensor_pose=AHEAD)
    assert place(poser) == [4.5, 0, 0]


def test_a_given_transform_that_closes_a_loop_is_told() -> None:
    looped = build(*TF, static_transforms=(bolted("laser", "odom", turned(0)),))
    told = "the given transform laser -> odom closes a loop: odom is above laser already"
    assert told in looped.notes


def test_a_long_chain_of_frames_costs_no_time() -> None:
    chain = [bolted(f"link{i}", f"link{i + 1}", turned(0)) for i in range(10_000)]
    assert build(*TF, *chain).notes == []


def test_two_lasers_ride_on_one_topic_of_poses() -> None:
    rear = bolted("base_link", "rear", turned(180))
    poser = build(*drive("mocap", "", "/pose"), MOUNT, rear)
    poser.find_chains(["laser", "rear"])
    assert place(poser, frame="rear") == [4, 0, 0]
    assert place(poser, frame="laser") == [4.5, 0, 0]


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        ({"/a": 5, "/b": 6}, "/b"),
        ({"/b": 5, "/a": 5}, "/a"),
        ({"/goal_pose": 50, "/plane_pose": 5}, "/plane_pose"),
    ],
)
def test_the_topic_with_most_poses_is_taken_and_then_the_first_by_name(
    topics: dict[str, int], chosen: str
) -> None:
    log = [s for name, count in topics.items() for s in drive("map", "", name, range(count))]
    body = build(*log).sources.unnamed_body
    assert body is not None
    assert body.topic == chosen


def test_lasers_that_map_in_different_frames_are_not_mixed() -> None:
    poser = build(*TF, *drive("odom2", "hull"))
    poser.find_chains(["laser"])
    poser.find_chains(["hull"])
    assert poser.chains["hull"] is None
    assert any("no transform from 'odom' to 'hull'" in note for note in poser.notes)


@pytest.mark.parametrize(
    ("samples", "options", "expected", "fixed"),
    [
        ([*drive("map", "odom"), *TF], {}, [4.5, 20, 0], "map"),
        ([bolted("hull", "base_link", turned(0, y=1)), MOUNT], {}, [4.5, 21, 0], "map"),
        ([], {}, [4, 20, 0], "map"),
        ([], {"sensor_pose": AHEAD}, [4.5, 20, 0], "map"),
        ([*drive("odom", "base_link"), *MAST], {"base_frame": "mast"}, [4.5, 20, 0], "map"),
        ([], {"map_frame": "hall"}, [4, 20, 0], "hall"),
    ],
    ids=["above the laser", "a still tree", "the laser's", "its body's", "a named base's", "hall"],
)
def test_a_trajectory_file_carries_the_laser(
    tmp_path: Path,
    samples: list[PoseSample],
    options: dict[str, Any],
    expected: list[float],
    fixed: str,
) -> None:
    path = tmp_path / "slam.tum"
    path.write_text("".join(f"{t} {t} 20 0 0 0 0 1\n" for t in range(11)))
    poser = build(*samples, poses=str(path), **options)
    assert place(poser) == expected
    assert poser.fixed == fixed
    assert f"poses from {path}, taken as those of" in poser.notes[0]


def test_a_trajectory_that_does_not_exist_lists_those_that_do() -> None:
    with pytest.raises(PoseError) as caught:
        build(*drive("odom", "base_link", "/wheels"), *drive("map", "", "/pose"), poses="/slam")
    assert str(caught.value) == (
        "/slam: neither a file nor a topic with poses; topics with poses: /pose, /wheels"
    )


def test_a_trajectory_file_without_a_usable_pose_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lost.tum"
    path.write_text("1 nan nan nan nan nan nan nan\n")
    with pytest.raises(PoseError, match="holds no usable pose"):
        build(poses=str(path))


def test_yaw_of_the_mount_turns_the_sensor() -> None:
    poser = build(*drive("odom", "base_link"), sensor_pose=turned(180))
    poser.find_chains(["laser"])
    chain = poser.chains["laser"]
    assert chain is not None
    rotation = chain.at(np.array([4 * 10**9], np.int64)).rotation
    assert math.isclose(abs(float(yaw_of(rotation)[0])), math.pi)
    assert chain.frames == ("odom", "base_link", "laser")


def test_of_many_static_transforms_that_change_a_few_are_named() -> None:
    old = [bolted("base_link", f"bumper{number}", turned(0)) for number in range(21)]
    new = [edge._replace(record_ns=5, pose=turned(0, y=2)) for edge in old]
    named = ", ".join(f"base_link -> bumper{number}" for number in (0, 1, 10))  # by name
    told = f"/tf_static changes {named} and 18 more: the last pose counts"
    assert build(*TF, *old, *new).notes == [told]
