"""Decimal numbers in text, parsed as fast as the text can be read.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.
"""

import numpy as np

from occmap.jit import kernel
from occmap.types import Float64, Int64, UInt8, UInt64

PADDING = b"\n" * 8
"""What must follow the last line: words are looked at eight bytes at a time."""
MOST_DIGITS = 15
"""Every integer of so many digits is below 2 to the power of 53."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _END = 48, 57, 46, 45, 32, 10
_I, _N, _F = 105, 110, 102

_ZEROS = np.uint64(0x3030303030303030)
_BEYOND_NINE = np.uint64(0x7676767676767676)
"""Added to digits, it sets the highest bit of every byte that is none."""
_HIGHEST = np.uint64(0x8080808080808080)
_PLACES = np.uint64(0x0001020304050607)
_PAIRS, _FOURS, _EIGHTS = (
    np.uint64(0x00FF00FF00FF00FF),
    np.uint64(0x0000FFFF0000FFFF),
    np.uint64(0x00000000FFFFFFFF),
)
_BY_10, _BY_100, _BY_10000 = np.uint64(10), np.uint64(100), np.uint64(10000)
_ONE, _SEVEN, _BYTE, _TWO_BYTES, _FOUR_BYTES, _SEVEN_BYTES = map(np.uint64, (1, 7, 8, 16, 32, 56))


@kernel
def parse_rows(
    text: UInt8,
    eights: UInt64,
    separator: int,
    head: int,
    powers: Float64,
    values: Float64,
    places: Int64,
    left: Int64,
) -> int:
    """Parse the numbers in lines of words.

    Parameters
    ----------
    text
        (L,) bytes: S lines, each with its end, and `PADDING`.
    eights
        (L - 7,) the eight bytes from each byte on, the first one lowest.
    separator
        What stands between two words: one comma, or any number of blanks.
    head
        How many words of a line come before its numbers.
    powers
        `POWERS`.
    values
        (S, N) filled with the numbers, and with NaN where nothing stands between two commas.
    places
        (S, 2) filled with where the numbers of a line begin and end; words may follow them.
    left
        (M, 4) filled with row, column, start and end of each word that is left to the caller.

    Returns
    -------
    int
        How many words are left; -1 where a line has fewer numbers than N, or where more words are
        left than there is room for.
    """
    rows, cols = values.shape
    lefts = 0
    at: int | np.int64 = 0
    for row in range(rows):
        for _ in range(head):
            while separator == _BLANK and text[at] == _BLANK:
                at += 1
            while text[at] != separator:
                if text[at] == _END:
                    return -1
                at += 1
            at += 1
        places[row, 0] = at
        for col in range(cols):
            while separator == _BLANK and text[at] == _BLANK:
                at += 1
            # The usual number, of digits with a dot between and up to seven bytes, at a stroke.
            eight = eights[at] ^ _ZEROS
            others = ((eight + _BEYOND_NINE) | eight) & _HIGHEST
            dot = (others & (~others + _ONE)) >> _SEVEN
            others &= others - _ONE
            end = (others & (~others + _ONE)) >> _SEVEN
            digits = np.int64((dot * _PLACES) >> _SEVEN_BYTES)
            length = np.int64((end * _PLACES) >> _SEVEN_BYTES)
            after = text[at + length]
            if length > 1 and text[at + digits] == _DOT and after in (separator, _END):
                before = dot - _ONE
                eight = (eight & before) | (((eight & (end - _ONE)) >> _BYTE) & ~before)
                eight = (eight * _BY_10 + (eight >> _BYTE)) & _PAIRS
                eight = (eight * _BY_100 + (eight >> _TWO_BYTES)) & _FOURS
                eight = (eight * _BY_10000 + (eight >> _FOUR_BYTES)) & _EIGHTS
                values[row, col] = np.float64(eight) / powers[8 - digits]
                at += length
            else:
                start = at
                if text[at] == _MINUS:
                    at += 1
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
                    at += 1
                count, value = at - first - dots, np.nan
                if text[at] != separator and text[at] != _END:
                    count = 0
                    while text[at] != separator and text[at] != _END:
                        at += 1
                if 0 < count <= MOST_DIGITS:
                    value = number / powers[decimals]
                elif at - first == 3 and (text[first], text[at - 2], text[at - 1]) == (_I, _N, _F):
                    value = np.inf
                elif at > start or separator == _BLANK:
                    if at == start or lefts == len(left):
                        return -1
                    left[lefts, 0], left[lefts, 1] = row, col
                    left[lefts, 2], left[lefts, 3] = start, at
                    lefts += 1
                values[row, col] = -value if start < first else value
            if col == cols - 1:
                break
            if text[at] == _END:
                return -1
            at += 1
        places[row, 1] = at
        while text[at] != _END:
            at += 1
        at += 1
    return lefts
