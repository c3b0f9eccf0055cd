"""Numbers that are parsed many at a time are what Python's float makes of them one by one."""

import struct
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from occmap.readers.kernels import ANY, NANOSECONDS, NUMBER, SECONDS
from occmap.readers.text import Block, Table, parse_stamp, parse_table
from occmap.types import Float64

WHOLE = st.text("0123456789", max_size=9)
WRITTEN = st.builds("{}{}.{}".format, st.sampled_from(["", "-", "+"]), WHOLE, WHOLE)
FLOATS = st.floats()
NUMBERS = st.one_of(
    WRITTEN.filter(lambda text: any(map(str.isdigit, text))),
    FLOATS.map(repr),
    FLOATS.map("{:.3f}".format),
    FLOATS.map("{:.17e}".format),
    st.integers(-(10**20), 10**20).map(str),
)


def parse(lines: list[bytes], separator: bytes, kinds: list[int]) -> Table:
    """Parse all of some lines."""
    block = Block.of(1, [line + b"\n" for line in lines])
    return parse_table(block, np.arange(len(lines)), separator, np.array(kinds, np.uint8))


def to_bytes(values: Float64) -> list[bytes]:
    """Each float exactly, -0.0 apart from 0.0"""
    return [struct.pack("<d", value) for value in values.ravel().tolist()]


@pytest.mark.parametrize("separator", [",", " ", "  "])
@given(st.lists(NUMBERS, min_size=1, max_size=9), st.integers(0, 2))
@settings(max_examples=150, deadline=None)
@example(["9007199254740993", "999999999999999", "0.1", ".5", "5.", "-0", "123456."], 1)
@example(["1.23456", "inf", "-inf", "nan", "-nan"], 0)
def test_every_number_is_the_nearest_float(separator: str, words: list[str], head: int) -> None:
    line = separator.join([*["x"] * head, *words]).encode()

    kinds = [ANY] * head + [NUMBER] * len(words)
    values, _ = parse([line, line], separator[:1].encode(), kinds)

    assert to_bytes(values[:, head:]) == 2 * [struct.pack("<d", float(word)) for word in words]


@pytest.mark.parametrize("word", ["", "1_0", "one", "1 2", "1.2.3", "--1", "1-2", "0x10", "\u0661"])
@pytest.mark.parametrize("at", range(3))
def test_what_few_programs_write_is_refused(word: str, at: int) -> None:
    words = ["1.5", "2", "2.25"]
    words[at] = word or "-"
    with pytest.raises(ValueError, match=r"number|float"):
        parse([",".join(words).encode()], b",", 3 * [NUMBER])


def test_an_empty_cell_is_nan_between_commas_and_nothing_between_blanks() -> None:
    values = parse([b",2,", b"1.5, ,inf"], b",", 3 * [NUMBER]).values
    np.testing.assert_array_equal(values, [[np.nan, 2, np.nan], [1.5, np.nan, np.inf]])
    assert parse([b"1  -inf "], b" ", 2 * [NUMBER]).values.tolist() == [[1.0, -np.inf]]


@pytest.mark.parametrize(
    "line", [b"a 1 2", b"a 1 2 ", b"a", b"", b"   ", b"a 1 2 3 4", b"a 1 2 3 x"]
)
def test_a_line_with_too_few_or_too_many_words_is_refused(line: bytes) -> None:
    with pytest.raises(ValueError, match="words"):
        parse([b"a 1 2 3", line], b" ", [ANY, NUMBER, NUMBER, NUMBER])


STAMPS = st.decimals(-(10**9), 10**10, allow_nan=False, places=12)


@given(st.lists(st.tuples(STAMPS, st.integers(0, 12)), min_size=1, max_size=9))
@example([("9223372036.854775807", 9), ("8999999999.999999999", 9), ("0", 0)])
@settings(deadline=None)
def test_times_of_many_lines_are_those_of_each(stamps: list[tuple[Decimal, int]]) -> None:
    words = [f"{Decimal(seconds):.{places}f}" for seconds, places in stamps]
    whole = [str(int(Decimal(seconds) * 10**8)) for seconds, _ in stamps]
    lines = [f"{word} x {each}".encode() for word, each in zip(words, whole, strict=True)]
    try:
        expected = list(map(parse_stamp, words))
    except ValueError:
        with pytest.raises(ValueError, match="no time"):
            parse(lines, b" ", [SECONDS, ANY, NANOSECONDS])
        return
    times = parse(lines, b" ", [SECONDS, ANY, NANOSECONDS]).times
    assert times[:, 0].tolist() == expected
    assert times[:, 2].tolist() == list(map(int, whole))


@pytest.mark.parametrize("word", ["", "1.2.3", "one", "1 2", "9999999999"])
def test_what_is_no_time_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match="no time"):
        parse([f"1,{word}".encode()], b",", [NUMBER, SECONDS])


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
