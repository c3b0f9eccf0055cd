"""Numbers that are parsed many at a time are what Python's float makes of them one by one."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from occmap.readers.text import parse_stamp, parse_table
from occmap.types import Float64

WHOLE = st.text("0123456789", max_size=9)
WRITTEN = st.builds("{}{}.{}".format, st.sampled_from(["", "-", "+"]), WHOLE, WHOLE)
FLOATS = st.floats(allow_nan=False)
NUMBERS = st.one_of(
    WRITTEN.filter(lambda text: any(map(str.isdigit, text))),
    FLOATS.map(repr),
    FLOATS.map("{:.3f}".format),
    FLOATS.map("{:.17e}".format),
    st.integers(-(10**20), 10**20).map(str),
)


def to_bytes(values: Float64) -> list[bytes]:
    """Each float exactly, -0.0 apart from 0.0"""
    return [struct.pack("<d", value) for value in values.ravel().tolist()]


@pytest.mark.parametrize("separator", [",", " ", "  "])
@given(st.lists(NUMBERS, min_size=1, max_size=9), st.integers(0, 2))
@settings(max_examples=150, deadline=None)
@example(["9007199254740993", "999999999999999", "0.1", ".5", "5.", "-0", "123456.", "1.23456"], 1)
def test_every_number_is_the_nearest_float(separator: str, words: list[str], head: int) -> None:
    line = separator.join([*["x"] * head, *words]).encode()

    table = parse_table([line, line], separator[:1].encode(), head, len(words))

    assert to_bytes(table.values) == 2 * [struct.pack("<d", float(word)) for word in words]
    start = len(line) - len(separator.join(words))
    assert (table.places[:, 1] == len(line)).all()
    assert set(line[: table.places[0, 0]].replace(b"x", b"")) <= set(separator.encode())
    assert table.places[0, 0] <= start


@pytest.mark.parametrize("word", ["", "1_0", "one", "1 2", "1.2.3", "--1", "1-2", "0x10", "\u0661"])
@pytest.mark.parametrize("at", range(3))
def test_what_few_programs_write_is_refused(word: str, at: int) -> None:
    words = ["1.5", "2", "2.25"]
    words[at] = word or "-"
    with pytest.raises(ValueError, match=r"number|float"):
        parse_table([",".join(words).encode()], b",", 0, 3)


def test_an_empty_cell_is_nan_between_commas_and_nothing_between_blanks() -> None:
    values = parse_table([b",2,", b"1.5, ,inf"], b",", 0, 3).values
    np.testing.assert_array_equal(values, [[np.nan, 2, np.nan], [1.5, np.nan, np.inf]])
    assert parse_table([b"1  -inf nan"], b" ", 0, 2).values.tolist() == [[1.0, -np.inf]]


@pytest.mark.parametrize("line", [b"a 1 2", b"a 1 2 ", b"a", b"", b"   "])
def test_a_line_with_too_few_numbers_is_refused(line: bytes) -> None:
    with pytest.raises(ValueError, match="number"):
        parse_table([b"a 1 2 3", line], b" ", 1, 3)


def test_places_are_those_within_each_line() -> None:
    table = parse_table([b"x 1.5 2 z", b"long 1 2 and more"], b" ", 1, 2)
    assert table.places.tolist() == [[2, 7], [5, 8]]


@given(st.decimals(-(10**9), 10**10, allow_nan=False, places=12), st.integers(0, 12))
def test_a_stamp_is_exact_to_the_nanosecond(seconds: object, places: int) -> None:
    text = f"{seconds:.{places}f}"
    digits, _, part = text.lstrip("-").partition(".")
    nanoseconds = int(digits + part[:9].ljust(9, "0"))
    if nanoseconds >= 2**63 - 1:
        with pytest.raises(ValueError, match="no time"):
            parse_stamp(text)
        return
    assert abs(abs(parse_stamp(text)) - nanoseconds) <= (places > 9)
