"""The SQLite storage files (.db3) of ROS 2 bags, row by row as they were written.

Read without the index on time, so that a file that was cut gives the rows before the cut.
"""

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from occmap.errors import LogError
from occmap.readers import Note
from occmap.readers.ros_source import Channel, Encoding, RawMessage, Syntax, add_note

MAGIC = b"SQLite format 3\x00"

_SYNTAXES: Mapping[str, Syntax] = {"ros2msg": "msg", "ros2idl": "idl"}
_ENCODINGS: Mapping[str, Encoding] = {"cdr": "cdr"}


class SqliteSource:
    """The channels and raw messages of a .db3 file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[Note] = []
        try:
            with closing(self._connect()) as database:
                topics = _read_topics(database)
                counts = self._count_messages(database)
                self._note_cut(database)
        except sqlite3.Error as error:
            raise LogError(
                f"an SQLite database that cannot be read as a ROS 2 bag ({error})", where=path
            ) from None
        self._by_id = {key: replace(item, count=counts[key]) for key, item in topics.items()}

    @property
    def channels(self) -> Sequence[Channel]:
        """Every topic of the file."""
        return list(self._by_id.values())

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some topics, in the order in which they were written."""
        by_id = {key: channel for key, channel in self._by_id.items() if channel in wanted}
        query = (
            "SELECT id, topic_id, timestamp, data FROM messages NOT INDEXED"
            f" WHERE topic_id IN ({','.join('?' * len(by_id))})"
            " AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
        )
        # What is lost where the file was cut has been noted when its messages were counted.
        with closing(self._connect()) as database, suppress(sqlite3.Error):
            for _, key, record_ns, data in _read_rows(database, query, tuple(by_id)):
                yield by_id[key], record_ns, memoryview(data)

    def _note_cut(self, database: sqlite3.Connection) -> None:
        """Note where the file ends within a page: SQLite takes what is missing for zeros."""
        ((page,),) = database.execute("PRAGMA page_size")
        lost = -self.path.stat().st_size % page
        if lost and not self.notes:
            add_note(self.notes, f"the storage file is cut: its last page lacks {lost} bytes")

    def _connect(self) -> sqlite3.Connection:
        """Open the file so that nothing is ever written, not even a lock."""
        log = self.path.with_name(self.path.name + "-wal")
        # A recorder that died leaves its last rows in a log beside the file.
        unfinished = log.exists() and log.stat().st_size > 0
        mode = "mode=ro" if unfinished else "mode=ro&immutable=1"
        location = f"file:{quote(str(self.path.resolve()))}?{mode}"
        database = sqlite3.connect(location, uri=True, check_same_thread=False)
        # SQLite refuses a file that is shorter than its header says, unless told to try.
        database.execute("PRAGMA writable_schema = ON")
        return database

    def _count_messages(self, database: sqlite3.Connection) -> Counter[int]:
        """Count the messages of each topic, as far as the file is whole."""
        counts: Counter[int] = Counter()
        try:
            query = "SELECT id, topic_id FROM messages NOT INDEXED WHERE true"
            for _, key in _read_rows(database, query, ()):
                counts[key] += 1
        except sqlite3.DatabaseError as error:
            add_note(
                self.notes,
                f"the storage file breaks off after {counts.total()} messages ({error})",
            )
        return counts


def _read_rows(
    database: sqlite3.Connection, query: str, values: tuple[int, ...]
) -> Iterator[tuple[Any, ...]]:
    """Give the rows of a query, whose first column is the id, up to the last that is sound.

    Raises
    ------
    sqlite3.DatabaseError
        The file is damaged behind these rows.
    """
    last = -1
    try:
        for row in database.execute(f"{query} ORDER BY id", values):
            last = row[0]
            yield row
    except sqlite3.DatabaseError:
        # Python's cursor is one row ahead of what it gives, and loses that one with the error.
        yield from database.execute(f"{query} AND id > ? ORDER BY id LIMIT 1", (*values, last))
        raise


def _read_topics(database: sqlite3.Connection) -> dict[int, Channel]:
    """Read the topics and their types."""
    definitions = _read_definitions(database)
    rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
    topics = {}
    for key, name, kind, encoding in rows:
        text, syntax = definitions.get(kind, ("", ""))
        topics[key] = Channel(str(name), str(kind), _ENCODINGS.get(encoding, ""), text, syntax)
    return topics


def _read_definitions(database: sqlite3.Connection) -> dict[str, tuple[str, Syntax]]:
    """Read the message definitions by type; recorders before ROS 2 Iron stored none."""
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    with suppress(sqlite3.OperationalError):
        rows = database.execute(query)
        return {kind: (text, _SYNTAXES[form]) for kind, form, text in rows if form in _SYNTAXES}
    return {}
