"""Poses of another recording: of a robot's own topics, or what a SLAM exports after the drive."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin

from occmap import OccupancyMap, build_map, explain
from occmap.errors import PoseError
from occmap.posing import PosingOptions
from occmap.readers import open_log
from occmap.scans.logs import gather_poses
from occmap.store import open_saved
from tests.cli.runner import occmap, read_error
from tests.readers import ros
from tests.readers.ros import ROS1, ROS2, SECOND, Bag2, Written, drive, write_bag1, write_mcap

KINDS = {kind.rpartition("/")[2]: kind for kind in ros.POSED}


def make(kind: str, stamp_ns: int, x: float) -> Any:
    """A message that says where the robot was."""
    if kind == "TransformStamped":
        return ros.transforms(ROS2, stamp_ns, [("map", "trajectory_0", x)]).transforms[0]
    return ros.posed(ROS2, KINDS[kind], stamp_ns, ("map", "base", x))


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A drive that lacks the transform to its base."""
    monkeypatch.chdir(tmp_path)
    return write_bag1(Path("log.bag"), [each for each in drive(ROS1) if each.topic != "/tf"])


@pytest.fixture
def whole(log: Path) -> str:
    """The evidence of the same drive with its own poses."""
    return name_evidence(build_map(write_bag1(log.with_name("whole.bag"), drive(ROS1))))


def name_evidence(made: OccupancyMap) -> str:
    assert made.about is not None
    return made.about.evidence


STAMPS = [(k + 1) * SECOND + 5 for k in range(6)]


def write_poses(kind: str, topic: str) -> Path:
    messages = [Written(topic, at, make(kind, at, 0.5 * k)) for k, at in enumerate(STAMPS)]
    return write_mcap(Path("slam.mcap"), messages)


@pytest.mark.parametrize(
    ("kind", "topic"),
    [("Odometry", "/odom"), ("PoseStamped", "/pose"), ("TransformStamped", "trajectory_0")],
)
def test_a_drive_has_the_poses_of_another_recording(
    kind: str, topic: str, log: Path, whole: str
) -> None:
    write_poses(kind, topic)
    for poses in ("slam.mcap", f"slam.mcap:{topic}"):
        made = build_map(log, poses=poses)
        assert name_evidence(made) == whole
        note = f"log.bag: poses from slam.mcap:{topic}, taken as those of 'base'"
        assert any(each.startswith(note) for each in made.report.notes)


def test_a_path_that_is_sent_again_and_again_is_its_last(log: Path, whole: str) -> None:
    poses = [make("PoseStamped", at, 0.5 * k) for k, at in enumerate(STAMPS)]
    drifted = [make("PoseStamped", at, 0.5 * k + 9) for k, at in enumerate(STAMPS[:3])]
    kind = ROS2.types["nav_msgs/msg/Path"]
    messages = [
        Written("/path", STAMPS[2], kind(ros.header(ROS2, STAMPS[2], "map"), drifted)),
        Written("/path", STAMPS[5], kind(ros.header(ROS2, STAMPS[5], "map"), poses)),
        *(Written("/pose", at, make("PoseStamped", at, 0.0)) for at in STAMPS[:2]),
    ]
    write_mcap(Path("slam.mcap"), messages)
    assert name_evidence(build_map(log, poses="slam.mcap")) == whole  # the path has more poses


def test_the_frames_of_the_other_recording_do_not_mix_with_those_of_the_log(log: Path) -> None:
    others = [each for each in drive(ROS2) if each.topic == "/tf"]
    poses = [Written("/odom", at, make("Odometry", at, 0.5 * k)) for k, at in enumerate(STAMPS)]
    write_mcap(Path("slam.mcap"), [*others, *poses])
    made = build_map(log, poses="slam.mcap")
    assert made.report.scans.used == 6
    with pytest.raises(PoseError, match="have no poses"):
        build_map(log)


