"""Which poses a scan gets, told by where its laser ends up."""

import math
from pathlib import Path

import numpy as np
import pytest

from occmap.errors import LogError, PoseError
from occmap.posing.attach import Poser
from occmap.types import Pose, PoseSample
from tests.posing.scenes import at, bolted, build, drive, positions, turned, yaw_of

MOUNT = bolted("base_link", "laser", Pose.planar(0.5, 0, 0))
AHEAD = Pose.planar(0.5, 0, 0)


def place(poser: Poser, second: float = 4, frame: str = "laser") -> list[float]:
    """X, y, z of the sensor at a moment, for what drives at a metre a second."""
    return [round(float(value), 9) for value in positions(poser, [second], frame)[0]]


def refusal(poser: Poser, *frames: str) -> str:
    """Why no frame of a log has a chain, of the first one."""
    failures = poser.find_chains(frames or ["laser"])
    assert poser.fixed is None
    return str(next(iter(failures.values())))


# The fixed frame


def test_the_map_is_chosen_before_odom() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, bolted("map", "odom", turned(0, y=7)))
    assert place(poser) == [4.5, 7, 0]
    assert poser.fixed == "map"


def test_odom_is_chosen_where_there_is_no_map() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, bolted("world", "odom", turned(0, y=7)))
    assert place(poser) == [4.5, 0, 0]
    assert poser.fixed == "odom"


def test_the_root_is_chosen_where_there_is_neither() -> None:
    poser = build(*drive("earth", "base_link"), MOUNT)
    assert place(poser) == [4.5, 0, 0]
    assert poser.fixed == "earth"


def test_the_user_chooses_the_map_frame() -> None:
    log = [*drive("odom", "base_link"), MOUNT, bolted("map", "odom", turned(0, y=7))]
    poser = build(*log, map_frame="odom")
    assert place(poser) == [4.5, 0, 0]
    message = refusal(build(*log, map_frame="moon"))
    known = "no frame 'moon' in the log (known: base_link, laser, map, odom)"
    assert message == f"{known}; give one of these as `map_frame`, or leave it out"


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


def test_leading_slashes_mean_nothing() -> None:
    poser = build(*drive("/odom", "/base_link"), MOUNT)
    assert place(poser, frame="/laser") == [4.5, 0, 0]


# The mount


def test_a_missing_mount_is_named_with_the_flag_that_gives_it() -> None:
    assert refusal(build(*drive("odom", "base_link"))) == (
        "no transform to the laser's frame 'laser' (known: base_link, odom); "
        "give its mount on base_link: `sensor_pose=(x,y,yaw)`"
    )


def test_many_known_frames_are_not_all_listed() -> None:
    wheels = [bolted("base_link", f"wheel{i:02}", AHEAD) for i in range(20)]
    assert "wheel03 and 16 more)" in refusal(build(*drive("odom", "base_link"), *wheels))


def test_the_given_mount_hangs_on_base_link() -> None:
    poser = build(*drive("odom", "base_link"), sensor_pose=Pose.planar(1, 2, math.pi))
    assert place(poser) == [5, 2, 0]


def test_the_given_mount_goes_before_the_log() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, sensor_pose=turned(0, x=-1))
    assert place(poser) == [3, 0, 0]
    assert "the given sensor pose replaces the log's of 'laser'" in poser.notes


@pytest.mark.parametrize("base", ["base_footprint", "r2d2/base_link", "hull"])
def test_the_base_is_found_under_other_names(base: str) -> None:
    wheel = [at(t, base, "wheel", turned(90 * t)) for t in range(11)]
    poser = build(*drive("odom", base), *wheel, sensor_pose=AHEAD)
    assert place(poser) == [4.5, 0, 0]


