"""SQLite files of ROS 2 bags that are damaged, unfinished or hostile."""

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from occmap.errors import LogError
from occmap.readers import open_log
from tests.fuzz.__main__ import alarm
from tests.readers.ros import RANGES, ROS2, SCAN, Bag2, Written, scan
from tests.readers.runs import bounded_memory

SCANS = 300
ALL = list(range(SCANS))
PAGE = 4096
LEAF, INNER = 0x0D, 0x05
TABLE = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INT, timestamp INT, data BLOB)"


def write_bag(folder: Path, beams: int = 100) -> Path:
    """Write scans with the stamps 0, 1, 2 ..."""
    ranges = RANGES.repeat(beams // len(RANGES))
    log = [Written("/scan", k, scan(ROS2, k, "laser", ranges)) for k in ALL]
    return Bag2(StoragePlugin.SQLITE3).write(folder / "drive", log) / "drive.db3"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A sound bag."""
    return write_bag(tmp_path)


def read(path: Path) -> tuple[list[int], list[str]]:
    """The stamps of the scans, and the notes, all of which must be of damage."""
    log = open_log(path)
    stamps = [scan.stamp_ns for stream in log.streams for scan in log.scans({stream.topic})]
    assert stamps == sorted(set(stamps))
    assert all(note.damage for note in log.notes)
    return stamps, [note.text for note in log.notes]


@contextmanager
def edit(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path)) as database, database:
        yield database


def find_pages(data: bytes | bytearray, kind: int) -> list[int]:
    """Where the pages of a kind start, without the schema's."""
    return [at for at in range(PAGE, len(data), PAGE) if data[at] == kind]


def test_a_database_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with edit(tmp_path / "other.db3") as database:
        database.execute("CREATE TABLE birds (name TEXT)")

    with pytest.raises(LogError, match="no such table: topics"):
        open_log(tmp_path / "other.db3")


def test_a_database_that_was_cut_gives_the_rows_before_the_cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])

    stamps, notes = read(path)

    # Rows fill a page from its end, so those that were written last on the cut page are there.
    assert stamps[:100] == ALL[:100]
    assert 0.4 < len(stamps) / SCANS < 0.6
    assert "the storage file is damaged" in notes[0]


def test_a_page_of_zeros_takes_the_rows_that_lay_on_it(path: Path) -> None:
    data = bytearray(path.read_bytes())
    at = find_pages(data, LEAF)[-10]
    lost = int.from_bytes(data[at + 3 : at + 5], "big")
    assert 1 < lost < 10
    data[at : at + 512] = bytes(512)
    path.write_bytes(data)

    stamps, notes = read(path)

    assert len(stamps) == SCANS - lost
    assert {0, SCANS - 1} < set(stamps)
    assert any(f"{SCANS - lost} of {SCANS} messages are found" in note for note in notes)


def test_a_damaged_root_takes_all_rows(path: Path) -> None:
    data = bytearray(path.read_bytes())
    for at in find_pages(data, INNER):
        data[at : at + 512] = bytes(512)
    path.write_bytes(data)

    stamps, notes = read(path)

    assert stamps == []
    assert any(f"0 of {SCANS} messages are found" in note for note in notes)


def test_a_page_that_a_message_goes_on_in(tmp_path: Path) -> None:
    path = write_bag(tmp_path, beams=5000)
    data = bytearray(path.read_bytes())
    # Such a page starts with the number of the next.
    at = next(at for at in find_pages(data, 0) if any(data[at : at + 4]))
    data[at : at + 4] = bytes(4)
    path.write_bytes(data)

    stamps, notes = read(path)

    assert len(stamps) == SCANS - 1
    assert f"{SCANS - 1} messages are read on /scan, where the log announces {SCANS}" in notes


def test_rows_that_a_page_no_longer_counts_are_told_of(path: Path) -> None:
    data = bytearray(path.read_bytes())
    at = find_pages(data, LEAF)[-10]
    left = SCANS - data[at + 4] + 1
    data[at + 4] = 1  # SQLite does not mind
    path.write_bytes(data)

    stamps, notes = read(path)

    assert len(stamps) == left
    assert f"{left} of {SCANS} messages are found" in notes[0]


