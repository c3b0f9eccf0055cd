"""Which poses a scan gets, told by where its laser ends up."""

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from occmap.errors import PoseError
from occmap.posing import PosingOptions
from occmap.posing.attach import Poser
from occmap.posing.sources import gather
from occmap.types import Pose, PoseSample
from tests.posing.scenes import at, bolted, build, drive, positions, turned

AHEAD = Pose.planar(0.5, 0, 0)
MOUNT = bolted("base_link", "laser", AHEAD)
DRIVE = drive("odom", "base_link")
TF = [*DRIVE, MOUNT]
IN_MAP = [*TF, bolted("map", "odom", turned(0, y=7))]
MOVED = bolted("base_link", "laser", turned(0, y=3))
MAST = [bolted("base_link", "mast", turned(0, y=1)), bolted("mast", "laser", AHEAD)]
HULLS = [*drive("odom", "hull"), *drive("odom", "mast")]
MOCAP = [at(t, "mocap", "", turned(0, y=t), "/mocap/pose") for t in range(11)]
FUSED = [at(t, "odom", "base_link", turned(0, y=t), "/fused") for t in range(11)]
LAGGING = [at(t, "odom", "base_link", turned(0, x=-t), "/wheels") for t in range(100)]
ABOVE = bolted("map", "odom", turned(0))
LOOP = [*TF, bolted("laser", "odom", turned(0)), bolted("odom", "camera", turned(0))]
POSES = drive("mocap", "", "/pose")
UNCONNECTED = [*drive("odom", "base_footprint", "/odom"), MOUNT]
GIVE_MOUNT = "give its mount on base_link: `sensor_pose=(x,y,yaw)`"
NAMELESS = drive("odom", "", "/odom")


class Case(NamedTuple):
    """Poses and options, and what comes of them."""

    samples: list[PoseSample]
    expected: Any
    fixed: str
    options: dict[str, Any]


def case(samples: list[PoseSample], expected: Any, fixed: str = "odom", **options: Any) -> Case:
    return Case(samples, expected, fixed, options)


