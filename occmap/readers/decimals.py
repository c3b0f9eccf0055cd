"""Decimal numbers and times in text, parsed many at a time.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.

Offsets are unsigned: numba need not look whether one of them counts from the end of an array.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.readers.text_log import ANY, NUMBER, RANGE, SAME, SECONDS, Block, Pattern, Table
from occmap.types import Bool, Float32, Float64, Int64, UInt8
from occmap.values import as_float32, parse_nanoseconds, parse_seconds, shorten

NUMBER_CHARACTERS = b"+-.0123456789Ee naif"
"""What programs write numbers with; of others, such as 1_0, Python and NumPy think differently."""
MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_TIME_DIGITS = 19
"""Whole nanoseconds of this many digits fit 64 bits where the first is not 9."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _QUOTE, _END = map(ord, '09.- "\n')
_INF, _NAN = (np.frombuffer(word, np.uint8) for word in (b"inf", b"nan"))
_NONE, _ONE = np.uint64(0), np.uint64(1)
_READ, _LEFT, _UNLIKE = range(3)
"""What becomes of a word: it is left to the caller, or its line is not like the others."""


class Lines(NamedTuple):
    """Lines to parse, and what their words are."""

    text: UInt8
    """(L,) bytes: lines, each with its end, and `PADDING`"""
    starts: Int64
    """(S,) where the lines begin that are parsed"""
    separator: int
    """What stands between two words: one comma, or any number of blanks"""
    kinds: UInt8
    """(N,) what each word of a line is"""
    words: UInt8
    """The words of a line like these, one behind the other"""
    ends: Int64
    """(N,) where each of them ends"""
    places: Int64
    """(N,) which beam each word is, counted from 0, where it is one"""


class Filled(NamedTuple):
    """What is filled with the words of S lines that hold N each."""

    ranges: Float32
    """(S, B); NaN where nothing stands between two commas"""
    values: Float64
    """(N, S) other numbers, likewise"""
    times: Int64
    """(N, S) ns"""
    alike: Bool
    """(S,) whether a line has N words, each parsed or left to the caller"""
    left: Int64
    """(M, 4) row, column, start and end of each word that is left to the caller"""


class Word(NamedTuple):
    """A word as far as it reads like a decimal number."""

    start: np.uint64
    end: np.uint64
    number: np.int64
    """That all its digits make"""
    digits: np.uint64
    """How many these are; 0 where anything but a minus, digits and a dot is in the word"""
    decimals: np.uint64
    """How many of the digits stand behind the dot"""


