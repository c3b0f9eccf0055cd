"""A file that is no log, or no whole one, is named in one line, and nothing is written."""

import gzip
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from occmap.readers.mcap import McapSource
from tests.cli.runner import occmap, read_error
from tests.readers.ros import ROS2, drive, write_mcap
from tests.samples import SAMPLE_LOGS, write_csv

pytestmark = pytest.mark.usefixtures("here")
HEAD = "# angle_min: 0\n# angle_increment: 0.1\n"
NO_LOG = "occmap reads carmen, clouds, csv, mcap, rosbag: see `occmap readers`"
KEPT_OUT = pytest.mark.skipif(os.geteuid() == 0, reason="root may read and write any folder")


def fail(log: Any, output: str = "m.pgm", *words: str) -> str:
    """Return the one line that a failing build prints; it must leave the folder as it was."""
    before = sorted(Path.cwd().rglob("*"))
    error = read_error(occmap("build", log, "-o", output, *words), 1)
    assert sorted(Path.cwd().rglob("*")) == before
    assert "fault in occmap" not in error
    return error


def write(name: str, content: str | bytes) -> str:
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return name


def test_a_link_to_nothing_is_named_as_one() -> None:
    Path("dangling.mcap").symlink_to("nowhere.mcap")
    assert fail("dangling.mcap").startswith("dangling.mcap: a link to nowhere.mcap, which is not")


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("empty.mcap", b"", "the file is empty"),
        ("notes.txt", "Dear diary,\nI", "a text file of no known log format: it starts with 'Dear"),
        ("poses.csv", "time,x,y,theta\n1,2,3,0\n", "if it holds poses alone, give it with --poses"),
        ("blank.txt", "\n\n", "a text file of no known log format"),
        ("bytes.bin", b"\xff\xfe\x00\x01 and more", "it starts with the bytes ff fe 00 01"),
        ("cut.gz", b"\x1f\x8b\x08\x00", "a gzip file with nothing in it that can be read"),
        ("a b.mcap.gz", gzip.compress(McapSource.magic, mtime=0), "first: gunzip 'a b.mcap."),
        ("drive.mcap.zst", b"\x28\xb5\x2f\xfd\x04", "decompress it first: unzstd drive.mcap.zst"),
        ("drive.bag.lz4", b"\x04\x22\x4d\x18H@", "decompress it first: unlz4 drive.bag.lz4"),
        ("a.tgz", gzip.compress(bytes([9] * 257) + b"ustar", mtime=0), "tar -xf a.tgz"),
        ("a.pcap", b"\xd4\xc3\xb2\xa1\x02", "packets; record what the lidar's ROS driver makes"),
        ("scan.las", b"LASF\0\0\0\0", "it starts with the bytes 4c 41 53 46"),
        ("zeros.mcap", bytes(5000), "a file that begins with zeros, as a power cut leaves one"),
        ("map.pgm", "P5\n2 1\n255\nab", "a map, not a log: `occmap diff` compares maps"),
        ("map.yaml", "image: map.pgm\n", "a map, not a log: `occmap diff` compares maps"),
        ("map.png", b"\x89PNG\r\n", "a picture, not a log"),
        ("old.bag", "#ROSBAG V1.2\n", "convert it with ROS 1's `rosbag fix"),
        ("older.bag", "#ROSRECORD V1\n", "convert it with ROS 1's `rosbag fix"),
        ("new.bag", "#ROSBAG V2.0\n", "nothing in it can be read"),
        ("drive.mcap", "version https://git-lfs.github.com/spec/v1\n", "fetch it: git lfs pull"),
        ("map.ply", "ply\nformat ascii 1.0\n", "clouds of single scans, in a folder"),
    ],
)
def test_a_file_that_is_no_log(name: str, content: str | bytes, found: str) -> None:
    error = fail(write(name, content))
    assert error.startswith(f"{name}: ")
    assert found in error


def test_a_folder_that_is_no_bag_and_a_name_that_is_not_in_one() -> None:
    write("stuff/b.txt", "b")
    write("stuff/a.txt", "a")
    expected = f"stuff: a folder that is not a recording: it holds a.txt, b.txt; {NO_LOG}"
    assert fail("stuff") == expected
    Path("empty").mkdir()
    assert "it holds nothing" in fail("empty")
    assert "did you mean stuff/a.txt?" in fail("stuff/aa.txt")


@KEPT_OUT
def test_a_folder_that_cannot_be_read_or_written() -> None:
    write_csv(Path("log.csv"), [(0.0, 0.0, 0.0)], [0.3])
    Path("secret").mkdir(mode=0)
    assert "cannot be read (Permission denied)" in fail("secret")
    Path("maps").mkdir(mode=0o500)
    assert "no permission to write into" in fail("log.csv", "maps/m.pgm")


def test_a_pipe_is_no_file() -> None:
    os.mkfifo("pipe")
    assert "pipe: no file and no folder; pipe it: | occmap build -" in fail("pipe")


def test_a_bag_whose_files_are_missing() -> None:
    Path("bag").mkdir()
    shutil.copy(SAMPLE_LOGS / "drive_ros2" / "metadata.yaml", "bag")
    assert "bag: metadata.yaml names files that are missing: drive_ros2.db3; " in fail("bag")


def test_a_log_without_scans_says_what_it_holds_and_what_is_damaged() -> None:
    log = write_mcap(Path("tf.mcap"), [each for each in drive(ROS2) if each.topic != "/scan"])
    error = fail(log)
    assert error.startswith("tf.mcap: holds no laser scans and no clouds; it holds ")
    assert "/tf (tf2_msgs/msg/TFMessage, 6)" in error
    content = write_mcap(log, drive(ROS2)).read_bytes()
    log.write_bytes(content[: content.index(b"sensor_msgs/msg/LaserScan")])
    assert "; the file ends in the middle" in fail(log)


@pytest.mark.parametrize(
    ("content", "where", "found"),
    [
        ("# angle_min: 0\nstamp,x,y,yaw,r0,r1\n0,0,0,0,1,1\n", "", "angle_increment"),
        (HEAD + "x,y,yaw,r0,r1\n0,0,0,1,1\n", "", "stamp"),
        (HEAD + "stamp,x,y,yaw,r0,r1\n0,0,0,0,one,1\n0,0,0,0,1,two\n", ":4", "'one'"),
        (HEAD + "stamp,x,y,yaw,r0\n0,0,north,0,1\n", ":4", "'north'"),
        (HEAD + "stamp,r0,r1\n0,1,1\n1,1,1\n", "", "looked for tf, odometry and"),
        (HEAD + "stamp,r0,r1\n0,1,1\n1,1,1\n", "", "give a trajectory: --poses FILE"),
    ],
)
def test_a_csv_with_a_fault_names_file_and_line(content: str, where: str, found: str) -> None:
    error = fail(write("bad.csv", content))
    assert error.startswith(f"bad.csv{where}:")
    assert found in error


def test_an_update_as_a_file_name_is_read_by_its_path() -> None:
    write_csv(Path("beam"), [(0.0, 0.0, 0.0)], [0.3])
    assert "no log is given" in read_error(occmap("build beam -o m.pgm"), 2)
    assert occmap("build ./beam -o m.pgm -q").code == 0


def test_a_world_file_that_cannot_be_written() -> None:
    write_csv(Path("log.csv"), [(0.0, 0.0, 0.0)], [0.3])
    Path("m.pgw").mkdir()
    assert fail("log.csv", "m.png", "--georeference", "1,2,3").startswith("m.pgw: ")
