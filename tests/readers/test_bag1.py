"""Messages of a block of records are those that were written, in any order of their fields."""

import struct
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers import NoteList
from occmap.readers.bag1 import CONNECTION, MESSAGE, Bag1Source

Found = tuple[int, int, bytes]

ORDERS = (("conn", "op", "time"), ("op", "conn", "time"), ("time", "extra", "conn", "op"))
NO_TIME = ("conn", "op")
TWICE = ("conn", "op", "time", "op")
WANTED = range(2**31)
RECORDS = st.lists(
    st.tuples(
        st.sampled_from([*ORDERS, *ORDERS, NO_TIME, TWICE]),
        st.sampled_from([MESSAGE, MESSAGE, MESSAGE, CONNECTION]),
        st.integers(0, 2**32 - 1),
        st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 999_999_999)),
        st.binary(max_size=5),
    ),
    max_size=8,
)


class Blocks(Bag1Source):
    """Splits blocks that lie in no file."""

    def __init__(self) -> None:
        self.notes = NoteList()
        self._cut_at = -1

    def list_wanted(self, block: bytes, wanted: Sequence[int]) -> list[Found]:
        found = self._list_records(0, memoryview(block)).tolist()
        return [
            (key, time, block[start:end]) for key, time, _, start, end in found if key in wanted
        ]


def write(
    order: Sequence[str], opcode: int, connection: int, time: tuple[int, int], data: bytes
) -> bytes:
    values = {
        "op": bytes([opcode]),
        "conn": struct.pack("<I", connection),
        "time": struct.pack("<II", *time),
        "extra": b"(.*=",
    }
    fields = b"".join(
        struct.pack("<I", len(name) + 1 + len(values[name])) + name.encode() + b"=" + values[name]
        for name in order
    )
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


@given(RECORDS, st.integers(0, 30))
@settings(max_examples=100)
def test_messages_are_those_that_were_written(
    records: list[tuple[Sequence[str], int, int, tuple[int, int], bytes]], cut: int
) -> None:
    block = b"".join(write(*record) for record in records)
    block = block[: len(block) - cut]
    expected: list[Found] = []
    damaged = []
    end = 0
    for order, opcode, connection, (seconds, nanoseconds), data in records:
        start, end = end, end + len(write(order, opcode, connection, (seconds, nanoseconds), data))
        is_whole = end <= len(block)
        is_wanted = opcode == MESSAGE and connection in WANTED
        if is_wanted and is_whole and "time" in order:
            time = seconds * 1_000_000_000 + nanoseconds
            expected.append((connection, time, data))
        elif start < len(block) and (not is_whole or is_wanted):
            damaged.append(start)
    source = Blocks()

    assert source.list_wanted(block, WANTED) == expected
    assert source.notes or not damaged


@pytest.mark.parametrize("order", ORDERS)
def test_a_message_has_its_connection_time_and_data(order: Sequence[str]) -> None:
    block = b"".join(write(order, MESSAGE, 7 + i, (i, 5), b"data%d" % i) for i in range(3))

    assert Blocks().list_wanted(block, range(10)) == [
        (7, 5, b"data0"),
        (8, 1_000_000_005, b"data1"),
        (9, 2_000_000_005, b"data2"),
    ]


def test_a_damaged_time_of_another_connection_ends_nothing() -> None:
    other = write(NO_TIME, MESSAGE, 8, (0, 0), b"")
    block = other + write(ORDERS[0], MESSAGE, 7, (1, 0), b"data")
    assert [connection for connection, *_ in Blocks().list_wanted(block, range(8))] == [7]