def test_an_unclear_base_is_asked_for() -> None:
    log = [*drive("odom", "hull"), *drive("odom", "mast")]
    message = refusal(build(*log, sensor_pose=AHEAD))
    assert message == (
        "which frame the laser is mounted on is not clear (known: hull, mast, odom); "
        "name it: `base_frame=hull`"
    )
    assert place(build(*log, sensor_pose=AHEAD, base_frame="mast")) == [4.5, 0, 0]
    assert "`base_frame` takes hull, mast, odom" in refusal(
        build(*log, sensor_pose=AHEAD, base_frame="moon")
    )


def test_a_given_static_transform_fills_the_tree_or_goes_before_it() -> None:
    given = bolted("base_link", "laser", turned(0, y=3))
    assert place(build(*drive("odom", "base_link"), static_transforms=(given,))) == [4, 3, 0]
    poser = build(*drive("odom", "base_link"), MOUNT, static_transforms=(given,))
    assert place(poser) == [4, 3, 0]
    assert "the given transform base_link -> laser replaces the log's" in poser.notes


def test_a_given_transform_that_closes_a_loop_is_told() -> None:
    loop = bolted("laser", "odom", turned(0))
    looped = build(*drive("odom", "base_link"), MOUNT, static_transforms=(loop,))
    told = "the given transform laser -> odom closes a loop: odom is above laser already"
    assert told in looped.notes
    above = bolted("map", "odom", turned(0))
    assert build(*drive("odom", "base_link"), MOUNT, static_transforms=(above,)).notes == []


def test_of_a_static_transform_that_is_sent_again_the_last_holds() -> None:
    again = MOUNT._replace(stamp_ns=1, pose=turned(0, y=2))
    assert place(build(*drive("odom", "base_link"), again, MOUNT)) == [4, 2, 0]


# Transforms that contradict each other: maps are made all the same, and it is said


def notes_of(*samples: PoseSample) -> list[str]:
    return build(*drive("odom", "base_link"), MOUNT, *samples).notes


def test_a_frame_with_two_parents_is_told() -> None:
    assert notes_of(bolted("tower", "laser", turned(0)), bolted("map", "odom", turned(0))) == [
        "frames that have several parents: laser (base_link, tower); the shortest way counts"
    ]


def test_a_loop_is_told_once() -> None:
    loop = bolted("laser", "odom", turned(0)), bolted("odom", "camera", turned(0))
    assert notes_of(*loop) == [
        "the transforms laser -> odom -> base_link -> laser form a loop: the shortest way counts"
    ]


def test_a_long_chain_of_frames_costs_no_time() -> None:
    chain = [bolted(f"link{i}", f"link{i + 1}", turned(0)) for i in range(10_000)]
    assert notes_of(*chain) == []


@pytest.mark.parametrize("stamp_ns", [0, 1])
def test_a_static_transform_that_changes_is_told(stamp_ns: int) -> None:
    again = MOUNT._replace(stamp_ns=stamp_ns, record_ns=5)
    moved = again._replace(pose=turned(0, y=2))
    assert notes_of(moved) == ["/tf_static changes base_link -> laser: the last pose counts"]
    assert notes_of(again) == []


def test_a_transform_that_is_static_and_otherwise_is_told() -> None:
    sent = [at(t, "base_link", "laser", MOUNT.pose) for t in range(3)]
    assert notes_of(*sent) == []
    moved = [at(t, "base_link", "laser", turned(0, y=t)) for t in range(3)]
    assert notes_of(*moved) == ["/tf, /tf_static differ on base_link -> laser: /tf counts"]


# Odometry and topics of poses


def test_odometry_fills_what_tf_lacks_and_says_so() -> None:
    poser = build(*drive("odom", "base_link", "/wheels"), MOUNT)
    assert place(poser) == [4.5, 0, 0]
    assert poser.notes == ["tf does not give odom -> base_link: taken from /wheels"]


def test_tf_goes_before_odometry() -> None:
    lagging = [at(t, "odom", "base_link", turned(0, x=-t), "/wheels") for t in range(100)]
    poser = build(*lagging, *drive("odom", "base_link"), MOUNT)
    assert place(poser) == [4.5, 0, 0]
    assert not poser.notes