PLACES = {
    "map before odom": case(IN_MAP, [4.5, 7, 0], "map"),
    "odom without a map": case([*TF, bolted("world", "odom", turned(0, y=7))], [4.5, 0, 0]),
    "the root without both": case([*drive("earth", "base_link"), MOUNT], [4.5, 0, 0], "earth"),
    "a chosen map": case(IN_MAP, [4.5, 0, 0], map_frame="odom"),
    "leading slashes": case([*drive("/odom", "/base_link"), MOUNT], [4.5, 0, 0]),
    "a given mount": case(DRIVE, [4.5, 0, 0], sensor_pose=AHEAD),
    "before that of the log": case(TF, [3, 0, 0], sensor_pose=turned(0, x=-1)),
    "on a named base": case(HULLS, [4.5, 0, 0], sensor_pose=AHEAD, base_frame="mast"),
    "a given transform": case(DRIVE, [4, 3, 0], static_transforms=(MOVED,)),
    "before one of the log": case(TF, [4, 3, 0], static_transforms=(MOVED,)),
    "the last static one": case([*TF, MOUNT._replace(record_ns=1, pose=turned(0, y=2)), MOUNT],
        [4, 2, 0]),
    "odometry": case([*drive("odom", "base_link", "/wheels"), MOUNT], [4.5, 0, 0]),
    "odometry of what tf only mounts": case(
        [*drive("odom", "base_link", "/wheels"), bolted("footprint", "base_link", AHEAD), MOUNT],
        [4.5, 0, 0],
    ),
    "odometry of a mounted laser": case([*drive("camera_init", "laser", "/lio"), MOUNT], [4, 0, 0],
        "camera_init"),
    "tf before odometry": case([*LAGGING, *TF], [4.5, 0, 0]),
    "poses of a still tree": case([*POSES, MOUNT], [4.5, 0, 0], "mocap"),
    "poses without a tree": case(POSES, [4, 0, 0], "mocap"),
    "nameless odometry": case(NAMELESS, [4.5, 0, 0], sensor_pose=AHEAD),
    "of a base in tf": case([*NAMELESS, MOUNT], [4.5, 0, 0]),
    "a frame in itself": case([*drive("gps", "gps", "/gps"), MOUNT], [4.5, 0, 0], "gps"),
    "of another base": case([*NAMELESS, bolted("torso", "laser", AHEAD)], [4.5, 0, 0]),
    "bolted to the map": case([bolted("map", "laser", turned(0, x=3))], [3, 0, 0], "map"),
    "a chosen topic": case([*TF, *MOCAP], [0.5, 4, 0], "mocap", poses="/mocap/pose"),
    "chosen odometry": case([*TF, *drive("map", "odom"), *FUSED], [0.5, 4, 0], poses="fused"),
    "in a chosen map": case([*TF, *drive("map", "odom"), *FUSED], [4.5, 4, 0], "map",
        poses="/fused", map_frame="map"),
    "of an unconnected body": case(UNCONNECTED, [4.5, 0, 0], poses="/odom", base_frame="base_link"),
    "a frame above": case(TF, [4.5, 0, 0], "map", static_transforms=(ABOVE,)),
    "two parents": case([*TF, bolted("tower", "laser", turned(0)), ABOVE], [4.5, 0, 0], "map"),
    "a loop": case(LOOP, [0, 0, 0]),
    "a mount sent again": case([*TF, MOUNT._replace(record_ns=5)], [4.5, 0, 0]),
    "a mount on /tf, too": case([*TF, *(at(t, "base_link", "laser", AHEAD) for t in range(3))],
        [4.5, 0, 0]),
    "and moves there": case(
        [*TF, *(at(t, "base_link", "laser", turned(0, y=t)) for t in range(11))], [4, 4, 0]
    ),
}  # fmt: skip
TAKEN = "poses from {}, taken as those of '{}'"
OWN = ": give `base_frame=laser` if they are the sensor's own"
SHORTEST = "the shortest way counts"
NOTES = {
    "before that of the log": ["the given sensor pose replaces the log's of 'laser'"],
    "before one of the log": ["the given transform base_link -> laser replaces the log's"],
    "the last static one": ["/tf_static changes base_link -> laser: the last pose counts"],
    "odometry": ["tf does not give odom -> base_link: taken from /wheels"],
    "odometry of what tf only mounts": [
        f"frames that have several parents: base_link (footprint, odom); {SHORTEST}",
        "tf does not give odom -> base_link: taken from /wheels",
    ],
    "odometry of a mounted laser": [
        f"frames that have several parents: laser (base_link, camera_init); {SHORTEST}",
        "tf does not give camera_init -> laser: taken from /lio",
    ],
    "nameless odometry": ["tf does not give odom -> base_link: taken from /odom"],
    "poses of a still tree": [TAKEN.format("/pose", "base_link") + OWN],
    "poses without a tree": [
        f"{TAKEN.format('/pose', 'laser')}, the laser itself: give `sensor_pose=(x,y,yaw)` if they "
        "are the robot's"
    ],
    "of a base in tf": [TAKEN.format("/odom", "base_link") + OWN],
    "a frame in itself": [TAKEN.format("/gps", "base_link") + OWN],
    "of another base": [TAKEN.format("/odom", "torso") + OWN],
    "a chosen topic": [TAKEN.format("/mocap/pose", "base_link") + OWN],
    "chosen odometry": [TAKEN.format("/fused", "base_link")],
    "in a chosen map": [TAKEN.format("/fused", "base_link")],
    "of an unconnected body": [TAKEN.format("/odom", "base_link")],
    "two parents": [f"frames that have several parents: laser (base_link, tower); {SHORTEST}"],
    "and moves there": ["/tf, /tf_static differ on base_link -> laser: /tf counts"],
}
"""What is said of how the poses of these were found; of the others nothing"""


