"""A folder or a pattern stands for the recordings in it, in the order of their time."""

import gzip
import shutil
from pathlib import Path

import pytest

import occmap
from occmap.readers import ReaderOptions
from occmap.scans.logs import find_inputs
from tests.samples import SAMPLE_LOGS, write_csv


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A folder of three recordings, the last by name the first by time, and of other files."""
    folder = tmp_path / "day"
    folder.mkdir()
    for name, first in (("c.csv", 0), ("a.csv", 100), ("b.csv", 200)):
        write_csv(folder / name, [(0.0, 0.0, 0.0)] * 3, [1.0, 1.0], 0.1, first)
    (folder / "notes.txt").write_text("hello\n")
    (folder / ".hidden.csv").write_text("stamp\n")
    return folder


def find(*paths: Path, others: tuple[Path, ...] = ()) -> tuple[list[str], list[str]]:
    logs, notes = find_inputs(paths, ReaderOptions(), others)
    return [log.name for log in logs], notes


def test_a_folder_is_its_recordings_in_the_order_of_their_time(day: Path) -> None:
    note = f"{day}: 3 recordings, in the order of their time: c.csv, a.csv, b.csv"
    assert find(day) == (["c.csv", "a.csv", "b.csv"], [f"{note}; 1 other file passed over"])


def test_a_pattern_is_what_it_matches(day: Path) -> None:
    pattern = day / "[ab].csv"
    note = f"{pattern}: 2 recordings, in the order of their time: a.csv, b.csv"
    assert find(pattern) == (["a.csv", "b.csv"], [note])
    (day / "b.csv.gz").write_bytes(gzip.compress((day / "b.csv").read_bytes()))
    assert find(day)[1][1].startswith(f"{day}: b.csv.gz: lies there unpacked, too")


def test_what_else_the_user_names_is_no_recording(day: Path) -> None:
    names, notes = find(day, others=(day / "a.csv",))
    assert names == ["c.csv", "b.csv"]
    assert notes[0].endswith("2 other files passed over")


def test_what_occmap_wrote_into_a_folder_is_no_recording(day: Path) -> None:
    made = [day / "map.mcap", day / "way.csv", day / "way.tum"]
    occmap.build_map(day, outputs=made)
    names, notes = find(day)
    assert names == ["c.csv", "a.csv", "b.csv"]
    (note,) = notes
    assert note.endswith("4 other files passed over")


def test_a_recording_that_failed_is_named(day: Path) -> None:
    """Nothing was written to one, and what is in the other of the name of those found is none."""
    (day / "d.mcap").touch()
    (day / "e.csv").write_text("stamp,x,y,yaw\n1,2,3,0\n")
    names, notes = find(day, others=(day / "out.mcap",))
    assert names == ["c.csv", "a.csv", "b.csv"]
    assert notes[0].endswith("; 1 other file passed over")
    told = "passed over, though named like a recording"
    assert notes[1] == f"{day / 'd.mcap'}: {told}: the file is empty"
    assert notes[2].startswith(f"{day / 'e.csv'}: {told}: a text file of no known log format")
    (day / "out.mcap").touch()
    assert len(find(day, others=(day / "out.mcap",))[1]) == 3
    for name in ("F.MCAP", "H.DB3"):
        (day / name).touch()
    assert len(find(day)[1]) == 6


@pytest.mark.parametrize("name", ["drive.csv", "drive_ros2"])
def test_a_recording_stays_as_it_is(name: str) -> None:
    assert find(SAMPLE_LOGS / name) == ([name], [])


def test_files_of_one_split_recording_stay_one(tmp_path: Path) -> None:
    for part in range(2):
        shutil.copy(SAMPLE_LOGS / "drive.mcap", tmp_path / f"drive_{part}.mcap")
    assert find(tmp_path) == ([tmp_path.name], [])
    shutil.copy(SAMPLE_LOGS / "drive.bag", tmp_path / "other.bag")
    assert sorted(find(tmp_path)[0]) == ["drive_0.mcap", "drive_1.mcap", "other.bag"]


def test_bags_of_ros2_in_a_folder_are_recordings(tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        shutil.copytree(SAMPLE_LOGS / "drive_ros2", tmp_path / name)
    assert find(tmp_path)[0] == ["monday", "tuesday"]


def test_what_holds_no_recording_is_left_to_the_readers(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello\n")
    for path in (tmp_path, tmp_path / "*.bag", tmp_path / "none.csv"):
        assert find(path) == ([path.name], [])


def test_a_notebook_may_give_a_folder(day: Path) -> None:
    made = occmap.build_map(day)
    assert made.report.scans.used == 9
    assert "3 recordings, in the order of their time" in made.report.notes[0]
    assert [Path(log.path).name for log in occmap.check(day).logs] == ["c.csv", "a.csv", "b.csv"]
