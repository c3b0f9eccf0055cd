"""Numbers that are parsed many at a time are what Python's float makes of them one by one."""

import struct
from contextlib import suppress
from decimal import Decimal
from itertools import count

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from occmap import values
from occmap.readers import decimals
from occmap.readers.decimals import NUMBER, OTHER, RANGE, SAME, TIME, parse_words
from occmap.readers.text_log import make_block
from occmap.types import Float64
from occmap.values import as_float32, parse_time

SECONDS = TIME + values.SECONDS
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


def parse(
    lines: list[bytes], separator: bytes, kinds: list[int]
) -> tuple[decimals.Words, dict[int, str]]:
    """Parse the lines that are like the first; a RANGE is that of the next beam."""
    block = make_block(1, b"".join(line + b"\n" for line in lines))
    beams = count()
    of_words = np.array([kind + next(beams) if kind == RANGE else kind for kind in kinds])
    return parse_words(block.text, block.starts[:-1], separator, of_words, [""] * len(kinds))


def find_sound(lines: list[bytes], separator: bytes, kinds: list[int]) -> list[int]:
    """Say which of some lines, all of which are alike, can be read."""
    words, faults = parse(lines, separator, kinds)
    assert words.alike.tolist() == list(range(len(lines)))
    return [at for at in range(len(lines)) if at not in faults]


def to_bytes(values: Float64) -> list[bytes]:
    """Each float exactly, -0.0 apart from 0.0"""
    return [struct.pack("<d", value) for value in values.ravel().tolist()]


@pytest.mark.parametrize("separator", [",", " ", "  "])
@given(st.lists(NUMBERS, min_size=1, max_size=9), st.integers(0, 2))
@settings(max_examples=150)
@example(["9007199254740993", "999999999999999", "0.1", ".5", "5.", "-0", "123456."], 1)
@example(["1.23456", "inf", "-inf", "nan", "-nan"], 0)
@example(["1.25", "2.50", "0.01", "9.99", "1.2", "8", "9", "10"], 0)
def test_every_number_is_the_nearest_float(separator: str, words: list[str], head: int) -> None:
    line = separator.join([*["x"] * head, *words]).encode()
    floats = list(map(float, words))

    kinds = [OTHER] * head
    as_numbers, _ = parse([line, line], separator[:1].encode(), kinds + [NUMBER] * len(words))
    as_ranges, _ = parse([line, line], separator[:1].encode(), kinds + [RANGE] * len(words))

    values, ranges = as_numbers.numbers[head:], as_ranges.ranges
    assert to_bytes(values.T) == 2 * [struct.pack("<d", each) for each in floats]
    assert ranges.tobytes() == 2 * as_float32(floats).tobytes()


@pytest.mark.parametrize(
    "word",
    ["-", "1_0", "one", "1 2", "1.2.3", "--1", "1-2", "0x10", "\u0661", "3:25", "p.25", "\x10.25"],
)
@pytest.mark.parametrize("at", range(3))
@pytest.mark.parametrize("kind", [NUMBER, RANGE])
def test_a_line_with_a_word_few_programs_write_is_left_out(word: str, at: int, kind: int) -> None:
    words = ["1.5", "2", "2.25"]
    words[at] = word
    lines = [b"3.5,2,1.25", ",".join(words).encode(), b"3.5,2,1.25"]
    assert find_sound(lines, b",", 3 * [kind]) == [0, 2]


def test_an_empty_cell_is_nan_between_commas_and_nothing_between_blanks() -> None:
    values, _ = parse([b",2,", b"1.5, ,inf"], b",", 3 * [NUMBER])
    expected = np.array([[np.nan, 2, np.nan], [1.5, np.nan, np.inf]])
    np.testing.assert_array_equal(values.numbers, expected.T)
    ranges, _ = parse([b",2,", b"1.5, ,inf"], b",", 3 * [RANGE])
    np.testing.assert_array_equal(ranges.ranges, expected)
    assert parse([b"1  -inf "], b" ", 2 * [RANGE])[0].ranges.tolist() == [[1.0, -np.inf]]


