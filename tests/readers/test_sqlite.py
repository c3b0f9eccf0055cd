"""SQLite files of ROS 2 bags that are damaged, unfinished or hostile."""

import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from occmap.errors import LogError
from occmap.readers import Log, Note, open_log
from tests.fuzz.__main__ import alarm
from tests.readers.ros import RANGES, ROS2, SCAN, Bag2, Written, scan

SCANS = 300
PAGE = 4096
LEAF, INNER = 0x0D, 0x05
TABLE = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)"


def read_stamps(log: Log) -> list[int]:
    return [scan.stamp_ns for scan in log.scans({"/scan"})]


def write_bag(folder: Path, beams: int = 100) -> Path:
    """Write scans with the stamps 0, 1, 2 ..."""
    ranges = RANGES.repeat(beams // len(RANGES))
    log = [Written("/scan", k, scan(ROS2, k, "laser", ranges)) for k in range(SCANS)]
    return Bag2(StoragePlugin.SQLITE3).write(folder / "drive", log) / "drive.db3"


def find_pages(data: bytes | bytearray, kind: int) -> list[int]:
    """Where the pages of a kind start, without the schema's."""
    return [at for at in range(PAGE, len(data), PAGE) if data[at] == kind]


def test_a_database_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.db3"
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE birds (name TEXT)")
    database.commit()
    database.close()

    with pytest.raises(LogError, match="no such table: topics"):
        open_log(path)


def test_a_database_that_was_cut_gives_the_rows_before_the_cut(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])

    cut = open_log(path)
    scans = list(cut.scans({"/scan"}))

    stamps = [scan.stamp_ns for scan in scans]
    # Rows fill a page from its end, so those that were written last on the cut page are there.
    assert stamps[:100] == list(range(100))
    assert stamps == sorted(set(stamps))
    assert 0.4 < len(scans) / SCANS < 0.6
    assert " messages are found" in cut.notes[0].text
    size = f"{len(data) // 2} of its {len(data)} bytes are there"
    assert cut.notes[1] == Note(f"the storage file is cut: {size}", True)


