"""The parts of a log give its scans, each once and in order, in whatever process they are read."""

import gzip
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import zstandard

from occmap.readers import Log, open_log, split_log
from occmap.steps.opening import choose_topics
from occmap.types import Scan
from tests.samples import DRIVES, SAMPLE_LOGS


def read(log: Log) -> list[Scan]:
    return list(log.scans(choose_topics(log, [])))


@pytest.mark.parametrize("size", [30_000, 200_000])
@pytest.mark.parametrize("path", DRIVES, ids=lambda path: path.name)
def test_parts_give_each_scan_once_and_in_order(path: Path, size: int) -> None:
    log = open_log(path)
    parts: list[Log] = pickle.loads(pickle.dumps(split_log(log, size)))
    assert len(parts) > 2
    scans = [scan for part in parts for scan in read(part)]
    whole = read(log)
    assert [scan.stamp_ns for scan in scans] == [scan.stamp_ns for scan in whole]
    assert all(
        np.array_equal(one.ranges, other.ranges, equal_nan=True)
        for one, other in zip(scans, whole, strict=True)
    )
    assert all(list(part.notes) == list(log.notes) for part in parts)


@pytest.mark.parametrize("path", DRIVES, ids=lambda path: path.name)
def test_a_small_log_is_one_part(path: Path) -> None:
    (part,) = split_log(open_log(path), 1 << 30)
    assert len(read(part)) == 414


def test_a_packed_log_is_one_part(tmp_path: Path) -> None:
    packed = tmp_path / "drive.csv.gz"
    packed.write_bytes(gzip.compress((SAMPLE_LOGS / "drive.csv").read_bytes()))
    (part,) = split_log(open_log(packed), 30_000)
    assert len(read(part)) == 414


def test_a_log_without_an_index_is_one_part(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((SAMPLE_LOGS / "drive.mcap").read_bytes()[:300_000])
    (part,) = split_log(open_log(cut), 30_000)
    assert 0 < len(read(part)) < 414


def test_the_header_of_a_csv_is_no_row_of_any_part(tmp_path: Path) -> None:
    """Comments before it may be longer than a part."""
    text = (SAMPLE_LOGS / "drive.csv").read_text()
    log = tmp_path / "long.csv"
    log.write_text("# a comment of no use\n" * 100 + text)
    parts = split_log(open_log(log), 1000)
    assert sum(len(read(part)) for part in parts) == 414
    assert len(parts) > 100


@pytest.mark.parametrize("bad", range(150, 250, 7))
def test_a_part_judges_damage_by_the_whole_log(bad: int, tmp_path: Path) -> None:
    rows = [f"{stamp},1,2,0,1.5,2.5" for stamp in range(400)]
    rows[bad] = rows[bad].replace("1.5", "one")
    path = tmp_path / "log.csv"
    header = "# angle_min: -1.5\n# angle_increment: 0.25\nstamp,x,y,yaw,r0,r1"
    path.write_text("\n".join([header, *rows]) + "\n")
    log = open_log(path)
    parts = split_log(log, 150)
    assert len(parts) > 40
    stamps = [scan.stamp_ns // 10**9 for part in parts for scan in read(part)]
    assert stamps == [stamp for stamp in range(400) if stamp != bad]
    read(log)
    (note,) = log.notes
    assert f"1 of 400 lines are malformed and left out, the first is line {bad + 4}:" in note.text
    assert [note for part in parts for note in part.notes] == [note]


def test_a_bag_that_was_unpacked_cannot_be_handed_on(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    shutil.copytree(SAMPLE_LOGS / "drive_ros2", folder)
    (folder / "metadata.yaml").unlink()
    (storage,) = folder.glob("*.db3")
    storage.with_name(f"{storage.name}.zstd").write_bytes(zstandard.compress(storage.read_bytes()))
    storage.unlink()
    assert not split_log(open_log(folder), 30_000)
