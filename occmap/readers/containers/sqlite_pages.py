"""Rows of a damaged SQLite file, found page by page: https://www.sqlite.org/fileformat2.html.

Where one page is damaged, SQLite gives up all pages that it leads to: 1,593 of 40,001 messages for
an inner page of a bag, and all of them for the root. Its shell can `.recover` them, the library
cannot. Here each page of rows is read by itself.
"""

import struct
from array import array
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias

import numpy as np

_LEAF = 0x0D
"""The first byte of a page that holds rows of a table."""
_LEAF_HEAD = 8
_NULL, _ONE = 0, 9
_WIDTHS = {_NULL: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, _ONE: 0}
"""Bytes of an integer by its type; 8 and 9 are the numbers 0 and 1."""
_BLOB = 12
"""From this type on, even types are blobs."""

Row: TypeAlias = tuple[int, int, int, bytes | None]
"""Id, topic, time (ns) and message; the message is None where one of its pages is damaged."""


class _Cell(NamedTuple):
    """A row as it lies on its page."""

    id: int
    topic: int
    record_ns: int
    start: int
    """Where the record starts on the page."""
    head: int
    """Bytes of the record before the message."""
    size: int
    """Bytes of the record."""


def find_rows(path: Path, after: int) -> Iterator[Row]:
    """Give the rows whose ids are greater than `after`, in the order of their ids.

    A table of messages is known by its columns: id, topic, time (ns) and data.
    """
    with path.open("rb") as file:
        pages = _Pages(file)
        ids, places = array("q"), array("q")
        for number, at in pages.list_cells():
            cell = pages.parse_cell(number, at)
            if cell is not None and cell.id > after:
                ids.append(cell.id)
                places.append(number * pages.size + at)
        _, firsts = np.unique(ids, return_index=True)
        for index in firsts.tolist():
            number, at = divmod(places[index], pages.size)
            cell = pages.parse_cell(number, at)
            if cell is not None:
                yield cell.id, cell.topic, cell.record_ns, pages.read_data(number, cell)


class _Pages:
    """The pages of a file, numbered from 0."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        size, reserved = struct.unpack(">16xH2xB", file.read(21))
        self.size = 1 << 16 if size == 1 else max(size, 512)
        self._usable = self.size - reserved
        self._end = file.seek(0, 2)
        self._held = -1, b""

    def read(self, number: int) -> bytes:
        """Read a page; it is short where the file is cut."""
        if self._held[0] != number:
            self._file.seek(number * self.size)
            self._held = number, self._file.read(self.size)
        return self._held[1]

    def list_cells(self) -> Iterator[tuple[int, int]]:
        """Give page and offset of each row of any table but the schema, on the first page."""
        for number in range(1, -(-self._end // self.size)):
            page = self.read(number)
            if page[0] == _LEAF and len(page) > _LEAF_HEAD:
                count = int.from_bytes(page[3:5], "big")
                count = min(count, (len(page) - _LEAF_HEAD) // 2)
                for at in struct.unpack_from(f">{count}H", page, _LEAF_HEAD):
                    yield number, at

    def parse_cell(self, number: int, at: int) -> _Cell | None:
        """Parse the start of a row; None where it is not one of messages, or is damaged.

        A row is the size of its record, its id, and the record: how long its head is, the type of
        each column, and the columns.
        """
        page = self.read(number)
        with suppress(LookupError):  # the page ends, or there is no such type
            size, at = _read_varint(page, at)
            key, start = _read_varint(page, at)
            length, at = _read_varint(page, start)
            kinds = []
            while at < start + length:
                kind, at = _read_varint(page, at)
                kinds.append(kind)
            if len(kinds) != 4 or kinds[0] != _NULL or kinds[3] % 2 or key >= 2**63:
                return None
            topic, at = _read_integer(page, start + length, kinds[1])
            record_ns, at = _read_integer(page, at, kinds[2])
            head = at - start
            if head + (kinds[3] - _BLOB) // 2 == size <= self._end:
                return _Cell(key, topic, record_ns, start, head, size)
        return None

    def read_data(self, number: int, cell: _Cell) -> bytes | None:
        """Read the message of a row from all pages that it lies on."""
        # The format has it so: a record that no page can hold leaves the page that it begins on
        # with as much as fills its last page, or with the least.
        most = self._usable - 35
        least = (self._usable - 12) * 32 // 255 - 23
        local = cell.size
        if local > most:
            local = least + (cell.size - least) % (self._usable - 4)
            local = local if local <= most else least
        page, end = self.read(number), cell.start + local
        pieces = [page[cell.start + cell.head : end]]
        lacking = cell.size - local
        following = page[end : end + 4]
        while lacking > 0 and (number := int.from_bytes(following, "big")) > 0:
            page = self.read(number - 1)
            following, piece = page[:4], page[4 : min(self._usable, 4 + lacking)]
            pieces.append(piece)
            lacking -= len(piece)
        data = b"".join(pieces)
        return data if len(data) == cell.size - cell.head else None


def _read_varint(page: bytes, at: int) -> tuple[int, int]:
    """Read an integer of 1 to 9 bytes, and where it ends."""
    value = 0
    for place in range(at, at + 8):
        value = value << 7 | page[place] & 0x7F
        if page[place] < 0x80:
            return value, place + 1
    return value << 8 | page[at + 8], at + 9


def _read_integer(page: bytes, at: int, kind: int) -> tuple[int, int]:
    """Read an integer of some type, and where it ends."""
    value = page[at : at + _WIDTHS[kind]]
    return int.from_bytes(value, "big", signed=True) + (kind == _ONE), at + len(value)
