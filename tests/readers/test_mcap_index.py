"""Messages that are found by the indexes behind a chunk must be those that a walk finds."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.readers.mcap_index import Indexes, Places

ENTRY = struct.Struct("<QQ")
MESSAGES = st.lists(
    st.tuples(st.integers(0, 3), st.integers(5, 9), st.integers(0, 5)), min_size=1, max_size=8
)
"""Channel, time, and how many bytes of its own each has"""


def write_records(messages: list[tuple[int, int, int]]) -> tuple[bytes, list[tuple[int, ...]]]:
    """The records of a chunk; and channel, time, start and end of each message's own bytes."""
    records = b""
    places: list[tuple[int, ...]] = []
    for channel, time_ns, length in messages:
        head = struct.pack("<BQHIQQ", 5, 22 + length, channel, 0, time_ns, 3)
        places.append((channel, time_ns, len(records) + 31, len(records) + 31 + length))
        records += head + b"\x05" * length
    return records, places


def index(places: list[tuple[int, ...]]) -> list[bytes]:
    bodies: dict[int, bytes] = {}
    for channel, time_ns, start, _ in places:
        bodies[channel] = bodies.get(channel, b"") + ENTRY.pack(time_ns, start - 31)
    return [struct.pack("<HI", channel, len(body)) + body for channel, body in bodies.items()]


def find(records: bytes, bodies: list[bytes], last_ns: int = 9) -> Places | None:
    indexes = Indexes()
    for body in bodies:
        indexes.add(body)
    return indexes.find(records, 5, last_ns)


@given(MESSAGES)
def test_what_is_found_is_what_was_written(messages: list[tuple[int, int, int]]) -> None:
    records, places = write_records(messages)

    found = find(records, index(places))

    assert found is not None
    assert list(zip(*(column.tolist() for column in found), strict=True)) == places


@given(MESSAGES, st.data())
def test_an_index_that_is_wrong_in_any_byte_finds_nothing(
    messages: list[tuple[int, int, int]], data: st.DataObject
) -> None:
    records, places = write_records(messages)
    bodies = index(places)
    body = bytearray(data.draw(st.sampled_from(bodies)))
    at = data.draw(st.integers(0, len(body) - 1))
    others = [each for each in bodies if each != body]
    body[at] ^= 1 << data.draw(st.integers(0, 7))

    assert find(records, [bytes(body), *others]) is None


@pytest.mark.parametrize("at", range(9))
def test_a_head_that_is_not_as_the_index_says_finds_nothing(at: int) -> None:
    records, places = write_records([(1, 5, 4), (1, 9, 4)])
    damaged = bytearray(records)
    damaged[at] ^= 4

    assert find(bytes(damaged), index(places)) is None


def test_a_chunk_that_holds_more_than_the_messages_finds_nothing() -> None:
    records, places = write_records([(1, 5, 4), (2, 9, 4), (1, 9, 4)])

    assert find(records + b"\x04", index(places)) is None
    assert find(records, index(places[:2])) is None
    assert find(records, index(places[1:])) is None
    assert find(records, []) is None


def test_a_time_that_the_chunk_does_not_state_finds_nothing() -> None:
    records, places = write_records([(1, 5, 4), (2, 9, 4)])

    assert find(records, index(places), last_ns=9) is not None
    assert find(records, index(places), last_ns=8) is None