def place(poser: Poser, second: float = 4, frame: str = "laser") -> list[float]:
    """X, y, z of the sensor at a moment, for what drives at a metre a second."""
    return [round(float(value), 9) for value in positions(poser, [second], frame)[0]]


@pytest.mark.parametrize("name", PLACES)
def test_where_a_laser_ends_up_in_which_map_and_what_is_said_of_it(name: str) -> None:
    samples, expected, fixed, options = PLACES[name]
    poser = build(*samples, **options)
    assert place(poser) == expected
    assert poser.fixed == fixed
    assert poser.notes == NOTES.get(name, [])


REFUSALS = {
    "an unknown map": case(IN_MAP,
        ["no frame 'moon' in the log (known: base_link, laser, map, odom)", "`map_frame`"],
        map_frame="moon"),
    "no mount": case(DRIVE, ["the laser's frame 'laser' (known: base_link, odom)", GIVE_MOUNT]),
    "of nameless odometry": case(NAMELESS, [GIVE_MOUNT]),
    "frames of two robots": case(
        [*drive("map", "a/base_link"), *drive("map", "b/base_link"),
         bolted("a/base_link", "a/laser", AHEAD), bolted("b/base_link", "b/laser", AHEAD)],
        ["if it is 'a/laser': `static_transforms=a/laser,laser,0,0,0,0,0,0`, and `topics=TOPIC`"]),
    "many frames": case([*DRIVE, *(bolted("base_link", f"w{i:02}", AHEAD) for i in range(20))],
        ["w03 and 16 more)"]),
    "an unclear base": case(HULLS,
        ["is not clear (known: hull, mast, odom)", "name it: `base_frame=hull`"],
        sensor_pose=AHEAD),
    "an unknown base": case(HULLS, ["`base_frame` takes hull, mast, odom"], sensor_pose=AHEAD,
        base_frame="moon"),
    "no poses": case([], ["the scans have no poses", "give a trajectory: `poses=FILE`"]),
    "goals and plans": case(
        [sample for topic in ("/goal_pose", "/initialpose", "/move_base/global/plan")
         for sample in drive("map", "", topic, range(50))], ["the scans have no poses"]),
    "poses without times": case([MOUNT, *drive("map", "", "/path", [0])],
        ["/path", "are zero", "`stamps=record`"]),
    "such poses without a tree": case(drive("map", "", "/path", [0]), ["/path", "`stamps=record`"]),
    "nothing moves": case([MOUNT], ["tf only says where 'laser' sits on", "`poses=FILE`"]),
    "what moves is elsewhere": case([*drive("odom", "base_footprint"), MOUNT],
        ["moves: base_footprint", "`static_transforms=base_footprint,base_link,0,0,0,0,0,0`"]),
    "a chosen body that is not connected": case(UNCONNECTED,
        ["no transform from 'base_footprint' to 'laser'"], poses="/odom"),
}  # fmt: skip


@pytest.mark.parametrize("frame", ["map", "robot1/odom", "world", "camera_init"])
def test_what_is_in_a_frame_that_is_no_sensors_is_in_the_map_already(frame: str) -> None:
    """As clouds are that FAST-LIO and its kin register; `velodyne` may well be a sensor."""
    poser = build(*drive(frame, "body"))
    assert place(poser, frame=frame) == [0, 0, 0]
    assert poser.fixed == frame
    error = build(*drive("velodyne", "body")).find_chains(["velodyne"])["velodyne"]
    assert "not connected to what moves: body" in str(error)


@pytest.mark.parametrize("name", REFUSALS)
def test_why_a_laser_has_no_place(name: str) -> None:
    samples, texts, _, options = REFUSALS[name]
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