@pytest.mark.parametrize("topic", ["", ":/tf", ":tf", ":/tf_static"])
@pytest.mark.parametrize("lacking", ["none", "/tf", "/tf_static"])
def test_a_log_takes_the_transforms_of_a_recording_without_poses(
    topic: str, lacking: str, log: Path, whole: str
) -> None:
    """What both hold is no conflict, and a goal is no topic of poses."""
    messages, poses = drive(ROS1), f"other.bag{topic}"
    goal = ros.posed(ROS1, KINDS["PoseStamped"], SECOND, ("odom", "", 9.0))
    sent = [*(it for it in messages if "tf" in it.topic), Written("/goal", SECOND, goal)]
    write_bag1(Path("other.bag"), sent)
    log.unlink()
    write_bag1(log, [each for each in messages if each.topic != lacking])
    if lacking == "/tf" and "static" in poses:
        with pytest.raises(PoseError, match="have no poses"):
            build_map(log, poses=poses)
        return
    made = build_map(log, poses=poses)
    assert name_evidence(made) == whole
    taken = "other.bag:/tf, " * ("static" not in topic) + "other.bag:/tf_static"
    assert f"log.bag: transforms are taken from {taken}, too" in made.report.notes


def test_transforms_of_a_recording_replace_those_of_the_log(log: Path, whole: str) -> None:
    messages = [each for each in drive(ROS1) if each.topic == "/tf"]
    wrong = [Written("/tf", at, ros.transforms(ROS1, at, [("odom", "base", 9.0)])) for at in STAMPS]
    others = [each for each in drive(ROS1) if each.topic != "/tf"]
    log.unlink()
    write_bag1(log, [*others, *wrong])
    assert name_evidence(build_map(log)) != whole
    write_bag1(Path("other.bag"), messages)
    made = build_map(log, poses="other.bag")
    assert name_evidence(made) == whole
    assert not any("set back" in note for note in made.report.notes)


@pytest.mark.parametrize(
    ("names", "write", "version"),
    [
        (("day_0.bag", "day_1.bag.active"), write_bag1, ROS1),
        (("day_2026-01-02-03-04-00_0.bag", "day_2026-01-02-03-04-01_1.bag"), write_bag1, ROS1),
        (("day_0.mcap", "day_1.mcap"), write_mcap, ROS2),
    ],
)
def test_a_later_part_of_a_split_recording_takes_what_never_changes_from_the_first(
    names: Sequence[str], write: Callable[..., Path], version: Any, whole: str
) -> None:
    messages = drive(version)
    parts = [Path("day", name) for name in names]
    parts[0].parent.mkdir()
    for part, some in zip(parts, (messages[:7], messages[7:]), strict=True):
        write(part, some)
    suffix = parts[0].suffix
    write(Path("day", f"other_0{suffix}"), messages[1:])  # another recording, and a broken one
    Path("day", f"day_1999-01-01-00-00-00_0{suffix}").write_bytes(b"no bag")
    made = build_map(*parts)
    assert name_evidence(made) == whole
    assert f"{parts[1]}: transforms are taken from {parts[0]}:/tf_static, too" in made.report.notes
    assert name_evidence(build_map(*parts, poses=f"{parts[0]}:/tf_static")) == whole
    parts[0].write_bytes(b"no bag")
    with pytest.raises(PoseError, match="no transform to the laser's frame"):
        build_map(parts[1])


def test_one_pose_of_the_other_recording_is_no_trajectory(log: Path) -> None:
    start = Written("/initialpose", STAMPS[0], make("PoseStamped", STAMPS[0], 0.0))
    for poses in ("slam.mcap", "slam.mcap:/initialpose"):
        write_mcap(Path("slam.mcap"), [start])
        with pytest.raises(PoseError, match=r"holds no (such )?topic of poses; `poses` takes"):
            build_map(log, poses=poses)


