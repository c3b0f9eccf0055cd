"""Decimal numbers in lines of text, parsed many at a time.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is parsed by `float` itself.

Offsets are unsigned: numba need not look whether one of them counts from the end of an array.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.types import Bool, Float32, Float64, Int64, UInt8
from occmap.values import as_float32, shorten

OTHER, NUMBER, RANGE = range(3)
"""What a word of a line is: a number, the range of a beam, or something that is not a number."""
NUMBER_CHARACTERS = b"+-.0123456789Ee naif"
"""What programs write numbers with; of others, such as 1_0, Python and NumPy think differently."""
MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_WHOLE_DIGITS = 19
"""An integer of this many digits that does not fit 64 bits becomes negative where it overflows."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _END = map(ord, "09.- \n")
_INF, _NAN = (np.frombuffer(word, np.uint8) for word in (b"inf", b"nan"))
_NONE, _ONE = np.uint64(0), np.uint64(1)


class Words(NamedTuple):
    """The words of S lines, N in each."""

    ranges: Float32
    """(S, B); NaN where nothing stands between two commas"""
    numbers: Float64
    """(N, S) other numbers, likewise; by word, since few words of a line are no ranges"""
    digits: Int64
    """(N, S) the number that all digits of a word make; a hash of a word that is no decimal"""
    decimals: Int64
    """(N, S) how many of the digits stand behind the dot; -1 for a word that is no decimal"""
    is_sound: Bool
    """(S,) whether a line has N words, and each of them can be read as what it is"""
    left: Int64
    """(M, 4) row, column, start and end of each word that the kernel leaves to Python"""

    def refuse_others(self, columns: list[int]) -> None:
        """Let only those lines be sound that have the same words as the first in some columns."""
        for part in (self.digits[columns], self.decimals[columns]):
            self.is_sound[:] &= (part == part[:, :1]).all(axis=0)

    def read_times(self, column: int, places: int) -> Int64:
        """Read times (S,) in ns, which are written in units of 10 ** `places` ns.

        A line with a time that is not a plain decimal of at most 64 bits is not sound.
        """
        more = places - self.decimals[column]
        scale = 10 ** np.clip(more, 0, places)
        is_small = np.abs(self.digits[column]) <= (2**63 - 1) // scale
        self.is_sound[:] &= is_small & (more >= 0) & (more <= places)
        return np.asarray(self.digits[column] * scale)


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


def parse_words(text: bytes, starts: Int64, separator: bytes, kinds: UInt8) -> Words:
    """Parse lines that begin at some places of a text.

    Parameters
    ----------
    separator
        What stands between two words: one comma, or any number of blanks.
    kinds
        (N,) what each word of a line is.
    """
    shape = len(kinds), len(starts)
    words = Words(
        ranges=np.empty((len(starts), np.count_nonzero(kinds == RANGE)), np.float32),
        numbers=np.empty(shape),
        digits=np.empty(shape, np.int64),
        decimals=np.empty(shape, np.int64),
        is_sound=np.zeros(len(starts), np.bool_),
        # With more words than this for Python, lines are parsed as quickly one by one.
        left=np.empty((shape[0] * shape[1] // 8 + 64, 4), np.int64),
    )
    lefts = parse_rows(np.frombuffer(text, np.uint8), starts, ord(separator), kinds, words)
    beams = np.cumsum(kinds == RANGE) - 1
    for row, col, start, end in words.left[:lefts].tolist():
        try:
            number = _parse_number(text[start:end])
        except ValueError:
            words.is_sound[row] = False
            continue
        if kinds[col] == RANGE:
            words.ranges[row, beams[col]] = as_float32(number)
        else:
            words.numbers[col, row] = number
    return words


@lru_cache(maxsize=64)
def _parse_number(word: bytes) -> float:
    """Parse a number that the kernel leaves; cached, as many logs repeat a few in every line."""
    if word.translate(None, NUMBER_CHARACTERS):
        raise ValueError(f"{shorten(word.decode(errors='replace'))} where a number belongs")
    return float(word.strip() or "nan")


@kernel
def parse_rows(text: UInt8, starts: Int64, separator: int, kinds: UInt8, words: Words) -> int:
    """Parse the words of lines; one that holds more or fewer words than others is not sound.

    So is one for whose words `left` has no more room.

    Returns
    -------
    int
        How many words are left to Python.
    """
    lefts, last = 0, len(kinds) - 1
    for row in range(len(starts)):
        at, beam = _skip_blanks(text, np.uint64(starts[row]), separator), 0
        for col in range(len(kinds)):
            word, kind = _scan_word(text, at, separator), kinds[col]
            is_read, value = _to_float(text, word)
            if kind == RANGE:
                words.ranges[row, beam] = value
                beam += 1
            else:
                words.numbers[col, row] = value
                words.digits[col, row], words.decimals[col, row] = _to_whole(text, word)
            if kind != OTHER and not is_read:
                if lefts == len(words.left):
                    break
                words.left[lefts, 0], words.left[lefts, 1] = row, col
                words.left[lefts, 2], words.left[lefts, 3] = word.start, word.end
                lefts += 1
            at = word.end
            if text[at] != _END:
                at = _skip_blanks(text, at + _ONE, separator)
            if text[word.end] == _END or (separator == _BLANK and text[at] == _END):
                words.is_sound[row] = col == last
                break
    return lefts


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
def _to_whole(text: UInt8, word: Word) -> tuple[np.int64, np.int64]:
    """Give the whole number that a word's digits make, and its decimals.

    For what is no decimal it is a hash, by which equal words are known, and -1.
    """
    if 0 < word.digits <= MOST_WHOLE_DIGITS and word.number >= 0:
        sign = -1 if text[word.start] == _MINUS else 1
        return sign * word.number, np.int64(word.decimals)
    number = np.int64(0)
    for at in range(word.start, word.end):
        number = number * 1_000_003 + text[at]
    return number, np.int64(-1)