def drive_robot(space: str, y: float, lag: float = 0.0) -> list[PoseSample]:
    """A drive of a robot whose topics are in a namespace, and whose frames have the usual names."""
    moving = [
        at(t + lag, "odom", "base_link", turned(0, x=t, y=y), f"{space}/tf") for t in range(9)
    ]
    return [*moving, MOUNT._replace(topic=f"{space}/tf_static", pose=turned(0, y=y / 10))]


ROBOTS = [*drive_robot("/robot1", 1, lag=0.25), *drive_robot("/robot2", 2)]
SCAN, ONE, TWO = "/robot2/scan", "/robot1/tf, /robot1/tf_static", "/robot2/tf, /robot2/tf_static"
SPACES = {
    "its own": (ROBOTS, SCAN, [4, 2.2, 0], [ONE]),
    "one below it": (ROBOTS, "/robot2/front/scan", [4, 2.2, 0], [ONE]),
    "the only one": (drive_robot("/robot2", 2), "/scan", [4, 2.2, 0], []),
    "another one": (drive_robot("", 2), SCAN, [4, 2.2, 0], []),
    "the root": ([*ROBOTS[10:], *drive_robot("", 3)], "/scan", [4, 3.3, 0], [TWO]),
    "before the root": ([*drive("odom", "base_link"), *ROBOTS[10:]], SCAN, [4, 2.2, 0], ["/tf"]),
    "filled by the root": ([bolted("map", "odom", turned(0, x=100)), *ROBOTS], SCAN, [104, 2.2, 0],
        [ONE]),
    "sent again at the root": (
        [*ROBOTS[10:], *(each._replace(topic="/tf") for each in ROBOTS[11:18])], "/scan",
        [4, 2.2, 0], []),
    "beside one with the same mount": (
        [
            *ROBOTS[10:],
            *(at(t, "base_link", "hull", AHEAD, "/robot2/tf") for t in range(9)),
            *(at(t + 0.5, "base_link", "hull", AHEAD, "/arm/tf") for t in range(9)),
            bolted("hull", "gripper", AHEAD)._replace(topic="/arm/tf_static"),
        ], SCAN, [4, 2.2, 0], []),
    "beside one of other frames": ([*ROBOTS[10:], *drive("odom", "hull", "/robot1/tf")], SCAN,
        [4, 2.2, 0], []),
}  # fmt: skip


@pytest.mark.parametrize("name", SPACES)
def test_a_scan_goes_by_the_transforms_of_the_nearest_namespace(name: str) -> None:
    samples, topic, expected, left_out = SPACES[name]
    poser = Poser(gather(samples, PosingOptions(), topics=[topic]), PosingOptions())
    assert place(poser) == expected
    assert len(poser.notes) == len(left_out)
    assert all(f"transforms on {each} are left out: " in poser.notes[0] for each in left_out)


def test_scans_of_two_robots_are_not_mixed() -> None:
    scans = ["/robot1/scan", "/robot2/scan"]
    with pytest.raises(PoseError, match="one robot at a time, as with `topics=/robot1/scan`"):
        gather(ROBOTS, PosingOptions(), topics=scans)
    apart = [*drive("one", "laser", "/robot1/tf"), *drive("two", "other", "/robot2/tf")]
    assert gather(apart, PosingOptions(), topics=scans).notes == ()


@pytest.mark.parametrize("base", ["base_footprint", "r2d2/base_link", "hull"])
def test_the_base_is_found_under_other_names(base: str) -> None:
    wheel = [at(t, base, "wheel", turned(90 * t)) for t in range(11)]
    poser = build(*drive("odom", base), *wheel, sensor_pose=AHEAD)
    assert place(poser) == [4.5, 0, 0]


def test_a_long_chain_of_frames_costs_no_time() -> None:
    chain = [bolted(f"link{i}", f"link{i + 1}", turned(0)) for i in range(3000)]
    assert build(*TF, *chain).notes == []


