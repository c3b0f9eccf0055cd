"""Decimal numbers and times in text, parsed as fast as the text can be read.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.

Offsets are unsigned: numba need not look whether one of them counts from the end of an array.
"""

from typing import NamedTuple

import numpy as np

from occmap.jit import kernel, step
from occmap.readers.tables import ANY, NUMBER, RANGE, SAME, SECONDS
from occmap.types import Bool, Float32, Float64, Int64, UInt8, UInt64

MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_TIME_DIGITS = 19
"""Whole nanoseconds of this many digits fit 64 bits where the first is not 9."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _QUOTE, _END = map(ord, '09.- "\n')

# Eight bytes of text as one number, the first byte lowest.
_INF, _NAN = (np.uint64(int.from_bytes(word, "little")) for word in (b"inf", b"nan"))
_THREE_BYTES = np.uint64(0xFFFFFF)
_DIGIT_BITS = np.uint64(0x1010101010101010)
"""Every digit has this bit; dots, commas, blanks and line ends have not."""
_UPPER, _LOWER = np.uint64(0xF0F0F0F0F0F0F0F0), np.uint64(0x0F0F0F0F0F0F0F0F)
_SIXES = np.uint64(0x0606060606060606)
"""Added to the lower halves of bytes, it sets a digit bit where they are above nine."""
_PAIRS, _FIRST_PAIRS, _LAST_PAIRS = (
    np.uint64(0x000000FF000000FF),
    np.uint64(100 + (1000000 << 32)),
    np.uint64(1 + (10000 << 32)),
)
_NONE, _ONE, _EIGHT, _TEN, _SIXTEEN, _HALF, _BYTE = map(np.uint64, (0, 1, 8, 10, 16, 32, 0xFF))


class Lines(NamedTuple):
    """Lines to parse, and what their words are."""

    text: UInt8
    """(L,) bytes: lines, each with its end, and `PADDING`"""
    eights: UInt64
    """(L - 7,) the eight bytes from each byte on, the first one lowest"""
    starts: Int64
    """(S,) where the lines begin that are parsed"""
    separator: int
    """What stands between two words: one comma, or any number of blanks"""
    kinds: UInt8
    """(N,) what each word of a line is"""
    same: UInt8
    """Bytes: the words that are the same in every line, each with a separator behind it"""


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
    first: np.uint64
    """Where it goes on behind a minus"""
    end: np.uint64
    number: np.int64
    """That all its digits make"""
    digits: int
    """How many these are; 0 where anything but digits and one dot is in the word"""
    dots: int
    decimals: int
    """How many of the digits stand behind the dot"""
    has_quote: bool


class Form(NamedTuple):
    """How short numbers are written, such as 12.34 and a comma, in up to eight bytes."""

    bits: np.uint64
    """All bits of the dot and of the separator, and those that tell that a byte may be a digit"""
    usual: np.uint64
    """What these bits are"""
    before_dot: np.uint64
    behind_dot: np.uint64
    """The lower halves of the digits' bytes; those behind the dot, moved up by one place"""
    width: np.uint64
    """Of a word without its separator (bytes)"""
    power: float
    """The eight digits, with zeros behind the last, make so many times the number"""


@kernel
def parse_rows(lines: Lines, filled: Filled) -> int:
    """Parse the words of lines; a line that holds more or fewer words than others is unlike them.

    So is one for whose words `left` has no more room.

    Returns
    -------
    int
        How many words are left to the caller.
    """
    text, eights, starts, separator, kinds, same = lines
    ranges, values, times, alike, left = filled
    lefts = 0
    # Most ranges are written in the form of those before them: one comparison tells that a word has
    # it, and all its digits are taken at once. A form that no word has comes first.
    form, others = Form(_NONE, _ONE, _NONE, _NONE, _NONE, 1.0), 0
    for row in range(len(starts)):
        at, same_at, beam = np.uint64(starts[row]), _NONE, 0
        for col in range(len(kinds)):
            if col > 0 and text[at] == _END:
                break
            at = _skip_blanks(text, at + np.uint64(col > 0), separator)
            kind = kinds[col]
            has_form, digits = _match_form(eights[at], form)
            if has_form and kind == RANGE:
                ranges[row, beam] = _join_digits(digits) / form.power
                at += form.width
                beam += 1
                others = 0
                continue
            size = _measure_same(text, at, same, same_at, separator) if kind == SAME else _NONE
            if kind == SAME and size == _NONE:
                break
            if kind == SAME:
                at += size - _ONE
                same_at += size
                continue
            word = _scan_word(text, at, separator)
            at = word.end
            # A quote may hold a separator; between blanks no word is empty.
            if word.has_quote or (at == word.start and separator == _BLANK):
                break
            is_read = True
            if kind == RANGE:
                is_read, ranges[row, beam] = _to_float(word, eights[word.first])
                beam += 1
                others += 1
                is_short = word.first == word.start and 0 < word.digits < 8 - word.dots
                if others > 1 and is_short and text[at] == separator:
                    form, others = _find_form(word, eights[word.start]), 0
            elif kind == NUMBER:
                is_read, values[col, row] = _to_float(word, eights[word.first])
            elif kind != ANY:
                is_read, times[col, row] = _to_ns(word, kind, text[word.first])
            if is_read:
                continue
            if lefts == len(left):
                break
            left[lefts, 0], left[lefts, 1] = row, col
            left[lefts, 2], left[lefts, 3] = word.start, at
            lefts += 1
        else:
            alike[row] = text[_skip_blanks(text, at, separator)] == _END
    return lefts