COPIED = f"ALTER TABLE messages RENAME TO old; {TABLE}; INSERT INTO messages SELECT * FROM old"
UNKNOWN = "UPDATE messages SET topic_id = 77 WHERE id < 6"
TIMELESS = "UPDATE messages SET timestamp = NULL WHERE id < 6; DROP INDEX timestamp_idx"
INDEX = "CREATE INDEX timestamp_idx ON messages(timestamp)"
KEYLESS = """
    CREATE TABLE others AS SELECT {} AS id, name, type, serialization_format FROM topics;
    DROP TABLE topics; ALTER TABLE others RENAME TO topics"""
FEWER = f"{SCANS - 5} messages are read on /scan, where the log announces {SCANS}"


@pytest.mark.parametrize(
    ("statements", "lost", "told"),
    [
        (f"{UNKNOWN}; REINDEX", 5, f"{SCANS - 5} of {SCANS} messages are found"),
        (f"{UNKNOWN}; DROP INDEX timestamp_idx", 5, f"{SCANS - 5} of {SCANS} messages are found"),
        (f"{COPIED}; {TIMELESS}; {INDEX}", 5, FEWER),  # rows that the index lacks
        *((KEYLESS.format(key), SCANS, f"0 of {SCANS} mess") for key in ("NULL", "'one'")),
        (COPIED.replace("topic_id INT", "topic_id TEXT"), 0, ""),
    ],
)
def test_rows_without_a_topic_or_a_time_are_told_of(
    path: Path, statements: str, lost: int, told: str
) -> None:
    """But topics may be numbered by text."""
    with edit(path) as database:
        database.executescript(statements)

    stamps, notes = read(path)

    assert stamps == ALL[lost:]
    assert [told in note for note in notes] == [True] * bool(lost)


@pytest.fixture
def unfinished(tmp_path: Path, path: Path) -> Iterator[Path]:
    """A bag whose last 100 rows lie in the log that its recorder left, in a read-only folder."""
    folder = tmp_path / "robot"
    folder.mkdir()
    with edit(path) as database:
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
            shutil.copy(f"{path}{suffix}", folder)
    yield folder / path.name
    folder.chmod(0o755)


def test_rows_in_a_log_beside_the_file_are_read_and_nothing_is_written(unfinished: Path) -> None:
    folder = unfinished.parent
    before = {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}
    folder.chmod(0o555)

    stamps, (note,) = read(unfinished)
    assert stamps == ALL
    assert "drive.db3-wal" in note
    assert before == {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in before}
    assert set(folder.iterdir()) == set(before)


def test_a_log_beside_the_file_that_is_cut_or_damaged(unfinished: Path) -> None:
    wal = unfinished.with_name(unfinished.name + "-wal")
    data = wal.read_bytes()
    half = len(data) // 2
    flipped = data[:half] + bytes([data[half] ^ 1]) + data[half + 1 :]
    for damaged in (data[:half], flipped, bytes(32) + data[32:], data[:20], data[:40]):
        wal.write_bytes(damaged)

        stamps, (note,) = read(unfinished)

        assert SCANS - 100 <= len(stamps) < SCANS
        assert stamps == ALL[: len(stamps)]
        assert "drive.db3-wal" in note


def test_a_recorder_that_died_within_a_transaction(path: Path) -> None:
    path.with_name("drive.db3-journal").write_bytes(b"x")

    _, (note,) = read(path)

    assert note == "the recorder died while it wrote: drive.db3-journal is not used"


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
def test_what_is_computed_on_reading_takes_no_time_or_memory(path: Path, statement: str) -> None:
    with edit(path) as database:
        database.execute("DROP TABLE messages")
        database.execute(statement)
        if "zeroblob" in statement:
            database.execute("INSERT INTO messages VALUES (1, 1, 1)")

    with alarm(5), bounded_memory():
        stamps, _ = read(path)
    assert stamps == []


@pytest.mark.parametrize("text", [b"/scan" + SCAN.encode(), b"INTEGER NOT NULL,\n      timestamp"])
def test_texts_that_are_no_utf8_are_read(path: Path, text: bytes) -> None:
    data = path.read_bytes()
    assert text in data
    path.write_bytes(data.replace(text, b"\xc9" + text[1:]))

    stamps, _ = read(path)

    assert stamps == ALL
