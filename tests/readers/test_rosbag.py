import os
import shutil
import sys
from pathlib import Path

import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from occmap.errors import LogError
from occmap.readers import Note, Probe, open_log, probe_path
from occmap.readers.rosbag import RosbagReader
from tests.fuzz.__main__ import alarm
from tests.readers.ros import ROS1, ROS2, SCAN, TF, Bag2, drive, write_bag1
from tests.readers.runs import count_scans

SQLITE = Bag2(StoragePlugin.SQLITE3)
MCAP = Bag2(StoragePlugin.MCAP)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A ROS 2 bag with its metadata and one storage file, drive.db3."""
    return SQLITE.write(tmp_path / "drive", drive(ROS2))


def test_bags_are_recognised_by_content(folder: Path, tmp_path: Path) -> None:
    bag = write_bag1(tmp_path / "no_suffix", drive(ROS1))
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "notes.txt").write_text("nothing here")

    reader = RosbagReader()
    assert reader.recognises(probe_path(bag))
    assert reader.recognises(probe_path(folder))
    assert reader.recognises(probe_path(folder / "drive.db3"))
    assert not reader.recognises(probe_path(plain))
    assert not reader.recognises(Probe(plain / "notes.txt", b"nothing", b"nothing"))


def test_a_bare_storage_file_is_read(folder: Path) -> None:
    assert count_scans(open_log(folder / "drive.db3")) == 6


def test_a_folder_without_metadata_is_read(tmp_path: Path) -> None:
    for number, bag in enumerate((SQLITE, MCAP, Bag2(SQLITE.storage, CompressionMode.MESSAGE))):
        folder = bag.write(tmp_path / f"bag{number}", drive(ROS2))
        (folder / "metadata.yaml").unlink()
        assert count_scans(open_log(folder)) == 6


ANCHORS = "\n".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}, *a{i - 1}]" for i in range(1, 60))
UNFOLDING = (
    f"a0: &a0 [x, x]\n{ANCHORS}\nrosbag2_bagfile_information:\n"
    "  relative_file_paths: *a59\n  compression_mode: *a59\n"
)
MERGING = "a0: &a0 {x: 1}\n" + "\n".join(
    f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}], x{i}: 1}}" for i in range(1, 40)
)


@pytest.mark.parametrize(
    "text",
    [
        *("", "just words", "{", "rosbag2_bagfile_information: 3"),
        *("[" * 900 + "]" * 900, UNFOLDING, MERGING, "x" * (1 << 20) + ": 1"),
        "rosbag2_bagfile_information: {relative_file_paths: [drive.db3],"
        " topics_with_message_count: [{message_count: many, topic_metadata: {name: /tf}}]}",
    ],
    ids=range(9),
)
def test_the_files_of_a_folder_with_damaged_metadata_are_read(text: str, folder: Path) -> None:
    (folder / "metadata.yaml").write_text(text)

    with alarm(20):
        log = open_log(folder)

    assert count_scans(log) == 6
    assert log.notes == [Note("metadata.yaml is damaged and not used", damage=True)]


@pytest.mark.parametrize("bag", [SQLITE, MCAP], ids=["sqlite", "mcap"])
def test_messages_that_only_the_metadata_counts_are_told_of(bag: Bag2, tmp_path: Path) -> None:
    folder = bag.write(tmp_path / "drive", drive(ROS2, scans=9))
    metadata = (folder / "metadata.yaml").read_text()
    assert open_log(folder).notes == []
    shutil.rmtree(folder)
    bag.write(folder, drive(ROS2, scans=6))
    (folder / "metadata.yaml").write_text(metadata)

    assert open_log(folder).notes == [
        Note(f"metadata.yaml announces 9 messages of {kind} on {topic}, the files 6", damage=True)
        for topic, kind in (("/tf", TF), ("/scan", SCAN))
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="needs named pipes")
@pytest.mark.parametrize("name", ["metadata.yaml", "drive_1.db3", "drive.db3-wal"])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(name: str, folder: Path) -> None:
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- drive.db3", "- drive.db3\n  - drive_1.db3"))
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)

    with alarm(5):
        assert count_scans(open_log(folder)) == 6


def test_missing_files_that_the_metadata_names_are_named(folder: Path, tmp_path: Path) -> None:
    renamed = shutil.copytree(folder, tmp_path / "renamed")
    (renamed / "drive.db3").rename(renamed / "other.db3")
    (folder / "drive.db3").unlink()

    with pytest.raises(LogError, match=r"names files that are missing: drive\.db3"):
        open_log(folder)
    log = open_log(renamed)
    assert count_scans(log) == 6
    assert log.notes == [Note("metadata.yaml names files that are missing: drive.db3", True)]


def test_a_file_that_the_metadata_does_not_name_is_told_of(folder: Path) -> None:
    shutil.copy(folder / "drive.db3", folder / "drive_1.db3")
    (folder / "drive.db3.zstd").write_bytes(b"what a player unpacked")
    (folder / "map.bin").touch()  # does not make it a folder of clouds

    (note,) = open_log(folder).notes

    assert note.damage
    assert "does not name drive_1.db3: not read" in note.text


def test_a_storage_file_that_cannot_be_read_does_not_spoil_the_others(folder: Path) -> None:
    (folder / "metadata.yaml").unlink()
    (folder / "drive_2.db3").write_bytes(b"no database")

    log = open_log(folder)

    assert count_scans(log) == 6
    assert log.notes == [Note("drive_2.db3 is not used: neither SQLite nor MCAP", True)]


@pytest.mark.parametrize("other", ["walk_0.db3", "drive.mcap", "drive.db3.zstd"])
def test_a_folder_of_several_recordings_is_refused(other: str, folder: Path) -> None:
    shutil.copy(folder / "drive.db3", folder / other)
    assert count_scans(open_log(folder)) == 6  # the metadata says which file it is
    (folder / "metadata.yaml").unlink()

    with pytest.raises(LogError, match=r"more than one recording and no metadata\.yaml") as caught:
        open_log(folder)
    assert other in caught.value.found
    assert caught.value.fix.startswith(f"give one of them, such as {folder}/")
