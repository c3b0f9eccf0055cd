"""Words in lines of text, parsed many at a time: numbers, ranges and times.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Words that are
written in another way are left to Python.

Offsets are unsigned: numba need not look whether one of them counts from the end of an array.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.types import Float32, Float64, Int64, UInt8
from occmap.values import SECONDS, as_float32, parse_number, parse_time

OTHER, SAME, NUMBER, TIME = range(4)
RANGE = TIME + SECONDS + 1
"""What a word is: passed over, the same in all lines that are alike, a number, a time, whose unit
is added to TIME, or the range of a beam, whose index is added to RANGE"""
MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_WHOLE_DIGITS = 19
"""An integer of this many digits that does not fit 64 bits becomes negative where it overflows."""
LARGEST = 2**63 - 1
MOST_TRIED = 16
"""For each line that is like the first, so many are looked at: among lines that all differ, each
would else be looked at as often as there are lines."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
SCALES: Int64 = np.array([10**n for n in range(10)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _END = map(ord, "09.- \n")
_TAB, _RETURN = map(ord, "\t\r")
"""The first and the last of the other blanks, as Python splits bytes"""
_INF, _NAN = (np.frombuffer(word, np.uint8) for word in (b"inf", b"nan"))
_NONE, _ONE = np.uint64(0), np.uint64(1)


class Words(NamedTuple):
    """The words of S lines that are alike, N in each."""

    ranges: Float32
    """(S, B); NaN where nothing stands between two commas"""
    numbers: Float64
    """(N, S) other numbers, likewise; by word, since few words of a line are no ranges"""
    times: Int64
    """(N, S) ns; a hash of a word that is the SAME"""
    alike: Int64
    """(S,) which of the lines given these are"""
    left: Int64
    """(M, 4) row, column, start and end of words that the kernel leaves to Python"""

    def take(self, lines: list[int]) -> "Words":
        """Select some of the lines."""
        of_words = self.numbers[:, lines], self.times[:, lines]
        return Words(self.ranges[lines], *of_words, self.alike[lines], self.left)


class Word(NamedTuple):
    """A word as far as it reads like a decimal number."""

    start: np.uint64
    end: np.uint64
    number: np.int64
    """That all its digits make"""
    digits: np.uint64
    """How many these are; 0 where anything but a minus, digits, a dot and then blanks is in it"""
    decimals: np.uint64
    """How many of the digits stand behind the dot"""


def parse_words(
    text: bytes, starts: Int64, separator: bytes, kinds: Int64, names: Sequence[str]
) -> tuple[Words, dict[int, str]]:
    """Parse lines that begin at some places of a text: the first, and those behind it like it.

    A line is not like it that holds more or fewer words, or others where they should be the same.

    Parameters
    ----------
    separator
        What stands between two words: one comma, or any number of blanks.
    kinds, names
        (N,) what each word of a line is, and how a sentence about it begins.

    Returns
    -------
    words, faults
        Of the lines that are alike, and what is wrong with some of them.
    """
    starts = starts[: len(text) // len(kinds) + 1]  # no more lines can have so many words
    shape = len(kinds), len(starts)
    words = Words(
        ranges=np.empty((len(starts), np.count_nonzero(kinds >= RANGE)), np.float32),
        numbers=np.empty(shape),
        times=np.empty(shape, np.int64),
        alike=np.empty(len(starts), np.int64),
        # Room for all words of the first line: with many more, others wait for their turn.
        left=np.empty((len(kinds) * (1 + len(starts) // 8) + 64, 4), np.int64),
    )
    source = np.frombuffer(text, np.uint8)
    lines, lefts = parse_rows(source, starts, (ord(separator), kinds), words)
    faults: dict[int, str] = {}
    for row, col, start, end in words.left[:lefts].tolist():
        kind = int(kinds[col])
        try:
            value = _parse_word(text[start:end], min(kind, RANGE))
        except ValueError as error:
            faults.setdefault(row, f"{names[col]}{error}")
            continue
        if kind >= RANGE:
            words.ranges[row, kind - RANGE] = as_float32(value)
        elif isinstance(value, int):
            words.times[col, row] = value
        else:
            words.numbers[col, row] = value
    if lines < len(starts):  # copied, so that few lines do not keep the room for all
        words = words.take(list(range(lines)))
    return words, faults


@lru_cache(maxsize=64)
def _parse_word(word: bytes, kind: int) -> float | int:
    """Parse a word that the kernel leaves; cached, as many logs repeat a few in every line."""
    text = unquote(word)
    return parse_time(text, kind - TIME) if TIME <= kind < RANGE else parse_number(text or "nan")


def unquote(word: bytes) -> str:
    """Read a word as text without its blanks and quotes; U+FFFD is what is no UTF-8."""
    text = word.strip().decode("utf-8", "replace")
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] == '"' else text


@kernel
def parse_rows(
    text: UInt8, starts: Int64, form: tuple[int, Int64], words: Words
) -> tuple[int, int]:
    """Parse the words of the lines that are like the first.

    Parameters
    ----------
    form
        What stands between two words, and what each word is.

    Returns
    -------
    lines, lefts
        How many lines are alike, and how many of their words are left.
    """
    lines = lefts = 0
    for row in range(len(starts)):
        if row > MOST_TRIED * lines:
            break
        found = _read_line(text, np.uint64(starts[row]), form, (lines, lefts), words)
        if found >= 0:
            words.alike[lines] = row
            lines += 1
            lefts = found
    return lines, lefts


@step
def _read_line(
    text: UInt8, start: np.uint64, form: tuple[int, Int64], place: tuple[int, int], words: Words
) -> int:
    """Read a line that is like others: how many words are left then.

    It is -1 where the line is not like them, or `left` has no more room for its words.
    """
    (separator, kinds), (row, lefts) = form, place
    at = _skip_blanks(text, start)
    for col in range(len(kinds)):
        word = _scan_word(text, at, separator)
        if not _read_word(text, word, kinds[col], (row, col), words):
            if kinds[col] == SAME or lefts == len(words.left):
                return -1
            words.left[lefts, 0], words.left[lefts, 1] = row, col
            words.left[lefts, 2], words.left[lefts, 3] = word.start, word.end
            lefts += 1
        at = word.end
        if text[at] != _END:
            at = _skip_blanks(text, at + _ONE)
        is_last = text[word.end] == _END or (separator == _BLANK and text[at] == _END)
        if is_last != (col == len(kinds) - 1):
            return -1
    return lefts


@step
def _read_word(text: UInt8, word: Word, kind: int, place: tuple[int, int], words: Words) -> bool:
    """Whether a word is read here as what it is, or is the same as in the first line."""
    row, col = place
    is_read = True
    if kind >= RANGE:
        is_read, words.ranges[row, kind - RANGE] = _to_float(text, word)
    elif kind == NUMBER:
        is_read, words.numbers[col, row] = _to_float(text, word)
    elif kind >= TIME:
        is_read, words.times[col, row] = _to_time(text, word, kind - TIME)
    elif kind == SAME:
        words.times[col, row] = _hash(text, word)
        is_read = bool(words.times[col, row] == words.times[col, 0])
    return is_read


@step
def _is_blank(byte: int) -> bool:
    """Whether a byte stands between words, if that is no comma; the end of a line does."""
    return byte == _BLANK or _TAB <= byte <= _RETURN


@step
def _skip_blanks(text: UInt8, at: np.uint64) -> np.uint64:
    """Where the next word begins."""
    while _is_blank(text[at]) and text[at] != _END:
        at += _ONE
    return at


@step
def _scan_word(text: UInt8, start: np.uint64, separator: int) -> Word:
    """Read a word up to its separator or the end of its line; blanks may stand behind a number."""
    first = start + np.uint64(text[start] == _MINUS)
    at, number = _scan_digits(text, first, np.int64(0))
    digits, decimals = at - first, _NONE
    if text[at] == _DOT:
        dot = at
        at, number = _scan_digits(text, dot + _ONE, number)
        decimals = at - dot - _ONE
        digits += decimals
    while not (
        text[at] == separator or text[at] == _END or (separator == _BLANK and _is_blank(text[at]))
    ):
        if not _is_blank(text[at]):
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
def _to_float(text: UInt8, word: Word) -> tuple[bool, float]:
    """Whether a word is a number that is read here, and which."""
    is_negative = text[word.start] == _MINUS
    start, value = word.start + np.uint64(is_negative), np.nan
    if _NONE < word.digits <= MOST_DIGITS:
        value = word.number / POWERS[word.decimals]
    elif _is_name(text, start, word.end, _INF):
        value = np.inf
    elif word.start < word.end and not _is_name(text, start, word.end, _NAN):
        return False, value
    return True, -value if is_negative else value


@step
def _is_name(text: UInt8, start: np.uint64, end: np.uint64, name: UInt8) -> bool:
    """Whether a word is a name of three letters."""
    size = _NONE
    while start + size < end and size < 3 and text[start + size] == name[size]:
        size += _ONE
    return bool(size == 3 and start + size == end)


@step
def _to_time(text: UInt8, word: Word, places: int) -> tuple[bool, np.int64]:
    """Whether a word is a time in units of 10 ** `places` ns that is read here, and which (ns)."""
    more = places - np.int64(word.decimals)
    is_whole = 0 < word.digits <= MOST_WHOLE_DIGITS and word.number >= 0 and more >= 0
    if not is_whole or word.number > LARGEST // SCALES[more]:
        return False, np.int64(0)
    sign = -1 if text[word.start] == _MINUS else 1
    return True, np.int64(sign * word.number * SCALES[more])


@step
def _hash(text: UInt8, word: Word) -> np.int64:
    """Make a number of a word, by which equal words are known."""
    number = np.int64(1)  # so that zeros in front count
    for at in range(word.start, word.end):
        number = number * 1_000_003 + text[at]
    return number