def test_a_topic_of_poses_carries_a_tree_that_does_not_move() -> None:
    poser = build(*drive("mocap", "", "/pose"), MOUNT)
    assert place(poser) == [4.5, 0, 0]
    assert poser.fixed == "mocap"
    assert poser.notes == ["poses from /pose, taken as those of 'base_link'"]


def test_two_lasers_ride_on_one_topic_of_poses() -> None:
    poser = build(*drive("mocap", "", "/pose"), MOUNT, bolted("base_link", "rear", turned(180)))
    poser.find_chains(["laser", "rear"])
    assert place(poser, frame="rear") == [4, 0, 0]
    assert place(poser, frame="laser") == [4.5, 0, 0]


def test_odometry_that_names_no_body_is_that_of_the_robot() -> None:
    nameless = drive("odom", "", "/odom")
    named = refusal(build(*drive("odom", "base_link", "/odom")))
    assert "give its mount on base_link: `sensor_pose=(x,y,yaw)`" in named
    assert refusal(build(*nameless)) == named
    assert place(build(*nameless, sensor_pose=Pose.planar(0.5, 0, 0))) == [4.5, 0, 0]
    assert place(build(*nameless, MOUNT)) == [4.5, 0, 0]  # whatever tf calls the body
    assert place(build(*nameless, bolted("torso", "laser", Pose.planar(0.5, 0, 0)))) == [4.5, 0, 0]


def test_poses_without_any_tree_are_those_of_the_laser() -> None:
    poser = build(*drive("mocap", "", "/pose"))
    assert place(poser) == [4, 0, 0]
    assert poser.notes == [
        "poses from /pose, taken as those of 'laser', the laser itself: give "
        "`sensor_pose=(x,y,yaw)` if they are the robot's"
    ]


def test_goals_and_plans_are_no_poses() -> None:
    goals = [
        sample
        for topic in ("/goal_pose", "/initialpose", "/move_base/global/plan")
        for sample in drive("map", "", topic, range(50))
    ]
    assert "the scans have no poses" in refusal(build(*goals))
    assert build(*goals, *drive("map", "", "/plane_pose")).sources.unnamed_body is not None


def test_the_topic_with_most_poses_is_taken_and_then_the_first_by_name() -> None:
    def chosen(*topics: tuple[str, int]) -> str:
        log = [s for name, count in topics for s in drive("map", "", name, range(count))]
        body = build(*log).sources.unnamed_body
        assert body is not None
        return body.topic

    assert chosen(("/a", 5), ("/b", 6)) == "/b"
    assert chosen(("/b", 5), ("/a", 5)) == "/a"


def test_a_log_without_any_poses_says_what_was_looked_for() -> None:
    assert refusal(build()) == (
        "the scans have no poses: looked for tf, odometry and topics of poses in the log; "
        "give a trajectory: `poses=FILE`"
    )


def test_a_tree_in_which_nothing_moves_is_refused() -> None:
    message = refusal(build(MOUNT))
    assert message.startswith("the scans have no poses: tf only says where 'laser' sits on")
    assert message.endswith("give a trajectory: `poses=FILE`")


def test_what_moves_elsewhere_is_named_with_what_would_join_it() -> None:
    message = refusal(build(*drive("odom", "base_footprint"), MOUNT))
    assert "not connected to what moves: base_footprint" in message
    assert "`static_transforms=base_footprint,base_link,0,0,0,0,0,0`" in message


def test_a_robot_bolted_to_its_map_stands_there_at_all_times() -> None:
    assert place(build(bolted("map", "laser", turned(0, x=3)))) == [3, 0, 0]


def test_of_two_lasers_the_one_without_transform_is_noted() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT)
    poser.find_chains(["laser", "bumper"])
    assert place(poser) == [4.5, 0, 0]
    assert any("no transform to the laser's frame 'bumper'" in note for note in poser.notes)