def test_a_page_of_zeros_takes_the_rows_that_lay_on_it(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    data = bytearray(path.read_bytes())
    at = find_pages(data, LEAF)[-10]
    lost = int.from_bytes(data[at + 3 : at + 5], "big")
    assert 1 < lost < 10
    data[at : at + 512] = bytes(512)
    path.write_bytes(data)

    log = open_log(path)
    stamps = read_stamps(log)

    assert len(stamps) == SCANS - lost
    assert stamps == sorted(set(stamps))
    assert {0, SCANS - 1} < set(stamps)
    text = f"{SCANS - lost} of {SCANS} messages are found"
    assert text in log.notes[0].text


def test_a_damaged_root_takes_all_rows(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    data = bytearray(path.read_bytes())
    for at in find_pages(data, INNER):
        data[at : at + 512] = bytes(512)
    path.write_bytes(data)

    log = open_log(path)

    assert read_stamps(log) == []
    assert f" 0 of {SCANS} messages are found" in " ".join(log.notes)


def test_a_page_that_a_message_goes_on_in(tmp_path: Path) -> None:
    path = write_bag(tmp_path, beams=5000)
    data = bytearray(path.read_bytes())
    # Such a page starts with the number of the next.
    at = next(at for at in find_pages(data, 0) if any(data[at : at + 4]))
    data[at : at + 4] = bytes(4)
    path.write_bytes(data)

    log = open_log(path)

    assert len(read_stamps(log)) == SCANS - 1
    text = f"{SCANS - 1} messages are read on /scan, where the log announces {SCANS}"
    assert Note(text, damage=True) in log.notes


def test_rows_that_a_page_no_longer_counts_are_told_of(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    data = bytearray(path.read_bytes())
    at = find_pages(data, LEAF)[-10]
    rows = data[at + 4]
    data[at + 4] = 1  # SQLite does not mind
    path.write_bytes(data)

    log = open_log(path)

    assert len(read_stamps(log)) == SCANS - rows + 1
    assert f"{SCANS - rows + 1} of {SCANS} messages are found" in log.notes[0].text
    assert "its table and its index differ" in log.notes[0].text


def test_rows_of_an_unknown_topic_are_told_of(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET topic_id = 77 WHERE id < 6")
    database.close()

    log = open_log(path)

    assert len(read_stamps(log)) == SCANS - 5
    assert log.notes == [Note("the file names no topic for 5 messages", damage=True)]


@pytest.fixture
def unfinished(tmp_path: Path) -> Iterator[Path]:
    """A bag whose last 100 rows lie in the log that its recorder left, in a read-only folder."""
    folder = tmp_path / "robot"
    folder.mkdir()
    source = write_bag(tmp_path)
    database = sqlite3.connect(source)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    rows = database.execute("SELECT * FROM messages WHERE id > ?", (SCANS - 100,)).fetchall()
    database.execute("DELETE FROM messages WHERE id > ?", (SCANS - 100,))
    database.commit()
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for row in rows:
        database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
        database.commit()
    for suffix in ("", "-wal"):
        shutil.copy(f"{source}{suffix}", folder)
    database.close()
    yield folder / source.name
    folder.chmod(0o755)


def test_rows_in_a_log_beside_the_file_are_read_and_nothing_is_written(unfinished: Path) -> None:
    folder = unfinished.parent
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}
    folder.chmod(0o555)

    log = open_log(unfinished)

    assert read_stamps(log) == list(range(SCANS))
    assert log.notes == []
    assert before == {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in before}
    assert set(folder.iterdir()) == set(before)


def test_a_log_beside_the_file_that_is_cut_or_damaged(unfinished: Path) -> None:
    wal = unfinished.with_name(unfinished.name + "-wal")
    data = wal.read_bytes()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 1
    for damaged in (
        data[: len(data) // 2],
        bytes(flipped),
        bytes(32) + data[32:],
        data[:20],
        data[:40],
    ):
        wal.write_bytes(damaged)
        log = open_log(unfinished)
        stamps = read_stamps(log)

        assert SCANS - 100 <= len(stamps) < SCANS
        assert stamps == list(range(len(stamps)))
        (note,) = log.notes
        assert note.damage
        assert note.text.startswith("drive.db3-wal is cut or damaged: its last")


def test_a_log_from_before_it_was_emptied_is_no_damage(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode = WAL")
    rows = database.execute("SELECT * FROM messages ORDER BY id").fetchall()
    for kept in (SCANS - 100, SCANS - 1):  # much is written first, and a little over it
        database.execute("DELETE FROM messages WHERE id > ?", (kept,))
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows[kept:])
        database.commit()
        log = open_log(path)
        assert read_stamps(log) == list(range(SCANS))
        assert log.notes == []
        database.execute("PRAGMA wal_checkpoint(RESTART)")
    database.close()


def test_a_recorder_that_died_within_a_transaction(tmp_path: Path) -> None:
    path = write_bag(tmp_path)
    path.with_name("drive.db3-journal").write_bytes(b"x")

    text = "the recorder died while it wrote: drive.db3-journal is not used"
    assert open_log(path).notes == [Note(text, damage=True)]


ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT"


@pytest.mark.parametrize(
    "statement",
    [
        f"CREATE VIEW messages AS {ENDLESS} i AS id, 1 AS topic_id, i AS timestamp, x'' AS data"
        " FROM n",
        "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
        TABLE.replace("data BLOB", "data AS (zeroblob(1000000000))"),
    ],
)
def test_only_real_tables_are_read(tmp_path: Path, statement: str) -> None:
    path = write_bag(tmp_path)
    database = sqlite3.connect(path)
    database.execute("DROP TABLE messages")
    database.execute(statement)
    database.commit()
    database.close()

    complaint = "no such table: messages|the table messages has generated columns"
    with alarm(5), pytest.raises(LogError, match=complaint):
        open_log(path)


@pytest.mark.parametrize("key", ["NULL", "'one'"])
def test_a_topic_without_a_number_is_told_of(tmp_path: Path, key: str) -> None:
    path = write_bag(tmp_path)
    database = sqlite3.connect(path)
    rows = database.execute("SELECT name, type, serialization_format FROM topics").fetchall()
    database.execute("DROP TABLE topics")
    database.execute("CREATE TABLE topics(id, name, type, serialization_format)")
    database.execute(f"INSERT INTO topics VALUES ({key}, ?, ?, ?)", rows[0])
    database.commit()
    database.close()

    text = f"the file names no topic for {SCANS} messages"
    assert open_log(path).notes == [Note(text, damage=True)]


@pytest.mark.parametrize("text", [b"/scan" + SCAN.encode(), b"INTEGER NOT NULL,\n      timestamp"])
def test_texts_that_are_no_utf8_are_read(tmp_path: Path, text: bytes) -> None:
    path = write_bag(tmp_path)
    data = path.read_bytes()
    assert text in data
    path.write_bytes(data.replace(text, b"\xc9" + text[1:]))

    log = open_log(path)

    assert len(list(log.scans({stream.topic for stream in log.streams}))) == SCANS
