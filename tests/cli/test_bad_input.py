"""Every bad input is one clear line and the right exit code; no file is left behind."""

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

HEAD = "# angle_min: 0\n# angle_increment: 0.1\n"
NO_LOG = "occmap reads carmen, clouds, csv, mcap, rosbag: see `occmap readers`"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a new folder with one good log, `log.csv`."""
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "log.csv", [(0.0, 0.0, 0.0)], [0.3])
    return tmp_path


def fail(code: int, *words: Any) -> str:
    """Return the one line that a failing build prints; it must leave the folder as it was."""
    before = sorted(Path.cwd().rglob("*"))
    error = read_error(occmap("build", *words), code)
    assert sorted(Path.cwd().rglob("*")) == before
    assert "Traceback" not in error
    assert "fault in occmap" not in error
    return error


def write(name: str, content: str | bytes) -> str:
    path = Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return name


def test_a_link_to_nothing_is_named_as_one(folder: Path) -> None:
    (folder / "dangling.mcap").symlink_to("nowhere.mcap")
    found = "a link to nowhere.mcap, which is not there"
    fix = "mend the link, or give the log itself"
    assert fail(1, "dangling.mcap", "-o", "m.pgm") == f"dangling.mcap: {found}; {fix}"


def test_a_frame_that_the_log_lacks_is_told_with_those_it_has() -> None:
    error = fail(1, SAMPLE_LOGS / "drive.mcap", "-o", "m.pgm", "--map-frame", "world")
    assert "no frame 'world' in the log (known: base_link, laser, map, odom); give one of" in error
    assert error.endswith("these as --map-frame, or leave it out")


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("empty.mcap", b"", "the file is empty"),
        ("notes.txt", "Dear diary,\nI", "a text file of no known log format: it starts with 'Dear"),
        ("blank.txt", "\n\n", "a text file of no known log format"),
        ("bytes.bin", b"\xff\xfe\x00\x01 and more", "it starts with the bytes ff fe 00 01"),
        ("cut.gz", b"\x1f\x8b\x08\x00", "a gzip file with nothing in it that can be read"),
        (
            "a b.mcap.gz",
            gzip.compress(McapSource.magic, mtime=0),
            "decompress it first: gunzip 'a b.mcap.gz'",
        ),
        ("drive.mcap.zst", b"\x28\xb5\x2f\xfd\x04", "decompress it first: unzstd drive.mcap.zst"),
        ("zeros.mcap", bytes(5000), "the first 4,096 bytes are zero, as a power cut leaves a file"),
        ("map.pgm", "P5\n2 1\n255\nab", "a map, not a log: `occmap diff` compares maps"),
        ("map.yaml", "image: map.pgm\n", "a map, not a log: `occmap diff` compares maps"),
        ("map.png", b"\x89PNG\r\n", "a picture, not a log"),
        ("old.bag", "#ROSRECORD V1.2\n", "convert it with ROS 1's `rosbag fix"),
        (
            "drive.mcap",
            "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 123\n",
            "a Git LFS pointer, not the file; fetch it: git lfs pull",
        ),
    ],
)
def test_a_file_that_is_no_log(name: str, content: str | bytes, found: str) -> None:
    error = fail(1, write(name, content), "-o", "m.pgm")
    assert error.startswith(f"{name}: ")
    assert found in error


def test_a_folder_that_is_no_bag(folder: Path) -> None:
    write("stuff/b.txt", "b")
    write("stuff/a.txt", "a")
    error = fail(1, "stuff", "-o", "m.pgm")
    assert error == f"stuff: a folder that is not a recording: it holds a.txt, b.txt; {NO_LOG}"
    (folder / "empty").mkdir()
    assert "it holds nothing" in fail(1, "empty", "-o", "m.pgm")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read any folder")
def test_a_folder_that_cannot_be_read(folder: Path) -> None:
    (folder / "secret").mkdir(mode=0)
    assert "cannot be read (Permission denied)" in fail(1, "secret", "-o", "m.pgm")


def test_a_pipe_is_no_file(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    assert "pipe: neither a file nor a folder; save it to a file" in fail(1, "pipe", "-o", "m.pgm")


def test_a_bag_whose_files_are_missing(folder: Path) -> None:
    (folder / "bag").mkdir()
    shutil.copy(SAMPLE_LOGS / "drive_ros2" / "metadata.yaml", folder / "bag")
    error = fail(1, "bag", "-o", "m.pgm")
    found = "metadata.yaml names files that are missing: drive_ros2.db3"
    assert error == f"bag: {found}; copy them into this folder, too"


def test_a_log_without_scans_says_what_it_holds(folder: Path) -> None:
    write_mcap(folder / "tf.mcap", [each for each in drive(ROS2) if each.topic != "/scan"])
    error = fail(1, "tf.mcap", "-o", "m.pgm")
    assert error.startswith("tf.mcap: holds no laser scans and no clouds; it holds ")
    assert "/tf (tf2_msgs/msg/TFMessage, 6)" in error


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
    error = fail(1, write("bad.csv", content), "-o", "m.pgm")
    assert error.startswith(f"bad.csv{where}:")
    assert found in error


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into any folder")
def test_an_output_folder_that_cannot_be_written(folder: Path) -> None:
    (folder / "maps").mkdir(mode=0o500)
    assert "no permission to write into" in fail(1, "log.csv", "-o", "maps/m.pgm")


@pytest.mark.parametrize(
    ("output", "found"),
    [
        ("log.csv/m.pgm", "log.csv is a file, not a folder"),
        ("maps/m.pgm", "maps/m.pgm: the folder maps does not exist; create it: mkdir -p maps"),
        ("m.jpg", "unknown suffix '.jpg'; occmap writes .csv, .ground.tif, .html, .keepout.pgm"),
        ("n" * 300 + ".pgm", "File name too long"),
    ],
)
def test_an_output_that_cannot_be(output: str, found: str) -> None:
    code = 2 if "suffix" in found else 1
    assert found in fail(code, "log.csv", "-o", output)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("polgon log.csv -o m.pgm", "'polgon' is neither a log nor an update; did you mean 'pol"),
        ("Beam log.csv -o m.pgm", "did you mean 'beam'?"),
        ("polgon", "did you mean 'polygon'?"),
        ("beam -o m.pgm", "no log is given; type: occmap build LOG -o map.pgm"),
        ("", "no log is given"),
        ("log.csv", "where to write the map is not given; add -o map.pgm"),
        ("log.csv -o m.pgm --resolution 0", "a resolution of 0.0 m is not possible"),
        ("log.csv -o m.pgm --resolution nan", "a resolution of nan m is not possible"),
        ("log.csv -o m.pgm --extent 0,0,1e9,1", "reaches too far; give numbers up to 1e+08"),
        ("log.csv -o m.pgm --poses=", "--poses is empty; give a name, or leave it out"),
        ("log.csv -o m.pgm --resolution five", "--resolution is 'five'; give a number"),
        ("log.csv -o m.pgm --model smiple", "no model is called 'smiple'; did you mean 'simple'?"),
        ("log.csv -o m.pgm --model simple:p_hot=1", "the model simple has no parameter 'p_hot'"),
        ("log.csv -o m.pgm --model simple:p_hit", "write NAME:KEY=NUMBER,KEY=NUMBER"),
        ("log.csv -o m.pgm --model simple --p-hit 0.3", "p_miss 0.4 is not below p_hit 0.3"),
        ("log.csv -o m.pgm --epsilon 1", "the model counting has no parameter 'epsilon'"),
        ("log.csv -o m.pgm --model quadratic --epsilon 1e9", "--epsilon 1000000000.0 is not"),
        (
            "log.csv -o m.pgm --occupied-thresh 0.2 --free-thresh 0.6",
            "they must satisfy 0 < free < occupied < 1",
        ),
        ("log.csv -o m.pgm --min-range 5 --max-range 2", "--min-range 5.0 and --max-range 2.0"),
        ("log.csv -o m.pgm --no-return free", "'free' is not one of 'clear', 'ignore'"),
        ("log.csv -o m.pgm --start 5 --end 2", "--start 5.0 is not before --end 2.0"),
        ("log.csv -o m.pgm --max-cells 0", "0 is not in the range x>=1"),
        ("log.csv -o m.pgm --static-tf a,b", "give parent,child,x,y,z,roll,pitch,yaw"),
        ("log.csv -o m.pgm -o m.pgm", "m.pgm: would be written twice"),
        ("log.csv -o m.pgm --modle x", "--model"),
    ],
)
def test_wrong_usage(words: str, found: str) -> None:
    assert found in fail(2, *words.split())


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("--scan-topic /front", "log.csv: has no scans on the topic /front"),
        ("--poses nowhere.tum", "no such file; check the path: --poses takes a trajectory file"),
        ("--start 7", "none of 1 scans can be used: 1 outside --start and --end"),
        ("--max-cells 2", "more than --max-cells 2"),
        ("--min-range 1", "no beam of any scan observed a cell"),
    ],
)
def test_options_that_leave_no_map(words: str, found: str) -> None:
    assert found in fail(1, "log.csv", "-o", "m.pgm", *words.split())


def test_a_log_that_is_not_there_is_guessed(tmp_path: Path) -> None:
    shutil.copy("log.csv", tmp_path / "drive.csv")
    guess = f"no such file or directory; did you mean {tmp_path}/drive.csv?"
    assert fail(1, tmp_path / "drve.csv", "-o", "m.pgm") == f"{tmp_path}/drve.csv: {guess}"
    found = f"{tmp_path}/*.bag: no file matches; check the pattern and its folder"
    assert fail(1, tmp_path / "*.bag", "-o", "m.pgm") == found


def test_one_bad_log_of_two_stops_the_build() -> None:
    error = fail(1, "log.csv", "nowhere.csv", "-o", "m.pgm")
    assert error == "nowhere.csv: no such file or directory; check the path"


def test_an_update_as_a_file_name_is_read_by_its_path() -> None:
    shutil.copy("log.csv", "beam")
    assert "no log is given" in fail(2, "beam", "-o", "m.pgm")
    assert occmap("build", "./beam", "-o", "m.pgm", "-q").code == 0


@pytest.mark.parametrize(
    ("place", "found"),
    [
        ("91,0,0", "no place has latitude 91 and longitude 0; write degrees: LAT,LON,YAW"),
        ("0,-181,0", "no place has latitude 0 and longitude -181; write degrees: LAT,LON,YAW"),
        ("52.5,13.4", "--georeference 52.5,13.4: 2 values where 3 belong; give latitude,longitude"),
        ("north,13,0", "--georeference north,13,0: 'north' is not a number; give latitude"),
        ("nan,13,0", "--georeference nan,13,0: 'nan' is not a number"),
    ],
)
def test_a_place_that_is_on_no_globe(place: str, found: str) -> None:
    assert fail(2, "log.csv", "-o", "m.tif", "--georeference", place).startswith(found)


def test_a_world_file_that_cannot_be_written() -> None:
    Path("m.pgw").mkdir()
    error = fail(1, "log.csv", "-o", "m.png", "--georeference", "1,2,3")
    assert error.startswith("m.pgw: ")