def parse_table(block: Block, rows: Int64, pattern: Pattern) -> Table:
    """Parse those of some lines, by their indices (S,), that are of a pattern."""
    words, separator, kinds = pattern
    rows = rows[: len(block.text) // len(kinds)]  # no more lines can have so many words
    values = np.empty((len(kinds), len(rows)))
    filled = Filled(
        ranges=np.empty((len(rows), np.count_nonzero(kinds == RANGE)), np.float32),
        values=values,
        times=values.view(np.int64),
        alike=np.zeros(len(rows), np.bool_),
        # With more words than this for the caller, lines are parsed as quickly one by one.
        left=np.empty((values.size // 8 + 64, 4), np.int64),
    )
    lines = Lines(
        text=np.frombuffer(block.text, np.uint8),
        starts=block.starts[rows],
        separator=ord(separator),
        kinds=kinds,
        words=np.frombuffer(b"".join(words), np.uint8),
        ends=np.cumsum([len(word) for word in words]),
        places=np.cumsum(kinds == RANGE) - 1,
    )
    left = parse_rows(lines, filled)
    _parse_left(block.text, lines, filled, left)
    alike, ranges = filled.alike, filled.ranges
    if not alike.all():
        rows, ranges, values = rows[alike], ranges[alike], values[:, alike]
    return Table(rows, ranges, values, values.view(np.int64))


def _parse_left(text: bytearray, lines: Lines, filled: Filled, left: int) -> None:
    """Parse the words that the kernel left, so many; a line with a malformed one is not alike."""
    for row, col, start, end in filled.left[:left].tolist():
        word, kind = bytes(text[start:end]), lines.kinds[col]
        try:
            if kind == RANGE:
                filled.ranges[row, lines.places[col]] = as_float32(_parse_number(word))
            elif kind == NUMBER:
                filled.values[col, row] = _parse_number(word)
            else:
                parse = parse_seconds if kind == SECONDS else parse_nanoseconds
                filled.times[col, row] = parse(word.decode("utf-8", "replace"))
        except ValueError:
            filled.alike[row] = False


@lru_cache(maxsize=64)
def _parse_number(word: bytes) -> float:
    """Parse a number that the kernel leaves; cached, as many logs repeat a few in every line."""
    if word.translate(None, NUMBER_CHARACTERS):
        raise ValueError(f"{shorten(word.decode(errors='replace'))} where a number belongs")
    return float(word.strip() or "nan")


@kernel
def parse_rows(lines: Lines, filled: Filled) -> int:
    """Parse the words of lines; a line that holds more or fewer words than others is unlike them.

    So is one for whose words `left` has no more room.

    Returns
    -------
    int
        How many words are left to the caller.
    """
    text, separator, left, lefts = lines.text, lines.separator, filled.left, 0
    for row in range(len(lines.starts)):
        at = _skip_blanks(text, np.uint64(lines.starts[row]), separator)
        for col in range(len(lines.kinds)):
            word = _scan_word(text, at, separator)
            outcome = _read_word(lines, filled, word, row, col)
            if outcome == _UNLIKE or (outcome == _LEFT and lefts == len(left)):
                break
            if outcome == _LEFT:
                left[lefts, 0], left[lefts, 1] = row, col
                left[lefts, 2], left[lefts, 3] = word.start, word.end
                lefts += 1
            if text[word.end] == _END:
                filled.alike[row] = col == len(lines.kinds) - 1
                break
            at = _skip_blanks(text, word.end + _ONE, separator)
        else:
            filled.alike[row] = separator == _BLANK and text[at] == _END
    return lefts


@step
def _read_word(lines: Lines, filled: Filled, word: Word, row: int, col: int) -> int:
    """Put a word where its line and its kind say; tell whether it is read."""
    text, kind, is_read = lines.text, lines.kinds[col], True
    if word.start == word.end and lines.separator == _BLANK:
        return _UNLIKE  # the line has no more words
    if kind == RANGE:
        is_read, filled.ranges[row, lines.places[col]] = _to_float(text, word)
    elif kind == NUMBER:
        is_read, filled.values[col, row] = _to_float(text, word)
    elif kind == SAME:
        return _READ if _is_same(lines, word, col) else _UNLIKE
    elif kind == ANY:
        return _UNLIKE if _has_quote(text, word) else _READ  # it may hold a separator
    else:
        is_read, filled.times[col, row] = _to_ns(text, word, kind)
    return _READ if is_read else _LEFT


@step
def _skip_blanks(text: UInt8, at: np.uint64, separator: int) -> np.uint64:
    """Where the next word begins; between commas each byte is part of a word."""
    while separator == _BLANK and text[at] == _BLANK:
        at += _ONE
    return at


@step
def _scan_word(text: UInt8, start: np.uint64, separator: int) -> Word:
    """Read a word up to its separator or the end of its line."""
    first = start + np.uint64(text[start] == _MINUS)
    at, number = _scan_digits(text, first, np.int64(0))
    digits, decimals = at - first, _NONE
    if text[at] == _DOT:
        dot = at
        at, number = _scan_digits(text, dot + _ONE, number)
        decimals = at - dot - _ONE
        digits += decimals
    while text[at] != separator and text[at] != _END:
        digits = _NONE
        at += _ONE
    return Word(start, at, number, digits, decimals)


@step
def _scan_digits(text: UInt8, at: np.uint64, number: np.int64) -> tuple[np.uint64, np.int64]:
    """Go on behind some digits, given and giving the number that all before make."""
    while _ZERO <= text[at] <= _NINE:
        number = number * 10 + (text[at] - _ZERO)
        at += _ONE
    return at, number


@step
def _is_same(lines: Lines, word: Word, col: int) -> bool:
    """Whether a word is the one of every line."""
    start, end = np.uint64(lines.ends[col - 1] if col else 0), np.uint64(lines.ends[col])
    size = end - start
    at = _NONE
    while at < size and lines.text[word.start + at] == lines.words[start + at]:
        at += _ONE
    return bool(at == size and word.end - word.start == size)


@step
def _has_quote(text: UInt8, word: Word) -> bool:
    at = word.start
    while at < word.end and text[at] != _QUOTE:
        at += _ONE
    return bool(at < word.end)


@step
def _to_float(text: UInt8, word: Word) -> tuple[bool, float]:
    """Whether a word is a number that is read here, and which."""
    is_negative = text[word.start] == _MINUS
    value = np.nan
    if _NONE < word.digits <= MOST_DIGITS:
        value = word.number / POWERS[word.decimals]
    elif _is_name(text, word, is_negative, _INF):
        value = np.inf
    elif word.start < word.end and not _is_name(text, word, is_negative, _NAN):
        return False, value
    return True, -value if is_negative else value


@step
def _is_name(text: UInt8, word: Word, is_negative: bool, name: UInt8) -> bool:
    """Whether a word is a name such as inf, behind a minus or without."""
    at, size = word.start + np.uint64(is_negative), 0
    while size < len(name) and text[at + np.uint64(size)] == name[size]:
        size += 1
    return bool(size == len(name) and word.end - at == size)


@step
def _to_ns(text: UInt8, word: Word, kind: int) -> tuple[bool, np.int64]:
    """Whether a word is a time that is read here, and which (ns)."""
    number, size = word.number, np.int64(word.digits)
    more = 9 - np.int64(word.decimals) if kind == SECONDS else 0
    has_sign = text[word.start] == _MINUS
    is_whole = kind == SECONDS or word.end - word.start == word.digits
    most = MOST_TIME_DIGITS - more - (text[word.start] == _NINE)
    is_read = bool(is_whole and not has_sign and more >= 0 and 0 < size <= most)
    for _ in range(more if is_read else 0):
        number *= 10
    return is_read, number