def test_lasers_that_map_in_different_frames_are_not_mixed() -> None:
    poser = build(*drive("odom", "base_link"), MOUNT, *drive("odom2", "hull"))
    poser.find_chains(["laser"])
    poser.find_chains(["hull"])
    assert poser.chains["hull"] is None
    assert any("no transform from 'odom' to 'hull'" in note for note in poser.notes)


# A chosen trajectory


def write_tum(tmp_path: Path) -> str:
    path = tmp_path / "slam.tum"
    path.write_text("".join(f"{t} {t} 20 0 0 0 0 1\n" for t in range(11)))
    return str(path)


def test_a_trajectory_file_replaces_what_moves_above_the_laser(tmp_path: Path) -> None:
    log = [*drive("map", "odom"), *drive("odom", "base_link"), MOUNT]
    poser = build(*log, poses=write_tum(tmp_path))
    assert place(poser) == [4.5, 20, 0]
    assert poser.fixed == "map"
    assert poser.notes == [f"poses from {tmp_path / 'slam.tum'}, taken as those of 'base_link'"]


def test_a_trajectory_file_carries_the_root_of_a_still_tree(tmp_path: Path) -> None:
    hull = bolted("hull", "base_link", turned(0, y=1))
    assert place(build(hull, MOUNT, poses=write_tum(tmp_path))) == [4.5, 21, 0]


def test_a_trajectory_file_alone_is_the_lasers_own_or_its_bodys(tmp_path: Path) -> None:
    file = write_tum(tmp_path)
    assert place(build(poses=file)) == [4, 20, 0]
    assert place(build(poses=file, sensor_pose=AHEAD)) == [4.5, 20, 0]
    assert "`sensor_pose=" in refusal(build(poses=file, base_frame="base_link"))


def test_a_trajectory_of_a_named_base_reaches_the_laser_from_there(tmp_path: Path) -> None:
    mast = bolted("base_link", "mast", turned(0, y=1))
    log = [*drive("odom", "base_link"), mast, bolted("mast", "laser", AHEAD)]
    poser = build(*log, poses=write_tum(tmp_path), base_frame="mast")
    assert place(poser) == [4.5, 20, 0]


def test_a_trajectory_file_may_name_its_map(tmp_path: Path) -> None:
    poser = build(poses=write_tum(tmp_path), map_frame="hall")
    assert place(poser) == [4, 20, 0]
    assert poser.fixed == "hall"


def test_a_chosen_topic_goes_before_tf() -> None:
    mocap = [at(t, "mocap", "", turned(0, y=t), "/mocap/pose") for t in range(11)]
    poser = build(*drive("odom", "base_link"), MOUNT, *mocap, poses="/mocap/pose")
    assert place(poser) == [0.5, 4, 0]
    assert poser.fixed == "mocap"


def test_a_chosen_odometry_topic_goes_before_tf() -> None:
    fused = [at(t, "odom", "base_link", turned(0, y=t), "/fused") for t in range(11)]
    log = [*drive("odom", "base_link"), *drive("map", "odom"), MOUNT, *fused]
    poser = build(*log, poses="fused")
    assert place(poser) == [0.5, 4, 0]
    assert poser.fixed == "odom"
    assert place(build(*log, poses="/fused", map_frame="map")) == [4.5, 4, 0]


def test_a_chosen_odometry_topic_of_an_unconnected_body_needs_the_base_named() -> None:
    log = [*drive("odom", "base_footprint", "/odom"), MOUNT]
    assert "no transform from 'base_footprint' to 'laser'" in refusal(build(*log, poses="/odom"))
    assert place(build(*log, poses="/odom", base_frame="base_link")) == [4.5, 0, 0]


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
    path.write_text("1 2\n")
    with pytest.raises(LogError, match=r"lost.tum:1: 2 values"):
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
    assert notes_of(*old, *new) == [f"/tf_static changes {named} and 18 more: the last pose counts"]
