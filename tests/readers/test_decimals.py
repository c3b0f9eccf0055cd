"""Numbers that are parsed many at a time are what Python's float makes of them one by one."""

import struct
from contextlib import suppress
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from occmap.readers.decimals import NUMBER, OTHER, RANGE, Words, parse_words
from occmap.readers.text_log import make_block
from occmap.types import Float64
from occmap.values import as_float32, parse_seconds

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


def parse(lines: list[bytes], separator: bytes, kinds: list[int]) -> Words:
    """Parse all of some lines."""
    block = make_block(1, b"".join(line + b"\n" for line in lines))
    return parse_words(block.text, block.starts[:-1], separator, np.array(kinds, np.uint8))


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
    values = parse([line, line], separator[:1].encode(), kinds + [NUMBER] * len(words)).numbers
    ranges = parse([line, line], separator[:1].encode(), kinds + [RANGE] * len(words)).ranges

    assert to_bytes(values[head:].T) == 2 * [struct.pack("<d", each) for each in floats]
    assert ranges.tobytes() == 2 * as_float32(floats).tobytes()


FORMS = st.sampled_from(["{:.2f}", "{:.2f}", "{:.3f}", "{:.0f}", "{:.6f}", "{:g}", "{}"])


@given(st.lists(st.tuples(st.floats(0, 100), FORMS), min_size=2, max_size=60), st.booleans())
@settings(max_examples=300)
def test_ranges_of_changing_forms_are_the_nearest_float32(
    written: list[tuple[float, str]], by_commas: bool
) -> None:
    words = [form.format(value) for value, form in written]
    separator = "," if by_commas else " "
    lines = [separator.join(each).encode() for each in (words, words[::-1], words)]

    ranges = parse(lines, separator.encode(), [RANGE] * len(words)).ranges

    np.testing.assert_array_equal(ranges[0], np.array([float(w) for w in words], np.float32))
    np.testing.assert_array_equal(ranges, [ranges[0], ranges[0][::-1], ranges[0]])


@pytest.mark.parametrize("word", ["", "1_0", "one", "1 2", "1.2.3", "--1", "1-2", "0x10", "\u0661"])
@pytest.mark.parametrize("at", range(3))
@pytest.mark.parametrize("kind", [NUMBER, RANGE])
def test_a_line_with_a_word_that_few_programs_write_is_left_out(
    word: str, at: int, kind: int
) -> None:
    words = ["1.5", "2", "2.25"]
    words[at] = word or "-"
    lines = [b"3.5,2,1.25", ",".join(words).encode(), b"3.5,2,1.25"]
    assert parse(lines, b",", 3 * [kind]).is_sound.tolist() == [True, False, True]


@pytest.mark.parametrize("word", ["3:25", "3.2?", "p.25", "3.2p", "3,25", "\x10.25"])
def test_a_word_that_only_looks_like_those_before_it_is_no_number(word: str) -> None:
    sound = b"1.25,2.25,3.25,4.25,5.25"
    line = sound.replace(b"3.25", word.encode())
    assert parse([sound, line, sound], b",", 5 * [RANGE]).is_sound.tolist() == [True, False, True]


def test_an_empty_cell_is_nan_between_commas_and_nothing_between_blanks() -> None:
    values = parse([b",2,", b"1.5, ,inf"], b",", 3 * [NUMBER]).numbers
    np.testing.assert_array_equal(values, [[np.nan, 1.5], [2, np.nan], [np.nan, np.inf]])
    ranges = parse([b",2,", b"1.5, ,inf"], b",", 3 * [RANGE]).ranges
    np.testing.assert_array_equal(ranges, [[np.nan, 2, np.nan], [1.5, np.nan, np.inf]])
    assert parse([b"1  -inf "], b" ", 2 * [RANGE]).ranges.tolist() == [[1.0, -np.inf]]


@pytest.mark.parametrize(
    "line",
    [b"a 1 2", b"a 1 2 ", b"a", b"", b"   ", b"a 1 2 3 4", b"a 1 2 3 x", b"a 1.5 2.5"],
)
@pytest.mark.parametrize("kind", [NUMBER, RANGE])
def test_a_line_with_too_few_or_too_many_words_is_left_out(line: bytes, kind: int) -> None:
    sound = b"a 1.5 2.5 3.5"
    words = parse([sound, line, sound], b" ", [OTHER, kind, kind, kind])
    assert words.is_sound.tolist() == [True, False, True]


@pytest.mark.parametrize("line", [b"b,1", b"aa,1", b"a ,1", b",1", b"a"])
def test_a_line_in_which_a_word_differs_that_is_the_same_is_left_out(line: bytes) -> None:
    words = parse([b"a,1", line, b"a,2"], b",", [OTHER, NUMBER])
    words.refuse_others([0])
    assert words.is_sound.tolist() == [True, False, True]
    assert words.numbers[1, ::2].tolist() == [1, 2]


STAMPS = st.decimals(-(10**9), 10**10, allow_nan=False, places=12)


@given(st.lists(st.tuples(STAMPS, st.integers(0, 12)), min_size=1, max_size=9))
@example([("9223372036.854775807", 9), ("8999999999.999999999", 9), ("0", 0)])
def test_times_of_many_lines_are_those_of_each(stamps: list[tuple[Decimal, int]]) -> None:
    words = [f"{Decimal(seconds):.{places}f}" for seconds, places in stamps]
    whole = [str(int(Decimal(seconds) * 10**8)) for seconds, _ in stamps]
    lines = [f"{word} x {each}".encode() for word, each in zip(words, whole, strict=True)]
    words_read = parse(lines, b" ", [OTHER] * 3)
    times = words_read.read_times(0, 9), words_read.read_times(2, 0)
    for row in np.flatnonzero(words_read.is_sound).tolist():
        assert [times[0][row], times[1][row]] == [parse_seconds(words[row]), int(whole[row])]
    for row, word in enumerate(words):
        is_plain = len(word.partition(".")[2]) <= 9 and len(word.strip("-").replace(".", "")) <= 19
        with suppress(ValueError):
            parse_seconds(word)
            assert words_read.is_sound[row] or not is_plain


@pytest.mark.parametrize("word", ["", "1.2.3", "one", "1 2", "9999999999"])
def test_a_line_with_a_word_that_is_no_time_is_left_out(word: str) -> None:
    words = parse([f"1,{word}".encode()], b",", [NUMBER, OTHER])
    words.read_times(1, 9)
    assert not words.is_sound.any()


@given(st.decimals(-(10**9), 10**10, allow_nan=False, places=12), st.integers(0, 12))
@example(Decimal("9223372037"), 0)
def test_a_stamp_is_exact_to_the_nanosecond(seconds: object, places: int) -> None:
    text = f"{seconds:.{places}f}"
    digits, _, part = text.lstrip("-").partition(".")
    nanoseconds = int(digits + part[:9].ljust(9, "0"))
    if nanoseconds >= 2**63 - 1:
        with pytest.raises(ValueError, match="not a time"):
            parse_seconds(text)
        return
    assert abs(abs(parse_seconds(text)) - nanoseconds) <= (places > 9)
