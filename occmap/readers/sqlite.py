"""The SQLite storage files (.db3) of ROS 2 bags, read row by row in the order of writing.

The index on time is not used to find rows; it says how many there should be.
"""

import os
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import apsw

from occmap.errors import LogError
from occmap.readers import NoteList
from occmap.readers.containers import Channel, RawMessage

_ERRORS = (apsw.Error, UnicodeDecodeError)
"""What the library raises on damaged files; texts in them may be anything."""
_LOCKLESS = "win32-none" if os.name == "nt" else "unix-none"
"""SQLite's way to open files without a lock"""
_MOST_BYTES = 1 << 28
"""The largest value that is read; no message is near it."""
_LEAST_ID, _GREATEST_ID = -(2**63), 2**63 - 1
"""The ids that a row can have"""
_SINGLE_TRIES, _MOST_TRIES = 64, 88
"""How often the next row behind damage is tried, and how often one in all, each time twice as far
behind; recorders number rows one by one, and the last try is 16 million rows behind."""


class SqliteSource:
    """The channels and raw messages of a .db3 file."""

    magic = b"SQLite format 3\x00"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._wal = path.with_name(path.name + "-wal")
        # A recorder that died leaves its last rows in a write-ahead log beside the file.
        self._has_wal = self._wal.is_file() and self._wal.stat().st_size > 0
        try:
            with closing(self._connect()) as database:
                topics = _read_topics(database)
                counts = self._count_messages(database, topics)
            self._note_state()
        except _ERRORS as error:
            found = f"an SQLite database that cannot be read as a ROS 2 bag ({error})"
            raise LogError(found, where=path) from None
        self._by_id = {key: replace(item, count=counts[key]) for key, item in topics.items()}
        self.channels = list(self._by_id.values())

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some topics, in the order in which they were written."""
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        with closing(self._connect()) as database:
            for _, key, record_ns, data in self._read_rows(database, "data", by_id):
                yield by_id[key], record_ns, data

    def _read_rows(
        self, database: apsw.Connection, what: str, topics: Collection[int]
    ) -> Iterator[tuple[Any, ...]]:
        """Give id, topic, time (ns) and something else of the rows of some topics.

        Where a page is damaged, SQLite gives up all that it leads to; so rows that lie further and
        further behind it are asked for, until there are some again. A note says so, if none does.
        """
        query = (
            f"SELECT rowid, CAST(topic_id AS INTEGER), timestamp, {what} FROM messages NOT INDEXED"
            f" WHERE rowid >= ? AND topic_id IN ({','.join('?' * len(topics))})"
            " AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
            " ORDER BY rowid"
        )
        start, tries = _LEAST_ID, 0
        while tries <= _MOST_TRIES:
            try:
                for row in database.execute(query, (start, *topics)):
                    yield row
                    start, tries = row[0] + 1, 0
                return
            except _ERRORS as error:
                if not self.notes:
                    self.notes.add_damage(f"the storage file is damaged ({error})")
                tries += 1
                start = min(max(start, 0) + (1 << max(tries - _SINGLE_TRIES, 0)), _GREATEST_ID)

    def _count_messages(self, database: apsw.Connection, topics: Collection[int]) -> Counter[int]:
        """Count the messages of each topic that can be read; the index says how many there are."""
        announced = 0
        with suppress(*_ERRORS):
            sql = "SELECT count(timestamp) FROM messages INDEXED BY timestamp_idx"
            ((announced,),) = database.execute(sql)
        try:
            sql = "SELECT CAST(topic_id AS INTEGER), count(*) FROM messages NOT INDEXED GROUP BY 1"
            counts = Counter(dict(database.execute(sql)))
        except _ERRORS:
            rows = self._read_rows(database, "length(data)", topics)
            counts = Counter(topic for _, topic, _, _ in rows)
        # An index that lacks rows, or is missing, loses none.
        announced = max(announced, counts.total())
        if (found := sum(counts[key] for key in topics)) < announced:
            text = f"{found} of {announced} messages are found in the storage file"
            why = "others are damaged, or of a topic that it does not name"
            self.notes.add_damage(f"{text}: {why}")
        return counts

    def _note_state(self) -> None:
        """Note the signs that the file was cut, or that its recorder died."""
        with self.path.open("rb") as file:
            page, pages = struct.unpack(">16xH10xI", file.read(32))
            page = 1 << 16 if page == 1 else page
            size = file.seek(0, 2)
        if size < page * pages and not self._has_wal:
            text = f"the storage file is cut: {size} of its {page * pages} bytes are there"
            self.notes.add_damage(text)
        if self._has_wal:
            text = f"the recorder did not close the file: {self._wal.name} is read, too"
            self.notes.add_damage(f"{text}, as far as it is whole")
        journal = self.path.with_name(self.path.name + "-journal")
        if journal.is_file() and journal.stat().st_size:
            self.notes.add_damage(f"the recorder died while it wrote: {journal.name} is not used")

    def _connect(self) -> apsw.Connection:
        """Open the file in a way that never writes anything beside it, not even a lock."""
        database = apsw.Connection(
            self.path.resolve().as_uri() + ("" if self._has_wal else "?immutable=1"),
            flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI,
            vfs=_LOCKLESS if self._has_wal else None,
        )
        database.config(apsw.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1)  # of the write-ahead log
        database.limit(apsw.SQLITE_LIMIT_LENGTH, _MOST_BYTES)
        database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)  # one may go on for ever
        # SQLite refuses a file that is shorter than its header says, unless told to try.
        database.execute("PRAGMA writable_schema = ON; PRAGMA trusted_schema = OFF")
        # With this, SQLite keeps the index of a write-ahead log in memory, not in a file.
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        return database


def _read_topics(database: apsw.Connection) -> dict[int, Channel]:
    """Read the topics and their types; recorders before ROS 2 Iron stored no definitions."""
    definitions: dict[str, str] = {}
    columns = ("topic_type", "encoding", "encoded_message_definition")
    with suppress(apsw.SQLError):
        rows = _read_texts(database, "message_definitions", *columns)
        definitions = {kind: text for kind, form, text in rows if form == "ros2msg"}
    fields = ("name", "type", "serialization_format", "ifnull(CAST(id AS INTEGER), -1)")
    return {
        int(key): Channel(name, kind, encoding, definitions.get(kind, ""))
        for name, kind, encoding, key in _read_texts(database, "topics", *fields)
    }


def _read_texts(database: apsw.Connection, table: str, *columns: str) -> Iterator[tuple[str, ...]]:
    """Give some columns of a table as text, also where it is not UTF-8."""
    blobs = ", ".join(f"CAST(ifnull({column}, '') AS BLOB)" for column in columns)
    for row in database.execute(f"SELECT {blobs} FROM {table}"):
        yield tuple(value.decode(errors="replace") for value in row)