@step
def _match_form(word: np.uint64, form: Form) -> tuple[bool, np.uint64]:
    """Whether eight bytes begin with a word of a form, and its digits, each in a byte."""
    digits = (word & form.before_dot) | ((word >> _EIGHT) & form.behind_dot)
    is_like = word & form.bits == form.usual and (digits + _SIXES) & _DIGIT_BITS == _NONE
    return is_like, digits


@step
def _join_digits(digits: np.uint64) -> np.int64:
    """The number of eight digits, of which the first is the lowest byte."""
    digits = digits * _TEN + (digits >> _EIGHT)
    odd_pairs, even_pairs = digits & _PAIRS, (digits >> _SIXTEEN) & _PAIRS
    return np.int64((odd_pairs * _FIRST_PAIRS + even_pairs * _LAST_PAIRS) >> _HALF)


@step
def _find_form(word: Word, eight: np.uint64) -> Form:
    """The form of a short word without a sign, given its eight bytes."""
    whole = word.digits - word.decimals
    dot_at, end_at = np.uint64(8 * whole), np.uint64(8 * (word.digits + word.dots))
    word_bits = (_ONE << end_at) - _ONE
    before_dot = ((_ONE << dot_at) - _ONE) & _LOWER
    behind_dot = (word_bits >> _EIGHT) & _LOWER & ~before_dot
    bits = word_bits & _UPPER | np.uint64(255 * word.dots) << dot_at | _BYTE << end_at
    width = np.uint64(word.digits + word.dots)
    return Form(bits, eight & bits, before_dot, behind_dot, width, POWERS[8 - whole])


@step
def _skip_blanks(text: UInt8, at: np.uint64, separator: int) -> np.uint64:
    """Where the next word begins; between commas each byte is part of a word."""
    while separator == _BLANK and text[at] == _BLANK:
        at += _ONE
    return at


@step
def _measure_same(
    text: UInt8, at: np.uint64, same: UInt8, same_at: np.uint64, separator: int
) -> np.uint64:
    """How long a word is with its separator if it is the one of every line, and else 0."""
    size = _NONE
    while same[same_at + size] != separator and same[same_at + size] == text[at + size]:
        size += _ONE
    ends = text[at + size] == separator or text[at + size] == _END
    return size + _ONE if same[same_at + size] == separator and ends else _NONE


@step
def _scan_word(text: UInt8, at: np.uint64, separator: int) -> Word:
    """Read a word up to its separator or the end of its line."""
    start = at
    if text[at] == _MINUS:
        at += _ONE
    first, number, dots, decimals = at, np.int64(0), 0, 0
    while True:
        if _ZERO <= text[at] <= _NINE:
            number *= 10
            number += text[at] - _ZERO
            decimals += dots
        elif text[at] == _DOT and dots == 0:
            dots = 1
        else:
            break
        at += _ONE
    digits, has_quote = int(at - first) - dots, False
    while text[at] != separator and text[at] != _END:
        digits = 0
        has_quote |= text[at] == _QUOTE
        at += _ONE
    return Word(start, first, at, number, digits, dots, decimals, has_quote)


@step
def _to_float(word: Word, name: np.uint64) -> tuple[bool, float]:
    """Whether a word is a number that is read here, and which; `name` is its eight bytes."""
    is_read, value, size = True, np.nan, np.int64(word.end - word.first)
    name &= _THREE_BYTES
    if 0 < word.digits <= MOST_DIGITS:
        value = word.number / POWERS[word.decimals]
    elif size == 3 and name == _INF:
        value = np.inf
    elif size != 3 or name != _NAN:
        is_read = word.end == word.start  # an empty cell
    return is_read, -value if word.start < word.first else value


@step
def _to_ns(word: Word, kind: int, first: np.uint8) -> tuple[bool, np.int64]:
    """Whether a word is a time that is read here, and which (ns); `first` is its first digit."""
    number, more = word.number, 9 - word.decimals if kind == SECONDS else 0
    is_plain = word.start == word.first and more >= 0 and (kind == SECONDS or word.dots == 0)
    is_read = is_plain and 0 < word.digits <= MOST_TIME_DIGITS - more - (first == _NINE)
    for _ in range(more if is_read else 0):
        number *= 10
    return is_read, number