@pytest.mark.parametrize(
    ("poses", "found"),
    [
        ("slam.mcap:/other", "topics of poses: slam.mcap:/odom"),
        ("slam.mcap:/tf", "slam.mcap:/tf: holds no such topic of poses"),
        ("none.bag", "none.bag: no such file, and no such topic"),
        ("none.bag:/odom", "none.bag:/odom: no such file, and no such topic"),
        ("broken.bag", "broken.bag: "),
    ],
)
def test_poses_that_are_not_there(poses: str, found: str, log: Path) -> None:
    write_poses("Odometry", "/odom")
    Path("broken.bag").write_bytes(b"no bag")
    error = read_error(occmap("build", log, "-o", "m.pgm", "--poses", poses), 1)
    assert found in error


def test_the_other_recording_is_an_input_of_the_build(log: Path) -> None:
    write_poses("Odometry", "/odom")
    day = Path("day")
    day.mkdir()
    Path("slam.mcap").rename(day / "slam.mcap")
    chosen = ("--poses", "day/slam.mcap:/odom")
    error = read_error(occmap("build", log, "-o", day / "slam.mcap", *chosen), 2)
    assert "day/slam.mcap" in error  # nothing writes over it
    log.rename(day / "log.bag")
    occmap("build", day, "-o", "m.npz", *chosen)  # and of a folder it is no log
    build = open_saved(Path("m.npz")).manifest.builds[0]
    assert [each["name"] for each in build["inputs"]] == ["log.bag", "slam.mcap"]
    assert build["options"]["posing"]["poses"] == "slam.mcap:/odom"
    made = explain("m.npz", 1, 1, logs=[day / "log.bag"], poses=[day / "slam.mcap"])
    assert made.scans_used == 6
    (day / "occmap.toml").write_text('poses = "slam.mcap:/odom"')  # where it lies
    assert occmap("build", day / "log.bag", "-o", "again.npz").code == 0
    assert Path("again.npz").read_bytes() == Path("m.npz").read_bytes()
    with pytest.raises(PoseError, match="add `poses=slam"):
        explain("m.npz", 1, 1, logs=[day / "log.bag"])


def test_the_other_recording_may_be_a_folder(log: Path) -> None:
    poses = [Written("/odom", at, make("Odometry", at, 0.5 * k)) for k, at in enumerate(STAMPS)]
    Bag2(StoragePlugin.SQLITE3).write(Path("slam"), poses)
    write_poses("Odometry", "/odom")
    assert occmap("build", log, "-o", "file.pgm", "--poses", "slam.mcap").code == 0
    for chosen in ("slam", "slam:/odom"):
        assert occmap("build", log, "-o", "m.npz", "-o", "m.pgm", "--poses", chosen).code == 0
        assert Path("m.pgm").read_bytes() == Path("file.pgm").read_bytes()
        build = open_saved(Path("m.npz")).manifest.builds[0]
        assert build["options"]["posing"]["poses"] == chosen
        names = [each["name"] for each in build["inputs"]]
        assert names == ["log.bag", "slam/metadata.yaml", "slam/slam.db3"]
        assert explain("m.npz", 1, 1, logs=[log], poses=["slam"]).scans_used == 6
        with pytest.raises(PoseError, match="add `poses=slam`"):
            explain("m.npz", 1, 1, logs=[log])
    error = read_error(occmap("build", log, "-o", "slam/metadata.yaml", "--poses", "slam"), 2)
    assert "slam" in error


def test_damage_of_the_other_recording_is_told(log: Path) -> None:
    other = write_poses("PoseStamped", "/path")
    data = other.read_bytes()
    other.write_bytes(data[: len(data) // 2])

    made = build_map(log, poses=str(other), outputs="map.pgm")

    (told,) = (note for note in made.report.damage if "the file ends" in note)
    assert told.startswith(f"{log}: {other}: ")


def test_damage_of_the_other_recording_does_not_grow_notes_that_cannot(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_poses("PoseStamped", "/path")
    other.write_bytes(other.read_bytes()[:-100])
    opened = open_log(log)
    monkeypatch.setattr(opened, "notes", ())
    assert list(gather_poses(opened, PosingOptions(poses=str(other))))