def test_blanks_behind_a_number_say_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("occmap.readers.decimals._parse_word", None)  # none is left to Python
    text = b" 1.5 ,2\t, 3 \r ,-4. \n"
    starts, kinds = np.array([0]), np.array([RANGE, NUMBER, SECONDS, RANGE + 1])
    words, faults = parse_words(text, starts, b",", kinds, [""] * 4)
    assert not faults
    assert words.ranges.tolist() == [[1.5, -4]]
    assert (words.numbers[1, 0], words.times[2, 0]) == (2, 3 * 10**9)


@pytest.mark.parametrize("word", ["", "1.2.3", "one", "1 2", "9999999999"])
def test_some_words_are_no_times(word: str) -> None:
    assert find_sound([b"1,2", f"1,{word}".encode()], b",", [SAME, SECONDS]) == [0]


def test_quotes_around_a_word_say_nothing() -> None:
    lines = [b'"1.5","2","3"', b'1.5",2,"']
    words, faults = parse(lines, b",", [RANGE, NUMBER, SECONDS])
    assert faults.keys() == {1}
    assert (words.ranges[0, 0], words.numbers[1, 0], words.times[2, 0]) == (1.5, 2, 3 * 10**9)


@pytest.mark.parametrize(
    "line",
    [b"a 1 2", b"a 1 2 ", b"a", b"", b"   ", b"a 1 2 3 4", b"a 1 2 3 x", b"a 1.5 2.5", b"b 1 2 3"],
)
@pytest.mark.parametrize("kind", [NUMBER, RANGE])
def test_a_line_with_other_words_is_passed_over(line: bytes, kind: int) -> None:
    sound = b"a 1.5 2.5 3.5"
    lines = [sound, sound, line, b"a 1.5 2.5 x", sound]
    words, faults = parse(lines, b" ", [SAME, kind, kind, kind])
    assert words.alike.tolist() == [0, 1, 3, 4]
    assert faults.keys() == {2}
    assert len(words.ranges) == 4


def test_not_all_lines_are_tried_for_the_few_that_are_alike() -> None:
    few, _ = parse([b"a 1", *[b"b 1"] * 99, b"a 1"], b" ", [SAME, RANGE])
    assert few.alike.tolist() == [0]
    half, _ = parse([b"a 1", b"b 1"] * 50, b" ", [SAME, RANGE])
    assert half.alike.tolist() == list(range(0, 100, 2))


@pytest.mark.parametrize("separator", [b" ", b","])
def test_words_that_are_written_in_rare_ways_are_read_in_turn(separator: bytes) -> None:
    lines = [separator.join([b"+1.5", b"2e0", b"INF", b"1e1"])] * 50
    at = 0
    while at < len(lines):
        words, faults = parse(lines[at:], separator, [RANGE, RANGE, NUMBER, SECONDS])
        assert not faults
        assert words.alike.tolist() == list(range(max(len(words.ranges), 1)))
        assert {tuple(row) for row in words.ranges.tolist()} == {(1.5, 2)}
        assert set(words.times[3].tolist()) == {10**10}
        at += len(words.ranges)


STAMPS = st.decimals(-(10**9), 10**10, allow_nan=False, places=12)


@given(st.lists(st.tuples(STAMPS, st.integers(0, 12)), min_size=1, max_size=9))
@example([("9223372036.854775807", 9), ("8999999999.999999999", 9), ("0", 0), ("9999999999", 0)])
def test_times_of_many_lines_are_those_of_each(stamps: list[tuple[Decimal, int]]) -> None:
    words = [f"{Decimal(seconds):.{places}f}" for seconds, places in stamps]
    whole = [str(int(Decimal(seconds) * 10**8)) for seconds, _ in stamps]
    lines = [f"{word} x {each}".encode() for word, each in zip(words, whole, strict=True)]
    read, faults = parse(lines, b" ", [SECONDS, OTHER, TIME])
    for row, (word, each) in enumerate(zip(words, whole, strict=True)):
        expected = None
        with suppress(ValueError):
            expected = parse_time(word)
        if row in faults:
            assert expected is None
        else:
            assert read.times[[0, 2], row].tolist() == [expected, int(each)]