def test_two_lasers_ride_on_one_topic_of_poses() -> None:
    rear = bolted("base_link", "rear", turned(180))
    poser = build(*drive("mocap", "", "/pose"), MOUNT, rear)
    poser.find_chains(["laser", "rear"])
    assert place(poser, frame="rear") == [4, 0, 0]
    assert place(poser, frame="laser") == [4.5, 0, 0]


def test_where_scans_begin_in_their_frame_says_nothing_of_how_that_moves() -> None:
    origin = [at(t, "laser", "laser:scan", AHEAD, "/scan") for t in range(11)]
    assert place(build(*POSES, *origin), frame="laser:scan") == [4.5, 0, 0]


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


@pytest.mark.parametrize(
    ("other", "frame", "joint"),
    [
        (drive("odom2", "hull"), "hull", "odom,odom2"),
        ([*drive("odom2", "hull"), bolted("hull", "mast", AHEAD)], "mast", "odom,odom2"),
        ([bolted("deck", "rear", AHEAD)], "rear", "base_link,deck"),
    ],
    ids=["another robot", "its laser", "a laser of this robot"],
)
def test_lasers_that_map_in_different_frames_are_not_mixed(
    other: list[PoseSample], frame: str, joint: str
) -> None:
    """A laser that drives hangs on what drives, or its map on the other map."""
    poser = build(*TF, *other)
    poser.find_chains(["laser"])
    poser.find_chains([frame])
    assert poser.chains[frame] is None
    (note,) = poser.notes
    assert f"no transform from 'odom' to {frame!r}" in note
    assert f"join them: `static_transforms={joint},X,Y,Z,ROLL,PITCH,YAW`" in note


CARRIED = {
    "above the laser": case([*drive("map", "odom"), *TF], [4.5, 20, 0], "map"),
    "a still tree": case([bolted("hull", "base_link", turned(0, y=1)), MOUNT], [4.5, 21, 0], "map"),
    "the laser's": case([], [4, 20, 0], "map"),
    "its body's": case([], [4.5, 20, 0], "map", sensor_pose=AHEAD),
    "a named base's": case([*DRIVE, *MAST], [4.5, 20, 0], "map", base_frame="mast"),
    "hall": case([], [4, 20, 0], "hall", map_frame="hall"),
}


@pytest.mark.parametrize("name", CARRIED)
def test_a_trajectory_file_carries_the_laser(tmp_path: Path, name: str) -> None:
    samples, expected, fixed, options = CARRIED[name]
    path = tmp_path / "slam.tum"
    path.write_text("".join(f"{t} {t} 20 0 0 0 0 1\n" for t in range(11)))
    poser = build(*samples, poses=str(path), **options)
    assert place(poser) == expected
    assert poser.fixed == fixed
    assert f"poses from {path}, taken as those of" in poser.notes[0]


def test_what_is_no_trajectory_is_named_and_those_that_there_are() -> None:
    with pytest.raises(PoseError, match=r"/robot2/tf: transforms are not .* leave out `poses`"):
        build(*ROBOTS, poses="/robot2/tf")
    with pytest.raises(PoseError, match=r"^/slam: no such file.*topics of poses: /pose, /wheels$"):
        build(*drive("odom", "base_link", "/wheels"), *drive("map", "", "/pose"), poses="/slam")


def test_a_trajectory_file_without_a_usable_pose_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lost.tum"
    path.write_text("1 nan nan nan nan nan nan nan\n")
    with pytest.raises(PoseError, match="holds no usable pose"):
        build(poses=str(path))


def test_of_many_static_transforms_that_change_a_few_are_named() -> None:
    old = [bolted("base_link", f"bumper{number}", turned(0)) for number in range(21)]
    new = [edge._replace(record_ns=5, pose=turned(0, y=2)) for edge in old]
    named = ", ".join(f"base_link -> bumper{number}" for number in (0, 1, 10))  # by name
    told = f"/tf_static changes {named} and 18 more: the last pose counts"
    assert build(*TF, *old, *new).notes == [told]
